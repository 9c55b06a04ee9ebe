"""The two noises of a measurement apart, and what to do against each.

Light is random, so that more paths help; and specimens of one surface differ, so that only more or larger ones help.
With K realisations the scatter between their means holds both, S² = σ²(specimens) + σ²(Monte Carlo), while the scatter
between the replicates within each of them holds the latter alone. The difference is an unbiased estimate of the former,
as in a one-way analysis of variance with random effects.

Source: S. R. Searle, G. Casella, C. E. McCulloch, Variance Components, 1992, section 3.5, doi:10.1002/9780470316856.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gonio.wording import percent

if TYPE_CHECKING:
    import xarray as xr

    from gonio.measurement import Measurement

FEWEST = 10
"""Bins with fewer arrivals are not asked how uncertain they are."""

MORE = 4
"""Advice tells what so many times the work would bring."""


def variances(measurement: Measurement) -> xr.Dataset:
    """The variances of what was measured, each noise apart: those of the mean over all realisations.

    A Dataset with `brdf_monte_carlo`, `brdf_specimens` (sr⁻²), `albedo_monte_carlo` and `albedo_specimens` (1), over
    the dimensions of `brdf` and `albedo`. Their sum is the square of the standard error. The specimens' part is not
    biased, so where there is little of it, it comes out negative half the time: average before you take a root.

    Raises ValueError for fewer than two realisations, which cannot tell the noises apart.
    """
    import xarray as xr

    data = measurement.dataset
    if "realisations" not in data or int(data["realisations"].max()) < 2:
        raise ValueError("one specimen cannot tell its two noises apart: measure with realisations = 4 or more")
    result = {}
    for name, error in (("brdf", "brdf_standard_error"), ("albedo", "albedo_standard_error")):
        result[f"{name}_monte_carlo"] = data[f"{error}_mc"] ** 2
        result[f"{name}_specimens"] = data[error] ** 2 - result[f"{name}_monte_carlo"]
    return xr.Dataset({name: part.assign_attrs(long_name=_LONG_NAMES[name]) for name, part in result.items()})


_PARTS = "monte_carlo", "specimens"

_LONG_NAMES = {
    "brdf_monte_carlo": "variance of brdf: Monte Carlo noise",
    "brdf_specimens": "variance of brdf: specimens differ",
    "albedo_monte_carlo": "variance of albedo: Monte Carlo noise",
    "albedo_specimens": "variance of albedo: specimens differ",
}


@dataclass(frozen=True)
class Noise:
    """Relative standard errors of something measured, as a root mean square."""

    monte_carlo: float
    """Its part that more paths reduce."""
    specimens: float
    """Its part that only more or larger specimens reduce."""

    @property
    def known(self) -> bool:
        """Whether there was light enough to tell."""
        return not math.isnan(self.monte_carlo)

    @property
    def total(self) -> float:
        """Both together."""
        return math.hypot(self.monte_carlo, self.specimens)

    def with_more(self, paths: float = 1.0, specimens: float = 1.0, area: float = 1.0) -> float:
        """The error with so many times the paths a specimen, so many times the specimens, or their area."""
        return math.hypot(self.monte_carlo / math.sqrt(paths), self.specimens / math.sqrt(area)) / math.sqrt(specimens)

    @classmethod
    def together(cls, noises: Sequence[Noise]) -> Noise:
        """The root mean square of those that are known."""
        parts = np.array([(noise.monte_carlo, noise.specimens) for noise in noises if noise.known])
        return cls(*np.sqrt(np.mean(parts**2, axis=0)).tolist()) if parts.size else cls(math.nan, math.nan)


@dataclass(frozen=True)
class Noises:
    """How uncertain a measurement is, and why."""

    bins: Noise
    """Of the detector's bins with a count of ten or more, a mean over the light that they receive."""
    albedo: Noise
    """Of the albedos, a mean over incidences and wavelengths."""
    realisations: int

    @classmethod
    def together(cls, found: Sequence[Noises]) -> Noises:
        """The root mean square of several measurements'."""
        bins, albedo = Noise.together([one.bins for one in found]), Noise.together([one.albedo for one in found])
        return cls(bins, albedo, min(one.realisations for one in found))

    def sentences(self) -> list[str]:
        """How uncertain it is, and what would help, with numbers."""
        if not self.bins.known:
            return [f"No bin has a count of {FEWEST}, too few to tell how uncertain bins are: trace more paths."]
        return [self._told("bins", self.bins), self._told("albedos", self.albedo), self._advice()]

    def _told(self, what: str, noise: Noise) -> str:
        return (
            f"Relative standard error of the {what}: {percent(noise.total)} "
            f"({percent(noise.monte_carlo)} Monte Carlo noise, {percent(noise.specimens)} because specimens differ)."
        )

    def _advice(self) -> str:
        """What helps the bins, and what does not."""
        bins, more = self.bins, MORE * self.realisations
        paths = f"{MORE} times the paths give {percent(bins.with_more(paths=MORE))}"
        larger = f"patches of twice the side {percent(bins.with_more(area=MORE))}"
        if bins.monte_carlo >= bins.specimens:
            return f"More paths help most: for the bins {paths}, {larger}."
        return (
            f"Larger or more specimens help most: for the bins {larger}, realisations = {more} "
            f"{percent(bins.with_more(specimens=MORE))}, but {paths}."
        )


def noises(measurement: Measurement) -> Noises:
    """How uncertain a measurement is, and why. Raises ValueError for fewer than two realisations."""
    parts, data = variances(measurement).sel(order="all"), measurement.dataset.sel(order="all")
    area, value = data["projected_solid_angle"], data["brdf"].where(data["count"] >= FEWEST)
    light, albedo = (value * area).sum(), data["albedo"].where(data["albedo"] > 0)
    # Of relative variances var / f² the mean over the light f cosθ dω.
    bins = [float((parts[f"brdf_{part}"] * area / value).sum() / light) for part in _PARTS]
    whole = [float((parts[f"albedo_{part}"] / albedo**2).mean()) for part in _PARTS]
    return Noises(_rooted(*bins), _rooted(*whole), int(data["realisations"].max()))


def _rooted(monte_carlo: float, specimens: float) -> Noise:
    """Relative errors from their mean squares; what is not there at all may come out negative, and NaN is kept."""
    squares = monte_carlo, specimens
    return Noise(*(square if math.isnan(square) else math.sqrt(max(square, 0.0)) for square in squares))
