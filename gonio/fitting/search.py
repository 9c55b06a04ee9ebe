"""Where the deviance is least: nonlinear least squares of its roots, within limits, from the best of a few starts."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from microsurfaces.arrays import Floats

_STEP = 0.01
"""Relative step of derivatives: far above the accuracy of bin averages, and of what a random walk's seed decides."""

_EDGE = 1e-3
"""Share of the way between its limits within which a parameter counts as pressed against one."""

_SCAN = 5
"""Values tried of every parameter before the search, to start it in the right valley."""

_DISTANCES = np.array([0.3, 0.8, 1.2, 1.5, 1.8, 2.1, 3.0, 5.0])
"""Distances of cylinders to start from: below 2, where they have no flat strips between them, they matter most."""


class Solution(NamedTuple):
    """Where a search ended."""

    values: Floats
    """(k,)"""
    roots: Floats
    """(n,)"""
    jacobian: Floats
    """Of the roots, by the values: (n, k)."""
    at_bound: NDArray[np.bool_]
    """(k,)"""


def search(names: Sequence[str], roots: Callable[[Floats], Floats], start: Floats, limits: Floats) -> Solution:
    """Least squares from the best of a few starts, within limits."""
    from scipy.optimize import least_squares

    best = min(_trials(names, start, limits, roots), key=lambda trial: float((roots(trial) ** 2).sum()))
    ruler = _Ruler(limits)
    solution = least_squares(
        lambda marks: roots(ruler.values(marks)),
        # The search starts inside the limits, where derivatives have two sides.
        np.clip(ruler.marks(best), 1.0 + _EDGE, 2.0 - _EDGE),
        jac="3-point",
        bounds=(1.0, 2.0),
        diff_step=ruler.step,
        x_scale="jac",
        xtol=1e-8,
        ftol=1e-10,
    )
    values = ruler.values(solution.x)
    return Solution(
        np.where(np.abs(values) > 1e-12, values, 0.0),
        solution.fun,
        solution.jac / ruler.slopes(solution.x),
        (solution.x < 1.0 + 2 * _EDGE) | (solution.x > 2.0 - 2 * _EDGE),
    )


class _Ruler:
    """Parameters on scales from 1 to 2, logarithmic between limits that are both positive."""

    def __init__(self, limits: Floats) -> None:
        self._logarithmic = limits[:, 0] > 0.0
        self._low, high = self._line(limits.T)
        self._length = high - self._low
        steps = np.where(self._logarithmic, _STEP, _STEP * self._length)
        self.step = steps / self._length / 1.5
        """Steps of derivatives, relative to a mark."""

    def _line(self, values: Floats) -> Floats:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self._logarithmic, np.log(values), values)

    def marks(self, values: Floats) -> Floats:
        """Where values are."""
        return np.asarray(1.0 + (self._line(values) - self._low) / self._length)

    def values(self, marks: Floats) -> Floats:
        """What is there."""
        line = self._low + (np.asarray(marks) - 1.0) * self._length
        return np.asarray(np.where(self._logarithmic, np.exp(line), line))

    def slopes(self, marks: Floats) -> Floats:
        """How fast values change with marks."""
        return np.asarray(self._length * np.where(self._logarithmic, self.values(marks), 1.0))


def _trials(names: Sequence[str], start: Floats, limits: Floats, roots: Callable[[Floats], Floats]) -> list[Floats]:
    """Where a search may start: the given place, or one of a grid over all parameters while that is small."""
    places = [_places(name, low, high) for name, (low, high) in zip(names, limits, strict=True)]
    if len(start) <= 2:
        return [start, *map(np.array, itertools.product(*places))]
    best = start
    for _ in range(2):
        for index, values in enumerate(places):
            moved = [np.where(np.arange(len(start)) == index, value, best) for value in values]
            best = min([best, *moved], key=lambda trial: float((roots(trial) ** 2).sum()))
    return [best]


def _places(name: str, low: float, high: float) -> Floats:
    """Values between two limits, evenly in the logarithm where the limits are positive."""
    if name == "distance":
        return _DISTANCES[(low <= _DISTANCES) & (high >= _DISTANCES)]
    share = (np.arange(_SCAN) + 0.5) / _SCAN
    return np.asarray(low * (high / low) ** share if low > 0.0 else low + (high - low) * share)
