"""The forecast of a campaign is held to the campaign itself, its interpolation to straight lines."""

from __future__ import annotations

import json
import os
import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toys import BASE, KINDS, TOY, Gonio, assert_same, half_bad, read

import gonio
from gonio.campaign import planning, results, running
from gonio.campaign.planning import Forecast, Sample, plan
from gonio.campaign.processes import ProcessPool
from gonio.campaign.status import seconds_left
from gonio.campaign.store import CampaignStore
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan
from gonio.toml_files import InputError

UNITS = 12
"""Of the toy here: 2 slopes, 2 realisations, 3 incidences."""


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Half of TOY, with more paths than the pilots of this file have."""
    text = TOY.replace("paths = 4000", "paths = 40_000").replace('["Au", "Al"]', '["Au"]')
    return read(tmp_path_factory.mktemp("toy"), text)


@pytest.fixture(scope="module")
def forecast(toy: Campaign) -> Forecast:
    """Of TOY, by half of its paths: with fewer, stratified starts on so small a patch gain more than the root tells."""
    return plan(toy, pilot=20_000)


def with_goniometers(campaign: Campaign, **changes: object) -> Campaign:
    """The campaign with other instruments."""
    changed = [replace(e, goniometer=replace(e.goniometer, **changes)) for e in campaign.experiments]
    return replace(campaign, experiments=tuple(changed))


# --- The forecast and what came true ---------------------------------------------------------------------------------


def test_a_forecast_comes_true(toy: Campaign, forecast: Forecast, tmp_path: Path) -> None:
    """Bins are many; of an albedo four replicates tell the error no better than to a factor of two or three."""
    assert (forecast.experiments, forecast.units, forecast.reliefs) == (2, UNITS, 4)
    assert forecast.paths == forecast.paths_needed == UNITS * 40_000
    assert {sample.paths for sample in forecast.pilots} == {20_000}
    running.run(toy, tmp_path)
    size = sum(file.stat().st_size for file in tmp_path.glob("units/*.npz"))
    assert forecast.units_bytes == pytest.approx(size, rel=0.15)
    files = results.merge(tmp_path).files
    assert forecast.merged_bytes == pytest.approx(sum(file.stat().st_size for file in files), rel=0.15)
    bins = [error_of(file) for file in files]
    assert forecast.bin_error == pytest.approx((np.median(bins), max(bins)), rel=0.2)
    albedos = [gonio.load(file).dataset.sel(order="all") for file in files]
    errors = [float((a["albedo_standard_error_mc"] / a["albedo"]).max()) * np.sqrt(2) for a in albedos]
    assert max(errors) / 3 < forecast.albedo_error[1] < 3 * max(errors)


def error_of(file: Path) -> float:
    """The error that half of the light has at the worst incidence and wavelength, of one of two specimens."""
    measured = gonio.load(file)
    found = measured.dataset.sel(order="all", phi_i=0.0)
    solid = measured.detector.projected_solid_angles().reshape(found["brdf"].shape[1:3])
    errors = []
    for theta in found["theta_i"]:
        for wavelength in found["wavelength"]:
            here = found.sel(theta_i=theta, wavelength=wavelength)
            value, error = here["brdf"].values, here["brdf_standard_error_mc"].values * np.sqrt(2)
            lit = value > 0
            relative, light = (error[lit] / value[lit]), (value * solid)[lit]
            order = np.argsort(relative)
            cumulative = np.cumsum(light[order])
            errors.append(relative[order][np.searchsorted(cumulative, cumulative[-1] / 2)])
    return float(max(errors))


def test_four_times_the_paths_halve_the_errors(toy: Campaign, forecast: Forecast) -> None:
    more = again(with_goniometers(toy, paths=160_000), forecast)
    assert more.bin_error == pytest.approx([error / 2 for error in forecast.bin_error], rel=1e-9)
    assert more.albedo_error == pytest.approx([error / 2 for error in forecast.albedo_error], rel=1e-9)
    assert more.paths == 4 * forecast.paths


def test_a_target_is_reached_or_out_of_reach(toy: Campaign, forecast: Forecast) -> None:
    """As long as a replicate more or less matters little."""
    target = forecast.bin_error[1] / 10
    aimed = again(with_goniometers(toy, target_error=target), forecast)
    assert aimed.bin_error[1] == pytest.approx(target, rel=0.01)
    assert aimed.paths < aimed.paths_needed < 101 * aimed.paths
    assert aimed.beyond == 0
    assert again(with_goniometers(toy, target_error=1e-6), forecast).beyond == 2


def again(campaign: Campaign, forecast: Forecast) -> Forecast:
    """Another campaign of the same units, by the same pilots."""
    whole = Plan.of(campaign)
    units, names = (
        whole.shard(1, 1),
        [(s.unit.experiment, s.unit.realisation, s.unit.incidence) for s in forecast.pilots],
    )
    chosen = [[(u.experiment, u.realisation, u.incidence) for u in units].index(name) for name in names]
    between = planning._Between(planning._Places(campaign).of(units), chosen, forecast.pilots)
    return planning._forecast(whole, units, between, (1, 1), 0.0, (0.0, 1.0), None)


@pytest.mark.parametrize("kind", ["a target", "Klems's patches"])
def test_the_paths_of_a_target_are_told(kind: str, tmp_path: Path) -> None:
    """The pilots are those that the target itself goes by, for other azimuths and all patches together."""
    campaign = Campaign.of([KINDS[kind]])
    forecast = plan(campaign, pilot=10**6)
    running.run(campaign, tmp_path)
    store = CampaignStore(tmp_path)
    units, replicates = Plan.of(campaign).units[0], campaign.experiments[0].goniometer.replicates
    taken = sum(unit.paths // replicates * int(store.read(unit.name)[1]["replicates"]) for unit in units)
    assert taken > 1.5 * forecast.paths
    assert forecast.paths_needed == pytest.approx(taken, rel=0.1)


# --- A target for all, or for each -----------------------------------------------------------------------------------


def test_targets_are_swept_and_the_same_for_shards_and_workers(tmp_path: Path) -> None:
    """Half the error takes four times the replicates, of the same pilot (Stein 1945)."""
    text = f"{BASE}\n[sweep]\ngoniometer.target_error = [0.05, 0.025]"
    campaign = read(tmp_path, text)
    running.run(campaign, tmp_path / "one")
    for shard in (2, 3, 1):
        running.run(campaign, tmp_path / "shards", shard=(shard, 3))
    running.run(campaign, tmp_path / "workers", ProcessPool(2))
    for name in ("shards", "workers"):
        assert_same(tmp_path / name, tmp_path / "one")
    store = CampaignStore(tmp_path / "one")
    coarse, fine = (
        np.array([int(store.read(unit.name)[1]["replicates"]) for unit in group[:3]])
        for group in Plan.of(campaign).units
    )
    more = coarse > 4
    assert more.sum() == 2
    assert (((4 * coarse - 3 <= fine) | ~more) & (fine <= 4 * coarse)).all()
    given = read(tmp_path, f"{BASE}target_error = 0.05\n[sweep]\nseed = [0]")
    assert running.run(given, tmp_path / "one").computed == 0


# --- How long is left -------------------------------------------------------------------------------------------------


def test_time_left_is_at_the_pace_of_the_last_hour(toy: Campaign, tmp_path: Path) -> None:
    """A unit every ten seconds until now, and three of yesterday: 40 s for the other 4."""
    store, names = CampaignStore(tmp_path), [unit.name for unit in Plan.of(toy).shard(1, 1)]
    store.create(Plan.of(toy).manifest())
    assert seconds_left(store) is None
    now = time.time()
    for age, name in zip([0, 10, 20, 30, 40, 90000, 90000, 90000], names, strict=False):
        (store.units / f"{name}.npz").touch()
        os.utime(store.units / f"{name}.npz", (now - age,) * 2)
    assert seconds_left(store) == pytest.approx(40, abs=5)


def test_status_tells_the_time_left_and_a_line_for_each_shard(run: Gonio) -> None:
    assert run("run", "toy.toml", "--shard", "1/3", "-o", "c", "--quiet") == (0, "", "")
    for number, unit in enumerate(Plan.of(Campaign.read("toy.toml")).shard(3, 3)[:2], 2):
        Path("c/claims", unit.name).write_text(json.dumps({"host": "node", "pid": 1, "run": f", shard {number}/3"}))
    _, out, _ = run("status", "c")
    assert re.search(r"are complete, about \d+ s\s+are\s+left\.", out)
    assert {f"node, process 1, shard {n}/3: 1 unit under way." for n in (2, 3)} <= set(out.splitlines())


# --- Between the pilots ----------------------------------------------------------------------------------------------


def samples(campaign: Campaign, time_of_path: list[float]) -> tuple[Plan, list[Sample]]:
    """Invented pilots, one for every unit."""
    whole = Plan.of(campaign)
    units = whole.shard(1, 1)
    return whole, [
        Sample(
            unit, 1000, build=2.0, fixed=0.5, per_path=seconds, size=100.0, growth=0.0, bin_error=3.0, albedo_error=0
        )
        for unit, seconds in zip(units, time_of_path, strict=True)
    ]


@pytest.mark.parametrize(("workers", "builds"), [(1, 4), (2, 4), (6, 6)])
def test_time_is_the_sum_of_paths_units_and_reliefs(workers: int, builds: int, toy: Campaign) -> None:
    """Shared among workers, each of which builds a relief at least."""
    whole, pilots = samples(toy, [1e-5 * (1 + i) for i in range(UNITS)])
    units = whole.shard(1, 1)
    between = planning._Between(np.arange(UNITS)[:, None] / UNITS, range(UNITS), pilots)
    found = planning._forecast(whole, units, between, (workers, 1), 1.0, (0.0, 1.0), None)
    work = sum(0.5 + 40_000 * 1e-5 * (1 + i) for i in range(UNITS)) + 2.0 * builds
    assert found.work == pytest.approx(work, rel=1e-6)
    assert found.seconds == pytest.approx(1.0 + work / workers, rel=1e-6)
    assert found.units_bytes == 100 * UNITS
    assert found.merged_bytes == 100 * UNITS / 2


def test_a_run_is_no_shorter_than_its_longest_unit(toy: Campaign) -> None:
    whole, pilots = samples(toy, [1e-2] + [1e-7] * (UNITS - 1))
    between = planning._Between(np.arange(UNITS)[:, None] / UNITS, range(UNITS), pilots)
    found = planning._forecast(whole, whole.shard(1, 1), between, (12, 1), 0.0, (0.0, 1.0), None)
    assert found.seconds == pytest.approx(400 + 2.5, rel=1e-6)


def test_between_pilots_logarithms_are_straight(toy: Campaign) -> None:
    _, pilots = samples(toy, [1e-6] * UNITS)
    three = [replace(pilots[i], per_path=seconds) for i, seconds in enumerate((1e-6, 4e-6, 16e-6))]
    at = np.linspace(0, 1, 9)[:, None]
    found = planning._Between(at, [0, 4, 8], three)("per_path")
    assert found == pytest.approx(1e-6 * 16 ** np.linspace(0, 1, 9), rel=1e-6)
    bent = [replace(three[0], per_path=4e-6), *three[1:]]
    found = planning._Between(at, [0, 4, 8], bent)("per_path")
    assert found == pytest.approx([4e-6] * 4 + list(4e-6 * 4 ** np.linspace(0, 1, 5)), rel=1e-6)


def test_pilots_are_the_extremes_and_then_what_lies_between() -> None:
    line = np.linspace(0, 1, 101)[:, None]
    assert sorted(planning._spread(line, 5)) == [0, 25, 50, 75, 100]
    square = np.array([[x, y] for x in range(5) for y in range(5)]) / 4.0
    assert sorted(planning._spread(square, 5)) == [0, 4, 12, 20, 24]
    assert planning._spread(np.zeros((7, 1)), 3) == [0]


def test_a_pilot_has_every_kind_and_the_extremes_of_what_is_swept(tmp_path: Path) -> None:
    text = f"""{BASE}
    [sweep]
    surface.alpha = {{from = 0.1, to = 0.8, count = 30}}
    material = [{{kind = "Mirror"}}, {{kind = "Conductor", name = "Au"}}]
    seed = [1, 2, 3]"""
    campaign = read(tmp_path, text)
    units = Plan.of(campaign).shard(1, 1)
    chosen = [units[i] for i in planning._spread(planning._Places(campaign).of(units), planning.PILOTS)]
    assert len(chosen) == planning.PILOTS < len(units)
    piloted = [(campaign.experiments[unit.experiment], unit.incidence) for unit in chosen]
    corners = {(e.surface.alpha, type(e.material).__name__, i) for e, i in piloted}
    assert {(a, m, i) for a in (0.1, 0.8) for m in ("Mirror", "Conductor") for i in (0, 2)} <= corners


# --- The command line, and what goes wrong ---------------------------------------------------------------------------


def test_the_command_tells_a_forecast(run: Gonio) -> None:
    code, out, err = run(
        "plan", "toy.toml", "--pilot", "400", "--set", "goniometer.target_error=0.05", "--workers", "2"
    )
    assert (code, err) == (0, "")
    for words in ("Forecast for Toys", "24, on 4 surfaces", "2 workers of ", " for the target, beyond 96,000"):
        assert words in out
    assert "Measured: 12 of 24 units, with 400 to 400 paths each" in " ".join(out.split())
    assert [path.name for path in Path().iterdir()] == ["toy.toml"]
    code, _, err = run("plan", "toy.toml", "--pilot", "0")
    assert (code, err) == (2, "--pilot 0: must be 1 or more.\n")


def test_what_cannot_be_measured_is_told_with_its_experiment(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^experiment 2: surface: .*16 of 16 heights are NaN"):
        plan(read(tmp_path, half_bad(tmp_path)), pilot=4)


def test_it_stops_when_it_is_told_to(toy: Campaign) -> None:
    """Ctrl-C, which comes to the thread that waits, stops a pilot that would take minutes."""

    def stop(done: int, total: int) -> None:
        if done:
            raise KeyboardInterrupt

    slow = with_goniometers(toy, paths=400_000_000)
    first = replace(slow, experiments=(toy.experiments[0], *slow.experiments[1:]))
    with pytest.raises(KeyboardInterrupt):
        plan(first, pilot=400_000_000, progress=stop)
