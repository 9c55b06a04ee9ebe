"""Campaigns on a Dask cluster: real schedulers and workers, some of them killed, and always the same bytes."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from toys import KINDS, TOY, UNITS, assert_same, half_bad, read

from gonio.campaign import cluster, results, running
from gonio.campaign.cluster import ClusterError, connected
from gonio.campaign.queue import DEATHS, Queue, Report, State
from gonio.campaign.store import CampaignStore
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan
from gonio.cli import main
from gonio.toml_files import InputError

WATCHED = """
import os
from gonio.campaign.units import UnitRunner

def watched(measure):
    def logged(self, unit, *rest):
        with open(os.environ["MEASURED"], "a") as file:
            file.write(f"{os.getpid()} {unit.relief} {self.threads}\\n")
        measure(self, unit, *rest)
        if os.path.exists("fault"):
            class Local(Exception):
                __slots__ = ("secret",)
                def __reduce__(self):
                    raise RuntimeError
            raise Local("a fault of ours")
    return logged

if UnitRunner.measure.__name__ == "measure":  # this is loaded twice
    UnitRunner.measure = watched(UnitRunner.measure)
"""
"""Has a worker write down what it measures, and with how many threads."""


class Cluster:
    """A scheduler and its workers, each a process."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.processes, self.log = folder, list[subprocess.Popen[bytes]](), folder / "measured"
        (folder / "watched.py").write_text(WATCHED)
        self.scheduler = self.start("scheduler", "--port", "0", "--scheduler-file", "scheduler.json")

    def start(self, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1", "--no-dashboard"]
        with (self.folder / "log").open("ab") as log:
            environment = os.environ | {"MEASURED": str(self.log)}
            process = subprocess.Popen(command, stdout=log, stderr=log, cwd=self.folder, env=environment)
        self.processes.append(process)
        return process

    @property
    def address(self) -> str:
        file = self.folder / "scheduler.json"
        wait(lambda: file.exists() and file.read_text().endswith("}"))
        return str(json.loads(file.read_text())["address"])

    def worker(self, threads: int = 1) -> subprocess.Popen[bytes]:
        options = ["--no-nanny", "--nthreads", str(threads), "--preload", "watched.py", "--death-timeout", "60"]
        return self.start("worker", "--scheduler-file", "scheduler.json", *options)

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Two workers, one of them with two threads; not to be harmed."""
    started = Cluster(tmp_path_factory.mktemp("pair"))
    with contextlib.closing(started):
        started.worker(1)
        started.worker(2)
        yield started


def run_on(address: str, campaign: Campaign, folder: Path, report: Report | None = None) -> State:
    """Have a cluster compute a campaign."""
    with connected(address) as pool:
        return running.run(campaign, folder, pool, report=report)


def wait(met: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not met():
        assert time.monotonic() < end
        time.sleep(0.01)


def together(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a run begin when so many workers are there."""
    update = cluster._Coordinator._update_workers

    def patient(self: cluster._Coordinator) -> None:
        wait(lambda: len(self._present()) >= count)
        update(self)
        monkeypatch.setattr(cluster._Coordinator, "_update_workers", update)

    monkeypatch.setattr(cluster._Coordinator, "_update_workers", patient)


def test_a_cluster_gives_what_one_process_does(
    pair: Cluster, toy: Campaign, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each worker has one unit at a time, with as many threads as it has, and seldom changes its relief."""
    together(2, monkeypatch)
    pair.log.unlink(missing_ok=True)
    state = run_on(pair.address, toy, tmp_path)
    assert (state.computed, state.deaths, state.failures, state.refused) == (UNITS, 0, [], [])
    assert state.workers == 2
    assert state.rays > state.paths_done == state.paths
    assert_same(tmp_path, finished)
    assert not list((tmp_path / "claims").iterdir())
    measured = [line.split() for line in pair.log.read_text().splitlines()]
    assert len(measured) == UNITS
    lines = {pid: [line for line in measured if line[0] == pid] for pid in {line[0] for line in measured}}
    assert sorted("".join({threads for *_, threads in some}) for some in lines.values()) == ["1", "2"]
    reliefs = {relief for _, relief, _ in measured}
    changes = sum(a[1] != b[1] for some in lines.values() for a, b in itertools.pairwise(some))
    assert changes <= len(reliefs) + 1


def test_a_target_takes_the_same_paths_on_a_cluster(pair: Cluster, tmp_path: Path) -> None:
    campaign = Campaign.of([KINDS["a target"]])
    running.run(campaign, tmp_path / "one")
    assert run_on(pair.address, campaign, tmp_path / "many").failures == []
    for name in ("one", "many"):
        results.merge(tmp_path / name)
    assert_same(tmp_path / "many", tmp_path / "one")


def test_workers_with_other_versions_are_left_out(
    pair: Cluster, toy: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = cluster._all_versions
    monkeypatch.setattr(cluster, "_all_versions", lambda: ours() | {"numba": "0.1"})
    with pytest.raises(InputError, match=r"worker tcp://.* has other versions \(numba .* instead of 0\.1\)"):
        run_on(pair.address, toy, tmp_path)
    assert CampaignStore(tmp_path).finished() == set()


def test_ctrl_c_stops_the_units_under_way_and_keeps_what_is_finished(pair: Cluster, tmp_path: Path) -> None:
    """A unit of 5e8 paths would take minutes: its worker is free for the next run at once."""
    (tmp_path / "toy.toml").write_text(TOY.replace("paths = 4000", "paths = 500_000_000"))
    tokens = [sys.executable, "-m", "gonio", "campaign", "run", "toy.toml", "-o", "c", "--scheduler", pair.address]
    process = subprocess.Popen(tokens, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    measured = pair.log.stat().st_size if pair.log.exists() else 0
    wait(lambda: process.poll() is not None or (pair.log.exists() and pair.log.stat().st_size > measured))
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1, err
    assert err.endswith("units are kept in c; the same command continues.\n")
    assert "Traceback" not in err
    assert not list((tmp_path / "c/claims").iterdir())
    small = Campaign.of([KINDS["V-grooves"]])
    assert run_on(pair.address, small, tmp_path / "next").failures == []
    assert CampaignStore(tmp_path / "c").finished() == set()


def test_a_unit_that_cannot_be_computed_stops_no_other(pair: Cluster, tmp_path: Path) -> None:
    state = run_on(pair.address, read(tmp_path, half_bad(tmp_path)), tmp_path / "c")
    assert (state.computed, len(state.failures)) == (6, 6)
    assert "experiment 2, realisation 0: surface: " in state.failures[0]


def test_a_fault_of_ours_shows_its_trace(pair: Cluster, toy: Campaign, tmp_path: Path) -> None:
    """Even where the exception cannot be sent."""
    fault = pair.folder / "fault"
    fault.touch()
    try:
        with pytest.raises(RuntimeError, match=r"(?s)a worker failed:.*Local: a fault of ours"):
            run_on(pair.address, toy, tmp_path)
    finally:
        fault.unlink()
    assert run_on(pair.address, toy, tmp_path).failures == []


def test_a_worker_dies_another_one_comes_and_nothing_is_lost(
    toy: Campaign, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGKILL for the only worker when it has the third unit, then one comes and does the rest.

    When in the end the scheduler is killed, that is told and nothing is lost either.
    """
    (tmp_path / "cluster").mkdir()
    third, give = Plan.of(toy).shard(1, 1)[2], cluster._Coordinator._give
    with contextlib.closing(Cluster(tmp_path / "cluster")) as cluster_:
        victim = cluster_.worker()

        def treacherous(self: cluster._Coordinator, number: int, work: object, *what: object) -> None:
            give(self, number, work, *what)
            if what[0] == third and victim.poll() is None:
                victim.kill()
                cluster_.worker()

        monkeypatch.setattr(cluster._Coordinator, "_give", treacherous)
        state = run_on(cluster_.address, toy, tmp_path / "c")
        assert (state.deaths, state.computed, state.failures, state.workers) == (1, UNITS, [], 1)
        assert_same(tmp_path / "c", finished)

        with pytest.raises(ClusterError, match="scheduler is gone"):
            run_on(cluster_.address, toy, tmp_path / "d", report=lambda state: cluster_.scheduler.kill())
    assert running.run(toy, tmp_path / "d").failures == []
    assert_same(tmp_path / "d", finished)


def test_a_unit_whose_workers_die_is_given_up(toy: Campaign, tmp_path: Path) -> None:
    plan = Plan.of(toy)
    CampaignStore(tmp_path).create(plan.manifest())
    queue = Queue(plan.shard(1, 1)[:1], CampaignStore(tmp_path))
    coordinator = cluster._Coordinator(None, queue, toy.experiments, lambda state: None, str(tmp_path))  # type: ignore[arg-type]
    for number in range(DEATHS):
        assert queue.left
        coordinator._workers[number] = cluster._Worker("tcp://x", 1, None, queue.take())
        coordinator._lost(number)
    assert not queue.left
    assert queue.state.deaths == DEATHS
    (sentence,) = queue.state.failures
    assert sentence.endswith("its worker died 3 times, as when memory is short.")


def test_a_worker_tells_why_it_may_not_compute(tmp_path: Path) -> None:
    ours = cluster._all_versions()
    with pytest.raises(cluster._UnfitError, match=r"does not see .*nowhere: give a folder that all machines share"):
        cluster._examined(ours, str(tmp_path / "nowhere"), "", 0.0)
    (tmp_path / "manifest.json").write_text("another")
    with pytest.raises(cluster._UnfitError, match="does not see"):
        cluster._examined(ours, str(tmp_path), "", 0.0)
    with pytest.raises(cluster._UnfitError, match=r"cannot write to .*: No such file"):
        cluster._examined(ours, str(tmp_path), cluster._manifest(str(tmp_path)) or "", 0.0)


SCRIPT = Path(__file__).parents[2] / "docs/slurm_array.sh"


def submit(folder: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run the job script with what SLURM sets, and a gonio that prints what it is told to do."""
    (folder / "gonio").write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    (folder / "gonio").chmod(0o755)
    environment = os.environ | {"PATH": f"{folder}:{os.environ['PATH']}", **variables}
    return subprocess.run(["bash", str(SCRIPT), *words], cwd=folder, env=environment, capture_output=True, text=True)


def test_the_tasks_of_a_job_array_give_what_one_process_does(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a toy.toml").write_text(TOY)
    array = {"SLURM_ARRAY_TASK_MIN": "4", "SLURM_ARRAY_TASK_COUNT": "3", "SLURM_CPUS_PER_TASK": "2"}
    for task in ("5", "4", "6"):
        done = submit(tmp_path, str(tmp_path / "a toy.toml"), str(tmp_path / "c"), SLURM_ARRAY_TASK_ID=task, **array)
        assert (done.returncode, done.stderr) == (0, "")
        with pytest.raises(SystemExit) as end:
            main(done.stdout.splitlines())
        assert end.value.code == 0
        assert capsys.readouterr().out.startswith("8 units: 0 were there, 8 computed in ")
    assert done.stdout.endswith("--shard\n3/3\n--threads\n2\n")
    assert_same(tmp_path / "c", finished)


def test_the_job_script_is_one_for_slurm(tmp_path: Path) -> None:
    """SLURM reads no option after the first command; without a campaign it says what it needs."""
    lines = SCRIPT.read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line and not line.startswith("#"))
    options = [line.split()[1].split("=")[0] for line in lines[:first] if line.startswith("#SBATCH")]
    assert {"--array", "--cpus-per-task", "--mem", "--time"} <= set(options)
    assert not any(line.startswith("#SBATCH") for line in lines[first:])
    done = submit(tmp_path)
    assert done.returncode != 0
    assert "usage: sbatch slurm_array.sh CAMPAIGN.toml DIR" in done.stderr


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("tcp://127.0.0.1:1", "no Dask scheduler answers there (Timed out"),
        ("tcp//x", "that is not protocol://host:port"),
    ],
)
def test_a_scheduler_that_does_not_answer_is_told(
    address: str, words: str, toy: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 0.3)
    with pytest.raises(InputError) as error:
        run_on(address, toy, tmp_path / "c")
    assert words in str(error.value)
    assert not (tmp_path / "c").exists()


def test_without_dask_that_is_told(toy: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r'needs Dask, pip install "gonio\[cluster\]"'):
        run_on("tcp://127.0.0.1:1", toy, tmp_path)
