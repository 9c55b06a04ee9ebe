"""The square on which distributions of normals stand, and the warp under which its nodes follow the lobe."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.sphere import angles, direction
from microsurfaces.arrays import Floats, Vectors

Blend: TypeAlias = Sequence[tuple[NDArray[np.intp], Floats]]
"""Slices of a table, and how much each of them counts, for every point."""


def normal(u: ArrayLike, v: ArrayLike) -> Vectors:
    """Directions (..., 3) of points on the square."""
    return direction(90 * np.square(u), 360 * np.asarray(v) - 180)


def square(w: Vectors) -> tuple[Floats, Floats]:
    """The point (u, v) of directions (..., 3)."""
    theta, phi = angles(w)
    return np.sqrt(theta / 90), (phi / 360 + 0.5) % 1


def solid_angle(u: Floats) -> Floats:
    """In sr per unit of the square's area."""
    return np.asarray(2 * math.pi**2 * u * np.sin(np.square(u) * (math.pi / 2)))


def cell(x: Floats, count: int) -> tuple[NDArray[np.intp], Floats]:
    """The interval of `count` nodes from 0 to 1 that `x` lies in, and how far in it."""
    at = np.clip(x, 0.0, 1.0) * (count - 1)
    lower = np.minimum(at.astype(np.intp), count - 2)
    return lower, at - lower


def bilinear(table: NDArray[np.floating], u: Floats, v: Floats) -> Floats:
    """`table` (rows, columns) between its nodes."""
    (i, s), (j, t) = cell(u, table.shape[1]), cell(v, table.shape[0])
    upper = (1 - s) * table[j, i] + s * table[j, i + 1]
    return np.asarray((1 - t) * upper + t * ((1 - s) * table[j + 1, i] + s * table[j + 1, i + 1]))


def slices_around(*axes: tuple[NDArray[np.floating], Floats]) -> Blend:
    """Slices around values, (nodes, values) for each axis; a table has a slice for every node, those of the last axis
    side by side."""
    blend: list[tuple[NDArray[np.intp], Floats]] = [(np.zeros(axes[0][1].shape, np.intp), np.ones(axes[0][1].shape))]
    for nodes, values in axes:
        if len(nodes) == 1:
            continue
        lower = np.clip(np.searchsorted(nodes, values) - 1, 0, len(nodes) - 2)
        share = np.clip((values - nodes[lower]) / (nodes[lower + 1] - nodes[lower]), 0.0, 1.0)
        blend = [
            (k * len(nodes) + lower + step, weight * part)
            for k, weight in blend
            for step, part in ((0, 1 - share), (1, share))
        ]
    return blend


@dataclass(frozen=True, eq=False)
class Warp:
    """Maps of the unit square, one a slice, under which points (u, v) of a bilinear density become even in (x, y)."""

    density: Floats
    """(slices, rows, columns), each integrating to 1."""
    along: Floats
    """Integrals of the rows up to each column."""
    total: Floats
    """(slices, rows): integrals up to each row."""

    @classmethod
    def of(cls, density: NDArray[np.floating]) -> Self:
        """From a density of any scale. Raises ValueError if a slice is negative, or 0 everywhere."""
        values = np.asarray(density, np.float64)
        if not (values >= 0).all():
            raise ValueError("vndf must not be negative")
        along, total = np.zeros_like(values), np.zeros(values.shape[:2])
        np.cumsum((values[..., 1:] + values[..., :-1]) / (2 * (values.shape[2] - 1)), axis=2, out=along[..., 1:])
        ends = along[..., -1]
        np.cumsum((ends[:, 1:] + ends[:, :-1]) / (2 * (values.shape[1] - 1)), axis=1, out=total[:, 1:])
        whole = total[:, -1:].copy()
        if not (whole > 0).all():
            raise ValueError("vndf is 0 everywhere in one of its slices")
        return cls(values / whole[..., None], along / whole[..., None], total / whole)

    def nodes(self, k: int, count: int) -> tuple[Floats, Floats]:
        """(u, v) of slice `k`, (count, count) each, at even steps in y (rows) and in x (columns)."""
        steps = np.linspace(0.0, 1.0, count)
        rows, columns = self.density.shape[1:]
        row = np.clip(np.searchsorted(self.total[k], steps) - 1, 0, rows - 2)
        ends = self.along[k, :, -1]
        t = _share((steps - self.total[k, row]) * (rows - 1), ends[row], ends[row + 1])[:, None]
        along, density = ((1 - t) * table[k, row] + t * table[k, row + 1] for table in (self.along, self.density))
        wanted = steps * along[:, -1:]
        column = np.clip((along[:, None, :] < wanted[:, :, None]).sum(axis=2) - 1, 0, columns - 2)
        below, left, right = (
            np.take_along_axis(table, index, axis=1)
            for table, index in ((along, column), (density, column), (density, column + 1))
        )
        s = _share((wanted - below) * (columns - 1), left, right)
        return (column + s) / (columns - 1), np.broadcast_to((row[:, None] + t) / (rows - 1), s.shape)

    def invert(self, u: Floats, v: Floats, blend: Blend) -> tuple[Floats, Floats]:
        """(x, y) of points (u, v) between slices: these are blended first, as all readers do."""
        rows, columns = self.density.shape[1:]
        (i, s), (j, t) = cell(u, columns), cell(v, rows)

        def at(table: Floats, *index: NDArray[np.intp] | int) -> Floats:
            return np.asarray(sum(weight * table[(k, *index)] for k, weight in blend))

        left, right = ((1 - t) * at(self.density, j, c) + t * at(self.density, j + 1, c) for c in (i, i + 1))
        x = s * (left + s / 2 * (right - left)) / (columns - 1)
        x += (1 - t) * at(self.along, j, i) + t * at(self.along, j + 1, i)
        first, second = at(self.along, j, -1), at(self.along, j + 1, -1)
        y = t * (first + t / 2 * (second - first)) / (rows - 1) + at(self.total, j)
        width = (1 - t) * first + t * second
        return x / np.where(width > 0, width, 1.0), y


def _share(area: Floats, start: Floats, end: Floats) -> Floats:
    """How far, 0 to 1, the line from `start` to `end` has `area` under it."""
    root = start + np.sqrt(np.maximum(start**2 + 2 * area * (end - start), 0.0))
    return np.clip(2 * area / np.where(root > 0, root, 1.0), 0.0, 1.0)
