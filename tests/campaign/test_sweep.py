"""What a sweep means: which experiments a campaign file asks for."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toys import BASE, read

import microsurfaces as ms
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan
from gonio.toml_files import InputError


def values(tmp_path: Path, text: str, *keys: str) -> list[Any]:
    """The values of some keys at every point of a sweep."""
    points = read(tmp_path, f"{BASE}\n{text}").parameters
    return [tuple(point[key] for key in keys) if len(keys) > 1 else point[keys[0]] for point in points]


def test_axes_are_crossed_and_the_first_varies_slowest(toy: Campaign) -> None:
    assert [(e.surface.alpha, e.material.name) for e in toy.experiments] == [
        (0.2, "Au"), (0.2, "Al"), (0.4, "Au"), (0.4, "Al")
    ]  # fmt: skip
    assert toy.parameters[1] == {"surface.alpha": 0.2, "material.name": "Al"}
    assert toy.title == "Toys"
    assert {e.goniometer.paths for e in toy.experiments} == {4000}


@pytest.mark.parametrize(
    ("key", "spec", "expected"),
    [
        ("surface.alpha", "{start = 0.1, stop = 0.5, step = 0.1}", [0.1, 0.2, 0.3, 0.4, 0.5]),
        ("surface.alpha", "{start = 0.5, stop = 0.15, step = -0.2}", [0.5, 0.3]),
        ("seed", "{start = 3, stop = 9, step = 2}", [3, 5, 7, 9]),
        ("surface.alpha", "{from = 0.1, to = 0.4, count = 4}", [0.1, 0.2, 0.3, 0.4]),
        ("surface.alpha", '{from = 0.01, to = 0.1, count = 3, scale = "log"}', [0.01, 0.03162278, 0.1]),
        ("seed", "{from = 1, to = 5, count = 3}", [1, 3, 5]),
        ("surface.samples", '{from = 16, to = 64, count = 3, scale = "log"}', [16, 32, 64]),
    ],
)
def test_ranges_hold_the_numbers_one_would_write(tmp_path: Path, key: str, spec: str, expected: list[Any]) -> None:
    found = values(tmp_path, f"[sweep]\n{key} = {spec}", key)
    assert found == expected
    assert [type(value) for value in found] == [type(value) for value in expected]


def test_zipped_axes_step_together_and_are_crossed_with_the_rest(tmp_path: Path) -> None:
    text = """[sweep]
    seed = [1, 2]
    [sweep.size]
    zip = true
    "surface.side" = [100.0, 200.0, 400.0]
    surface.samples = [32, 64, 128]"""
    found = values(tmp_path, text, "seed", "surface.side", "surface.samples")
    sizes = [(100.0, 32), (200.0, 64), (400.0, 128)]
    assert found == [(seed, *size) for seed in (1, 2) for size in sizes]


def test_a_group_called_surface_is_of_the_surface(tmp_path: Path) -> None:
    text = "[sweep.surface]\nzip = true\nside = [100.0, 200.0]\nsamples = [32, 64]"
    assert values(tmp_path, text, "surface.side", "surface.samples") == [(100.0, 32), (200.0, 64)]


def test_a_random_design_is_reproduced_and_longer_ones_begin_with_it(tmp_path: Path) -> None:
    def drawn(count: int, seed: int, more: str = "") -> list[Any]:
        text = f"""[sweep]
        random = {{count = {count}, seed = {seed}}}
        {more}
        surface.alpha = {{from = 0.05, to = 0.8, scale = "log"}}
        surface.samples = {{from = 30, to = 33}}
        material.name = ["Au", "Al", "Cu"]"""
        return values(tmp_path, text, "surface.alpha", "surface.samples", "material.name")

    many = drawn(300, 1)
    assert drawn(40, 1) == many[:40]
    assert drawn(40, 1, "seed = {start = 1, stop = 9, step = 1}") == many[:40]
    assert drawn(40, 2) != many[:40]
    alphas = np.log([alpha for alpha, *_ in many])
    low, high = np.log(0.05), np.log(0.8)
    # Mean and range of a uniform distribution: 300 values, four standard errors.
    assert abs(alphas.mean() - (low + high) / 2) < 4 * (high - low) / np.sqrt(12 * 300)
    assert low <= alphas.min() < low + 0.1 * (high - low)
    for column, count in ((1, 4), (2, 3)):
        found = Counter(point[column] for point in many)
        assert len(found) == count
        assert min(found.values()) > 300 / count - 4 * np.sqrt(300 / count)
    assert set(Counter(point[1] for point in many)) == {30, 31, 32, 33}
    together = np.corrcoef(alphas, [samples for _, samples, _ in many])[0, 1]
    assert abs(together) < 4 / np.sqrt(300)  # each parameter by itself


def test_tables_and_base_files_are_swept_and_files_are_found_beside(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    np.save(tmp_path / "data/a.npy", np.zeros((4, 4)))
    text = BASE.replace("[experiment]", "").replace("experiment.", "")
    (tmp_path / "data/base.toml").write_text(text)
    campaign = read(
        tmp_path,
        """base = "data/base.toml"
        [sweep]
        surface = [{kind = "Flat"}, {kind = "HeightFieldFile", path = "data/a.npy", periodic = "as is", """
        """pixel_size = 1.0, unit = "um"}]""",
    )
    flat, mapped = campaign.experiments
    assert isinstance(flat.surface, ms.Flat)
    assert mapped.surface.path == str(tmp_path / "data/a.npy")
    assert mapped.goniometer.paths == 4000


def test_a_list_of_experiments_is_a_campaign_of_what_differs(toy: Campaign) -> None:
    campaign = Campaign.of(toy.experiments)
    assert campaign.parameters == toy.parameters
    assert Plan.of(campaign).units == Plan.of(toy).units


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[sweep]\nsurface.alpha = [-1.0]", "surface.alpha = -1.0: must be greater than 0"),
        ("[sweep]\nsurface.alhpa = [1.0]", "surface.alhpa: Gaussian has no such parameter; did you mean alpha?"),
        ("[sweep]\nsurface.alpha = 0.3", "sweep.surface.alpha = 0.3: must be a list of values"),
        ("[sweep]\nsurface.alpha = []", "sweep.surface.alpha = []: must be a list of values"),
        ("[sweep]\nseed = {start = 1, stop = 5, step = -1}", "sweep.seed.step = -1: does not lead"),
        ("[sweep]\nseed = {start = 1, stop = 5}", "sweep.seed = {start = 1, stop = 5}: must be"),
        ("[sweep]\nseed = {from = 1, to = 5, count = 0}", "sweep.seed.count = 0: must be a whole number"),
        ('[sweep]\nsurface.alpha = {from = 0, to = 1, count = 5, scale = "log"}', "sweep.surface.alpha.scale"),
        ("[sweep]\nzip = true\nseed = [1, 2]\nsurface.alpha = [0.1]", "seed has 2, surface.alpha has 1"),
        ("[sweep]\nseed = [1]\n[sweep.x]\nzip = true\nseed = [2]", "seed is swept twice"),
        ("[sweep]\nrandom = 5\nsurface.alpha = {from = 0.1, to = 0.2}", "sweep.random = 5: must be a table such as"),
        ("[sweep]\nseed = {start = 0, stop = 1_000_000, step = 1}", "1000001 values are too many"),
        (
            "[sweep]\n" + "\n".join(f"{k} = {{from = 1, to = 999, count = 999}}" for k in ("seed", "realisations")),
            "998001 experiments are more than 100000",
        ),
        ("[sweep]\nseed.x = [1]", "sweep.seed.x: seed is a value"),
        ("[swep]\nseed = [1]", "swep: a campaign has no such key; did you mean sweep?"),
        ("base = 'x.toml'", "one of them"),
    ],
)
def test_a_mistake_is_one_sentence_with_its_key(tmp_path: Path, text: str, words: str) -> None:
    base = BASE.replace("realisations = 2", "seed = 0") if "seed.x" in text else BASE
    whole = text + base if text.startswith("base") else base + text
    with pytest.raises(InputError) as error:
        read(tmp_path, whole)
    assert words in str(error.value)
    assert len(error.value.sentences) == 1


def test_an_experiment_is_told_from_a_campaign() -> None:
    path = Path(__file__).parents[2] / "configs/flat_mirror.toml"
    with pytest.raises(InputError, match=r'is an experiment: gonio run .* base = "flat_mirror\.toml"'):
        Campaign.read(path)
