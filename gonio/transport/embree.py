"""The light paths over any mesh: launch, scatter, cross the seams, escape. Numba kernels around Embree's closest hits.

Every worker keeps a wave of paths in flight. All paths of a wave ask Embree for their next hit at once, one kernel
moves them on, and places that became free are filled with new paths, so that the few long paths never hold up the rest.
Randomness depends on nothing but the path's own number (`philox`), results are integer sums: the bytes that come out do
not depend on threads, on the size of a wave or on the order of anything.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.randomness import kernel, philox
from gonio.tally import UNIT
from gonio.transport.light import LAMBERTIAN, attenuate, cosine_direction, mirrored, unit
from gonio.transport.scene import EmbreeMesh
from gonio.transport.scoring import Arrivals, Scores, balance, integer, score, score_apertures, total_up
from gonio.transport.setup import Setup
from gonio.transport.source import Replicates, incident, start
from gonio.transport.termination import ABSORBED, ESCAPED, IN_FLIGHT, LOST, MAX_CROSSINGS, TRUNCATED

WAVE = 32_768
"""Paths in flight in one worker: large enough to hide the interpreter, small enough for the second-level cache."""

CLIPPED = 1e-3
"""A ray that meets a facet from behind, this close to its edge in barycentric coordinates, has only clipped a ridge by
a rounding error: it goes on. Anywhere else it has come from under the surface and is lost."""


class PathState(NamedTuple):
    """Paths in flight: the first `active` rows of every array."""

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    reach: NDArray[np.float32]
    """How far the next hit may be: to the far side of the seam, or to the top."""
    weights: NDArray[np.float64]
    paths: NDArray[np.int64]
    slots: NDArray[np.int32]
    """Which replicate of the group a path belongs to."""
    hits: NDArray[np.int32]
    crossings: NDArray[np.int32]
    terminations: NDArray[np.int8]
    """What the last event did to a path: still in flight, escaped, truncated or lost."""
    struck: NDArray[np.int64]
    """Scratch: the rows of the paths that have just been reflected, and then their cosines of incidence."""
    cosines: NDArray[np.float64]
    records: NDArray[np.int64]
    """Scratch: the row of every path that has just escaped, and the record of `Scores.bins` that it adds to."""


def trace(
    mesh: EmbreeMesh,
    setup: Setup,
    replicates: range,
    paths: int,
    scores: Scores,
    advanced: Callable[[int, int], bool],
    wave: int,
) -> bool:
    """As `transport.trace`, over a mesh, with `wave` paths in flight."""
    source, optics, bins = setup
    total = len(replicates) * paths
    ringed = bool(bins.sector_edges.size)
    state = _empty_wave(min(wave, total), len(optics.eta))
    group = Replicates.of(replicates, paths, source)
    xs, ys, zs = state.directions.T
    arrivals = Arrivals((xs, ys, zs), state.terminations, state.weights, state.paths, state.slots, state.hits)
    active = launched = 0
    while active or launched < total:
        room = min(len(state.paths) - active, total - launched)
        if room and active <= len(state.paths) // 2:
            _launch(state, active, launched, room, group, source, mesh.tile)
            active, launched = active + room, launched + room
        found = mesh.intersect(state.origins[:active], state.directions[:active], state.reach[:active])
        hits = (found["primID"], found["tfar"], found["u"], found["v"])
        struck = _move(
            state, active, hits, (mesh.normals, mesh.corner_normals), mesh.tile, optics, source, replicates.start
        )
        attenuate(state.struck, struck, state.cosines, optics, state.weights, state.hits, state.terminations)
        if ringed:
            score(active, arrivals, bins, source, group.turns, scores.bins, state.records)
        else:
            score_apertures(active, arrivals, bins, source, group.turns, scores.bins)
        left = _settle(state, active, mesh.tile, scores.energy_budget)
        if not advanced(active - left, active):
            return False
        active = left
    if ringed:
        total_up(scores.bins)
    balance(scores, paths)
    return True


def _empty_wave(size: int, wavelengths: int) -> PathState:
    return PathState(
        np.zeros((size, 3), np.float32),
        np.zeros((size, 3), np.float32),
        np.zeros(size, np.float32),
        np.zeros((size, wavelengths)),
        np.zeros(size, np.int64),
        np.zeros(size, np.int32),
        np.zeros(size, np.int32),
        np.zeros(size, np.int32),
        np.zeros(size, np.int8),
        np.zeros(size, np.int64),
        np.zeros(size),
        np.zeros((size + 1, 2), np.int64),
    )


@kernel
def _launch(state, active, first, count, group, source, tile):
    """Start `count` paths of a group of replicates, from the `first` on, on the plane above the tile.

    A replicate starts one in each of `group.paths` equal cells along a Morton curve; all replicates of the group start
    in a cell before the first goes on to the next.
    """
    origins, directions, weights = state.origins, state.directions, state.weights
    turns = group.turns
    path, slot = divmod(first, turns.size)
    steady = source.source_sin2 == 0 and source.patch[1] == 0 and not source.average
    dx, dy, dz = incident(path, 0, 0.0, source)
    for i in range(active, active + count):
        replicate = group.first + slot
        # The four words of a block serve four replicates.
        if i == active or slot == 0 or replicate % 4 == 0:
            words = philox(path, path >> 32, replicate // 4, 0, source.key[0], source.key[1])
        along_x, along_y = start(path, group.paths, words[replicate % 4])
        x, y = (2 * along_x - 1) * tile.half_x, (2 * along_y - 1) * tile.half_y
        if not steady:
            dx, dy, dz = incident(path, replicate, turns[slot], source)
        origins[i, 0], origins[i, 1], origins[i, 2] = x, y, tile.top
        directions[i, 0], directions[i, 1], directions[i, 2] = dx, dy, dz
        state.reach[i] = _to_edge(x, y, dx, dy, tile.outer_x, tile.outer_y)
        for w in range(weights.shape[1]):
            weights[i, w] = 1.0
        state.paths[i] = path
        state.slots[i] = slot
        state.hits[i] = 0
        state.crossings[i] = 0
        slot += 1
        if slot == turns.size:
            path, slot = path + 1, 0


@kernel
def _to_edge(x, y, dx, dy, half_x, half_y):
    """Distance along a ray to the side at ±half_x or ±half_y that it meets first; inf if it is vertical."""
    distance = np.inf
    if dx != 0:
        distance = (math.copysign(half_x, dx) - x) / dx
    if dy != 0:
        distance = min(distance, (math.copysign(half_y, dy) - y) / dy)
    return distance


@kernel
def _serves(sx, sy, sz, dx, dy, dz, nx, ny, nz):
    """Whether light can be reflected about the exact normal (sx, sy, sz) of a chord with the normal (nx, ny, nz).

    Close to a silhouette it may face away from the ray, or send it through the chord.
    """
    ex, ey, ez = mirrored(dx, dy, dz, sx, sy, sz)
    return dx * sx + dy * sy + dz * sz < 0 and ex * nx + ey * ny + ez * nz > 0


@kernel
def _wrapped(position, half):
    """A coordinate brought back into the tile."""
    if position > half:
        return position - 2 * half
    if position < -half:
        return position + 2 * half
    return position


@kernel
def _pass_on(x, y, z, dx, dy, dz, reach, tile):
    """A ray that meets nothing before the far side of the seam escapes at the top or re-enters opposite.

    Returns its termination and where it goes on.
    """
    if dz > 0 and z + reach * dz >= tile.top:
        return ESCAPED, x, y, z
    side = max(0.0, _to_edge(x, y, dx, dy, tile.half_x, tile.half_y))
    x, y, z = x + side * dx, y + side * dy, z + side * dz
    # The coordinate that has reached its side goes opposite.
    if tile.half_x - abs(x) < tile.half_y - abs(y):
        x, y = -math.copysign(tile.half_x, dx), min(tile.half_y, max(-tile.half_y, y))
    else:
        x, y = min(tile.half_x, max(-tile.half_x, x)), -math.copysign(tile.half_y, dy)
    return (LOST if z < tile.bottom else IN_FLIGHT), x, y, z


@kernel
def _move(state, active, found, facets, tile, optics, source, first_replicate):
    """Move every path past its next event, and note its termination. Returns how many have been reflected."""
    primitives, distances, us, vs = found
    normals, corner_normals = facets
    origins, directions, hits, crossings = state.origins, state.directions, state.hits, state.crossings
    struck = 0
    for i in range(active):
        x, y, z = np.float64(origins[i, 0]), np.float64(origins[i, 1]), np.float64(origins[i, 2])
        dx, dy, dz = np.float64(directions[i, 0]), np.float64(directions[i, 1]), np.float64(directions[i, 2])
        primitive = primitives[i]
        if primitive < 0:
            termination, x, y, z = _pass_on(x, y, z, dx, dy, dz, np.float64(state.reach[i]), tile)
            crossings[i] += 1
        else:
            termination = IN_FLIGHT
            u, v = np.float64(us[i]), np.float64(vs[i])
            nx, ny = np.float64(normals[primitive, 0]), np.float64(normals[primitive, 1])
            nz = np.float64(normals[primitive, 2])
            distance = np.float64(distances[i])
            x = _wrapped(x + distance * dx + tile.offset * nx, tile.half_x)
            y = _wrapped(y + distance * dy + tile.offset * ny, tile.half_y)
            z += distance * dz + tile.offset * nz
            if dx * nx + dy * ny + dz * nz >= 0:
                crossings[i] += 1
                if min(u, v, 1 - u - v) > CLIPPED:
                    termination = LOST
            else:
                hits[i] += 1
                crossings[i] = 0
                if corner_normals.shape[0]:
                    c = corner_normals[primitive]
                    t = 1.0 - u - v
                    sx, sy, sz = unit(
                        t * c[0, 0] + u * c[1, 0] + v * c[2, 0],
                        t * c[0, 1] + u * c[1, 1] + v * c[2, 1],
                        t * c[0, 2] + u * c[1, 2] + v * c[2, 2],
                    )
                    if _serves(sx, sy, sz, dx, dy, dz, nx, ny, nz):
                        nx, ny, nz = sx, sy, sz
                state.struck[struck], state.cosines[struck] = i, min(1.0, -(dx * nx + dy * ny + dz * nz))
                struck += 1
                if optics.kind == LAMBERTIAN:
                    path, replicate = state.paths[i], first_replicate + state.slots[i]
                    r0, r1, _, _ = philox(path, path >> 32, replicate, hits[i], source.key[0], source.key[1])
                    dx, dy, dz = cosine_direction(r0, r1, nx, ny, nz)
                else:
                    dx, dy, dz = mirrored(dx, dy, dz, nx, ny, nz)
                # One Newton step: without it the length would drift over thousands of hits.
                scale = 1.5 - 0.5 * (dx * dx + dy * dy + dz * dz)
                directions[i, 0], directions[i, 1], directions[i, 2] = dx * scale, dy * scale, dz * scale
        origins[i, 0], origins[i, 1], origins[i, 2] = x, y, z
        if termination == IN_FLIGHT:
            horizontal = directions[i, 2] == 0 and z >= tile.top
            if horizontal or crossings[i] >= MAX_CROSSINGS:
                termination = TRUNCATED
        state.terminations[i] = termination
    return struck


@kernel
def _settle(state, active, tile, budget):
    """Account for what has ended and close up the rest at the front. Returns how many are still in flight.

    What a path lost on its way is absorbed; what it still carries when it ends is truncated or lost, or has escaped.
    """
    origins, directions, weights = state.origins, state.directions, state.weights
    left = 0
    for i in range(active):
        termination = state.terminations[i]
        if termination != IN_FLIGHT:
            slot = state.slots[i]
            for w in range(weights.shape[1]):
                carried = integer(weights[i, w])
                budget[slot, ABSORBED, w] += UNIT - carried
                if termination >= 0:
                    budget[slot, termination, w] += carried
            continue
        for axis in range(3):
            origins[left, axis] = origins[i, axis]
            directions[left, axis] = directions[i, axis]
        for w in range(weights.shape[1]):
            weights[left, w] = weights[i, w]
        state.paths[left] = state.paths[i]
        state.slots[left] = state.slots[i]
        state.hits[left] = state.hits[i]
        state.crossings[left] = state.crossings[i]
        x, y = np.float64(origins[left, 0]), np.float64(origins[left, 1])
        dx, dy = np.float64(directions[left, 0]), np.float64(directions[left, 1])
        state.reach[left] = _to_edge(x, y, dx, dy, tile.outer_x, tile.outer_y)
        left += 1
    return left
