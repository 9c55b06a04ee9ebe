"""Foreign files in and out, one format a file: `FORMATS` maps a name to what writes it and what reads it.

Every format is a pair of functions: `write(brdf, path)` fills a file from a `BRDF`, `read(path)` makes one of a
file, evaluated as the programs that open it do. Reading back what was written tells what the conversion cost.
"""

from __future__ import annotations

import functools
import importlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from numpy.typing import ArrayLike

from gonio import netcdf
from gonio.brdf import BRDF, Function
from gonio.formats.loss import Loss
from gonio.measurement import Measurement
from gonio.models import Model
from microsurfaces.recipe import did_you_mean


@dataclass(frozen=True)
class Format:
    """One foreign format, or one of its variants."""

    title: str
    """What it is and who opens it."""
    suffix: str
    """Of its files, with the dot."""
    module: str
    """The module of `gonio.formats` that has `write` and `read`."""
    options: Mapping[str, object]
    """Further arguments of its `write`."""

    def write(self, brdf: BRDF, path: Path) -> Sequence[str]:
        """Fill `path` from `brdf`; sentences about what had to be bent."""
        notes: Sequence[str] = self._home.write(brdf, path, **self.options)
        return notes

    def read(self, path: Path) -> BRDF:
        """The BRDF in such a file; raises ValueError in one sentence for what is none."""
        brdf: BRDF = self._home.read(path)
        return brdf

    @property
    def page(self) -> str:
        """What the format is and what it keeps, in paragraphs."""
        return self._home.__doc__ or ""

    @property
    def _home(self) -> ModuleType:
        return importlib.import_module(f"gonio.formats.{self.module}")


def _format(title: str, suffix: str, module: str, **options: object) -> Format:
    return Format(title, suffix, module, options)


FORMATS: Mapping[str, Format] = {
    "rgl": _format("RGL/EPFL tensor file, sRGB: Mitsuba 3", ".bsdf", "rgl", colour=True),
    "rgl-spectral": _format("the same, spectral: Mitsuba 3, pbrt-v4", ".bsdf", "rgl", colour=False),
    "merl": _format("MERL, isotropic RGB: BRDF Explorer, ALTA ...", ".binary", "merl"),
    "merl-edge": _format("the same, for programs that interpolate: BSDFProcessor", ".binary", "merl", sample="edge"),
    "klems-full": _format("Klems matrix, 145 patches: Radiance, WINDOW ...", ".xml", "radiance", basis="klems-full"),
    "klems-half": _format("the same, 77 patches", ".xml", "radiance", basis="klems-half"),
    "klems-quarter": _format("the same, 41 patches", ".xml", "radiance", basis="klems-quarter"),
    "tensor3": _format("isotropic tensor tree: Radiance", ".xml", "radiance", basis="tensor3"),
    "tensor4": _format("anisotropic tensor tree: Radiance", ".xml", "radiance", basis="tensor4"),
    "pab": _format("PAB-Opto, a text file per incidence: Radiance, Tekari", ".pab", "pab"),
    "zemax": _format("Zemax OpticStudio table, luminance", ".bsdf", "zemax"),
    "zemax-xyz": _format("the same, tristimulus", ".bsdf", "zemax", colour=True),
    "astm": _format("ASTM E1392 text, as Cornell's: BSDFProcessor", ".astm", "astm"),
    "bird": _format("BiRD universal BRDF, JSON with uncertainties", ".json", "bird"),
    "csv": _format("one line per bin, with errors: pandas, spreadsheets", ".csv", "table_csv"),
    "openmaterial": _format("ASAM OpenMATERIAL 3D look-up table", ".xompt", "openmaterial"),
    "exr": _format("OpenEXR, spectral, bins with errors", ".exr", "exr"),
    "exr-rgb": _format("OpenEXR, linear sRGB, bins", ".exr", "exr", colour=True),
    "exr-disc": _format("OpenEXR, linear sRGB, equal-area disc", ".exr", "exr", colour=True, layout="disc"),
}
"""Every format by name; of those with the same suffix the first is the one that the suffix means."""


@dataclass(frozen=True)
class Exported:
    """What an export wrote, and what it cost."""

    path: Path
    notes: Sequence[str]
    """Sentences about what had to be bent."""
    source: BRDF
    """What the file was filled from."""
    format: Format

    @functools.cached_property
    def loss(self) -> Loss:
        """How far the file, read back, is from the source on the source's own incidences and bins."""
        return Loss.between(self.source, self.format.read(self.path))


def export(
    source: Measurement | BRDF | Model | Function,
    path: str | os.PathLike[str],
    format: str | None = None,
    wavelengths: ArrayLike | None = None,
) -> Exported:
    """Write a measurement, a model, a Python function or any other `BRDF` in a foreign format.

    The suffix of `path` decides, or `format`, a name in `FORMATS`. A model and a function are written for `wavelengths`
    in nm, 450, 550 and 650 if left out. Nothing is left behind if the writing fails. Raises ValueError for a format
    that is not in `FORMATS` or cannot hold this BRDF, OSError where nothing can be written.

    >>> gonio.export(measurement, "gold.exr").loss.sentence()  # doctest: +SKIP
    >>> gonio.export(gonio.CookTorrance(m=0.3, material=gonio.Conductor("Au")), "gold.bsdf")  # doctest: +SKIP
    """
    path = Path(path)
    chosen = FORMATS[_name(path, format)]
    brdf = BRDF.of(source, wavelengths)
    left_out = _left_out(source, brdf) if isinstance(source, Measurement) else ()
    return Exported(path, (*left_out, *chosen.write(brdf, path)), brdf, chosen)


def _left_out(measurement: Measurement, source: BRDF) -> tuple[str, ...]:
    """A sentence about incidences that were asked for and are not exported."""
    left = measurement.measured.size - source.theta_i.size * source.phi_i.size
    return (f"{left} incidences are left out: they, or others of the same theta_i, were not measured.",) if left else ()


def load(path: str | os.PathLike[str], format: str | None = None) -> Measurement:
    """Read a measurement: one that `gonio.save` wrote (.nc), or a foreign file of a format in `FORMATS`.

    The suffix decides, or `format`. Foreign files become measurements without sums and energy budget, sampled at
    incidences and bins that suit them. Raises ValueError in one sentence for anything else.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    suffix = path.suffix.lower()
    readers = [FORMATS[_name(path, format)]] if format else [f for f in FORMATS.values() if f.suffix == suffix]
    if not readers:
        return netcdf.load(path)
    return _read(path, list({reader.module: reader for reader in reversed(readers)}.values())[::-1]).measured()


def _read(path: Path, readers: Sequence[Format]) -> BRDF:
    """What the first of `readers` that knows the file makes of it: formats may share nothing but a suffix."""
    complaints = []
    for reader in readers:
        try:
            return reader.read(path)
        except ValueError as error:
            complaints.append(str(error))
    raise ValueError("; ".join(complaints))


def _name(path: Path, format: str | None) -> str:
    """The format of this name, or the first of this suffix."""
    if format is not None:
        if format not in FORMATS:
            raise ValueError(f"there is no format {format!r}{did_you_mean(format, FORMATS)}: {_choices()}")
        return format
    for name, candidate in FORMATS.items():
        if candidate.suffix == path.suffix.lower():
            return name
    raise ValueError(f"no format has the suffix of {str(path)!r}: {_choices()}; choose one with format (--format)")


def _choices() -> str:
    return "the formats are " + ", ".join(f"{name} ({f.suffix})" for name, f in FORMATS.items())
