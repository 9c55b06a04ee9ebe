"""Spectra to colours: CIE XYZ of the 1931 2° observer, and linear sRGB.

A reflectance or BRDF known at some wavelengths is taken as linear between them and constant beyond; under an illuminant
a perfect white has Y = 1, and the sRGB of any illuminant's white is (1, 1, 1): the eye adapts (Bradford).
"""

from __future__ import annotations

import functools
from importlib import resources
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from microsurfaces.arrays import Floats

Illuminant = Literal["D65", "A", "E"]
"""Daylight, incandescent light, or equal energy at all wavelengths."""

PRIMARIES = (611.4, 549.1, 464.2)
"""Dominant wavelengths of sRGB's red, green and blue in nm: what stands for a channel where one is asked for."""

_XYZ_TO_RGB = np.array(
    [
        [3.2404541621, -1.5371385940, -0.4985314095],
        [-0.9692660305, 1.8760108454, 0.0415560175],
        [0.0556434310, -0.2040259135, 1.0572251882],
    ]
)
"""Linear sRGB of XYZ (IEC 61966-2-1), its white at D65."""

_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""Cone responses of the Bradford adaptation (CIECAM97)."""


def xyz_weights(wavelengths: ArrayLike, illuminant: Illuminant = "D65") -> Floats:
    """The (3, W) matrix that takes values at `wavelengths` (W,), nm, to X, Y, Z under `illuminant`; rows of Y sum to 1.

    Raises ValueError if two wavelengths are the same.
    """
    nodes = np.asarray(wavelengths, np.float64)
    order = np.argsort(nodes)
    if (np.diff(nodes[order]) <= 0).any():
        raise ValueError(f"wavelengths = {nodes.tolist()} must be different from each other")
    table = _cie()
    light = np.ones(len(table["nm"])) if illuminant == "E" else table[illuminant]
    hats = np.stack([np.interp(table["nm"], nodes[order], row) for row in np.eye(len(nodes))], axis=1)
    weights = np.empty((3, len(nodes)))
    responses = np.stack([table[name] for name in "xyz"]) * light
    weights[:, order] = responses @ hats
    return np.asarray(weights / responses[1].sum())


def rgb_weights(wavelengths: ArrayLike, illuminant: Illuminant = "D65") -> Floats:
    """The (3, W) matrix that takes values at `wavelengths` (W,), nm, to linear sRGB; each row sums to 1."""
    xyz = xyz_weights(wavelengths, illuminant)
    white, day = xyz.sum(axis=1), xyz_weights([550.0], "D65")[:, 0]
    cones = _BRADFORD @ day / (_BRADFORD @ white)
    rgb = _XYZ_TO_RGB @ np.linalg.inv(_BRADFORD) @ (cones[:, None] * (_BRADFORD @ xyz))
    return np.asarray(rgb / rgb.sum(axis=1, keepdims=True))


def xyz_of_rgb() -> Floats:
    """The (3, 3) matrix from linear sRGB to XYZ; its white is D65's."""
    return np.linalg.inv(_XYZ_TO_RGB)


def encoded(linear: ArrayLike) -> Floats:
    """sRGB of a screen, 0 to 1, from linear sRGB (..., 3), clipped (IEC 61966-2-1)."""
    x = np.clip(np.asarray(linear, np.float64), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


@functools.cache
def _cie() -> dict[str, Floats]:
    """Columns of the vendored table by name."""
    text = resources.files("gonio").joinpath("data/cie.csv").read_text(encoding="utf-8").splitlines()
    lines = [line for line in text if not line.startswith("#")]
    rows = np.array([line.split(",") for line in lines[1:]], np.float64)
    return dict(zip(lines[0].split(","), rows.T, strict=True))
