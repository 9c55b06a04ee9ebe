"""Numbers and words in text files."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np

from microsurfaces.arrays import Floats

LARGEST = 1e15
"""Of the numbers that are read: more is damage, and its sums overflow."""


def numbers(text: str) -> Floats:
    """The numbers of `text`, separated by white space or commas. Raises ValueError if there is anything else."""
    if not text.strip():
        # numpy finds a -1 in nothing but white space.
        return np.empty(0)
    with warnings.catch_warnings():
        # numpy stops at the first word that is no number, and only warns.
        warnings.simplefilter("error", DeprecationWarning)
        try:
            values = np.fromstring(text.replace(",", " "), np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            raise ValueError("there is something that is not a number") from None
    if not (np.abs(values) < LARGEST).all():
        raise ValueError(f"there is a number that is not finite, or beyond {LARGEST:g}")
    return values


def frame(content: bytes, **options: Any) -> Any:
    """Delimited text as a `pandas.DataFrame` of doubles, each the nearest to its decimal."""
    import pandas  # type: ignore[import-untyped]

    # Since 3.1 pandas reads like this anyway, and warns if told to.
    old = tuple(int(number) for number in pandas.__version__.split(".")[:2]) < (3, 1)
    exact = {"float_precision": "round_trip"} if old else {}
    return pandas.read_csv(
        io.BytesIO(content), dtype=np.float64, encoding="utf-8", encoding_errors="replace", **exact, **options
    )


def decimal(value: float) -> str:
    """The shortest decimal that reads back as `value`, never with an exponent."""
    return np.format_float_positional(value, trim="-")


def padded(angle: float) -> str:
    """Degrees in names of files and images: `030.0`, with more digits where one is not enough."""
    return f"{angle:05.1f}" if round(angle, 1) == angle else decimal(angle)


def radians(angle: float) -> str:
    """The shortest decimal of the double that is `angle` degrees in radians."""
    return decimal(float(np.radians(angle)))


def title_of(text: object) -> str:
    """Text on one line."""
    return " ".join(str(text).split())
