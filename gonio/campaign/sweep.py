"""What a campaign asks for: a base experiment and a sweep of its parameters in a TOML file, or many experiments."""

from __future__ import annotations

import copy
import itertools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import TypeAdapter, ValidationError

from gonio.experiment import Experiment
from gonio.toml_files import InputError, override_value, read_toml, resolve_paths
from microsurfaces.recipe import as_toml, did_you_mean, parameters, sentences

MAX_EXPERIMENTS = 100_000
"""A sweep with more is taken for a mistake."""

MOST_SENTENCES = 20
"""Further mistakes of one campaign are only counted."""

_RANGES = ({"start", "stop", "step"}, {"from", "to", "count"}, {"from", "to", "count", "scale"})
_SPANS = ({"from", "to"}, {"from", "to", "scale"})
_NEEDS = "a campaign needs an [experiment] or a base file, and a [sweep]"

Point = dict[str, Any]
"""Values of the swept parameters by dotted key."""


@dataclass(frozen=True)
class Campaign:
    """Experiments that are run together, and what tells them apart."""

    title: str
    """One line for people."""
    experiments: tuple[Experiment, ...]
    """In the order of the sweep, the first key varying slowest."""
    parameters: tuple[Point, ...]
    """Of every experiment the values of the swept parameters, by dotted key such as surface.alpha."""

    @classmethod
    def read(cls, path: str | Path, overrides: Iterable[str] = ()) -> Self:
        """The campaign of a TOML file, with `overrides` such as "goniometer.paths=1000" put in its base experiment.

        Files that it names are looked for beside it. Raises `InputError` with one sentence for each mistake.
        """
        path = Path(path)
        table = read_toml(path, _NEEDS)
        base, mistakes = _base(table, path), []
        mistakes += [sentence for override in overrides for sentence in override_value(base, override)]
        points = _Sweep(mistakes).points(table.get("sweep", {}), "sweep", "")
        if mistakes:
            raise _too_many(mistakes)
        folder = path.absolute().parent
        experiments = _experiments([_with(base, point, folder) for point in points])
        return cls(str(table.get("title", "")), experiments, tuple(points))

    @classmethod
    def of(cls, experiments: Sequence[Experiment], title: str = "") -> Self:
        """The campaign of a list of experiments; its parameters are the values in which they differ."""
        if not experiments:
            raise InputError("experiments = []: a campaign needs one or more.")
        flat = [_flat(experiment.to_dict()) for experiment in experiments]
        keys = dict.fromkeys(key for table in flat for key in table if key not in ("title", "models"))
        swept = [key for key in keys if any(table.get(key) != flat[0].get(key) for table in flat)]
        return cls(title, tuple(experiments), tuple({key: table.get(key) for key in swept} for table in flat))


def _base(table: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """The tables of the experiment that is varied, paths absolute."""
    if "surface" in table:
        raise InputError(f'{path} is an experiment: gonio run {path}, or name it in a campaign as base = "{path.name}"')
    known = ("title", "base", "experiment", "sweep")
    mistakes = [f"{key}: a campaign has no such key{did_you_mean(key, known)}." for key in table if key not in known]
    if ("base" in table) == ("experiment" in table):
        mistakes.append(f'{path}: give a table [experiment] or a file, base = "gold.toml", one of them.')
    if not isinstance(table.get("experiment", {}), dict):
        mistakes.append(f"experiment = {as_toml(table['experiment'])}: must be a table [experiment].")
    if not isinstance(table.get("base", ""), str):
        mistakes.append(f"base = {as_toml(table['base'])}: must be the name of an experiment's TOML file.")
    if mistakes:
        raise InputError(*mistakes)
    if "experiment" in table:
        base, folder = dict(table["experiment"]), path
    else:
        folder = path.parent / table["base"]
        base = read_toml(folder, "an experiment needs at least the tables [surface] and [material]")
    resolve_paths(base, folder.absolute().parent)
    return base


def _experiments(tables: Sequence[Mapping[str, Any]]) -> tuple[Experiment, ...]:
    """All experiments, or all that is wrong with them, each mistake once."""
    adapter, experiments, mistakes = TypeAdapter(Experiment), [], list[str]()
    for table in tables:
        try:
            experiments.append(adapter.validate_json(json.dumps(table, default=str)))
        except ValidationError as error:
            mistakes += sentences(error, Experiment)
    if mistakes:
        raise _too_many(mistakes)
    return tuple(experiments)


def _too_many(mistakes: Iterable[str]) -> InputError:
    """An error that tells every mistake once, and of very many how many there are."""
    told = list(dict.fromkeys(mistakes))
    more = [f"... and {len(told) - MOST_SENTENCES} more mistakes."] if len(told) > MOST_SENTENCES else []
    return InputError(*told[:MOST_SENTENCES], *more)


def _with(base: Mapping[str, Any], point: Point, folder: Path) -> dict[str, Any]:
    """The tables of `base` with the values of a point put in."""
    table: dict[str, Any] = copy.deepcopy(dict(base))
    for key, value in point.items():
        *parents, name = key.split(".")
        inner = table
        for parent in parents:
            inner = inner.setdefault(parent, {})
            if not isinstance(inner, dict):
                raise InputError(f"sweep.{key}: {parent} is a value of the experiment, not a table.")
        inner[name] = copy.deepcopy(value)
    resolve_paths(table, folder)
    return table


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values by dotted key."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat


# --- The sweep -------------------------------------------------------------------------------------------------------


@dataclass
class _Sweep:
    """Turns the table [sweep] into points; what is wrong is added to `mistakes`."""

    mistakes: list[str]

    def points(self, table: Any, place: str, prefix: str) -> list[Point]:
        """The points of a group of axes: crossed, zipped or drawn at random, as the group says."""
        if not isinstance(table, dict):
            return self._wrong(f"{place} = {as_toml(table)}: must be a table with a list or range for each key.")
        axes = {key: value for key, value in table.items() if key not in ("zip", "random")}
        draws = self._draws(table, place)
        if draws is None and table.get("zip") not in (None, True, False):
            return self._wrong(f"{place}.zip = {as_toml(table['zip'])}: must be true or false.")
        columns = list(self._columns(axes, place, prefix, draws))
        keys = [key for column in columns for key in (column[0] if column else ())]
        for key in dict.fromkeys(key for key in keys if keys.count(key) > 1):
            self._wrong(f"{place}: {key} is swept twice.")
        if table.get("zip") or draws:
            return self._zipped(columns, place)
        if (count := math.prod(map(len, columns))) > MAX_EXPERIMENTS:
            return self._wrong(f"{place}: {count} experiments are more than {MAX_EXPERIMENTS}: sweep fewer values.")
        return [_joined(parts) for parts in itertools.product(*columns)]

    def _columns(
        self, axes: Mapping[str, Any], place: str, prefix: str, draws: tuple[int, int] | None
    ) -> Iterable[list[Point]]:
        """The points along every axis and of every inner group."""
        for name, value in axes.items():
            key, where = f"{prefix}{name}", f"{place}.{name}"
            if isinstance(value, dict) and ("zip" in value or "random" in value):
                # A group may be called as it likes; one that is called surface holds keys of the surface.
                inner = f"{key}." if prefix or name in parameters(Experiment) else ""
                yield self.points(value, where, inner)
            elif isinstance(value, dict) and not set(value) & {"start", "stop", "step", "from", "to", "count"}:
                yield from self._columns(value, where, f"{key}.", draws)
            elif draws:
                yield [{key: drawn} for drawn in self._drawn(value, where, key, *draws)]
            else:
                yield [{key: listed} for listed in self._listed(value, where)]

    def _zipped(self, columns: Sequence[list[Point]], place: str) -> list[Point]:
        """Points whose parameters step together."""
        lengths = {next(iter(column[0])): len(column) for column in columns if column}
        if len(set(lengths.values())) > 1:
            told = ", ".join(f"{key} has {length}" for key, length in lengths.items())
            return self._wrong(f"{place}: lists that are zipped must be equally long, but {told}.")
        return [_joined(parts) for parts in zip(*columns, strict=False)]

    def _draws(self, table: Mapping[str, Any], place: str) -> tuple[int, int] | None:
        """(count, seed) of a random design."""
        if "random" not in table:
            return None
        design = table["random"]
        good = isinstance(design, dict) and set(design) == {"count", "seed"}
        good = good and all(type(number) is int and number >= 0 for number in design.values())
        if not good or not 1 <= design["count"] <= MAX_EXPERIMENTS or table.get("zip"):
            self._wrong(
                f"{place}.random = {as_toml(design)}: must be a table such as {{count = 50, seed = 1}}, without zip."
            )
            return 1, 0
        return design["count"], design["seed"]

    def _listed(self, spec: Any, place: str) -> list[Any]:
        """The values of a list or a range."""
        if isinstance(spec, list) and spec:
            return spec
        if not isinstance(spec, dict) or set(spec) not in _RANGES or not _numbers(spec):
            return self._wrong(
                f"{place} = {_shown(spec)}: must be a list of values, {{start, stop, step}} or {{from, to, count}}."
            )
        if "step" in spec:
            return self._stepped(spec, place)
        if type(spec["count"]) is not int or not 1 <= spec["count"] <= MAX_EXPERIMENTS:
            return self._wrong(f"{place}.count = {as_toml(spec['count'])}: must be a whole number, 1 or more.")
        return [self._between(spec, place, t) for t in np.linspace(0.0, 1.0, spec["count"])]

    def _stepped(self, spec: Mapping[str, Any], place: str) -> list[Any]:
        """start, start + step ... up to and with stop; decimal, so that 0.1 + 2 * 0.1 is 0.3."""
        start, stop, step = (Decimal(repr(spec[name])) for name in ("start", "stop", "step"))
        if step == 0 or (stop - start) / step < 0:
            return self._wrong(f"{place}.step = {as_toml(spec['step'])}: does not lead from start to stop.")
        count = int((stop - start) / step) + 1
        if count > MAX_EXPERIMENTS:
            return self._wrong(f"{place}.step = {as_toml(spec['step'])}: {count} values are too many.")
        whole = all(type(number) is int for number in spec.values())
        return [(int if whole else float)(start + k * step) for k in range(count)]

    def _drawn(self, spec: Any, place: str, key: str, count: int, seed: int) -> list[Any]:
        """`count` random values, the same first ones for a larger count and whatever else is drawn."""
        random = np.random.default_rng(np.random.SeedSequence((seed, *key.encode())))
        shares = random.random(count)
        if isinstance(spec, dict) and set(spec) in _SPANS and _numbers(spec):
            return [self._between(spec, place, t) for t in shares]
        if isinstance(spec, dict) and set(spec) not in _RANGES:
            return self._wrong(f"{place} = {_shown(spec)}: must be a list of values to choose from, or {{from, to}}.")
        values = self._listed(spec, place)
        return [values[int(t * len(values))] for t in shares] if values else []

    def _between(self, spec: Mapping[str, Any], place: str, t: float) -> Any:
        """The value at share `t` of a span; whole between whole numbers, if that is what it is to be."""
        first, last, scale = spec["from"], spec["to"], spec.get("scale", "linear")
        if scale not in ("linear", "log") or (scale == "log" and not (first > 0 and last > 0)):
            if not self.mistakes or not self.mistakes[-1].startswith(f"{place}.scale"):
                self._wrong(f'{place}.scale = {as_toml(scale)}: must be "linear", or "log" between positive numbers.')
            return first
        whole = type(first) is int and type(last) is int
        if whole and "count" not in spec and scale == "linear":
            return min(first + int(t * (last - first + 1)), last)
        value = first * (last / first) ** t if scale == "log" else first + t * (last - first)
        # Readable numbers, which stand in names and tables as they are.
        value = float(last) if t == 1 else float(f"{value:.7g}")
        return int(value) if whole and value.is_integer() else value

    def _wrong(self, sentence: str) -> list[Any]:
        self.mistakes.append(sentence)
        return []


def _joined(points: Iterable[Point]) -> Point:
    return {key: value for point in points for key, value in point.items()}


def _numbers(spec: Mapping[str, Any]) -> bool:
    """Whether a range is made of finite numbers."""
    return all(type(value) in (int, float) and np.isfinite(value) for name, value in spec.items() if name != "scale")


def _shown(spec: Any) -> str:
    """A value or a small table as it stands in TOML."""
    if not isinstance(spec, dict):
        return as_toml(spec)
    return f"{{{', '.join(f'{key} = {as_toml(value)}' for key, value in spec.items())}}}"
