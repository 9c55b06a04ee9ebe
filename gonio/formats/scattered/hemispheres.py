"""What is known at one incidence: rings and sectors, or scattered directions, linear between them."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from gonio.formats.scattered.rows import SAME, Index, nodes_of
from microsurfaces.arrays import Floats

MOST_STEPS = 1000
"""From triangle to triangle."""

WIDEST_RING, WIDEST_SECTOR = 30.0, 60.0
"""Degrees between neighbouring samples in theta_o and dphi beyond which nothing is known between them."""


class Hemisphere(Protocol):
    """What is known at one incidence."""

    @property
    def steps(self) -> tuple[float, float]:
        """Typical distances in theta_o and dphi, degrees."""

    def at(self, theta: Floats, dphi: Floats) -> Floats:
        """(n, channels), NaN where nothing is known."""


def hemisphere_of(theta: Floats, dphi: Floats, values: Floats, mirrored: bool) -> Hemisphere:
    """The samples of one incidence as rings and sectors if they are some, otherwise as scattered points.

    Those of one side of the plane of incidence stand for both if `mirrored`.
    """
    if mirrored and dphi.max() <= 180 + SAME:
        off = (dphi > SAME) & (dphi < 180 - SAME)
        theta, dphi = np.append(theta, theta[off]), np.append(dphi, 360 - dphi[off])
        values = np.concatenate([values, values[off]])
    (rings, ring), (sectors, sector) = nodes_of(theta), nodes_of(dphi)
    # One sample at the pole has no azimuth.
    sized = len(rings) * len(sectors) - (len(sectors) - 1) * (rings[0] == 0.0 and (ring == 0).sum() == 1)
    if sized > 2 * len(theta) and len(sectors) > 2:
        known = np.isfinite(values).all(axis=1)
        kept = known if known.any() else ~known
        return Cloud(theta[kept], dphi[kept], values[kept])
    total = np.zeros((2, len(rings), len(sectors), values.shape[1]))
    known = np.isfinite(values)
    np.add.at(total[0], (ring, sector), np.where(known, values, 0.0))
    np.add.at(total[1], (ring, sector), known)
    table = np.where(total[1] > 0, total[0] / np.maximum(total[1], 1), np.nan)
    if rings[0] == 0.0 and (ring == 0).sum() == 1:
        table[0] = table[0, sector[ring == 0]]
    return Rings(rings, sectors, _along_scans(rings, table))


def _along_scans(theta: Floats, table: Floats) -> Floats:
    """`table` (rings, sectors, channels) with the rings that a sector's scan has stepped over."""
    filled = table.copy()
    for j in np.flatnonzero(np.isnan(table[..., 0]).any(axis=0)):
        here = np.flatnonzero(np.isfinite(table[:, j]).all(axis=1))
        if len(here) < 2:
            continue
        gaps = np.diff(theta[here])
        stepped = np.repeat(gaps <= 2.1 * np.median(gaps), np.diff(here))
        rings = np.arange(here[0], here[-1])[stepped]
        for channel in range(table.shape[2]):
            filled[rings, j, channel] = np.interp(theta[rings], theta[here], table[here, j, channel])
    return filled


@dataclass(frozen=True)
class Rings:
    """Samples at all crossings of some rings and sectors, holes apart."""

    theta: Floats
    dphi: Floats
    values: Floats
    """(rings, sectors, channels)."""

    @property
    def steps(self) -> tuple[float, float]:
        """Median distances; in a plane of incidence, bins are as narrow as what is known about it."""
        around = np.diff(self.dphi, append=self.dphi[0] + 360)
        narrow = around[around <= WIDEST_SECTOR]
        along = np.diff(self.theta)
        return float(np.median(along)) if along.size else 1.0, float(np.median(narrow)) if narrow.size else 1.0

    def at(self, theta: Floats, dphi: Floats) -> Floats:
        """Linear in both angles."""
        total = np.zeros((2, len(theta), self.values.shape[2]))
        rings, along = _between(self.theta, theta, WIDEST_RING)
        sectors, around = _between(self.dphi, dphi, WIDEST_SECTOR, period=360.0)
        everything = np.arange(len(theta))
        for ring, weight in zip(rings, (1 - along, along), strict=True):
            for sector, share in zip(sectors, (1 - around, around), strict=True):
                accumulate(total, everything, np.nan_to_num(weight * share), self.values[ring, sector])
        return weighted_mean(total)


def _between(
    nodes: Floats, values: Floats, widest: float, period: float | None = None
) -> tuple[tuple[Index, Index], Floats]:
    """The nodes on either side of `values` and how far between them; NaN where that is farther than nodes speak for.

    A node beside a gap wider than `widest`, or at an end, speaks for half the distance to its other neighbour.
    """
    count = np.arange(len(nodes))
    if period is None:
        ends, index = np.concatenate([nodes[:1] - 999, nodes, nodes[-1:] + 999]), np.pad(count, 1, mode="edge")
    else:
        ends, index = np.append(nodes, nodes[0] + period), np.append(count, 0)
        values = (values - nodes[0]) % period + nodes[0]
    low = np.clip(np.searchsorted(ends, values, side="right") - 1, 0, len(ends) - 2)
    gaps = np.diff(ends)
    reach = np.where(gaps <= widest, gaps, 1.0) / 2
    gap, above = gaps[low], values - ends[low]
    spoken = np.where(above <= np.roll(reach, 1)[low], 0.0, np.nan)
    spoken = np.where(gap - above <= np.roll(reach, -1)[low], 1.0, spoken)
    return (index[low], index[low + 1]), np.where(gap <= widest, above / gap, spoken)


@dataclass(frozen=True)
class Cloud:
    """Scattered samples."""

    theta: Floats
    dphi: Floats
    values: Floats
    """(n, channels)."""

    @property
    def steps(self) -> tuple[float, float]:
        """The distance of neighbours in either direction."""
        return 2 * self._reach, 2 * self._reach

    @functools.cached_property
    def _points(self) -> Floats:
        return _disc(self.theta, self.dphi)

    @functools.cached_property
    def _tree(self) -> Any:
        from scipy.spatial import KDTree

        return KDTree(self._points)

    @functools.cached_property
    def _reach(self) -> float:
        """Half the distance between neighbours, degrees."""
        if len(self.theta) < 2:
            return 0.5
        return float(np.median(self._tree.query(self._points, k=2)[0][:, 1])) / 2

    @functools.cached_property
    def _mesh(self) -> Any:
        """The triangles between the points; None if they lie on a line."""
        from scipy.spatial import Delaunay, QhullError

        try:
            return Delaunay(self._points)
        except (QhullError, ValueError):
            return None

    def at(self, theta: Floats, dphi: Floats) -> Floats:
        """Linear over triangles; beyond them the nearest sample, if it is near."""
        wanted = _disc(theta, dphi)
        away, nearest = self._tree.query(wanted)
        near = (away <= self._reach)[:, None]
        beyond = np.where(near, self.values[nearest], np.nan)
        if self._mesh is None:
            return beyond
        corners, weights = self._triangles(wanted, nearest)
        inside = np.einsum("nk,nkc->nc", weights, self.values[corners])
        return np.where(np.isnan(inside), beyond, inside)

    def _triangles(self, wanted: Floats, nearest: Index) -> tuple[Index, Floats]:
        """The corners of the triangle around each point and their weights (n, 3); NaN outside of all.

        From a triangle at the nearest sample one goes through the edge that the point lies farthest behind, until it
        lies behind none: among Delaunay's triangles this ends. (SciPy's own search sets up a linear system for each.)
        """
        mesh = self._mesh
        # Points that lie upon others, or in line, belong to no triangle.
        here = mesh.vertex_to_simplex[nearest]
        here = np.where((here >= 0) & (here < len(mesh.simplices)), here, 0)
        weights = _barycentric(self._points[mesh.simplices[here]], wanted)
        going = np.flatnonzero(weights.min(axis=1) < -SAME)
        for _ in range(MOST_STEPS):
            # Flat triangles on the rim do not know inside from outside: over the rim only where no other way leads on.
            around = mesh.neighbors[here[going]]
            behind = np.where(around >= 0, weights[going], np.inf)
            beyond = np.where(behind.min(axis=1) < -SAME, around[np.arange(len(going)), behind.argmin(axis=1)], -1)
            weights[going[beyond < 0]] = np.nan
            going, beyond = going[beyond >= 0], beyond[beyond >= 0]
            here[going] = beyond
            weights[going] = _barycentric(self._points[mesh.simplices[beyond]], wanted[going])
            going = going[weights[going].min(axis=1) < -SAME]
            if not going.size:
                break
        weights[going] = np.nan
        return mesh.simplices[here], weights


def _barycentric(corners: Floats, points: Floats) -> Floats:
    """Weights of the corners (n, 3, 2) whose sums the points (n, 2) are; NaN for a triangle without area."""
    (ax, ay), (bx, by) = ((corners[:, k] - corners[:, 2]).T for k in (0, 1))
    x, y = (points - corners[:, 2]).T
    with np.errstate(invalid="ignore", divide="ignore"):
        first, second = (x * by - y * bx) / (ax * by - ay * bx), (ax * y - ay * x) / (ax * by - ay * bx)
        return np.asarray(np.stack([first, second, 1 - first - second], axis=-1))


def _disc(theta: Floats, dphi: Floats) -> Floats:
    """The hemisphere laid flat about its pole with true polar angles, (n, 2), degrees."""
    phi = np.radians(dphi)
    return np.stack([theta * np.cos(phi), theta * np.sin(phi)], axis=-1)


def accumulate(total: Floats, at: Index, weight: Floats, values: Floats) -> None:
    """Add values that are known to the sums `total` of values and of weights, (2, n, channels)."""
    known = np.isfinite(values)
    total[0, at] += weight[:, None] * np.where(known, values, 0.0)
    total[1, at] += weight[:, None] * known


def weighted_mean(total: Floats) -> Floats:
    """The weighted mean of what is known, where that is at least half; NaN elsewhere."""
    values, known = total
    return np.where(known >= 0.5 - 1e-9, values / np.where(known > 0, known, 1.0), np.nan)
