"""Units of work: one incidence of one specimen, or a part of its replicates, named by all that decides its numbers."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from gonio.campaign.store import FORMAT_VERSION, CampaignStore, DamagedError, name_of
from gonio.campaign.sweep import Campaign
from gonio.experiment import Experiment, instruction_set
from gonio.goniometer import Goniometer, Incidence, Progress, empty_sums, enter
from gonio.measurement import Measurement
from gonio.tally import Tally, UInt128
from gonio.toml_files import InputError
from gonio.transport.scene import Geometry, Scene

BLOCK_PATHS = 1 << 24
"""An incidence with more paths is cut into blocks of replicates, so that several workers can share it."""

BLOCK_REPLICATES = 4
"""A block has so many at least, which the threads of a worker share."""


@dataclass(frozen=True)
class Unit:
    """One incidence of one specimen, or a block of its replicates."""

    experiment: int
    """Its place in the campaign."""
    realisation: int
    incidence: int
    """Its place among those of the goniometer."""
    replicates: tuple[int, int] | None
    """The first of its replicates and the one after the last; None if a target decides how many there are."""
    name: str
    relief: str
    """The same for units that need the same relief."""
    paths: int
    """Its share of the work."""
    pilot: str | None
    """The unit whose number of replicates it takes over, if any."""


def units_of(number: int, experiment: Experiment) -> list[Unit]:
    """The units of the campaign's experiment `number`: realisations, in each the incidences, in each the blocks."""
    goniometer, units = experiment.goniometer, list[Unit]()
    each = math.ceil(goniometer.paths / goniometer.replicates)
    for realisation in range(experiment.realisations):
        relief = name_of(_relief(experiment, realisation))
        for place, incidence in enumerate(goniometer.incidences()):
            for block in _blocks(goniometer):
                key = key_of(experiment, realisation, incidence, block)
                pilot = None
                if block is None and realisation > 0:
                    pilot = name_of(key_of(experiment, 0, incidence, None))
                first, end = block or (0, goniometer.replicates)
                units.append(Unit(number, realisation, place, block, name_of(key), relief, each * (end - first), pilot))
    return units


def _blocks(goniometer: Goniometer) -> list[tuple[int, int] | None]:
    """The replicates of an incidence, cut into nearly equal parts."""
    if goniometer.target_error is not None:
        return [None]
    replicates = goniometer.replicates
    parts = max(1, min(replicates // BLOCK_REPLICATES, math.ceil(goniometer.paths / BLOCK_PATHS)))
    edges = [replicates * part // parts for part in range(parts + 1)]
    return list(itertools.pairwise(edges))


def key_of(
    experiment: Experiment, realisation: int, incidence: Incidence, replicates: tuple[int, int] | None
) -> dict[str, Any]:
    """All that decides the numbers of a unit; files stand for their content, wherever they are."""
    tables = _tables(experiment)
    goniometer = {name: value for name, value in tables["goniometer"].items() if name not in ("theta_i", "phi_i")}
    return {
        "format_version": FORMAT_VERSION,
        "material": _by_content(tables["material"]),
        "goniometer": goniometer | {"incidence": [incidence.theta, incidence.phi], "block": replicates},
        "versions": versions(),
        **_relief(experiment, realisation),
    }


def _relief(experiment: Experiment, realisation: int) -> dict[str, Any]:
    """All that decides a specimen's relief, and its seeds."""
    return {
        "surface": _by_content(_tables(experiment)["surface"]),
        "seed": experiment.seed,
        "realisation": realisation,
        # Some surfaces are stratified over all their realisations.
        "realisations": experiment.realisations if getattr(experiment.surface, "stratified", False) else None,
    }


@functools.lru_cache(maxsize=16)
def _tables(experiment: Experiment) -> dict[str, Any]:
    return experiment.to_dict()


@functools.cache
def versions() -> dict[str, str]:
    """Versions of the packages that decide the numbers."""
    return {name: importlib.metadata.version(name) for name in ("gonio", "numpy", "scipy", "numba", "embreex")}


def _by_content(table: Mapping[str, Any]) -> dict[str, Any]:
    """The table with a hash of its content in place of every file's path."""
    result: dict[str, Any] = {
        key: _by_content(value) if isinstance(value, dict) else value for key, value in table.items()
    }
    if isinstance(result.get("path"), str):
        result["path"] = _content(Path(result["path"]))
    return result


def _content(path: Path) -> str:
    try:
        stat = path.stat()
        return _digest(path, stat.st_mtime_ns, stat.st_size)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}.") from None


@functools.lru_cache(maxsize=1024)
def _digest(path: Path, modified: int, size: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# --- The plan of a campaign ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plan:
    """A campaign cut into units."""

    campaign: Campaign
    units: tuple[tuple[Unit, ...], ...]
    """Those of every experiment. Experiments that have a unit in common share its file."""

    @classmethod
    def of(cls, campaign: Campaign) -> Plan:
        """Cut a campaign into units. Raises `InputError` for a file that cannot be read."""
        return cls(campaign, tuple(tuple(units_of(*pair)) for pair in enumerate(campaign.experiments)))

    def manifest(self) -> dict[str, Any]:
        """What was asked, by which version, with which seeds: all that is needed to put the results together."""
        return {
            "format_version": FORMAT_VERSION,
            "title": self.campaign.title,
            "versions": versions(),
            "experiments": [
                {
                    "parameters": point,
                    "experiment": experiment.to_dict(),
                    "paths": [unit.paths for unit in units],
                    "units": [unit.name for unit in units],
                }
                for experiment, point, units in zip(
                    self.campaign.experiments, self.campaign.parameters, self.units, strict=True
                )
            ],
        }

    def shard(self, number: int, shards: int) -> list[Unit]:
        """The units of one of `shards` parts with nearly the same number of paths; `number` counts from 1.

        Units of one relief are neighbours, so most reliefs are built in one part only; and a unit is in the same part
        as the one whose number of replicates it takes over.
        """
        reliefs: dict[str, dict[str, Unit]] = {}
        for unit in (unit for units in self.units for unit in units):
            reliefs.setdefault(unit.relief, {}).setdefault(unit.name, unit)
        units = [unit for group in reliefs.values() for unit in group.values()]
        total, before, part = sum(unit.paths for unit in units), 0, dict[str, int]()
        for unit in units:
            part[unit.name] = before * shards // total + 1
            before += unit.paths
        return [unit for unit in units if part[unit.pilot or unit.name] == number]


# --- Measuring one unit ----------------------------------------------------------------------------------------------


@dataclass
class UnitRunner:
    """Measures units with a number of threads, and keeps the relief that was built last."""

    store: CampaignStore
    threads: int
    _built: tuple[str, Geometry] | None = None

    def measure(self, unit: Unit, experiment: Experiment, progress: Progress | None = None) -> None:
        """Measure a unit and keep its sums in the store.

        Raises `InputError` for a surface that cannot be built, OSError where nothing can be written, MemoryError, and
        KeyboardInterrupt for Ctrl-C, which keeps nothing of this unit.
        """
        goniometer = experiment.goniometer
        incidence = goniometer.incidences()[unit.incidence]
        key = key_of(experiment, unit.realisation, incidence, unit.replicates)
        if name_of(key) != unit.name:
            raise InputError("surface: its file has changed since the campaign was started; start it again.")
        replicates = None if unit.replicates is None else range(*unit.replicates)
        if unit.pilot is not None:
            replicates = range(self._replicates(unit, experiment))
        scene, seed = self._scene(unit, experiment), experiment.light_seed(unit.realisation)
        try:
            tally = goniometer.tally(scene, seed, incidence, self.threads, progress, replicates)
        except ValueError as error:
            raise InputError(f"goniometer.{error}") from None
        about = goniometer.provenance(scene, seed) | {"instruction_set": instruction_set()}
        self.store.write(unit.name, {"unit": key, "attributes": about}, _packed(tally))

    def attempt(self, unit: Unit, experiment: Experiment, progress: Progress | None = None) -> str | None:
        """Measure a unit and keep it; the sentence of what is wrong with this unit alone, if anything.

        Raises what `measure` does for faults that are not the unit's.
        """
        try:
            self.measure(unit, experiment, progress)
        except InputError as error:
            return str(error)
        except MemoryError as error:
            return f"not enough memory: {error or 'make the surface, the detector or the number of workers smaller'}."
        return None

    def _scene(self, unit: Unit, experiment: Experiment) -> Scene:
        """The specimen; the relief built last is used again, of another material, too."""
        if self._built is None or self._built[0] != unit.relief:
            self._built = None  # never two at a time
            self._built = unit.relief, experiment.scene(unit.realisation).geometry
        return Scene(self._built[1], experiment.material)

    def _replicates(self, unit: Unit, experiment: Experiment) -> int:
        """How many replicates the first realisation took; it is measured now if it was not, or is damaged."""
        assert unit.pilot is not None
        if self.store.has(unit.pilot):
            try:
                return int(self.store.read(unit.pilot)[1]["replicates"])
            except DamagedError as error:
                self.store.set_aside(unit.pilot, error)
        pilot = next(other for other in units_of(unit.experiment, experiment) if other.name == unit.pilot)
        self.measure(pilot, experiment)
        return int(self.store.read(unit.pilot)[1]["replicates"])


# --- Units back into a measurement -----------------------------------------------------------------------------------


def _packed(tally: Tally) -> dict[str, NDArray[Any]]:
    """The arrays of a unit's file, named as those of a measurement's `sums`.

    `weight` (order, bin, W) and `count` (order, bin) are of all replicates, `pilot_weight` and `pilot_squares` (the sum
    of their squares, 128 bits wide) of the pilot's, all in units of 2⁻³² path; `energy_budget` (3, W) is what was
    absorbed, truncated and lost.
    """
    # Without a target all replicates are the pilot's.
    pilot = {} if tally.replicates <= tally.pilot else {"pilot_weight": tally.piloted}
    return {
        "weight": tally.total,
        **pilot,
        "pilot_squares_high": tally.squares.high,
        "pilot_squares_low": tally.squares.low,
        "count": tally.count,
        "energy_budget": tally.energy_budget,
        "replicates": np.array(tally.replicates),
    }


def unpacked(goniometer: Goniometer, arrays: Mapping[str, NDArray[Any]]) -> Tally:
    """The tally in a unit's file."""
    return Tally(
        goniometer.replicates,
        math.ceil(goniometer.paths / goniometer.replicates),
        arrays["weight"],
        arrays.get("pilot_weight", arrays["weight"]).copy(),
        UInt128(arrays["pilot_squares_high"], arrays["pilot_squares_low"]),
        arrays["count"],
        arrays["energy_budget"],
        int(arrays["replicates"]),
    )


def joined(experiment: Experiment, units: Sequence[tuple[dict[str, Any], dict[str, NDArray[Any]]]]) -> Measurement:
    """One realisation from all its units' notes and arrays, in their order: as `Goniometer.measure` gives it."""
    goniometer = experiment.goniometer
    sums, blocks = empty_sums(goniometer), len(_blocks(goniometer))
    for place, incidence in enumerate(goniometer.incidences()):
        tally, *others = (unpacked(goniometer, arrays) for _, arrays in units[place * blocks : (place + 1) * blocks])
        for other in others:
            tally.merge(other)
        enter(tally, sums, (incidence.row, incidence.column))
    # Units are shared by experiments with other incidences: the recipe is this one's.
    recipe = {"goniometer": TypeAdapter(Goniometer).dump_json(goniometer).decode()}
    return Measurement(sums, units[0][0]["attributes"] | recipe)
