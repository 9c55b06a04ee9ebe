"""Puts the table of formats into the README: who reads each file back, how far that is from the truth, size and time.

    .venv/bin/python docs/formats_table.py

The source is a measurement without noise: rough gold by Smith's model, 19 incidences, bins of 1 degree, 3 wavelengths.
Errors are those of 2,000 random pairs of directions as the foreign program evaluates the file (lists of bins: of their
entries) against the model itself, where f cos(theta_o) is above 1 % of its largest value. Needs mitsuba, pyradiance.
"""

from __future__ import annotations

import re
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import OpenEXR  # noqa: E402
import test_formats_merl as merl  # noqa: E402
import test_formats_radiance as radiance  # noqa: E402
import test_formats_rgl as rgl  # noqa: E402
import test_formats_text as text  # noqa: E402

import gonio  # noqa: E402
from gonio.brdf import BRDF  # noqa: E402
from gonio.colour import rgb_weights, xyz_weights  # noqa: E402
from gonio.detectors import HemisphereGrid  # noqa: E402
from gonio.formats import FORMATS  # noqa: E402
from gonio.models import Beckmann, Microfacet, SmithCorrelated  # noqa: E402
from gonio.sphere import angles, direction  # noqa: E402

NM = np.array([450.0, 550.0, 650.0])
THETA_I = np.array([*np.arange(0.0, 90.0, 5.0), 87.0])
MODEL = Microfacet(distribution=Beckmann(0.3), masking=SmithCorrelated(), material=gonio.Conductor("Au"))
PAIRS = 2000
START, END = "<!-- docs/formats_table.py -->\n", "<!-- end -->"


def truth(wi, wo):  # type: ignore[no-untyped-def]
    """The model at the three wavelengths, (n, 3)."""
    return MODEL.eval(wi, wo, NM)


def pairs():  # type: ignore[no-untyped-def]
    """Directions within the measured range, even over the hemisphere."""
    rng = np.random.default_rng(7)
    theta = np.degrees(np.arccos(rng.uniform([[0.1], [0.02]], 1.0, (2, PAIRS))))
    wi, wo = direction(theta, rng.uniform(0, 360, (2, PAIRS)))
    return wi, wo


def by_mitsuba(path, wi, wo, spectral):  # type: ignore[no-untyped-def]
    """What Mitsuba finds, and the model, (n, 3) each."""
    found = rgl.theirs(path, wi, wo, [*NM, NM[-1]] if spectral else None)[:, :3] / wo[:, 2:]
    return found, truth(wi, wo) if spectral else truth(wi, wo) @ rgb_weights(NM).T


def by_radiance(path, wi, wo):  # type: ignore[no-untyped-def]
    """What Radiance finds, and the model, (n, 1) each."""
    found, _ = radiance.query(path, wi, wo)
    return found[:, 1:2], truth(wi, wo) @ xyz_weights(NM)[1:2].T


def by_merl_lookup(path, wi, wo):  # type: ignore[no-untyped-def]
    """The bins of a MERL file, and the model, (n, 3) each."""
    content = path.read_bytes()
    found = np.array([merl.stored(content, a, b) for a, b in zip(wi.tolist(), wo.tolist(), strict=True)])
    return found * merl.SCALES, truth(wi, wo) @ rgb_weights(NM).T


def by_zemax_lookup(path, wi, wo):  # type: ignore[no-untyped-def]
    """What a Zemax table says, and the model, (n, 1) each."""
    table = text.Zemax(path)
    channel = "TristimulusY" if "TristimulusY" in table.channels else "Monochrome"
    places = zip(*angles(wi), *angles(wo), strict=True)
    return np.array([[table.value(*place, channel)] for place in places]), truth(wi, wo) @ xyz_weights(NM)[1:2].T


def entries(rows):  # type: ignore[no-untyped-def]
    """Entries of a list of bins and what the model says of these bins; every seventh."""
    theta_i, _, theta_o, dphi, nm, value = np.array(list(rows)[::7]).T
    channel = np.searchsorted(NM, nm - 0.5)
    bins = MEASURED.dataset["brdf"].sel(order="all").values[:, 0]
    row = np.abs(np.subtract.outer(theta_i, THETA_I)).argmin(axis=1)
    ring = np.abs(np.subtract.outer(theta_o, GRID.theta)).argmin(axis=1)
    sector = np.rint(dphi).astype(int) % GRID.shape[1]
    return value[:, None], bins[row, ring, sector, channel][:, None]


def by_openexr(path):  # type: ignore[no-untyped-def]
    """All texels of one wavelength, and the bins, (n, 1) each."""
    part = OpenEXR.File(str(path), separate_channels=True).parts
    images = {p.name(): p.channels for p in part if "error" not in p.name()}
    found = np.stack([images[f"theta_i{t:05.1f}_phi_i000.0"]["T.550nm"].pixels for t in THETA_I])
    bins = MEASURED.dataset["brdf"].sel(order="all", wavelength=550).values[:, 0]
    return found.reshape(-1, 1), np.roll(bins, GRID.shape[1] // 2, axis=2).reshape(-1, 1)


GRID = HemisphereGrid(1.0, 1.0)
MEASURED = BRDF(truth, NM, THETA_I, attributes={"title": "gold"}).sampled(THETA_I, [0.0], GRID)

READERS = {
    "rgl": ("Mitsuba 3 `measured`", lambda path, *pair: by_mitsuba(path, *pair, spectral=False)),
    "rgl-spectral": ("Mitsuba 3 `measured`", lambda path, *pair: by_mitsuba(path, *pair, spectral=True)),
    "merl": ("the published look-up, in the tests", by_merl_lookup),
    "merl-edge": ("the published look-up, in the tests", by_merl_lookup),
    **{name: ("Radiance (pyradiance)", by_radiance) for name, f in FORMATS.items() if f.module == "radiance"},
    "pab": ("Radiance's pabopto2bsdf, in the tests", None),
    "zemax": ("its published rules, in the tests", by_zemax_lookup),
    "zemax-xyz": ("its published rules, in the tests", by_zemax_lookup),
    "astm": ("plain text, in the tests", lambda path, *_: entries(text.rows_of_astm(path))),
    "bird": ("jsonschema; plain JSON", lambda path, *_: entries(text.rows_of_bird(path))),
    "csv": ("Python's csv; pandas", lambda path, *_: entries(text.rows_of_csv(path))),
    "openmaterial": ("jsonschema; plain JSON", lambda path, *_: entries(text.rows_of_xompt(path))),
    "exr": ("OpenEXR", lambda path, *_: by_openexr(path)),
    "exr-rgb": ("OpenEXR, in the tests", None),
    "exr-disc": ("OpenEXR, in the tests", None),
}


def rows():  # type: ignore[no-untyped-def]
    """One line a format."""
    wi, wo = pairs()
    with tempfile.TemporaryDirectory() as folder:
        for name, format in FORMATS.items():
            path = Path(folder) / f"{name}{format.suffix}"
            started = time.perf_counter()
            gonio.export(MEASURED, path, name)
            seconds = time.perf_counter() - started
            size = sum(file.stat().st_size for file in Path(folder).glob(f"{name}*")) / 1e6
            who, read = READERS[name]
            error = errors(*read(path, wi, wo), wo) if read else ("-", "-")
            for file in Path(folder).glob(f"{name}*"):
                file.unlink()
            line = f"| `{name}` | {format.suffix} | {who} | {error[0]} | {error[1]} | {size:.2g} | {seconds:.1f} |"
            print(line, flush=True)
            yield line


def errors(found, expected, wo):  # type: ignore[no-untyped-def]
    """Median and 95th percentile of the relative error, as text."""
    power = expected * (wo[:, 2:] if len(wo) == len(expected) else 1.0)
    bright = power > 0.01 * power.max(axis=0)
    off = np.abs(found / np.where(bright, expected, 1.0) - 1)[bright]
    return [f"{100 * np.quantile(off, q):.2g} %" for q in (0.5, 0.95)]


if __name__ == "__main__":
    head = [
        "| format | suffix | read back by | error, median | error, 95 % | MB | s |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    table = "\n".join([*head, *rows()]) + "\n"
    readme = ROOT / "README.md"
    before = readme.read_text(encoding="utf-8")
    readme.write_text(re.sub(f"{START}.*?{END}", lambda _: START + table + END, before, flags=re.S), encoding="utf-8")
