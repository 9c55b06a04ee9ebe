"""Where paths are counted: directions to bins, in exact integers."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.detectors import Apertures, Detector, HemisphereGrid, Klems
from gonio.randomness import kernel
from gonio.tally import UNIT
from gonio.transport.light import unit
from gonio.transport.source import surface_turn
from gonio.transport.termination import ESCAPED

RING_STEPS = 4096
"""Steps of sin² that the ring of a direction is looked up by."""


SECTOR_STEPS = 1024
"""Steps of each quadrant that the azimuth bin of a direction is looked up by."""


class Bins(NamedTuple):
    """The detector as the kernels need it."""

    size: int
    """How many bins."""
    sin2_edges: NDArray[np.float64]
    """sin² of the upper ring edges of a accelerator, inf for the last; empty for apertures."""
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
    """Azimuth of the traced frame that the bins count from, in turns: the light's for a grid, 0 for apertures."""
    axes: NDArray[np.float64]
    cosine: float
    """Of the apertures' half angle."""


class Arrivals(NamedTuple):
    """Paths, some of which have just escaped; one row each."""

    directions: tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]]
    """x, y and z of their directions; of any length."""
    terminations: NDArray[np.int8]
    weights: NDArray[np.float64]
    """(paths, wavelengths)."""
    paths: NDArray[np.int64]
    """Their numbers."""
    slots: NDArray[np.int32]
    """Which replicate of the group each belongs to."""
    hits: NDArray[np.int32]


class Scores(NamedTuple):
    """What every replicate of a group collected, in integers (`tally.UNIT` to a path)."""

    bins: NDArray[np.int64]
    """(orders, bins, replicates, wavelengths + 1): weights, and in the last column how many paths arrived; the last
    bin is the whole hemisphere. What is added together lies together, and so do the replicates, because what they send
    off from one place arrives in one bin."""
    energy_budget: NDArray[np.int64]
    """What did not escape: absorbed, truncated, lost, (replicates, 3, wavelengths)."""

    @classmethod
    def empty(cls, replicates: int, orders: int, bins: int, wavelengths: int) -> Scores:
        """Nothing yet."""
        return cls(
            np.zeros((orders, bins, replicates, wavelengths + 1), np.int64),
            np.zeros((replicates, 3, wavelengths), np.int64),
        )


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
def total_up(scored):
    """Fill in the whole hemisphere, the last bin, from all others: escaped is their sum, not a second counter."""
    orders, places, slots, width = scored.shape
    for order in range(orders):
        for place in range(places - 1):
            for slot in range(slots):
                if scored[order, place, slot, width - 1] > 0:
                    for w in range(width):
                        scored[order, places - 1, slot, w] += scored[order, place, slot, w]


def balance(scores: Scores, paths: int) -> None:
    """launched = escaped + absorbed + truncated + lost, exactly, or the instrument is broken."""
    spent = scores.bins[:, -1, :, :-1].sum(axis=0) + scores.energy_budget.sum(axis=1)
    if (spent != paths * UNIT).any():
        raise ArithmeticError(f"the energy budget does not close: {spent / UNIT} of {paths} paths accounted for")


@kernel
def score(count, arrivals, bins, source, turns, scored, records):
    """Add the paths that have escaped, of the first `count`, to their bins of rings.

    First the bins are found, then a short loop adds to them: they lie far apart in memory, and so the processor can
    wait for many of them at once. `records`, (count + 1, 2), is scratch.
    """
    directions, terminations, weights, paths, slots, hits = arrivals
    xs, ys, zs = directions
    edges, rings, ring_bins, divisions = bins.sin2_edges, bins.rings, bins.ring_bins, bins.divisions
    sector_edges, first_sectors, width = bins.sector_edges, bins.first_sectors, weights.shape[1]
    c, s = math.cos(2 * math.pi * bins.turn), math.sin(2 * math.pi * bins.turn)
    arrived = 0
    for i in range(count):
        if terminations[i] != ESCAPED:
            continue
        x, y, z = np.float64(xs[i]), np.float64(ys[i]), np.float64(zs[i])
        across = x * x + y * y
        sin2 = across / (across + z * z)
        ring = rings[int(sin2 * RING_STEPS)]
        while sin2 >= edges[ring]:
            ring += 1
        if source.average:
            angle = 2 * math.pi * (bins.turn + surface_turn(paths[i], turns[slots[i]], True))
            c, s = math.cos(angle), math.sin(angle)
        x, y = c * x + s * y, c * y - s * x
        table = divisions[ring]
        sector = first_sectors[table, _diamond(x, y)]
        while _passed(x, y, sector_edges[table, sector + 1, 0], sector_edges[table, sector + 1, 1]):
            sector += 1
        place = ring_bins[ring] + sector
        place = place if place < ring_bins[ring + 1] else ring_bins[ring]
        order = min(hits[i], scored.shape[0]) - 1
        records[arrived, 0], records[arrived, 1] = i, (order * scored.shape[1] + place) * turns.size + slots[i]
        arrived += 1
    sums = scored.reshape(-1, width + 1)
    for j in range(arrived):
        row, record = np.uint64(records[j, 0]), np.uint64(records[j, 1])
        for w in range(width):
            sums[record, w] += integer(weights[row, w])
        sums[record, width] += 1


@kernel
def _diamond(x, y):
    """The step around the circle in which a direction lies; the pole is in the first."""
    turn = y / (abs(x) + abs(y) + 1e-300)
    turn = 2.0 - turn if x < 0 else turn
    return int((turn if turn >= 0 else 4.0 + turn) * SECTOR_STEPS)


@kernel
def _passed(x, y, edge_x, edge_y):
    """Whether a direction lies on an edge or less than a quarter turn beyond it."""
    return (edge_x * y - edge_y * x >= 0) & (edge_x * x + edge_y * y > 0)


@kernel
def integer(weight):
    """A weight in units of the sums."""
    return np.int64(weight * UNIT + 0.5)


@kernel
def score_apertures(count, arrivals, bins, source, turns, scored):
    """Add the paths that have escaped to every aperture that sees them, and to the whole hemisphere."""
    directions, terminations, weights, paths, slots, hits = arrivals
    xs, ys, zs = directions
    axes, width = bins.axes, weights.shape[1]
    for i in range(count):
        if terminations[i] != ESCAPED:
            continue
        x, y, z = unit(np.float64(xs[i]), np.float64(ys[i]), np.float64(zs[i]))
        order, slot = min(hits[i], scored.shape[0]) - 1, slots[i]
        angle = 2 * math.pi * surface_turn(paths[i], turns[slot], source.average)
        c, s = math.cos(angle), math.sin(angle)
        x, y = c * x + s * y, c * y - s * x
        for place in range(bins.size + 1):
            seen = place == bins.size or x * axes[place, 0] + y * axes[place, 1] + z * axes[place, 2] >= bins.cosine
            if seen:
                for w in range(width):
                    scored[order, place, slot, w] += integer(weights[i, w])
                scored[order, place, slot, width] += 1
