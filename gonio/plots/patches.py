"""Lobes without the noise of single bins: averages over patches around the vertices of a regular mesh of directions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gonio.sphere import direction
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    import xarray as xr

PATCH = 3.0
"""Degrees over which a lobe is averaged before it is drawn: bins near the pole are so small that they are all noise."""
VERTEX = 1.5
"""Degrees between the vertices."""
THETA, DPHI = np.arange(0.0, 90.01, VERTEX), np.arange(0.0, 360.0, VERTEX)
"""Polar angles (rows,) and azimuths (columns,) of the vertices, degrees."""


def width(data: xr.Dataset) -> float:
    """Degrees over which the bins are averaged: `PATCH`, or a bin where bins are larger."""
    return max(PATCH, 90 / data.sizes["theta_o"])


def scattered(data: xr.Dataset, brdf: Floats) -> Floats:
    """Light per solid angle, BRDF times cosine in 1/sr, around every vertex: (rows, columns, channels).

    `brdf` (rings, sectors, channels) are the values in the bins of `data`. The weights are the solid angle and a smooth
    patch; NaN where no bin around is known, 0 along the horizon, where the cosine leaves no light.
    """
    light, (solid, _) = _around(data, brdf)
    with np.errstate(invalid="ignore", divide="ignore"):
        value = (light / solid[:, None]).reshape(len(THETA) - 1, len(DPHI), -1)
    return np.concatenate([value, np.zeros_like(value[:1])])


def averaged(data: xr.Dataset, brdf: Floats) -> Floats:
    """The BRDF itself around every vertex but those on the horizon, cos-weighted: (rows - 1, columns, channels)."""
    light, (_, projected) = _around(data, brdf)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((light / projected[:, None]).reshape(len(THETA) - 1, len(DPHI), -1))


def _around(data: xr.Dataset, brdf: Floats) -> tuple[Floats, tuple[Floats, Floats]]:
    """Sums of the light (vertices, channels), of the solid angle and of the projected one over the patches."""
    from scipy.sparse import csr_array
    from scipy.spatial import KDTree

    solid, projected, directions, owner = _pieces(data)
    values = brdf.reshape(-1, brdf.shape[-1])[owner]
    known = np.isfinite(values).all(axis=1)
    values, solid, projected, directions = (x[known] for x in (values, solid, projected, directions))
    vertices = direction(THETA[:-1, None], DPHI).reshape(-1, 3)
    reach = 2 * np.sin(np.radians(width(data)) / 2)
    pairs = KDTree(vertices).sparse_distance_matrix(KDTree(directions), reach, output_type="ndarray")
    weight = (1 - (pairs["v"] / reach) ** 2) ** 2
    patches = csr_array((weight, (pairs["i"], pairs["j"])), shape=(len(vertices), len(solid)))
    return np.asarray(patches @ (values * projected[:, None])), (patches @ solid, patches @ projected)


def _pieces(data: xr.Dataset) -> tuple[Floats, Floats, Floats, NDArray[np.intp]]:
    """Bins cut into pieces of half a patch at most.

    Their solid angles and projected solid angles (n,), directions (n, 3) and the bins that they belong to (n,).
    """
    rings, sectors = (data[f"{name}_bounds"].values for name in ("theta_o", "dphi"))
    pieces = np.ceil(np.diff(rings, axis=1)[:, 0] / (PATCH / 2)).astype(int)
    edges = [np.linspace(low, high, n, endpoint=False) for (low, high), n in zip(rings, pieces, strict=True)]
    theta = np.radians(np.append(np.concatenate(edges), 90.0))
    cuts = int(np.ceil(360 / len(sectors) / (PATCH / 2)))
    dphi = np.linspace(sectors[0, 0], sectors[-1, 1], cuts * len(sectors), endpoint=False)
    step = np.radians(360 / len(dphi))
    middle = np.degrees(theta[1:] + theta[:-1]) / 2
    directions = direction(middle[:, None], dphi + np.degrees(step) / 2).reshape(-1, 3)
    solid, projected = -np.diff(np.cos(theta)) * step, np.diff(np.sin(theta) ** 2) / 2 * step
    ring = np.repeat(np.arange(len(rings)), pieces)
    owner = ring[:, None] * len(sectors) + np.repeat(np.arange(len(sectors)), cuts)
    return np.repeat(solid, len(dphi)), np.repeat(projected, len(dphi)), directions, owner.ravel()
