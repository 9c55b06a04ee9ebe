"""Computes the units of a campaign that are missing: in this process, in several that may die at any moment, or on a
cluster (`cluster`).

Work is idempotent: a unit's file is the same bytes whoever writes it. Runs in one folder therefore need no lock; what
another one has claimed is only left for last.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio.campaign.store import CampaignStore, paths_of

if TYPE_CHECKING:
    from distributed import Client

    from gonio.campaign.sweep import Campaign
    from gonio.campaign.units import Unit
    from gonio.experiment import Experiment

DEATHS = 3
"""A unit whose worker died so often is given up."""

REPORT_SECONDS = 0.5
"""Workers tell how far they are this often."""

STOP_SECONDS = 5.0
"""Workers that do not end by then are killed."""

PACE_SECONDS = 3600.0
"""What was finished longer ago tells nothing about how fast it goes now."""


class ClusterError(RuntimeError):
    """A cluster cannot go on: why, without the full stop."""


@dataclass
class State:
    """How far a run is; `report` of `run` gets it a few times a second."""

    units: int
    """All of this run's, or of its shard's."""
    kept: int
    """Those that were there before."""
    paths: int
    """Of the units that this run has to compute."""
    computed: int = 0
    finished_paths: int = 0
    current: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Of every worker the paths and rays of its unit so far."""
    finished_rays: int = 0
    failures: list[str] = field(default_factory=list)
    """A sentence for every unit that could not be computed."""
    deaths: int = 0
    """Workers that died and were replaced."""
    changed: bool = False
    """Whether the folder held another campaign before."""
    workers: int | None = None
    """Those of a cluster that compute now."""
    refused: list[str] = field(default_factory=list)
    """A sentence for every worker of a cluster that may not compute."""

    @property
    def paths_done(self) -> int:
        """Paths traced in this run."""
        return self.finished_paths + sum(paths for paths, _ in self.current.values())

    @property
    def rays(self) -> int:
        """Rays traced in this run."""
        return self.finished_rays + sum(rays for _, rays in self.current.values())


Report = Callable[[State], None]


class Queue:
    """The units that are missing, handed out so that each relief is built seldom, and others' work is done last."""

    def __init__(self, units: Sequence[Unit], folder: CampaignStore, run: str = "") -> None:
        """`units` in their order; `run` is what a claim says besides host and process."""
        self._folder, self._run = folder, run
        finished = folder.finished()
        missing = [unit for unit in units if unit.name not in finished]
        names = {unit.name for unit in missing}
        self._groups: dict[str, deque[Unit]] = {}
        self._waiting: dict[str, list[Unit]] = {}
        self._later: list[Unit] = []
        self._deaths: dict[str, int] = {}
        for unit in missing:
            if unit.pilot in names:
                self._waiting.setdefault(unit.pilot or "", []).append(unit)
            else:
                self._add(unit)
        self._held: set[str] = set()
        self.state = State(len(units), len(units) - len(missing), sum(unit.paths for unit in missing))

    @property
    def left(self) -> bool:
        """Whether there are units that nobody has taken."""
        return bool(self._groups or self._waiting or self._later)

    def take(self, relief: str | None = None, others: Sequence[str] = ()) -> Unit | None:
        """A unit to compute now, of the relief that is built already if there is one, else of none of `others`."""
        while unit := self._next(relief, others):
            if self._folder.has(unit.name):
                self._found(unit)
                continue
            self._held.add(unit.name)  # before the claim is written: Ctrl-C may come in between
            if self._folder.claim(unit.name, self._run):
                return unit
            self._held.discard(unit.name)
            self._later.append(unit)
        # Whoever claimed these may be dead; computing one twice does no harm.
        while self._later:
            unit = self._later.pop()
            if not self._folder.has(unit.name):
                return unit
            self._found(unit)
        return None

    def _found(self, unit: Unit) -> None:
        """Another run has finished a unit."""
        self.state.kept += 1
        self.state.finished_paths += unit.paths
        self._over(unit)

    def _next(self, relief: str | None, others: Sequence[str]) -> Unit | None:
        if not self._groups:
            return None
        if relief not in self._groups:
            fresh = (name for name in self._groups if name not in others)
            relief = next(fresh, None) or max(self._groups, key=lambda name: len(self._groups[name]))
        unit = self._groups[relief or ""].popleft()
        if not self._groups[unit.relief]:
            del self._groups[unit.relief]
        return unit

    def settle(self, unit: Unit, failure: str | None, worker: int = 0, rays: int = 0) -> None:
        """Worker `worker` has finished a unit with so many rays, or could not: the sentence why."""
        self.state.current.pop(worker, None)
        self.state.finished_rays += rays
        self.state.finished_paths += unit.paths
        if failure is None:
            self.state.computed += 1
        else:
            self.state.failures.append(f"experiment {unit.experiment + 1}, realisation {unit.realisation}: {failure}")
        self._over(unit)

    def _over(self, unit: Unit) -> None:
        """A unit is finished, or given up: others may have waited for it."""
        self._release(unit)
        for other in self._waiting.pop(unit.name, ()):
            self._add(other)

    def died(self, unit: Unit) -> bool:
        """The worker of a unit died; whether the unit will be tried again."""
        self._deaths[unit.name] = self._deaths.get(unit.name, 0) + 1
        if self._deaths[unit.name] >= DEATHS:
            return False
        self._release(unit)
        self._add(unit)
        return True

    def release_all(self) -> None:
        """The run ends: take back what it still claims."""
        for name in tuple(self._held):
            self._folder.release(name)
        self._held.clear()

    def _release(self, unit: Unit) -> None:
        self._held.discard(unit.name)
        self._folder.release(unit.name)

    def _add(self, unit: Unit) -> None:
        self._groups.setdefault(unit.relief, deque()).append(unit)


def run(
    campaign: Campaign,
    folder: str | Path,
    *,
    workers: int = 0,
    shard: tuple[int, int] = (1, 1),
    threads: int | None = None,
    scheduler: str | None = None,
    report: Report | None = None,
) -> State:
    """Compute the units of a campaign that `folder` lacks.

    With `workers` so many processes share the cores, with a `scheduler` (its address) the workers of a Dask cluster
    compute, each with its own number of threads; otherwise this process uses all cores or `threads`. `shard` (i, n)
    computes the i-th of n parts only. What is finished is kept whatever happens; calling again continues.

    Raises `InputError` for what cannot be run, OSError where nothing can be written, `ClusterError`, and
    KeyboardInterrupt.
    """
    from gonio.campaign.units import Plan

    with contextlib.nullcontext() if scheduler is None else _connected(scheduler) as client:
        plan, home = Plan.of(campaign), CampaignStore(Path(folder))
        manifest = plan.manifest()
        _refuse_other_versions(home, manifest["versions"])
        changed = home.create(manifest)
        queue = Queue(plan.shard(*shard), home, f", shard {shard[0]}/{shard[1]}" if shard[1] > 1 else "")
        queue.state.changed = changed
        told = report or (lambda _: None)
        if client:
            _on_cluster(client, campaign.experiments, queue, told, home)
        elif workers:
            _WorkerPool(campaign.experiments, queue, told, home, threads or max(1, cores() // workers)).run(workers)
        else:
            _alone(campaign.experiments, queue, told, home, threads or cores())
    return queue.state


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def seconds_left(folder: CampaignStore) -> float | None:
    """How long a campaign will take at the pace of the last hour; None where too little was finished in it."""
    paths = paths_of(folder.manifest())
    with os.scandir(folder.units) as entries:
        finished = {entry.name[:-4]: entry.stat().st_mtime for entry in entries if entry.name[:-4] in paths}
    now, left = time.time(), sum(paths.values()) - sum(paths[unit] for unit in finished)
    recent = sorted((when, paths[unit]) for unit, when in finished.items() if when > now - PACE_SECONDS)
    done = sum(count for _, count in recent[1:])
    return left * (now - recent[0][0]) / done if done else None


def _refuse_other_versions(folder: CampaignStore, versions: dict[str, str]) -> None:
    """Raise `InputError` if the folder was begun with packages that may give other numbers."""
    from gonio.toml_files import InputError

    if not (folder.path / "manifest.json").exists():
        return
    try:
        begun = folder.manifest()["versions"]
    except (InputError, KeyError):  # a damaged manifest is written anew
        return
    differing = [f"{name} {begun.get(name)}, now {now}" for name, now in versions.items() if begun.get(name) != now]
    if differing:
        raise InputError(
            f"{folder.path} was begun with other versions, which may give other numbers ({'; '.join(differing)}): "
            "install those, or give another folder."
        )


def attempt(work: Callable[[], None]) -> str | None:
    """Do `work`; the sentence of what is wrong with this unit, if anything."""
    from gonio.toml_files import InputError

    try:
        work()
    except InputError as error:
        return str(error)
    except MemoryError as error:
        return f"not enough memory: {error or 'make the surface, the detector or the number of workers smaller'}."
    return None


# --- On a cluster ----------------------------------------------------------------------------------------------------


def _connected(scheduler: str) -> contextlib.AbstractContextManager[Client]:
    from gonio.campaign.cluster import connected

    return connected(scheduler)


def _on_cluster(
    client: Client, experiments: Sequence[Experiment], queue: Queue, report: Report, folder: CampaignStore
) -> None:
    from gonio.campaign.cluster import WorkerPool

    WorkerPool(client, experiments, queue, report, CampaignStore(folder.path.absolute())).run()


# --- In this process -------------------------------------------------------------------------------------------------


def _alone(
    experiments: Sequence[Experiment], queue: Queue, report: Report, folder: CampaignStore, threads: int
) -> None:
    """Compute all units here, one after another."""
    from gonio.campaign.units import UnitRunner

    runner, relief, state = UnitRunner(folder, threads), None, queue.state

    def progress(paths: int, total: int, rays: int) -> None:
        state.current[0] = paths, rays
        report(state)

    try:
        while unit := queue.take(relief):
            relief = unit.relief
            failure = attempt(lambda unit=unit: runner.measure(unit, experiments[unit.experiment], progress))  # type: ignore[misc]
            queue.settle(unit, failure, rays=state.current.get(0, (0, 0))[1])
            report(state)
    finally:
        queue.release_all()


# --- In processes of their own ---------------------------------------------------------------------------------------


@dataclass
class _Worker:
    """A place for a worker: the process that sits there now, and what it computes."""

    process: Any
    connection: Connection
    unit: Unit | None = None
    relief: str | None = None


class _WorkerPool:
    """Workers, and who has which unit. They write their units themselves, so that little passes through here."""

    def __init__(
        self, experiments: Sequence[Experiment], queue: Queue, report: Report, folder: CampaignStore, threads: int
    ) -> None:
        self._experiments, self._queue, self._state, self._report = experiments, queue, queue.state, report
        self._task = str(folder.path), threads
        self._workers: list[_Worker] = []

    def run(self, workers: int) -> None:
        """Compute all units with so many processes."""
        try:
            self._workers = [self._hired() for _ in range(min(workers, self._state.units - self._state.kept))]
            while True:
                for number, worker in enumerate(self._workers):
                    if worker.unit is None:
                        self._assign(number)
                busy = [worker.connection for worker in self._workers if worker.unit is not None]
                if not busy:
                    break
                ready = wait(busy, timeout=REPORT_SECONDS)
                for number, worker in enumerate(self._workers):
                    if worker.connection in ready:
                        self._listen(number)
                self._report(self._state)
            self._dismiss(STOP_SECONDS)
        finally:
            self._dismiss(0.0)
            self._queue.release_all()

    def _hired(self) -> _Worker:
        """A new worker. It is spawned, not forked: threads and locks of this process are none of its business."""
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(there, *self._task), daemon=True)
        process.start()
        there.close()  # so that this end tells when the worker dies
        return _Worker(process, here)

    def _assign(self, number: int) -> None:
        """Give a worker its next unit, if there is one for it."""
        worker = self._workers[number]
        others = [other.relief for other in self._workers if other is not worker and other.unit and other.relief]
        unit = self._queue.take(worker.relief, others)
        if unit is None:
            return
        worker.unit, worker.relief = unit, unit.relief
        with contextlib.suppress(OSError):  # it is dead: heard of in `_listen`
            worker.connection.send((unit, self._experiments[unit.experiment]))

    def _listen(self, number: int) -> None:
        """Take what a worker tells: how far it is, that it has finished, or that it is dead."""
        worker = self._workers[number]
        assert worker.unit is not None
        try:
            kind, content = worker.connection.recv()
        except (EOFError, OSError):
            self._replace(number)
            return
        if kind == "progress":
            self._state.current[number] = content
        elif kind == "done":
            unit, worker.unit = worker.unit, None
            self._queue.settle(unit, content[0], number, content[1])
        else:
            raise content

    def _replace(self, number: int) -> None:
        """Another worker in place of a dead one; its unit is computed again."""
        worker, self._state.deaths = self._workers[number], self._state.deaths + 1
        assert worker.unit is not None
        worker.connection.close()
        worker.process.join()
        self._state.current.pop(number, None)
        if not self._queue.died(worker.unit):
            end = f"its worker died {DEATHS} times (exit code {worker.process.exitcode}), as when memory is short."
            self._queue.settle(worker.unit, end, number)
        self._workers[number] = self._hired()

    def _dismiss(self, patience: float) -> None:
        """End all workers: a worker whose connection is closed goes by itself, or is made to."""
        for worker in self._workers:
            worker.connection.close()
            if patience == 0.0:
                worker.process.kill()
        for worker in self._workers:
            worker.process.join(patience or None)
            if worker.process.exitcode is None:
                worker.process.kill()
                worker.process.join()
        self._workers = []


def _work(connection: Connection, folder: str, threads: int) -> None:
    """The life of a worker: computes the units that come through `connection` until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the coordinator's matter
    from gonio.campaign.units import UnitRunner

    runner, last, traced = UnitRunner(CampaignStore(Path(folder)), threads), 0.0, 0

    def progress(paths: int, total: int, rays: int) -> None:
        nonlocal last, traced
        traced = rays
        if time.monotonic() - last >= REPORT_SECONDS:
            last = time.monotonic()
            connection.send(("progress", (paths, rays)))

    # The coordinator may be gone at any moment, too.
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            unit, experiment = connection.recv()
            traced = 0
            try:
                failure = attempt(lambda u=unit, e=experiment: runner.measure(u, e, progress))  # type: ignore[misc]
            except (BrokenPipeError, ConnectionResetError):
                return
            except OSError as error:
                connection.send(("stop", error))
            except Exception:
                connection.send(("stop", RuntimeError(f"a worker failed:\n{traceback.format_exc()}")))
            else:
                connection.send(("done", (failure, traced)))
