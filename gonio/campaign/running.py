"""Computes the units of a campaign that are missing, with the workers that it is given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gonio.campaign.processes import cores
from gonio.campaign.queue import Queue, Report, State
from gonio.campaign.store import CampaignStore
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan, UnitRunner
from gonio.experiment import Experiment
from gonio.toml_files import InputError


class WorkerPool(Protocol):
    """Who computes: `ThisProcess`, a `ProcessPool` of this machine, or the `ClusterPool` of many."""

    def compute(self, queue: Queue, experiments: Sequence[Experiment], report: Report) -> None:
        """Compute all units of `queue`, which are parts of `experiments`, and `report` a few times a second.

        Whatever happens, what is finished is in the queue's store and nothing is claimed any more.
        """
        ...


@dataclass(frozen=True)
class ThisProcess:
    """Computes units here, one after another."""

    threads: int | None = None
    """Those of every unit; all cores if not given."""

    def compute(self, queue: Queue, experiments: Sequence[Experiment], report: Report) -> None:
        """Compute all units; see `WorkerPool`."""
        runner, relief, state = UnitRunner(queue.store, self.threads or cores()), None, queue.state

        def progress(paths: int, total: int, rays: int) -> None:
            state.current[0] = paths, rays
            report(state)

        try:
            while unit := queue.take(relief):
                relief = unit.relief
                queue.settle(unit, runner.attempt(unit, experiments[unit.experiment], progress))
                report(state)
        finally:
            queue.release_all()


def run(
    campaign: Campaign,
    folder: str | Path,
    pool: WorkerPool | None = None,
    *,
    shard: tuple[int, int] = (1, 1),
    report: Report | None = None,
) -> State:
    """Compute the units of a campaign that `folder` lacks.

    The workers of `pool` compute; if not given, this process, on all cores. `shard` (i, n) computes the i-th of n parts
    only. What is finished is kept whatever happens; calling again continues.

    Raises `InputError` for what cannot be run, OSError where nothing can be written, `ClusterError` where a cluster is
    gone, and KeyboardInterrupt.
    """
    plan, store = Plan.of(campaign), CampaignStore(Path(folder))
    manifest = plan.manifest()
    _refuse_other_versions(store, manifest["versions"])
    changed = store.create(manifest)
    queue = Queue(plan.shard(*shard), store, f", shard {shard[0]}/{shard[1]}" if shard[1] > 1 else "")
    queue.state.changed = changed
    (pool or ThisProcess()).compute(queue, campaign.experiments, report or (lambda _: None))
    return queue.state


def _refuse_other_versions(store: CampaignStore, versions: dict[str, str]) -> None:
    """Raise `InputError` if the folder was begun with packages that may give other numbers."""
    if not store.manifest_file.exists():
        return
    try:
        begun = store.manifest()["versions"]
    except (InputError, KeyError):  # a damaged manifest is written anew
        return
    differing = [f"{name} {begun.get(name)}, now {now}" for name, now in versions.items() if begun.get(name) != now]
    if differing:
        raise InputError(
            f"{store.path} was begun with other versions, which may give other numbers ({'; '.join(differing)}): "
            "install those, or give another folder."
        )
