"""The light paths over a height field, without a ray tracer: most of them meet no doubt at all, the rest walk.

Everything is done for many paths at once, in short loops whose turns do not depend on each other: the processor then
works on several paths at a time. First hits under parallel light are guessed by Newton's method on the facets and
accepted where it is proven that nothing stands before them; a reflected path has escaped where that is proven (see
`accelerator.Accelerator`). All others go from cell to cell, or from node to node of the quadtree where they pass above
it, and find the very same hits: what is proven changes nothing but the time.

A path in flight is above the surface where it crosses the sides of the cells' triangles; it hits the first facet that
takes it below. There is no offset to restart from and no edge to slip through: the facet that a path leaves cannot be
its next, and nothing is ever lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.randomness import kernel, philox
from gonio.tally import UNIT
from gonio.transport.accelerator import BLOCK, Accelerator, horizon_sector
from gonio.transport.light import LAMBERTIAN, attenuate, cosine_direction, mirrored
from gonio.transport.scoring import Arrivals, Scores, balance, integer, score, score_apertures, total_up
from gonio.transport.setup import Setup
from gonio.transport.source import Replicates, Source, incident, start
from gonio.transport.termination import ABSORBED, ESCAPED, IN_FLIGHT, MAX_CROSSINGS, TRUNCATED

LANES = 464
"""Paths that are worked on at a time: their state stays in the first-level cache, and not a power of two, whose arrays
would compete for the same places in it."""

ROUNDS = 128
"""How often that is done between two looks at the progress."""

BUNDLE, GUESSED_BUNDLE = 8, 32
"""Paths that a bundle should have at least: fewer where its way begins a search than where it begins a guess."""

NEIGHBOURS = 8
"""Paths that are close to each other."""

NEWTON = 3
"""Steps of Newton's method towards a first hit, after as many of a neighbour."""

WORTH = 0.25
"""Share of the blocks that must be certain to see the source for a guess to be worth its time."""

_FAR = 1e300
"""What is never reached."""

_ROW, _COLUMN = 32, (1 << 31) - 1
"""A facet as one number: its row above the 32nd bit, its column, and its triangle in the last bit."""


class PathState(NamedTuple):
    """The paths that are worked on."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    """Where a path was last reflected, or started; in cells of the tile that it is in."""
    z: NDArray[np.float64]
    """Its height there, µm above the middle."""
    dx: NDArray[np.float64]
    dy: NDArray[np.float64]
    dz: NDArray[np.float64]
    """Its direction."""
    way: NDArray[np.float64]
    """How far from there it is known to be free, µm."""
    i: NDArray[np.int64]
    j: NDArray[np.int64]
    """The cell that it is in after that way."""
    triangle: NDArray[np.int64]
    """Which triangle of the cell it leaves, 0 below the diagonal, 1 above; -1 if none."""
    cosines: NDArray[np.float64]
    """Cosines of incidence of the paths in `struck`, in that order."""
    normals: NDArray[np.float64]
    """Normals of the facets where they have been struck, in that order."""
    weights: NDArray[np.float64]
    paths: NDArray[np.int64]
    slots: NDArray[np.int32]
    hits: NDArray[np.int32]
    terminations: NDArray[np.int8]
    active: NDArray[np.int64]
    """Paths that look for their next hit."""
    struck: NDArray[np.int64]
    """Paths that have found it."""
    records: NDArray[np.int64]

    @classmethod
    def of(cls, lanes: int, wavelengths: int) -> PathState:
        """Room for `lanes` paths."""
        x, y, z, dx, dy, dz, way, cosines = (np.zeros(lanes) for _ in range(8))
        i, j, triangle, paths, active, struck = (np.zeros(lanes + 1, np.int64) for _ in range(6))
        slots, hits, terminations = np.zeros(lanes, np.int32), np.zeros(lanes, np.int32), np.zeros(lanes, np.int8)
        normals, weights = np.zeros((lanes, 3)), np.zeros((lanes, wavelengths))
        records = np.zeros((lanes + 1, 2), np.int64)
        return cls(
            x, y, z, dx, dy, dz, way, i, j, triangle, cosines, normals, weights, paths, slots, hits, terminations,
            active, struck, records,
        )  # fmt: skip


class Illumination(NamedTuple):
    """What is known beforehand of the light."""

    parallel: bool
    """Whether all of it has one direction."""
    vertical: bool
    """Whether that is straight down."""
    dx: float
    dy: float
    dz: float
    """Its direction, the nominal one if there are many; cells per µm along x and y."""
    guess: bool
    """Whether so many blocks are certain to see the source that first hits are guessed."""
    level: int
    """Level of the quadtree whose nodes are as wide as a bundle of parallel rays."""


def illumination_of(source: Source, accelerator: Accelerator, paths: int) -> Illumination:
    """What is known beforehand of `source`; `paths` are launched side by side over the tile."""
    nominal = source._replace(source_sin2=0.0, patch=(0.0, 0.0, 0.0), average=False)
    u, v, w = incident(0, 0, 0.0, nominal)
    dx, dy = u / accelerator.spacing[0], v / accelerator.spacing[1]
    guess = accelerator.certainty(-dx, -dy, -w) > WORTH
    ny, nx = accelerator.shape
    bundles = nx * ny / paths * (GUESSED_BUNDLE if guess else BUNDLE)
    level = min(max(1, math.ceil(math.log2(max(1.0, bundles)) / 2)), len(accelerator.widths) - 1)
    vertical = source.source_sin2 == 0 and source.patch[1] == 0 and source.theta == 0
    return Illumination(vertical or source == nominal, vertical, dx, dy, w, guess, level)


def trace(
    accelerator: Accelerator,
    setup: Setup,
    replicates: range,
    paths: int,
    scores: Scores,
    advanced: Callable[[int, int], bool],
    lanes: int = LANES,
) -> bool:
    """As `transport.trace`, over a height field."""
    slots = len(replicates)
    illumination = illumination_of(setup.source, accelerator, slots * paths)
    at_once = max(1, min(lanes // slots, paths))
    state = PathState.of(at_once * slots, len(setup.optics.eta))
    group = Replicates.of(replicates, paths, setup.source)
    for first in range(0, paths, ROUNDS * at_once):
        last = min(paths, first + ROUNDS * at_once)
        rays = _advance(state, accelerator, setup, illumination, group, first, last, scores)
        if not advanced((last - first) * slots, rays):
            return False
    if setup.bins.sector_edges.size:
        total_up(scores.bins)
    balance(scores, paths)
    return True


@kernel
def _advance(state, accelerator, setup, illumination, group, first, last, scores):
    """Follow the paths from `first` to `last` of all replicates to their ends. Returns how many rays they are."""
    source, optics, bins = setup
    turns = group.turns
    at_once = state.x.size // turns.size
    # The bundle that the last path belonged to, level by level: its node, and how far it is free.
    nodes, ways = np.full(accelerator.widths.size, -1), np.zeros(accelerator.widths.size)
    arrivals = Arrivals(
        (state.dx, state.dy, state.dz), state.terminations, state.weights, state.paths, state.slots, state.hits
    )
    rays = 0
    while first < last:
        some = min(at_once, last - first)
        count = some * turns.size
        _launch(state, first, some, group, source, illumination, accelerator)
        struck, searching = 0, count
        if illumination.vertical:
            struck, searching = _drop(state, count, accelerator), 0
        else:
            if illumination.parallel:
                _approach(state, count, illumination, accelerator, nodes, ways)
            _enter(state, count, accelerator)
            if illumination.guess:
                struck, searching = _guess(state, count, accelerator)
        near = illumination.parallel
        rays += count
        while searching + struck:
            struck = _walk(state, searching, struck, accelerator, near)
            rays += struck
            _normals(state, struck, accelerator)
            if optics.kind == LAMBERTIAN:
                _diffuse(state, struck, group.first, source)
            else:
                _mirror(state, struck)
            spent = attenuate(
                state.struck, struck, state.cosines, optics, state.weights, state.hits, state.terminations
            )
            searching = _search(state, struck, accelerator, spent)
            struck, near = 0, True
        if bins.sector_edges.size:
            score(count, arrivals, bins, source, turns, scores.bins, state.records)
        else:
            score_apertures(count, arrivals, bins, source, turns, scores.bins)
        _account_for(state, count, scores.energy_budget)
        first += some
    return rays


@kernel
def _launch(state, first, some, group, source, illumination, accelerator):
    """Start `some` paths from `first` on in all replicates, on the plane that touches the highest point."""
    turns = group.turns
    ny, nx = accelerator.heights.shape[0] - 1, accelerator.heights.shape[1] - 1
    x, y, dx, dy, dz = state.x, state.y, state.dx, state.dy, state.dz
    numbers, slots = state.paths, state.slots
    u, v, w = incident(first, 0, 0.0, source)
    n = 0
    for path in range(first, first + some):
        for slot in range(turns.size):
            replicate = group.first + slot
            # The four words of a block serve four replicates.
            if slot == 0 or replicate % 4 == 0:
                words = philox(path, path >> 32, replicate // 4, 0, source.key[0], source.key[1])
            along_x, along_y = start(path, group.paths, words[replicate % 4])
            x[n], y[n] = along_x * nx, along_y * ny
            if not illumination.parallel:
                u, v, w = incident(path, replicate, turns[slot], source)
            dx[n], dy[n], dz[n] = u, v, w
            numbers[n], slots[n] = path, slot
            n += 1
    state.z[:n] = accelerator.top
    state.way[:n] = 0.0
    state.triangle[:n] = -1
    state.hits[:n] = 0
    state.terminations[:n] = IN_FLIGHT
    state.weights[:n] = 1.0


@kernel
def _triangle_at(x, y, odd):
    """Which triangle of a cell lies under (x, y), both in 0 to 1: above its diagonal or below.

    The diagonal runs from (1, 0) to (0, 1), in odd cells from (0, 0) to (1, 1).
    """
    return np.int64((y - x if odd else y + x - 1.0) > 0)


@kernel
def _facet(triangle, odd, h00, h10, h01, h11):
    """A triangle of a cell from the heights of its corners, the first index for x.

    Returns its slopes along x and y, µm per cell, and its height at (0, 0), or at (1, 1) for the upper one.
    """
    p = h11 - h01 if triangle else h10 - h00
    q = h11 - h10 if triangle != odd else h01 - h00
    return p, q, h11 if triangle else h00


@kernel
def _drop(state, count, accelerator):
    """Vertical light hits what lies under it."""
    heights, x, y, z = accelerator.heights, state.x, state.y, state.z
    columns, rows, triangles, struck = state.i, state.j, state.triangle, state.struck
    for n in range(count):
        i, j = np.int64(x[n]), np.int64(y[n])
        u, v = x[n] - i, y[n] - j
        odd = (i + j) & 1
        triangle = _triangle_at(u, v, odd)
        row, column, above, beside = np.uint64(j), np.uint64(i), np.uint64(j + 1), np.uint64(i + 1)
        h00, h10 = heights[row, column], heights[row, beside]
        h01, h11 = heights[above, column], heights[above, beside]
        p, q, corner = _facet(triangle, odd, h00, h10, h01, h11)
        z[n] = corner + p * (u - triangle) + q * (v - triangle)
        columns[n], rows[n], triangles[n], struck[n] = i, j, triangle, n
    return count


@kernel
def _approach(state, count, illumination, accelerator, nodes, ways):
    """How far the bundle is free that each path belongs to."""
    ny, nx = accelerator.heights.shape[0] - 1, accelerator.heights.shape[1] - 1
    max_mipmap, offsets, widths = accelerator.dilated_mipmap, accelerator.offsets, accelerator.widths
    x, y, way = state.x, state.y, state.way
    finest, coarsest = illumination.level, min(illumination.level + 2, widths.size - 1)
    for n in range(count):
        i, j = np.int64(x[n]), np.int64(y[n])
        if (j >> finest) * widths[finest] + (i >> finest) != nodes[finest]:
            free = 0.0
            for level in range(coarsest, finest - 1, -1):
                node = (j >> level) * widths[level] + (i >> level)
                if node != nodes[level]:
                    half = np.int64(1) << (level - 1)
                    ways[level] = _free_way(
                        float(((i >> level) << level) + half), float(((j >> level) << level) + half), accelerator.top,
                        illumination.dx, illumination.dy, illumination.dz, free, level, nx, ny,
                        max_mipmap[offsets[level] - offsets[1] : offsets[level + 1] - offsets[1]], widths[level],
                    )  # fmt: skip
                    nodes[level] = node
                free = ways[level]
        way[n] = ways[finest]


@kernel
def _free_way(x, y, z, dx, dy, dz, way, level, nx, ny, max_mipmap, width):
    """How far a ray, free up to `way`, goes on before it is no higher than the node of a level that it is in."""
    shift_x, shift_y = math.floor((x + dx * way) / nx) * nx, math.floor((y + dy * way) / ny) * ny
    x, y = x - shift_x, y - shift_y
    i, j = min(np.int64(x + dx * way), nx - 1), min(np.int64(y + dy * way), ny - 1)
    inverse_x, inverse_y = 1.0 / dx if dx != 0 else _FAR, 1.0 / dy if dy != 0 else _FAR
    right, up = np.int64(inverse_x > 0), np.int64(inverse_y > 0)
    while True:
        node_i, node_j = i >> level, j >> level
        edge_x, edge_y = min((node_i + right) << level, nx), min((node_j + up) << level, ny)
        to_x, to_y = (edge_x - x) * inverse_x, (edge_y - y) * inverse_y
        end = min(to_x, to_y)
        top = max_mipmap[node_j * width + node_i]
        if z + dz * end <= top:
            return max(way, min(end, (top - z) / dz))
        way = end
        if to_x < to_y:
            i, j = edge_x - 1 + right, _within(y + dy * way, node_j, level, ny)
        else:
            i, j = _within(x + dx * way, node_i, level, nx), edge_y - 1 + up
        over_x, over_y = _beyond(i, nx), _beyond(j, ny)
        i, x = i - over_x * nx, x - over_x * nx
        j, y = j - over_y * ny, y - over_y * ny


@kernel
def _within(x, node, level, n):
    """The cell of a coordinate that lies, but for rounding, in a node; the last node of `n` cells may be narrower."""
    return min(max(np.int64(x), node << level), min((node + 1) << level, n) - 1)


@kernel
def _beyond(i, n):
    """1 or -1 for a cell that lies beyond the tile's far or near side, else 0."""
    return np.int64(i >= n) - np.int64(i < 0)


@kernel
def _enter(state, count, accelerator):
    """Bring every path into the tile and the cell where it ceases to be free."""
    ny, nx = accelerator.heights.shape[0] - 1, accelerator.heights.shape[1] - 1
    per_x, per_y = 1.0 / accelerator.spacing[0], 1.0 / accelerator.spacing[1]
    x, y, dx, dy, way = state.x, state.y, state.dx, state.dy, state.way
    columns, rows, active = state.i, state.j, state.active
    for n in range(count):
        u, v = x[n] + dx[n] * per_x * way[n], y[n] + dy[n] * per_y * way[n]
        shift_x, shift_y = math.floor(u / nx) * nx, math.floor(v / ny) * ny
        x[n], y[n] = x[n] - shift_x, y[n] - shift_y
        columns[n], rows[n] = min(np.int64(u - shift_x), nx - 1), min(np.int64(v - shift_y), ny - 1)
        active[n] = n


@kernel
def _certain(dx, dy, dz, horizon_slope2):
    """Whether light in a direction, per cell, is certain to escape where the table says so for its sector."""
    return (dz > 0) & (dz * dz > horizon_slope2 * (dx * dx + dy * dy))


@kernel
def _guess(state, count, accelerator):
    """Find first hits by Newton's method. Returns how many are proven, and how many have to be searched for.

    What the source is certain to see is the first that its light meets. Neighbours hit close to each other: what the
    first of them has found the others begin with.
    """
    x, y, z, way, triangle, columns, rows = state.x, state.y, state.z, state.way, state.triangle, state.i, state.j
    dx, dy, dz, active, struck = state.dx, state.dy, state.dz, state.active, state.struck
    horizon_code, horizon_slope2, top = accelerator.horizon_code, accelerator.horizon_slope2, accelerator.top
    per_x, per_y = 1.0 / accelerator.spacing[0], 1.0 / accelerator.spacing[1]
    # Scratch: the way to the next guess, and on which facets the last two lay.
    ways, facets = state.cosines, state.records
    for n in range(count):
        ways[n] = way[n]
        facets[n, 0] = -1
    for _ in range(NEWTON):
        _improve(state, count, NEIGHBOURS, accelerator)
    for n in range(count):
        ways[n] = ways[n - n % NEIGHBOURS]
    for _ in range(NEWTON):
        _improve(state, count, 1, accelerator)
    proven = searched = 0
    for n in range(count):
        facet = max(facets[n, 0], 0)
        s, i, j = facet & 1, facet >> 1 & _COLUMN, facet >> _ROW
        u, v, w = dx[n] * per_x, dy[n] * per_y, dz[n]
        code = horizon_code[np.uint64(j >> BLOCK), np.uint64(i >> BLOCK), np.uint64(horizon_sector(-u, -v))]
        seen = _certain(-u, -v, -w, horizon_slope2[code])
        ok = (facets[n, 0] >= 0) & (facet == facets[n, 1]) & seen & (ways[n] >= 0)
        active[searched] = n
        searched += not ok
        struck[proven] = n
        proven += ok
        if ok:
            columns[n], rows[n], triangle[n] = i, j, s
            x[n], y[n], z[n] = x[n] + u * ways[n], y[n] + v * ways[n], top + w * ways[n]
    return proven, searched


@kernel
def _improve(state, count, step, accelerator):
    """One step of Newton's method for every `step`-th path: meet the plane of the facet that lies under the guess."""
    x, y, dx, dy, dz, ways, facets = (
        state.x, state.y, state.dx, state.dy, state.dz, state.cosines, state.records,
    )  # fmt: skip
    heights, top = accelerator.heights, accelerator.top
    per_x, per_y = 1.0 / accelerator.spacing[0], 1.0 / accelerator.spacing[1]
    ny, nx = heights.shape[0] - 1, heights.shape[1] - 1
    for n in range(0, count, step):
        along_x, along_y = dx[n] * per_x, dy[n] * per_y
        u, v = x[n] + along_x * ways[n], y[n] + along_y * ways[n]
        i, j = min(max(np.int64(u), 0), nx - 1), min(max(np.int64(v), 0), ny - 1)
        odd = (i + j) & 1
        s = _triangle_at(u - i, v - j, odd)
        row, column, above, beside = np.uint64(j), np.uint64(i), np.uint64(j + 1), np.uint64(i + 1)
        h00, h10 = heights[row, column], heights[row, beside]
        h01, h11 = heights[above, column], heights[above, beside]
        p, q, corner = _facet(s, odd, h00, h10, h01, h11)
        base = corner + p * (x[n] - i - s) + q * (y[n] - j - s)
        ways[n] = (base - top) / (dz[n] - p * along_x - q * along_y)
        inside = (u >= 0) & (u < nx) & (v >= 0) & (v < ny)
        facets[n, 1] = facets[n, 0]
        facets[n, 0] = j << _ROW | i << 1 | s if inside else -1


@kernel
def _walk(state, count, struck, accelerator, near):
    """Find the next hit of every active path; returns how many are now in `struck`. The others have ended.

    `near` says that they start close to the surface, and so from cell to cell.
    """
    heights, max_mipmap, offsets, widths, top = (
        accelerator.heights,
        accelerator.max_mipmap,
        accelerator.offsets,
        accelerator.widths,
        accelerator.top,
    )
    ny, nx = heights.shape[0] - 1, heights.shape[1] - 1
    xs, ys, zs, ways, columns, rows, triangles = (
        state.x, state.y, state.z, state.way, state.i, state.j, state.triangle,
    )  # fmt: skip
    along_x, along_y, along_z, active, found, terminations = (
        state.dx, state.dy, state.dz, state.active, state.struck, state.terminations,
    )  # fmt: skip
    coarsest = widths.size - 1
    per_x, per_y = 1.0 / accelerator.spacing[0], 1.0 / accelerator.spacing[1]
    for k in range(count):
        n = np.uint64(active[k])
        x, y, z, way = xs[n], ys[n], zs[n], ways[n]
        dx, dy, dz = along_x[n] * per_x, along_y[n] * per_y, along_z[n]
        i, j, own = columns[n], rows[n], triangles[n]
        inverse_x, inverse_y = 1.0 / dx if dx != 0 else _FAR, 1.0 / dy if dy != 0 else _FAR
        right, up = np.int64(inverse_x > 0), np.int64(inverse_y > 0)
        rises = dz >= 0
        termination = ESCAPED if rises and z > top else IN_FLIGHT
        level, cell_by_cell, crossings = np.int64(BLOCK), near, 0
        while termination == IN_FLIGHT:
            node_i, node_j = i >> level, j >> level
            if cell_by_cell:
                # Through the cells of a block.
                first_i, last_i = node_i << BLOCK, min((node_i + 1) << BLOCK, nx) - 1
                first_j, last_j = node_j << BLOCK, min((node_j + 1) << BLOCK, ny) - 1
                triangle = np.int64(-1)
                while (i >= first_i) & (i <= last_i) & (j >= first_j) & (j <= last_j):
                    to_x, to_y = (i + right - x) * inverse_x, (j + up - y) * inverse_y
                    end = min(to_x, to_y)
                    if z + dz * (way if rises else end) <= max_mipmap[np.uint64(j * nx + i)]:
                        row, column = np.uint64(j), np.uint64(i)
                        above, beside = np.uint64(j + 1), np.uint64(i + 1)
                        triangle, hit = _meet(
                            x - i, y - j, z, dx, dy, dz, (i + j) & 1, own, way, to_x, to_y, right, up,
                            heights[row, column], heights[row, beside], heights[above, column], heights[above, beside],
                        )  # fmt: skip
                        if triangle >= 0:
                            way = hit
                            break
                    way, own = end, np.int64(-1)
                    if to_x < to_y:
                        i += 2 * right - 1
                    else:
                        j += 2 * up - 1
                if triangle >= 0:
                    xs[n], ys[n], zs[n] = x + dx * way, y + dy * way, z + dz * way
                    columns[n], rows[n], triangles[n] = i, j, triangle
                    found[struck] = n
                    struck += 1
                    break
                cell_by_cell = False
            else:
                edge_x, edge_y = min((node_i + right) << level, nx), min((node_j + up) << level, ny)
                to_x, to_y = (edge_x - x) * inverse_x, (edge_y - y) * inverse_y
                end = min(to_x, to_y)
                if (
                    z + dz * (way if rises else end)
                    <= max_mipmap[np.uint64(offsets[level] + node_j * widths[level] + node_i)]
                ):
                    cell_by_cell = level == BLOCK
                    level -= not cell_by_cell
                    continue
                # Above the node.
                way, own = end, np.int64(-1)
                if to_x < to_y:
                    i, j = edge_x - 1 + right, _within(y + dy * way, node_j, level, ny)
                else:
                    i, j = _within(x + dx * way, node_i, level, nx), edge_y - 1 + up
            if rises and z + dz * way > top:
                termination = ESCAPED
            if level < coarsest and ((i >> (level + 1) != node_i >> 1) | (j >> (level + 1) != node_j >> 1)):
                level += 1
            over_x, over_y = _beyond(i, nx), _beyond(j, ny)
            if over_x | over_y:
                i, x = i - over_x * nx, x - over_x * nx
                j, y = j - over_y * ny, y - over_y * ny
                crossings += 1
                if crossings >= MAX_CROSSINGS and termination == IN_FLIGHT:
                    termination = TRUNCATED
        terminations[n] = termination
    return struck


@kernel
def _meet(x, y, z, dx, dy, dz, odd, own, way, to_x, to_y, right, up, h00, h10, h01, h11):
    """Where a ray that enters a cell after `way` meets it: (triangle, way), the triangle -1 if it does not.

    The cell is [0, 1]², (x, y, z) where the ray begins. A facet is met if the ray is below it where it leaves it,
    across the diagonal or across an edge, unless it began on that facet, `own`.
    """
    end = min(to_x, to_y)
    if to_x < to_y:
        low, high, place = h10 if right else h00, h11 if right else h01, y + dy * end
    else:
        low, high, place = h01 if up else h00, h11 if up else h10, x + dx * end
    below_edge = z + dz * end < low + (high - low) * place
    # The diagonal: above it lies what is to be positive.
    beyond = y - x if odd else y + x - 1.0
    rate = dy - dx if odd else dy + dx
    entered, left = np.int64(beyond + rate * way > 0), np.int64(beyond + rate * end > 0)
    crossing = -beyond / rate
    low, high = h00 if odd else h10, h11 if odd else h01
    below_diagonal = z + dz * crossing < low + (high - low) * (y + dy * crossing)
    first = (entered != left) & below_diagonal & (entered != own)
    if first or (below_edge and left != own):
        triangle = entered if first else left
        p, q, corner = _facet(triangle, odd, h00, h10, h01, h11)
        rate = dz - p * dx - q * dy
        if rate < 0:
            base = corner + p * (x - triangle) + q * (y - triangle)
            return triangle, min(max((base - z) / rate, way), end)
    return np.int64(-1), end


@kernel
def _normals(state, count, accelerator):
    """Put the normals of the facets that have been struck where the struck paths are listed."""
    per_x, per_y = 1.0 / accelerator.spacing[0], 1.0 / accelerator.spacing[1]
    heights, rows, columns, triangles, struck, normals = (
        accelerator.heights, state.j, state.i, state.triangle, state.struck, state.normals,
    )  # fmt: skip
    for k in range(count):
        n = np.uint64(struck[k])
        i, j = columns[n], rows[n]
        row, column, above, beside = np.uint64(j), np.uint64(i), np.uint64(j + 1), np.uint64(i + 1)
        h00, h10 = heights[row, column], heights[row, beside]
        h01, h11 = heights[above, column], heights[above, beside]
        p, q, _ = _facet(triangles[n], (i + j) & 1, h00, h10, h01, h11)
        p, q = p * per_x, q * per_y
        scale = 1.0 / math.sqrt(1.0 + p * p + q * q)
        normals[k, 0], normals[k, 1], normals[k, 2] = -p * scale, -q * scale, scale


@kernel
def _mirror(state, count):
    """Reflect the paths that have been struck."""
    xs, ys, zs, struck, normals, cosines, hits = (
        state.dx, state.dy, state.dz, state.struck, state.normals, state.cosines, state.hits,
    )  # fmt: skip
    for k in range(count):
        n = np.uint64(struck[k])
        nx, ny, nz = normals[k, 0], normals[k, 1], normals[k, 2]
        dx, dy, dz = xs[n], ys[n], zs[n]
        cosines[k] = min(1.0, -(dx * nx + dy * ny + dz * nz))
        dx, dy, dz = mirrored(dx, dy, dz, nx, ny, nz)
        # One Newton step: without it the length would drift over thousands of hits.
        scale = 1.5 - 0.5 * (dx * dx + dy * dy + dz * dz)
        xs[n], ys[n], zs[n] = dx * scale, dy * scale, dz * scale
        hits[n] += 1


@kernel
def _diffuse(state, count, first_replicate, source):
    """Send the paths that have been struck off in a direction of their own."""
    xs, ys, zs, struck, normals = state.dx, state.dy, state.dz, state.struck, state.normals
    paths, slots, hits = state.paths, state.slots, state.hits
    for k in range(count):
        n = np.uint64(struck[k])
        hits[n] += 1
        path, replicate = paths[n], first_replicate + slots[n]
        r0, r1, _, _ = philox(path, path >> 32, replicate, hits[n], source.key[0], source.key[1])
        xs[n], ys[n], zs[n] = cosine_direction(r0, r1, normals[k, 0], normals[k, 1], normals[k, 2])


@kernel
def _search(state, count, accelerator, spent):
    """Sort out who is certain to escape; returns how many of the struck have to be followed on."""
    per_x, per_y = 1.0 / accelerator.spacing[0], 1.0 / accelerator.spacing[1]
    horizon_code, horizon_slope2 = accelerator.horizon_code, accelerator.horizon_slope2
    xs, ys, zs, columns, rows, way = state.dx, state.dy, state.dz, state.i, state.j, state.way
    struck, active, terminations = state.struck, state.active, state.terminations
    searching = 0
    for k in range(count):
        n = np.uint64(struck[k])
        dx, dy, dz = xs[n] * per_x, ys[n] * per_y, zs[n]
        code = horizon_code[
            np.uint64(rows[n] >> BLOCK), np.uint64(columns[n] >> BLOCK), np.uint64(horizon_sector(dx, dy))
        ]
        escapes = _certain(dx, dy, dz, horizon_slope2[code])
        way[n] = 0.0
        terminations[n] = ESCAPED if escapes & (terminations[n] == IN_FLIGHT) else terminations[n]
        active[searching] = n
        searching += not escapes
    if spent:
        count, searching = searching, 0
        for k in range(count):
            n = active[k]
            active[searching] = n
            searching += terminations[n] == IN_FLIGHT
    return searching


@kernel
def _account_for(state, count, budget):
    """What a path lost on its way is absorbed; what it still carries when it ends has escaped or is truncated."""
    weights, slots, terminations = state.weights, state.slots, state.terminations
    for n in range(count):
        slot, termination = slots[n], terminations[n]
        for w in range(weights.shape[1]):
            carried = integer(weights[n, w])
            budget[slot, ABSORBED, w] += UNIT - carried
            if termination >= 0:
                budget[slot, termination, w] += carried
