from __future__ import annotations

import dataclasses
import json
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from pydantic import Field, TypeAdapter, ValidationError, model_validator

from microsurfaces.recipe import (
    Fraction,
    NonNegative,
    Positive,
    as_toml,
    did_you_mean,
    members,
    parameters,
    recipe,
    sentences,
)


@recipe
class Disc:
    radius: Positive
    """Radius, µm."""
    shade: Fraction = 0.5
    """Grey value."""


@recipe
class Ring:
    inner: NonNegative = 1.0
    """Inner radius."""
    outer: Positive = 2.0
    """Outer radius."""

    @model_validator(mode="after")
    def _ordered(self) -> Ring:
        if self.inner >= self.outer:
            raise ValueError(f"inner = {self.inner:g} must be less than outer = {self.outer:g}")
        return self


Shape = Annotated[Disc | Ring, Field(discriminator="kind")]


@recipe
class Drawing:
    shape: Shape
    """What is drawn."""
    copies: int = 1
    """How often."""
    angles: Annotated[tuple[Annotated[float, Field(ge=0, lt=90)], ...], Field(min_length=1)] = (0.0,)
    """Where to, degrees."""
    pairs: tuple[tuple[float, float], ...] = ()
    """Points."""
    style: Literal["line", "fill"] = "line"
    """How it is drawn."""
    name: str | None = None
    """Its name."""
    closed: bool = True
    """Whether lines are closed."""


def told(**values: Any) -> list[str]:
    values = {"shape": {"kind": "Disc", "radius": 1.0}} | values
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(Drawing).validate_json(json.dumps(values))
    return sentences(caught.value, Drawing)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"shape": {"kind": "Disc", "radius": -1}}, "shape.radius = -1: must be greater than 0."),
        ({"shape": {"kind": "Disc", "radius": "1"}}, "shape.radius = '1': must be a number."),
        ({"shape": {"kind": "Disc", "radius": float("inf")}}, "shape.radius = inf: must be a finite number."),
        ({"shape": {"kind": "Disc", "radius": float("nan")}}, "shape.radius = nan: must be a finite number."),
        ({"shape": {"kind": "Disc"}}, "shape.radius is missing: Radius, µm."),
        ({"shape": {"kind": "Disc", "radius": 1, "shade": 1.5}}, "shape.shade = 1.5: must be 1 or less."),
        (
            {"shape": {"kind": "Disc", "radius": 1, "shad": 1}},
            "shape.shad: Disc has no such parameter; did you mean shade?",
        ),
        (
            {"shape": {"kind": "Disc", "radius": 1, "x": 1}},
            "shape.x: Disc has no such parameter; it knows radius, shade.",
        ),
        ({"shape": {"kind": "Square"}}, "shape.kind = 'Square': unknown; choose Disc or Ring."),
        ({"shape": {"kind": "disk"}}, "shape.kind = 'disk': unknown; choose Disc or Ring; did you mean Disc?"),
        ({"shape": {"radius": 1}}, "shape.kind is missing: choose Disc or Ring."),
        ({"shape": 3}, "shape = 3: must be a table whose kind is Disc or Ring."),
        ({"shape": {"kind": "Ring", "inner": 3}}, "shape.inner = 3 must be less than outer = 2."),
        ({"copies": 2.5}, "copies = 2.5: must be a whole number."),
        ({"copies": 2e3}, "copies = 2000.0: must be a whole number, written 2000."),
        ({"copies": True}, "copies = true: must be a whole number."),
        ({"angles": [0, 90]}, "angles[1] = 90: must be less than 90."),
        ({"angles": []}, "angles = []: must be a list of 1 or more."),
        ({"angles": ["x"]}, "angles[0] = 'x': must be a number."),
        ({"angles": 3}, "angles = 3: must be a list in square brackets."),
        ({"pairs": [[1, 2], [3]]}, "pairs[1][1] is missing."),
        ({"pairs": [[1, 2, 3]]}, "pairs[0] = [1, 2, 3]: must be a list of 2 or fewer."),
        ({"style": "dots"}, "style = 'dots': must be line or fill."),
        ({"name": 3}, "name = 3: must be text in quotes."),
        ({"closed": 1}, "closed = 1: must be true or false."),
        ({"colour": 1}, "colour: Drawing has no such parameter; it knows " + ", ".join(parameters(Drawing)) + "."),
    ],
)
def test_each_mistake_is_one_sentence(values: dict[str, Any], sentence: str) -> None:
    assert told(**values) == [sentence]


def test_all_mistakes_are_told_at_once() -> None:
    values = {"shape": {"kind": "Disc", "radius": 0, "shade": -1}, "copies": "x", "angles": [1, 91]}
    assert told(**values) == [
        "shape.radius = 0: must be greater than 0.",
        "shape.shade = -1: must be 0 or more.",
        "copies = 'x': must be a whole number.",
        "angles[1] = 91: must be less than 90.",
    ]


def test_mistakes_in_python_calls_are_told_in_the_same_way() -> None:
    with pytest.raises(ValidationError) as caught:
        Disc(radius=0, shady=2)  # type: ignore[call-arg]
    assert sentences(caught.value, Disc) == [
        "radius = 0: must be greater than 0.",
        "shady: Disc has no such parameter; did you mean shade?",
    ]


def test_what_is_no_table_at_all_is_one_sentence() -> None:
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(Disc).validate_json("[]")
    assert sentences(caught.value, Disc) == ["[]: must be a table with the parameters of Disc."]


def test_recipes_are_frozen_hash_and_print_as_python() -> None:
    drawing = Drawing(Ring(0.5), angles=(1.0,))
    assert hash(drawing) == hash(Drawing(Ring(0.5), angles=(1.0,)))
    assert eval(repr(drawing)) == drawing
    with pytest.raises(dataclasses.FrozenInstanceError):
        drawing.copies = 2  # type: ignore[misc]


def test_arrays_and_lists_become_tuples_and_numpy_scalars_numbers() -> None:
    drawing = Drawing(Disc(np.float64(2.0)), np.int64(3), np.arange(3.0), [[1, 2]])  # type: ignore[arg-type]
    assert type(drawing.copies) is int
    assert drawing.angles == (0.0, 1.0, 2.0)
    assert drawing.pairs == ((1.0, 2.0),)


def test_a_union_is_read_by_its_kind() -> None:
    assert TypeAdapter(Drawing).validate_json('{"shape": {"kind": "Ring"}}').shape == Ring()


def test_members_names_the_recipes_in_a_type() -> None:
    assert members(Shape) == {"Disc": Disc, "Ring": Ring}
    assert members(Drawing) == {"Drawing": Drawing}
    assert members(Disc | None) == {"Disc": Disc}
    assert members(tuple[float, ...]) == {}


def test_a_misspelt_word_is_recognised() -> None:
    assert did_you_mean("gausian", ["Flat", "Gaussian"]) == "; did you mean Gaussian?"
    assert did_you_mean("xyz", ["Flat", "Gaussian"]) == ""


def test_values_are_shown_as_toml_and_cut_where_long() -> None:
    assert as_toml([True, "a", 1.5, {"b": 1}]) == "[true, 'a', 1.5, {...}]"
    assert as_toml(list(range(9))) == "[0, 1, 2, 3, 4, 5, ...]"
    assert len(as_toml("x" * 200)) == 60
