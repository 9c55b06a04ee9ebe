"""Bin averages of models that are functions: the cos-weighted mean over every bin of a detector."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.detectors import Detector
from gonio.sphere import Vectors

Array = NDArray[np.float64]

TOLERANCE = 1e-5
"""A bin is done when twice as many nodes an axis change it by less than this share of the larger of its own value and
the mean over the detector."""

_NODES = (2, 4, 8, 16, 32, 64, 128, 256, 512, 1024)
"""Gauss-Legendre nodes an axis, tried in turn."""

_BATCH = 1 << 17
"""Directions evaluated at once: bounds the memory whatever the detector."""


class Function(Protocol):
    """A BRDF with a value for every pair of directions."""

    def eval(self, wi: ArrayLike, wo: ArrayLike, wavelengths: ArrayLike = ...) -> Array:
        """BRDF in 1/sr without the cosine, shape (..., W)."""
        ...


Detail = Callable[[Vectors, Vectors, Array], Array]
"""`detail(wi, wo, radius)`: the smallest angle (bins,), radians, over which the BRDF changes within `radius` (bins,) of
the directions `wo` (bins, q, 3)."""


def bin_average(
    model: Function, detail: Detail, wi: ArrayLike, detector: Detector, wavelengths: ArrayLike
) -> NDArray[np.float64]:
    """Average `model` over every bin of `detector` for light from `wi` (3,): (bins, W) in 1/sr, weighted with cos dw.

    Nodes are doubled, bin by bin, until a bin changes by less than `TOLERANCE`. A bin starts with nodes no farther
    apart than `detail`, so that no lobe can slip between them. A lobe too narrow for 1024 nodes an axis is a
    ValueError.
    """
    wi = np.asarray(wi, np.float64)
    wavelengths = np.atleast_1d(np.asarray(wavelengths, np.float64))
    start, solid = _first_nodes(detail, wi, detector), detector.projected_solid_angles()
    average = np.full((detector.bins, wavelengths.size), np.nan)
    unfinished = np.ones(detector.bins, bool)
    for nodes in _NODES:
        bins = np.flatnonzero(unfinished & (start <= nodes))
        finer = _gauss_legendre(model, wi, detector, wavelengths, nodes, bins)
        change, average[bins] = np.abs(finer - average[bins]), finer
        mean = np.nansum(average * solid[:, None], axis=0) / solid.sum()
        unfinished[bins] = ~(change <= TOLERANCE * np.maximum(finer, mean)).all(axis=1)
    if unfinished.any():
        raise ValueError(
            f"{model!r} has a lobe too narrow for {np.count_nonzero(unfinished)} bins of this detector: "
            f"its average does not settle with {_NODES[-1]} nodes an axis; use smaller bins or a rougher model."
        )
    return average


def _gauss_legendre(
    model: Function, wi: Array, detector: Detector, wavelengths: Array, nodes: int, bins: NDArray[np.intp]
) -> Array:
    """Averages (len(bins), W) with a fixed number of nodes an axis, in batches."""
    average = np.zeros((bins.size, wavelengths.size))
    # Apertures use twice as many nodes around their axis as along it.
    batch = max(1, _BATCH // (2 * nodes**2))
    for first in range(0, bins.size, batch):
        some = slice(first, first + batch)
        wo, weights = detector.quadrature(wi, nodes, bins[some])
        for node in range(0, weights.shape[1], _BATCH):
            part = np.s_[:, node : node + _BATCH]
            average[some] += np.einsum("bq,bqw->bw", weights[part], model.eval(wi, wo[part], wavelengths))
    return average


def _first_nodes(detail: Detail, wi: Array, detector: Detector) -> NDArray[np.int64]:
    """Nodes an axis (bins,) at which a bin's nodes stand as close as the BRDF's finest detail in it."""
    wo, _ = detector.quadrature(wi, 2)
    centre = wo.mean(axis=1, keepdims=True)
    # Two Gauss-Legendre nodes stand at 1 / sqrt(3) of the way to the edge.
    radius = np.sqrt(3.0) * np.linalg.norm(wo - centre, axis=-1).max(axis=1)
    wanted = np.clip(2.0 * radius / detail(wi, wo, radius), _NODES[0], _NODES[-2])
    start: NDArray[np.int64] = np.asarray(_NODES)[np.searchsorted(_NODES, wanted)]
    return start
