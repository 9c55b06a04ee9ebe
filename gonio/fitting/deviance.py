"""How far a model is from what was counted: the deviance of counts, 2 sum(E ln(E / M) - (E - M)), in units of noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gonio.fitting.binning import Lobe
from microsurfaces.arrays import Floats


def roots(lobes: Sequence[Lobe], predictions: Sequence[Floats]) -> Floats:
    """Signed roots of the deviance of every bin, in units of the noise."""
    found = []
    for lobe, model in zip(lobes, predictions, strict=True):
        expected = model + lobe.background
        ratio = (lobe.energy + lobe.background) / expected
        deviance = 2.0 * expected * _kullback(ratio) / lobe.unit
        found.append((np.sign(ratio - 1.0) * np.sqrt(deviance)).ravel())
    return np.concatenate(found)


def _kullback(ratio: Floats) -> Floats:
    """u ln u - u + 1, accurate where u is 1."""
    x = ratio - 1.0
    near = np.abs(x) < 1e-3
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = np.where(ratio > 0.0, ratio * np.log(ratio), 0.0) - x
    return np.maximum(np.where(near, x * x * (0.5 - x / 6.0 + x * x / 12.0), exact), 0.0)


def parts(lobes: Sequence[Lobe], roots: Floats) -> Floats:
    """The deviance of every block of every lobe."""
    each = np.split(roots**2, np.cumsum([lobe.energy.size for lobe in lobes])[:-1])
    return np.concatenate(
        [
            np.bincount(lobe.blocks, part.reshape(lobe.energy.shape).sum(axis=1))
            for lobe, part in zip(lobes, each, strict=True)
        ]
    )


def deviance_of_noise(lobes: Sequence[Lobe], final: Sequence[Floats]) -> float:
    """The deviance that the measurement's standard errors lead one to expect."""
    return float(
        sum(
            (lobe.error**2 / (lobe.unit * (model + lobe.background))).sum()
            for lobe, model in zip(lobes, final, strict=True)
        )
    )
