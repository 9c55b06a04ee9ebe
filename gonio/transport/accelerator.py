"""The tables of a height field that say where light cannot meet it: what is proven there need not be traced.

Coordinates are in cells, x from 0 to nx and y from 0 to ny; heights in µm above the middle of the relief; slopes in µm
per cell. Everything repeats periodically, whatever the number of nodes. Three tables:

* `max_mipmap`: the highest point of every node of a quadtree over the cells (Tevs, Ihrke and Seidel 2008,
  doi:10.1145/1342250.1342279). A ray that passes above a node cannot hit anything in it.
* `dilated_mipmap`: the same of a node and its neighbours. A bundle of parallel rays as wide as a node, whose middle
  passes above that, cannot hit anything either.
* `horizon_code`: certified escape. For blocks of 4 x 4 cells and 16 sectors of azimuth, a slope: a ray that leaves the
  relief anywhere in the block, toward the sector and more steeply than that, hits nothing.

All of them are rounded to the safe side.
"""

from __future__ import annotations

import itertools
import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.randomness import kernel
from microsurfaces import HeightField
from microsurfaces.arrays import Float32s, Floats

BLOCK = 2
"""Level of the quadtree, 4 x 4 cells, that `horizon_code` speaks of, and below which rays go from cell to cell."""

SECTORS = 16
"""Sectors of azimuth, numbered by what is cheap to find: see `horizon_sector`."""

NEAR = 2
"""The near part of a bound looks at slopes, up to 2^NEAR nodes away; beyond it heights are compared."""

ROUNDING = 2.5e-7
"""Margin of float32 heights, in units of the largest: more than their rounding error and that of a ray's height."""

MARGIN = 1e-5
"""Relative margin of the certified slopes."""

TAN_PI_8 = math.tan(math.pi / 8)

_CERTAIN = np.concatenate([2.0 ** ((np.arange(255) - 128) / 16), [np.inf]])
"""The slope, in units of the rms slope, that a code stands for: 4 % from one to the next, from 1/256 to 240."""


class Ring(NamedTuple):
    """What lies between two distances, R and 2R, from a node of a level, toward each sector."""

    level: int
    near: float
    """R in cells."""
    boxes: Floats
    """(SECTORS, 4), as of `_boxes`."""
    cells: tuple[int, int]
    """(ny, nx) of the height field."""


class Accelerator(NamedTuple):
    """A height field with its tables, ready to be traced."""

    heights: Floats
    """(ny + 1, nx + 1) µm: the nodes, the first row and column repeated at the end."""
    top: float
    """The highest of them."""
    spacing: tuple[float, float]
    """µm a cell along x and y."""
    max_mipmap: Float32s
    """Highest point of every node, level after level, row after row."""
    offsets: NDArray[np.int64]
    """Where each level begins in `max_mipmap`, and where the last ends."""
    widths: NDArray[np.int64]
    """Nodes in a row of each level."""
    dilated_mipmap: Float32s
    """Highest point of every node and its neighbours, from level 1 on."""
    horizon_code: NDArray[np.uint8]
    """(rows, columns, sectors): the certified slope of every block, as an index into `horizon_slope2`."""
    horizon_slope2: Floats
    """(256,): squares of slopes, (µm per cell)²; the last is infinite."""

    @classmethod
    def of(cls, relief: HeightField) -> Accelerator:
        """The tables of `relief`: about 0.2 s per million nodes on two cores."""
        heights = np.pad(relief.heights, ((0, 1), (0, 1)), mode="wrap")
        heights -= (heights.min() + heights.max()) / 2
        margin = ROUNDING * float(np.abs(heights).max())
        max_mipmap, offsets, widths = _pyramid(heights, margin)
        bottoms = -_pyramid(-heights, margin)[0]
        slopes = _certified_slopes(heights, max_mipmap, bottoms, offsets, widths)
        unit = (
            float(np.sqrt(np.mean(np.diff(heights, axis=0)[:, :-1] ** 2 + np.diff(heights, axis=1)[:-1] ** 2))) or 1.0
        )
        horizon_slope2 = (unit * _CERTAIN * (1 + MARGIN)) ** 2
        horizon_code = np.empty((*slopes.shape[1:], SECTORS), np.uint8)
        _in_rows(_encode, len(horizon_code), slopes, unit * _CERTAIN, horizon_code)
        dilated_mipmap = _dilated(max_mipmap, offsets, widths, heights.shape)
        return cls(
            heights,
            float(heights.max()),
            relief.spacing,
            max_mipmap,
            offsets,
            widths,
            dilated_mipmap,
            horizon_code,
            horizon_slope2,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx), cells."""
        return self.heights.shape[0] - 1, self.heights.shape[1] - 1

    def certainty(self, dx: float, dy: float, dz: float) -> float:
        """Share of the blocks from which light in a direction, per cell along x and y, is certain to escape."""
        # The last code is never certain, not even straight up.
        enough = np.append(dz * abs(dz) > self.horizon_slope2[:-1] * (dx * dx + dy * dy), False)
        return float(np.mean(enough[self.horizon_code[..., horizon_sector(dx, dy)]]))


@kernel
def horizon_sector(dx, dy):
    """The sector of azimuth of a direction: one bit each for the signs of x and y, |y| > |x|, and the nearer octant."""
    ax, ay = abs(dx), abs(dy)
    steep = min(ax, ay) > TAN_PI_8 * max(ax, ay)
    return np.int64(dx < 0) | np.int64(dy < 0) << 1 | np.int64(ay > ax) << 2 | np.int64(steep) << 3


def _sides() -> NDArray[np.int64]:
    """(SECTORS,) the lower side of every sector, in sixteenths of a turn."""
    places = (np.arange(SECTORS) + 0.5) * (2 * math.pi / SECTORS)
    sides = np.empty(SECTORS, np.int64)
    for place, angle in enumerate(places):
        sides[horizon_sector(math.cos(angle), math.sin(angle))] = place
    return sides


def _boxes(near: float, far: float) -> Floats:
    """(SECTORS, 4): x from, to, y from, to of what lies within a sector between two distances."""
    angles = (_sides()[:, None] + np.arange(2)) * (2 * math.pi / SECTORS)
    x, y = (np.multiply.outer((near, far), along(angles)) for along in (np.cos, np.sin))
    return np.stack([x.min(axis=(0, 2)), x.max(axis=(0, 2)), y.min(axis=(0, 2)), y.max(axis=(0, 2))], axis=-1)


def _levels(ny: int, nx: int) -> list[tuple[int, int]]:
    """Rows and columns of every level, from the cells to a single node, at least up to `BLOCK`."""
    levels = [(ny, nx)]
    while max(levels[-1]) > 1 or len(levels) <= BLOCK:
        levels.append((-(-levels[-1][0] // 2), -(-levels[-1][1] // 2)))
    return levels


def _pyramid(heights: Floats, margin: float) -> tuple[Float32s, NDArray[np.int64], NDArray[np.int64]]:
    """Highest points of the nodes of all levels, with where each level begins and how wide it is."""
    shapes = _levels(heights.shape[0] - 1, heights.shape[1] - 1)
    offsets = np.cumsum([0] + [rows * columns for rows, columns in shapes])
    max_mipmap = np.empty(offsets[-1], np.float32)
    levels = [
        max_mipmap[start:stop].reshape(s) for start, stop, s in zip(offsets[:-1], offsets[1:], shapes, strict=True)
    ]
    _in_rows(_cells, len(levels[0]), heights, margin, levels[0])
    for finer, coarser in itertools.pairwise(levels):
        _in_rows(_merge, len(coarser), finer, coarser)
    return max_mipmap, offsets, np.array([columns for _, columns in shapes])


def _in_rows(job, rows: int, *arguments) -> None:
    """Run a kernel over all rows, shares of them on every core."""
    cores = min(os.cpu_count() or 1, max(1, rows // 64))
    edges = [rows * k // cores for k in range(cores + 1)]
    with ThreadPoolExecutor(cores) as pool:
        list(pool.map(lambda first, last: job(first, last, *arguments), edges, edges[1:]))


@kernel
def _cells(first, last, heights, margin, out):
    for j in range(first, last):
        for i in range(out.shape[1]):
            h = max(max(heights[j, i], heights[j, i + 1]), max(heights[j + 1, i], heights[j + 1, i + 1]))
            out[j, i] = np.float32(h + margin)


@kernel
def _merge(first, last, finer, out):
    rows, columns = finer.shape
    for j in range(first, last):
        below, above = 2 * j, min(2 * j + 1, rows - 1)
        for i in range(out.shape[1]):
            left, right = 2 * i, min(2 * i + 1, columns - 1)
            out[j, i] = max(max(finer[below, left], finer[below, right]), max(finer[above, left], finer[above, right]))


def _dilated(
    max_mipmap: Float32s, offsets: NDArray[np.int64], widths: NDArray[np.int64], shape: tuple[int, int]
) -> Float32s:
    """Highest point of every node and those that a bundle about its middle can reach, from level 1 on."""
    parts = []
    for level in range(1, len(widths)):
        nodes = max_mipmap[offsets[level] : offsets[level + 1]].reshape(-1, widths[level])
        for axis, cells in enumerate(size - 1 for size in shape):
            # The last node may be narrower than the bundle.
            reach = 1 if cells % (1 << level) == 0 else 2
            nodes = np.maximum.reduce([np.roll(nodes, shift, axis) for shift in range(-reach, reach + 1)])
        parts.append(nodes.ravel())
    return np.concatenate(parts)


def _certified_slopes(
    heights: Floats,
    max_mipmap: Float32s,
    bottoms: Float32s,
    offsets: NDArray[np.int64],
    widths: NDArray[np.int64],
) -> Float32s:
    """(SECTORS, rows, columns) slopes, µm per cell: who leaves a block more steeply hits nothing.

    Up to R = 2^NEAR nodes away no facet rises more steeply toward the sector. Beyond it, from R to 2R, 2R to 4R and so
    on, nothing is higher than a line of that slope from the lowest point of the block, seen from as near as the ring
    comes. Larger rings are looked at for larger blocks, with their nodes; the largest is bounded by the highest point
    of all.
    """
    ny, nx = heights.shape[0] - 1, heights.shape[1] - 1
    level = len(widths) - 1
    while level > BLOCK and (1 << level + NEAR) > max(nx, ny):
        level -= 1
    shape = _levels(ny, nx)[level]
    lows = bottoms[offsets[level] : offsets[level + 1]].reshape(shape)
    slopes = np.repeat(((max_mipmap[-1] - lows) / (1 << level + NEAR))[None], SECTORS, axis=0)
    while level > BLOCK:
        level -= 1
        coarser, slopes = slopes, np.empty((SECTORS, *_levels(ny, nx)[level]), np.float32)
        near = float(1 << level + NEAR)
        part = slice(offsets[level], offsets[level + 1])
        nodes = (values[part].reshape(slopes.shape[1:]) for values in (max_mipmap, bottoms))
        ring = Ring(level, near, _boxes(near, 2 * near), (ny, nx))
        _in_rows(_ring, slopes.shape[1], *nodes, ring, coarser, slopes)
    steepest = np.empty_like(slopes)
    _in_rows(_steepest, slopes.shape[1], heights, _sides(), steepest)
    _in_rows(_nearby, slopes.shape[1], steepest, _boxes(0.0, float(1 << BLOCK + NEAR)), (ny, nx), slopes)
    return slopes


@kernel
def _ring(first, last, max_mipmap, bottoms, ring, coarser, out):
    """The bound of one ring, or that of the larger ones if it is higher."""
    level, near, boxes, cells = ring
    for k in range(out.shape[0]):
        box = boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3]
        for j in range(first, last):
            for i in range(out.shape[2]):
                top = _highest(i, j, level, box, cells, max_mipmap)
                out[k, j, i] = max((top - bottoms[j, i]) / near, coarser[k, j >> 1, i >> 1])


@kernel
def _nearby(first, last, steepest, boxes, cells, out):
    """Raise the bound of every block to the largest slope near it."""
    for k in range(out.shape[0]):
        slopes = steepest[k]
        box = boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3]
        for j in range(first, last):
            for i in range(out.shape[2]):
                out[k, j, i] = max(out[k, j, i], _highest(i, j, BLOCK, box, cells, slopes))


@kernel
def _highest(i, j, level, box, cells, values):
    """Largest value of the nodes in reach of node (i, j): of those that its box, moved anywhere in it, touches."""
    ny, nx = cells
    left, right, down, up = box
    x0, x1 = math.floor((i << level) + left), math.floor(min((i + 1) << level, nx) + right)
    y0, y1 = math.floor((j << level) + down), math.floor(min((j + 1) << level, ny) + up)
    if x1 - x0 >= nx:
        x0, x1 = 0, nx - 1
    if y1 - y0 >= ny:
        y0, y1 = 0, ny - 1
    highest = np.float32(-np.inf)
    # Copies of the tile that the box touches.
    for row in range(y0 // ny, y1 // ny + 1):
        for column in range(x0 // nx, x1 // nx + 1):
            for n in range(max(y0 - row * ny, 0) >> level, (min(y1 - row * ny, ny - 1) >> level) + 1):
                for m in range(max(x0 - column * nx, 0) >> level, (min(x1 - column * nx, nx - 1) >> level) + 1):
                    highest = max(highest, values[n, m])
    return highest


@kernel
def _steepest(first, last, heights, sides, out):
    """Largest slope toward each sector of the facets of every block.

    Within a sector a facet is steepest at a side of it, unless its gradient lies inside; then it is at most
    1 / cos(π/16) times as steep as at the nearer side.
    """
    ny, nx = heights.shape[0] - 1, heights.shape[1] - 1
    half = SECTORS // 2
    cosines = np.cos(np.arange(half) * (2 * math.pi / SECTORS))
    sines = np.sin(np.arange(half) * (2 * math.pi / SECTORS))
    along = np.empty(SECTORS)
    size = 1 << BLOCK
    for block_j in range(first, last):
        for block_i in range(out.shape[2]):
            along[:] = -np.inf
            for j in range(block_j * size, min((block_j + 1) * size, ny)):
                for i in range(block_i * size, min((block_i + 1) * size, nx)):
                    h00, h10, h01, h11 = heights[j, i], heights[j, i + 1], heights[j + 1, i], heights[j + 1, i + 1]
                    odd = (i + j) & 1
                    p0, p1 = h10 - h00, h11 - h01
                    q0, q1 = (h11 - h10, h01 - h00) if odd else (h01 - h00, h11 - h10)
                    for k in range(half):
                        s0, s1 = p0 * cosines[k] + q0 * sines[k], p1 * cosines[k] + q1 * sines[k]
                        along[k] = max(along[k], max(s0, s1))
                        along[k + half] = max(along[k + half], -min(s0, s1))
            for k in range(SECTORS):
                slope = max(along[sides[k]], along[(sides[k] + 1) % SECTORS])
                out[k, block_j, block_i] = slope / math.cos(math.pi / SECTORS) if slope > 0 else slope


@kernel
def _encode(first, last, slopes, certain, out):
    """The first entry of `certain` that is not below each slope; `certain` grows by equal factors."""
    start, rate = math.log2(certain[0]), 1.0 / math.log2(certain[1] / certain[0])
    for j in range(first, last):
        for i in range(out.shape[1]):
            for k in range(out.shape[2]):
                slope = slopes[k, j, i]
                code = 0
                if slope > certain[0]:
                    code = min(max(int((math.log2(slope) - start) * rate) - 1, 0), certain.size - 1)
                while certain[code] < slope:
                    code += 1
                out[j, i, k] = code
