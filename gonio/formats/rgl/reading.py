"""Reading: what the fields of a file must be, and the BRDF that they make."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.brdf import BRDF, NOMINAL
from gonio.detectors import HemisphereGrid
from gonio.formats.rgl.interpolant import Interpolant
from gonio.formats.rgl.parametrisation import Warp
from gonio.formats.rgl.tensor_file import load

BINS = 1 << 23
"""Values of the largest measurement that reading suggests."""


def read(path: Path) -> BRDF:
    """A BRDF from a tensor file: ours or EPFL's, colours or spectra, isotropic or not, reductions 1, 2 and 4.

    Raises ValueError for what is none.
    """
    try:
        fields = load(path)
        interpolant = _interpolant(fields)
    except (OSError, ValueError, struct.error) as error:
        raise ValueError(f"{path}: not a tensor file of a BRDF, or it is damaged ({error})") from None
    colour = "spectra" not in fields
    theta_i = np.unique(np.minimum(np.round(np.degrees(interpolant.theta_i), 4), 90.0))
    phi_i = interpolant.azimuths()
    channels = interpolant.values.shape[-1]
    return BRDF(
        evaluate=interpolant.evaluate,
        wavelengths=np.array(NOMINAL["RGB"]) if colour else fields["wavelengths"].astype(np.float64),
        theta_i=theta_i,
        phi_i=phi_i,
        isotropic=interpolant.isotropic,
        basis="RGB" if colour else "spectrum",
        detector=_detector(len(theta_i) * len(phi_i) * channels),
        attributes={"title": _title(fields) or path.stem, "origin": f"RGL file {path.name}"},
    )


def _interpolant(fields: Mapping[str, NDArray[Any]]) -> Interpolant:
    """The BRDF of these fields. Raises ValueError where they do not fit each other."""
    name = "spectra" if "spectra" in fields else "rgb"
    _insist_on_fields(fields, name)
    theta_i, phi_i, ndf, sigma = (fields[field].astype(np.float64) for field in ("theta_i", "phi_i", "ndf", "sigma"))
    vndf, values = fields["vndf"], fields[name]
    grid = len(phi_i), len(theta_i)
    channels = len(fields["wavelengths"]) if name == "spectra" else 3
    if vndf.shape[:2] != grid or values.shape[:3] != (*grid, channels) or values.shape[3] != values.shape[4]:
        raise ValueError(f"vndf {vndf.shape} and {name} {values.shape} do not fit {grid} azimuths and incidences")
    if min(*ndf.shape, *sigma.shape, *vndf.shape[2:], values.shape[3]) < 2:
        raise ValueError("one of its tables has fewer than 2 rows or columns")
    _insist_on_order(theta_i, "theta_i", 0.0, math.pi / 2)
    _insist_on_order(phi_i, "phi_i", -math.pi, math.pi)
    if name == "spectra":
        _insist_on_order(fields["wavelengths"], name, 0.0, math.inf)
    if not ((ndf >= 0).all() and (sigma > 0).all()):
        raise ValueError("ndf must not be negative, and sigma above 0")
    interpolant = Interpolant(
        theta_i=theta_i,
        phi_i=phi_i,
        ndf=ndf,
        sigma=sigma,
        warp=Warp.of(vndf.reshape(-1, *vndf.shape[2:])),
        values=np.ascontiguousarray(np.moveaxis(values, 2, -1)).reshape(-1, *values.shape[3:], channels),
        jacobian=bool(fields["jacobian"][0]),
    )
    if interpolant.reduction not in (1, 2, 4):
        raise ValueError(f"its azimuths span a circle / {interpolant.reduction}, and 1, 2 and 4 have a meaning")
    return interpolant


def _insist_on_fields(fields: Mapping[str, NDArray[Any]], name: str) -> None:
    """Whether everything is there, with its type and dimensions; `name` is that of the values."""
    sides = {"theta_i": 1, "phi_i": 1, "ndf": 2, "sigma": 2, "vndf": 4, "jacobian": 1, name: 5}
    if name == "spectra":
        sides["wavelengths"] = 1
    for field, count in sides.items():
        kind = np.uint8 if field == "jacobian" else np.float32
        if field not in fields:
            raise ValueError(f"it has no field {field!r}")
        if fields[field].ndim != count or not fields[field].size or fields[field].dtype != kind:
            raise ValueError(f"its field {field!r} is {fields[field].dtype} {list(fields[field].shape)}")
        if not np.isfinite(fields[field]).all():
            raise ValueError(f"its field {field!r} holds numbers that are not finite")


def _insist_on_order(nodes: NDArray[np.floating], name: str, low: float, high: float) -> None:
    slack = 1e-3
    inside = (nodes >= low - slack) & (nodes <= high + slack)
    if not (inside.all() and (np.diff(nodes) > 0).all()):
        raise ValueError(f"{name} must rise between {low:.4g} and {high:.4g}")


def _detector(others: int) -> HemisphereGrid:
    """Bins as small as 1 x 2 degrees, larger ones if there would be too many of them for so many other values."""
    grids = [HemisphereGrid(theta_step=step, phi_step=2 * step) for step in (1.0, 1.5, 2.0, 3.0, 5.0)]
    return next((grid for grid in grids if grid.bins * others <= BINS), grids[-1])


def _title(fields: Mapping[str, NDArray[Any]]) -> str:
    """The first line of the description."""
    if fields.get("description", np.zeros(0)).dtype != np.uint8:
        return ""
    lines = fields["description"].tobytes().decode("utf-8", errors="replace").split("\n", 1)
    return "".join(letter for letter in lines[0] if letter.isprintable())[:200]
