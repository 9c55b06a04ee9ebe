"""The units of a campaign that a run has to compute: in which order they are handed out, and how far it is.

Work is idempotent: a unit's file is the same bytes whoever writes it. Runs in one folder therefore need no lock; what
another one has claimed is only left for last.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from gonio.campaign.store import CampaignStore

if TYPE_CHECKING:
    from gonio.campaign.units import Unit

DEATHS = 3
"""A unit whose worker died so often is given up."""

REPORT_SECONDS = 0.5
"""Workers tell how far they are this often."""


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
    """Units that this run has finished."""
    finished_paths: int = 0
    """Paths of the units that are finished or given up."""
    current: dict[int, tuple[int, int]] = field(default_factory=dict)
    """The paths and rays so far of each worker's unit, by the worker's number."""
    finished_rays: int = 0
    """Rays of the units that are finished or given up."""
    failures: list[str] = field(default_factory=list)
    """A sentence for every unit that could not be computed."""
    deaths: int = 0
    """Workers that died while they computed a unit."""
    changed: bool = False
    """Whether the folder held another campaign before."""
    workers: int | None = None
    """Those of a cluster that compute now; None on a single machine."""
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

    def __init__(self, units: Sequence[Unit], store: CampaignStore, run: str = "") -> None:
        """`units` in their order; `run` is what a claim says besides host and process."""
        self.store, self._run = store, run
        finished = store.finished()
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
        self._claimed: set[str] = set()
        self.state = State(len(units), len(units) - len(missing), sum(unit.paths for unit in missing))

    @property
    def left(self) -> bool:
        """Whether there are units that nobody has taken."""
        return bool(self._groups or self._waiting or self._later)

    def take(self, relief: str | None = None, others: Sequence[str] = ()) -> Unit | None:
        """A unit to compute now, of the relief that is built already if there is one, else of none of `others`."""
        while unit := self._next(relief, others):
            if self.store.has(unit.name):
                self._found(unit)
                continue
            self._claimed.add(unit.name)  # before the claim is written: Ctrl-C may come in between
            if self.store.claim(unit.name, self._run):
                return unit
            self._claimed.discard(unit.name)
            self._later.append(unit)
        # Whoever claimed these may be dead; computing one twice does no harm.
        while self._later:
            unit = self._later.pop()
            if not self.store.has(unit.name):
                return unit
            self._found(unit)
        return None

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

    def _found(self, unit: Unit) -> None:
        """Another run has finished a unit."""
        self.state.kept += 1
        self.state.finished_paths += unit.paths
        self._over(unit)

    def settle(self, unit: Unit, failure: str | None, worker: int = 0, rays: int | None = None) -> None:
        """Note that `worker` has finished a unit, or why it could not: `failure`, a sentence.

        `rays` is how many the unit took; None stands for those that the worker told of last.
        """
        _, told = self.state.current.pop(worker, (0, 0))
        self.state.finished_rays += told if rays is None else rays
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

    def died(self, unit: Unit, worker: int, how: str = "") -> None:
        """Note that `worker` died while it computed a unit, which is tried again, or given up after `DEATHS` times."""
        self.state.deaths += 1
        self.state.current.pop(worker, None)
        self._deaths[unit.name] = self._deaths.get(unit.name, 0) + 1
        if self._deaths[unit.name] < DEATHS:
            self._release(unit)
            self._add(unit)
        else:
            self.settle(unit, given_up(how), worker)

    def release_all(self) -> None:
        """The run ends: take back what it still claims."""
        for name in tuple(self._claimed):
            self.store.release(name)
        self._claimed.clear()

    def _release(self, unit: Unit) -> None:
        self._claimed.discard(unit.name)
        self.store.release(unit.name)

    def _add(self, unit: Unit) -> None:
        self._groups.setdefault(unit.relief, deque()).append(unit)


def given_up(how: str = "") -> str:
    """Why a unit is not tried again; `how` its last worker died, if that is known."""
    return f"its worker died {DEATHS} times{how and f' ({how})'}, as when memory is short."
