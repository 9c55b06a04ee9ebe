"""Workers that are processes of this machine, and may die at any moment."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import TYPE_CHECKING

from gonio.campaign.queue import REPORT_SECONDS, Queue, Report
from gonio.campaign.store import CampaignStore

if TYPE_CHECKING:
    from gonio.campaign.units import Unit
    from gonio.experiment import Experiment

STOP_SECONDS = 5.0
"""Workers that do not end by then are killed."""


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True)
class ProcessPool:
    """Processes that compute a unit each at a time."""

    workers: int
    """How many, 1 or more."""
    threads: int | None = None
    """Those of each; an equal share of the cores if not given."""

    def compute(self, queue: Queue, experiments: Sequence[Experiment], report: Report) -> None:
        """Compute all units; see `WorkerPool`."""
        threads = self.threads or max(1, cores() // self.workers)
        _Coordinator(queue, experiments, report, threads).run(self.workers)


# --- The process that hands out units --------------------------------------------------------------------------------


@dataclass
class _Worker:
    """A process, and what it computes."""

    process: SpawnProcess
    connection: Connection
    unit: Unit | None = None
    relief: str | None = None
    """Of the unit that it had last: it is built there."""


class _Coordinator:
    """Gives each worker its next unit. Workers write their units themselves, so that little passes through here."""

    def __init__(self, queue: Queue, experiments: Sequence[Experiment], report: Report, threads: int) -> None:
        self._queue, self._state, self._experiments, self._report = queue, queue.state, experiments, report
        self._threads = threads
        self._workers: list[_Worker] = []

    def run(self, workers: int) -> None:
        """Compute all units with so many processes."""
        try:
            self._workers = [self._started() for _ in range(min(workers, self._state.units - self._state.kept))]
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
            self._stop(STOP_SECONDS)
        finally:
            self._stop(0.0)
            self._queue.release_all()

    def _started(self) -> _Worker:
        """A new worker. It is spawned, not forked: threads and locks of this process are none of its business."""
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(there, str(self._queue.store.path), self._threads), daemon=True)
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
            failure, rays = content
            self._queue.settle(unit, failure, number, rays)
        else:
            raise content

    def _replace(self, number: int) -> None:
        """Another worker in place of a dead one; its unit is computed again."""
        worker = self._workers[number]
        assert worker.unit is not None
        worker.connection.close()
        worker.process.join()
        self._queue.died(worker.unit, number, f"exit code {worker.process.exitcode}")
        self._workers[number] = self._started()

    def _stop(self, patience: float) -> None:
        """End all workers: one whose connection is closed ends by itself, or is made to."""
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


# --- In a worker's process -------------------------------------------------------------------------------------------


def _work(connection: Connection, folder: str, threads: int) -> None:
    """Compute the units that come through `connection`, until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the coordinator's matter
    # Imported only now: numba and scipy take a second, in which Ctrl-C would end this process with a traceback.
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
                failure = runner.attempt(unit, experiment, progress)
            except (BrokenPipeError, ConnectionResetError):
                return
            except OSError as error:
                connection.send(("stop", error))
            except Exception:
                connection.send(("stop", RuntimeError(f"a worker failed:\n{traceback.format_exc()}")))
            else:
                connection.send(("done", (failure, traced)))
