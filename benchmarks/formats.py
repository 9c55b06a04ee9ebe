"""Puts the table of formats into docs/formats.md: who reads each file back, how far that is from the truth, size, time.

    .venv/bin/python benchmarks/formats.py

The source is a measurement without noise: rough gold by Smith's model, 19 incidences, bins of 1 degree, 3 wavelengths.
Errors are those of 2,000 random pairs of directions as the foreign program evaluates the file (lists of bins: of their
entries) against the model itself, where f cos(theta_o) is above 1 % of its largest value. Needs mitsuba, pyradiance.
"""

from __future__ import annotations

import functools
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import OpenEXR

import gonio
from gonio.brdf import BRDF
from gonio.colour import rgb_weights, xyz_weights
from gonio.detectors import HemisphereGrid
from gonio.formats import FORMATS
from gonio.measurement import Measurement
from gonio.models import Beckmann, Microfacet, SmithCorrelated
from gonio.sphere import angles, direction
from microsurfaces.arrays import Floats, Vectors

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "oracles"))

from readers import lists, merl, mitsuba, radiance, zemax  # noqa: E402 - the tests are no package

FILE = ROOT / "docs" / "formats.md"
START, END = "<!-- benchmarks/formats.py -->\n", "<!-- end -->"
HEAD = [
    "| format | suffix | read back by | error, median | error, 95 % | MB | s |",
    "| --- | --- | --- | --- | --- | --- | --- |",
]

NM = np.array([450.0, 550.0, 650.0])
THETA_I = np.array([*np.arange(0.0, 90.0, 5.0), 87.0])
GRID = HemisphereGrid(1.0, 1.0)
MODEL = Microfacet(distribution=Beckmann(0.3), masking=SmithCorrelated(), material=gonio.Conductor("Au"))
PAIRS = 2000

Found = tuple[Floats, Floats]
"""What a reader finds and what the model says, (n, channels) each, 1/sr."""


def truth(wi: Vectors, wo: Vectors) -> Floats:
    """The model at the three wavelengths, (n, 3)."""
    return MODEL.eval(wi, wo, NM)


@functools.cache
def measured() -> Measurement:
    """The model as a measurement without noise."""
    return BRDF(truth, NM, THETA_I, attributes={"title": "gold"}).sampled(THETA_I, [0.0], GRID)


def pairs() -> tuple[Vectors, Vectors]:
    """Directions within the measured range, even over the hemisphere."""
    rng = np.random.default_rng(7)
    theta = np.degrees(np.arccos(rng.uniform([[0.1], [0.02]], 1.0, (2, PAIRS))))
    wi, wo = direction(theta, rng.uniform(0, 360, (2, PAIRS)))
    return wi, wo


# --- Readers ---------------------------------------------------------------------------------------------------------


def by_mitsuba(path: Path, wi: Vectors, wo: Vectors) -> Found:
    """sRGB by Mitsuba's `measured`."""
    return mitsuba.evaluated(path, wi, wo) / wo[:, 2:], truth(wi, wo) @ rgb_weights(NM).T


def by_spectral_mitsuba(path: Path, wi: Vectors, wo: Vectors) -> Found:
    """The wavelengths by Mitsuba's `measured`, which takes four at a time."""
    return mitsuba.evaluated(path, wi, wo, [*NM, NM[-1]])[:, :3] / wo[:, 2:], truth(wi, wo)


def by_radiance(path: Path, wi: Vectors, wo: Vectors) -> Found:
    """The luminance by Radiance."""
    found, _ = radiance.query(path, wi, wo)
    return found[:, 1:2], luminance(wi, wo)


def by_merl_lookup(path: Path, wi: Vectors, wo: Vectors) -> Found:
    """The bins of a MERL file."""
    content = path.read_bytes()
    found = np.array([merl.stored(content, *pair) for pair in zip(wi.tolist(), wo.tolist(), strict=True)])
    return found * merl.SCALES, truth(wi, wo) @ rgb_weights(NM).T


def by_zemax_lookup(path: Path, wi: Vectors, wo: Vectors) -> Found:
    """The luminance that a Zemax table says."""
    table = zemax.Zemax(path)
    channel = "TristimulusY" if "TristimulusY" in table.channels else "Monochrome"
    places = zip(*angles(wi), *angles(wo), strict=True)
    return np.array([[table.value(*place, channel)] for place in places]), luminance(wi, wo)


def luminance(wi: Vectors, wo: Vectors) -> Floats:
    """CIE Y of the model, (n, 1)."""
    return truth(wi, wo) @ xyz_weights(NM)[1:2].T


def entries(rows: Iterable[tuple[float, ...]]) -> Found:
    """Every seventh entry of a list of bins, and what the model says of these bins."""
    theta_i, _, theta_o, dphi, nm, value = np.array(list(rows)[::7]).T
    channel = np.searchsorted(NM, nm - 0.5)
    bins = measured().dataset["brdf"].sel(order="all").values[:, 0]
    row = np.abs(np.subtract.outer(theta_i, THETA_I)).argmin(axis=1)
    ring = np.abs(np.subtract.outer(theta_o, GRID.theta)).argmin(axis=1)
    sector = np.rint(dphi).astype(int) % GRID.shape[1]
    return value[:, None], bins[row, ring, sector, channel][:, None]


def by_openexr(path: Path) -> Found:
    """All texels of one wavelength, and the bins."""
    part = OpenEXR.File(str(path), separate_channels=True).parts
    images = {p.name(): p.channels for p in part if "error" not in p.name()}
    found = np.stack([images[f"theta_i{t:05.1f}_phi_i000.0"]["T.550nm"].pixels for t in THETA_I])
    bins = measured().dataset["brdf"].sel(order="all", wavelength=550).values[:, 0]
    return found.reshape(-1, 1), np.roll(bins, GRID.shape[1] // 2, axis=2).reshape(-1, 1)


READERS: dict[str, tuple[str, Callable[..., Found] | None]] = {
    "rgl": ("Mitsuba 3 `measured`", by_mitsuba),
    "rgl-spectral": ("Mitsuba 3 `measured`", by_spectral_mitsuba),
    "merl": ("the published look-up, in the tests", by_merl_lookup),
    "merl-edge": ("the published look-up, in the tests", by_merl_lookup),
    **{name: ("Radiance (pyradiance)", by_radiance) for name, f in FORMATS.items() if f.module == "radiance"},
    "pab": ("Radiance's pabopto2bsdf, in the tests", None),
    "zemax": ("its published rules, in the tests", by_zemax_lookup),
    "zemax-xyz": ("its published rules, in the tests", by_zemax_lookup),
    "astm": ("plain text, in the tests", lambda path, *_: entries(lists.rows_of_astm(path))),
    "bird": ("jsonschema; plain JSON", lambda path, *_: entries(lists.rows_of_bird(path))),
    "csv": ("Python's csv; pandas", lambda path, *_: entries(lists.rows_of_csv(path))),
    "openmaterial": ("jsonschema; plain JSON", lambda path, *_: entries(lists.rows_of_xompt(path))),
    "exr": ("OpenEXR", lambda path, *_: by_openexr(path)),
    "exr-rgb": ("OpenEXR, in the tests", None),
    "exr-disc": ("OpenEXR, in the tests", None),
}
"""For each format who reads it back, and how that is done here."""


# --- The table -------------------------------------------------------------------------------------------------------


def rows() -> Iterator[str]:
    """One line a format."""
    wi, wo = pairs()
    for name, format in FORMATS.items():
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{name}{format.suffix}"
            started = time.perf_counter()
            gonio.export(measured(), path, name)
            seconds = time.perf_counter() - started
            size = sum(file.stat().st_size for file in Path(folder).iterdir()) / 1e6
            who, read = READERS[name]
            median, high = errors(*read(path, wi, wo), wo) if read else ("-", "-")
        line = f"| `{name}` | {format.suffix} | {who} | {median} | {high} | {size:.2g} | {seconds:.1f} |"
        print(line, flush=True)
        yield line


def errors(found: Floats, expected: Floats, wo: Vectors) -> tuple[str, str]:
    """Median and 95th percentile of the relative error, as text."""
    power = expected * (wo[:, 2:] if len(wo) == len(expected) else 1.0)
    bright = power > 0.01 * power.max(axis=0)
    off = np.abs(found / np.where(bright, expected, 1.0) - 1)[bright]
    median, high = (f"{100 * np.quantile(off, q):.2g} %" for q in (0.5, 0.95))
    return median, high


if __name__ == "__main__":
    measured()  # not to be timed with the first format
    table = "\n".join([*HEAD, *rows()]) + "\n"
    before = FILE.read_text(encoding="utf-8")
    FILE.write_text(re.sub(f"{START}.*?{END}", lambda _: START + table + END, before, flags=re.S), encoding="utf-8")
