"""What all light paths have in common: where they start, how matter weakens them, where they are counted.

Randomness depends on nothing but the path's own number (`philox`), results are integer sums: the bytes that come out do
not depend on threads or on the order of anything.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import uint64
from numpy.typing import NDArray

from gonio.detectors import Apertures, Detector, HemisphereGrid, Klems
from gonio.optics import Lambertian, Material, Mirror, fresnel, fresnel_table
from gonio.randomness import WORD, kernel, philox, uniform
from gonio.tally import UNIT

MAX_HITS = 10_000
"""Light trapped in a cusp between lossless cylinders needs more than 1,000."""

MAX_CROSSINGS = 10_000
"""Tiles that a path may cross between two hits."""

NEGLIGIBLE = 1e-9
"""A path whose largest weight is below this stops; what it carried is in the ledger as truncated."""

RING_STEPS = 4096
"""Steps of sin² that the ring of a direction is looked up by."""

SECTOR_STEPS = 1024
"""Steps of each quadrant that the azimuth bin of a direction is looked up by."""

ABSORBED, TRUNCATED, LOST = 0, 1, 2
"""Rows of the ledger: where light goes that does not escape."""

IN_FLIGHT, ESCAPED = -2, -1
"""Fates of a path beside those rows."""

MIRROR, FRESNEL, LAMBERTIAN = 0, 1, 2
"""Kinds of matter."""

_GOLDEN = (math.sqrt(5) - 1) / 2


class Lamp(NamedTuple):
    """The light of one incidence as the kernels need it."""

    theta: float
    phi: float
    """Nominal direction to the lamp, radians."""
    beam: float
    """sin² of the half angle of the source cone; 0 for a collimated beam."""
    patch: tuple[float, float, float]
    """sin² of the polar angles between which light comes from a patch of the sky, and half its azimuthal width in
    radians; zeros for a beam."""
    average: bool
    """Whether every path turns the surface by its own angle."""
    key: tuple[int, int]
    """Two 32-bit words that set this incidence's random numbers apart."""


class Matter(NamedTuple):
    """The material as the kernels need it, one entry a wavelength."""

    kind: int
    eta: NDArray[np.float64]
    k: NDArray[np.float64]
    reflectance: NDArray[np.float64]
    table: NDArray[np.float64]
    """Fresnel's reflectance over the cosine, as `optics.fresnel_table` has it."""


class Bins(NamedTuple):
    """The detector as the kernels need it."""

    size: int
    """How many bins."""
    sin2_edges: NDArray[np.float64]
    """sin² of the upper ring edges of a grid, inf for the last; empty for apertures."""
    rings: NDArray[np.int64]
    """The ring in which each of many equal steps of sin² begins."""
    ring_bins: NDArray[np.int64]
    """The first bin of each ring, and the number of all; (rings + 1,)."""
    divisions: NDArray[np.int64]
    """Which of the following tables divides each ring."""
    sector_edges: NDArray[np.float64]
    """(tables, sectors + 2, 2) cos and sin of the lower edges of the azimuth bins, and of the first two once more."""
    first_sectors: NDArray[np.int64]
    """(tables, steps), the azimuth bin in which each of many steps around the circle begins."""
    turn: float
    """Azimuth of the traced frame that the bins count from, in turns: the lamp's for a grid, 0 for apertures."""
    axes: NDArray[np.float64]
    cosine: float
    """Of the apertures' half angle."""


class Catch(NamedTuple):
    """What every replicate of a group collected, in integers (`tally.UNIT` to a path)."""

    bins: NDArray[np.int64]
    """(orders, bins, replicates, wavelengths + 1): weights, and in the last column how many paths arrived; the last
    bin is the whole hemisphere. What is added together lies together, and so do the replicates, because what they send
    off from one place arrives in one bin."""
    ledger: NDArray[np.int64]
    """Absorbed, truncated, lost, (replicates, 3, wavelengths)."""

    @classmethod
    def empty(cls, replicates: int, orders: int, bins: int, wavelengths: int) -> Catch:
        """Nothing yet."""
        return cls(
            np.zeros((orders, bins, replicates, wavelengths + 1), np.int64),
            np.zeros((replicates, 3, wavelengths), np.int64),
        )


def matter(material: Material, wavelengths: NDArray[np.float64]) -> Matter:
    """`material` at `wavelengths` (W,) nm for the kernels."""
    ones = np.ones(len(wavelengths))
    if isinstance(material, Mirror):
        return Matter(MIRROR, ones, ones, ones, np.zeros((0, 6, 0)))
    if isinstance(material, Lambertian):
        return Matter(LAMBERTIAN, ones, ones, ones * material.reflectance, np.zeros((0, 6, 0)))
    index = material.refractive_index(wavelengths)
    eta, k = np.ascontiguousarray(index.real), np.ascontiguousarray(index.imag)
    return Matter(FRESNEL, eta, k, ones, fresnel_table(eta, k))


def bins_of(detector: Detector, phi_i: float) -> Bins:
    """`detector` for the kernels, for light from azimuth `phi_i` in degrees."""
    match detector:
        case HemisphereGrid():
            rings, sectors = detector.shape
            return _ringed(detector.theta_edges, np.full(rings, sectors), phi_i / 360)
        case Klems():
            return _ringed(detector.theta_edges, detector.sectors, 0.0)
        case Apertures():
            cosine = math.cos(math.radians(detector.half_angle))
            none, empty = np.zeros(0, np.int64), np.zeros(0)
            return Bins(
                detector.bins, empty, none, none, none, np.zeros((0, 0, 2)), np.zeros((0, 0), np.int64), 0.0,
                np.ascontiguousarray(detector.axes), cosine,
            )  # fmt: skip


def _ringed(theta_edges: NDArray[np.float64], sectors: NDArray[np.int64], turn: float) -> Bins:
    """Rings between `theta_edges` in degrees, each of so many equal sectors, the first centred on azimuth `turn`."""
    upper = np.sin(np.radians(theta_edges[1:])) ** 2
    upper[-1] = np.inf
    rings = np.searchsorted(upper, np.arange(RING_STEPS + 1) / RING_STEPS, side="right")
    counts, divisions = np.unique(sectors, return_inverse=True)
    edges = np.zeros((len(counts), counts[-1] + 2, 2))
    first = np.empty((len(counts), 4 * SECTOR_STEPS + 1), np.int64)
    for table, count in enumerate(counts):
        edges[table, : count + 2], first[table] = _sector_table(int(count))
    ring_bins = np.concatenate([[0], np.cumsum(sectors)])
    return Bins(int(ring_bins[-1]), upper, rings, ring_bins, divisions, edges, first, turn, np.zeros((0, 3)), 1.0)


def _sector_table(sectors: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """`Bins.sector_edges` and `Bins.first_sectors` of equal azimuth bins, the first centred on 0.

    The circle is walked along a diamond: its step n begins where |x| + |y| = 1 and y, from quadrant to quadrant, is as
    far from the axis as n is from the quadrant's first step. An undivided ring has edges that are never passed.
    """
    if sectors == 1:
        return np.zeros((3, 2)), np.zeros(4 * SECTOR_STEPS + 1, np.int64)
    edges = (np.arange(sectors + 2) - 0.5) * (2 * math.pi / sectors)
    quadrant, part = np.divmod(np.arange(4 * SECTOR_STEPS + 1), SECTOR_STEPS)
    begins = quadrant * (math.pi / 2) + np.arctan2(part, SECTOR_STEPS - part)
    first = np.searchsorted(edges, begins - 1e-9, side="right") - 1
    return np.stack([np.cos(edges), np.sin(edges)], axis=-1), np.minimum(first, sectors)


@kernel
def total_up(caught):  # type: ignore[no-untyped-def]
    """Fill in the whole hemisphere, the last bin, from all others: escaped is their sum, not a second counter."""
    orders, places, members, width = caught.shape
    for order in range(orders):
        for place in range(places - 1):
            for member in range(members):
                if caught[order, place, member, width - 1] > 0:
                    for w in range(width):
                        caught[order, places - 1, member, w] += caught[order, place, member, w]


def balance(catch: Catch, paths: int) -> None:
    """launched = escaped + absorbed + truncated + lost, exactly, or the instrument is broken."""
    spent = catch.bins[:, -1, :, :-1].sum(axis=0) + catch.ledger.sum(axis=1)
    if (spent != paths * UNIT).any():
        raise ArithmeticError(f"the energy ledger does not close: {spent / UNIT} of {paths} paths accounted for")


@kernel
def every_second_bit(x):  # type: ignore[no-untyped-def]
    """The even bits of a 64-bit word, closed up."""
    x &= uint64(0x5555555555555555)
    x = (x | (x >> uint64(1))) & uint64(0x3333333333333333)
    x = (x | (x >> uint64(2))) & uint64(0x0F0F0F0F0F0F0F0F)
    x = (x | (x >> uint64(4))) & uint64(0x00FF00FF00FF00FF)
    x = (x | (x >> uint64(8))) & uint64(0x0000FFFF0000FFFF)
    return (x | (x >> uint64(16))) & WORD


@kernel
def replicate_turn(replicate, key):  # type: ignore[no-untyped-def]
    """Where a replicate's sequence of surface angles starts, in turns."""
    return uniform(philox(0, 0, replicate, 0xFFFFFFFF, key[0], key[1])[0])


@kernel
def surface_turn(path, turn, average):  # type: ignore[no-untyped-def]
    """How far the lamp is turned about the sample for this path, in turns: 0, or stratified and uniform."""
    fraction = path * _GOLDEN + turn
    return average * (fraction - math.floor(fraction))


@kernel
def incident(path, replicate, turn, lamp):  # type: ignore[no-untyped-def]
    """The direction in which a path's light travels: cos-weighted over the source, and turned about the sample."""
    sine, cosine, phi = math.sin(lamp.theta), math.cos(lamp.theta), lamp.phi
    if lamp.patch[1] > 0:
        r0, r1, _, _ = philox(path, path >> 32, replicate, 0xFFFFFFFE, lamp.key[0], lamp.key[1])
        low, high, half_width = lamp.patch
        sin2 = low + (high - low) * uniform(r0)
        sine, cosine, phi = math.sqrt(sin2), math.sqrt(1 - sin2), phi + half_width * (2 * uniform(r1) - 1)
    elif lamp.beam > 0:
        r0, r1, r2, _ = philox(path, path >> 32, replicate, 0xFFFFFFFE, lamp.key[0], lamp.key[1])
        sin_delta = math.sqrt(lamp.beam * uniform(r0))
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
    phi += 2 * math.pi * surface_turn(path, turn, lamp.average)
    return -sine * math.cos(phi), -sine * math.sin(phi), -cosine


@kernel
def start(path, paths, word):  # type: ignore[no-untyped-def]
    """Where one of `paths` paths starts, as fractions of the tile along x and y: at random in its own of as many cells.

    The cells follow each other along a Morton curve, so that neighbours stay neighbours.
    """
    place = uint64((path + uniform(word)) / paths * 2.0**52)
    return (every_second_bit(place) + 0.5) * 2.0**-26, (every_second_bit(place >> uint64(1)) + 0.5) * 2.0**-26


@kernel
def unit(x, y, z):  # type: ignore[no-untyped-def]
    """A vector at length 1."""
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * scale, y * scale, z * scale


@kernel
def mirrored(dx, dy, dz, nx, ny, nz):  # type: ignore[no-untyped-def]
    """The direction of travel after a mirror reflection."""
    twice = 2 * (dx * nx + dy * ny + dz * nz)
    return dx - twice * nx, dy - twice * ny, dz - twice * nz


@kernel
def cosine_direction(r0, r1, nx, ny, nz):  # type: ignore[no-untyped-def]
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
def weigh(struck, count, cosines, matter, weights, hits, fates):  # type: ignore[no-untyped-def]
    """Weaken the paths `struck[:count]` that have been reflected at `cosines`. Returns how many are spent by it."""
    eta, k, reflectance, width = matter.eta, matter.k, matter.reflectance, weights.shape[1]
    if matter.kind == FRESNEL and matter.table.shape[0]:
        _look_up(struck, count, cosines, matter.table, weights)
    elif matter.kind == FRESNEL:
        for n in range(count):
            for w in range(width):
                weights[struck[n], w] *= fresnel(cosines[n], eta[w], k[w])
    elif matter.kind == LAMBERTIAN:
        for n in range(count):
            for w in range(width):
                weights[struck[n], w] *= reflectance[w]
    spent = 0
    for n in range(count):
        i, weak = struck[n], 0
        while weak < width and weights[i, weak] < NEGLIGIBLE:
            weak += 1
        if weak == width or hits[i] >= MAX_HITS:
            fates[i] = TRUNCATED
            spent += 1
    return spent


@kernel
def _look_up(struck, count, cosines, table, weights):  # type: ignore[no-untyped-def]
    """Multiply by the polynomials of `optics.fresnel_table`; rows are taken out so that wavelengths go abreast."""
    intervals = table.shape[0]
    for n in range(count):
        place = min(np.int64(cosines[n] * intervals), intervals - 1)
        u = cosines[n] * intervals - place
        row, c0, c1, c2 = weights[struck[n]], table[place, 0], table[place, 1], table[place, 2]
        c3, c4, c5 = table[place, 3], table[place, 4], table[place, 5]
        for w in range(row.size):
            row[w] *= (c0[w] + c1[w] * u) + u * u * ((c2[w] + c3[w] * u) + u * u * (c4[w] + c5[w] * u))


@kernel
def collect(count, directions, fates, weights, paths, members, hits, bins, lamp, turns, caught, arrivals):  # type: ignore[no-untyped-def]
    """Add the paths that have escaped, of the first `count`, to their bins of a grid.

    First the bins are found, then a short loop adds to them: they lie far apart in memory, and so the processor can
    wait for many of them at once.
    """
    xs, ys, zs = directions
    edges, rings, ring_bins, divisions = bins.sin2_edges, bins.rings, bins.ring_bins, bins.divisions
    sector_edges, first_sectors, width = bins.sector_edges, bins.first_sectors, weights.shape[1]
    c, s = math.cos(2 * math.pi * bins.turn), math.sin(2 * math.pi * bins.turn)
    arrived = 0
    for i in range(count):
        if fates[i] != ESCAPED:
            continue
        x, y, z = np.float64(xs[i]), np.float64(ys[i]), np.float64(zs[i])
        across = x * x + y * y
        sin2 = across / (across + z * z)
        ring = rings[int(sin2 * RING_STEPS)]
        while sin2 >= edges[ring]:
            ring += 1
        if lamp.average:
            angle = 2 * math.pi * (bins.turn + surface_turn(paths[i], turns[members[i]], True))
            c, s = math.cos(angle), math.sin(angle)
        x, y = c * x + s * y, c * y - s * x
        table = divisions[ring]
        sector = first_sectors[table, _diamond(x, y)]
        while _passed(x, y, sector_edges[table, sector + 1, 0], sector_edges[table, sector + 1, 1]):
            sector += 1
        place = ring_bins[ring] + sector
        place = place if place < ring_bins[ring + 1] else ring_bins[ring]
        order = min(hits[i], caught.shape[0]) - 1
        arrivals[arrived, 0], arrivals[arrived, 1] = i, (order * caught.shape[1] + place) * turns.size + members[i]
        arrived += 1
    records = caught.reshape(-1, width + 1)
    for j in range(arrived):
        row, record = np.uint64(arrivals[j, 0]), np.uint64(arrivals[j, 1])
        for w in range(width):
            records[record, w] += integer(weights[row, w])
        records[record, width] += 1


@kernel
def _diamond(x, y):  # type: ignore[no-untyped-def]
    """The step around the circle in which a direction lies; the pole is in the first."""
    turn = y / (abs(x) + abs(y) + 1e-300)
    turn = 2.0 - turn if x < 0 else turn
    return int((turn if turn >= 0 else 4.0 + turn) * SECTOR_STEPS)


@kernel
def _passed(x, y, edge_x, edge_y):  # type: ignore[no-untyped-def]
    """Whether a direction lies on an edge or less than a quarter turn beyond it."""
    return (edge_x * y - edge_y * x >= 0) & (edge_x * x + edge_y * y > 0)


@kernel
def integer(weight):  # type: ignore[no-untyped-def]
    """A weight in units of the sums."""
    return np.int64(weight * UNIT + 0.5)


@kernel
def sight(count, directions, fates, weights, paths, members, hits, bins, lamp, turns, caught):  # type: ignore[no-untyped-def]
    """Add the paths that have escaped to every aperture that sees them, and to the whole hemisphere."""
    xs, ys, zs = directions
    axes, width = bins.axes, weights.shape[1]
    for i in range(count):
        if fates[i] != ESCAPED:
            continue
        x, y, z = unit(np.float64(xs[i]), np.float64(ys[i]), np.float64(zs[i]))
        order, member = min(hits[i], caught.shape[0]) - 1, members[i]
        angle = 2 * math.pi * surface_turn(paths[i], turns[member], lamp.average)
        c, s = math.cos(angle), math.sin(angle)
        x, y = c * x + s * y, c * y - s * x
        for place in range(bins.size + 1):
            seen = place == bins.size or x * axes[place, 0] + y * axes[place, 1] + z * axes[place, 2] >= bins.cosine
            if seen:
                for w in range(width):
                    caught[order, place, member, w] += integer(weights[i, w])
                caught[order, place, member, width] += 1
