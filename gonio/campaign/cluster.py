"""Computes the units of a campaign on a running Dask cluster whose machines share the folder's file system.

A worker gets one unit at a time, of the relief that it has built already if there is one, and writes the unit itself:
all that comes back is how far it is, or what is wrong. Dask finds the workers and tells which are alive; who computes
what is decided here, by the same queue as for processes on one machine.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
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

from gonio.campaign import running
from gonio.campaign.running import REPORT_SECONDS, ClusterError, Queue, Report, attempt
from gonio.campaign.store import CampaignStore

if TYPE_CHECKING:
    from distributed import Client

    from gonio.campaign.units import Unit, UnitRunner
    from gonio.experiment import Experiment
    from gonio.goniometer import Progress

CONNECT_SECONDS = 10.0
"""A scheduler that does not answer by then is taken for absent."""

MEET_SECONDS = 1.0
"""Workers may come and go; they are counted this often."""

SHARED_SECONDS = 10.0
"""A shared file system shows a new file everywhere by then."""


@contextlib.contextmanager
def connected(address: str) -> Iterator[Client]:
    """A connection to the scheduler at `address`. Raises `InputError` where none answers or Dask is not installed."""
    from gonio.toml_files import InputError

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
            yield client


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


@dataclass
class _Worker:
    """A worker of the cluster, and what it does now."""

    address: str
    threads: int
    future: Any
    """Its greeting first, then unit after unit; None while there is nothing to do."""
    unit: Unit | None = None
    relief: str | None = None
    fit: bool = False
    """Whether it may compute: the greeting went well."""
    leaving: bool = False


@dataclass
class WorkerPool:
    """The workers of a cluster, and who has which unit."""

    client: Client
    experiments: Sequence[Experiment]
    queue: Queue
    report: Report
    folder: CampaignStore
    _workers: dict[int, _Worker] = field(default_factory=dict)
    _hired: int = 0
    _met: float = 0.0
    _heard: SimpleQueue[tuple[int, Any]] = field(default_factory=SimpleQueue)
    _topic: str = field(default_factory=lambda: f"gonio-{secrets.token_hex(8)}")

    def run(self) -> None:
        """Compute all units. Raises `InputError` if every worker is unfit, `ClusterError` and OSError."""
        self.client.subscribe_topic(self._topic, lambda event: self._heard.put(event[1]))
        try:
            while self.queue.left or any(worker.unit for worker in self._workers.values()):
                self._meet()
                self._assign()
                self._listen()
                self.report(self.queue.state)
        finally:
            self.queue.release_all()
            self._dismiss()

    def _meet(self) -> None:
        """Greet workers that have come, give up those that are gone."""
        if time.monotonic() - self._met < MEET_SECONDS:
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
                self._greet(address, worker["nthreads"])
        self._met = time.monotonic()

    def _present(self) -> dict[str, Any]:
        """The workers that the scheduler knows."""
        try:
            workers: dict[str, Any] = self.client.scheduler_info(n_workers=-1)["workers"]
        except OSError:
            raise _gone() from None
        return workers

    def _greet(self, address: str, threads: int) -> None:
        """Have a new worker tell whether it may compute."""
        from gonio.campaign.units import versions

        known = hashlib.sha256((self.folder.path / "manifest.json").read_bytes()).hexdigest()
        self._workers[self._hired] = _Worker(address, threads, None)
        self._give(self._hired, _greeting, _all_versions(versions()), str(self.folder.path), known, SHARED_SECONDS)
        self._hired += 1

    def _give(self, number: int, work: Any, *what: Any) -> None:
        """Have one worker, and no other, do something; its end is heard of in `_listen`."""
        worker = self._workers[number]
        worker.future = self.client.submit(work, *what, workers=[worker.address], pure=False, retries=0)
        worker.future.add_done_callback(lambda future: self._heard.put((number, future)))

    def _assign(self) -> None:
        """Give every idle worker a unit, if there is one for it."""
        for number, worker in self._workers.items():
            if worker.fit and not worker.leaving and worker.unit is None:
                others = [other.relief for other in self._workers.values() if other.unit and other.relief]
                worker.unit = self.queue.take(worker.relief, others)
                if worker.unit is None:
                    return
                worker.relief = worker.unit.relief
                experiment = self.experiments[worker.unit.experiment]
                self._give(
                    number,
                    _compute,
                    worker.unit,
                    experiment,
                    str(self.folder.path),
                    worker.threads,
                    number,
                    self._topic,
                )

    def _listen(self) -> None:
        """Wait for what workers tell, and take all of it."""
        with contextlib.suppress(Empty):
            number, content = self._heard.get(timeout=REPORT_SECONDS)
            while True:
                worker = self._workers.get(number)
                if worker is not None and worker.future is content:
                    self._ended(number, worker)
                elif worker is not None and worker.unit is not None and isinstance(content, (list, tuple)):
                    name, paths, rays = content
                    if name == worker.unit.name:
                        self.queue.state.current[number] = paths, rays
                number, content = self._heard.get_nowait()

    def _ended(self, number: int, worker: _Worker) -> None:
        """A worker has done what it was given, or could not."""
        future, unit, worker.future, worker.unit = worker.future, worker.unit, None, None
        if future.status not in ("finished", "error"):
            raise _gone()
        error = future.exception() if future.status == "error" else None
        if unit is None:
            self._greeted(worker, error)
        else:
            self.queue.settle(unit, _sentence(error), number, self.queue.state.current.get(number, (0, 0))[1])

    def _greeted(self, worker: _Worker, error: BaseException | None) -> None:
        """A worker is fit, or is left out; raises `InputError` if none is fit."""
        from gonio.toml_files import InputError

        worker.fit = error is None
        self.queue.state.workers = sum(other.fit for other in self._workers.values())
        if error is not None:
            why = str(error) if isinstance(error, _UnfitError) else f"cannot run gonio ({_first_line(error)})"
            self.queue.state.refused.append(f"worker {worker.address} {why}")
        if not any(other.fit or other.future for other in self._workers.values()):
            raise InputError(*self.queue.state.refused)

    def _lost(self, number: int) -> None:
        """A worker is gone: its unit is for another one."""
        worker, state = self._workers.pop(number), self.queue.state
        state.workers = sum(other.fit for other in self._workers.values())
        state.current.pop(number, None)
        if worker.future is not None:
            worker.future.cancel()
        if worker.unit is not None:
            state.deaths += 1
            if not self.queue.died(worker.unit):
                self.queue.settle(worker.unit, _died(), number)

    def _dismiss(self) -> None:
        """Leave nothing behind: units under way stop when their client is gone, reliefs are forgotten."""
        fit = [worker.address for worker in self._workers.values() if worker.fit]
        if fit and self.client.status == "running":
            with contextlib.suppress(OSError):
                self.client.run(_forget, workers=fit, on_error="ignore")


def _died() -> str:
    return f"its worker died {running.DEATHS} times, as when memory is short."


def _gone() -> ClusterError:
    return ClusterError("The Dask scheduler is gone")


def _sentence(error: BaseException | None) -> str | None:
    """What is wrong with a unit. Raises `error` unless it is the unit's alone."""
    from distributed.scheduler import KilledWorker

    if error is None or isinstance(error, _FailedError):
        return None if error is None else str(error)
    if isinstance(error, KilledWorker):
        return _died()
    if isinstance(error, OSError):
        raise error
    raise RuntimeError(str(error) if isinstance(error, _BrokenError) else f"a worker failed: {error!r}")


def _first_line(error: BaseException) -> str:
    """What went wrong first."""
    while error.__cause__ is not None:
        error = error.__cause__
    return f"{type(error).__name__}: {error}".splitlines()[0]


def _all_versions(decisive: dict[str, str]) -> dict[str, str]:
    """Those that decide the numbers, and that of what carries the units."""
    return decisive | {"distributed": importlib.metadata.version("distributed")}


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
class _Workplace:
    """A worker process's place of work: units are computed one at a time, each with all of its threads."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    runner: UnitRunner | None = None


@functools.cache
def _workplace() -> _Workplace:
    return _Workplace()


def _forget() -> None:
    _workplace().runner = None


def _greeting(versions: dict[str, str], folder: str, manifest: str, patience: float) -> None:
    """Raise `_UnfitError` unless this worker has the same packages and can write to the same folder."""
    from gonio.campaign import units

    ours = _all_versions(units.versions())
    differing = [
        f"{name} {ours[name]} instead of {version}" for name, version in versions.items() if ours[name] != version
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


def _manifest(folder: str) -> str | None:
    try:
        return hashlib.sha256((Path(folder) / "manifest.json").read_bytes()).hexdigest()
    except OSError:
        return None


def _compute(unit: Unit, experiment: Experiment, folder: str, threads: int, number: int, topic: str) -> None:
    """Compute and keep a unit. Raises `_FailedError` if it cannot be, OSError where nothing can be written."""
    from distributed import get_worker

    worker, last = get_worker(), 0.0
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
        failure = attempt(lambda: _measure(unit, experiment, Path(folder), threads, progress))
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


def _measure(unit: Unit, experiment: Experiment, folder: Path, threads: int, progress: Progress) -> None:
    """Measure a unit on this process's runner."""
    from gonio.campaign.units import UnitRunner

    place = _workplace()
    with place.lock:
        if place.runner is None or (place.runner.folder.path, place.runner.threads) != (folder, threads):
            place.runner = UnitRunner(CampaignStore(folder), threads)
        runner = place.runner
        runner.measure(unit, experiment, progress)
