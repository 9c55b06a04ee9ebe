"""Neighbouring bins joined until they have enough arrivals, and how sure the errors of these pools are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.comparison.incidence import SURE, Incidence
from gonio.comparison.prediction import Prediction
from gonio.models.averages import TOLERANCE
from microsurfaces.arrays import Floats

ENOUGH_COUNT = 10
"""Bins with fewer arrivals are pooled with their neighbours before anything is said about a bin."""


class Pools:
    """Neighbouring bins joined until they have enough arrivals: energies (pools, W), and what is uncertain of them."""

    def __init__(self, measured: Incidence, prediction: Prediction, solid: Floats) -> None:
        power = solid[:, None]
        self.first = first_bins(measured.count, measured.brdf * power, (measured.error * power) ** 2)
        self.size = np.diff(np.append(self.first, solid.size))
        self.measured = self._sum(measured.brdf * power)
        self.model = self._sum(prediction.brdf * power)
        numerical = (TOLERANCE * self.model) ** 2 + self._sum((prediction.random * power) ** 2)
        variance = self._sum((measured.error * power) ** 2)
        variance_mc = self._sum((measured.error_mc * power) ** 2)
        self.error = np.sqrt(variance + numerical)
        self.error_mc = np.sqrt(np.minimum(variance, variance_mc) + numerical)
        count = np.zeros((solid.size, 1), np.int64) if measured.count is None else self._sum(measured.count)[:, None]
        fourth, fourth_mc = (self._sum((error * power) ** 4) for error in (measured.error, measured.error_mc))
        # What is known of the model, without degrees of freedom, makes the sum of both the better known.
        surer, surer_mc = (in_units(v + numerical, v) ** 2 for v in (variance, variance_mc))
        self.freedom = _at_most(self._freedom(variance, fourth, count, measured.freedom) * surer)
        self.freedom_mc = _at_most(self._freedom(variance_mc, fourth_mc, count, measured.freedom_mc) * surer_mc)

    def _sum(self, values: NDArray[Any]) -> NDArray[Any]:
        return np.add.reduceat(values, self.first)

    def _freedom(self, variance: Floats, fourth: Floats, count: NDArray[np.int64], freedom: float) -> Floats:
        """Degrees of freedom of the variance of a pool, its bins taken as independent (Welch and Satterthwaite).

        A count of n knows its own variance no better than 2 n degrees of freedom do.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            welch = np.where(fourth > 0.0, freedom * variance**2 / fourth, freedom)
        return np.where(self.size[:, None] == 1, freedom, np.minimum(welch, np.maximum(2 * count, freedom)))

    def significance(self) -> Floats:
        """(measured - model) in standard errors, (pools, W)."""
        return in_units(self.measured - self.model, self.error)

    def area(self, solid: Floats) -> Floats:
        """Projected solid angles of the pools (pools, 1), from those of the bins (bins,), sr."""
        return np.asarray(self._sum(solid)[:, None])

    def spread(self, values: Floats) -> Floats:
        """What is known of pools (pools, W) for each of their bins (bins, W)."""
        return np.repeat(values, self.size, axis=0)


def first_bins(count: NDArray[np.int64] | None, energy: Floats, variance: Floats) -> NDArray[np.intp]:
    """Where each pool of consecutive bins starts: a pool ends with the bin that gives it enough arrivals.

    Where nobody kept the `count` of arrivals every bin is a pool.

    They must be worth as many independent ones: where specimens differ, arrivals come in clusters from the few that
    have a facet of the right tilt, and energy^2 / variance (bins, W) counts these. Bins that remain at the end join the
    last pool, so that every bin, and all of the energy, is in one pool.
    """
    if count is None:
        return np.arange(len(energy))
    starts, filled, clusters = [0], 0, np.zeros((2, energy.shape[1]))
    for index, arrivals in enumerate(count.tolist()):
        if filled >= ENOUGH_COUNT and (clusters[0] ** 2 >= ENOUGH_COUNT * clusters[1]).all():
            starts.append(index)
            filled, clusters = 0, np.zeros_like(clusters)
        filled += arrivals
        clusters += energy[index], variance[index]
    enough = filled >= ENOUGH_COUNT and (clusters[0] ** 2 >= ENOUGH_COUNT * clusters[1]).all()
    return np.asarray(starts if enough or len(starts) == 1 else starts[:-1], np.intp)


def _at_most(freedom: Floats) -> Floats:
    """Degrees of freedom with which nothing is left to know, in place of more or of none."""
    return np.clip(np.where(freedom > 0.0, freedom, np.inf), None, SURE)


def in_units(value: Floats, unit: Floats) -> Floats:
    """`value` in units of `unit`; 0 where both are 0, infinite where only the unit is, NaN where it is not known."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((value == 0.0) & ~np.isnan(unit), 0.0, value / unit)
