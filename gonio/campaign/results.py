"""Puts finished units together: a measurement for every experiment, the same bytes as `Experiment.run` would give."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from gonio.campaign.store import CampaignStore, DamagedError, keys_of, measurement_file, write_durably
from gonio.campaign.units import joined
from gonio.experiment import Experiment
from gonio.measurement import Measurement
from gonio.netcdf import save
from gonio.noise import Noises, noises

Steps = Callable[[int, int], None]
"""What a long task calls now and then, with the steps done and those in all."""


@dataclass
class Merged:
    """What `merge` did."""

    files: list[Path] = field(default_factory=list)
    """The measurements that are complete."""
    incomplete: int = 0
    """Experiments that lack units."""
    damaged: list[str] = field(default_factory=list)
    """A sentence for every damaged unit, which has been set aside: run the campaign again."""
    noises: dict[int, Noises] = field(default_factory=dict)
    """How uncertain each experiment of several realisations is, and why; by number, from 0."""
    processors: set[str] = field(default_factory=set)
    """Instruction sets that the units were computed with: the same bits are promised on the same one only."""


def merge(folder: str | Path, progress: Steps | None = None) -> Merged:
    """Write DIR/measurements/NUMBER-HASH.nc for every experiment whose units are all there, and index.csv.

    Raises `InputError` where there is no campaign, OSError where nothing can be written.
    """
    store, result, names = CampaignStore(Path(folder)), Merged(), list[str]()
    entries, finished = store.manifest()["experiments"], store.finished()
    store.measurements.mkdir(exist_ok=True)
    for number, entry in enumerate(entries):
        measurement = _measurement(store, entry, result) if finished.issuperset(entry["units"]) else None
        if measurement is None:
            result.incomplete += 1
            names.append("")
        else:
            path = store.measurements / measurement_file(entries, number)
            result.files.append(save(measurement, path))
            names.append(path.name)
            if entry["experiment"]["realisations"] > 1:
                result.noises[number] = noises(measurement)
        if progress:
            progress(number + 1, len(entries))
    index = index_of([entry["parameters"] for entry in entries], {"file": names})
    write_durably(store.measurements / "index.csv", index.encode())
    return result


def _measurement(store: CampaignStore, entry: Mapping[str, Any], result: Merged) -> Measurement | None:
    """The measurement of one experiment; None if a unit is damaged."""
    experiment = TypeAdapter(Experiment).validate_json(json.dumps(entry["experiment"]))
    units = iter(entry["units"])
    each = len(entry["units"]) // experiment.realisations
    merged: Measurement | None = None
    processors, sound = set[str](), True
    for _ in range(experiment.realisations):
        parts = []
        for unit in (next(units) for _ in range(each)):
            try:
                parts.append(store.read(unit))
            except DamagedError as error:
                sound = False
                result.damaged.append(store.set_aside(unit, error))
        if sound:
            processors |= {note["attributes"].pop("instruction_set") for note, _ in parts}
            part = joined(experiment, parts)
            merged = part if merged is None else merged.merge(part)
    if merged is None or not sound:
        return None
    result.processors |= processors
    described = experiment.described(merged, interrupted=False)
    # Of the machines that measured, not of this one.
    return replace(described, attributes=described.attributes | {"instruction_set": ", ".join(sorted(processors))})


def index_of(points: Sequence[Mapping[str, Any]], files: Mapping[str, Sequence[str]]) -> str:
    """The table of all experiments as CSV: number, their files by what they are, and the swept parameters."""
    keys = keys_of(points)
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["experiment", *files, *keys])
    for number, (point, *names) in enumerate(zip(points, *files.values(), strict=True), 1):
        table.writerow([number, *names, *(cell(point.get(key)) for key in keys)])
    return text.getvalue()


def cell(value: Any) -> str:
    """A parameter's value as it stands in a table; tables and lists as JSON."""
    return json.dumps(value) if isinstance(value, dict | list) else "" if value is None else str(value)
