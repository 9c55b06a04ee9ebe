"""Exact sums: weights are integers (2³² to a path), and so are the sums of their squares, 128 bits wide.

Integer sums do not care for the order in which threads, replicates or shards are added, so results are the same bytes
always and a variance that is zero is exactly zero.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
from numba import njit, uint64
from numpy.typing import NDArray

UNIT = 1 << 32
"""The integer weight of one whole path."""

MAX_PATHS = (1 << 31) - 1
"""More launched paths than this would overflow the 64-bit sums."""

SLABS = 11
"""Parts of the sums that threads add to one at a time; prime, so that groups of replicates begin in different ones."""

_LOW = uint64(0xFFFFFFFF)
_HALF = uint64(32)


class UInt128(NamedTuple):
    """Unsigned 128-bit integers: `high` · 2⁶⁴ + `low`, two uint64 arrays of one shape."""

    high: NDArray[np.uint64]
    low: NDArray[np.uint64]

    @classmethod
    def zeros(cls, shape: tuple[int, ...]) -> UInt128:
        """Zeros of `shape`."""
        return cls(np.zeros(shape, np.uint64), np.zeros(shape, np.uint64))

    def add(self, other: UInt128) -> None:
        """Add `other` in place."""
        _add(self.high.ravel(), self.low.ravel(), other.high.ravel(), other.low.ravel())

    def add_square(self, values: NDArray[np.int64]) -> None:
        """Add the squares of `values` in place."""
        _add_square(self.high.ravel(), self.low.ravel(), np.ascontiguousarray(values).ravel())

    def squared_deviations(self, total: NDArray[np.int64], count: int) -> UInt128:
        """count · Σx² - (Σx)², where this is Σx² and `total` is Σx of `count` values: count² times their variance."""
        result = UInt128.zeros(self.high.shape)
        _squared_deviations(
            result.high.ravel(),
            result.low.ravel(),
            self.high.ravel(),
            self.low.ravel(),
            np.ascontiguousarray(total).ravel(),
            count,
        )
        return result

    def floats(self) -> NDArray[np.float64]:
        """The nearest float64 values."""
        return self.high.astype(np.float64) * 2.0**64 + self.low.astype(np.float64)


@dataclass
class Tally:
    """Exact sums over the replicates of one incidence: orders (their total first) x bins (the hemisphere last) x W."""

    pilot: int
    """The first so many replicates give the error bars; any more only make the mean better. Their number may follow
    from the pilot's scatter, and intervals still cover (Stein 1945, doi:10.1214/aoms/1177731088)."""
    paths: int
    """Paths per replicate."""
    total: NDArray[np.int64]
    """Weights of all replicates."""
    piloted: NDArray[np.int64]
    """Weights of the pilot's."""
    squares: UInt128
    """Squares of the pilot's weights, summed."""
    count: NDArray[np.int64]
    """Paths that arrived, (orders, bins)."""
    energy_budget: NDArray[np.int64]
    """Absorbed, truncated, lost: (3, W)."""
    replicates: int = 0
    _locks: list[threading.Lock] = field(default_factory=lambda: [threading.Lock() for _ in range(SLABS)])

    @classmethod
    def empty(cls, pilot: int, paths: int, shape: tuple[int, int, int]) -> Self:
        """No replicates yet, of `paths` each, for sums of `shape`."""
        zeros = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
        return cls(
            pilot, paths, *zeros, UInt128.zeros(shape), np.zeros(shape[:2], np.int64), np.zeros((3, shape[2]), np.int64)
        )

    def add(self, replicates: range, scored: NDArray[np.int64], budget: NDArray[np.int64]) -> None:
        """Add what a group of replicates scored, (orders, bins, replicates, W and the number of paths), and lost.

        Both arrays hold zeros afterwards, ready for the next group.
        """
        pilots = np.array(replicates) < self.pilot
        sums = (self.total, self.piloted, self.squares.high, self.squares.low, self.count)
        edges = [len(self.count[0]) * slab // SLABS for slab in range(SLABS + 1)]
        for slab in range(replicates.start, replicates.start + SLABS):
            # Threads that finish together begin in different slabs.
            slab %= SLABS
            with self._locks[slab]:
                _absorb(scored, pilots, edges[slab], edges[slab + 1], sums)
        with self._locks[0]:
            self.energy_budget += budget.sum(axis=0)
            budget.fill(0)
            self.replicates += len(replicates)

    def merge(self, other: Tally) -> None:
        """Add the tally of other replicates of the same incidence, in place."""
        self.total += other.total
        self.piloted += other.piloted
        self.squares.add(other.squares)
        self.count += other.count
        self.energy_budget += other.energy_budget
        self.replicates += other.replicates

    def squared_deviations(self) -> UInt128:
        """pilot · Σx² - (Σx)² over the pilot's replicates, of the shape of `total`."""
        return self.squares.squared_deviations(self.piloted, self.pilot)


@njit(cache=True, nogil=True)
def _absorb(scored, pilots, first, last, sums):
    total, piloted, high, low, counts = sums
    orders, _, replicates, width = scored.shape
    width -= 1
    whole = np.zeros(width, np.int64)
    for place in range(first, last):
        for replicate in range(replicates):
            count = 0
            for order in range(orders):
                count += scored[order, place, replicate, width]
                counts[order + 1, place] += scored[order, place, replicate, width]
            counts[0, place] += count
            if count == 0:
                continue
            whole[:] = 0
            for order in range(orders - 1, -2, -1):
                if order >= 0 and scored[order, place, replicate, width] == 0:
                    continue
                for w in range(width):
                    value = scored[order, place, replicate, w] if order >= 0 else whole[w]
                    whole[w] += value
                    total[order + 1, place, w] += value
                    if pilots[replicate]:
                        piloted[order + 1, place, w] += value
                        square_high, square_low = _square(value)
                        before = low[order + 1, place, w]
                        low[order + 1, place, w] = before + square_low
                        high[order + 1, place, w] += square_high + uint64(low[order + 1, place, w] < before)
                if order >= 0:
                    scored[order, place, replicate] = 0


@njit(cache=True, nogil=True)
def _square(x):
    """(high, low) of the square of an int64 that is not negative."""
    a, b = uint64(x) >> _HALF, uint64(x) & _LOW
    cross = a * b
    low = b * b
    middle = (low >> _HALF) + ((cross & _LOW) << uint64(1))
    return a * a + ((cross >> _HALF) << uint64(1)) + (middle >> _HALF), (middle << _HALF) | (low & _LOW)


@njit(cache=True, nogil=True)
def _add(high, low, other_high, other_low):
    for i in range(high.size):
        before = low[i]
        low[i] = before + other_low[i]
        high[i] += other_high[i] + uint64(low[i] < before)


@njit(cache=True, nogil=True)
def _add_square(high, low, values):
    for i in range(values.size):
        if values[i] != 0:
            square_high, square_low = _square(values[i])
            before = low[i]
            low[i] = before + square_low
            high[i] += square_high + uint64(low[i] < before)


@njit(cache=True, nogil=True)
def _squared_deviations(result_high, result_low, high, low, total, count):
    factor = uint64(count)
    for i in range(total.size):
        if total[i] == 0:
            continue
        bottom = (low[i] & _LOW) * factor
        middle = (low[i] >> _HALF) * factor + (bottom >> _HALF)
        product_low = (middle << _HALF) | (bottom & _LOW)
        product_high = high[i] * factor + (middle >> _HALF)
        square_high, square_low = _square(total[i])
        result_low[i] = product_low - square_low
        result_high[i] = product_high - square_high - uint64(product_low < square_low)
