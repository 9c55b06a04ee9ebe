"""OpenEXR images: one per incidence, as whole bins (latitude and longitude) or drawn on an equal-area disc.

**Bins.** Rows are theta_o from the pole to the horizon, columns dphi from -180 degrees upwards: the source side is
in the middle and the specular side at the left edge. A texel is the average over its bin, so nothing is interpolated
and no texel is lost. The values are the BRDF of all orders together (1/sr, no cosine); where errors are known, a second
image of the same layout holds the standard error.

Spectra have a channel per wavelength, in the spectral layout: `T.550nm`, with a decimal comma where the wavelength is
no whole number, and `spectralLayoutVersion` 1.0 in the header (Fichet, Pacanowski and Wilkie, "An OpenEXR Layout for
Spectral Images", JCGT 10(3), 2021). Colours are linear sRGB in R, G, B.

**Disc.** A picture for compositing and teaching: Lambert's azimuthal equal-area projection seen from above, absolute
azimuth 0 to the right and 90 upwards, the horizon on the circle that touches the edges. Texels are point samples at
their centres; those beyond the horizon are 0, and so are their alpha channel's.

Opened by tev, DJV, Nuke, Blender, Mitsuba, OpenImageIO and colour-science.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from gonio.brdf import BRDF
from gonio.detectors import HemisphereGrid
from gonio.formats.text import decimal, padded
from gonio.measurement import tabulated
from gonio.sphere import angles, direction, rotate_z
from microsurfaces.arrays import Floats, Vectors
from microsurfaces.atomic_write import atomic_write

if TYPE_CHECKING:
    import xarray as xr

QUANTITIES = {
    "brdf": "cos-weighted bin average of the BRDF, all orders of scattering, no cosine",
    "brdf_standard_error": "standard error of brdf: Monte Carlo and, where there are several, realisation noise",
}
COMMENTS = {
    "bins": (
        "rows: theta_o from 0 (normal) to 90 degrees; columns: dphi = phi_o - phi_i from -180 degrees upwards, "
        "counter-clockwise seen from above; 0 is the source side, 180 the specular side. Texels are whole bins; "
        "centres, edges and projected solid angles are in the attribute gonio.json."
    ),
    "disc": (
        "Lambert azimuthal equal-area disc seen from above: phi_o = 0 to the right, 90 upwards, theta_o = 90 degrees "
        "on the circle that touches the edges. Texels are samples at their centres."
    ),
}
DISC = 360
"""Texels along the disc's diameter."""

LARGEST = 1 << 30
"""Bytes that a file may hold at most, unpacked."""


def write(brdf: BRDF, path: Path, colour: bool = False, layout: Literal["bins", "disc"] = "bins") -> Sequence[str]:
    """Write the BRDF, and its standard error where it is known, of every measured incidence to `path`.

    Parts are named `theta_i030.0_phi_i000.0` and `theta_i030.0_phi_i000.0_standard_error`, float32, 1/sr; the string
    attribute `gonio.json` of each holds its grid, its units and where it came from. With `colour` a spectrum becomes
    linear sRGB, without errors. Raises OSError where the file cannot be written.
    """
    import OpenEXR

    if colour:
        brdf = brdf.in_basis("RGB")
    measurement = brdf.measured()
    data = measurement.dataset
    incidences = [data.isel(theta_i=i, phi_i=j) for i, j in np.argwhere(measurement.measured)]
    if layout == "disc":
        parts = [_disc_part(brdf, incidence) for incidence in incidences]
    else:
        quantities = [name for name in QUANTITIES if data[name].notnull().any()]
        parts = [_part(brdf, incidence, name) for incidence in incidences for name in quantities]
    with atomic_write(path) as temporary:
        try:
            OpenEXR.File([OpenEXR.Part(header, channels) for header, channels in parts]).write(str(temporary))
        except RuntimeError as error:
            # OpenEXR's word for a full disc.
            raise OSError(f"{path}: {error}") from None
    return ()


def _part(brdf: BRDF, incidence: xr.Dataset, variable: str) -> tuple[dict[str, Any], dict[str, NDArray[np.float32]]]:
    """Header and channels of one incidence's image of `variable`."""
    suffix = variable.removeprefix("brdf")
    header = _header(incidence, suffix, "bins", _description(brdf, incidence, variable))
    image = _centred(incidence[variable].sel(order="all")).transpose("wavelength", "theta_o", "dphi")
    return header, dict(zip(_channels(brdf), np.ascontiguousarray(image.values, np.float32), strict=True))


def _disc_part(brdf: BRDF, incidence: xr.Dataset) -> tuple[dict[str, Any], dict[str, NDArray[np.float32]]]:
    """Header and channels of one incidence's disc."""
    wo, above = _disc_directions()
    wi = np.broadcast_to(direction(float(incidence["theta_i"]), float(incidence["phi_i"])), wo.shape)
    image = np.zeros((len(brdf.wavelengths), *above.shape), np.float32)
    image[:, above] = brdf.evaluate(wi[above], wo[above]).T
    about = {**_about(brdf, incidence), "quantity": "BRDF, all orders of scattering, no cosine"}
    channels = {**dict(zip(_channels(brdf), image, strict=True)), "A": above.astype(np.float32)}
    return _header(incidence, "", "disc", about), channels


def _disc_directions() -> tuple[Vectors, NDArray[np.bool_]]:
    """Directions (rows, columns, 3) of the disc's texels, and which of them are above the horizon."""
    centres = (np.arange(DISC) + 0.5) * (2 / DISC) - 1
    x, y = np.meshgrid(centres, -centres)
    across = np.hypot(x, y)
    # theta = 90 degrees has radius 1: the radius is √2 sin(theta / 2).
    theta = np.degrees(2 * np.arcsin(np.minimum(across, 1) / np.sqrt(2)))
    return direction(theta, np.degrees(np.arctan2(y, x))), across < 1


def _header(incidence: xr.Dataset, suffix: str, layout: str, about: dict[str, Any]) -> dict[str, Any]:
    import OpenEXR

    return {
        "name": part_name(float(incidence["theta_i"]), float(incidence["phi_i"])) + suffix,
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        **({"spectralLayoutVersion": "1.0"} if about["basis"] == "spectrum" else {}),
        "comments": COMMENTS[layout],
        "gonio.json": json.dumps({"layout": layout, **about}, allow_nan=False),
    }


def _channels(brdf: BRDF) -> tuple[str, ...]:
    """Names of the channels, as readers of spectral and of colour images expect them."""
    if brdf.basis == "spectrum":
        return tuple(channel_name(nm) for nm in brdf.wavelengths.tolist())
    return brdf.channels


def channel_name(wavelength: float) -> str:
    """The spectral layout's name of a reflectance-like channel: `T.550nm`, `T.632,8nm`."""
    return f"T.{decimal(wavelength).replace('.', ',')}nm"


def part_name(theta_i: float, phi_i: float) -> str:
    """The name of an incidence's image: `theta_i030.0_phi_i000.0`, with more digits where one is not enough."""
    return f"theta_i{padded(theta_i)}_phi_i{padded(phi_i)}"


def _centred(image: xr.DataArray | xr.Dataset) -> Any:
    """`image` with its columns from dphi = -180 degrees upwards."""
    return image.roll(dphi=image.sizes["dphi"] // 2, roll_coords=True)


def _about(brdf: BRDF, incidence: xr.Dataset) -> dict[str, Any]:
    """What is known of one incidence's image, whatever its layout."""
    return {
        "units": "sr-1",
        "theta_i": float(incidence["theta_i"]),
        "phi_i": float(incidence["phi_i"]),
        "angle_units": "degree",
        "basis": brdf.basis,
        "wavelengths": brdf.wavelengths.tolist(),
        "wavelength_units": "nm",
        "isotropic": bool(brdf.isotropic),
        **{name: str(int(incidence[name])) for name in ("paths", "realisations") if name in incidence},
        "provenance": {key: _text(value) for key, value in brdf.attributes.items()},
    }


def _description(brdf: BRDF, incidence: xr.Dataset, variable: str) -> dict[str, Any]:
    """What the part holds, on which grid, and everything that is known about how it was made."""
    grid = _centred(incidence)
    dphi = (grid["dphi"].values + 180.0) % 360.0 - 180.0
    offsets = grid["dphi_bounds"].values - grid["dphi"].values[:, None]
    return {
        **_about(brdf, incidence),
        "quantity": QUANTITIES[variable],
        "detector": brdf.measured().attributes["detector"],
        "theta_o": grid["theta_o"].values.tolist(),
        "theta_o_bounds": grid["theta_o_bounds"].values.tolist(),
        "dphi": dphi.tolist(),
        "dphi_bounds": (dphi[:, None] + offsets).tolist(),
        "projected_solid_angle": grid["projected_solid_angle"].isel(dphi=0).values.tolist(),
        "projected_solid_angle_meaning": "integral of cos(theta_o) over one bin of each row, sr; all columns are equal",
    }


def _text(value: Any) -> str:
    """Attributes as text: integers beyond 2^31 and doubles survive no other way."""
    return value if isinstance(value, str) else str(np.asarray(value).tolist())


# --- Reading ---------------------------------------------------------------------------------------------------------


def read(path: Path) -> BRDF:
    """A BRDF from images that `write` made: bins with their errors as they were, discs interpolated between texels.

    Raises ValueError for other files: an image alone does not tell its directions.
    """
    import OpenEXR

    try:
        _insist_on_size(path)
        parts = OpenEXR.File(str(path), separate_channels=True).parts
        images = [(json.loads(part.header["gonio.json"]), _pixels(part)) for part in parts]
        return _disc(path, images) if images[0][0]["layout"] == "disc" else _bins(path, images)
    except (RuntimeError, KeyError, ValueError, TypeError, IndexError, AttributeError, OSError, MemoryError) as error:
        raise ValueError(f"{path}: not an OpenEXR file that gonio wrote, or it is damaged ({error})") from None


def _insist_on_size(path: Path) -> None:
    """Refuse images that would unpack to more than `LARGEST`, by their headers alone."""
    import OpenEXR

    announced = 0
    for part in OpenEXR.File(str(path), header_only=True).parts:
        low, high = (np.asarray(corner, np.int64) for corner in part.header["dataWindow"])
        announced += int(np.prod(high - low + 1)) * 4 * len(part.header["channels"])
    if announced > LARGEST:
        raise ValueError(f"its images hold {announced >> 20} MiB, more than {LARGEST >> 20}")


def _pixels(part: Any) -> Floats:
    """(rows, columns, channels) in the order in which the part's wavelengths or colours are named."""
    about = json.loads(part.header["gonio.json"])
    names = [channel_name(nm) for nm in about["wavelengths"]] if about["basis"] == "spectrum" else list(about["basis"])
    return np.stack([np.asarray(part.channels[name].pixels, np.float64) for name in names], axis=-1)


def _attributes(path: Path, about: dict[str, Any]) -> dict[str, Any]:
    known = {name: about["provenance"][name] for name in ("title", "experiment") if name in about["provenance"]}
    return {
        **known,
        "origin": f"OpenEXR file {path.name}",
        "isotropic": int(about["isotropic"]),
        "basis": about["basis"],
    }


def _nodes(images: list[tuple[dict[str, Any], Floats]]) -> tuple[Floats, Floats]:
    """Every theta_i and phi_i that occurs, ascending."""
    theta_i, phi_i = (np.unique([about[name] for about, _ in images]) for name in ("theta_i", "phi_i"))
    return theta_i, phi_i


def _bins(path: Path, images: list[tuple[dict[str, Any], Floats]]) -> BRDF:
    from pydantic import TypeAdapter

    about = images[0][0]
    detector = TypeAdapter(HemisphereGrid).validate_json(about["detector"])
    theta_i, phi_i = _nodes(images)
    shape = (len(theta_i), len(phi_i), *detector.shape, len(about["wavelengths"]))
    tables = {quantity: np.full(shape, np.nan) for quantity in QUANTITIES.values()}
    for each, pixels in images:
        at = np.searchsorted(theta_i, each["theta_i"]), np.searchsorted(phi_i, each["phi_i"])
        tables[each["quantity"]][at] = np.roll(pixels, -(detector.shape[1] // 2), axis=1)
    values, errors = (tables[QUANTITIES[name]] for name in ("brdf", "brdf_standard_error"))
    attributes = _attributes(path, about)
    return BRDF.of(tabulated(values, detector, theta_i, phi_i, about["wavelengths"], errors, attributes))


def _disc(path: Path, images: list[tuple[dict[str, Any], Floats]]) -> BRDF:
    about = images[0][0]
    theta_i, phi_i = _nodes(images)
    table = np.full((len(theta_i), len(phi_i), *images[0][1].shape), np.nan)
    for each, pixels in images:
        table[np.searchsorted(theta_i, each["theta_i"]), np.searchsorted(phi_i, each["phi_i"])] = pixels
    table[:, :, ~_disc_directions()[1]] = np.nan

    def evaluate(wi: Vectors, wo: Vectors) -> Floats:
        """The nearest disc's nearest texel."""
        theta, phi = angles(wi)
        wo = rotate_z(wo, phi_i[0] - phi) if about["isotropic"] else wo
        row = np.abs(theta[:, None] - theta_i).argmin(axis=1)
        column = np.abs((phi[:, None] - phi_i + 180) % 360 - 180).argmin(axis=1) * (not about["isotropic"])
        return np.asarray(table[row, column, *_texel(wo)])

    return BRDF(
        evaluate=evaluate,
        wavelengths=np.array(about["wavelengths"]),
        theta_i=theta_i,
        phi_i=phi_i,
        isotropic=about["isotropic"],
        basis=about["basis"],
        attributes=_attributes(path, about),
    )


def _texel(wo: Vectors) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row and column of the disc's texel that each direction falls into."""
    theta, phi = angles(wo)
    across = np.sqrt(2) * np.sin(np.radians(theta) / 2)
    x, y = across * np.cos(np.radians(phi)), across * np.sin(np.radians(phi))
    row, column = (np.clip(((1 + c) / 2 * DISC).astype(np.intp), 0, DISC - 1) for c in (-y, x))
    return row, column
