"""What arrays are called in signatures; their shapes and units stand in the docstrings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Float32s = NDArray[np.float32]
Integers = NDArray[np.int64]
Indices = NDArray[np.intp]
Vectors = NDArray[np.float64]
"""Directions or points, the last axis 3."""
