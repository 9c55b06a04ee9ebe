"""Units of work: one incidence of one specimen, named by all that decides its numbers, measured and read back."""

from __future__ import annotations

import copy
import functools
import hashlib
import importlib.metadata
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.campaign.folder import DamagedError, Folder, name_of
from gonio.campaign.sweep import Campaign
from gonio.detectors import Klems
from gonio.experiment import Experiment, InputError, instruction_set
from gonio.goniometer import Goniometer, Progress
from gonio.measurement import Measurement
from gonio.scene import Scene
from microsurfaces import VGrooves

FORMAT = 1
"""Of a unit's file and of the manifest."""


@dataclass(frozen=True)
class Unit:
    """One incidence of one specimen (with Klems's patches all of them, which are measured together)."""

    experiment: int
    """Its place in the campaign."""
    realisation: int
    incidence: int | None
    """Its place among those of the goniometer; None for all."""
    name: str
    relief: str
    """The same for units that need the same relief."""
    paths: int
    """Its share of the work."""
    pilot: str | None
    """The unit whose number of replicates it takes over, if any."""


def units_of(number: int, experiment: Experiment) -> list[Unit]:
    """The units of the campaign's experiment `number`, one realisation after another."""
    goniometer, units = experiment.goniometer, list[Unit]()
    whole = isinstance(goniometer.detector, Klems)
    incidences = [None] if whole else list(range(len(goniometer.incidences())))
    paths = math.ceil(goniometer.paths / goniometer.replicates) * goniometer.replicates
    paths *= len(goniometer.incidences()) if whole else 1
    for realisation in range(experiment.realisations):
        for incidence in incidences:
            key = key_of(experiment, realisation, incidence)
            pilot = None
            if goniometer.target_error is not None and realisation > 0:
                pilot = name_of(key_of(experiment, 0, incidence))
            relief = name_of({name: key[name] for name in ("surface", "seed", "realisation", "strips")})
            units.append(Unit(number, realisation, incidence, name_of(key), relief, paths, pilot))
    return units


def key_of(experiment: Experiment, realisation: int, incidence: int | None) -> dict[str, Any]:
    """All that decides the numbers of a unit; files stand for their content, wherever they are."""
    tables = _tables(experiment)
    goniometer = tables["goniometer"]
    if incidence is not None:
        at = experiment.goniometer.incidences()[incidence]
        goniometer = goniometer | {"theta_i": [at.theta], "phi_i": [at.phi]}
    return {
        "format": FORMAT,
        "surface": _by_content(tables["surface"]),
        "material": _by_content(tables["material"]),
        "goniometer": goniometer,
        "seed": experiment.seed,
        "realisation": realisation,
        # The slopes of V-grooves are stratified over all realisations.
        "strips": experiment.realisations if isinstance(experiment.surface, VGrooves) else None,
        "versions": versions(),
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
            "format": FORMAT,
            "title": self.campaign.title,
            "versions": versions(),
            "experiments": [
                {
                    "parameters": point,
                    "experiment": experiment.to_dict(),
                    "paths": units[0].paths,
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
class Bench:
    """Measures units with a number of threads, and keeps the relief that was built last."""

    folder: Folder
    threads: int
    _built: tuple[str, Scene] | None = None

    def measure(self, unit: Unit, experiment: Experiment, progress: Progress | None = None) -> None:
        """Measure a unit and keep its sums in the folder.

        Raises `InputError` for a surface that cannot be built, OSError where nothing can be written, MemoryError, and
        KeyboardInterrupt for Ctrl-C, which keeps nothing of this unit.
        """
        key = key_of(experiment, unit.realisation, unit.incidence)
        if name_of(key) != unit.name:
            raise InputError("surface: its file has changed since the campaign was started; start it again.")
        replicates = None if unit.pilot is None else self._replicates(unit, experiment)
        goniometer = _narrowed(experiment.goniometer, unit.incidence)
        scene, seed = self._scene(unit, experiment), experiment.seed_of("light", unit.realisation)
        try:
            part = goniometer.measure(scene, seed, self.threads, progress, replicates)
        except ValueError as error:
            raise InputError(f"goniometer.{error}") from None
        if part.interrupted:
            raise KeyboardInterrupt
        sums = part.counted
        note = {
            "unit": key,
            "theta_i": sums["theta_i"].values.tolist(),
            "phi_i": sums["phi_i"].values.tolist(),
            "attributes": part.attributes | {"instruction_set": instruction_set()},
        }
        self.folder.write(unit.name, note, {str(name): sums[name].values for name in sums.data_vars})

    def _scene(self, unit: Unit, experiment: Experiment) -> Scene:
        """The specimen; the relief built last is used again, of another material, too."""
        if self._built is None or self._built[0] != unit.relief:
            self._built = None  # never two at a time
            self._built = unit.relief, experiment.scene(unit.realisation)
        scene = self._built[1]
        if scene.material != experiment.material:
            scene = copy.copy(scene)
            scene.material = experiment.material
        return scene

    def _replicates(self, unit: Unit, experiment: Experiment) -> list[int]:
        """How many replicates the first realisation took; it is measured now if it was not, or is damaged."""
        assert unit.pilot is not None
        if self.folder.has(unit.pilot):
            try:
                return _counts(self.folder.read(unit.pilot)[1])
            except DamagedError:
                self.folder.set_aside(unit.pilot)
        pilot = next(other for other in units_of(unit.experiment, experiment) if other.name == unit.pilot)
        self.measure(pilot, experiment)
        return _counts(self.folder.read(unit.pilot)[1])


def _counts(arrays: Mapping[str, NDArray[Any]]) -> list[int]:
    counts: list[int] = arrays["replicates"].ravel().tolist()
    return counts


def _narrowed(goniometer: Goniometer, incidence: int | None) -> Goniometer:
    """The instrument with one incidence only: random numbers depend on the incidence's values, not on its place."""
    if incidence is None:
        return goniometer
    at = goniometer.incidences()[incidence]
    return replace(goniometer, theta_i=(at.theta,), phi_i=(at.phi,))


# --- Units back into a measurement -----------------------------------------------------------------------------------


def joined(experiment: Experiment, units: Sequence[tuple[dict[str, Any], dict[str, NDArray[Any]]]]) -> Measurement:
    """One realisation from all its units' notes and sums: what `Goniometer.measure` would have returned."""
    from pydantic import TypeAdapter

    from gonio.goniometer import empty_sums

    sums = empty_sums(experiment.goniometer)
    for note, arrays in units:
        rows = np.searchsorted(sums["theta_i"].values, note["theta_i"])
        columns = np.searchsorted(sums["phi_i"].values, note["phi_i"])
        for name, array in arrays.items():
            sums[name].values[np.ix_(rows, columns)] = array
    attributes = dict(units[0][0]["attributes"])
    attributes["goniometer"] = TypeAdapter(Goniometer).dump_json(experiment.goniometer).decode()
    return Measurement(sums, attributes)
