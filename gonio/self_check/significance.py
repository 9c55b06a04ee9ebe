"""How surely a random check must be wrong before it fails."""

from __future__ import annotations

import numpy as np

LEVEL = 1e-3
"""Probability that a random check fails although nothing is wrong."""


def sidak_level(cases: int) -> float:
    """The level of one of `cases` that gives all of them together `LEVEL`."""
    return float(-np.expm1(np.log1p(-LEVEL) / cases))
