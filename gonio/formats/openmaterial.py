"""ASAM OpenMATERIAL 3D BRDF look-up table `.xompt`: reflectance for the camera, lidar and radar models of driving.

JSON with `metadata` and `brdf`. `brdf.wavelengths` lists the wavelengths in metres; `brdf.lookupTable` has a row

    [wavelength in m, theta_i, theta_o, phi_o in rad, f_r in 1/sr (no cosine) or null]

for every bin, sorted by its columns from the first on. phi_o is relative to the azimuth of the light, counter-clockwise
seen from above: 0 is the source side and π the specular side. Therefore the table is isotropic; of an anisotropic
specimen it holds the mean over the azimuths of the light. Errors are lost.

**The detector's solid angle** is in `brdf.receiverSolidAngles`, one for each wavelength in sr, as the standard and SEMI
ME1392 want it. The values are averages over the bins of a hemisphere, which are not all equally large: what stands
there is the mean of all bins, and `brdf.binSolidAngles`, an addition of ours, has the solid angle of those at every
theta_o.

Read is every such table; a phi_o from 0 to π only stands for both sides. Directions need not form a grid: see
`gonio.formats.scattered`.

ASAM OpenMATERIAL 3D 1.1, schema material_brdf_schema.json (github.com/asam-ev/OpenMATERIAL-3D).
"""

from __future__ import annotations

import datetime
import hashlib
import itertools
import json
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.brdf import BRDF
from gonio.detectors import HemisphereGrid
from gonio.formats import json_arrays
from gonio.formats.scattered.bins import detector_of
from gonio.formats.scattered.rows import degrees
from gonio.formats.scattered.table import Table
from gonio.formats.text import decimal, radians, title_of
from gonio.measurement import Measurement
from microsurfaces.arrays import Floats
from microsurfaces.atomic_write import atomic_write

if TYPE_CHECKING:
    import xarray as xr

VERSION = "1.1.0"
"""Of OpenMATERIAL 3D."""

SCHEMA = (
    f"https://raw.githubusercontent.com/asam-ev/OpenMATERIAL-3D/refs/tags/v{VERSION}/schemas/material_brdf_schema.json"
)


def write(brdf: BRDF, path: Path) -> Sequence[str]:
    """Write every bin of every measured polar angle of the light, the mean over its azimuths.

    Raises OSError where the file cannot be written.
    """
    measurement = brdf.measured()
    data = measurement.dataset.sel(order="all")
    values = data["brdf"].isel(phi_i=0) if brdf.isotropic else data["brdf"].mean("phi_i")
    values = values.sortby("wavelength").transpose("wavelength", "theta_i", "theta_o", "dphi")
    head = {
        "$schema": SCHEMA,
        "metadata": _metadata(brdf, measurement),
        "brdf": {
            "wavelengths": [_metres(nm) for nm in values["wavelength"].values],
            **_solid_angles(values["wavelength"].values, brdf.detector),
        },
    }
    text = json.dumps(head, indent=1, ensure_ascii=False, allow_nan=False).removesuffix("\n }\n}")
    with atomic_write(path) as scratch, scratch.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f'{text},\n  "lookupTable": [\n')
        for index, rows in enumerate(_rows(values)):
            file.write((",\n" if index else "") + ",\n".join(rows))
        file.write("\n]}}\n")
    return _notes(brdf, measurement, values.values)


def _rows(values: xr.DataArray) -> Iterator[Iterator[str]]:
    """The rows of each wavelength and incidence as text."""
    bins = [
        f"{radians(theta)},{radians(phi)}"
        for theta, phi in itertools.product(values["theta_o"].values, values["dphi"].values)
    ]
    for nm, at_wavelength in zip(values["wavelength"].values, values.values, strict=True):
        for theta_i, lobe in zip(values["theta_i"].values, at_wavelength, strict=True):
            light = f"[{_metres(nm)!r},{radians(theta_i)}"
            # Negative values are refused by the schema; maximum keeps what is not known.
            numbers = map(repr, np.maximum(lobe, 0.0).ravel().tolist())
            yield (f"{light},{place},{'null' if v == 'nan' else v}]" for place, v in zip(bins, numbers, strict=True))


def _metres(nm: float) -> float:
    return float(f"{decimal(nm)}e-9")


def _metadata(brdf: BRDF, measurement: Measurement) -> dict[str, Any]:
    digest = hashlib.blake2b(
        np.ascontiguousarray(measurement.dataset["brdf"].values).tobytes(), digest_size=16
    ).digest()
    origin = brdf.attributes.get("origin")
    return {
        "name": title_of(brdf.title),
        "description": "Averages over bins of theta_o and phi_o, given by their centres.",
        "uuid": str(uuid.UUID(bytes=digest, version=5)),
        "materialVersion": "1.0.0",
        "openMaterial3dVersion": VERSION,
        "copyrights": ["NA"],
        "license": "NA",
        "authors": ["NA"],
        "creationDate": datetime.datetime.now(datetime.UTC).strftime("%Y%m%dT%H%M%SZ"),
        "sources": "simulated by gonio" if origin is None else title_of(origin),
        "gonio": {"basis": brdf.basis, "detector": json.loads(measurement.attributes["detector"])},
    }


def _solid_angles(wavelengths: Floats, grid: HemisphereGrid) -> dict[str, Any]:
    """Of the bins: their mean for each wavelength, and the one of each ring."""
    rings = -np.diff(np.cos(np.radians(grid.theta_edges))) * (2 * np.pi / grid.shape[1])
    mean = 2 * np.pi / grid.bins
    return {
        "receiverSolidAngles": [{"wavelength": _metres(nm), "solidAngle": mean} for nm in wavelengths],
        "binSolidAngles": [
            {"exitZenith": float(np.radians(theta)), "solidAngle": float(angle)}
            for theta, angle in zip(grid.theta, rings, strict=True)
        ],
    }


def _notes(brdf: BRDF, measurement: Measurement, values: Floats) -> Sequence[str]:
    notes = []
    unknown = np.isnan(values).mean()
    if unknown:
        notes.append(f"nothing is known of {unknown:.1%} of the values: they are null")
    if (values < 0).any():
        notes.append(f"{(values < 0).mean():.1%} of the values were negative: the format demands 0")
    if brdf.basis != "spectrum":
        named = zip(brdf.channels, brdf.wavelengths, strict=True)
        notes.append(f"colours stand at nominal wavelengths: {', '.join(f'{name} at {nm:g} nm' for name, nm in named)}")
    if not brdf.isotropic:
        notes.append(f"the table is isotropic: it holds the mean over {len(brdf.phi_i)} azimuths of the light")
    if measurement.dataset["brdf_standard_error"].notnull().any():
        notes.append("the format has no place for standard errors")
    return notes


# --- Reading ---------------------------------------------------------------------------------------------------------


def read(path: Path) -> BRDF:
    """A BRDF from such a table; ours come back exactly. Raises ValueError in one sentence for anything else."""
    try:
        content = json_arrays.load(path, "lookupTable")
        with np.errstate(over="ignore", invalid="ignore"):
            return _table(content["metadata"], content["brdf"], path.name).to_brdf()
    except KeyError as error:
        raise ValueError(f"{path}: not an OpenMATERIAL BRDF table: {error} is missing") from None
    except (ValueError, TypeError, AttributeError, OverflowError, OSError) as error:
        raise ValueError(f"{path}: not an OpenMATERIAL BRDF table: {title_of(error)}") from None


def _table(metadata: Mapping[str, Any], content: Mapping[str, Any], name: str) -> Table:
    rows = np.asarray(content["lookupTable"], np.float64)
    if rows.ndim != 2 or rows.shape[1] != 5:
        raise ValueError(f"its lookupTable has the shape {rows.shape}, expected rows of 5 numbers")
    wavelength, theta_i, theta_o, phi_o, values = rows.T
    ours = metadata.get("gonio")
    about = ours if isinstance(ours, dict) else {}
    table = Table.of_rows(
        degrees(theta_i),
        np.zeros(len(rows)),
        degrees(theta_o),
        degrees(phi_o),
        np.round(1e9 * wavelength, 6),
        values,
        isotropic=True,
        detector=detector_of(about.get("detector")),
        attributes={"title": title_of(metadata.get("name") or name), "origin": f"OpenMATERIAL file {name}"},
    )
    return table.in_colours(about.get("basis"))
