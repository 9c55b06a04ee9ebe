"""The self-check of a measurement, recomputed from its exact sums; its report goes with every result.

A check has failed where physics or bookkeeping is wrong: do not use the numbers. It warns where the settings limit what
may be concluded from them. Exact integers are held to exact equality; what is random is judged at one level a check,
shared (Sidak) between all that the check looks at, so that a sound instrument practically never fails.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from gonio.detectors import HemisphereGrid
from gonio.measurement import Measurement
from gonio.netcdf import load
from gonio.self_check import bookkeeping, energy, reciprocity, sampling, surface, wave_optics
from gonio.self_check.report import Check, SelfCheckReport
from gonio.self_check.sums import ExactSums

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Check", "SelfCheckReport", "check", "check_file"]


def check(measurement: Measurement, stored: xr.Dataset | None = None) -> SelfCheckReport:
    """Check `measurement`; `stored` are the labelled values that go with it, `measurement.dataset` if left out.

    Raises ValueError if no incidence was measured, or if the measurement is external.
    """
    sums = ExactSums.of(measurement)
    fresh = replace(measurement).dataset
    return SelfCheckReport(
        (
            bookkeeping.energy_budget(sums),
            bookkeeping.orders(sums, isinstance(measurement.detector, HemisphereGrid)),
            bookkeeping.labelled_values(fresh, measurement.dataset if stored is None else stored),
            energy.albedo(sums),
            energy.furnace(measurement, sums),
            energy.lost_light(sums),
            reciprocity.exchanged_cones(measurement, fresh),
            surface.normals(measurement, sums),
            surface.resolution(measurement),
            sampling.replicates(measurement),
            sampling.realisations(measurement, sums),
            sampling.completeness(measurement, sums),
            sampling.sparse_bins(sums),
            wave_optics.polarisation(measurement, sums),
            wave_optics.geometric_optics(measurement, sums),
        )
    )


def check_file(path: str | Path) -> SelfCheckReport:
    """Check the measurement in a netCDF file, its labelled values against its exact sums as well.

    Raises ValueError in one sentence for a file that holds no measurement, or an external one.
    """
    import xarray as xr

    try:
        measurement = load(path)
        if measurement.sums is None:
            raise ValueError(
                f"{path} comes from another program, without the sums that gonio counts: there is nothing to check"
            )
        with xr.open_dataset(path, engine="h5netcdf") as stored:
            return check(measurement, stored.load())
    except (LookupError, TypeError, AttributeError, ValidationError, json.JSONDecodeError) as error:
        what = " ".join(str(error).split())
        raise ValueError(f"{path}: not a measurement that gonio wrote, or it is damaged ({what})") from None
