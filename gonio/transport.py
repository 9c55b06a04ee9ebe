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
from numba import njit, uint64
from numpy.typing import NDArray

from gonio.detectors import Apertures, Detector, HemisphereGrid
from gonio.optics import Lambertian, Material, Mirror
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

ORDERS = 3
"""One hit, two hits, three and more."""

ABSORBED, TRUNCATED, LOST = 0, 1, 2
"""Rows of the ledger: where light goes that does not escape."""

_MIRROR, _FRESNEL, _LAMBERTIAN = 0, 1, 2
_IN_FLIGHT, _ESCAPED = -2, -1
_GOLDEN = (math.sqrt(5) - 1) / 2
_WORD = uint64(0xFFFFFFFF)

kernel = njit(cache=True, nogil=True, error_model="numpy", inline="always")


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
    """sin² of the ring edges of a grid; empty for apertures."""
    sectors: int
    turn: float
    """Azimuth of the traced frame that the bins count from, radians: the lamp's for a grid, 0 for apertures."""
    axes: NDArray[np.float64]
    cos_half_angle: float


class Wave(NamedTuple):
    """Paths in flight: the first `active` rows of every array."""

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    reach: NDArray[np.float32]
    """How far the next hit may be: to the far side of the seam, or to the top."""
    weights: NDArray[np.float64]
    paths: NDArray[np.int64]
    hits: NDArray[np.int32]
    crossings: NDArray[np.int32]


class Catch(NamedTuple):
    """What one replicate collected, in integers (`tally.UNIT` to a path)."""

    weight: NDArray[np.int64]
    """(orders, bins + 1, wavelengths); the last bin is the whole hemisphere."""
    hits: NDArray[np.int64]
    """Paths that arrived, (orders, bins + 1)."""
    ledger: NDArray[np.int64]
    """Absorbed, truncated, lost, (3, wavelengths)."""


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
            sin2 = np.sin(np.radians(detector.theta_edges)) ** 2
            return Bins(detector.bins, sin2, detector.shape[1], math.radians(phi_i), np.zeros((0, 3)), 1.0)
        case Apertures():
            cosine = math.cos(math.radians(detector.half_angle))
            return Bins(detector.bins, np.zeros(0), 1, 0.0, np.ascontiguousarray(detector.axes), cosine)


def trace(
    scene: Scene,
    lamp: Lamp,
    substance: Matter,
    bins: Bins,
    replicate: int,
    paths: int,
    advanced: Callable[[int, int], bool],
    wave: int = WAVE,
) -> Catch | None:
    """Trace all `paths` of one replicate.

    `advanced(paths, rays)` is told after every wave what was newly done; when it returns False the replicate is given
    up and the result is None.
    """
    state = _empty_wave(min(wave, paths), len(substance.eta))
    orders, width = ORDERS, len(substance.eta)
    catch = Catch(
        np.zeros((orders, bins.size + 1, width), np.int64),
        np.zeros((orders, bins.size + 1), np.int64),
        np.zeros((3, width), np.int64),
    )
    turn = _replicate_turn(replicate, lamp.key)
    active = launched = 0
    while active or launched < paths:
        room = min(len(state.paths) - active, paths - launched)
        if room and active <= len(state.paths) // 2:
            _launch(state, active, launched, room, paths, replicate, turn, lamp, scene.tile)
            active, launched = active + room, launched + room
        found = scene.intersect(state.origins[:active], state.directions[:active], state.reach[:active])
        left = _advance(
            state,
            active,
            (found["primID"], found["tfar"], found["u"], found["v"]),
            (scene.normals, scene.corner_normals),
            scene.tile,
            substance,
            bins,
            lamp,
            turn,
            replicate,
            catch,
        )
        if not advanced(active - left, active):
            return None
        active = left
    if bins.sin2_edges.size:
        # Escaped is the sum of the bins themselves, not a second counter.
        catch.weight[:, -1] = catch.weight[:, :-1].sum(axis=1)
        catch.hits[:, -1] = catch.hits[:, :-1].sum(axis=1)
    _balance(catch, paths)
    return catch


def _empty_wave(size: int, wavelengths: int) -> Wave:
    return Wave(
        np.zeros((size, 3), np.float32),
        np.zeros((size, 3), np.float32),
        np.zeros(size, np.float32),
        np.zeros((size, wavelengths)),
        np.zeros(size, np.int64),
        np.zeros(size, np.int32),
        np.zeros(size, np.int32),
    )


def _balance(catch: Catch, paths: int) -> None:
    """launched = escaped + absorbed + truncated + lost, exactly, or the instrument is broken."""
    spent = catch.weight[:, -1].sum(axis=0) + catch.ledger.sum(axis=0)
    if (spent != paths * UNIT).any():
        raise ArithmeticError(f"the energy ledger does not close: {spent / UNIT} of {paths} paths accounted for")


@kernel
def philox(c0, c1, c2, c3, k0, k1):  # type: ignore[no-untyped-def]
    """Philox4x32-10 (Salmon et al. 2011, doi:10.1145/2063384.2063405): four 32-bit words, as uint64."""
    c0, c1, c2, c3 = uint64(c0) & _WORD, uint64(c1) & _WORD, uint64(c2) & _WORD, uint64(c3) & _WORD
    k0, k1 = uint64(k0) & _WORD, uint64(k1) & _WORD
    for _ in range(10):
        p0 = uint64(0xD2511F53) * c0
        p1 = uint64(0xCD9E8D57) * c2
        c0 = (p1 >> uint64(32)) ^ c1 ^ k0
        c1 = p1 & _WORD
        c2 = (p0 >> uint64(32)) ^ c3 ^ k1
        c3 = p0 & _WORD
        k0 = (k0 + uint64(0x9E3779B9)) & _WORD
        k1 = (k1 + uint64(0xBB67AE85)) & _WORD
    return c0, c1, c2, c3


@kernel
def _uniform(word):  # type: ignore[no-untyped-def]
    """A 32-bit word as a number inside (0, 1)."""
    return (np.float64(word) + 0.5) * 2.0**-32


@kernel
def _every_second_bit(x):  # type: ignore[no-untyped-def]
    """The even bits of a 64-bit word, closed up."""
    x &= uint64(0x5555555555555555)
    x = (x | (x >> uint64(1))) & uint64(0x3333333333333333)
    x = (x | (x >> uint64(2))) & uint64(0x0F0F0F0F0F0F0F0F)
    x = (x | (x >> uint64(4))) & uint64(0x00FF00FF00FF00FF)
    x = (x | (x >> uint64(8))) & uint64(0x0000FFFF0000FFFF)
    return (x | (x >> uint64(16))) & _WORD


@njit(cache=True, nogil=True)
def _replicate_turn(replicate, key):  # type: ignore[no-untyped-def]
    """Where a replicate's sequence of surface angles starts, in turns."""
    return _uniform(philox(0, 0, replicate, 0xFFFFFFFF, key[0], key[1])[0])


@kernel
def _surface_angle(path, turn, lamp):  # type: ignore[no-untyped-def]
    """How far the lamp is turned about the sample for this path, radians: 0, or a stratified uniform angle."""
    if not lamp.average:
        return 0.0
    fraction = path * _GOLDEN + turn
    return 2 * math.pi * (fraction - math.floor(fraction))


@kernel
def _incident(path, replicate, lamp):  # type: ignore[no-untyped-def]
    """Polar angle's sine and cosine and the azimuth of the direction to the lamp; cos-weighted over the source cone."""
    if lamp.beam == 0.0:
        return math.sin(lamp.theta), math.cos(lamp.theta), lamp.phi
    r0, r1, r2, _ = philox(path, path >> 32, replicate, 0xFFFFFFFE, lamp.key[0], lamp.key[1])
    sin_delta = math.sqrt(lamp.beam * _uniform(r0))
    cos_delta = math.sqrt(1 - sin_delta * sin_delta)
    sin_t, cos_t = math.sin(lamp.theta), math.cos(lamp.theta)
    # Around the cone the density is 1 + a cosψ: a uniform ψ is turned over with the right probability.
    psi = 2 * math.pi * _uniform(r1)
    a = -sin_delta / cos_delta * sin_t / cos_t
    if 2 * _uniform(r2) > 1 + a * math.cos(psi):
        psi += math.pi
    down = sin_delta * math.cos(psi)
    x = cos_delta * sin_t + down * cos_t
    y = sin_delta * math.sin(psi)
    return math.hypot(x, y), cos_delta * cos_t - down * sin_t, lamp.phi + math.atan2(y, x)


@njit(cache=True, nogil=True, error_model="numpy")
def _launch(wave, active, first, count, paths, replicate, turn, lamp, tile):  # type: ignore[no-untyped-def]
    """Start `count` paths on the plane above the tile: one in each of `paths` equal cells along a Morton curve."""
    for j in range(count):
        i, path = active + j, first + j
        r0, _, _, _ = philox(path, path >> 32, replicate, 0, lamp.key[0], lamp.key[1])
        place = uint64((path + _uniform(r0)) / paths * 2.0**52)
        wave.origins[i, 0] = ((_every_second_bit(place) + 0.5) * 2.0**-25 - 1) * tile.half_x
        wave.origins[i, 1] = ((_every_second_bit(place >> uint64(1)) + 0.5) * 2.0**-25 - 1) * tile.half_y
        wave.origins[i, 2] = tile.top
        sine, cosine, phi = _incident(path, replicate, lamp)
        phi += _surface_angle(path, turn, lamp)
        wave.directions[i, 0] = -sine * math.cos(phi)
        wave.directions[i, 1] = -sine * math.sin(phi)
        wave.directions[i, 2] = -cosine
        wave.weights[i, :] = 1.0
        wave.paths[i] = path
        wave.hits[i] = 0
        wave.crossings[i] = 0
        wave.reach[i] = _to_edge(wave.origins[i], wave.directions[i], tile.outer_x, tile.outer_y)


@kernel
def _to_edge(origin, direction, half_x, half_y):  # type: ignore[no-untyped-def]
    """Distance along a ray to the side at ±half_x or ±half_y that it meets first; inf if it is vertical."""
    distance = np.inf
    dx, dy = np.float64(direction[0]), np.float64(direction[1])
    if dx != 0:
        distance = (math.copysign(half_x, dx) - origin[0]) / dx
    if dy != 0:
        distance = min(distance, (math.copysign(half_y, dy) - origin[1]) / dy)
    return distance


@kernel
def fresnel(cosine, eta, k):  # type: ignore[no-untyped-def]
    """Unpolarised reflectance of an interface of index eta + ik, total reflection included.

    `optics.fresnel_conductor` with R_s (1 + R_p / R_s) / 2 drawn together, so that one division is left.
    """
    cos2 = cosine * cosine
    sin2 = 1.0 - cos2
    t0 = eta * eta - k * k - sin2
    modulus = math.sqrt(t0 * t0 + 4.0 * eta * eta * k * k)
    twice = 2.0 * math.sqrt(max(0.0, 0.5 * (modulus + t0))) * cosine
    p = cos2 * modulus + sin2 * sin2
    return (modulus + cos2 - twice) * p / ((modulus + cos2 + twice) * (p + twice * sin2))


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
def _exact_normal(corners, u, v, dx, dy, dz, nx, ny, nz):  # type: ignore[no-untyped-def]
    """The interpolated exact normal, where geometry is smooth by definition.

    Close to a silhouette the exact normal of a chord may face away from the ray, or send it through the chord; there
    the facet's own (nx, ny, nz) serves.
    """
    w = 1.0 - u - v
    sx, sy, sz = _unit(
        w * corners[0, 0] + u * corners[1, 0] + v * corners[2, 0],
        w * corners[0, 1] + u * corners[1, 1] + v * corners[2, 1],
        w * corners[0, 2] + u * corners[1, 2] + v * corners[2, 2],
    )
    ex, ey, ez = _mirrored(dx, dy, dz, sx, sy, sz)
    if dx * sx + dy * sy + dz * sz < 0 and ex * nx + ey * ny + ez * nz > 0:
        return sx, sy, sz
    return nx, ny, nz


@kernel
def _cosine_direction(r0, r1, nx, ny, nz):  # type: ignore[no-untyped-def]
    """A direction about the normal with density cosθ/π."""
    radius, angle = math.sqrt(_uniform(r0)), 2 * math.pi * _uniform(r1)
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
def _reflect(wave, i, hit, facets, tile, substance, lamp, replicate):  # type: ignore[no-untyped-def]
    """Reflect path i where it hit the surface. Returns its fate."""
    primitive, distance, u, v = hit
    dx, dy, dz = np.float64(wave.directions[i, 0]), np.float64(wave.directions[i, 1]), np.float64(wave.directions[i, 2])
    normals, corner_normals = facets
    nx, ny, nz = np.float64(normals[primitive, 0]), np.float64(normals[primitive, 1]), np.float64(normals[primitive, 2])
    behind = dx * nx + dy * ny + dz * nz >= 0
    if behind and min(u, v, 1 - u - v) > CLIPPED:
        return LOST
    wave.origins[i, 0] = _wrapped(wave.origins[i, 0] + distance * dx + tile.offset * nx, tile.half_x)
    wave.origins[i, 1] = _wrapped(wave.origins[i, 1] + distance * dy + tile.offset * ny, tile.half_y)
    wave.origins[i, 2] = wave.origins[i, 2] + distance * dz + tile.offset * nz
    if behind:
        wave.crossings[i] += 1
        return _IN_FLIGHT
    wave.hits[i] += 1
    wave.crossings[i] = 0
    if corner_normals.shape[0]:
        nx, ny, nz = _exact_normal(corner_normals[primitive], u, v, dx, dy, dz, nx, ny, nz)
    cosine = min(1.0, -(dx * nx + dy * ny + dz * nz))
    if substance.kind == _LAMBERTIAN:
        path = wave.paths[i]
        r0, r1, _, _ = philox(path, path >> 32, replicate, wave.hits[i], lamp.key[0], lamp.key[1])
        dx, dy, dz = _cosine_direction(r0, r1, nx, ny, nz)
    else:
        dx, dy, dz = _mirrored(dx, dy, dz, nx, ny, nz)
    # One Newton step: without it the length would drift over thousands of hits.
    scale = 1.5 - 0.5 * (dx * dx + dy * dy + dz * dz)
    wave.directions[i, 0], wave.directions[i, 1], wave.directions[i, 2] = dx * scale, dy * scale, dz * scale
    largest = 1.0
    if substance.kind != _MIRROR:
        largest = 0.0
        for w in range(wave.weights.shape[1]):
            if substance.kind == _FRESNEL:
                wave.weights[i, w] *= fresnel(cosine, substance.eta[w], substance.k[w])
            else:
                wave.weights[i, w] *= substance.reflectance[w]
            largest = max(largest, wave.weights[i, w])
    if largest < NEGLIGIBLE or wave.hits[i] >= MAX_HITS:
        return TRUNCATED
    return _IN_FLIGHT


@kernel
def _pass_on(wave, i, tile):  # type: ignore[no-untyped-def]
    """Path i meets nothing before the far side of the seam: it escapes at the top or re-enters opposite."""
    dz = np.float64(wave.directions[i, 2])
    if dz > 0 and wave.origins[i, 2] + wave.reach[i] * dz >= tile.top:
        return _ESCAPED
    side = max(0.0, _to_edge(wave.origins[i], wave.directions[i], tile.half_x, tile.half_y))
    x = wave.origins[i, 0] + side * np.float64(wave.directions[i, 0])
    y = wave.origins[i, 1] + side * np.float64(wave.directions[i, 1])
    # The coordinate that has reached its side goes opposite.
    if tile.half_x - abs(x) < tile.half_y - abs(y):
        wave.origins[i, 0] = -math.copysign(tile.half_x, wave.directions[i, 0])
        wave.origins[i, 1] = min(tile.half_y, max(-tile.half_y, y))
    else:
        wave.origins[i, 0] = min(tile.half_x, max(-tile.half_x, x))
        wave.origins[i, 1] = -math.copysign(tile.half_y, wave.directions[i, 1])
    wave.origins[i, 2] += side * dz
    wave.crossings[i] += 1
    if wave.origins[i, 2] < tile.bottom:
        return LOST
    if wave.crossings[i] >= MAX_CROSSINGS:
        return TRUNCATED
    return _IN_FLIGHT


@kernel
def _place(wave, i, bins, lamp, turn):  # type: ignore[no-untyped-def]
    """The bin of a grid that path i escapes into."""
    x, y, z = np.float64(wave.directions[i, 0]), np.float64(wave.directions[i, 1]), np.float64(wave.directions[i, 2])
    flat = x * x + y * y
    sector = 0  # the pole itself has no azimuth
    if flat > 0:
        turns = (math.atan2(y, x) - bins.turn - _surface_angle(wave.paths[i], turn, lamp)) * (0.5 / math.pi)
        turns += 0.5 / bins.sectors
        sector = min(int((turns - math.floor(turns)) * bins.sectors), bins.sectors - 1)
    sin2 = flat / (flat + z * z)
    low, high = 0, bins.sin2_edges.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if sin2 >= bins.sin2_edges[middle]:
            low = middle
        else:
            high = middle
    return low * bins.sectors + sector


@kernel
def _arrive(wave, i, bins, lamp, turn, catch):  # type: ignore[no-untyped-def]
    """Path i has escaped: add its weights to its bin, or to every aperture that sees it."""
    order = min(wave.hits[i], ORDERS) - 1
    if bins.sin2_edges.size:
        place = _place(wave, i, bins, lamp, turn)
        _add(wave.weights[i], catch.weight[order, place])
        catch.hits[order, place] += 1
        return
    x, y, z = _unit(
        np.float64(wave.directions[i, 0]), np.float64(wave.directions[i, 1]), np.float64(wave.directions[i, 2])
    )
    angle = _surface_angle(wave.paths[i], turn, lamp)
    c, s = math.cos(angle), math.sin(angle)
    x, y = c * x + s * y, c * y - s * x
    for aperture in range(bins.size):
        axis = bins.axes[aperture]
        if x * axis[0] + y * axis[1] + z * axis[2] >= bins.cos_half_angle:
            _add(wave.weights[i], catch.weight[order, aperture])
            catch.hits[order, aperture] += 1
    _add(wave.weights[i], catch.weight[order, bins.size])
    catch.hits[order, bins.size] += 1


@kernel
def _integer(weight):  # type: ignore[no-untyped-def]
    return np.int64(weight * UNIT + 0.5)


@kernel
def _add(weights, total):  # type: ignore[no-untyped-def]
    for w in range(weights.size):
        total[w] += _integer(weights[w])


@kernel
def _spend(weights, fate, ledger):  # type: ignore[no-untyped-def]
    """A path ends: what it lost on its way is absorbed; what it still carries goes to `fate`, unless it escaped."""
    for w in range(weights.size):
        carried = _integer(weights[w])
        ledger[ABSORBED, w] += UNIT - carried
        if fate >= 0:
            ledger[fate, w] += carried


@kernel
def _keep(wave, source, target):  # type: ignore[no-untyped-def]
    """Move a path to the front of the wave, where it stays in flight."""
    for axis in range(3):
        wave.origins[target, axis] = wave.origins[source, axis]
        wave.directions[target, axis] = wave.directions[source, axis]
    for w in range(wave.weights.shape[1]):
        wave.weights[target, w] = wave.weights[source, w]
    wave.paths[target] = wave.paths[source]
    wave.hits[target] = wave.hits[source]
    wave.crossings[target] = wave.crossings[source]


@njit(cache=True, nogil=True, error_model="numpy")
def _advance(wave, active, found, facets, tile, substance, bins, lamp, turn, replicate, catch):  # type: ignore[no-untyped-def]
    """Move every path on by one event. Returns how many are still in flight, closed up at the front."""
    primitives, distances, u, v = found
    left = 0
    for i in range(active):
        if primitives[i] >= 0:
            hit = (primitives[i], np.float64(distances[i]), np.float64(u[i]), np.float64(v[i]))
            fate = _reflect(wave, i, hit, facets, tile, substance, lamp, replicate)
        else:
            fate = _pass_on(wave, i, tile)
        if fate == _IN_FLIGHT and wave.directions[i, 2] == 0 and wave.origins[i, 2] >= tile.top:
            fate = TRUNCATED
        if fate == _IN_FLIGHT:
            if left != i:
                _keep(wave, i, left)
            wave.reach[left] = _to_edge(wave.origins[left], wave.directions[left], tile.outer_x, tile.outer_y)
            left += 1
            continue
        if fate == _ESCAPED:
            _arrive(wave, i, bins, lamp, turn, catch)
        _spend(wave.weights[i], fate, catch.ledger)
    return left
