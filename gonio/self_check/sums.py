"""The exact sums that the self-checks read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.measurement import ENERGY_BUDGET, Measurement
from gonio.tally import UInt128
from microsurfaces.arrays import Floats, Integers


@dataclass(frozen=True)
class ExactSums:
    """The exact sums of the N incidences that were measured."""

    theta: Floats
    """(N,) degrees."""
    phi: Floats
    """(N,) degrees."""
    wavelengths: Floats
    """(W,) nm."""
    weight: Integers
    """(N, orders, bins, W): all orders first, the hemisphere last."""
    count: Integers
    """(N, orders, bins)."""
    squares: UInt128
    """Squares of `weight`, summed over realisations."""
    energy_budget: dict[str, Integers]
    """What was launched and how it ended, each (N, W)."""
    paths: Integers
    """(N,)."""
    realisations: Integers
    """(N,)."""
    incidences: int
    """How many incidences were asked for."""

    @classmethod
    def of(cls, measurement: Measurement) -> ExactSums:
        """Those of `measurement`; ValueError if there are none."""
        sums = measurement.counted
        at = np.nonzero(sums["paths"].values)
        if not at[0].size:
            raise ValueError("The measurement holds no measured incidence to check: run it again to the end.")
        names = ("weight", "count", "energy_budget", "paths", "realisations")
        weight, count, budget, paths, realisations = (sums[name].values[at] for name in names)
        high, low = (sums[f"realisation_squares_{half}"].values[at] for half in ("high", "low"))
        return cls(
            sums["theta_i"].values[at[0]],
            sums["phi_i"].values[at[1]],
            sums["wavelength"].values,
            weight,
            count,
            UInt128(high, low),
            {termination: budget[:, k] for k, termination in enumerate(ENERGY_BUDGET)},
            paths,
            realisations,
            sums["paths"].size,
        )

    def worst(self, values: NDArray[Any]) -> str:
        """The incidence and wavelength at which `values` (N, W) are largest."""
        n, w = divmod(int(values.argmax()), len(self.wavelengths))
        return f"theta_i {self.theta[n]:g}, phi_i {self.phi[n]:g}, {self.wavelengths[w]:g} nm"

    @property
    def reflected(self) -> Integers:
        """What left, of every order, (N, orders, W)."""
        return self.weight[:, :, -1]
