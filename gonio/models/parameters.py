"""The parameters of models by dotted name, such as "m" or "distribution.alpha": to set them, and what may be fitted."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from gonio.models import Distribution, Masking, Model
from gonio.optics import Dielectric, Material
from microsurfaces.recipe import members, parameters

BOUNDS: dict[str, tuple[float, float]] = {
    "alpha": (0.005, 3.0),
    "alpha_x": (0.005, 3.0),
    "alpha_y": (0.005, 3.0),
    "m": (0.005, 3.0),
    "m_x": (0.005, 3.0),
    "m_y": (0.005, 3.0),
    "n": (1.0, 1e5),
    "n_u": (1.0, 1e5),
    "n_v": (1.0, 1e5),
    "sigma": (0.0, 60.0),
    "eta": (0.05, 10.0),
    "k": (0.0, 20.0),
    "reflectance": (0.0, 1.0),
    "specular": (0.0, 1.0),
    "k_d": (0.0, 1.0),
    "k_s": (0.0, 1.0),
    "distance": (0.05, 8.0),
    "floor_height": (0.0, 0.99),
    "protrusion": (0.01, 1.0),
    "rotation": (-180.0, 180.0),
}
"""What can be fitted, by the last part of its dotted name, and between which limits."""

INSTEAD = (
    ("m", "m_x m_y", "scales"),
    ("alpha", "alpha_x alpha_y"),
    ("n", "n_u n_v"),
    ("name", "eta k"),
    ("floor_height", "protrusion"),
)
"""Parameters that stand for one another: to give one group is to take back the others."""

_SHARES = (("k_d", "k_s"), ("specular", "reflectance"))
"""Parameters that must not sum to more than 1."""


def with_values(model: Model, values: Mapping[str, float]) -> Model:
    """`model` with the numbers of these dotted names set; what they stand for is taken back.

    Weights that must not sum to more than 1 give way: one that was not named to one that was, two that were to each
    other.
    """
    adapter: TypeAdapter[Model] = TypeAdapter(Model)
    table = adapter.dump_python(model, mode="json", exclude_none=True)
    for name, value in values.items():
        put(table, name, float(value))
    give_way(table, values)
    return adapter.validate_json(json.dumps(table))


def put(table: dict[str, Any], name: str, value: Any) -> None:
    """Set the parameter of a dotted name in a model's table, in place; what it stands for is taken back.

    A part that becomes another kind keeps the parameters that the new kind knows. Raises KeyError where the name leads
    through something that is no table.
    """
    *parents, last = name.split(".")
    for parent in parents:
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            raise KeyError(parent)
    if last == "kind":
        known = parameters(_kinds().get(value))
        for key in [key for key in table if key not in known]:
            del table[key]
    for groups in ([group.split() for group in row] for row in INSTEAD):
        if any(last in group for group in groups):
            for key in (key for group in groups if last not in group for key in group):
                table.pop(key, None)
    table[last] = value


def whole_name(table: Mapping[str, Any], name: str, value: Any) -> str:
    """The dotted name of what is set in a model's table: `alpha` of its distribution, the kind that `masking` is.

    A name that fits nothing, or several parts, stays as it is.
    """
    own = parameters(_kinds()[table["kind"]])
    first = name.split(".")[0]
    if first in own:
        names_kind = name == first and isinstance(value, str) and value in members(own[first].annotation)
        return f"{name}.kind" if names_kind else name
    owners = [
        part
        for part, field in own.items()
        for kinds in [members(field.annotation)]
        for chosen in [kinds.get(table[part]["kind"]) if isinstance(table.get(part), dict) else None]
        if any(first in parameters(kind) for kind in ([chosen] if chosen else kinds.values()))
    ]
    return f"{owners[0]}.{name}" if len(owners) == 1 else name


def give_way(table: dict[str, Any], named: Mapping[str, Any]) -> None:
    """Make weights that must not exceed 1 together do so, those first that were not named; in place."""
    for pair in _SHARES:
        if not all(isinstance(table.get(key), float) for key in pair) or (total := sum(table[k] for k in pair)) <= 1.0:
            continue
        if all(key in named for key in pair):
            table.update({key: table[key] / total for key in pair})
        elif given := next((key for key in pair if key in named), None):
            table[pair[1 - pair.index(given)]] = 1.0 - table[given]


@functools.cache
def _kinds() -> dict[str, type]:
    """Everything that a part of a model may be."""
    return {name: cls for union in (Model, Material, Distribution, Masking) for name, cls in members(union).items()}


def owner(model: Model, name: str) -> Any:
    """What the last part of a dotted name is an attribute of; None if there is no such thing."""
    part: Any = model
    for parent in name.split(".")[:-1]:
        part = getattr(part, parent, None)
    return part


def bounds(model: Model, name: str) -> tuple[float, float]:
    """Limits of a parameter that is fitted."""
    low, high = model.free.get(name) or BOUNDS[name.rsplit(".", 1)[-1]]
    # A transparent material that is thinner than air would reflect totally: no surface in air does.
    return (1.0, high) if isinstance(owner(model, name), Dielectric) else (low, high)


def value_of(model: Model, name: str) -> float:
    """The number of a parameter, within its bounds; ValueError in one sentence for what cannot be fitted.

    One that is not given follows from those that stand for it.
    """
    part, last = owner(model, name), name.rsplit(".", 1)[-1]
    if last not in BOUNDS or not hasattr(part, last):
        known = ", ".join(candidates(model))
        raise ValueError(f"{name!r} is no parameter of {type(model).__name__} that can be fitted; choose from {known}.")
    value = getattr(part, last)
    low, high = bounds(model, name)
    return float(np.clip(_implied(part, last) if value is None else value, low, high))


def _implied(part: Any, name: str) -> float:
    """A parameter that is not given but follows from the one that stands for it."""
    if name in ("eta", "k"):
        index = part.refractive_index(np.array([550.0]))[0]
        return float(index.real if name == "eta" else index.imag)
    groups = next(([group.split() for group in row] for row in INSTEAD if name in " ".join(row).split()), [])
    given = [value for group in groups for key in group if isinstance(value := getattr(part, key, None), float)]
    if not given:
        return 0.0
    return 1.0 - given[0] if name in ("protrusion", "floor_height") else float(np.mean(given))


def candidates(model: Model) -> list[str]:
    """Dotted names of everything that can be fitted."""
    return _names(model, "")


def _names(part: Any, prefix: str) -> list[str]:
    names: list[str] = []
    for key in parameters(type(part)):
        value = getattr(part, key)
        if key in BOUNDS:
            names.append(prefix + key)
        elif parameters(type(value)):
            names += _names(value, f"{prefix}{key}.")
    return names


def starts(model: Model, names: Sequence[str]) -> list[float]:
    """Where a fit of these parameters starts; ValueError in one sentence for names that cannot be fitted."""
    if not names:
        known = ", ".join(candidates(model))
        raise ValueError(f"{type(model).__name__}: no parameter to fit; name some of {known}.")
    if len(set(names)) < len(names):
        raise ValueError(f"free = {list(names)}: a parameter is named twice.")
    return [value_of(model, name) for name in names]
