"""Exact sums: weights are integers (2³² to a path), and so are the sums of their squares, 128 bits wide.

Integer sums do not care for the order in which threads, replicates or shards are added, so results are the same bytes
always and a variance that is zero is exactly zero.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, uint64
from numpy.typing import NDArray

UNIT = 1 << 32
"""The integer weight of one whole path."""

MAX_PATHS = (1 << 31) - 1
"""More launched paths than this would overflow the 64-bit sums."""

_LOW = uint64(0xFFFFFFFF)
_HALF = uint64(32)


class Wide(NamedTuple):
    """Unsigned 128-bit integers: `high` · 2⁶⁴ + `low`, two uint64 arrays of one shape."""

    high: NDArray[np.uint64]
    low: NDArray[np.uint64]

    @classmethod
    def zeros(cls, shape: tuple[int, ...]) -> Wide:
        """Zeros of `shape`."""
        return cls(np.zeros(shape, np.uint64), np.zeros(shape, np.uint64))

    def add(self, other: Wide) -> None:
        """Add `other` in place."""
        _add(self.high.ravel(), self.low.ravel(), other.high.ravel(), other.low.ravel())

    def add_square(self, values: NDArray[np.int64]) -> None:
        """Add the squares of `values` in place."""
        _add_square(self.high.ravel(), self.low.ravel(), np.ascontiguousarray(values).ravel())

    def scatter(self, total: NDArray[np.int64], count: int) -> Wide:
        """count · Σx² - (Σx)², where this is Σx² and `total` is Σx of `count` values: count² times their variance."""
        result = Wide.zeros(self.high.shape)
        _scatter(
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


@njit(cache=True, nogil=True)
def _square(x):  # type: ignore[no-untyped-def]
    """(high, low) of the square of an int64 that is not negative."""
    a, b = uint64(x) >> _HALF, uint64(x) & _LOW
    cross = a * b
    low = b * b
    middle = (low >> _HALF) + ((cross & _LOW) << uint64(1))
    return a * a + ((cross >> _HALF) << uint64(1)) + (middle >> _HALF), (middle << _HALF) | (low & _LOW)


@njit(cache=True, nogil=True)
def _add(high, low, other_high, other_low):  # type: ignore[no-untyped-def]
    for i in range(high.size):
        before = low[i]
        low[i] = before + other_low[i]
        high[i] += other_high[i] + uint64(low[i] < before)


@njit(cache=True, nogil=True)
def _add_square(high, low, values):  # type: ignore[no-untyped-def]
    for i in range(values.size):
        if values[i] != 0:
            square_high, square_low = _square(values[i])
            before = low[i]
            low[i] = before + square_low
            high[i] += square_high + uint64(low[i] < before)


@njit(cache=True, nogil=True)
def _scatter(result_high, result_low, high, low, total, count):  # type: ignore[no-untyped-def]
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
