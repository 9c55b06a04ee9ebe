"""What the hits of a path do to light: reflectances for every wavelength, and new directions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.optics import Lambertian, Material, Mirror, fresnel, fresnel_table
from gonio.randomness import kernel, uniform
from gonio.transport.termination import MAX_HITS, NEGLIGIBLE, TRUNCATED

MIRROR, FRESNEL, LAMBERTIAN = 0, 1, 2
"""Kinds of surface optics."""


class SurfaceOptics(NamedTuple):
    """The material as the kernels need it, one entry a wavelength."""

    kind: int
    eta: NDArray[np.float64]
    k: NDArray[np.float64]
    reflectance: NDArray[np.float64]
    table: NDArray[np.float64]
    """Fresnel's reflectance over the cosine, as `optics.fresnel_table` has it."""


def surface_optics(material: Material, wavelengths: NDArray[np.float64]) -> SurfaceOptics:
    """`material` at `wavelengths` (W,) nm for the kernels."""
    ones = np.ones(len(wavelengths))
    if isinstance(material, Mirror):
        return SurfaceOptics(MIRROR, ones, ones, ones, np.zeros((0, 6, 0)))
    if isinstance(material, Lambertian):
        return SurfaceOptics(LAMBERTIAN, ones, ones, ones * material.reflectance, np.zeros((0, 6, 0)))
    index = material.refractive_index(wavelengths)
    eta, k = np.ascontiguousarray(index.real), np.ascontiguousarray(index.imag)
    return SurfaceOptics(FRESNEL, eta, k, ones, fresnel_table(eta, k))


@kernel
def unit(x, y, z):
    """A vector at length 1."""
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * scale, y * scale, z * scale


@kernel
def mirrored(dx, dy, dz, nx, ny, nz):
    """The direction of travel after a mirror reflection."""
    twice = 2 * (dx * nx + dy * ny + dz * nz)
    return dx - twice * nx, dy - twice * ny, dz - twice * nz


@kernel
def cosine_direction(r0, r1, nx, ny, nz):
    """A direction about the normal with density cosθ/π."""
    radius, angle = math.sqrt(uniform(r0)), 2 * math.pi * uniform(r1)
    a, b = radius * math.cos(angle), radius * math.sin(angle)
    c = math.sqrt(max(0.0, 1 - radius * radius))
    # Frame of Duff et al. 2017 (JCGT 6(1)): no branch but the sign.
    sign = math.copysign(1.0, nz)
    f = -1.0 / (sign + nz)
    g = nx * ny * f
    x = a * (1 + sign * nx * nx * f) + b * g + c * nx
    y = a * sign * g + b * (sign + ny * ny * f) + c * ny
    return x, y, -a * sign * nx - b * ny + c * nz


@kernel
def attenuate(struck, count, cosines, optics, weights, hits, terminations):
    """Weaken the paths `struck[:count]` that have been reflected at `cosines`. Returns how many are spent by it."""
    eta, k, reflectance, width = optics.eta, optics.k, optics.reflectance, weights.shape[1]
    if optics.kind == FRESNEL and optics.table.shape[0]:
        _look_up(struck, count, cosines, optics.table, weights)
    elif optics.kind == FRESNEL:
        for n in range(count):
            for w in range(width):
                weights[struck[n], w] *= fresnel(cosines[n], eta[w], k[w])
    elif optics.kind == LAMBERTIAN:
        for n in range(count):
            for w in range(width):
                weights[struck[n], w] *= reflectance[w]
    spent = 0
    for n in range(count):
        i, weak = struck[n], 0
        while weak < width and weights[i, weak] < NEGLIGIBLE:
            weak += 1
        if weak == width or hits[i] >= MAX_HITS:
            terminations[i] = TRUNCATED
            spent += 1
    return spent


@kernel
def _look_up(struck, count, cosines, table, weights):
    """Multiply by the polynomials of `optics.fresnel_table`; rows are taken out so that wavelengths go abreast."""
    intervals = table.shape[0]
    for n in range(count):
        place = min(np.int64(cosines[n] * intervals), intervals - 1)
        u = cosines[n] * intervals - place
        row, c0, c1, c2 = weights[struck[n]], table[place, 0], table[place, 1], table[place, 2]
        c3, c4, c5 = table[place, 3], table[place, 4], table[place, 5]
        for w in range(row.size):
            row[w] *= (c0[w] + c1[w] * u) + u * u * ((c2[w] + c3[w] * u) + u * u * (c4[w] + c5[w] * u))
