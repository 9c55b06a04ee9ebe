"""The light paths: launch, scatter, cross the seams, escape, bin. Numba kernels around Embree's closest hits.

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
from numba import uint64
from numpy.typing import NDArray

from gonio.detectors import Apertures, Detector, HemisphereGrid
from gonio.optics import Lambertian, Material, Mirror, fresnel
from gonio.randomness import WORD, kernel, philox, uniform
from gonio.scene import Scene
from gonio.tally import UNIT

WAVE = 32_768
"""Paths in flight in one worker: large enough to hide the interpreter, small enough for the second-level cache."""

MAX_HITS = 10_000
"""Light trapped in a cusp between lossless cylinders needs more than 1,000."""

MAX_CROSSINGS = 10_000
"""Tiles that a path may cross between two hits."""

NEGLIGIBLE = 1e-9
"""A path whose largest weight is below this stops; what it carried is in the ledger as truncated."""

CLIPPED = 1e-3
"""A ray that meets a facet from behind, this close to its edge in barycentric coordinates, has only clipped a ridge by
a rounding error: it goes on. Anywhere else it has come from under the surface and is lost."""

RING_STEPS = 4096
"""Steps of sin² that the ring of a direction is looked up by."""

ABSORBED, TRUNCATED, LOST = 0, 1, 2
"""Rows of the ledger: where light goes that does not escape."""

_MIRROR, _FRESNEL, _LAMBERTIAN = 0, 1, 2
_IN_FLIGHT, _ESCAPED = -2, -1
_GOLDEN = (math.sqrt(5) - 1) / 2


class Lamp(NamedTuple):
    """The light of one incidence as the kernels need it."""

    theta: float
    phi: float
    """Nominal direction to the lamp, radians."""
    beam: float
    """sin² of the half angle of the source cone; 0 for a collimated beam."""
    average: bool
    """Whether every path turns the surface by its own angle."""
    key: tuple[int, int]
    """Two 32-bit words that set this incidence's random numbers apart."""


class Matter(NamedTuple):
    """The material as the kernels need it, one entry a wavelength."""

    kind: int
    eta: NDArray[np.float64]
    k: NDArray[np.float64]
    reflectance: NDArray[np.float64]


class Bins(NamedTuple):
    """The detector as the kernels need it."""

    size: int
    """How many bins."""
    sin2_edges: NDArray[np.float64]
    """sin² of the upper ring edges of a grid, inf for the last; empty for apertures."""
    rings: NDArray[np.int64]
    """The ring in which each of many equal steps of sin² begins."""
    sectors: int
    turn: float
    """Azimuth of the traced frame that the bins count from, in turns: the lamp's for a grid, 0 for apertures."""
    axes: NDArray[np.float64]
    cosine: float
    """Of the apertures' half angle."""


class Wave(NamedTuple):
    """Paths in flight: the first `active` rows of every array."""

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    reach: NDArray[np.float32]
    """How far the next hit may be: to the far side of the seam, or to the top."""
    weights: NDArray[np.float64]
    paths: NDArray[np.int64]
    members: NDArray[np.int32]
    """Which replicate of the group a path belongs to."""
    hits: NDArray[np.int32]
    crossings: NDArray[np.int32]
    fates: NDArray[np.int8]
    """What the last event did to a path: still in flight, escaped, truncated or lost."""
    arrivals: NDArray[np.int64]
    """Scratch: the row of every path that has just escaped, and the record of `Catch.bins` that it adds to."""


class Catch(NamedTuple):
    """What every replicate of a group collected, in integers (`tally.UNIT` to a path)."""

    bins: NDArray[np.int64]
    """(orders, bins, replicates, wavelengths + 1): weights, and in the last column how many paths arrived; the last
    bin is the whole hemisphere. What is added together lies together, and so do the replicates, because what they send
    off from one place arrives in one bin."""
    ledger: NDArray[np.int64]
    """Absorbed, truncated, lost, (replicates, 3, wavelengths)."""

    @classmethod
    def empty(cls, replicates: int, orders: int, bins: int, wavelengths: int) -> Catch:
        """Nothing yet."""
        return cls(
            np.zeros((orders, bins, replicates, wavelengths + 1), np.int64),
            np.zeros((replicates, 3, wavelengths), np.int64),
        )


def matter(material: Material, wavelengths: NDArray[np.float64]) -> Matter:
    """`material` at `wavelengths` (W,) nm for the kernels."""
    ones = np.ones(len(wavelengths))
    if isinstance(material, Mirror):
        return Matter(_MIRROR, ones, ones, ones)
    if isinstance(material, Lambertian):
        return Matter(_LAMBERTIAN, ones, ones, ones * material.reflectance)
    index = material.refractive_index(wavelengths)
    return Matter(_FRESNEL, np.ascontiguousarray(index.real), np.ascontiguousarray(index.imag), ones)


def bins_of(detector: Detector, phi_i: float) -> Bins:
    """`detector` for the kernels, for light from azimuth `phi_i` in degrees."""
    match detector:
        case HemisphereGrid():
            upper = np.sin(np.radians(detector.theta_edges[1:])) ** 2
            upper[-1] = np.inf
            rings = np.searchsorted(upper, np.arange(RING_STEPS + 1) / RING_STEPS, side="right")
            return Bins(detector.bins, upper, rings, detector.shape[1], phi_i / 360, np.zeros((0, 3)), 1.0)
        case Apertures():
            cosine = math.cos(math.radians(detector.half_angle))
            return Bins(
                detector.bins, np.zeros(0), np.zeros(0, np.int64), 1, 0.0, np.ascontiguousarray(detector.axes), cosine
            )


def trace(
    scene: Scene,
    lamp: Lamp,
    substance: Matter,
    detector: Detector,
    phi_i: float,
    replicates: range,
    paths: int,
    catch: Catch,
    advanced: Callable[[int, int], bool],
    wave: int = WAVE,
) -> bool:
    """Trace all `paths` of each of a group of replicates into `catch`, which is cleared first.

    The replicates advance over the sample side by side: as many times more rays share what the caches hold of it.
    `advanced(paths, rays)` is told after every wave what was newly done; when it returns False the group is given up,
    and so is the answer.
    """
    total = len(replicates) * paths
    bins = bins_of(detector, phi_i)
    collect = _collect if isinstance(detector, HemisphereGrid) else _sight
    state = _empty_wave(min(wave, total), len(substance.eta))
    catch.bins.fill(0)
    catch.ledger.fill(0)
    turns = np.array([_replicate_turn(replicate, lamp.key) for replicate in replicates])
    active = launched = 0
    while active or launched < total:
        room = min(len(state.paths) - active, total - launched)
        if room and active <= len(state.paths) // 2:
            _launch(state, active, launched, room, paths, replicates.start, turns, lamp, scene.tile)
            active, launched = active + room, launched + room
        found = scene.intersect(state.origins[:active], state.directions[:active], state.reach[:active])
        hits = (found["primID"], found["tfar"], found["u"], found["v"])
        _move(state, active, hits, (scene.normals, scene.corner_normals), scene.tile, substance, lamp, replicates.start)
        collect(state, active, bins, lamp, turns, catch.bins)
        left = _settle(state, active, scene.tile, catch.ledger)
        if not advanced(active - left, active):
            return False
        active = left
    if isinstance(detector, HemisphereGrid):
        # Escaped is the sum of the bins themselves, not a second counter.
        catch.bins[:, -1] = catch.bins[:, :-1].sum(axis=1)
    _balance(catch, paths)
    return True


def _empty_wave(size: int, wavelengths: int) -> Wave:
    return Wave(
        np.zeros((size, 3), np.float32),
        np.zeros((size, 3), np.float32),
        np.zeros(size, np.float32),
        np.zeros((size, wavelengths)),
        np.zeros(size, np.int64),
        np.zeros(size, np.int32),
        np.zeros(size, np.int32),
        np.zeros(size, np.int32),
        np.zeros(size, np.int8),
        np.zeros((size, 2), np.int64),
    )


def _balance(catch: Catch, paths: int) -> None:
    """launched = escaped + absorbed + truncated + lost, exactly, or the instrument is broken."""
    spent = catch.bins[:, -1, :, :-1].sum(axis=0) + catch.ledger.sum(axis=1)
    if (spent != paths * UNIT).any():
        raise ArithmeticError(f"the energy ledger does not close: {spent / UNIT} of {paths} paths accounted for")


@kernel
def _every_second_bit(x):  # type: ignore[no-untyped-def]
    """The even bits of a 64-bit word, closed up."""
    x &= uint64(0x5555555555555555)
    x = (x | (x >> uint64(1))) & uint64(0x3333333333333333)
    x = (x | (x >> uint64(2))) & uint64(0x0F0F0F0F0F0F0F0F)
    x = (x | (x >> uint64(4))) & uint64(0x00FF00FF00FF00FF)
    x = (x | (x >> uint64(8))) & uint64(0x0000FFFF0000FFFF)
    return (x | (x >> uint64(16))) & WORD


@kernel
def _replicate_turn(replicate, key):  # type: ignore[no-untyped-def]
    """Where a replicate's sequence of surface angles starts, in turns."""
    return uniform(philox(0, 0, replicate, 0xFFFFFFFF, key[0], key[1])[0])


@kernel
def _surface_turn(path, turn, average):  # type: ignore[no-untyped-def]
    """How far the lamp is turned about the sample for this path, in turns: 0, or stratified and uniform."""
    fraction = path * _GOLDEN + turn
    return average * (fraction - math.floor(fraction))


@kernel
def _incident(path, replicate, turn, lamp):  # type: ignore[no-untyped-def]
    """The direction in which a path's light travels: cos-weighted over the source cone, and turned about the sample."""
    sine, cosine, phi = math.sin(lamp.theta), math.cos(lamp.theta), lamp.phi
    if lamp.beam > 0:
        r0, r1, r2, _ = philox(path, path >> 32, replicate, 0xFFFFFFFE, lamp.key[0], lamp.key[1])
        sin_delta = math.sqrt(lamp.beam * uniform(r0))
        cos_delta = math.sqrt(1 - sin_delta * sin_delta)
        # Around the cone the density is 1 + a cosψ: a uniform ψ is turned over with the right probability.
        psi = 2 * math.pi * uniform(r1)
        a = -sin_delta / cos_delta * sine / cosine
        if 2 * uniform(r2) > 1 + a * math.cos(psi):
            psi += math.pi
        down, across = sin_delta * math.cos(psi), sin_delta * math.sin(psi)
        x = cos_delta * sine + down * cosine
        cosine = cos_delta * cosine - down * sine
        sine, phi = math.hypot(x, across), phi + math.atan2(across, x)
    phi += 2 * math.pi * _surface_turn(path, turn, lamp.average)
    return -sine * math.cos(phi), -sine * math.sin(phi), -cosine


@kernel
def _launch(wave, active, first, count, paths, first_replicate, turns, lamp, tile):  # type: ignore[no-untyped-def]
    """Start `count` paths on the plane above the tile.

    A replicate starts one in each of `paths` equal cells along a Morton curve; all replicates of the group start in a
    cell before the first goes on to the next.
    """
    origins, directions, weights = wave.origins, wave.directions, wave.weights
    path, member = divmod(first, turns.size)
    steady = lamp.beam == 0 and not lamp.average
    dx, dy, dz = _incident(path, 0, 0.0, lamp)
    for i in range(active, active + count):
        replicate = first_replicate + member
        # The four words of a block serve four replicates.
        if i == active or member == 0 or replicate % 4 == 0:
            words = philox(path, path >> 32, replicate // 4, 0, lamp.key[0], lamp.key[1])
        place = uint64((path + uniform(words[replicate % 4])) / paths * 2.0**52)
        x = ((_every_second_bit(place) + 0.5) * 2.0**-25 - 1) * tile.half_x
        y = ((_every_second_bit(place >> uint64(1)) + 0.5) * 2.0**-25 - 1) * tile.half_y
        if not steady:
            dx, dy, dz = _incident(path, replicate, turns[member], lamp)
        origins[i, 0], origins[i, 1], origins[i, 2] = x, y, tile.top
        directions[i, 0], directions[i, 1], directions[i, 2] = dx, dy, dz
        wave.reach[i] = _to_edge(x, y, dx, dy, tile.outer_x, tile.outer_y)
        for w in range(weights.shape[1]):
            weights[i, w] = 1.0
        wave.paths[i] = path
        wave.members[i] = member
        wave.hits[i] = 0
        wave.crossings[i] = 0
        member += 1
        if member == turns.size:
            path, member = path + 1, 0


@kernel
def _to_edge(x, y, dx, dy, half_x, half_y):  # type: ignore[no-untyped-def]
    """Distance along a ray to the side at ±half_x or ±half_y that it meets first; inf if it is vertical."""
    distance = np.inf
    if dx != 0:
        distance = (math.copysign(half_x, dx) - x) / dx
    if dy != 0:
        distance = min(distance, (math.copysign(half_y, dy) - y) / dy)
    return distance


@kernel
def _unit(x, y, z):  # type: ignore[no-untyped-def]
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * scale, y * scale, z * scale


@kernel
def _mirrored(dx, dy, dz, nx, ny, nz):  # type: ignore[no-untyped-def]
    """The direction of travel after a mirror reflection."""
    twice = 2 * (dx * nx + dy * ny + dz * nz)
    return dx - twice * nx, dy - twice * ny, dz - twice * nz


@kernel
def _serves(sx, sy, sz, dx, dy, dz, nx, ny, nz):  # type: ignore[no-untyped-def]
    """Whether light can be reflected about the exact normal (sx, sy, sz) of a chord with the normal (nx, ny, nz).

    Close to a silhouette it may face away from the ray, or send it through the chord.
    """
    ex, ey, ez = _mirrored(dx, dy, dz, sx, sy, sz)
    return dx * sx + dy * sy + dz * sz < 0 and ex * nx + ey * ny + ez * nz > 0


@kernel
def _cosine_direction(r0, r1, nx, ny, nz):  # type: ignore[no-untyped-def]
    """A direction about the normal with density cosθ/π."""
    radius, angle = math.sqrt(uniform(r0)), 2 * math.pi * uniform(r1)
    a, b = radius * math.cos(angle), radius * math.sin(angle)
    c = math.sqrt(max(0.0, 1 - radius * radius))
    # Frame of Duff et al. 2017 (JCGT 6(1)): no branch but the sign.
    sign = math.copysign(1.0, nz)
    f = -1.0 / (sign + nz)
    g = nx * ny * f
    x = a * (1 + sign * nx * nx * f) + b * g + c * nx
    y = a * sign * g + b * (sign + ny * ny * f) + c * ny
    return x, y, -a * sign * nx - b * ny + c * nz


@kernel
def _wrapped(position, half):  # type: ignore[no-untyped-def]
    """A coordinate brought back into the tile."""
    if position > half:
        return position - 2 * half
    if position < -half:
        return position + 2 * half
    return position


@kernel
def _pass_on(x, y, z, dx, dy, dz, reach, tile):  # type: ignore[no-untyped-def]
    """A ray that meets nothing before the far side of the seam escapes at the top or re-enters opposite.

    Returns its fate and where it goes on.
    """
    if dz > 0 and z + reach * dz >= tile.top:
        return _ESCAPED, x, y, z
    side = max(0.0, _to_edge(x, y, dx, dy, tile.half_x, tile.half_y))
    x, y, z = x + side * dx, y + side * dy, z + side * dz
    # The coordinate that has reached its side goes opposite.
    if tile.half_x - abs(x) < tile.half_y - abs(y):
        x, y = -math.copysign(tile.half_x, dx), min(tile.half_y, max(-tile.half_y, y))
    else:
        x, y = min(tile.half_x, max(-tile.half_x, x)), -math.copysign(tile.half_y, dy)
    return (LOST if z < tile.bottom else _IN_FLIGHT), x, y, z


@kernel
def _move(wave, active, found, facets, tile, substance, lamp, first_replicate):  # type: ignore[no-untyped-def]
    """Move every path past its next event, and note its fate."""
    primitives, distances, us, vs = found
    normals, corner_normals = facets
    origins, directions, weights, hits, crossings = (
        wave.origins,
        wave.directions,
        wave.weights,
        wave.hits,
        wave.crossings,
    )
    for i in range(active):
        x, y, z = np.float64(origins[i, 0]), np.float64(origins[i, 1]), np.float64(origins[i, 2])
        dx, dy, dz = np.float64(directions[i, 0]), np.float64(directions[i, 1]), np.float64(directions[i, 2])
        primitive = primitives[i]
        if primitive < 0:
            fate, x, y, z = _pass_on(x, y, z, dx, dy, dz, np.float64(wave.reach[i]), tile)
            crossings[i] += 1
        else:
            fate = _IN_FLIGHT
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
                    fate = LOST
            else:
                hits[i] += 1
                crossings[i] = 0
                if corner_normals.shape[0]:
                    c = corner_normals[primitive]
                    t = 1.0 - u - v
                    sx, sy, sz = _unit(
                        t * c[0, 0] + u * c[1, 0] + v * c[2, 0],
                        t * c[0, 1] + u * c[1, 1] + v * c[2, 1],
                        t * c[0, 2] + u * c[1, 2] + v * c[2, 2],
                    )
                    if _serves(sx, sy, sz, dx, dy, dz, nx, ny, nz):
                        nx, ny, nz = sx, sy, sz
                cosine = min(1.0, -(dx * nx + dy * ny + dz * nz))
                largest = 0.0
                for w in range(weights.shape[1]):
                    if substance.kind == _FRESNEL:
                        weights[i, w] *= fresnel(cosine, substance.eta[w], substance.k[w])
                    elif substance.kind == _LAMBERTIAN:
                        weights[i, w] *= substance.reflectance[w]
                    largest = max(largest, weights[i, w])
                if substance.kind == _LAMBERTIAN:
                    path, replicate = wave.paths[i], first_replicate + wave.members[i]
                    r0, r1, _, _ = philox(path, path >> 32, replicate, hits[i], lamp.key[0], lamp.key[1])
                    dx, dy, dz = _cosine_direction(r0, r1, nx, ny, nz)
                else:
                    dx, dy, dz = _mirrored(dx, dy, dz, nx, ny, nz)
                # One Newton step: without it the length would drift over thousands of hits.
                scale = 1.5 - 0.5 * (dx * dx + dy * dy + dz * dz)
                directions[i, 0], directions[i, 1], directions[i, 2] = dx * scale, dy * scale, dz * scale
                if largest < NEGLIGIBLE or hits[i] >= MAX_HITS:
                    fate = TRUNCATED
        origins[i, 0], origins[i, 1], origins[i, 2] = x, y, z
        if fate == _IN_FLIGHT:
            horizontal = directions[i, 2] == 0 and z >= tile.top
            if horizontal or crossings[i] >= MAX_CROSSINGS:
                fate = TRUNCATED
        wave.fates[i] = fate


@kernel
def _sector(x, y, offset, sectors):  # type: ignore[no-untyped-def]
    """Which of the azimuth bins, the first centred on `offset` turns, a direction lies in; the pole is in the first."""
    if x == 0 and y == 0:
        return 0
    turns = math.atan2(y, x) * (0.5 / math.pi) - offset + 0.5 / sectors
    return min(int((turns - math.floor(turns)) * sectors), sectors - 1)


@kernel
def _collect(wave, active, bins, lamp, turns, caught):  # type: ignore[no-untyped-def]
    """Add the paths that have escaped to their bins of a grid.

    First the bins are found, then a short loop adds to them: they lie far apart in memory, and so the processor can
    wait for many of them at once.
    """
    directions, fates, arrivals, edges = wave.directions, wave.fates, wave.arrivals, bins.sin2_edges
    rings = bins.rings
    weights, width = wave.weights, wave.weights.shape[1]
    arrived = 0
    for i in range(active):
        if fates[i] != _ESCAPED:
            continue
        x, y, z = np.float64(directions[i, 0]), np.float64(directions[i, 1]), np.float64(directions[i, 2])
        offset = bins.turn + _surface_turn(wave.paths[i], turns[wave.members[i]], lamp.average)
        sin2 = (x * x + y * y) / (x * x + y * y + z * z)
        ring = rings[int(sin2 * RING_STEPS)]
        while sin2 >= edges[ring]:
            ring += 1
        place = ring * bins.sectors + _sector(x, y, offset, bins.sectors)
        order, member = min(wave.hits[i], caught.shape[0]) - 1, wave.members[i]
        arrivals[arrived, 0], arrivals[arrived, 1] = i, (order * caught.shape[1] + place) * turns.size + member
        arrived += 1
    records = caught.reshape(-1, width + 1)
    for j in range(arrived):
        row, record = np.uint64(arrivals[j, 0]), np.uint64(arrivals[j, 1])
        for w in range(width):
            records[record, w] += _integer(weights[row, w])
        records[record, width] += 1


@kernel
def _integer(weight):  # type: ignore[no-untyped-def]
    return np.int64(weight * UNIT + 0.5)


@kernel
def _sight(wave, active, bins, lamp, turns, caught):  # type: ignore[no-untyped-def]
    """Add the paths that have escaped to every aperture that sees them, and to the whole hemisphere."""
    directions, axes, weights, width = wave.directions, bins.axes, wave.weights, wave.weights.shape[1]
    for i in range(active):
        if wave.fates[i] != _ESCAPED:
            continue
        x, y, z = _unit(np.float64(directions[i, 0]), np.float64(directions[i, 1]), np.float64(directions[i, 2]))
        order, member = min(wave.hits[i], caught.shape[0]) - 1, wave.members[i]
        angle = 2 * math.pi * _surface_turn(wave.paths[i], turns[member], lamp.average)
        c, s = math.cos(angle), math.sin(angle)
        x, y = c * x + s * y, c * y - s * x
        for place in range(bins.size + 1):
            seen = place == bins.size or x * axes[place, 0] + y * axes[place, 1] + z * axes[place, 2] >= bins.cosine
            if seen:
                for w in range(width):
                    caught[order, place, member, w] += _integer(weights[i, w])
                caught[order, place, member, width] += 1


@kernel
def _settle(wave, active, tile, ledger):  # type: ignore[no-untyped-def]
    """Enter in the ledger what has ended and close up the rest at the front. Returns how many are still in flight.

    What a path lost on its way is absorbed; what it still carries when it ends is truncated or lost, or has escaped.
    """
    origins, directions, weights = wave.origins, wave.directions, wave.weights
    left = 0
    for i in range(active):
        fate = wave.fates[i]
        if fate != _IN_FLIGHT:
            member = wave.members[i]
            for w in range(weights.shape[1]):
                carried = _integer(weights[i, w])
                ledger[member, ABSORBED, w] += UNIT - carried
                if fate >= 0:
                    ledger[member, fate, w] += carried
            continue
        for axis in range(3):
            origins[left, axis] = origins[i, axis]
            directions[left, axis] = directions[i, axis]
        for w in range(weights.shape[1]):
            weights[left, w] = weights[i, w]
        wave.paths[left] = wave.paths[i]
        wave.members[left] = wave.members[i]
        wave.hits[left] = wave.hits[i]
        wave.crossings[left] = wave.crossings[i]
        x, y = np.float64(origins[left, 0]), np.float64(origins[left, 1])
        dx, dy = np.float64(directions[left, 0]), np.float64(directions[left, 1])
        wave.reach[left] = _to_edge(x, y, dx, dy, tile.outer_x, tile.outer_y)
        left += 1
    return left
