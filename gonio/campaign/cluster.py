"""Workers that are those of a running Dask cluster, whose machines share the folder's file system.

A worker gets one unit at a time, of the relief that it has built already if there is one, and writes the unit itself:
all that comes back is how far it is, or what is wrong. Dask finds the workers and tells which are alive; who computes
what is decided here, by the same queue as for processes on one machine.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import itertools
import logging
import secrets
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from gonio.campaign.queue import REPORT_SECONDS, Queue, Report, given_up
from gonio.campaign.store import CampaignStore
from gonio.campaign.units import Unit, UnitRunner, versions
from gonio.experiment import Experiment
from gonio.goniometer import Progress
from gonio.toml_files import InputError

if TYPE_CHECKING:
    from distributed import Client

CONNECT_SECONDS = 10.0
"""A scheduler that does not answer by then is taken for absent."""

UPDATE_SECONDS = 1.0
"""Workers may come and go; they are counted this often."""

SHARED_SECONDS = 10.0
"""A shared file system shows a new file everywhere by then."""


class ClusterError(RuntimeError):
    """A cluster cannot go on: why, without the full stop."""


@dataclass(frozen=True)
class ClusterPool:
    """All workers of a cluster that have the same packages and see the folder, each with its own number of threads."""

    client: Client

    def compute(self, queue: Queue, experiments: Sequence[Experiment], report: Report) -> None:
        """Compute all units; see `WorkerPool`. Raises `InputError` if no worker is fit, `ClusterError` and OSError."""
        _Coordinator(self.client, queue, experiments, report, str(queue.store.path.absolute())).run()


@contextlib.contextmanager
def connected(address: str) -> Iterator[ClusterPool]:
    """The workers of the scheduler at `address`. Raises `InputError` where none answers or Dask is not installed."""
    try:
        from distributed import Client
    except ImportError:
        raise InputError(f'--scheduler {address}: needs Dask, pip install "gonio[cluster]".') from None
    with _silent(logging.getLogger("distributed")):
        try:
            _check(address)
            client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False, name="gonio")
        except (OSError, ValueError) as error:
            raise InputError(
                f"--scheduler {address}: no Dask scheduler answers there ({error}): give the address that dask "
                "scheduler prints, such as tcp://10.0.0.1:8786."
            ) from None
        with client:
            yield ClusterPool(client)


def _check(address: str) -> None:
    """Raise ValueError for what cannot be an address: Dask would leave a client behind that cannot be closed."""
    parts = urlsplit(address)
    if not (parts.scheme and parts.hostname and parts.port):
        raise ValueError("that is not protocol://host:port")


@contextlib.contextmanager
def _silent(logger: logging.Logger) -> Iterator[None]:
    """What Dask logs when a worker or its scheduler is gone, is told in sentences here."""
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(level)


# --- The process that hands out units --------------------------------------------------------------------------------


@dataclass
class _Worker:
    """A worker of the cluster, and what it does now."""

    address: str
    threads: int
    future: Any = None
    """Its examination first, then unit after unit; None while there is nothing to do."""
    unit: Unit | None = None
    relief: str | None = None
    """Of the unit that it had last: it is built there."""
    fit: bool = False
    """Whether it may compute: it passed the examination."""
    leaving: bool = False


@dataclass
class _Coordinator:
    """Gives each worker of a cluster its next unit."""

    client: Client
    queue: Queue
    experiments: Sequence[Experiment]
    report: Report
    folder: str
    """As all machines see it."""
    _workers: dict[int, _Worker] = field(default_factory=dict)
    _numbers: Iterator[int] = field(default_factory=itertools.count)
    _updated: float = 0.0
    _messages: SimpleQueue[tuple[int, Any]] = field(default_factory=SimpleQueue)
    _topic: str = field(default_factory=lambda: f"gonio-{secrets.token_hex(8)}")

    def run(self) -> None:
        """Compute all units; see `ClusterPool.compute`."""
        self.client.subscribe_topic(self._topic, lambda event: self._messages.put(event[1]))
        try:
            while self.queue.left or any(worker.unit for worker in self._workers.values()):
                self._update_workers()
                self._assign()
                self._listen()
                self.report(self.queue.state)
        finally:
            self.queue.release_all()
            self._forget_reliefs()

    def _update_workers(self) -> None:
        """Examine workers that have come, give up those that are gone."""
        if time.monotonic() - self._updated < UPDATE_SECONDS:
            return
        present = self._present()
        for number, worker in tuple(self._workers.items()):
            if worker.address not in present:
                self._lost(number)
            else:
                worker.leaving = present[worker.address]["status"].startswith("clos")
        known = {worker.address for worker in self._workers.values()}
        for address, worker in present.items():
            if address not in known and worker["status"] == "running":
                self._examine(address, worker["nthreads"])
        self._updated = time.monotonic()

    def _present(self) -> dict[str, Any]:
        """The workers that the scheduler knows."""
        try:
            workers: dict[str, Any] = self.client.scheduler_info(n_workers=-1)["workers"]
        except OSError:
            raise _gone() from None
        return workers

    def _examine(self, address: str, threads: int) -> None:
        """Have a new worker tell whether it may compute."""
        number, manifest = next(self._numbers), _manifest(self.folder) or ""
        self._workers[number] = _Worker(address, threads)
        self._give(number, _examined, _all_versions(), self.folder, manifest, SHARED_SECONDS)

    def _give(self, number: int, work: Any, *what: Any) -> None:
        """Have one worker, and no other, do something; its end is heard of in `_listen`."""
        worker = self._workers[number]
        worker.future = self.client.submit(work, *what, workers=[worker.address], pure=False, retries=0)
        worker.future.add_done_callback(lambda future: self._messages.put((number, future)))

    def _assign(self) -> None:
        """Give every idle worker a unit, if there is one for it."""
        for number, worker in self._workers.items():
            if worker.fit and not worker.leaving and worker.unit is None:
                others = [other.relief for other in self._workers.values() if other.unit and other.relief]
                unit = self.queue.take(worker.relief, others)
                if unit is None:
                    return
                worker.unit, worker.relief = unit, unit.relief
                tell = number, self._topic
                self._give(number, _compute, unit, self.experiments[unit.experiment], self.folder, worker.threads, tell)

    def _listen(self) -> None:
        """Wait for what workers tell, and take all of it."""
        with contextlib.suppress(Empty):
            number, content = self._messages.get(timeout=REPORT_SECONDS)
            while True:
                worker = self._workers.get(number)
                if worker is not None and worker.future is content:
                    self._ended(number, worker)
                elif worker is not None and worker.unit is not None and isinstance(content, (list, tuple)):
                    name, paths, rays = content
                    if name == worker.unit.name:
                        self.queue.state.current[number] = paths, rays
                number, content = self._messages.get_nowait()

    def _ended(self, number: int, worker: _Worker) -> None:
        """A worker has done what it was given, or could not."""
        future, unit, worker.future, worker.unit = worker.future, worker.unit, None, None
        if future.status not in ("finished", "error"):
            raise _gone()
        error = future.exception() if future.status == "error" else None
        if unit is None:
            self._examination_ended(worker, error)
        else:
            self.queue.settle(unit, _sentence(error), number)

    def _examination_ended(self, worker: _Worker, error: BaseException | None) -> None:
        """A worker is fit, or is left out; raises `InputError` if none is fit."""
        worker.fit = error is None
        self._count_workers()
        if error is not None:
            why = str(error) if isinstance(error, _UnfitError) else f"cannot run gonio ({_first_line(error)})"
            self.queue.state.refused.append(f"worker {worker.address} {why}")
        if not any(other.fit or other.future for other in self._workers.values()):
            raise InputError(*self.queue.state.refused)

    def _lost(self, number: int) -> None:
        """A worker is gone: its unit is for another one."""
        worker = self._workers.pop(number)
        self._count_workers()
        if worker.future is not None:
            worker.future.cancel()
        if worker.unit is not None:
            self.queue.died(worker.unit, number)

    def _count_workers(self) -> None:
        self.queue.state.workers = sum(worker.fit for worker in self._workers.values())

    def _forget_reliefs(self) -> None:
        """Leave nothing behind: units under way stop when their client is gone, what was built is forgotten."""
        fit = [worker.address for worker in self._workers.values() if worker.fit]
        if fit and self.client.status == "running":
            with contextlib.suppress(OSError):
                self.client.run(_forget, workers=fit, on_error="ignore")


def _gone() -> ClusterError:
    return ClusterError("The Dask scheduler is gone")


def _sentence(error: BaseException | None) -> str | None:
    """What is wrong with a unit. Raises `error` unless it is the unit's alone."""
    from distributed.scheduler import KilledWorker

    if error is None or isinstance(error, _FailedError):
        return None if error is None else str(error)
    if isinstance(error, KilledWorker):
        return given_up()
    if isinstance(error, OSError):
        raise error
    raise RuntimeError(str(error) if isinstance(error, _BrokenError) else f"a worker failed: {error!r}")


def _first_line(error: BaseException) -> str:
    """What went wrong first."""
    while error.__cause__ is not None:
        error = error.__cause__
    return f"{type(error).__name__}: {error}".splitlines()[0]


def _all_versions() -> dict[str, str]:
    """Those that decide the numbers, and that of what carries the units."""
    return versions() | {"distributed": importlib.metadata.version("distributed")}


def _manifest(folder: str) -> str | None:
    """A hash of the manifest; None where there is none to read."""
    try:
        return hashlib.sha256(CampaignStore(Path(folder)).manifest_file.read_bytes()).hexdigest()
    except OSError:
        return None


# --- On a worker -----------------------------------------------------------------------------------------------------


class _UnfitError(Exception):
    """A worker may not compute: why, as the end of a sentence."""


class _FailedError(Exception):
    """A unit cannot be computed: a sentence."""


class _BrokenError(Exception):
    """A fault of ours: what it was, with its trace."""


class _AbandonedError(Exception):
    """Nobody waits for this unit any more."""


@dataclass
class _SharedRunner:
    """What a worker process computes with: one unit at a time, with all of its threads."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    runner: UnitRunner | None = None


@functools.cache
def _shared() -> _SharedRunner:
    return _SharedRunner()


def _forget() -> None:
    _shared().runner = None


def _examined(theirs: dict[str, str], folder: str, manifest: str, patience: float) -> None:
    """Raise `_UnfitError` unless this worker has the same packages and can write to the same folder.

    `theirs` are the coordinator's versions and `manifest` the hash of what it sees, which is to be seen here, too,
    within `patience` seconds.
    """
    ours = _all_versions()
    differing = [
        f"{name} {ours[name]} instead of {version}" for name, version in theirs.items() if ours[name] != version
    ]
    if differing:
        raise _UnfitError(
            f"has other versions ({', '.join(differing)}), which may give other numbers: install the same"
        )
    end = time.monotonic() + patience
    while _manifest(folder) != manifest:
        if time.monotonic() > end:
            raise _UnfitError(f"does not see {folder}: give a folder that all machines share under the same path")
        time.sleep(0.1)
    try:
        with tempfile.TemporaryFile(dir=CampaignStore(Path(folder)).units):
            pass
    except OSError as error:
        raise _UnfitError(f"cannot write to {folder}: {error.strerror}") from None


def _compute(unit: Unit, experiment: Experiment, folder: str, threads: int, tell: tuple[int, str]) -> None:
    """Compute and keep a unit; `tell` is this worker's number and the topic under which it tells how far it is.

    Raises `_FailedError` if the unit cannot be computed, OSError where nothing can be written.
    """
    from distributed import get_worker

    worker, last, (number, topic) = get_worker(), 0.0, tell
    key = worker.get_current_task()

    def progress(paths: int, total: int, rays: int) -> None:
        nonlocal last
        task = worker.state.tasks.get(key)
        if task is None or task.state == "cancelled":
            raise _AbandonedError
        if time.monotonic() - last >= REPORT_SECONDS or paths == total:
            last = time.monotonic()
            worker.log_event(topic, (number, (unit.name, paths, rays)))

    # Errors travel as plain text: Dask waits forever for one that it cannot read.
    try:
        failure = _attempt(unit, experiment, Path(folder), threads, progress)
    except OSError as error:
        refused: Exception | None = OSError(error.errno, error.strerror or str(error))
    except _AbandonedError:
        refused = _AbandonedError()
    except Exception:
        refused = _BrokenError(f"a worker failed:\n{traceback.format_exc()}")
    else:
        refused = None if failure is None else _FailedError(failure)
    if refused is not None:
        raise refused


def _attempt(unit: Unit, experiment: Experiment, folder: Path, threads: int, progress: Progress) -> str | None:
    """`UnitRunner.attempt` of this process's runner."""
    shared = _shared()
    with shared.lock:
        if shared.runner is None or (shared.runner.store.path, shared.runner.threads) != (folder, threads):
            shared.runner = UnitRunner(CampaignStore(folder), threads)
        return shared.runner.attempt(unit, experiment, progress)
