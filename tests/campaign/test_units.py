"""Units of work: put together they are the measurement, and their names say what they compute."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toys import KINDS, ROUGH, TINY, UNITS, assert_same

import gonio
import microsurfaces as ms
from gonio.campaign import results, running, units
from gonio.campaign.running import ThisProcess
from gonio.campaign.status import status
from gonio.campaign.store import CampaignStore
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan
from gonio.experiment import Experiment
from gonio.toml_files import InputError


@pytest.mark.parametrize("kind", KINDS)
def test_merged_units_are_the_file_that_the_experiment_gives(kind: str, tmp_path: Path) -> None:
    experiment = KINDS[kind]
    state = running.run(Campaign.of([experiment]), tmp_path / "c")
    assert not state.failures
    (file,) = results.merge(tmp_path / "c").files
    direct = experiment.run()
    if experiment.goniometer.target_error is not None:
        assert int(direct.dataset["replicates"].max()) > experiment.goniometer.replicates
    assert file.read_bytes() == gonio.save(direct, tmp_path / "direct.nc").read_bytes()


@pytest.mark.parametrize("replicates", [4, 16, 18])
def test_a_large_measurement_is_cut_into_blocks_of_replicates(
    replicates: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = Experiment(ROUGH, gonio.Conductor("Au"), replace(TINY, replicates=replicates), realisations=2)
    whole = Plan.of(Campaign.of([experiment]))
    monkeypatch.setattr(units, "BLOCK_PATHS", 1000)
    plan = Plan.of(Campaign.of([experiment]))
    blocks = {4: 1, 16: 4, 18: 4}[replicates]
    assert len(plan.units[0]) == 2 * 4 * blocks
    assert sum(unit.paths for unit in plan.units[0]) == sum(unit.paths for unit in whole.units[0])
    for part in (1, 2, 3):
        running.run(Campaign.of([experiment]), tmp_path / "c", shard=(part, 3))
    (file,) = results.merge(tmp_path / "c").files
    assert file.read_bytes() == gonio.save(experiment.run(), tmp_path / "direct.nc").read_bytes()
    found = status(CampaignStore(tmp_path / "c"))
    assert found.paths == found.paths_finished == sum(unit.paths for unit in whole.units[0])


def test_the_number_of_threads_changes_no_byte(toy: Campaign, finished: Path, tmp_path: Path) -> None:
    running.run(toy, tmp_path, ThisProcess(3))
    assert_same(tmp_path, finished)


def test_seven_shards_give_what_one_process_does(toy: Campaign, finished: Path, tmp_path: Path) -> None:
    states = [running.run(toy, tmp_path, shard=(number, 7)) for number in (3, 1, 7, 2, 6, 5, 4)]
    assert sum(state.computed for state in states) == UNITS
    assert max(state.computed for state in states) <= 4
    assert_same(tmp_path, finished, merged=True)


@pytest.mark.parametrize("shards", [1, 3, 7, 50])
def test_shards_are_a_partition_that_keeps_pilots_and_reliefs_together(shards: int, toy: Campaign) -> None:
    campaign = Campaign.of([*toy.experiments, KINDS["a target"], KINDS["several specimens"]])
    plan = Plan.of(campaign)
    parts = [plan.shard(number, shards) for number in range(1, shards + 1)]
    names = [unit.name for part in parts for unit in part]
    assert len(names) == len(set(names))
    assert set(names) == {unit.name for group in plan.units for unit in group}
    for part in parts:
        assert all(unit.pilot in {other.name for other in part} for unit in part if unit.pilot)
    if shards == 3:
        work = [sum(unit.paths for unit in part) for part in parts]
        assert max(work) - min(work) <= 5 * 4000


def test_each_relief_is_built_once(toy: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four reliefs (two slopes, two realisations) serve 24 units of two materials."""
    build, built = ms.Gaussian.build, list[tuple[float, int]]()

    def counted(self: ms.Gaussian, seed: int, realisation: int, realisations: int) -> ms.HeightField:
        built.append((self.alpha, realisation))
        return build(self, seed, realisation, realisations)

    monkeypatch.setattr(ms.Gaussian, "build", counted)
    running.run(toy, tmp_path)
    assert len(built) == len(set(built)) == 4


# --- What a unit's name says -----------------------------------------------------------------------------------------


def names(experiment: Experiment) -> list[str]:
    return [unit.name for unit in Plan.of(Campaign.of([experiment])).units[0]]


def test_a_name_depends_on_what_decides_the_numbers_and_on_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    base = KINDS["several specimens"]
    known = names(base)
    assert len(known) == len(set(known)) == 12
    for same in (replace(base, title="other"), replace(base, models=("cook-torrance",))):
        assert names(same) == known
    longer = replace(base, realisations=4, goniometer=replace(TINY, theta_i=(0.0, 20.0, 30.0)))
    assert set(known) < set(names(longer))
    others = [
        replace(base, seed=6),
        replace(base, surface=replace(ROUGH, alpha=0.31)),
        replace(base, material=gonio.Conductor("Al")),
        replace(base, goniometer=replace(TINY, paths=4004)),
        replace(base, goniometer=replace(TINY, orders=4)),
    ]
    for other in others:
        assert not set(known) & set(names(other))
    grooves = KINDS["V-grooves"]
    assert not set(names(grooves)) & set(names(replace(grooves, realisations=3)))
    monkeypatch.setattr(units, "versions", lambda: {"gonio": "other"})
    assert not set(known) & set(names(base))


def test_a_file_stands_for_its_content_wherever_it_is(tmp_path: Path) -> None:
    def mapped(name: str, heights: np.ndarray) -> list[str]:
        np.save(tmp_path / name, heights)
        surface = ms.HeightFieldFile(path=str(tmp_path / name), periodic="as is", pixel_size=1.0, unit="um")
        return names(Experiment(surface, gonio.Mirror(), TINY))

    flat, rough = np.zeros((4, 4)), np.eye(4)
    known = mapped("a.npy", flat)
    assert mapped("b.npy", flat) == known
    assert not set(mapped("a.npy", rough)) & set(known)


def test_a_longer_campaign_keeps_the_units_of_the_shorter(copied: Path, toy: Campaign) -> None:
    longer = Campaign.of([replace(experiment, realisations=3) for experiment in toy.experiments])
    state = running.run(longer, copied)
    assert (state.kept, state.computed, state.changed) == (UNITS, UNITS // 2, True)
    merged = results.merge(copied)
    assert [int(gonio.load(file).dataset["realisations"].max()) for file in merged.files] == [3] * 4
    assert len(list(copied.glob("measurements/*.nc"))) == 8


def test_another_version_is_refused(copied: Path, toy: Campaign) -> None:
    manifest = json.loads((copied / "manifest.json").read_text())
    manifest["versions"]["numba"] = "0.1"
    (copied / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=r"was begun with other versions.*numba 0.1, now"):
        running.run(toy, copied)
