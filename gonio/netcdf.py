"""Measurements as netCDF-4 files: the labelled dataset, and the exact integers it comes from in the group `sums`."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.detectors import DETECTOR, HemisphereGrid
from gonio.measurement import Measurement, tabulated
from microsurfaces.atomic_write import atomic_write

if TYPE_CHECKING:
    import xarray as xr

FORMAT_VERSION = 1
"""Of the file: the names and units of what it holds. Another one is refused in a sentence."""


def save(measurement: Measurement, path: str | Path) -> Path:
    """Write a measurement as netCDF-4: the dataset, and (if gonio counted it) the group `sums` that merges exactly.

    The file appears when it is complete, under a temporary name until then.
    """
    path = Path(path)
    packed = {"zlib": True, "complevel": 1, "shuffle": True}
    content = io.BytesIO()  # in memory first: HDF5 does not survive a full disk
    groups = [
        (None, measurement.dataset.assign_attrs(format_version=FORMAT_VERSION), "w"),
        *(() if measurement.sums is None else (("sums", measurement.sums, "a"),)),
    ]
    for group, dataset, mode in groups:
        encoding = {name: packed for name, variable in dataset.data_vars.items() if variable.ndim > 3}
        dataset.to_netcdf(content, mode=mode, group=group, engine="h5netcdf", encoding=encoding)
    with atomic_write(path) as scratch:
        scratch.write_bytes(content.getvalue())
    return path


def load(path: str | Path) -> Measurement:
    """Read a measurement that `save` wrote. Raises ValueError in one sentence for anything else."""
    import xarray as xr

    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            attributes = dict(dataset.attrs)
            version = attributes.pop("format_version", 0)
            if "detector" in attributes and version != FORMAT_VERSION:
                raise ValueError(
                    f"its format_version is {version}, and this gonio reads {FORMAT_VERSION}: measure again, or "
                    "read it with the gonio that wrote it"
                )
            DETECTOR.validate_json(attributes["detector"])
            if "origin" in attributes:
                return _external(dataset.load(), attributes)
        with xr.open_dataset(path, group="sums", engine="h5netcdf") as sums:
            return Measurement(sums.load(), attributes)
    except (OSError, KeyError, ValueError) as error:
        raise ValueError(f"{path}: not a measurement that gonio wrote, or it is damaged ({error})") from None


def _external(dataset: xr.Dataset, attributes: Mapping[str, Any]) -> Measurement:
    """The measurement of a file without sums; KeyError or ValueError if it is none."""
    axes = ("theta_i", "phi_i", "theta_o", "dphi", "wavelength")
    brdf, error = (dataset[name].sel(order="all").transpose(*axes) for name in ("brdf", "brdf_standard_error"))
    theta_i, phi_i, wavelengths = (dataset[name].values for name in ("theta_i", "phi_i", "wavelength"))
    detector = DETECTOR.validate_json(attributes["detector"])
    if not isinstance(detector, HemisphereGrid) or brdf.shape[2:4] != detector.shape or error.shape != brdf.shape:
        raise ValueError("its values do not have the shape that its detector has")
    return tabulated(brdf.values, detector, theta_i, phi_i, wavelengths, error.values, attributes)
