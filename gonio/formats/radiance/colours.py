"""Colours of Radiance: white is that of equal energy, trees hold the chromaticities u' and v'."""

from __future__ import annotations

import numpy as np

from gonio.colour import xyz_of_rgb
from microsurfaces.arrays import Floats

WHITE = xyz_of_rgb().sum(axis=1)
"""X, Y and Z of a neutral surface with Y = 1 here; all 1 in the files of Radiance."""


def components(values: Floats, chromaticities: bool) -> dict[str, Floats]:
    """What the file holds of Y or XYZ values (..., channels), by the names of its wavelengths."""
    if values.shape[-1] == 1:
        return {"Visible": values[..., 0]}
    x, y, z = np.moveaxis(values / WHITE, -1, 0)
    if not chromaticities:
        return {"Visible": y, "CIE-X": x, "CIE-Z": z}
    total = x + 15 * y + 3 * z
    lit = total > 0
    total = np.where(lit, total, 1.0)
    return {"Visible": y, "CIE-u": np.where(lit, 4 * x / total, 4 / 19), "CIE-v": np.where(lit, 9 * y / total, 9 / 19)}


def xyz(y: Floats, u: Floats, v: Floats) -> Floats:
    """X, Y and Z (n, 3) of a luminance and chromaticities."""
    # A tree that is damaged, or that Radiance has left empty, has chromaticities that are none.
    v, u = np.where(v > 1e-3, v, 9 / 19), np.minimum(u, 1.0)
    x, z = 9 * u / (4 * v), (12 - 3 * u - 20 * v) / (4 * v)
    return np.asarray(y[:, None] * np.stack([x, np.ones_like(x), np.maximum(z, 0.0)], axis=-1) * WHITE)
