"""What was measured at one incidence, in one order of scattering."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    import xarray as xr

SURE = 1e6
"""Degrees of freedom with which nothing is left to know of a standard error."""


@dataclass(frozen=True, eq=False)
class Incidence:
    """What was measured at one incidence: bins flattened in theta_o, dphi order."""

    brdf: Floats
    """(bins, W) in 1/sr"""
    error: Floats
    """(bins, W), standard errors"""
    error_mc: Floats
    """(bins, W), their Monte Carlo part"""
    albedo: Floats
    """(W,)"""
    albedo_error: Floats
    """(W,)"""
    albedo_error_mc: Floats
    """(W,)"""
    count: NDArray[np.int64] | None
    """(bins,): arrivals; None if nobody counted."""
    freedom: float
    """Degrees of freedom of the errors; `SURE` if they are taken as they are."""
    freedom_mc: float
    """Degrees of freedom of their Monte Carlo part."""

    @classmethod
    def of(cls, data: xr.Dataset) -> Incidence:
        """One incidence and order of a measurement's dataset."""
        brdf, error, error_mc = (
            data[name].transpose(..., "wavelength").values.reshape(-1, data.sizes["wavelength"])
            for name in ("brdf", "brdf_standard_error", "brdf_standard_error_mc")
        )
        albedo, albedo_error, albedo_error_mc = (
            data[f"albedo{suffix}"].values for suffix in ("", "_standard_error", "_standard_error_mc")
        )
        count, freedom, freedom_mc = None, SURE, SURE
        if "count" in data:
            count = data["count"].values.ravel()
            freedom, freedom_mc = (float(data[name]) for name in ("degrees_of_freedom", "degrees_of_freedom_mc"))
        return cls(brdf, error, error_mc, albedo, albedo_error, albedo_error_mc, count, freedom, freedom_mc)

    def among(self, bins: NDArray[np.bool_], w: slice) -> Incidence:
        """Some of the bins at some wavelengths; the albedo is that of all bins that are known."""
        return replace(
            self,
            brdf=self.brdf[bins, w],
            error=self.error[bins, w],
            error_mc=self.error_mc[bins, w],
            albedo=self.albedo[w],
            albedo_error=self.albedo_error[w],
            albedo_error_mc=self.albedo_error_mc[w],
            count=None if self.count is None else self.count[bins],
        )
