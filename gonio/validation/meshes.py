"""Meshes of points in rows and columns."""

from __future__ import annotations

import numpy as np

from microsurfaces import Mesh
from microsurfaces.arrays import Floats


def sheet(points: Floats, period: tuple[float, float]) -> Mesh:
    """A mesh of points (rows, columns, 3), rows to the left of columns from above; what has no area is left out."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3).astype(np.int32)
    mesh = Mesh(points.reshape(-1, 3), faces, period)
    return Mesh(mesh.vertices, faces[mesh.areas() > 0.0], period)


def extruded(x: Floats, z: Floats, y: Floats) -> Mesh:
    """A profile (columns,) drawn along `y` (rows,), which may be any increasing numbers."""
    points = np.empty((y.size, x.size, 3))
    points[..., 0], points[..., 1], points[..., 2] = x, y[:, None], z
    return sheet(points, (float(x[-1] - x[0]), float(y[-1] - y[0])))
