"""Small drawings of the plane of incidence for notebooks, as SVG: sources on the left, specular directions, lobes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    import xarray as xr

SOURCE, SPECULAR, LOBE = "#d98200", "#0072b2", "#2a788e"
"""Colours of the source, of the specular direction and of lobes."""

RADIUS = 100
"""Of the half circle of directions, pixels."""

SHOWN = 3
"""At most so many incidences are drawn."""

IN_PLANE = 5.0
"""Degrees of arc on either side of the plane over which a lobe is averaged."""


def plane_of_incidence(sources: Sequence[float], lobes: Iterable[tuple[Floats, Floats]] = ()) -> str:
    """An SVG of sources at these polar angles in degrees and their specular directions, and of lobes.

    A lobe is signed angles in degrees, positive on the specular side, and radii from 0 to 1.
    """
    r, width = RADIUS, 2 * RADIUS + 40
    lines = [f'<path d="M{-r},0 A{r},{r} 0 0 1 {r},0 Z" fill="none" stroke="#8a8a86" stroke-width="1"/>']
    for angles, radii in lobes:
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(*_at(angles, r * radii), strict=True))
        lines.append(f'<polygon points="0,0 {points}" fill="{LOBE}" fill-opacity="0.25" stroke="{LOBE}"/>')
    for source in sources:
        for angle, colour in ((-source, SOURCE), (source, SPECULAR)):
            (x0, x1), (y0, y1) = _at(np.full(2, angle), np.array([0.9 * r, 1.1 * r]))
            lines.append(
                f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{colour}" stroke-width="3"/>'
            )
    box = f"{-width // 2} {-r - 15} {width} {r + 20}"
    words = (
        "<title>Plane of incidence: sources orange, specular directions blue, each lobe on a scale of its own</title>"
    )
    return f'<svg width="{width}" height="{r + 20}" viewBox="{box}" role="img">{words}{"".join(lines)}</svg>'


def _at(angles: Floats, radii: Floats) -> tuple[Floats, Floats]:
    """Pixels from the middle, y downward; grazing lines stay visible."""
    return radii * np.sin(np.radians(angles)), -radii * np.cos(np.radians(angles))


def thinned(sources: Sequence[float]) -> list[int]:
    """Which `SHOWN` of the sources to draw, evenly."""
    return sorted({round(k) for k in np.linspace(0, len(sources) - 1, min(SHOWN, len(sources)))})


def in_plane(data: xr.Dataset) -> tuple[Floats, Floats]:
    """Signed angles in degrees, and BRDF times cosine there, of one incidence and wavelength over theta_o and dphi."""
    dphi, theta = data["dphi"].values, data["theta_o"].values
    brdf = data["brdf"].transpose("theta_o", "dphi").values
    # Degrees of arc, not of azimuth: bins near the pole are small and noisy.
    arc = np.sin(np.radians(theta))[:, None]
    sides = []
    for side in (0.0, 180.0):
        apart = np.abs((dphi - side + 180) % 360 - 180)
        near = (arc * apart <= IN_PLANE) | (apart <= apart.min() + 1e-9)
        known = near & np.isfinite(brdf)
        mean = np.where(known, brdf, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        sides.append(mean * np.cos(np.radians(theta)))
    return np.concatenate([-theta[::-1], theta]), np.concatenate([sides[0][::-1], sides[1]])
