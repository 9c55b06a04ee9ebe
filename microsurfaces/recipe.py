"""The frozen, validated dataclass that every recipe is, and the sentences its mistakes are told in.

A recipe holds only scalars, strings, tuples and other recipes. It hashes, prints as Python and round-trips through
TOML: `kind`, the name of its class, says which member of a union a table is.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterable, Mapping, Sequence
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, dataclass_transform, get_args, get_origin

import numpy as np
from pydantic import ConfigDict, Field, ValidationError, model_validator
from pydantic.dataclasses import dataclass as validated_dataclass
from pydantic.fields import FieldInfo
from pydantic_core import ArgsKwargs, ErrorDetails, PydanticUndefined

Class = TypeVar("Class", bound=type)

Positive = Annotated[float, Field(gt=0)]
"""A finite number above zero."""

NonNegative = Annotated[float, Field(ge=0)]
"""A finite number, zero or above."""

Fraction = Annotated[float, Field(ge=0, le=1)]
"""A number from 0 to 1."""

_CONFIG = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True)


@dataclass_transform(frozen_default=True, field_specifiers=(Field,))
def recipe(cls: Class) -> Class:
    """Make `cls` a frozen, strictly validated dataclass with a literal `kind`, its own name.

    Lists and numpy arrays given for a field become tuples, numpy scalars become Python numbers; nothing else is
    converted. Wrong fields raise `pydantic.ValidationError`; `sentences` turns it into one sentence a mistake. Printed,
    a recipe is the Python that makes it, without what is left at its default.
    """
    cls.__repr__ = _as_python  # type: ignore[method-assign, assignment]
    cls.__annotations__["kind"] = Literal[cls.__name__]
    cls.kind = Field(default=cls.__name__, kw_only=True, repr=False)  # type: ignore[attr-defined]
    cls._plain_values = model_validator(mode="before")(classmethod(lambda _, data: _plain(data)))  # type: ignore[attr-defined, arg-type]
    return validated_dataclass(frozen=True, config=_CONFIG)(cls)  # type: ignore[return-value]


def _as_python(recipe: Any) -> str:
    said = {f.name: getattr(recipe, f.name) for f in dataclasses.fields(recipe) if f.repr}
    defaults = {name: field.get_default(call_default_factory=True) for name, field in parameters(type(recipe)).items()}
    changed = (f"{name}={value!r}" for name, value in said.items() if value != defaults.get(name, PydanticUndefined))
    return f"{type(recipe).__name__}({', '.join(changed)})"


def _plain(value: Any) -> Any:
    """`value` with lists and arrays as tuples and numpy scalars as Python numbers, all the way down."""
    match value:
        case ArgsKwargs():
            return ArgsKwargs(_plain(value.args), _plain(value.kwargs or {}))
        case Mapping():
            return {key: _plain(item) for key, item in value.items()}
        case np.ndarray() | np.generic():
            return _plain(value.tolist())
        case list() | tuple():
            return tuple(_plain(item) for item in value)
    return value


# --- The sentences that mistakes are told in -------------------------------------------------------------------------


def members(annotation: Any) -> dict[str, type]:
    """The recipes that a type names, by class name: itself, or every member of a union; empty if there are none."""
    if get_origin(annotation) is Annotated:
        return members(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return {name: cls for arm in get_args(annotation) for name, cls in members(arm).items()}
    return {annotation.__name__: annotation} if hasattr(annotation, "__pydantic_fields__") else {}


def parameters(owner: type | None) -> dict[str, FieldInfo]:
    """The parameters of a recipe by name, without its kind."""
    return {name: field for name, field in getattr(owner, "__pydantic_fields__", {}).items() if name != "kind"}


def sentences(error: ValidationError, expected: Any) -> list[str]:
    """One sentence for each mistake in what should have been an `expected` (a recipe or a union of them).

    Each says the dotted key and its value, what was expected and, where that can be told, what to do.
    """
    mistakes = error.errors(include_url=False)
    inside = {mistake["loc"][:-1] for mistake in mistakes}
    # A list whose items are wrong counts as too short as well: the items' own sentences say it better.
    return [
        _sentence(mistake, _place(mistake["loc"], expected))
        for mistake in mistakes
        if mistake["type"] != "too_short" or mistake["loc"] not in inside
    ]


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """The question after a misspelt word, '; did you mean Gaussian?', or nothing where no known word is near."""
    spellings = {name.lower(): name for name in known}
    near = difflib.get_close_matches(str(word).lower(), spellings, n=1, cutoff=0.6)
    return f"; did you mean {spellings[near[0]]}?" if near else ""


class _Place(NamedTuple):
    """Where a mistake is."""

    key: str
    """Dotted key, without the names of union members."""
    expected: Any
    """Type of what belongs there."""
    owner: type | None
    """The innermost recipe around it."""


def _place(location: tuple[str | int, ...], expected: Any) -> _Place:
    """Follow one of pydantic's locations down the types."""
    key, owner = "", next(iter(members(expected).values())) if len(members(expected)) == 1 else None
    for part in location:
        known = members(expected)
        if part in known:
            expected = owner = known[str(part)]
        elif isinstance(part, int):
            key += f"[{part}]"
            arms = get_args(expected)
            expected = arms[part] if part < len(arms) and arms[-1] is not Ellipsis else next(iter(arms), None)
        elif known or not key:
            owner = next(iter(known.values()), owner)
            fields = parameters(owner)
            expected = fields[part].annotation if part in fields else None
            key = f"{key}.{part}" if key else part
    return _Place(key, expected, owner)


def _sentence(mistake: ErrorDetails, place: _Place) -> str:
    """The sentence of one of pydantic's errors."""
    key, fields, tags = place.key, parameters(place.owner), list(members(place.expected))
    value, context = mistake["input"], mistake.get("ctx", {})
    word = key.rpartition(".")[2]
    kind = f"{key}.kind".removeprefix(".")
    match mistake["type"]:
        case "missing" | "missing_argument" | "missing_keyword_only_argument":
            note = fields[word].description if word in fields else None
            text = f"{key} is missing" + (f": {note}" if note else "")
        case "unexpected_keyword_argument" | "extra_forbidden":
            hint = did_you_mean(word, fields) or f"; it knows {', '.join(fields)}"
            text = f"{key}: {place.owner.__name__ if place.owner else 'the recipe'} has no such parameter{hint}"
        case "union_tag_not_found" if isinstance(value, Mapping):
            text = f"{kind} is missing: choose {_choice(tags)}"
        case "union_tag_not_found" | "dict_type" | "model_attributes_type":
            text = f"{key} = {as_toml(value)}: must be a table whose kind is {_choice(tags)}"
        case "union_tag_invalid":
            tag = context["tag"]
            text = f"{kind} = {as_toml(tag)}: unknown; choose {_choice(tags)}{did_you_mean(tag, tags)}"
        case "value_error" if str(context["error"]).partition(" ")[0] in _inner(place.expected):
            text = f"{key}.{context['error']}".removeprefix(".")
        case "value_error" if not key or isinstance(value, Mapping | ArgsKwargs):
            text = f"{key}: {context['error']}".removeprefix(": ")
        case "value_error":
            text = f"{key} = {as_toml(value)}: {str(context['error']).removeprefix(as_toml(value)).lstrip()}"
        case "dataclass_type":
            text = f"{key} = {as_toml(value)}: must be a table with the parameters of {_choice(tags)}".removeprefix(
                " = "
            )
        case "int_type" | "int_from_float" if isinstance(value, float) and value.is_integer():
            text = f"{key} = {as_toml(value)}: must be a whole number, written {int(value)}"
        case other:
            text = f"{key} = {as_toml(value)}: must be {_expectation(other, context) or mistake['msg']}"
    return text if text.endswith((".", "?", "!")) else text + "."


def _inner(expected: Any) -> dict[str, FieldInfo]:
    """The parameters of the recipe that belongs in a place, if it can only be one."""
    return parameters(next(iter(members(expected).values()), None)) if len(members(expected)) == 1 else {}


def _expectation(kind: str, context: Mapping[str, Any]) -> str:
    """What a value must be, from the type of pydantic's error; empty for a type that no recipe has met yet."""
    match kind:
        case "greater_than":
            return f"greater than {context['gt']:g}"
        case "greater_than_equal":
            return f"{context['ge']:g} or more"
        case "less_than":
            return f"less than {context['lt']:g}"
        case "less_than_equal":
            return f"{context['le']:g} or less"
        case "too_short":
            return f"a list of {context['min_length']} or more"
        case "too_long":
            return f"a list of {context['max_length']} or fewer"
        case "literal_error":
            return _choice(context["expected"].replace("'", "").replace(" or ", ", ").split(", "))
    return {
        "finite_number": "a finite number",
        "float_type": "a number",
        "int_type": "a whole number",
        "int_from_float": "a whole number",
        "string_type": "text in quotes",
        "bool_type": "true or false",
        "tuple_type": "a list in square brackets",
    }.get(kind, "")


def _choice(names: Sequence[str]) -> str:
    """'a, b or c'."""
    return " or ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def as_toml(value: object) -> str:
    """A value as it stands in TOML, cut where it is long."""
    match value:
        case bool():
            text = str(value).lower()
        case Mapping():
            text = "{...}"
        case list() | tuple():
            text = f"[{', '.join(map(as_toml, value[:6]))}{', ...' if len(value) > 6 else ''}]"
        case _:
            text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
