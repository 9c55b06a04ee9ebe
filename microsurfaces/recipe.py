"""The frozen, validated dataclass that every recipe is, and the sentences its mistakes are told in.

A recipe holds only scalars, strings, tuples and other recipes. It hashes, prints as Python and round-trips through
TOML: `kind`, the name of its class, says which member of a union a table is.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, TypeVar, dataclass_transform

import numpy as np
from pydantic import ConfigDict, Field, ValidationError, model_validator
from pydantic.dataclasses import dataclass as validated_dataclass
from pydantic_core import ArgsKwargs

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
    converted. Wrong fields raise `pydantic.ValidationError`; `sentences` turns it into one sentence a mistake.
    """
    cls.__annotations__["kind"] = Literal[cls.__name__]  # type: ignore[valid-type]
    cls.kind = Field(default=cls.__name__, kw_only=True, repr=False)  # type: ignore[attr-defined]
    cls._plain_values = model_validator(mode="before")(classmethod(lambda _, data: _plain(data)))  # type: ignore[attr-defined]
    return validated_dataclass(frozen=True, config=_CONFIG)(cls)  # type: ignore[call-overload, no-any-return]


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
