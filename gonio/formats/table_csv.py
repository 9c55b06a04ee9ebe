"""CSV: a row for every bin and wavelength, for spreadsheets, pandas, R, MATLAB, and other people's measurements.

**Written.** A commented header (lines that start with `#`: title, units, the angles, and everything that is known about
the measurement as JSON on the line `# gonio.json`), the names of the columns, then the rows:

    theta_i, phi_i       direction to the light, degrees
    theta_o, phi_o       direction to the detector, degrees, absolute
    dphi                 phi_o - phi_i: 0 on the source side, 180 on the specular side
    wavelength           nm; a nominal one where channels are colours (`basis` in the JSON says so)
    brdf                 average over the bin, 1/sr, all orders of scattering, no cosine; empty where unknown
    brdf_standard_error  1/sr; the column is missing if no error is known
    count                paths that arrived in the bin; the column is missing if they were not counted

Azimuths run counter-clockwise seen from above, from the x axis. Angles belong to the centres of the bins. Numbers are
the shortest decimals that read back as the same double: nothing is lost. `pandas.read_csv(path, comment="#")` reads it;
Excel shows the first 1 048 576 rows only.

**Read.** Any order of columns and rows, any further columns, commas, or semicolons with decimal commas, or tabs.
Without phi_i the light comes from azimuth 0; either of dphi and phi_o is enough; without wavelength there is a single
channel; brdf_standard_error may be missing. Angles need not form a grid: see `gonio.formats.scattered`.
"""

from __future__ import annotations

import codecs
import io
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gonio.brdf import BRDF
from gonio.formats.scattered.bins import detector_of, incidences
from gonio.formats.scattered.table import Table
from gonio.formats.text import decimal, frame, title_of
from microsurfaces.arrays import Floats
from microsurfaces.atomic_write import atomic_write

COLUMNS = ("theta_i", "phi_i", "theta_o", "phi_o", "dphi", "wavelength", "brdf", "brdf_standard_error")
"""What is read; all but theta_i, theta_o, brdf and one of phi_o and dphi may be missing."""

COMMENTS = (
    "BRDF in 1/sr (no cosine), average over bins centred on (theta_o, dphi); angles in degrees, wavelengths in nm",
    "theta from the normal, phi counter-clockwise from x; dphi = phi_o - phi_i: 0 source side, 180 specular side",
)

EXCEL_ROWS = 1_048_576

LARGEST = 1 << 30
"""Bytes that a file may have."""

LONGEST_HEADER = 1 << 24
"""Bytes before the first row."""


def write(brdf: BRDF, path: Path) -> Sequence[str]:
    """Write every bin of every measured incidence, with its standard error and count where they are known.

    Raises OSError where the file cannot be written.
    """
    measurement = brdf.measured()
    data = measurement.dataset.sel(order="all")
    count = data["count"].values if "count" in data else None
    known = bool(data["brdf_standard_error"].notnull().any())
    names = [*COLUMNS[:7], *COLUMNS[7:][: int(known)], *(["count"] if count is not None else [])]
    rows = 0
    with atomic_write(path) as scratch, scratch.open("w", encoding="utf-8", newline="\n") as file:
        file.write("".join(f"# {line}\n" for line in _comments(brdf)) + ",".join(names) + "\n")
        for (i, j), (theta, phi, values, errors) in zip(
            np.argwhere(measurement.measured), incidences(measurement), strict=True
        ):
            columns = [_places(theta, phi, data, brdf.wavelengths), _texts(values)]
            if known:
                columns.append(_texts(errors))
            if count is not None:
                columns.append(np.repeat(count[i, j], len(brdf.wavelengths)).astype(str).tolist())
            file.write("\n".join(map(",".join, zip(*columns, strict=True))) + "\n")
            rows += values.size
    if rows >= EXCEL_ROWS:
        return (f"it has {rows} rows, of which Excel shows the first {EXCEL_ROWS - 1}; pandas reads them all",)
    return ()


def _comments(brdf: BRDF) -> Sequence[str]:
    provenance = {key: value if isinstance(value, str) else str(value) for key, value in brdf.attributes.items()}
    about = {
        "title": brdf.title,
        "basis": brdf.basis,
        "isotropic": bool(brdf.isotropic),
        "detector": json.loads(brdf.measured().attributes["detector"]),
        "provenance": provenance,
    }
    named = zip(brdf.channels, brdf.wavelengths, strict=True)
    channels = () if brdf.basis == "spectrum" else (", ".join(f"{name} at wavelength {nm:g}" for name, nm in named),)
    return (title_of(brdf.title), *COMMENTS, *channels, f"gonio.json {json.dumps(about)}")


def _places(theta: float, phi: float, data: Any, wavelengths: Floats) -> list[str]:
    """The first six columns of an incidence's rows."""
    light = f"{decimal(theta)},{decimal(phi)}"
    rings = [decimal(t) for t in data["theta_o"].values]
    around = [f"{decimal((phi + d) % 360)},{decimal(d)}" for d in data["dphi"].values]
    colours = [decimal(nm) for nm in wavelengths]
    return [f"{light},{t},{a},{nm}" for t, a, nm in itertools.product(rings, around, colours)]


def _texts(values: Floats) -> list[str]:
    """Shortest decimals; nothing for what is not known."""
    return ["" if text == "nan" else text for text in map(repr, values.ravel().tolist())]


# --- Reading ---------------------------------------------------------------------------------------------------------


def read(path: Path) -> BRDF:
    """A BRDF from a table with these columns; ours come back exactly, with their errors.

    Raises ValueError in one sentence for anything else.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise ValueError(f"it is larger than {LARGEST >> 20} MiB")
        content = path.read_bytes()
        start, about = _header(content)
        with np.errstate(over="ignore", invalid="ignore"):
            return _table(_columns(content[start:]), about, path.name).to_brdf()
    except (ValueError, OSError, OverflowError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: not a CSV file of a BRDF: {title_of(error)}") from None


def _header(content: bytes) -> tuple[int, Mapping[str, Any]]:
    """Where the names of the columns begin, and what the comments before them tell."""
    about: Mapping[str, Any] = {}
    start = len(codecs.BOM_UTF8) * content.startswith(codecs.BOM_UTF8)
    for line in io.BytesIO(content[start:LONGEST_HEADER]):
        if line.startswith(b"# gonio.json "):
            about = _about(line.removeprefix(b"# gonio.json "))
        if line.strip() and not line.startswith(b"#"):
            return start, about
        start += len(line)
    raise ValueError("there is no line with the names of its columns")


def _about(text: bytes) -> Mapping[str, Any]:
    """What we wrote about a table; nothing if it is damaged."""
    try:
        about = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return about if isinstance(about, dict) else {}


def _table(columns: Mapping[str, Floats], about: Mapping[str, Any], name: str) -> Table:
    theta_o = columns["theta_o"]
    phi_i = columns.get("phi_i", np.zeros_like(theta_o))
    dphi = columns["dphi"] if "dphi" in columns else columns["phi_o"] - phi_i
    table = Table.of_rows(
        columns["theta_i"],
        phi_i,
        theta_o,
        dphi,
        columns.get("wavelength", np.full_like(theta_o, 555.0)),
        columns["brdf"],
        columns.get("brdf_standard_error"),
        isotropic=_flag(about.get("isotropic")),
        detector=detector_of(about.get("detector")),
        attributes=_attributes(about, name),
    )
    return table.in_colours(about.get("basis") if "wavelength" in columns else "Y")


def _flag(value: object) -> bool | None:
    return value if isinstance(value, bool) else None


def _columns(content: bytes) -> dict[str, Floats]:
    """The columns that we know, as numbers; NaN where a field is empty."""
    names = content[: content.find(b"\n")].decode("utf-8", errors="replace")
    separator = max(",;\t", key=names.count)
    table = frame(
        content,
        sep=separator,
        decimal="," if separator == ";" else ".",
        usecols=lambda name: _plain(name) in COLUMNS,
        skipinitialspace=True,
        comment="#",
    )
    columns = {_plain(name): table[name].to_numpy() for name in table.columns}
    missing = [name for name in ("theta_i", "theta_o", "brdf") if name not in columns]
    if "dphi" not in columns and "phi_o" not in columns:
        missing.append("dphi or phi_o")
    if missing:
        raise ValueError(f"the columns {', '.join(missing)} are missing, or their names")
    return columns


def _plain(name: object) -> str:
    return str(name).strip().strip('"').lower()


def _attributes(about: Mapping[str, Any], name: str) -> dict[str, Any]:
    provenance = about.get("provenance")
    known = provenance if isinstance(provenance, dict) else {}
    kept = {key: str(known[key]) for key in ("experiment",) if key in known}
    return {"title": title_of(about.get("title", name)), **kept, "origin": f"CSV file {name}"}
