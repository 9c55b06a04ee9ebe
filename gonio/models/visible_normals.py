"""Visible normals, those of facets seen from a direction, at random (Heitz and d'Eon 2014, doi:10.1111/cgf.12417)."""

from __future__ import annotations

import math

from gonio.models.distributions import BECKMANN
from gonio.randomness import kernel, philox, uniform

_ATTEMPTS = 64
"""Attempts at a visible normal of Beckmann's distribution; two thirds of them succeed."""

# What a block of random words is for; the smaller numbers are attempts.
ACROSS, LOBE, PATH = _ATTEMPTS, _ATTEMPTS + 1, _ATTEMPTS + 2


@kernel
def _lobe_area(lobes, j, x, y, z):
    """`projected_area` of one lobe."""
    c, s = lobes[j, 4], lobes[j, 5]
    tangent = math.hypot(lobes[j, 2] * (c * x + s * y), lobes[j, 3] * (c * y - s * x))
    if lobes[j, 0] != BECKMANN:
        length = math.hypot(z, tangent)
        return lobes[j, 1] * 0.5 * (z + length if z > 0.0 else tangent * tangent / (length - z))
    # Past a = 26 the rest is below 1e-300; so it is straight above.
    if tangent * 26.0 <= abs(z):
        return lobes[j, 1] * max(z, 0.0)
    a = z / tangent
    return lobes[j, 1] * 0.5 * (z * math.erfc(-a) + tangent * math.exp(-a * a) / math.sqrt(math.pi))


@kernel
def projected_area(lobes, x, y, z):
    """Area of the facets that face a direction, projected along it, per area of the plane.

    z (1 + Lambda) above the horizon, -z Lambda of the opposite direction below it, and finite in between.
    """
    total = 0.0
    for j in range(lobes.shape[0]):
        total += _lobe_area(lobes, j, x, y, z)
    return total


@kernel
def _chosen_lobe(lobes, x, y, z, u):
    """A lobe, with a probability proportional to its projected area."""
    rest = u * projected_area(lobes, x, y, z)
    for j in range(lobes.shape[0] - 1):
        rest -= _lobe_area(lobes, j, x, y, z)
        if rest < 0.0:
            return j
    return lobes.shape[0] - 1


@kernel
def _beckmann_slopes(c, walk, step, k0, k1):
    """Slopes (q, p) with density max(0, q + c) exp(-q^2 - p^2): towards the viewer, at elevation arccot c, and across.

    Exact rejection: tangents bound the logarithm of the density, from a Gaussian about its maximum if c is positive,
    from an exponential one if the viewer is below the horizon. At worst 0.66 of the attempts succeed, at c = 0.
    """
    if c >= 0.0:
        scale = 0.5 * (c + math.sqrt(c * c + 2.0))
        for attempt in range(_ATTEMPTS):
            r0, r1, r2, _ = philox(walk, walk >> 32, step, attempt, k0, k1)
            radius, angle = math.sqrt(-math.log(uniform(r0))), 2.0 * math.pi * uniform(r1)
            q, p = radius * math.cos(angle), radius * math.sin(angle)
            if uniform(r2) < (1.0 + q / scale) * math.exp(-q / scale):
                break
        return q + 0.5 / scale, p
    rate = math.sqrt(c * c + 4.0) - c
    for attempt in range(_ATTEMPTS):
        r0, r1, r2, _ = philox(walk, walk >> 32, step, attempt, k0, k1)
        q = -math.log(uniform(r0) * uniform(r1)) / rate
        if uniform(r2) < math.exp(-((q - 2.0 / rate) ** 2)):
            break
    r0, r1, _, _ = philox(walk, walk >> 32, step, ACROSS, k0, k1)
    return q - c, math.sqrt(-math.log(uniform(r0))) * math.cos(2.0 * math.pi * uniform(r1))


@kernel
def _ggx_normal(x, y, z, walk, step, k0, k1):
    """A vector along the normal of a unit hemisphere as seen from (x, y, z), which is a unit vector.

    Its specular directions fill a spherical cap evenly (J. Dupuy, A. Benyoub, Sampling Visible GGX Normals with
    Spherical Caps, 2023, doi:10.1111/cgf.14867), from below the horizon as well; 1 + z must not cancel there.
    """
    r0, r1, _, _ = philox(walk, walk >> 32, step, 0, k0, k1)
    height = 1.0 + z if z > 0.0 else (x * x + y * y) / (1.0 - z)
    u, angle = uniform(r0), 2.0 * math.pi * uniform(r1)
    drop = u * height
    sine = math.sqrt(drop * (2.0 - drop))
    return sine * math.cos(angle) + x, sine * math.sin(angle) + y, (1.0 - u) * height


@kernel
def visible_normal(lobes, x, y, z, walk, step, k0, k1):
    """A facet normal m with density max(0, v.m) D(m) / `projected_area`(v), for any direction v = (x, y, z).

    Stretched by 1 / alpha, a lobe is isotropic with alpha = 1.
    """
    j = 0
    if lobes.shape[0] > 1:
        j = _chosen_lobe(lobes, x, y, z, uniform(philox(walk, walk >> 32, step, LOBE, k0, k1)[0]))
    ax, ay, c, s = lobes[j, 2], lobes[j, 3], lobes[j, 4], lobes[j, 5]
    vx, vy = ax * (c * x + s * y), ay * (c * y - s * x)
    tangent = math.hypot(vx, vy)
    if lobes[j, 0] == BECKMANN:
        # Seen from straight above all azimuths are the same, and more than 1e8 makes no difference.
        ex, ey = (vx / tangent, vy / tangent) if tangent > 0.0 else (1.0, 0.0)
        q, p = _beckmann_slopes(z / max(tangent, 1e-8 * abs(z)), walk, step, k0, k1)
        mx, my, mz = ex * q - ey * p, ey * q + ex * p, 1.0
    else:
        scale = 1.0 / math.hypot(tangent, z)
        mx, my, mz = _ggx_normal(vx * scale, vy * scale, z * scale, walk, step, k0, k1)
    mx, my = ax * mx, ay * my
    scale = 1.0 / math.sqrt(mx * mx + my * my + mz * mz)
    return (c * mx - s * my) * scale, (s * mx + c * my) * scale, mz * scale
