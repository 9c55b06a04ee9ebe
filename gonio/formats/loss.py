"""What a conversion costs: a file, read back, against its source on the source's own incidences and bins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from gonio.brdf import BRDF
from gonio.sphere import direction
from gonio.wording import percent
from microsurfaces.arrays import Floats

RELATIVE_THRESHOLD = 0.01
"""Bins below this share of the peak of their incidence and channel count for the albedo only."""


@dataclass(frozen=True)
class Loss:
    """How far a file is from what it was filled from; shares, not percent."""

    albedo: float
    """Largest change of a directional albedo over incidences and channels, relative."""
    log_rms: float
    """Root mean square of ln(file / source), weighted with projected solid angle, over bins above 1 % of the peak of
    their incidence and channel."""
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
    def between(cls, source: BRDF, copy: BRDF) -> Self:
        """Compare averages over the bins of `source`; its channels are turned into those of `copy`."""
        source = source.in_basis(copy.basis)
        measurement = source.measured()
        places = list(measurement.incidences())
        incidences = [direction(theta, phi) for theta, phi in places]
        ours, theirs = (np.stack([brdf.average(wi, source.detector) for wi in incidences]) for brdf in (source, copy))
        errors = measurement.dataset["brdf_standard_error"].sel(order="all")
        error = np.stack([errors.sel(theta_i=theta, phi_i=phi).values for theta, phi in places]).reshape(ours.shape)
        area = source.detector.projected_solid_angles()[:, None]

        both = np.isfinite(ours) & np.isfinite(theirs)
        ours, known = np.nan_to_num(ours), np.where(both, theirs, 0.0)
        change = ((known - np.where(both, ours, 0.0)) * area).sum(axis=1) / _positive((ours * area).sum(axis=1))
        threshold = RELATIVE_THRESHOLD * ours.max(axis=1, keepdims=True)
        bright = (ours > threshold) & (ours > 0)
        counts = np.where(bright & both, area, 0.0)
        # A bin that is dark in the file is as wrong as one at a tenth of the threshold, not infinitely so.
        logs = np.log(_positive(np.maximum(known, threshold / 10)) / _positive(ours))
        off = np.where(counts > 0, np.abs(np.expm1(logs)), 0.0)
        incidence, place, _ = np.unravel_index(int(off.argmax()), off.shape)
        ring, sector = divmod(int(place), source.detector.shape[1])
        return cls(
            albedo=float(np.abs(change).max()),
            log_rms=_rms(logs, counts),
            largest=float(off.max()),
            where=(*places[incidence], float(source.detector.theta[ring]), float(source.detector.dphi[sector])),
            bins=int(bright.sum()),
            unknown=int((bright & ~both).sum()),
            noise=_rms(error / _positive(ours), counts),
        )

    def sentence(self) -> str:
        """All of it in words."""
        place = "theta_i = {:g}, phi_i = {:g}, theta_o = {:g}, dphi = {:g}".format(*self.where)
        text = (
            f"Read back, albedos change by at most {percent(self.albedo)}, and bins above {RELATIVE_THRESHOLD:.0%} of "
            f"the peak by {percent(self.log_rms)} (rms)"
            + (f", at most {percent(self.largest)} ({place})." if self.largest else ".")
        )
        if np.isfinite(self.noise):
            text += f" Their own standard errors are {percent(self.noise)} (rms)."
        if self.unknown:
            text += f" Of {self.unknown / self.bins:.2%} of these bins the file knows nothing."
        return text


def _rms(values: Floats, weights: Floats) -> float:
    """Root of the weighted mean square; 0 where nothing has weight."""
    with np.errstate(invalid="ignore"):
        squares = np.where(weights > 0, values, 0.0) ** 2
    return float(np.sqrt((weights * squares).sum() / max(weights.sum(), 1e-300)))


def _positive(values: Floats) -> Floats:
    return np.where(values > 0, values, 1.0)
