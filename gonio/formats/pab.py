"""PAB-Opto text `.pab`: what the goniophotometers of pab advanced technologies write, a file for every incidence.

Opens in Radiance (`pabopto2bsdf -s isotropic $(cat NAME.pab) > NAME.sir`, then `bsdf2klems` or `bsdf2ttree`; it wants
two incidences or more) and, one at a time, in Tekari.

A file begins with lines of a #: `intheta` and `inphi` of the direction to the light, `upphi` (the azimuth of "up": 90
for +y, our frame; a missing line means 0, a frame turned by 90 degrees), `format` (BSDF, BRDF or BTDF in 1/sr, or DSF,
which is BSDF times cosine) and `colorimetry`, CIE-Y or CIE-XYZ. Then come lines of theta, phi and Y, or X, Y and Z:
angles in degrees, of directions away from the surface, azimuths counter-clockwise from +x, so that light from inphi has
its specular direction at inphi + 180. White is that of equal energy, as in Radiance: a neutral surface has X = Y = Z.

`NAME.pab` lists the files of a set, one name a line, for whoever wants one file; one can make lists of other sets.
Values are the averages over the measurement's own bins, at their centres, so all that is lost are the spectrum, the
errors and what is behind the sixth digit. Between the bins a set is what `table` makes of such lists; transmission is
left out. The header lines `symmetry` and `detector` are ours, and others skip them.

P. Apian-Bennewitz, "Scanning Gonio-Photometers for Asymmetric Acquisition of Fine-structured BSDF", Eurographics
Workshop on Material Appearance Modeling (2014), 1-4, doi:10.2312/mam.20141291.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gonio.brdf import BRDF, NOMINAL, Basis
from gonio.formats.radiance.colours import WHITE
from gonio.formats.scattered.bins import detector_of, incidences
from gonio.formats.scattered.table import Table
from gonio.formats.text import decimal, numbers, padded, title_of
from gonio.measurement import Measurement
from microsurfaces.arrays import Floats

LARGEST = 1 << 30
"""Bytes that the files of a set may have together."""

_MOST_TURNS = 1e6
"""Degrees that an angle may have: beyond, rounding turns it into any other."""


def write(brdf: BRDF, path: Path) -> Sequence[str]:
    """Write a file for every incidence beside `path`, which lists them; in colour if there is more than one channel.

    They are named as `path` with `_theta_i030.0_phi_i000.0` before the suffix. Raises OSError where nothing can be
    written.
    """
    brdf = brdf.in_basis("Y" if len(brdf.wavelengths) == 1 else "XYZ")
    measurement = brdf.measured()
    names, unknown = [], []
    with tempfile.TemporaryDirectory(prefix=f".{path.stem}.", dir=path.parent) as folder:
        for theta_i, phi_i, values, _ in incidences(measurement):
            names.append(f"{path.stem}_theta_i{padded(theta_i)}_phi_i{padded(phi_i)}{path.suffix}")
            unknown.append(np.isnan(values).mean())
            text = _header(brdf, measurement, theta_i, phi_i) + _lines(brdf, phi_i, values)
            (Path(folder) / names[-1]).write_text(text, encoding="utf-8")
        (Path(folder) / path.name).write_text("".join(f"{name}\n" for name in names), encoding="utf-8")
        for name in (*names, path.name):
            (Path(folder) / name).replace(path.parent / name)
    notes = [f"{path.name} lists the files of the {len(names)} incidences, {names[0]} and so on"]
    if np.any(unknown):
        notes.append(f"{np.mean(unknown):.2%} of the bins are not known: they have no line")
    return notes


def _header(brdf: BRDF, measurement: Measurement, theta_i: float, phi_i: float) -> str:
    """What comes before the numbers."""
    title = title_of(brdf.title).replace('"', "'")[:200]
    return f"""#sample_name "{title}"
#colorimetry: CIE-{"Y" if len(brdf.wavelengths) == 1 else "XYZ"}
#format: theta phi BRDF
#intheta {decimal(theta_i)}
#inphi {decimal(phi_i)}
#upphi 90
#symmetry {"isotropic" if brdf.isotropic else "anisotropic"}
#detector {measurement.attributes["detector"]}
"""


def _lines(brdf: BRDF, phi_i: float, values: Floats) -> str:
    """A line for every bin of `values` (rings, sectors, channels) that is known."""
    grid = brdf.detector
    theta, phi = np.meshgrid(grid.theta, (grid.dphi + phi_i) % 360, indexing="ij")
    white = WHITE if values.shape[2] == 3 else np.ones(1)
    rows = np.concatenate([theta[..., None], phi[..., None], values / white], axis=-1).reshape(-1, 2 + values.shape[2])
    rows = rows[np.isfinite(rows).all(axis=1)]
    line = " ".join(["%.6f", "%.6f", *["%.6g"] * values.shape[2]]) + "\n"
    return (line * len(rows)) % tuple(rows.ravel().tolist())


def read(path: Path) -> BRDF:
    """The set that `path` lists, or the one incidence of a data file; Y or XYZ.

    Incidences with a single azimuth count as an isotropic specimen, as for pabopto2bsdf. Raises ValueError for anything
    else.
    """
    try:
        text = _text(path)
        names = [path.name] if _FORMAT.search(text) else _listed(path, text)
        return _joined([_incidence(path.parent / name) for name in names], path.name).to_brdf()
    except (ValueError, OSError) as error:
        raise ValueError(f"{path}: neither a PAB-Opto file nor a list of such files: {title_of(error)}") from None


_FORMAT = re.compile(r"^#[ \t]*format:[ \t]*theta[ \t]+phi[ \t]+(\S+)", re.MULTILINE)


def _text(path: Path) -> str:
    if path.stat().st_size > LARGEST:
        raise ValueError(f"{path.name} is larger than {LARGEST >> 20} MiB")
    return path.read_text(encoding="utf-8", errors="replace")


def _listed(path: Path, text: str) -> list[str]:
    """The files that a list names, all beside it."""
    names = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    here = {file.name: file.stat().st_size for file in path.parent.iterdir() if file.is_file()} if names else {}
    for name in names:
        if name not in here:
            raise ValueError(f"it has no line #format, and there is no file {name[:80]!r} beside it")
    if not names or len(set(names)) < len(names):
        raise ValueError("it has no line #format, and names no files or one twice")
    if sum(here[name] for name in names) > LARGEST:
        raise ValueError(f"its files are larger than {LARGEST >> 20} MiB together")
    return names


@dataclass(frozen=True)
class _Incidence:
    """What one file says."""

    header: str
    theta_i: float
    phi_i: float
    rows: Floats
    """(n, 2 + channels): theta_o and phi_o in degrees, values in 1/sr."""


def _incidence(path: Path) -> _Incidence:
    """The numbers of a file, azimuths from +x."""
    text = _text(path)
    try:
        end = re.search(r"^(?!#)", text, re.MULTILINE)
        header = text[: end.start()] if end else text
        rows = _rows(header, text[len(header) :])
        theta_i, phi_i, turn = _light(header)
        rows[:, 1] += turn
        return _Incidence(header, theta_i, phi_i + turn, rows)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from None


def _noted(header: str, word: str) -> str | None:
    """The text behind a word of the header."""
    found = re.search(rf"^#[ \t]*{word}:?[ \t]+(.*)$", header, re.MULTILINE)
    return found[1].strip() if found else None


def _light(header: str) -> tuple[float, float, float]:
    """theta_i and phi_i, and by how much azimuths have to be turned to count from +x, degrees."""
    light = _noted(header, "incident_angle") or f"{_noted(header, 'intheta')} {_noted(header, 'inphi')}"
    try:
        theta_i, phi_i = (float(angle) for angle in light.split())
        turn = 90 - float(_noted(header, "upphi") or 0)
    except ValueError:
        raise ValueError("it has no lines #intheta, #inphi and #upphi with an angle each") from None
    if not max(abs(theta_i), abs(phi_i), abs(turn)) < _MOST_TURNS:
        raise ValueError(f"light from ({theta_i:g}, {phi_i:g}) is none")
    return theta_i, phi_i, turn


def _rows(header: str, body: str) -> Floats:
    """theta_o, phi_o (not turned yet) and values in 1/sr of the directions above the horizon."""
    kind = _FORMAT.search(header)
    if kind is None or kind[1].upper() not in ("BSDF", "BRDF", "BTDF", "DSF"):
        raise ValueError("it has no line '#format: theta phi' with BSDF, BRDF, BTDF or DSF")
    columns = 5 if (_noted(header, "colorimetry") or "").upper() == "CIE-XYZ" else 3
    values = numbers(body)
    if values.size % columns:
        raise ValueError(f"its numbers do not form lines of {columns}")
    rows = values.reshape(-1, columns)
    rows = rows[np.abs(rows[:, 0]) < 90]
    if kind[1].upper() == "DSF":
        rows[:, 2:] /= np.cos(np.radians(rows[:, :1]))
    return rows


def _joined(incidences: Sequence[_Incidence], name: str) -> Table:
    """The whole set as one list."""
    channels = {found.rows.shape[1] - 2 for found in incidences}
    if len(channels) > 1:
        raise ValueError("some of its files have a colour and some have none")
    basis: Basis = "XYZ" if channels == {3} else "Y"
    rows = np.concatenate([found.rows for found in incidences])
    theta_i, phi_i = (
        np.concatenate([np.full(len(found.rows), angle) for found, angle in zip(incidences, angles, strict=True)])
        for angles in ([found.theta_i for found in incidences], [found.phi_i for found in incidences])
    )
    header = incidences[0].header
    return Table(
        theta_i,
        phi_i,
        rows[:, 0],
        rows[:, 1] - phi_i,
        rows[:, 2:] * (WHITE if basis == "XYZ" else 1.0),
        np.array(NOMINAL[basis]),
        basis=basis,
        isotropic={"isotropic": True, "anisotropic": False}.get(_noted(header, "symmetry") or ""),
        detector=detector_of(_noted(header, "detector")),
        attributes={
            "title": title_of((_noted(header, "sample_name") or "").strip('"')) or Path(name).stem,
            "origin": f"PAB-Opto file {name}",
        },
    )
