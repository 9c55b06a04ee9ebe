"""Height fields that are hard on shortcuts, and what is exactly known about any height field."""

import functools

import numpy as np

import microsurfaces as ms


def field(heights, spacing=(1.0, 1.0)):
    return ms.HeightField(np.array(heights, np.float64), spacing)


def noise(ny, nx, amplitude=1.0, spacing=(1.0, 1.0), seed=0):
    return field(amplitude * np.random.default_rng(seed).normal(size=(ny, nx)), spacing)


@functools.cache
def gaussian(alpha, seed=7):
    return ms.Gaussian(alpha=alpha, samples=96, side=60.0, correlation_length=6.0).build(seed)


def needles():
    heights = np.zeros((40, 40))
    heights[[3, 17, 17, 38], [5, 18, 20, 0]] = 40.0, 8.0, 12.0, 3.0
    return field(heights)


def walls():
    """Two that cross, one of them along the seam, high above a ground that is not quite even."""
    heights = 0.05 * np.random.default_rng(3).normal(size=(36, 24))
    heights[0, :], heights[:, 11] = 15.0, 9.0
    return field(heights, (0.7, 1.1))


def cliffs():
    """Terraces of three heights, one cell from one to the next."""
    steps = np.random.default_rng(4).integers(0, 3, (6, 4))
    return field(25.0 * np.kron(steps, np.ones((8, 12))))


def towers():
    """Far apart on a long tile whose sides are powers of nothing, so that only the rings know of them."""
    heights = 0.1 * np.random.default_rng(5).normal(size=(45, 170))
    heights[20:22, 10:12], heights[40, 95] = 30.0, 18.0
    return field(heights)


def ramps():
    """Facets that form one plane for as long as they can: nothing can be certain below their slope."""
    profile = np.interp(np.arange(60), [0, 13, 23, 50, 60], [0.0, 13.0, 1.0, 19.0, 0.0])
    return field(profile[:, None] + np.interp(np.arange(44), [0, 31, 44], [0.0, 26.0, 0.0]))


def between_nodes():
    """A Gaussian surface whose nodes have been moved by half a cell."""
    heights = gaussian(0.5).heights
    return field(sum(np.roll(heights, shift, (0, 1)) for shift in np.ndindex(2, 2)) / 4, gaussian(0.5).spacing)


RELIEFS = {
    "flat": lambda: ms.Flat().build(0),
    "gaussian .1": lambda: gaussian(0.1),
    "gaussian .3": lambda: gaussian(0.3),
    "gaussian .5": lambda: gaussian(0.5),
    "gaussian 1": lambda: gaussian(1.0),
    "gaussian anisotropic": lambda: ms.Gaussian(
        alpha_x=0.1, alpha_y=0.8, rotation=30, samples=101, side=80.0, correlation_length=6.0
    ).build(2),
    "between nodes": between_nodes,
    "pyramid": lambda: field([[0.0, 0.0], [0.0, 3.0]]),
    "chess board": lambda: field(2.0 * (np.indices((6, 6)).sum(axis=0) % 2)),
    "5 x 7": lambda: noise(5, 7),
    "33 x 33": lambda: noise(33, 33, seed=1),
    "64 x 3": lambda: noise(64, 3, 2.0, seed=2),
    "oblong cells": lambda: noise(30, 26, 0.5, (0.3, 2.0)),
    "high above zero": lambda: field(gaussian(0.3).heights[:64, :90] + 1e5, (0.6, 0.6)),
    "cliffs": cliffs,
    "needles": needles,
    "needles on the seam": lambda: field(np.roll(needles().heights, (23, -5), (0, 1))),
    "walls": walls,
    "towers": towers,
    "ramps": ramps,
    "steep": lambda: noise(32, 32, 20.0, seed=6),
    "faint": lambda: noise(48, 40, 1e-4, seed=8),
}
"""From the even to the outrageous; built anew at every call."""


def without_shortcuts(grid):
    """The same grid, but nothing is certain and no place is too high for a look at the cells."""
    return grid._replace(
        horizon_code=np.full_like(grid.horizon_code, 255),
        max_mipmap=np.full_like(grid.max_mipmap, np.inf),
        dilated_mipmap=np.full_like(grid.dilated_mipmap, np.inf),
    )


def height(heights, x, y):
    """Height of the triangles over (x, y) in cells, the diagonals as `HeightField.mesh` has them."""
    ny, nx = heights.shape
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = x - i, y - j
    i, j = i % nx, j % ny
    h00, h10 = heights[j, i], heights[j, (i + 1) % nx]
    h01, h11 = heights[(j + 1) % ny, i], heights[(j + 1) % ny, (i + 1) % nx]
    falling = np.where(
        u + v < 1, h00 + u * (h10 - h00) + v * (h01 - h00), h11 + (1 - u) * (h01 - h11) + (1 - v) * (h10 - h11)
    )
    rising = np.where(v < u, h00 + u * (h10 - h00) + v * (h11 - h10), h00 + u * (h11 - h01) + v * (h01 - h00))
    return np.where((i + j) % 2 == 0, falling, rising)


def clearance(heights, x, y, z, dx, dy, dz):
    """How far rays that rise stay above the triangles, (n,): the least height over them after the start; x, y in cells.

    Exact: between two lines of the grid, or two diagonals, whether they are there or not, the surface is linear.
    """
    until = (heights.max() - z) / dz
    least = np.full(x.shape, np.inf)
    for start, rate in ((x, dx), (y, dy), (x + y, dx + dy), (y - x, dy - dx)):
        last = int(np.max(np.abs(rate) * until)) + 2
        first = np.where(rate > 0, np.floor(start) + 1, np.ceil(start) - 1)
        for k in range(last):
            with np.errstate(divide="ignore", invalid="ignore"):
                way = (first + np.copysign(k, rate) - start) / rate
            met = np.isfinite(way) & (way <= until)
            t = way[met]
            above = z[met] + t * dz[met] - height(heights, x[met] + t * dx[met], y[met] + t * dy[met])
            least[met] = np.minimum(least[met], above)
    return least


def on_facets(heights, count, rng):
    """Random points on random facets: their cells (i, j), places (x, y) in cells, and heights."""
    ny, nx = heights.shape
    i, j = rng.integers(0, nx, count), rng.integers(0, ny, count)
    x, y = i + rng.uniform(0, 1, count), j + rng.uniform(0, 1, count)
    return i, j, x, y, height(heights, x, y)
