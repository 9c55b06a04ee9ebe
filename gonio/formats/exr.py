"""OpenEXR in the spectral layout: one image per incidence, one channel per wavelength.

Channels are named `T.550nm`, with a decimal comma where the wavelength is no whole number, and the header says
`spectralLayoutVersion` 1.0 (Fichet, Pacanowski and Wilkie, "An OpenEXR Layout for Spectral Images", JCGT 10(3), 2021).
Rows are theta_o from the pole to the horizon, columns dphi from -180 degrees upwards: the lamp's side is in the middle
and the mirror's at the left edge. A texel is the average over its bin, so nothing is interpolated and no texel is lost.
The values are the BRDF of all orders together (1/sr, no cosine); a second image of the same layout holds its standard
error. There are no R, G, B channels: the spectrum is the data.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from microsurfaces.files import replacing

if TYPE_CHECKING:
    import xarray as xr

    from gonio.measurement import Measurement

QUANTITIES = {
    "brdf": "cos-weighted bin average of the BRDF, all orders of scattering, no cosine",
    "standard_error": "standard error of brdf: Monte-Carlo noise and, where there are several, realisations together",
}
COMMENTS = (
    "rows: theta_o from 0 (normal) to 90 degrees; columns: dphi = phi_o - phi_i from -180 degrees upwards, "
    "counter-clockwise seen from above; 0 is the lamp's side, 180 the mirror's. Texels are whole bins; centres, edges "
    "and projected solid angles are in the attribute gonio.json."
)


def write(measurement: Measurement, path: Path) -> Path:
    """Write the BRDF and its standard error of every measured incidence to `path` and return it.

    Parts are named `theta_i030.0_phi_i000.0` and `theta_i030.0_phi_i000.0_standard_error`, float32, 1/sr; the string
    attribute `gonio.json` of each holds its grid, its units and where it came from. Raises ValueError for a detector
    without a hemisphere of bins or if no incidence was measured, OSError where the file cannot be written.
    """
    import OpenEXR

    data = measurement.dataset
    if "dphi" not in data.dims:
        raise ValueError(
            "OpenEXR holds hemispheres of theta_o rows and dphi columns, and this measurement was made with Apertures; "
            "measure with detector = HemisphereGrid to export it"
        )
    incidences = [data.isel(theta_i=i, phi_i=j) for i, j in np.argwhere(data["paths"].values > 0)]
    if not incidences:
        raise ValueError("no incidence of this measurement was measured (paths = 0 in all of them): nothing to export")
    parts = [_part(incidence, name) for incidence in incidences for name in QUANTITIES]
    with replacing(path) as temporary:
        try:
            OpenEXR.File([OpenEXR.Part(header, channels) for header, channels in parts]).write(str(temporary))
        except RuntimeError as error:
            # OpenEXR's word for a full disc.
            raise OSError(f"{path}: {error}") from None
    return path


def _part(incidence: xr.Dataset, variable: str) -> tuple[dict[str, Any], dict[str, NDArray[np.float32]]]:
    """Header and channels of one incidence's image of `variable`."""
    import OpenEXR

    header = {
        "name": part_name(float(incidence["theta_i"]), float(incidence["phi_i"]))
        + ("" if variable == "brdf" else f"_{variable}"),
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        "spectralLayoutVersion": "1.0",
        "comments": COMMENTS,
        "gonio.json": json.dumps(_description(incidence, variable), allow_nan=False),
    }
    image = _centred(incidence[variable].sel(order="all")).transpose("wavelength", "theta_o", "dphi")
    channels = {
        channel_name(float(nm)): np.ascontiguousarray(values, np.float32)
        for nm, values in zip(image["wavelength"].values, image.values, strict=True)
    }
    return header, channels


def channel_name(wavelength: float) -> str:
    """The spectral layout's name of a reflectance-like channel: `T.550nm`, `T.632,8nm`."""
    return f"T.{_digits(wavelength).replace('.', ',')}nm"


def part_name(theta_i: float, phi_i: float) -> str:
    """The name of an incidence's image: `theta_i030.0_phi_i000.0`, with more digits where one is not enough."""
    angles = (f"{angle:05.1f}" if round(angle, 1) == angle else _digits(angle) for angle in (theta_i, phi_i))
    return "theta_i{}_phi_i{}".format(*angles)


def _digits(value: float) -> str:
    """The shortest decimal that reads back as `value`, never with an exponent."""
    return np.format_float_positional(value, trim="-")


def _centred(image: xr.DataArray | xr.Dataset) -> Any:
    """`image` with its columns from dphi = -180 degrees upwards."""
    return image.roll(dphi=image.sizes["dphi"] // 2, roll_coords=True)


def _description(incidence: xr.Dataset, variable: str) -> dict[str, Any]:
    """What the part holds, on which grid, and everything that is known about how it was made."""
    grid = _centred(incidence)
    dphi = (grid["dphi"].values + 180.0) % 360.0 - 180.0
    offsets = grid["dphi_bounds"].values - grid["dphi"].values[:, None]
    return {
        "quantity": QUANTITIES[variable],
        "units": "sr-1",
        "theta_i": float(incidence["theta_i"]),
        "phi_i": float(incidence["phi_i"]),
        "theta_o": grid["theta_o"].values.tolist(),
        "theta_o_bounds": grid["theta_o_bounds"].values.tolist(),
        "dphi": dphi.tolist(),
        "dphi_bounds": (dphi[:, None] + offsets).tolist(),
        "angle_units": "degree",
        "projected_solid_angle": grid["projected_solid_angle"].isel(dphi=0).values.tolist(),
        "projected_solid_angle_meaning": "integral of cos(theta_o) over one bin of each row, sr; all columns are equal",
        "wavelengths": incidence["wavelength"].values.tolist(),
        "wavelength_units": "nm",
        "paths": str(int(incidence["paths"])),
        "realisations": str(int(incidence["realisations"])),
        "provenance": {key: _text(value) for key, value in incidence.attrs.items()},
    }


def _text(value: Any) -> str:
    """Attributes as text: integers beyond 2^31 and doubles survive no other way."""
    return value if isinstance(value, str) else str(np.asarray(value).tolist())
