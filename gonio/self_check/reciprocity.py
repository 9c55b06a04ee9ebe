"""Whether source and detector can be exchanged: Helmholtz reciprocity of cones that were measured both ways round."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gonio.comparison import ENOUGH_COUNT
from gonio.detectors import Apertures
from gonio.measurement import Measurement
from gonio.self_check.report import Check, not_applicable, outcome
from gonio.self_check.significance import sidak_level
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    import xarray as xr


Place = tuple[int, int, int]
"""Indices of what an aperture saw: theta_i, phi_i, detector."""


def exchanged_cones(measurement: Measurement, data: xr.Dataset) -> Check:
    """Cone A lit and cone B seen is cone B lit and cone A seen, by Student's t of the Monte Carlo noise.

    Both were measured on the same specimens, so how these differ drops out.
    """
    from scipy.special import stdtr

    pairs = [pair for pair in _pairs(measurement) if _comparable(pair, data)]
    if not pairs:
        why = (
            "no reciprocal pair was measured: it takes Apertures and a beam_half_angle equal to their half_angle, two "
            f"directions that were both lit and seen, and counts of at least {ENOUGH_COUNT}."
        )
        return not_applicable("reciprocity", why)
    there, back = (_Seen.at(data, places) for places in zip(*pairs, strict=True))
    score, freedom = there.difference(back)
    p_value = 2 * stdtr(freedom, -np.abs(score))
    level, worst = sidak_level(p_value.size), np.unravel_index(p_value.argmin(), p_value.shape)
    found = (
        f"the worst of {p_value.size} pairs (two cones, a wavelength) measured both ways round is "
        f"{there.value[worst]:.4g} and {back.value[worst]:.4g} 1/sr, {abs(score[worst]):.2g} standard errors apart "
        f"(p = {p_value[worst]:.2g}, limit {level:.2g})"
    )
    advice = "light and detector cannot be exchanged, so the sums were changed or light is lost; measure again"
    numbers = {"pairs": float(p_value.size), "t": float(score[worst]), "p_value": float(p_value[worst]), "limit": level}
    return outcome("reciprocity", bool(p_value[worst] >= level), found, advice, numbers)


class _Seen(NamedTuple):
    """What some apertures saw, (pairs, W), or (pairs, 1) where wavelengths do not matter."""

    value: Floats
    """1/sr."""
    error: Floats
    """Monte Carlo standard error."""
    path: Floats
    """What a path adds, the mean over those that arrived."""
    freedom: Floats
    """Degrees of freedom of the error."""

    @classmethod
    def at(cls, data: xr.Dataset, places: tuple[Place, ...]) -> _Seen:
        """The apertures at these places."""
        row, column, aperture = np.array(places).T
        value, error, count = (
            data[name].sel(order="all").values[row, column, aperture]
            for name in ("brdf", "brdf_standard_error_mc", "count")
        )
        freedom = data["degrees_of_freedom_mc"].values[row, column].astype(np.float64)
        return cls(value, error, value / count[:, None], freedom[:, None])

    def difference(self, other: _Seen) -> tuple[Floats, Floats]:
        """Student's t and its degrees of freedom (Welch), each (pairs, W).

        At the rim of a cone rounding (directions are float32) decides what is seen, a path at the least.
        """
        variance = self.error**2 + other.error**2
        fourth = self.error**4 / self.freedom + other.error**4 / other.freedom
        welch = np.where(fourth > 0, variance**2 / np.where(fourth > 0, fourth, 1.0), self.freedom)
        rim = self.path**2 + other.path**2 + (1e-6 * self.value) ** 2
        return (self.value - other.value) / np.sqrt(variance + rim), welch


def _pairs(measurement: Measurement) -> Iterator[tuple[Place, Place]]:
    """Every pair of equal cones that was measured both ways round, at two incidences."""
    detector, goniometer = measurement.detector, json.loads(measurement.attributes["goniometer"])
    beam, average = goniometer["beam_half_angle"], goniometer["azimuth"] == "average"
    if not isinstance(detector, Apertures) or beam <= 0 or abs(detector.half_angle - beam) > 1e-9:
        return
    known: dict[tuple[float, ...], Place] = {}
    paths = measurement.counted["paths"]
    for i, j in zip(*(index.tolist() for index in np.nonzero(paths.values)), strict=True):
        lit = float(paths["theta_i"][i]), float(paths["phi_i"][j])
        for k, seen in enumerate(detector.directions):
            reverse = known.get(_arrangement(seen, lit, average))
            if reverse is not None and reverse[:2] != (i, j):
                yield reverse, (i, j, k)
            known.setdefault(_arrangement(lit, seen, average), (i, j, k))


def _arrangement(lit: tuple[float, float], seen: tuple[float, float], average: bool) -> tuple[float, ...]:
    """A key for the cones about two directions (theta, phi): equal keys, equal BRDF.

    Where the surface was turned by all angles only the difference of the azimuths counts; at the pole there is none.
    """
    polar, azimuths = [round(w[0], 6) for w in (lit, seen)], [w[1] if w[0] > 1e-6 else 0.0 for w in (lit, seen)]
    if average:
        azimuths = [azimuths[1] - azimuths[0]] if min(polar) > 0 else [0.0]
    return (*polar, *(round(azimuth % 360, 6) % 360 for azimuth in azimuths))


def _comparable(pair: tuple[Place, Place], data: xr.Dataset) -> bool:
    """Whether the same specimens were measured both ways, with enough counts."""
    count, realisations = data["count"].sel(order="all").values, data["realisations"].values
    (*there, _), (*back, _) = pair
    return bool(
        realisations[tuple(there)] == realisations[tuple(back)] and min(count[place] for place in pair) >= ENOUGH_COUNT
    )
