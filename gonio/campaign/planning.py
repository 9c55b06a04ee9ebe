"""What a campaign will take: a pilot measures a few of its units with few paths, and all others lie between these."""

from __future__ import annotations

import json
import math
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gonio.campaign.processes import cores
from gonio.campaign.results import Steps, merge
from gonio.campaign.store import CampaignStore
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan, Unit, UnitRunner, units_of, unpacked
from gonio.detectors import Klems
from gonio.experiment import Experiment
from gonio.goniometer import median_error
from gonio.tally import MAX_PATHS, Tally
from gonio.toml_files import InputError
from microsurfaces.arrays import Floats

PILOTS = 16
"""No more units are measured, unless there are more workers."""

PILOT_SECONDS = 20.0
"""After that no further unit is begun."""

TRACING_SECONDS = 0.3
"""So long must a pilot's unit be traced that its time can be told."""

SMALLEST, GROWTH = 64, 8
"""A pilot's unit begins with so many paths in each replicate, and takes more by this factor until it lasts."""

MERGED = 2
"""Of so many pilots the merged file is looked at."""


@dataclass(frozen=True)
class Forecast:
    """What a campaign will take on this machine. Errors are relative, of Monte Carlo, in one specimen."""

    experiments: int
    units: int
    reliefs: int
    """Surfaces to be built."""
    paths: int
    """As asked for: what the target needs beyond is in `paths_needed`."""
    paths_needed: int
    workers: int
    """Processes."""
    threads: int
    """Of each."""
    seconds: float
    """From the start to the last unit."""
    work: float
    """Seconds of all workers together."""
    units_bytes: int
    merged_bytes: int
    memory: int | None
    """Peak of all processes together, bytes; None where the system does not tell."""
    bin_error: tuple[float, float]
    """Half of the light leaves through bins with an error below this: median of all experiments, and the worst."""
    albedo_error: tuple[float, float]
    """Of the albedo at the worst incidence and wavelength: median of all experiments, and the worst."""
    beyond: int
    """Experiments whose target needs more paths than can be summed."""
    pilots: tuple[Sample, ...]


@dataclass(frozen=True)
class Sample:
    """What a pilot's unit took."""

    unit: Unit
    """As the campaign has it."""
    paths: int
    build: float
    """Seconds to build its surface."""
    fixed: float
    """Seconds that it takes beside its paths."""
    per_path: float
    """Seconds for each path, of many."""
    size: float
    """Bytes of its file if one could extrapolate to a single path, along a straight line over log(paths)."""
    growth: float
    """Bytes for e times as many paths."""
    bin_error: float
    """Of a single path: divide by the root of their number."""
    albedo_error: float
    """Likewise."""


def plan(
    campaign: Campaign,
    *,
    workers: int = 0,
    threads: int | None = None,
    pilot: int | None = None,
    progress: Steps | None = None,
) -> Forecast:
    """Measure a pilot and tell what the campaign will take, with `workers` processes or in this one.

    `pilot` paths are traced in each of its units, otherwise as many as can be timed. Errors are scaled by the root of
    the number of paths; stratified starts make them smaller rather than larger. `progress` gets the units done and
    those in all. Raises `InputError` for what cannot be measured, MemoryError, and KeyboardInterrupt.
    """
    whole, workers = Plan.of(campaign), max(1, workers)
    units, places = whole.shard(1, 1), _Places(campaign)
    threads = threads or max(1, cores() // workers)
    at = places.of(units)
    chosen = [units[i] for i in _spread(at, max(PILOTS, workers))]
    idle = _memory()
    with tempfile.TemporaryDirectory() as scratch:
        trial = _Trial(campaign, Path(scratch), threads, pilot)
        pilots = trial.run(chosen, workers, progress or (lambda done, total: None))
        merged = trial.merged(pilots[:MERGED])
    peak = _memory()
    memory = None if idle is None or peak is None else peak + idle * workers
    between = _Between(at, [units.index(sample.unit) for sample in pilots], pilots)
    return _forecast(whole, units, between, (workers, threads), trial.start, merged, memory)


def _forecast(
    whole: Plan,
    units: Sequence[Unit],
    between: _Between,
    workers: tuple[int, int],
    start: float,
    merged: tuple[float, float],
    memory: int | None,
) -> Forecast:
    """What the pilots tell about all units; `workers` is workers and threads, `merged` as `_Trial.merged` has it."""
    asked = np.array([unit.paths for unit in units], np.float64)
    needed, beyond = _needed(whole.campaign, units, between("bin_error"))
    seconds, build = between("fixed") + between("per_path") * needed, between("build")
    reliefs = list({unit.relief: place for place, unit in enumerate(units)}.values())
    # Where there are more workers than reliefs, each of them builds one.
    idle = max(0, min(workers[0], len(units)) - len(reliefs))
    work = float(seconds.sum() + build[reliefs].sum() + idle * build.mean())
    sizes = between("size") + between("growth") * np.log(needed)
    traced = np.sqrt(needed * _blocks(units))
    bins, albedos = (_largest(whole, units, between(quantity) / traced) for quantity in ("bin_error", "albedo_error"))
    return Forecast(
        experiments=len(whole.units),
        units=len(units),
        reliefs=len(reliefs),
        paths=int(asked.sum()),
        paths_needed=int(needed.sum()),
        workers=workers[0],
        threads=workers[1],
        seconds=start + max(work / workers[0], float((seconds + build).max())),
        work=work,
        units_bytes=int(sizes.sum()),
        merged_bytes=_merged_bytes(whole, units, sizes, merged),
        memory=memory,
        bin_error=(float(np.median(bins)), max(bins)),
        albedo_error=(float(np.median(albedos)), max(albedos)),
        beyond=beyond,
        pilots=tuple(between.pilots),
    )


def _needed(campaign: Campaign, units: Sequence[Unit], error: Floats) -> tuple[Floats, int]:
    """Of every unit the paths that it will take, and how many experiments need more than can be summed.

    `error` is that of a single path. A target takes whole replicates more, as `Goniometer` has it.
    """
    asked = np.array([unit.paths for unit in units], np.float64)
    goniometers = [campaign.experiments[unit.experiment].goniometer for unit in units]
    target = np.array([goniometer.target_error or np.inf for goniometer in goniometers])
    replicates = np.array([goniometer.replicates for goniometer in goniometers])
    more = np.ceil(replicates * error**2 / (asked * target**2)) / replicates
    needed = asked * np.maximum(1.0, more)
    beyond = needed > MAX_PATHS
    return needed, len({unit.experiment for unit, over in zip(units, beyond, strict=True) if over})


def _blocks(units: Sequence[Unit]) -> Floats:
    """How many blocks of replicates the incidence of each unit is cut into."""
    incidences = [(unit.experiment, unit.realisation, unit.incidence) for unit in units]
    counts = Counter(incidences)
    return np.array([counts[incidence] for incidence in incidences], np.float64)


def _largest(whole: Plan, units: Sequence[Unit], error: Floats) -> list[float]:
    """The largest error in each experiment."""
    by_name = dict(zip((unit.name for unit in units), error.tolist(), strict=True))
    return [max(by_name[unit.name] for unit in group) for group in whole.units]


def _merged_bytes(whole: Plan, units: Sequence[Unit], sizes: Floats, merged: tuple[float, float]) -> int:
    """Bytes of all merged measurements: specimens are added up, incidences are not."""
    by_name = dict(zip((unit.name for unit in units), sizes.tolist(), strict=True))
    fixed, share = merged
    groups = zip(whole.campaign.experiments, whole.units, strict=True)
    return int(sum(fixed + share * sum(by_name[u.name] for u in group) / e.realisations for e, group in groups))


def _memory() -> int | None:
    """Most memory that this process has had, bytes; None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


# --- Which units, and what lies between them -------------------------------------------------------------------------

_NO_MATTER = {"seed", "realisations", "title", "models"} | {
    f"goniometer.{name}" for name in ("paths", "replicates", "target_error", "theta_i", "phi_i")
}
"""What changes neither the time of a path nor its scatter, or is taken into account by itself."""


class _Places:
    """Where units lie in the space of what is swept and of the angle of incidence, each from 0 to 1."""

    def __init__(self, campaign: Campaign) -> None:
        self._experiments = campaign.experiments
        points = Campaign.of(campaign.experiments).parameters
        keys = [key for key in points[0] if key not in _NO_MATTER]
        columns = [column for key in keys for column in _columns([point[key] for point in points])]
        self._swept = np.array(columns, np.float64).reshape(len(columns), len(points)).T

    def of(self, units: Sequence[Unit]) -> Floats:
        """The places of units, (unit, axis)."""
        swept = self._swept[[unit.experiment for unit in units]]
        return np.column_stack([swept, _scaled(np.array([self._theta(unit) for unit in units]))])

    def _theta(self, unit: Unit) -> float:
        """Degrees."""
        return self._experiments[unit.experiment].goniometer.incidences()[unit.incidence].theta


def _columns(values: list[Any]) -> list[Floats]:
    """A swept parameter's axis; one for each of its values if they are no numbers, so that all are equally far."""
    if all(type(value) in (int, float) for value in values):
        numbers = np.array(values, np.float64)
        return [_scaled(np.log(numbers) if numbers.min() > 0 else numbers)]
    names = [json.dumps(value) for value in values]
    return [np.array([name == other for name in names]) / math.sqrt(2) for other in dict.fromkeys(names)]


def _scaled(values: Floats) -> Floats:
    scaled: Floats = (values - values.min()) / (np.ptp(values) or 1.0)
    return scaled


def _spread(places: Floats, count: int) -> list[int]:
    """Up to `count` places, each as far as can be from those before: extremes first, then what lies between."""
    centre = np.linalg.norm(places - places.mean(axis=0), axis=1)
    chosen = [int(centre.argmax())]
    distance = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < count and distance.max() > 0:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return chosen


class _Between:
    """The pilots' numbers for all units: along one axis straight lines from pilot to pilot, in several likewise."""

    def __init__(self, at: Floats, chosen: Sequence[int], pilots: Sequence[Sample]) -> None:
        """`at` is where the units lie, (unit, axis); those `chosen` are the pilots'."""
        self.pilots = pilots
        self._at, self._chosen = at, list(chosen)

    def __call__(self, quantity: str) -> Floats:
        """A quantity of `Sample` for every unit; all but sizes are interpolated by their logarithms."""
        values = np.array([getattr(sample, quantity) for sample in self.pilots], np.float64)
        if quantity in ("size", "growth"):
            return self._interpolated(values)
        found: Floats = np.exp(self._interpolated(np.log(np.maximum(values, 1e-15))))
        return found

    def _interpolated(self, values: Floats) -> Floats:
        from scipy.interpolate import RBFInterpolator

        if np.ptp(values) == 0:
            return np.full(len(self._at), values[0])
        found: Floats = RBFInterpolator(self._at[self._chosen], values, kernel="linear", degree=0)(self._at)
        return np.clip(found, values.min(), values.max())


# --- The pilot -------------------------------------------------------------------------------------------------------


class _Trial:
    """Measures units of a campaign, each with few paths, in a folder of its own."""

    def __init__(self, campaign: Campaign, folder: Path, threads: int, paths: int | None) -> None:
        self._experiments, self._folder, self._threads, self._paths = campaign.experiments, folder, threads, paths
        self._store = CampaignStore(folder)
        self._store.units.mkdir(parents=True)
        self._stop = threading.Event()
        self.start = 0.0
        """Seconds that a process takes before it is at its best."""

    def run(self, units: Sequence[Unit], workers: int, progress: Steps) -> list[Sample]:
        """What units take, as many at a time as there are workers."""
        progress(0, len(units))
        self.start = sum(self._warm(unit) for unit in self._one_of_each_kind(units))
        samples, end = list[Sample](), time.monotonic() + PILOT_SECONDS

        def sample(place: int) -> Sample | None:
            return self._sample(units[place]) if place < 2 or time.monotonic() < end else None

        with ThreadPoolExecutor(workers) as pool:
            try:
                for done, found in enumerate(pool.map(sample, range(len(units))), 1):
                    samples += [found] if found else []
                    progress(done, len(units))
            except BaseException:
                self._stop.set()
                pool.shutdown(cancel_futures=True)
                raise
        return samples

    def merged(self, samples: Sequence[Sample]) -> tuple[float, float]:
        """Bytes of a merged measurement without light, and those for every byte of its units."""
        fixed, share = [], []
        for sample in samples:
            experiment = self._experiments[sample.unit.experiment]
            if isinstance(experiment.goniometer.detector, Klems):  # one of its patches tells little of all of them
                continue
            each = sample.paths // experiment.goniometer.replicates
            small, large = (self._merged(sample.unit, paths) for paths in (1, each))
            fixed.append(small[0])
            share.append((large[0] - small[0]) / (large[1] - small[1]) if large[1] > small[1] else 1.0)
        return (float(np.mean(fixed)), float(np.mean(share))) if fixed else (0.0, 1.0)

    def _merged(self, unit: Unit, each: int) -> tuple[int, int]:
        """Sizes of the merged measurement and of its one unit, of a pilot that was measured."""
        experiment = self._small(unit, each)
        self._store.create(Plan.of(Campaign.of([experiment])).manifest())
        (file,) = merge(self._folder).files
        return file.stat().st_size, self._file(unit, experiment).stat().st_size

    def _one_of_each_kind(self, units: Sequence[Unit]) -> list[Unit]:
        kinds: dict[tuple[type, type], Unit] = {}
        for unit in units:
            experiment = self._experiments[unit.experiment]
            kinds.setdefault((type(experiment.surface), type(experiment.material)), unit)
        return list(kinds.values())

    def _warm(self, unit: Unit) -> float:
        """Seconds that a unit takes if it is the first of its kind, beyond those of the next one."""
        first, next_ = (self._measure(UnitRunner(self._store, self._threads), unit, 1) for _ in range(2))
        return max(0.0, first - next_)

    def _sample(self, unit: Unit) -> Sample:
        """Measure a unit, with more and more paths until it can be timed; the last two times tell what paths cost."""
        goniometer = self._experiments[unit.experiment].goniometer
        asked = math.ceil(goniometer.paths / goniometer.replicates)
        runner = UnitRunner(self._store, self._threads)
        first = self._measure(runner, unit, 1)
        least = self._measure(runner, unit, 1)
        runs = [(1, least), (1, least)]
        while runs[-1][0] < asked and runs[-1][1] - least < TRACING_SECONDS and not (self._paths and len(runs) > 2):
            wanted = self._paths / goniometer.replicates if self._paths else max(SMALLEST, runs[-1][0] * GROWTH)
            each = min(asked, math.ceil(wanted))
            runs.append((each, self._measure(runner, unit, each)))
        return self._told(unit, max(first - least, 0.0), *runs[-2:])

    def _told(self, unit: Unit, build: float, less: tuple[int, float], more: tuple[int, float]) -> Sample:
        """What two runs tell, each with its paths in a replicate and its seconds."""
        sizes = [self._file(unit, self._small(unit, each)).stat().st_size for each, _ in (less, more)]
        experiment = self._small(unit, more[0])
        _, arrays = self._store.read(self._file(unit, experiment).stem)
        tally = unpacked(experiment.goniometer, arrays)
        paths = tally.paths * tally.replicates
        per_path = growth = 0.0
        if more[0] > less[0]:
            per_path = max(more[1] - less[1], 0.0) / (paths * (1 - less[0] / more[0]))
            growth = max(sizes[1] - sizes[0], 0) / math.log(more[0] / less[0])
        bins, albedo = (error * math.sqrt(paths) for error in (median_error(tally), _albedo_error(tally)))
        return Sample(
            unit,
            paths,
            build,
            max(more[1] - per_path * paths, 0.0),
            per_path,
            sizes[1] - growth * math.log(paths),
            growth,
            bins,
            albedo,
        )

    def _measure(self, runner: UnitRunner, unit: Unit, each: int) -> float:
        """Seconds that a unit took with so many paths a replicate."""
        experiment = self._small(unit, each)
        started = time.monotonic()
        try:
            runner.measure(self._alone(unit, experiment), experiment, self._go_on)
        except InputError as error:
            raise InputError(f"experiment {unit.experiment + 1}: {error}") from None
        return time.monotonic() - started

    def _small(self, unit: Unit, each: int) -> Experiment:
        """The experiment of one unit, with so many paths a replicate; Klems's patches cannot be told apart."""
        experiment = self._experiments[unit.experiment]
        goniometer = replace(experiment.goniometer, paths=each * experiment.goniometer.replicates, target_error=None)
        if not isinstance(goniometer.detector, Klems):
            at = goniometer.incidences()[unit.incidence]
            goniometer = replace(goniometer, theta_i=(at.theta,), phi_i=(at.phi,))
        return replace(experiment, realisations=1, goniometer=goniometer)

    def _alone(self, unit: Unit, experiment: Experiment) -> Unit:
        """The unit of its small experiment that stands for one of the campaign."""
        patch = unit.incidence if isinstance(experiment.goniometer.detector, Klems) else 0
        return next(other for other in units_of(0, experiment) if other.incidence == patch)

    def _file(self, unit: Unit, experiment: Experiment) -> Path:
        return self._store.units / f"{self._alone(unit, experiment).name}.npz"

    def _go_on(self, paths: int, total: int, rays: int) -> None:
        if self._stop.is_set():
            raise RuntimeError("the pilot was stopped")


def _albedo_error(tally: Tally) -> float:
    """Relative error of one unit's albedo, at the worst wavelength."""
    scatter = tally.squares.squared_deviations(tally.total, tally.replicates).floats()[0, -1]
    return float((np.sqrt(scatter / (tally.replicates - 1)) / np.maximum(tally.total[0, -1], 1)).max())
