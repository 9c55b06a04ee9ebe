"""A model's parameters as a measurement has them, in numbers and in sentences."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from gonio.models import Model
from microsurfaces.arrays import Floats

CORRELATED = 0.95
"""Parameters more correlated than this cannot be told apart by this measurement."""


@dataclass(frozen=True)
class Parameter:
    """One fitted number."""

    name: str
    """Dotted name of the model's parameter."""
    value: float
    standard_error: float
    """Noise and lack of fit together."""
    noise: float
    """Standard error from the measurement's noise alone; NaN if it is external and gives no errors."""
    lack_of_fit: float
    """Standard error from the model's not being the truth: how differently parts of the lobes would have it."""
    interval: tuple[float, float]
    """95 % confidence interval."""
    facets: float | None
    """The same number as the specimens' facets have it, where it is a roughness that was measured on them."""
    at_bound: bool
    """Whether the fit pressed it against a limit: its interval then means nothing."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A model's parameters as a measurement has them."""

    model: Model
    """The model with the fitted values."""
    parameters: tuple[Parameter, ...]
    correlation: Floats
    """Correlations between the parameters (k, k), noise and lack of fit together."""
    order: str
    """The order of scattering that was fitted."""
    deviance: float
    """In units of what a count carries, summed over all bins."""
    deviance_of_noise: float
    """What the measurement's standard errors lead one to expect of it; NaN if it has none."""
    parts: Floats
    """The deviance of every block of 3 x 3 bins and every incidence, all wavelengths together."""
    bins: int
    """How many numbers were fitted: bins x incidences x wavelengths."""
    l1: float
    """The residual: sum of |measured - model| over sum of model, over all bins."""
    normal_reflectance: tuple[tuple[float, float, float], ...]
    """(wavelength, F0, standard error): Fresnel reflectance at normal incidence, where the material was fitted."""
    incidences: tuple[tuple[float, float], ...]
    """(theta_i, phi_i) of what was fitted, degrees."""
    wavelengths: tuple[float, ...]
    """nm."""
    channels: tuple[str, ...]
    """What the values at these wavelengths are called: "550 nm", "R" ..."""
    left_out: int
    """How many bins of the fitted incidences took no part, because nothing is known of them."""

    @property
    def dispersion(self) -> float:
        """Variance about the model over that of the noise: 1 if nothing but noise is left; NaN without errors."""
        if math.isnan(self.deviance_of_noise):
            return math.nan
        return (
            self.deviance / max(self.deviance_of_noise, 1e-300) * self.bins / max(1, self.bins - len(self.parameters))
        )

    def sentences(self) -> list[str]:
        """The fit in plain sentences."""
        return [*map(_of_parameter, self.parameters), *self.remarks()]

    def remarks(self) -> list[str]:
        """What there is to say besides the numbers: reflectance, the residual, and warnings."""
        return [*self._reflectances(), self._quality(), *self._reservations(), *self.warnings()]

    def warnings(self) -> list[str]:
        """What should keep one from believing the numbers."""
        found = [
            f"{p.name} = {p.value:.4g} stands at its limit: the model cannot describe this measurement better, and the "
            "interval means nothing; fix it, or free another parameter."
            for p in self.parameters
            if p.at_bound
        ]
        for (i, one), (j, other) in itertools.combinations(enumerate(self.parameters), 2):
            if abs(self.correlation[i, j]) > CORRELATED:
                found.append(
                    f"{one.name} and {other.name} have a correlation of {self.correlation[i, j]:.3f}: this measurement "
                    "hardly tells them apart; fix one of them, or measure more incidences."
                )
        return found

    def _reflectances(self) -> list[str]:
        return [
            f"F0 = {value:.4f} ± {error:.4f} at {channel} (reflectance at normal incidence)."
            for channel, (_, value, error) in zip(self.channels, self.normal_reflectance, strict=False)
        ]

    def _quality(self) -> str:
        if math.isnan(self.dispersion):
            return f"The residual is {self.l1:.2%} of the light (L1), over {self.bins} bins."
        consistent = self.dispersion < 1.0 + 4.0 * np.sqrt(2.0 / self.bins)
        outcome = "consistent with noise" if consistent else "significant beyond noise"
        return (
            f"The residual is {outcome}: {self.l1:.2%} of the light (L1), {self.dispersion:.3g} times the variance "
            f"of the noise, over {self.bins} bins."
        )

    def _reservations(self) -> list[str]:
        """What an external measurement does not tell."""
        found = []
        if math.isnan(self.deviance_of_noise):
            found.append(
                "The errors of the measurement, or of some of its bins, are not known: intervals speak of lack of fit "
                "only, of how differently parts of the lobes would have the parameters."
            )
        if self.order != self.model.order:
            found.append(
                "The measurement does not keep apart how often light has hit the surface: "
                f"{type(self.model).__name__}, which speaks of the light of one hit, was fitted to all of it."
            )
        if self.left_out:
            found.append(
                f"{self.left_out} bins took no part: nothing is known of them, or of what they are joined with."
            )
        return found


def _of_parameter(p: Parameter) -> str:
    digits = 4 if not p.standard_error > 0.0 else max(4, int(np.ceil(-np.log10(p.standard_error))) + 1)
    noise = "" if math.isnan(p.noise) else f"noise {p.noise:.2g}, "
    sentence = (
        f"{p.name} = {p.value:.{digits}f} ± {p.standard_error:.{digits}f} "
        f"({noise}lack of fit {p.lack_of_fit:.2g}), "
        f"95 % between {p.interval[0]:.{digits}f} and {p.interval[1]:.{digits}f}"
    )
    if p.facets:
        sentence += f"; the facets have {p.facets:.{digits}f}, it is {p.value / p.facets - 1:+.1%} away"
    return sentence + "."
