"""Campaigns: what a sweep means, and that nothing is ever lost, wrong or different."""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gonio
import microsurfaces as ms
from gonio.campaign import results, running, store, units
from gonio.campaign.store import CampaignStore, DamagedError, pack, unpack
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan
from gonio.cli import main
from gonio.experiment import Experiment
from gonio.toml_files import InputError

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

Gonio = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Gonio:
    """Runs `gonio campaign` in a folder of its own that holds toy.toml; (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    Path("toy.toml").write_text(TOY)

    def command(*tokens: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as exit_:
            main(("campaign", *tokens))
        out, err = capsys.readouterr()
        assert isinstance(exit_.value.code, int)
        assert "Traceback" not in err
        return exit_.value.code, out, err

    return command


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    path = tmp_path_factory.mktemp("toy") / "toy.toml"
    path.write_text(TOY)
    return Campaign.read(path)


@pytest.fixture(scope="module")
def finished(toy: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of TOY, all computed in one process and merged; not to be changed."""
    path = tmp_path_factory.mktemp("finished")
    state = running.run(toy, path)
    assert (state.computed, state.kept, state.failures) == (UNITS, 0, [])
    assert results.merge(path).incomplete == 0
    return path


def read(tmp_path: Path, text: str) -> Campaign:
    (tmp_path / "c.toml").write_text(text)
    return Campaign.read(tmp_path / "c.toml")


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


# --- Sweeps ----------------------------------------------------------------------------------------------------------


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


# --- The same bytes always -------------------------------------------------------------------------------------------


TINY = gonio.Goniometer(
    theta_i=(0.0, 30.0), phi_i=(0.0, 90.0), paths=4000, replicates=4, wavelengths=(450.0, 650.0),
    detector=gonio.HemisphereGrid(theta_step=10.0, phi_step=20.0),
)  # fmt: skip
ROUGH = ms.Gaussian(alpha=0.3, side=100.0, samples=32)

KINDS = {
    "several specimens": Experiment(ROUGH, gonio.Conductor("Au"), TINY, realisations=3, seed=5, title="x"),
    "a target": Experiment(ROUGH, gonio.Conductor("Al"), replace(TINY, target_error=0.06), realisations=2),
    "V-grooves": Experiment(ms.VGrooves(m=0.4, grooves=16), gonio.Mirror(), TINY, realisations=2),
    "Klems's patches": Experiment(
        ROUGH, gonio.Conductor("Au"),
        gonio.Goniometer(paths=512, replicates=4, detector=gonio.Klems("quarter"), target_error=0.1), realisations=2,
    ),
    "a mesh, turned, a wide lamp": Experiment(
        ms.Cylinders(floor_height=0.0), gonio.Lambertian(0.5), replace(TINY, azimuth="average", beam_half_angle=2.0)
    ),
}  # fmt: skip


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
    status = store.status(CampaignStore(tmp_path / "c"))
    assert status.paths == status.paths_finished == sum(unit.paths for unit in whole.units[0])


def test_the_number_of_threads_changes_no_byte(toy: Campaign, finished: Path, tmp_path: Path) -> None:
    running.run(toy, tmp_path, threads=3)
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


def watch(path: Path, count: int, process: subprocess.Popen[str]) -> None:
    """Wait until so many units are finished."""
    end = time.monotonic() + 60
    while len(CampaignStore(path).finished()) < count and process.poll() is None:
        assert time.monotonic() < end
        time.sleep(0.002)


Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts `gonio campaign run` in a process of its own, for TOY; none of them outlives the test."""
    started: list[subprocess.Popen[str]] = []

    def command(path: Path, *options: str) -> subprocess.Popen[str]:
        toy = path.with_suffix(".toml")
        toy.write_text(TOY)
        tokens = [sys.executable, "-m", "gonio", "campaign", "run", str(toy), "-o", str(path), *options]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        started.append(subprocess.Popen(tokens, **pipes, text=True, start_new_session=True))
        return started[-1]

    yield command
    for process in started:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def workers_of(process: subprocess.Popen[str]) -> list[int]:
    """Processes that a run has started to compute units."""
    found = list[int]()
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # they come and go meanwhile
        for task in Path(f"/proc/{process.pid}/task").glob("*/children"):
            children = map(int, task.read_text().split())
            found += [pid for pid in children if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    return found


def assert_gone(pids: list[int]) -> None:
    """Processes end by themselves, soon."""
    end = time.monotonic() + 60
    while any(lives(pid) for pid in pids):
        assert time.monotonic() < end
        time.sleep(0.05)


def lives(pid: int) -> bool:
    """Whether a process runs; one that has ended but that nobody has asked about does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_ten_kills_lose_nothing_and_change_nothing(start: Start, toy: Campaign, finished: Path, tmp_path: Path) -> None:
    """SIGKILL for a run whose worker has to notice, then three times for a run and both its workers, one by one."""
    path, kept = tmp_path / "c", dict[str, int]()

    def finished_since() -> int:
        now = {file.name: file.stat().st_mtime_ns for file in path.glob("units/*.npz")}
        assert now.items() >= kept.items()  # none lost, none written again
        new = len(now) - len(kept)
        kept.update(now)
        return new

    killed = list[int]()
    for workers in (1, 2, 2, 2):
        process = start(path, "--workers", str(workers))
        watch(path, len(kept) + 2, process)
        workers = workers_of(process)
        victims = [process.pid, *(workers if workers > 1 else ())]
        for pid in reversed(victims):
            os.kill(pid, signal.SIGKILL)
        killed += victims
        process.communicate()
        assert process.returncode == -signal.SIGKILL
        assert_gone(workers)
        assert finished_since() >= 2
    assert len(killed) == 10
    assert len(kept) < UNITS
    state = running.run(toy, path)
    assert (state.kept, state.computed, state.failures) == (len(kept), UNITS - len(kept), [])
    assert finished_since() == state.computed
    assert_same(path, finished, merged=True)
    assert not list((path / "claims").iterdir())


def test_two_workers_give_what_one_process_does(toy: Campaign, finished: Path, tmp_path: Path) -> None:
    state = running.run(toy, tmp_path, workers=2)
    assert (state.deaths, state.failures, state.computed) == (0, [], UNITS)
    assert_same(tmp_path, finished)


def test_two_runs_in_one_folder_do_no_harm(start: Start, finished: Path, tmp_path: Path) -> None:
    path = tmp_path / "c"
    processes = [start(path), start(path)]
    for process in processes:
        out, err = process.communicate(timeout=100)
        assert process.returncode == 0, err
        assert f"{UNITS} units" in out
    assert_same(path, finished)


def test_ctrl_c_keeps_what_is_finished_and_leaves_no_worker(start: Start, tmp_path: Path) -> None:
    path = tmp_path / "c"
    process = start(path, "--workers", "1", "--set", "goniometer.paths=5000000")
    watch(path, 1, process)
    workers = workers_of(process)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers, too
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert err.endswith(f"units are kept in {path}; the same command continues.\n")
    assert "Traceback" not in err
    assert len(workers) == 1
    assert_gone(workers)
    assert store.verify(CampaignStore(path)) == (len(CampaignStore(path).finished()), [])
    assert not list((path / "claims").iterdir())


def test_a_unit_that_kills_its_workers_is_given_up_and_the_others_are_not(
    toy: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third unit's worker is killed each time: the run ends, with a sentence for that unit only."""
    monkeypatch.setattr(running, "DEATHS", 2)
    fatal = Plan.of(toy).shard(1, 1)[2]
    assign = running._WorkerPool._assign

    def treacherous(self: running._WorkerPool, number: int) -> None:
        assign(self, number)
        worker = self._workers[number]
        if worker.unit == fatal:
            worker.process.kill()

    monkeypatch.setattr(running._WorkerPool, "_assign", treacherous)
    state = running.run(toy, tmp_path, workers=1)
    assert state.deaths == 2
    assert state.computed == UNITS - 1
    (sentence,) = state.failures
    assert "experiment 1, realisation 0: its worker died 2 times (exit code -9)" in sentence


# --- Damage, disks, claims -------------------------------------------------------------------------------------------


@pytest.fixture
def copied(finished: Path, tmp_path: Path) -> Path:
    """A copy of the finished campaign, to be harmed."""
    return shutil.copytree(finished, tmp_path / "copied")


def test_no_flipped_bit_goes_unnoticed() -> None:
    """A unit's file either gives what was written or is told to be damaged; cut short, it always is."""
    random = np.random.default_rng(1)
    arrays = {"a": random.integers(0, 1 << 40, (3, 40)), "b": np.array([1 << 63], np.uint64)}
    whole, seen = pack({"unit": "x"}, arrays), 0
    assert whole == pack({"unit": "x"}, arrays)
    for place in range(len(whole)):
        harmed = bytearray(whole)
        harmed[place] ^= 1 << int(random.integers(8))
        try:
            note, found = unpack(bytes(harmed))
        except DamagedError:
            seen += 1
        else:
            assert note == {"unit": "x"}
            assert {name: array.tolist() for name, array in found.items()} == {n: a.tolist() for n, a in arrays.items()}
    assert seen > 0.8 * len(whole)
    for length in range(0, len(whole), 7):
        with pytest.raises(DamagedError):
            unpack(whole[:length])


def test_a_checksum_is_noticed_that_zip_does_not_notice() -> None:
    """A file that another program put together anew, with other numbers, is no unit."""
    good = dict(np.load(io.BytesIO(pack({"unit": 1}, {"a": np.arange(5)}))))
    content = io.BytesIO()
    np.savez(content, **{**good, "a": np.arange(1, 6)})
    with pytest.raises(DamagedError, match="checksum"):
        unpack(content.getvalue())


def harm(path: Path) -> list[str]:
    """Damage three units in different ways; their names."""
    files = sorted(path.glob("units/*.npz"))
    cut, zeros, swapped, other = files[0], files[5], files[9], files[10]
    cut.write_bytes(cut.read_bytes()[:-100])
    zeros.write_bytes(bytes(zeros.stat().st_size))
    swapped.write_bytes(other.read_bytes())
    return [file.stem for file in (cut, zeros, swapped)]


def test_verify_finds_what_is_damaged_and_the_next_run_repairs_it(run: Gonio, copied: Path, finished: Path) -> None:
    harmed = harm(copied)
    code, out, err = run("verify", str(copied))
    assert code == 1
    assert out == f"{UNITS - 3} units are sound.\n"
    for name in harmed:
        assert f"{name} is damaged" in err
    assert "under a wrong name" in err
    assert err.endswith("3 units were damaged: run the campaign again, which computes them.\n")
    code, out, _ = run("run", "toy.toml", "-o", str(copied))
    assert (code, out.startswith(f"{UNITS} units: {UNITS - 3} were there, 3 computed")) == (0, True)
    assert run("verify", str(copied)) == (0, f"{UNITS} units are sound.\n", "")
    assert_same(copied, finished)


def test_merge_finds_what_is_damaged(run: Gonio, copied: Path, finished: Path) -> None:
    harmed = harm(copied)
    code, _, err = run("merge", str(copied))
    assert code == 1
    assert all(f"{name} is damaged" in err for name in harmed)
    assert "experiments lack units: run the campaign again." in err
    rows = index(copied)
    hit = [any(name in entry["units"] for name in harmed) for entry in CampaignStore(copied).manifest()["experiments"]]
    assert [row["file"] == "" for row in rows] == hit
    assert run("run", "toy.toml", "-o", str(copied), "--quiet") == (0, "", "")
    assert_same(copied, finished)


def test_a_damaged_pilot_is_measured_again(tmp_path: Path) -> None:
    experiment = KINDS["a target"]
    campaign = Campaign.of([experiment])
    running.run(campaign, tmp_path)
    before = content(tmp_path)
    pilot, *_ = (unit.pilot for unit in Plan.of(campaign).units[0] if unit.pilot)
    follower = next(unit for unit in Plan.of(campaign).units[0] if unit.pilot == pilot)
    home = CampaignStore(tmp_path)
    (home.units / f"{pilot}.npz").write_bytes(b"nothing")
    (home.units / f"{follower.name}.npz").unlink()
    assert running.run(campaign, tmp_path).computed == 1
    assert content(tmp_path) == before


def test_a_full_disk_is_one_sentence_and_loses_nothing(
    run: Gonio, finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        sync, calls = os.fsync, list[int]()

        def full(handle: int) -> None:
            calls.append(handle)
            if len(calls) > 12:
                raise OSError(errno.ENOSPC, "anything")
            sync(handle)

        patch.setattr("os.fsync", full)
        code, out, err = run("run", "toy.toml", "-o", "c")
    assert (code, out) == (1, "")
    assert err == (
        "c cannot be written (no space left on device): finished units are kept, the same command continues.\n"
    )
    kept = len(CampaignStore(Path("c")).finished())
    assert kept == 5  # file and folder are flushed for the manifest and for each unit; not the sixth, half there
    assert not list(Path("c").rglob("*.tmp"))
    code, out, _ = run("run", "toy.toml", "-o", "c")
    assert out.startswith(f"{UNITS} units: {kept} were there, {UNITS - kept} computed")
    assert_same(Path("c"), finished)


def test_a_file_appears_whole_by_a_rename(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_, seen = Path.replace, list[tuple[bytes, bool]]()

    def watched(self: Path, target: Path) -> Path:
        seen.append((self.read_bytes(), target.exists()))
        return replace_(self, target)

    monkeypatch.setattr(Path, "replace", watched)
    store.write_whole(tmp_path / "a", b"content")
    assert seen == [(b"content", False)]
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_what_another_run_claims_is_done_last_and_dead_runs_claim_nothing(toy: Campaign, tmp_path: Path) -> None:
    plan = Plan.of(toy)
    home = CampaignStore(tmp_path)
    home.create(plan.manifest())
    ordered = plan.shard(1, 1)
    claim = {"host": "elsewhere", "pid": 1, "run": ""}
    (tmp_path / "claims" / ordered[0].name).write_text(json.dumps(claim))
    dead = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    claim = {"host": socket.gethostname(), "pid": int(dead.stdout), "run": ""}
    (tmp_path / "claims" / ordered[1].name).write_text(json.dumps(claim))
    (tmp_path / "claims" / ordered[2].name).write_text("")
    assert list(home.claims()) == [ordered[0].name]
    queue, taken = running.Queue(ordered, home), list[str]()
    while unit := queue.take():
        taken.append(unit.name)
        queue.settle(unit, None)
    assert taken == [unit.name for unit in ordered[1:]] + [ordered[0].name]
    assert not list((tmp_path / "claims").iterdir())


def test_what_killed_runs_left_half_written_is_removed_after_an_hour(toy: Campaign, tmp_path: Path) -> None:
    home = CampaignStore(tmp_path)
    home.create(Plan.of(toy).manifest())
    old, fresh = home.units / ".a.tmp", home.units / ".b.tmp"
    for path in (old, fresh):
        path.touch()
    os.utime(old, (time.time() - 4000,) * 2)
    home.create(Plan.of(toy).manifest())
    assert (old.exists(), fresh.exists()) == (False, True)
    assert home.finished() == set()


def test_workers_stay_with_their_relief_and_take_others_first(toy: Campaign, tmp_path: Path) -> None:
    plan = Plan.of(toy)
    CampaignStore(tmp_path).create(plan.manifest())
    queue = running.Queue(plan.shard(1, 1), CampaignStore(tmp_path))
    first, second = queue.take(), queue.take(None, ())
    assert first
    assert second
    assert second.relief == first.relief
    elsewhere = queue.take(None, [first.relief])
    assert elsewhere
    assert elsewhere.relief != first.relief
    for same in (first, elsewhere):
        again = queue.take(same.relief)
        assert again
        assert again.relief == same.relief


def test_no_specimen_is_begun_before_the_first_has_told_how_many_replicates_it_takes(tmp_path: Path) -> None:
    plan = Plan.of(Campaign.of([KINDS["a target"]]))
    CampaignStore(tmp_path).create(plan.manifest())
    queue, out = running.Queue(plan.shard(1, 1), CampaignStore(tmp_path)), list[units.Unit]()
    while unit := queue.take():
        out.append(unit)
    assert [unit.realisation for unit in out] == [0] * 4
    queue.settle(out[2], None)
    follower = queue.take()
    assert follower
    assert (follower.pilot, queue.take()) == (out[2].name, None)


def test_each_relief_is_built_once(toy: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four reliefs (two slopes, two realisations) serve 24 units of two materials."""
    build, built = ms.Gaussian.build, list[tuple[float, int]]()

    def counted(self: ms.Gaussian, seed: int) -> ms.HeightField:
        built.append((self.alpha, seed))
        return build(self, seed)

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


def test_a_damaged_manifest_is_written_anew(copied: Path, toy: Campaign, finished: Path) -> None:
    (copied / "manifest.json").write_text('{"title')
    with pytest.raises(InputError, match="is damaged: run the campaign again"):
        store.status(CampaignStore(copied))
    assert running.run(toy, copied).computed == 0
    assert_same(copied, finished)


# --- The command line ------------------------------------------------------------------------------------------------


def test_run_status_merge_from_the_command_line(run: Gonio, finished: Path) -> None:
    code, out, err = run("run", "toy.toml", "--shard", "1/2")
    assert (code, err) == (0, "")
    assert out.startswith("12 units: 0 were there, 12 computed in ")
    assert run("status", "out/toy") == (
        0,
        "Toys\n12 of 24 units are finished, 50% of the paths; 2 of 4 experiments are complete.\n",
        "",
    )
    code, out, err = run("merge", "out/toy")
    assert (code, err) == (1, "2 of 4 experiments lack units: run the campaign again.\n")
    assert run("run", "toy.toml", "--quiet") == (0, "", "")
    code, out, err = run("merge", "out/toy")
    assert code == 0
    assert out.startswith("4 measurements and index.csv in out/toy/measurements/\nAll 4 experiments together:\n")
    assert content(Path("out/toy")) == content(finished)
    rows = index(Path("out/toy"))
    assert [(row["experiment"], row["surface.alpha"], row["material.name"]) for row in rows] == [
        ("1", "0.2", "Au"), ("2", "0.2", "Al"), ("3", "0.4", "Au"), ("4", "0.4", "Al")
    ]  # fmt: skip
    for row in rows:
        measured = gonio.load(Path("out/toy/measurements") / row["file"])
        assert measured.material == gonio.Conductor(row["material.name"])


def test_status_tells_who_works_on_it(run: Gonio, copied: Path) -> None:
    unit = sorted(copied.glob("units/*.npz"))[0]
    unit.unlink()
    claim = {"host": "node7", "pid": 12, "run": ", shard 2/7"}
    (copied / "claims" / unit.stem).write_text(json.dumps(claim))
    code, out, _ = run("status", str(copied))
    assert code == 0
    assert out.endswith("node7, process 12, shard 2/7: 1 unit under way.\n")


def test_progress_is_plain_lines_without_a_terminal(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gonio.cli.campaigns.PLAIN_PROGRESS_SECONDS", 0.0)
    code, _, err = run("run", "toy.toml", "-o", "c")
    assert code == 0
    lines = err.splitlines()
    assert len(lines) >= UNITS
    assert lines[-1].startswith(f"100% done, {UNITS} of {UNITS} units, ")
    assert lines[-1].endswith("rays/s, 0 s left.")


@pytest.mark.parametrize(
    ("tokens", "words"),
    [
        ("run toy.toml --shard 0/7", "--shard 0/7: must be i/n"),
        ("run toy.toml --shard 3", "--shard 3: must be i/n"),
        ("run toy.toml --workers -1", "--workers -1: must be 0 or more"),
        ("run toy.toml --threads 0", "--threads 0: must be 1 or more"),
        ("run toy.toml --set surface.alpha", "--set 'surface.alpha': must be key=value"),
        ("run toi.toml", "did you mean toy.toml?"),
        ("status nowhere", "nowhere: holds no campaign"),
        ("merge nowhere", "nowhere: holds no campaign"),
        ("verify nowhere", "nowhere: holds no campaign"),
    ],
)
def test_what_goes_wrong_is_one_sentence_and_writes_nothing(run: Gonio, tokens: str, words: str) -> None:
    code, out, err = run(*tokens.split())
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1
    assert [path.name for path in Path().iterdir()] == ["toy.toml"]


def test_a_surface_that_cannot_be_built_stops_no_other(run: Gonio) -> None:
    np.save("bad.npy", np.full((4, 4), np.nan))
    bad = '{kind = "HeightFieldFile", path = "bad.npy", periodic = "as is", pixel_size = 1.0, unit = "um"}'
    Path("c.toml").write_text(f'{BASE}\n[sweep]\nsurface = [{{kind = "Flat"}}, {bad}]')
    code, _, err = run("run", "c.toml", "-o", "c")
    assert code == 1
    assert "experiment 2, realisation 1: surface: " in err
    assert "16 of 16 heights are NaN" in err
    assert err.endswith("6 of 12 units could not be computed; the others are kept.\n")
    assert len(CampaignStore(Path("c")).finished()) == 6


# --- Size ------------------------------------------------------------------------------------------------------------


def test_the_status_of_ten_thousand_units(tmp_path: Path) -> None:
    grids = replace(TINY, phi_i=tuple(np.arange(50.0)), theta_i=(0.0,))
    campaign = Campaign.of([Experiment(ROUGH, gonio.Mirror(), grids, seed=seed, realisations=10) for seed in range(20)])
    plan, home = Plan.of(campaign), CampaignStore(tmp_path)
    home.create(plan.manifest())
    every = [unit.name for group in plan.units for unit in group]
    assert len(every) == 10_000
    for name in every[:7000]:
        (home.units / f"{name}.npz").touch()
    found = subprocess.run(
        [sys.executable, "-m", "gonio", "campaign", "status", str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert "7000 of 10000 units are finished, 70% of the paths; 14 of 20 experiments are" in found.stdout


CONFIGS = [
    path for path in sorted((Path(__file__).parents[2] / "configs").glob("*.toml")) if "[sweep]" in path.read_text()
]


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_campaigns_in_configs_run(path: Path, tmp_path: Path) -> None:
    text = path.read_text()
    assert text.startswith("# ")
    with pytest.raises(InputError, match=f"{path.name} is a campaign: gonio campaign run"):
        Experiment.read(path)
    assert f"#     gonio campaign run configs/{path.name} -o " in text
    small = ["goniometer.paths=512", "surface.samples=32", "surface.side=100.0", "realisations=2"]
    campaign = Campaign.read(path, small)
    assert campaign.title
    assert not running.run(campaign, tmp_path).failures
    status = store.status(CampaignStore(tmp_path))
    assert status.experiments_finished == len(campaign.experiments) > 1
