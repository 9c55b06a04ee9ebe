"""Bin averages of models that are functions: the cos-weighted mean over every bin of a detector."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.detectors import Detector, HemisphereGrid
from microsurfaces.arrays import Floats, Vectors

TOLERANCE = 1e-5
"""Relative accuracy of an albedo: what a cell may still change by, as a share of itself or of the detector's mean."""

_NODES = (2, 3, 5, 8, 12, 18)
"""Gauss-Legendre nodes an axis, tried in turn in every cell."""

_MORE_NODES = (27, 40, 60, 90, 135, 200, 300, 450, 675, 1000)
"""And in apertures, which cannot be divided."""

_FINEST = 5_000_000
"""Sectors, or rings, of the finest grid that a bin's cells are taken from: its edges must fit into memory."""

_BATCH = 1 << 17
"""Directions evaluated at once: bounds the memory whatever the detector."""


class Estimate(NamedTuple):
    """What a random walk found, and how sure it is: arrays of the same shape, the first axis the orders."""

    value: Floats
    standard_error: Floats


class Function(Protocol):
    """A BRDF with a value for every pair of directions."""

    def eval(self, wi: ArrayLike, wo: ArrayLike, wavelengths: ArrayLike = ...) -> Floats:
        """BRDF in 1/sr without the cosine, shape (..., W)."""
        ...


@runtime_checkable
class RandomWalk(Protocol):
    """A BRDF that is estimated, with a standard error; axis 0 of an estimate is all orders, then 1, 2 ..."""

    def estimate(self, wi: ArrayLike, detector: Detector, wavelengths: ArrayLike, orders: int) -> Estimate:
        """Bin averages in 1/sr, (orders + 1, bins, W)."""
        ...

    def albedo(self, wi: ArrayLike, wavelengths: ArrayLike, orders: int) -> Estimate:
        """Directional-hemispherical reflectance, (orders + 1, W)."""
        ...


Detail = Callable[[Vectors, Vectors, Floats], Floats]
"""`detail(wi, wo, radius)`: the smallest angle (bins,), radians, over which the BRDF changes within `radius` (bins,) of
the directions `wo` (bins, q, 3)."""


def bin_average(
    model: Function, detail: Detail, wi: ArrayLike, detector: Detector, wavelengths: ArrayLike
) -> NDArray[np.float64]:
    """Average `model` over every bin of `detector` for light from `wi` (3,): (bins, W) in 1/sr, weighted with cos dw.

    Adaptive: more and more nodes until a bin has changed twice in a row by less than `TOLERANCE`; bins that do not
    settle, because a lobe is narrow or a kink of the model crosses them, are divided into 3 x 3. No rule is trusted
    whose nodes stand farther apart than `detail`, so that no lobe can slip between them. A lobe too narrow even for the
    finest cells, or for 1000 nodes across an aperture, which is not divided, is a ValueError.
    """
    wi = np.asarray(wi, np.float64)
    wavelengths = np.atleast_1d(np.asarray(wavelengths, np.float64))
    if wi[2] <= 0.0:
        return np.zeros((detector.bins, wavelengths.size))
    solid = detector.projected_solid_angles()
    energy, scale = np.zeros((2, detector.bins, wavelengths.size))
    cells, bins, owner, area = detector, np.arange(detector.bins), np.arange(detector.bins), solid
    for depth in itertools.count():
        # Of a divided bin only the cells along a kink do not settle, fewer as they shrink: they may be less accurate.
        slack = 3.0**depth * scale[owner]
        value, settled = _settle(model, detail, wi, cells, bins, area / solid.sum(), wavelengths, slack)
        estimate = energy.copy()
        np.add.at(estimate, owner, np.nan_to_num(value) * area[:, None])
        np.add.at(energy, owner[settled], value[settled] * area[settled, None])
        if settled.all():
            return energy / solid[:, None]
        if not isinstance(cells, HemisphereGrid) or 3 * max(cells.shape) > _FINEST:
            break
        scale = np.maximum(estimate / solid[:, None], estimate.sum(axis=0) / solid.sum())
        cells, bins, owner = _divide(cells, bins[~settled], owner[~settled])
        area = _areas(cells, bins)
    raise ValueError(
        f"{model!r} has a lobe too narrow for {np.unique(owner).size} bins of this detector: their averages do not "
        "settle; use smaller bins or a rougher model."
    )


def _settle(
    model: Function,
    detail: Detail,
    wi: Floats,
    detector: Detector,
    bins: NDArray[np.intp],
    share: Floats,
    wavelengths: Floats,
    scale: Floats,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Averages (len(bins), W) of cells, and which of them settled (len(bins),).

    A cell has settled when it changed twice in a row by less than `TOLERANCE` times the largest of its own value, of
    `scale` (len(bins), W) and of the mean over `bins`, weighted with their `share` (len(bins),) of the whole detector.
    """
    rules = _NODES if isinstance(detector, HemisphereGrid) else _NODES + _MORE_NODES
    wanted = _wanted_nodes(detail, wi, detector, bins)
    value, streak = np.full((bins.size, wavelengths.size), np.nan), np.zeros(bins.size, int)
    for nodes in rules:
        some = np.flatnonzero((streak < 2) & (wanted <= nodes))
        finer = _gauss_legendre(model, wi, detector, wavelengths, nodes, bins[some])
        change, value[some] = np.abs(finer - value[some]), finer
        mean = np.nansum(value * share[:, None], axis=0)
        close = change <= TOLERANCE * np.maximum(np.maximum(finer, scale[some]), mean)
        streak[some] = np.where(close.all(axis=1), streak[some] + 1, 0)
    return value, streak >= 2


def _gauss_legendre(
    model: Function, wi: Floats, detector: Detector, wavelengths: Floats, nodes: int, bins: NDArray[np.intp]
) -> Floats:
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


def _wanted_nodes(detail: Detail, wi: Floats, detector: Detector, bins: NDArray[np.intp]) -> Floats:
    """Nodes an axis (len(bins),) at which a cell's nodes stand as close as the BRDF's finest detail in it."""
    wo, _ = detector.quadrature(wi, 2, bins)
    centre = wo.mean(axis=1, keepdims=True)
    # Two Gauss-Legendre nodes stand at 1 / sqrt(3) of the way to the edge.
    radius = np.sqrt(3.0) * np.linalg.norm(wo - centre, axis=-1).max(axis=1)
    wanted: Floats = 2.0 * radius / detail(wi, wo, radius)
    return wanted


def _divide(
    grid: HemisphereGrid, bins: NDArray[np.intp], owner: NDArray[np.intp]
) -> tuple[HemisphereGrid, NDArray[np.intp], NDArray[np.intp]]:
    """The grid of a third of the steps, the cells of it that `bins` consist of, and whom each belongs to.

    Bins are centred on multiples of their steps, so that three of the finer ones fill a coarse one.
    """
    finer = HemisphereGrid(theta_step=grid.theta_step / 3, phi_step=grid.phi_step / 3, spacing=grid.spacing)
    rings, sectors = finer.shape
    ring, sector = np.divmod(bins, grid.shape[1])
    thirds = np.arange(3)
    ring = 3 * ring[:, None, None] + (thirds if grid.spacing == "projected_area" else thirds - 1)[:, None]
    sector = (3 * sector[:, None, None] + thirds - 1) % sectors
    # The polar cap and the horizon's half bin have fewer rings than three.
    there = np.broadcast_to((ring >= 0) & (ring < rings), (bins.size, 3, 3))
    owners = np.broadcast_to(owner[:, None, None], there.shape)
    return finer, (ring * sectors + sector)[there], owners[there]


def _areas(grid: HemisphereGrid, bins: NDArray[np.intp]) -> Floats:
    """Projected solid angles of some bins, sr; a fine grid has too many to compute them all."""
    sectors = grid.shape[1]
    sin2 = np.sin(np.radians(grid.theta_edges)) ** 2
    return np.asarray(np.diff(sin2)[bins // sectors] * np.pi / sectors)
