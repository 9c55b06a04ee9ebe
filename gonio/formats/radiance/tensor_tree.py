"""Tensor trees: BRDFs over a square of exiting directions and a line or a square of incident ones, as fine as needed.

Exiting directions are the unit square by Shirley and Chiu's map from the disc of (x, y), which keeps areas: equal
squares have equal projected solid angles. In rank 4 the incident direction is another such square, of `-wi`, the
direction that the light travels to. In rank 3, for isotropic BRDFs, it is the number (1 - sin theta_i) / 2 (a tree's
upper half is not used), and azimuths of exiting light are counted from the one that the light travels to.

A node of the tree is either a grid of 2^(rank k) values, the first dimension slowest, or 2^rank nodes for the halves,
dimension d giving bit d of their number. A value holds for the whole of its cell.

P. Shirley, K. Chiu, "A Low Distortion Map Between Disk and Square", Journal of Graphics Tools 2(3), 45-52 (1997),
doi:10.1080/10867651.1997.10487479; G. Ward, M. Kurt, N. Bonneel, "Reducing Anisotropic BSDF Measurement to Common
Practice", Eurographics Workshop on Material Appearance Modeling (2014), doi:10.2312/mam.20141292.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.brdf import BRDF
from gonio.formats.radiance.klems import mean_of_known
from gonio.formats.text import numbers
from gonio.sphere import angles, rotate_z
from microsurfaces.arrays import Floats, Vectors

RESOLUTION = {3: 6, 4: 5}
"""Of the grids that are written, by rank: 2 to this power cells in every dimension."""

_NODES = {
    # Every other corner of the 2 x 2 x 2 rule: exact for quadratic functions.
    3: np.array([[1, 1, 1], [3, 3, 1], [3, 1, 3], [1, 3, 3]]) / 4,
    # Exchanging the directions, and with it their signs, leads from one to the other: what is reciprocal stays so.
    4: np.array([[1, 1, 3, 3], [3, 3, 1, 1]]) / 4,
}
"""Places in a cell, as shares of its width, (nodes, rank)."""

_MOST_NODES = 4_000_000
"""Of a tree that is read; a grid, however large, is one."""

_DEEPEST = 16
"""Levels of a tree: Radiance's own cells are never smaller than 2^-16."""


def square(x: Floats, y: Floats) -> Floats:
    """Places (..., 2) in the unit square of points of the unit disc."""
    r, phi = np.hypot(x, y), np.arctan2(y, x)
    quadrant = np.floor(phi / (np.pi / 2) + 0.5)
    across = r * (phi - quadrant * (np.pi / 2)) / (np.pi / 4)
    # The quadrant around +x, turned by right angles.
    turns = [(r, across), (-across, r), (-r, -across), (across, -r)]
    a, b = (np.choose(quadrant.astype(int) % 4, coordinate) for coordinate in zip(*turns, strict=True))
    return np.stack([(a + 1) / 2, (b + 1) / 2], axis=-1)


def exiting(place: Floats) -> Vectors:
    """Directions (..., 3) above the horizon of places (..., 2) in the unit square."""
    a, b = np.moveaxis(2 * place - 1, -1, 0)
    wide = np.abs(a) >= np.abs(b)
    r = np.where(wide, a, b)
    ratio = np.where(wide, b, a) / np.where(r == 0, 1.0, r)
    phi = np.where(wide, ratio, 2 - ratio) * (np.pi / 4)
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(np.maximum(1 - r**2, 0.0))], axis=-1)


def grid(brdf: BRDF, rank: int) -> Floats:
    """Averages over the cells with the weight cosθ dω on either side, (cells, ..., channels); NaN where unknown."""
    cells, nodes = 2 ** RESOLUTION[rank], _NODES[rank]
    wo = exiting(_places(cells, nodes[:, -2:]))
    wi = exiting(_places(cells, nodes[:, :2])) * (-1, -1, 1) if rank == 4 else _in_plane(cells, nodes[:, 0])
    result = np.zeros((*[cells] * rank, len(brdf.wavelengths)))
    # The half of rank 3 that is not used stays 0.
    for light, out in zip(wi, result.reshape(-1, len(wo), len(brdf.wavelengths)), strict=False):
        values = brdf.evaluate(np.broadcast_to(light, wo.shape).reshape(-1, 3), wo.reshape(-1, 3))
        out[:] = mean_of_known(values.reshape(*wo.shape[:2], -1))
    return result


def _places(cells: int, nodes: Floats) -> Floats:
    """Places (cells², nodes, 2) in the unit square: `nodes` (nodes, 2) of every cell."""
    corner = np.stack(np.divmod(np.arange(cells**2), cells), axis=-1)
    return np.asarray((corner[:, None] + nodes) / cells)


def _in_plane(cells: int, nodes: Floats) -> Vectors:
    """Directions to the light (cells / 2, nodes, 3) in the used half of rank 3; it travels to azimuth 0."""
    sin = 1 - 2 * (np.arange(cells // 2)[:, None] + nodes) / cells
    return np.stack([-sin, np.zeros_like(sin), np.sqrt(1 - sin**2)], axis=-1)


@dataclass(frozen=True, eq=False)
class Tree:
    """A tensor tree of one number; nodes are numbered as they come in the file."""

    rank: int
    """Dimensions: 3 or 4."""
    power: NDArray[np.int64]
    """Of every node: its grid has 2 to this power cells in every dimension; -1 for one that holds nodes."""
    first: NDArray[np.int64]
    """Of every node: where its nodes begin in `nodes`, or its cells in `values`."""
    nodes: NDArray[np.int64]
    """Numbers of the nodes of all nodes that hold nodes."""
    values: Floats
    """Of the cells of all grids."""

    def __call__(self, place: Floats) -> Floats:
        """Values (n,) at places (n, rank) of the unit hypercube."""
        place, node = np.array(place), np.zeros(len(place), np.int64)
        while (deeper := np.flatnonzero(self.power[node] < 0)).size:
            place[deeper] *= 2
            upper = place[deeper] >= 1
            place[deeper] -= upper
            node[deeper] = self.nodes[self.first[node[deeper]] + upper @ (1 << np.arange(self.rank))]
        cells = 2 ** self.power[node]
        at = np.zeros(len(place), np.int64)
        for coordinate in place.T:
            at = at * cells + np.clip((coordinate * cells).astype(np.int64), 0, cells - 1)
        return np.asarray(self.values[self.first[node] + at])


def place(rank: int, wi: Vectors, wo: Vectors) -> Floats:
    """Places (n, rank) in the unit hypercube of pairs of directions (n, 3)."""
    if rank == 4:
        return np.concatenate([square(-wi[:, 0], -wi[:, 1]), square(wo[:, 0], wo[:, 1])], axis=-1)
    turned = rotate_z(wo, 180 - angles(wi)[1])
    # The normal itself must fall into the lower half.
    incident = (0.5 - 1e-6) - 0.5 * np.hypot(wi[:, 0], wi[:, 1])
    return np.concatenate([incident[:, None], square(turned[:, 0], turned[:, 1])], axis=-1)


def parse(text: str, rank: int) -> Tree:
    """The tree that `text` spells. Raises ValueError in a few words if it is none."""
    if text.count("{") > _MOST_NODES:
        raise ValueError(f"its tree has more than {_MOST_NODES} nodes; prune it with rttree_reduce")
    letters = np.frombuffer(text.encode(), np.uint8)
    braces = np.flatnonzero((letters == ord("{")) | (letters == ord("}")))
    opens = letters[braces] == ord("{")
    depth = np.cumsum(np.where(opens, 1, -1))
    if not depth.size or depth[-1] != 0 or depth[:-1].min() < 1 or depth.max() > _DEEPEST:
        raise ValueError("the braces do not make a tree")
    values = numbers(text.translate({ord("{"): " ", ord("}"): " "}))
    before = np.searchsorted(_beginnings(letters), np.append(braces, len(letters)))
    count = np.diff(before)
    leaf = opens & ~np.append(opens[1:], False)
    if before[0] or count[~leaf].any() or before[-1] != len(values):
        raise ValueError("there are numbers outside the grids")
    depth, leaf, count = depth[opens], leaf[opens], count[opens]
    power = np.where(leaf, np.round(np.log2(np.maximum(count, 1)) / rank).astype(np.int64), -1)
    if (count[leaf] != 1 << rank * power[leaf]).any():
        raise ValueError(f"a grid has not 2^({rank} k) values")
    first, nodes = _hung(depth, leaf, rank)
    first[leaf] = np.cumsum(count[leaf]) - count[leaf]
    return Tree(rank, power, first, nodes, np.maximum(values, 0.0))


def _beginnings(letters: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Where words begin."""
    table = np.zeros(256, np.bool_)
    table[list(b" \t\r\n\v\f,{}")] = True
    between = table[letters]
    return np.flatnonzero(~between & np.append(True, between[:-1]))


def _hung(depth: NDArray[np.int64], leaf: NDArray[np.bool_], rank: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """`Tree.first` (of nodes that hold nodes) and `Tree.nodes` of nodes in the order of the file."""
    first, nodes, size = np.zeros(len(depth), np.int64), [np.empty(0, np.int64)], 0
    for level in range(1, int(depth.max())):
        parents, children = np.flatnonzero((depth == level) & ~leaf), np.flatnonzero(depth == level + 1)
        parent = np.searchsorted(parents, children) - 1
        if not np.array_equal(parent, np.repeat(np.arange(len(parents)), 2**rank)):
            raise ValueError(f"a node has not {2**rank} branches")
        first[parents] = size + np.arange(len(parents)) * 2**rank
        nodes.append(children)
        size += len(children)
    return first, np.concatenate(nodes)
