"""What a model says of one incidence: bin averages and albedo. Nothing else here asks a model for numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.brdf import BRDF
from gonio.detectors import Detector, HemisphereGrid
from gonio.measurement import Measurement
from gonio.models import Model
from gonio.models.averages import TOLERANCE, Estimate, RandomWalk
from microsurfaces.arrays import Floats, Vectors

_FINE = HemisphereGrid(theta_step=2.0, phi_step=3.0)
"""Where a model's albedo is summed if the detector does not cover the hemisphere."""


class Prediction(NamedTuple):
    """What a model says of one incidence."""

    brdf: Floats
    """(bins, W) in 1/sr"""
    random: Floats
    """(bins, W), standard errors of a model that is a random walk; 0 for all others."""
    albedo: Floats
    """(W,)"""
    albedo_error: Floats
    """(W,), numerical and random."""

    @classmethod
    def of(cls, model: Model | BRDF, wi: Vectors, detector: Detector, wavelengths: Floats) -> Prediction:
        """Bins and hemisphere."""
        brdf, random = predicted(model, wi, detector, wavelengths)
        if isinstance(model, RandomWalk):
            albedo, error = model.albedo(wi, wavelengths, orders=1)
            return cls(brdf, random, albedo[0], error[0])
        covers = isinstance(detector, HemisphereGrid)
        solid = (detector if covers else _FINE).projected_solid_angles()
        whole = Estimate(brdf, random) if covers else predicted(model, wi, _FINE, wavelengths)
        albedo = solid @ whole.value
        return cls(brdf, random, albedo, _error_of(albedo, solid, whole.standard_error))

    def among(self, bins: NDArray[np.bool_], w: slice, solid: Floats) -> Prediction:
        """Some of the bins, of projected solid angles `solid`, at some wavelengths, and their part of the albedo."""
        brdf, random = self.brdf[bins, w], self.random[bins, w]
        albedo = solid @ brdf
        return Prediction(brdf, random, albedo, _error_of(albedo, solid, random))


def _error_of(albedo: Floats, solid: Floats, random: Floats) -> Floats:
    """Standard error (W,) of an albedo that is summed over bins of these projected solid angles and errors."""
    return np.asarray(np.hypot(TOLERANCE * albedo, np.sqrt(solid**2 @ random**2)))


def predicted(model: Model | BRDF, wi: Vectors, detector: Detector, wavelengths: Floats) -> Estimate:
    """Bin averages (bins, W) of `model` in 1/sr with their random standard errors, 0 for models that have none."""
    if isinstance(model, BRDF):
        columns = model.columns(wavelengths)
        return Estimate(model.average(wi, detector)[:, columns], model.standard_error(wi, detector)[:, columns])
    if isinstance(model, RandomWalk):
        value, error = model.estimate(wi, detector, wavelengths, orders=1)
        return Estimate(value[0], error[0])
    average = model.average(wi, detector, wavelengths)
    return Estimate(average, np.zeros_like(average))


def order_of(measurement: Measurement, model: Model | BRDF) -> str:
    """The order of scattering that `model` is held against: its own, or "all" where orders were not kept apart.

    Raises ValueError if other orders were kept apart than the model's.
    """
    known = [str(order) for order in measurement.dataset["order"].values]
    if known == ["all"]:
        return "all"
    if model.order not in known:
        raise ValueError(f"the measurement has no order {model.order!r}, only {', '.join(known)}.")
    return model.order
