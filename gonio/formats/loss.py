"""What a conversion costs: a file, read back, against its source on the source's own incidences and bins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from gonio.formats.lobes import Floats, Lobes
from gonio.sphere import direction

FLOOR = 0.01
"""Bins below this share of the peak of their incidence and channel count for the albedo only."""


@dataclass(frozen=True)
class Loss:
    """How far a file is from what it was filled from; shares, not percent."""

    albedo: float
    """Largest change of a directional albedo over incidences and channels, relative."""
    log_rms: float
    """Root mean square of ln(file / source) over the bins above 1 % of the peak of their incidence and channel."""
    largest: float
    """Largest |file / source - 1| there."""
    where: tuple[float, float, float, float]
    """theta_i, phi_i, theta_o, dphi of that bin, degrees."""
    bins: int
    """How many bins were compared."""
    unknown: int
    """How many of them the file knows nothing of."""
    noise: float
    """Root mean square of the relative standard errors of these bins of the source; NaN if they are not known."""

    @classmethod
    def between(cls, source: Lobes, copy: Lobes) -> Self:
        """Compare averages over the bins of `source`; its channels are turned into those of `copy`."""
        source = source.in_basis(copy.basis)
        measurement = source.measured()
        area = source.detector.projected_solid_angles()[:, None]
        errors = measurement.dataset["standard_error"].sel(order="all")
        places, logs, noise, albedo, unknown = [], [], [], 0.0, 0
        for theta, phi in measurement.incidences():
            wi = direction(theta, phi)
            ours = measurement.average(wi, source.detector)
            theirs = copy.average(wi, source.detector)
            bright = (ours > FLOOR * np.nanmax(ours, axis=0)) & (ours > 0)
            both = np.isfinite(theirs) & np.isfinite(ours)
            unknown += int((bright & ~both).sum())
            change = (np.where(both, theirs - ours, 0.0) * area).sum(axis=0) / _positive((ours * area).sum(axis=0))
            albedo = max(albedo, float(np.abs(change).max()))
            # A bin that is dark in the file is as wrong as one at a tenth of the floor, not infinitely so.
            dark = FLOOR / 10 * np.nanmax(ours, axis=0)
            ratio = np.where(bright & both, np.log(_positive(np.maximum(theirs, dark)) / _positive(ours)), np.nan)
            error = errors.sel(theta_i=theta, phi_i=phi).values.reshape(ours.shape)
            noise.append((error[bright] / ours[bright]) ** 2)
            places.append((theta, phi))
            logs.append(ratio)
        rms = float(np.sqrt(np.concatenate(noise).mean()))
        return cls._of(source, places, np.array(logs), albedo, unknown, rms)

    @classmethod
    def _of(
        cls, source: Lobes, places: list[tuple[float, float]], logs: Floats, albedo: float, unknown: int, noise: float
    ) -> Self:
        """From the logarithms (incidence, bin, channel), NaN where none counts."""
        known = np.isfinite(logs)
        if not known.any():
            return cls(albedo, 0.0, 0.0, (np.nan,) * 4, unknown, unknown, noise)
        change = np.where(known, np.abs(np.expm1(logs)), -1.0)
        incidence, place, _ = np.unravel_index(int(change.argmax()), change.shape)
        ring, sector = divmod(int(place), source.detector.shape[1])
        where = (*places[incidence], float(source.detector.theta[ring]), float(source.detector.dphi[sector]))
        rms = float(np.sqrt(np.mean(logs[known] ** 2)))
        return cls(albedo, rms, float(change.max()), where, int(known.sum()) + unknown, unknown, noise)

    def sentence(self) -> str:
        """All of it in words."""
        place = "theta_i = {:g}, phi_i = {:g}, theta_o = {:g}, dphi = {:g}".format(*self.where)
        text = (
            f"Read back, albedos change by at most {_percent(self.albedo)}, and bins above {FLOOR:.0%} of the peak by "
            f"{_percent(self.log_rms)} (rms), at most {_percent(self.largest)} ({place})."
        )
        if np.isfinite(self.noise):
            text += f" Their own standard errors are {_percent(self.noise)} (rms)."
        if self.unknown:
            text += f" Of {self.unknown / self.bins:.2%} of these bins the file knows nothing."
        return text


def _positive(values: Floats) -> Floats:
    return np.where(values > 0, values, 1.0)


def _percent(share: float) -> str:
    """Two digits of a percentage, whatever its size."""
    return f"{100 * share:.2g} %" if share < 1 else f"{100 * share:.0f} %"
