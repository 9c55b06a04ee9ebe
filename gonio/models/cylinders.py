"""What is lit and what is seen of parallel cylinders: Poulin and Fournier's geometry in closed form.

Lengths are in radii. x runs across the cylinders, y along them. A direction (cos b sin p, sin b, cos b cos p) has the
projected angle p and the axial angle b; what hides what depends on p alone, because the surface is invariant along y.
Points of the arc are named by the angle phi of their normal from z; a flat strip between arcs by the distance xi from
its end at small x.
"""

from __future__ import annotations

import math

from gonio.randomness import kernel

HALF_PI = math.pi / 2


def edge_angle(distance: float, floor: float) -> float:
    """phi_e, the largest angle between z and a normal of the exposed arc, radians."""
    return min(math.asin(min(distance / 2, 1.0)), math.acos(floor))


def strip_width(distance: float, floor: float) -> float:
    """w, the width of the flat strip in each period, radii; 0 where arcs meet."""
    width = distance - 2 * math.sin(edge_angle(distance, floor))
    return width if width > 1e-12 else 0.0


@kernel
def visible(ridges, d, edge, w, psi):
    """What is seen from the projected angle psi: arc from phi_lo to phi_hi, strip from xi_lo to xi_hi.

    A single interval of each. On ridges the near side ends where the surface turns away, the far side on the line that
    touches the neighbour; in grooves the near wall hides everything below an inscribed angle.
    """
    if psi < 0.0:
        lo, hi, xi_lo, xi_hi = _leaning(ridges, d, edge, w, -psi)
        return -hi, -lo, w - xi_hi, w - xi_lo
    return _leaning(ridges, d, edge, w, psi)


@kernel
def _leaning(ridges, d, edge, w, psi):
    """`visible` for psi >= 0."""
    if psi <= HALF_PI - edge:
        return -edge, edge, 0.0, w
    if not ridges:
        return max(-edge, 2.0 * psi + edge - math.pi), edge, 0.0, w
    cosine = math.cos(psi)
    tangent = psi - math.asin(max(-1.0, 1.0 - d * cosine))
    shadow = d - math.sin(edge) - (1.0 - math.cos(edge) * math.sin(psi)) / cosine
    return psi - HALF_PI, min(edge, tangent), 0.0, min(w, max(0.0, shadow))


@kernel
def shared(ridges, d, edge, w, psi_i, psi_o):
    """What is both lit and seen: the arc from phi_1 to phi_2 (none if phi_2 < phi_1), and a width of the strip."""
    lo_i, hi_i, xi_lo_i, xi_hi_i = visible(ridges, d, edge, w, psi_i)
    lo_o, hi_o, xi_lo_o, xi_hi_o = visible(ridges, d, edge, w, psi_o)
    strip = max(0.0, min(xi_hi_i, xi_hi_o) - max(xi_lo_i, xi_lo_o))
    return max(lo_i, lo_o), min(hi_i, hi_o), strip
