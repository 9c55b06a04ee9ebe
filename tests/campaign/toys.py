"""What the tests of campaigns have in common: small campaigns, and what their folders hold."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import gonio
import microsurfaces as ms
from gonio.campaign import results
from gonio.campaign.sweep import Campaign
from gonio.experiment import Experiment

Gonio = Callable[..., tuple[int, str, str]]
"""The fixtures that run `gonio campaign`: exit code, stdout and stderr of some words."""

BASE = """
[experiment]
realisations = 2
[experiment.surface]
kind = "Gaussian"
alpha = 0.3
side = 100.0
samples = 32
[experiment.material]
kind = "Conductor"
name = "Au"
[experiment.goniometer]
theta_i = [0.0, 30.0, 60.0]
paths = 4000
replicates = 4
detector = {kind = "HemisphereGrid", theta_step = 10.0, phi_step = 20.0}
"""

TOY = f"""
title = "Toys"
{BASE}
[sweep]
surface.alpha = [0.2, 0.4]
material.name = ["Au", "Al"]
"""

UNITS = 24
"""Of TOY: 4 experiments, 2 realisations, 3 incidences."""

TINY = gonio.Goniometer(
    theta_i=(0.0, 30.0),
    phi_i=(0.0, 90.0),
    paths=4000,
    replicates=4,
    wavelengths=(450.0, 650.0),
    detector=gonio.HemisphereGrid(theta_step=10.0, phi_step=20.0),
)
ROUGH = ms.Gaussian(alpha=0.3, side=100.0, samples=32)
KLEMS = gonio.Goniometer(paths=512, replicates=4, detector=gonio.Klems("quarter"), target_error=0.1)

KINDS = {
    "several specimens": Experiment(ROUGH, gonio.Conductor("Au"), TINY, realisations=3, seed=5, title="x"),
    "a target": Experiment(ROUGH, gonio.Conductor("Al"), replace(TINY, target_error=0.06), realisations=2),
    "V-grooves": Experiment(ms.VGrooves(m=0.4, grooves=16), gonio.Mirror(), TINY, realisations=2),
    "Klems's patches": Experiment(ROUGH, gonio.Conductor("Au"), KLEMS, realisations=2),
    "a mesh, turned, a wide source": Experiment(
        ms.Cylinders(floor_height=0.0), gonio.Lambertian(0.5), replace(TINY, azimuth="average", beam_half_angle=2.0)
    ),
}


def read(folder: Path, text: str) -> Campaign:
    """The campaign of a TOML file of this text."""
    (folder / "c.toml").write_text(text)
    return Campaign.read(folder / "c.toml")


def half_bad(folder: Path) -> str:
    """A campaign, as TOML, whose second surface cannot be built: the heights of its file, in `folder`, are NaN."""
    np.save(folder / "bad.npy", np.full((4, 4), np.nan))
    bad = '{kind = "HeightFieldFile", path = "bad.npy", periodic = "as is", pixel_size = 1.0, unit = "um"}'
    return f'{BASE}\n[sweep]\nsurface = [{{kind = "Flat"}}, {bad}]'


def content(path: Path) -> dict[str, bytes]:
    """All units, the manifest and what was merged; not what a killed run left half written."""
    chosen = [path / "manifest.json", *path.glob("units/[!.]*"), *path.glob("measurements/[!.]*")]
    return {str(file.relative_to(path)): file.read_bytes() for file in chosen}


def assert_same(path: Path, finished: Path, merged: bool = False) -> None:
    """A folder comes to the same bytes as one process did, if asked for after merging, too."""
    if merged:
        assert results.merge(path).incomplete == 0
    assert {name: bytes_ for name, bytes_ in content(finished).items() if merged or "measurements" not in name} == {
        name: bytes_ for name, bytes_ in content(path).items() if merged or "measurements" not in name
    }


def index(path: Path) -> list[dict[str, str]]:
    """The rows of index.csv."""
    return list(csv.DictReader(io.StringIO((path / "measurements/index.csv").read_text())))
