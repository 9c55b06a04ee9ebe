"""Runs in several processes, some of them killed: nothing is lost, wrong or different."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from toys import TOY, UNITS, assert_same

from gonio.campaign import processes, queue, running
from gonio.campaign.processes import ProcessPool
from gonio.campaign.status import verify
from gonio.campaign.store import CampaignStore
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan


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
        pids = workers_of(process)
        victims = [process.pid, *(pids if workers > 1 else ())]
        for pid in reversed(victims):
            os.kill(pid, signal.SIGKILL)
        killed += victims
        process.communicate()
        assert process.returncode == -signal.SIGKILL
        assert_gone(pids)
        assert finished_since() >= 2
    assert len(killed) == 10
    assert len(kept) < UNITS
    state = running.run(toy, path)
    assert (state.kept, state.computed, state.failures) == (len(kept), UNITS - len(kept), [])
    assert finished_since() == state.computed
    assert_same(path, finished, merged=True)
    assert not list((path / "claims").iterdir())


def test_two_workers_give_what_one_process_does(toy: Campaign, finished: Path, tmp_path: Path) -> None:
    state = running.run(toy, tmp_path, ProcessPool(2))
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
    assert verify(CampaignStore(path)) == (len(CampaignStore(path).finished()), [])
    assert not list((path / "claims").iterdir())


def test_a_unit_that_kills_its_workers_is_given_up_and_the_others_are_not(
    toy: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third unit's worker is killed each time: the run ends, with a sentence for that unit only."""
    monkeypatch.setattr(queue, "DEATHS", 2)
    fatal = Plan.of(toy).shard(1, 1)[2]
    assign = processes._Coordinator._assign

    def treacherous(self: processes._Coordinator, number: int) -> None:
        assign(self, number)
        worker = self._workers[number]
        if worker.unit == fatal:
            worker.process.kill()

    monkeypatch.setattr(processes._Coordinator, "_assign", treacherous)
    state = running.run(toy, tmp_path, ProcessPool(1))
    assert state.deaths == 2
    assert state.computed == UNITS - 1
    (sentence,) = state.failures
    assert "experiment 1, realisation 0: its worker died 2 times (exit code -9)" in sentence
