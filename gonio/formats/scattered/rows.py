"""Rows of a list: which directions are the same, and where each of them belongs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microsurfaces.arrays import Floats

Index = NDArray[np.intp]

SAME = 1e-4
"""Degrees between angles that are the same: files round radians to six decimals."""


def degrees(radians: ArrayLike) -> Floats:
    """Degrees of `radians` that may have been rounded to six decimals: whole hundredths where they are meant."""
    angle = np.degrees(np.asarray(radians, np.float64))
    whole = np.round(angle, 2)
    return np.where(np.abs(angle - whole) < SAME, whole, angle)


def insist_on_rows(*columns: Floats) -> None:
    """Raises ValueError if there are no rows, or if a number in a column (n,) is not finite."""
    if not columns[0].size:
        raise ValueError("it holds no values")
    if not all(np.isfinite(column).all() for column in columns):
        raise ValueError("a direction or a wavelength is missing or no number")


def upright(theta_i: Floats, phi_i: Floats, theta_o: Floats, dphi: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """The same directions with polar angles of 0 to 90 and azimuths of 0 to 360 degrees."""
    for name, theta in (("theta_i", theta_i), ("theta_o", theta_o)):
        if np.abs(theta).max() > 90 + SAME:
            raise ValueError(f"{name} = {theta[np.abs(theta).argmax()]:g} must lie between 0 and 90 degrees")
    turned_i, turned_o = 180.0 * (theta_i < 0), 180.0 * (theta_o < 0)
    return (
        np.minimum(np.abs(theta_i), 90.0),
        _around(phi_i + turned_i),
        np.minimum(np.abs(theta_o), 90.0),
        _around(dphi + turned_o - turned_i),
    )


def _around(azimuth: Floats) -> Floats:
    """Azimuths from 0 to 360 degrees; those that rounding left just below 360 are 0."""
    wrapped = azimuth % 360.0
    return np.where(wrapped > 360.0 - SAME, 0.0, wrapped)


def nodes_of(values: Floats) -> tuple[Floats, Index]:
    """The different values, ascending, and which of them each is; rounding makes no difference."""
    exact, index = np.unique(values, return_inverse=True)
    first = np.diff(exact, prepend=-np.inf) > SAME
    group = np.cumsum(first) - 1
    if exact.size and (exact - exact[first][group]).max() > 3 * SAME:
        # Values everywhere: a chain of neighbours that are the same is no node.
        return exact, index
    return exact[first], group[index]


def first_seen(values: Floats) -> tuple[Floats, Index]:
    """The different values in the order in which they appear, and which of them each is."""
    different, first, index = np.unique(values, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return different[order], rank[index]


def joined(indices: Sequence[Index]) -> Index:
    """One number for each combination of `indices`, (n,)."""
    key, size = np.zeros(len(indices[0]), np.intp), 1
    for index in indices:
        count = int(index.max()) + 1
        if size * count > 1 << 62:
            values, key = np.unique(key, return_inverse=True)
            size = len(values)
        key, size = key * count + index, size * count
    return key


def places_of(nodes: Floats, values: Floats) -> Index | None:
    """Which node each value is; None if one is none. The tolerance is ten roundings."""
    nearest = np.searchsorted((nodes[1:] + nodes[:-1]) / 2, values)
    return nearest if np.abs(nodes[nearest] - values).max() < 10 * SAME else None


def spread(column: Floats, cell: Index, shape: tuple[int, ...]) -> Floats:
    """Rows at their places in the whole table, (*shape, channels); NaN elsewhere."""
    table = np.full((math.prod(shape), column.shape[1]), np.nan)
    table[cell] = column
    return table.reshape(*shape, -1)
