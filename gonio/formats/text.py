"""Numbers in text files."""

from __future__ import annotations

import warnings

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
