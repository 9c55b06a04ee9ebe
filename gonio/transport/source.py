"""Where light comes from: directions, and starts that are stratified over the macroscopic plane.

Randomness depends on nothing but the path's own number (`philox`), results are integer sums: the bytes that come out do
not depend on threads or on the order of anything.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import uint64
from numpy.typing import NDArray

from gonio.randomness import WORD, kernel, philox, uniform

_GOLDEN = (math.sqrt(5) - 1) / 2


class Source(NamedTuple):
    """The light of one incidence as the kernels need it."""

    theta: float
    phi: float
    """Nominal direction to the source, radians."""
    source_sin2: float
    """sin² of the half angle of the source cone; 0 for a collimated beam."""
    patch: tuple[float, float, float]
    """sin² of the polar angles between which light comes from a patch of the sky, and half its azimuthal width in
    radians; zeros for a beam."""
    average: bool
    """Whether every path turns the surface by its own angle."""
    key: tuple[int, int]
    """Two 32-bit words that set this incidence's random numbers apart."""


class Replicates(NamedTuple):
    """Replicates that are traced side by side."""

    first: int
    """The number of the first of them."""
    turns: NDArray[np.float64]
    """Where the sequence of surface angles of each starts, in turns."""
    paths: int
    """How many paths each has."""

    @classmethod
    def of(cls, replicates: range, paths: int, source: Source) -> Replicates:
        """Those of `replicates`, lit by `source`."""
        turns = np.array([replicate_turn(replicate, source.key) for replicate in replicates])
        return cls(replicates.start, turns, paths)


@kernel
def every_second_bit(x):
    """The even bits of a 64-bit word, closed up."""
    x &= uint64(0x5555555555555555)
    x = (x | (x >> uint64(1))) & uint64(0x3333333333333333)
    x = (x | (x >> uint64(2))) & uint64(0x0F0F0F0F0F0F0F0F)
    x = (x | (x >> uint64(4))) & uint64(0x00FF00FF00FF00FF)
    x = (x | (x >> uint64(8))) & uint64(0x0000FFFF0000FFFF)
    return (x | (x >> uint64(16))) & WORD


@kernel
def replicate_turn(replicate, key):
    """Where a replicate's sequence of surface angles starts, in turns."""
    return uniform(philox(0, 0, replicate, 0xFFFFFFFF, key[0], key[1])[0])


@kernel
def surface_turn(path, turn, average):
    """How far the source is turned about the sample for this path, in turns: 0, or stratified and uniform."""
    fraction = path * _GOLDEN + turn
    return average * (fraction - math.floor(fraction))


@kernel
def incident(path, replicate, turn, source):
    """The direction in which a path's light travels: cos-weighted over the source, and turned about the sample."""
    sine, cosine, phi = math.sin(source.theta), math.cos(source.theta), source.phi
    if source.patch[1] > 0:
        r0, r1, _, _ = philox(path, path >> 32, replicate, 0xFFFFFFFE, source.key[0], source.key[1])
        low, high, half_width = source.patch
        sin2 = low + (high - low) * uniform(r0)
        sine, cosine, phi = math.sqrt(sin2), math.sqrt(1 - sin2), phi + half_width * (2 * uniform(r1) - 1)
    elif source.source_sin2 > 0:
        r0, r1, r2, _ = philox(path, path >> 32, replicate, 0xFFFFFFFE, source.key[0], source.key[1])
        sin_delta = math.sqrt(source.source_sin2 * uniform(r0))
        cos_delta = math.sqrt(1 - sin_delta * sin_delta)
        # Around the cone the density is 1 + a cosψ: a uniform ψ is turned over with the right probability.
        psi = 2 * math.pi * uniform(r1)
        a = -sin_delta / cos_delta * sine / cosine
        if 2 * uniform(r2) > 1 + a * math.cos(psi):
            psi += math.pi
        down, across = sin_delta * math.cos(psi), sin_delta * math.sin(psi)
        x = cos_delta * sine + down * cosine
        cosine = cos_delta * cosine - down * sine
        sine, phi = math.hypot(x, across), phi + math.atan2(across, x)
    phi += 2 * math.pi * surface_turn(path, turn, source.average)
    return -sine * math.cos(phi), -sine * math.sin(phi), -cosine


@kernel
def start(path, paths, word):
    """Where one of `paths` paths starts, as fractions of the tile along x and y: at random in its own of as many cells.

    The cells follow each other along a Morton curve, so that neighbours stay neighbours.
    """
    place = uint64((path + uniform(word)) / paths * 2.0**52)
    return (every_second_bit(place) + 0.5) * 2.0**-26, (every_second_bit(place >> uint64(1)) + 0.5) * 2.0**-26
