"""ASTM `.astm`: a list of directions and values as text, which Cornell's measured materials made common.

ASTM E1392 and E2387 standardise how to measure; the file that goes by their name is header lines, then

    NUM_POINTS 32400
    VARS theta_i,phi_i,theta_r,phi_r,450nm,550nm
    0.5235987755982988,0,0.017453292519943295,3.141592653589793,0.31,0.29

Angles are in radians, of directions away from the surface, azimuths counter-clockwise seen from above: light from phi_i
has its specular direction at phi_i + π. Values are f_r in 1/sr, no cosine; columns are wavelengths, or R, G, B (linear
sRGB), or X, Y, Z, or one of any other name. Rows come in any order, and directions need not form a grid. Opened by
BSDFProcessor and every spreadsheet.

Written are the bins' averages at their centres, as the shortest decimals that read back as the same double; the header
lines SYMMETRY (isotropic or anisotropic) and DETECTOR (the bins, as JSON) are ours, and others skip them. What is not
known has no row. Errors are lost. libbsdf, which reads in float32, does not read below 0 and takes missing directions
from their neighbours.

ASTM E1392-96 (2002), E2387-19; S. C. Foo, "A gonioreflectometer for measuring the bidirectional reflectance of material
for use in illumination computation", Cornell University, 1997.
"""

from __future__ import annotations

import io
import itertools
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gonio.brdf import BRDF, NOMINAL, Basis
from gonio.detectors import HemisphereGrid
from gonio.formats.scattered.bins import detector_of, incidences
from gonio.formats.scattered.rows import degrees
from gonio.formats.scattered.table import Table
from gonio.formats.text import frame, radians, title_of
from microsurfaces.arrays import Floats
from microsurfaces.atomic_write import atomic_write

ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")

LARGEST = 1 << 30
"""Bytes that a file may have."""

LONGEST_HEADER = 1 << 24
"""Bytes before the first row."""


def write(brdf: BRDF, path: Path) -> Sequence[str]:
    """Write every bin of every measured incidence whose value is known.

    Raises OSError where the file cannot be written.
    """
    measurement = brdf.measured()
    data = measurement.dataset
    names = brdf.channels
    known = [np.isfinite(values).all(axis=-1) for _, _, values, _ in incidences(measurement)]
    rows, bins = sum(int(here.sum()) for here in known), sum(here.size for here in known)
    with atomic_write(path) as scratch, scratch.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"TITLE {_plain(brdf.title)}\nSOURCE gonio\n")
        file.write(f"SYMMETRY {'isotropic' if brdf.isotropic else 'anisotropic'}\n")
        file.write(f"DETECTOR {measurement.attributes['detector']}\n")
        file.write(f"NUM_POINTS {rows}\nVARS {','.join((*ANGLES, *names))}\n")
        for (theta, phi, values, _), here in zip(incidences(measurement), known, strict=True):
            places = _places(theta, phi, data["theta_o"].values, data["dphi"].values)
            kept = itertools.compress(places, here.ravel().tolist())
            columns = (map(repr, column) for column in values[here].T.tolist())
            file.writelines(f"{','.join(row)}\n" for row in zip(kept, *columns, strict=True))
    return _notes(brdf, bins - rows, bins)


def _plain(text: str) -> str:
    """A title on one line, without the words that end a header."""
    return title_of(text).replace("VARS", "vars").replace("NUM_POINTS", "num_points")


def _places(theta: float, phi: float, rings: Floats, sectors: Floats) -> Iterator[str]:
    """The angles of an incidence's bins, as text."""
    light = f"{radians(theta)},{radians(phi)}"
    polar = [radians(t) for t in rings]
    around = [radians((phi + d) % 360) for d in sectors]
    return (f"{light},{t},{p}" for t, p in itertools.product(polar, around))


def _notes(brdf: BRDF, missing: int, bins: int) -> Sequence[str]:
    notes = []
    if missing:
        notes.append(f"nothing is known of {missing / bins:.1%} of the bins: they have no row")
    if not brdf.isotropic and len(brdf.phi_i) == 1:
        notes.append(
            "one azimuth of the light is known of an anisotropic specimen; programs will take it for isotropic"
        )
    if brdf.measured().dataset["brdf_standard_error"].notnull().any():
        notes.append("the format has no place for standard errors")
    return notes


# --- Reading ---------------------------------------------------------------------------------------------------------


def read(path: Path) -> BRDF:
    """A BRDF from such a list; ours come back exactly.

    Without a header of ours a single azimuth of the light means an isotropic specimen. Raises ValueError in one
    sentence for anything else.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise ValueError(f"it is larger than {LARGEST >> 20} MiB")
        content = path.read_bytes()
        start, about = _header(content)
        rows = _rows(content[start:], len(about["VARS"].split(",")))
        with np.errstate(over="ignore", invalid="ignore"):
            return _table(rows, about, path.name).to_brdf()
    except (ValueError, OSError, OverflowError) as error:
        raise ValueError(f"{path}: not an ASTM file of a BRDF: {title_of(error)}") from None


def _header(content: bytes) -> tuple[int, Mapping[str, str]]:
    """Where the rows begin, and the words of the lines before them with the texts behind."""
    about: dict[str, str] = {}
    start = 0
    for line in io.BytesIO(content[:LONGEST_HEADER]):
        word, *text = line.decode("utf-8", errors="replace").split(maxsplit=1) or [""]
        about[word] = "".join(text).strip()
        start += len(line)
        if word == "VARS":
            return start, about
    raise ValueError("there is no line that begins with VARS")


def _rows(content: bytes, columns: int) -> Floats:
    if not len(ANGLES) < columns < 1000:
        raise ValueError(f"its VARS are {columns}, expected {', '.join(ANGLES)} and up to 995 channels")
    names = range(columns)
    return np.asarray(frame(content, header=None, names=names, usecols=names, skipinitialspace=True).to_numpy())


def _table(rows: Floats, about: Mapping[str, str], name: str) -> Table:
    names = [word.strip() for word in about["VARS"].split(",")]
    if names[: len(ANGLES)] != list(ANGLES):
        raise ValueError(f"its VARS begin with {', '.join(names[:4])}, expected {', '.join(ANGLES)}")
    basis, wavelengths = _channels(names[len(ANGLES) :])
    theta_i, phi_i, theta_r, phi_r = (degrees(column) for column in rows.T[: len(ANGLES)])
    symmetry = about.get("SYMMETRY")
    attributes: dict[str, Any] = {"title": about.get("TITLE") or name, "origin": f"ASTM file {name}"}
    return Table(
        theta_i,
        phi_i,
        theta_r,
        phi_r - phi_i,
        rows[:, len(ANGLES) :],
        wavelengths,
        basis=basis,
        isotropic=symmetry == "isotropic" if symmetry in ("isotropic", "anisotropic") else None,
        detector=_detector(about.get("DETECTOR", "")),
        attributes=attributes,
    )


def _detector(text: str) -> HemisphereGrid | None:
    try:
        return detector_of(json.loads(text))
    except (ValueError, RecursionError):
        return None


def _channels(names: Sequence[str]) -> tuple[Basis, Floats]:
    """What the columns are, and their wavelengths; three of unknown names are R, G, B, as libbsdf has it."""
    if all(re.fullmatch(r"\d+(\.\d+)?nm", name) for name in names):
        return "spectrum", np.array([float(name.removesuffix("nm")) for name in names])
    counted: Mapping[int, Basis] = {1: "Y", 3: "RGB"}
    basis: Basis | None = "XYZ" if list(names) == ["X", "Y", "Z"] else counted.get(len(names))
    if basis is None:
        raise ValueError(f"its channels {', '.join(names)} are neither wavelengths nor colours")
    return basis, np.array(NOMINAL[basis])
