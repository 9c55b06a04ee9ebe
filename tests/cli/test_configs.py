"""Every experiment in configs/ runs as it stands, here at toy size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gonio.experiment import Experiment
from microsurfaces import Gaussian

CONFIGS = [
    path for path in sorted((Path(__file__).parents[2] / "configs").glob("*.toml")) if "[sweep]" not in path.read_text()
]
NAMES = {
    "aluminium_klems",
    "cylinders_grooves",
    "cylinders_ridges",
    "flat_mirror",
    "gold_beckmann",
    "height_map",
    "lambertian_rough",
    "reciprocity",
    "silver_anisotropic",
    "v_grooves",
}


def test_none_is_missing() -> None:
    assert {path.stem for path in CONFIGS} >= NAMES


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_it_says_what_it_shows_and_how_to_run_it(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# ")
    assert f"#     gonio run configs/{path.name}\n" in text
    assert Experiment.read(path).title


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_it_runs(path: Path) -> None:
    changes = ["goniometer.paths=512"]
    experiment = Experiment.read(path)
    if experiment.realisations > 1:
        changes.append("realisations=2")
    if isinstance(experiment.surface, Gaussian):
        changes += ["surface.samples=64", "surface.side=128.0"]
    dataset = Experiment.read(path, changes).run().dataset
    shares = [dataset[name] for name in ("escaped", "absorbed", "truncated", "lost")]
    np.testing.assert_allclose(sum(shares).where(dataset["paths"] > 0, 1.0), 1.0, rtol=1e-12)
    assert float(dataset["albedo"].sel(order="all").min()) > 0
    assert np.isfinite(dataset["brdf"]).where(dataset["paths"] > 0, True).all()
