"""BiRD / BxDiff universal BRDF data, JSON 1.0: what metrology laboratories exchange, values with uncertainties.

`{"metadata": {...}, "data": {...}}`. The data are flat lists of equal length, `{"unit": ..., "values": [...]}`:
`theta_i`, `phi_i`, `theta_r`, `phi_r`, `wavelength_i`, `BRDF` and `uBRDF`, one entry a bin and wavelength. Directions
point away from the surface (Nicodemus), azimuths run counter-clockwise seen from above, so light from phi_i has its
specular direction at phi_i + 180 degrees. Values are in 1/sr, no cosine. BiRDview draws it; about 80 bytes a value.

**Written.** Angles in degrees, wavelengths in nm, `uBRDF` the standard error (k = 1) in 1/sr if it is known of every
value. Colours, which are no wavelengths, go to `adhoc_variables.channel`. The metadata that the format demands and that
we cannot know (organization, address, contact) are "NA": edit them before the file is published. Our own description,
and the bins whose averages the values are, are in `metadata.adhoc_section`. What is not known has no entry.

**Read.** Degrees or radians, nm or μm, `uBRDF` in 1/sr or %, or the single `uncertainty` of `BRDF`. Values for several
polarisations of the light are averaged; those behind an analyser (`polarization_r`) are refused. Directions need not
form a grid: see `gonio.formats.scattered`.

D. Lanevski et al. (2022); EMPIR projects 16NRM08 BiRD and 18SIB03 BxDiff; schema and example at
github.com/BiRD-project/BiRD_view.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio import __version__
from gonio.brdf import BRDF, NOMINAL
from gonio.formats import json_arrays
from gonio.formats.scattered.bins import detector_of, incidences
from gonio.formats.scattered.rows import degrees
from gonio.formats.scattered.table import Table
from gonio.formats.text import decimal, title_of
from gonio.measurement import Measurement
from microsurfaces.arrays import Floats
from microsurfaces.atomic_write import atomic_write

SCHEMA = "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json"

UNITS = {
    **dict.fromkeys(("theta_i", "phi_i", "theta_r", "phi_r"), "deg"),
    "wavelength_i": "nm",
    **dict.fromkeys(("BRDF", "uBRDF"), "1/sr"),
}
"""Of what is written, in this order."""

NOT_KNOWN = "NA"

METHODS = ("simulation", "measurement")

ADDRESS = ("country", "city", "street", "building_nr", "postal_code")


def write(brdf: BRDF, path: Path) -> Sequence[str]:
    """Write every bin of every measured incidence whose value is known.

    Raises OSError where the file cannot be written.
    """
    measurement = brdf.measured()
    columns, notes = _columns(brdf, measurement)
    values = [_values(name, {"unit": unit}, columns[name]) for name, unit in UNITS.items() if name in columns]
    if "channel" in columns:
        about = {"description": f"{brdf.basis} under D65, CIE 1931 2° observer", "unit": "", "type": "string"}
        values.append(f'"adhoc_variables": {{{_values("channel", about, columns["channel"])}}}')
    metadata = json.dumps(_metadata(brdf, measurement), indent=1, ensure_ascii=False, allow_nan=False)
    with atomic_write(path) as scratch:
        text = '{{"metadata": {},\n"data": {{\n{}\n}}}}\n'.format(metadata, ",\n".join(values))
        scratch.write_text(text, encoding="utf-8", newline="\n")
    return notes


def _values(name: str, about: Mapping[str, str], values: Sequence[str]) -> str:
    head = json.dumps(about, ensure_ascii=False).removesuffix("}")
    return f'"{name}": {head}, "values": [{",".join(values)}]}}'


def _columns(brdf: BRDF, measurement: Measurement) -> tuple[Mapping[str, Sequence[str]], Sequence[str]]:
    """Every list of the file as pieces of text, and what had to be bent."""
    data = measurement.dataset
    known = data["brdf"].sel(order="all").notnull()
    errors = bool(data["brdf_standard_error"].sel(order="all").notnull().where(known, True).all())
    axes = {"theta_r": data["theta_o"].values, "wavelength_i": brdf.wavelengths}
    words: dict[str, NDArray[np.object_]] = {name: _words(map(decimal, axis)) for name, axis in axes.items()}
    if brdf.basis != "spectrum":
        words["channel"] = _words(json.dumps(name) for name in brdf.channels)
        del words["wavelength_i"]
    columns: dict[str, list[str]] = {name: [] for name in (*UNITS, "channel")}
    dark = bins = 0
    for theta, phi, values, error in incidences(measurement):
        here = np.isfinite(values)
        words["phi_r"] = _words(decimal((phi + d) % 360) for d in data["dphi"].values)
        for name, axis in (("theta_r", 0), ("phi_r", 1), ("wavelength_i", 2), ("channel", 2)):
            if name in words:
                along = np.expand_dims(words[name], [k for k in range(3) if k != axis])
                columns[name].append(",".join(np.broadcast_to(along, here.shape)[here].tolist()))
        count = int(here.sum())
        for name, angle in (("theta_i", theta), ("phi_i", phi)):
            columns[name].append(",".join([decimal(angle)] * count))
        columns["BRDF"].append(_numbers(np.maximum(values[here], 0.0)))
        if errors:
            columns["uBRDF"].append(_numbers(error[here]))
        dark, bins = dark + int((values[here] < 0).sum()), bins + count
    missing = int(known.size) - bins
    return {name: pieces for name, pieces in columns.items() if pieces}, _notes(brdf, missing, dark, bins)


def _words(texts: Any) -> NDArray[np.object_]:
    return np.array(list(texts), dtype=object)


def _numbers(values: Floats) -> str:
    """The shortest decimals that read back as the same doubles."""
    return ",".join(map(repr, values.tolist()))


def _notes(brdf: BRDF, missing: int, dark: int, bins: int) -> Sequence[str]:
    notes = []
    if missing:
        notes.append(f"nothing is known of {missing / (missing + bins):.1%} of the values: they have no entry")
    if dark:
        notes.append(f"{dark / bins:.1%} of the values were negative: the format demands 0")
    if not brdf.isotropic and len(brdf.phi_i) == 1:
        notes.append("one azimuth of the light is known of an anisotropic specimen; sample.properties_symmetry says so")
    notes.append("organization, address and contact are unknown (NA): fill them in before it is published")
    return notes


def _metadata(brdf: BRDF, measurement: Measurement) -> dict[str, Any]:
    """What is known of the measurement, where the schema has a place for it."""
    values = measurement.dataset["brdf"].values
    digest = hashlib.blake2b(np.ascontiguousarray(values).tobytes(), digest_size=16).digest()
    ours, method = "origin" not in brdf.attributes, brdf.attributes.get("method")
    return {
        "schema": SCHEMA,
        "id": f"urn:uuid:{uuid.UUID(bytes=digest, version=5)}",
        "type": "BRDF",
        "timestamp": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "provenance": {
            "organization": NOT_KNOWN,
            "location": dict.fromkeys(ADDRESS, NOT_KNOWN),
            "email": "NA@example.invalid",
            "contact_person": NOT_KNOWN,
        },
        "description": title_of(brdf.title),
        "method": method if method in METHODS else "simulation" if ours else "measurement",
        "instrumentation": NOT_KNOWN,
        "software": {"name": "gonio", "version": __version__},
        "sample": {
            "name": title_of(brdf.title),
            "type": NOT_KNOWN,
            "dimensions": {},
            "shape": NOT_KNOWN,
            "zero_azimuth_location": "the x axis",
            "properties_symmetry": "isotropic" if brdf.isotropic else "anisotropic",
        },
        "environment": NOT_KNOWN,
        "adhoc_section": {
            "detector": json.loads(measurement.attributes["detector"]),
            "provenance": {key: str(value) for key, value in brdf.attributes.items()},
        },
    }


# --- Reading ---------------------------------------------------------------------------------------------------------


def read(path: Path) -> BRDF:
    """A BRDF from such a file; ours come back exactly, with their errors.

    A specimen of which the file does not say whether it is isotropic is so if there is a single azimuth of the light.
    Raises ValueError in one sentence for anything else.
    """
    try:
        content = json_arrays.load(path, "values")
        with np.errstate(over="ignore", invalid="ignore"):
            return _table(content["metadata"], content["data"], path.name).to_brdf()
    except KeyError as error:
        raise ValueError(f"{path}: not a BiRD file of a BRDF: {error} is missing") from None
    except (ValueError, TypeError, AttributeError, IndexError, OverflowError, OSError) as error:
        raise ValueError(f"{path}: not a BiRD file of a BRDF: {title_of(error)}") from None


def _table(metadata: Mapping[str, Any], data: Mapping[str, Any], name: str) -> Table:
    _refuse_analysers(data)
    values = _list(data["BRDF"])
    theta_i, phi_i, theta_r, phi_r = (_angles(data[key]) for key in ("theta_i", "phi_i", "theta_r", "phi_r"))
    wavelength, basis = _wavelengths(data, len(values))
    columns = (theta_i, phi_i, theta_r, phi_r, wavelength)
    if any(column.shape != values.shape for column in columns):
        raise ValueError(
            f"its lists have {', '.join(str(len(c)) for c in columns)} entries, expected {len(values)} each"
        )
    adhoc = metadata.get("adhoc_section")
    ours = adhoc if isinstance(adhoc, dict) else {}
    sample = metadata.get("sample")
    symmetry = sample.get("properties_symmetry") if isinstance(sample, dict) else None
    table = Table.of_rows(
        theta_i,
        phi_i,
        theta_r,
        phi_r - phi_i,
        wavelength,
        values,
        _errors(data, values),
        isotropic={"isotropic": True, "anisotropic": False}.get(str(symmetry)),
        detector=detector_of(ours.get("detector")),
        attributes=_attributes(metadata, ours, name),
    )
    return table.in_colours(basis)


def _refuse_analysers(data: Mapping[str, Any]) -> None:
    """Only light of any polarisation is what we know of."""
    if "polarization_r" not in data:
        return
    states = data["polarization_r"]["values"]
    if any(state != "u" and list(state) != [1, 0, 0, 0] for state in states):
        raise ValueError("its values were taken behind an analyser (polarization_r), which is not supported")


def _list(variable: Mapping[str, Any]) -> Floats:
    values = np.asarray(variable["values"], np.float64)
    if values.ndim != 1:
        raise ValueError("the values of a variable must be a flat list of numbers")
    return values


def _angles(variable: Mapping[str, Any]) -> Floats:
    match variable["unit"]:
        case "deg" | "°":
            return _list(variable)
        case "rad":
            return degrees(_list(variable))
    raise ValueError(f"the unit of an angle is {title_of(variable['unit'])[:40]!r}, expected deg or rad")


def _wavelengths(data: Mapping[str, Any], count: int) -> tuple[Floats, str]:
    """The wavelength of each value in nm, nominal ones for colours, and what the channels are."""
    for name in ("wavelength_i", "wavelength_r"):
        if name in data:
            scale = {"nm": 1.0, "μm": 1e3, "µm": 1e3, "um": 1e3}[data[name]["unit"]]
            return np.round(scale * _list(data[name]), 6), "spectrum"
    channel = data.get("adhoc_variables", {}).get("channel", {}).get("values")
    for basis in ("RGB", "XYZ"):
        if channel is not None and set(channel) == set(basis):
            nominal = dict(zip(basis, NOMINAL[basis], strict=True))
            return np.array([nominal[name] for name in channel]), basis
    return np.full(count, NOMINAL["Y"][0]), "Y"


def _errors(data: Mapping[str, Any], values: Floats) -> Floats | None:
    """Standard errors of `values` in 1/sr; None if the file has none."""
    if "uBRDF" in data:
        errors, unit = _list(data["uBRDF"]), data["uBRDF"]["unit"]
        if errors.shape != values.shape:
            raise ValueError(f"its uBRDF has {len(errors)} entries, expected {len(values)}")
    elif "uncertainty" in data["BRDF"]:
        single = data["BRDF"]["uncertainty"]
        errors, unit = np.full(len(values), float(single["value"])), single["unit"]
    else:
        return None
    return errors / 100 * values if unit == "%" else errors


def _attributes(metadata: Mapping[str, Any], ours: Mapping[str, Any], name: str) -> dict[str, Any]:
    provenance = ours.get("provenance")
    known = {**(provenance if isinstance(provenance, dict) else {}), "method": metadata.get("method")}
    kept = {key: str(known[key]) for key in ("experiment", "method") if known.get(key)}
    return {"title": title_of(metadata.get("description") or name), **kept, "origin": f"BiRD file {name}"}
