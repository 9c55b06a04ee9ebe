"""Light paths over a profile, for drawings: shadowing, masking and multiple reflection in two dimensions.

The profile is a section through a surface, taken as a surface of its own that goes on unchanged along y: so it is for
cylinders and V-grooves, and for a height field it is one of its lines. Light is traced in the plane of the section, in
float64, around the same periodic tile as everywhere; it comes from the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.sphere import reflect
from microsurfaces import HeightField, Mesh
from microsurfaces.arrays import Floats, Indices

Flags = NDArray[np.bool_]
"""Booleans of any shape."""
MOST_HITS = 200
"""Light in the cusp between two cylinders may go on for thousands; no picture shows them."""
MOST_CROSSINGS = 10_000
"""Tiles that a ray may cross between two hits."""
ROUNDING = 1e-12
"""In periods: how far rounding may carry a point from its segment."""
EDGE_ON = 1e-9
"""Cosine below which a facet receives no light: rounding would decide, piece by piece, whether it is lit."""
PAIRS = 1 << 21
"""Rays times segments that are held in memory together."""


# --- The section ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Profile:
    """One period of a section through a surface: segments in the plane (x, z), µm, from left to right."""

    ends: Floats
    """(n, 2, 2) both ends (x, z) of each segment; the outside is on the left on the way from first to second."""
    normals: Floats
    """(n, 2, 2) unit normals (x, z) at both ends: exact ones where the surface is smooth by definition."""
    period: float
    y: float
    """Where the surface is cut, µm."""

    @classmethod
    def of(cls, relief: HeightField | Mesh) -> Profile:
        """The section in the middle of the tile; of a height field the line of nodes that is nearest to it."""
        if isinstance(relief, Mesh):
            return _section(relief)
        row = relief.heights.shape[0] // 2
        z = np.append(relief.heights[row], relief.heights[row, 0])
        nodes = np.stack([relief.spacing[0] * np.arange(len(z)), z], axis=-1)
        ends = np.stack([nodes[:-1], nodes[1:]], axis=1)
        return cls(ends, _flat(ends), relief.period[0], row * relief.spacing[1])

    @property
    def left(self) -> float:
        """Where the tile begins, µm."""
        return float(self.ends[..., 0].min())

    @property
    def top(self) -> float:
        """The largest height, µm."""
        return float(self.ends[..., 1].max())

    def copies(self, low: float, high: float) -> range:
        """How many periods to the right the tiles between x = low and high are."""
        first, last = (int(np.floor((x - self.left) / self.period)) for x in (low, high))
        return range(first, last + 1)

    def between(self, low: float, high: float) -> Profile:
        """As many copies of the period side by side as show themselves between x = low and high."""
        shifts = np.array([(k * self.period, 0.0) for k in self.copies(low, high)])
        ends = (self.ends + shifts[:, None, None]).reshape(-1, 2, 2)
        normals = np.tile(self.normals, (len(shifts), 1, 1))
        shown = (ends[..., 0].max(axis=1) >= low) & (ends[..., 0].min(axis=1) <= high)
        return Profile(ends[shown], normals[shown], self.period, self.y)


def _flat(ends: Floats) -> Floats:
    """The normals of straight segments, at both ends of each."""
    along = ends[:, 1] - ends[:, 0]
    normals = np.stack([-along[:, 1], along[:, 0]], axis=-1) / np.hypot(*along.T)[:, None]
    return np.repeat(normals[:, None], 2, axis=1)


def _section(mesh: Mesh) -> Profile:
    """Where the plane y = const through the middle of the tile cuts the triangles."""
    low, period = mesh.vertices[:, :2].min(axis=0), mesh.period
    y = float(low[1] + period[1] / 2)
    ends, normals = [], []
    for shift in np.arange(int(np.ceil(np.ptp(mesh.vertices[:, 1]) / period[1]))) * period[1]:
        above = (mesh.vertices[:, 1] > y + shift)[mesh.faces]
        cut = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
        place, exact = _crossings(mesh, cut, above[cut], y + shift)
        ends.append(place)
        normals.append(exact)
    return _in_tile(np.concatenate(ends), np.concatenate(normals), float(low[0]), period[0], y)


def _crossings(mesh: Mesh, cut: Indices, above: Flags, y: float) -> tuple[Floats, Floats]:
    """Ends and normals (m, 2, 2) of the segments in which the plane cuts the triangles `cut` (m,)."""
    # The corner that is alone on its side of the plane, and the two others, in the order of the triangle.
    alone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
    faces = mesh.faces[cut]
    peak, *others = (np.take_along_axis(faces, (alone[:, None] + k) % 3, axis=1)[:, 0] for k in range(3))
    facets = np.cross(mesh.vertices[others[0]] - mesh.vertices[peak], mesh.vertices[others[1]] - mesh.vertices[peak])
    ends, normals = [], []
    for other in others:
        a, b = mesh.vertices[peak], mesh.vertices[other]
        share = ((y - a[:, 1]) / (b[:, 1] - a[:, 1]))[:, None]
        ends.append((a + share * (b - a))[:, ::2])
        exact = facets if mesh.vertex_normals is None else mesh.vertex_normals[[peak, other]]
        normals.append((exact if exact.ndim == 2 else exact[0] + share * (exact[1] - exact[0]))[:, ::2])
    place, exact = np.stack(ends, axis=1), np.stack(normals, axis=1)
    along = place[:, 1] - place[:, 0]
    turned = along[:, 0] * facets[:, 2] - along[:, 1] * facets[:, 0] < 0
    place[turned], exact[turned] = place[turned, ::-1], exact[turned, ::-1]
    return place, exact / np.linalg.norm(exact, axis=-1, keepdims=True)


def _in_tile(ends: Floats, normals: Floats, left: float, period: float, y: float) -> Profile:
    """The segments, cut at the sides of the tile and brought into it."""
    pieces: list[Floats] = []
    turns: list[Floats] = []
    for shift in np.arange(int(np.ceil((ends[..., 0].max() - left) / period - ROUNDING))) * period:
        x = ends[..., 0] - shift - left
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = (np.array([0.0, period]) - x[:, :1]) / (x[:, 1] - x[:, 0])[:, None]
        level = x[:, 0] == x[:, 1]
        inside = (x[:, 0] >= 0) & (x[:, 0] <= period)
        start = np.where(level, np.where(inside, 0.0, 1.0), np.maximum(sides.min(axis=1), 0.0))
        end = np.where(level, 1.0, np.minimum(sides.max(axis=1), 1.0))
        share = np.stack([start, end], axis=1)[..., None]
        kept = end > start + ROUNDING
        for whole, parts, offset in ((ends, pieces, (shift, 0.0)), (normals, turns, (0.0, 0.0))):
            parts.append((whole[:, :1] + share * (whole[:, 1:] - whole[:, :1]) - offset)[kept])
    place, exact = np.concatenate(pieces), np.concatenate(turns)
    long = np.flatnonzero(np.hypot(*(place[:, 1] - place[:, 0]).T) > ROUNDING * period)
    order = long[place[long, :, 0].mean(axis=1).argsort(kind="stable")]
    return Profile(place[order], exact[order], period, y)


# --- Light on it ------------------------------------------------------------------------------------------------------


class Meeting(NamedTuple):
    """Where rays (n,) meet the surface next."""

    segment: Indices
    """-1 for a ray that leaves."""
    along: Floats
    """How far along the segment, 0 to 1."""
    point: Floats
    """(n, 2) within the tile."""
    tiles: Indices
    """How many periods to the right of where the ray came from that tile is."""

    def where(self, kept: Flags) -> Meeting:
        """Only some of the rays."""
        return Meeting(self.segment[kept], self.along[kept], self.point[kept], self.tiles[kept])


class Paths(NamedTuple):
    """Light paths (n,) from the plane z = top until they leave."""

    points: Floats
    """(hits + 1, n, 2) where they start and where they hit, µm, periods unfolded; NaN after the last hit."""
    hits: Indices
    leaving: Floats
    """(n, 2) unit vectors; NaN for a path that is still on its way after `MOST_HITS`."""


def incident(theta_i: float) -> Floats:
    """The direction (x, z) in which the light travels."""
    return np.array([np.sin(np.radians(theta_i)), -np.cos(np.radians(theta_i))])


def trace(profile: Profile, x: Floats, theta_i: float) -> Paths:
    """Mirror light that crosses the plane z = top at `x` (n,) µm until it leaves."""
    n, left, period = len(x), profile.left, profile.period
    tiles = np.floor((x - left) / period).astype(np.intp)
    point = np.stack([x - tiles * period, np.full(n, profile.top)], axis=-1)
    way = np.tile(incident(theta_i), (n, 1))
    points, hits, leaving = [np.stack([x, point[:, 1]], axis=-1)], np.zeros(n, np.intp), np.full((n, 2), np.nan)
    flying = np.arange(n)
    while flying.size and len(points) <= MOST_HITS:
        found = meet(profile, point[flying], way[flying])
        gone = found.segment < 0
        leaving[flying[gone]] = way[flying[gone]]
        flying, found = flying[~gone], found.where(~gone)
        tiles[flying] += found.tiles
        point[flying] = found.point
        way[flying] = _mirrored(profile, found, way[flying])
        hits[flying] += 1
        reached = np.full((n, 2), np.nan)
        reached[flying] = found.point + np.stack([tiles[flying] * period, np.zeros(len(flying))], axis=-1)
        points.append(reached)
    return Paths(np.stack(points[: hits.max() + 1]), hits, leaving)


def meet(profile: Profile, point: Floats, way: Floats) -> Meeting:
    """What rays from `point` (n, 2) in the tile meet next in the directions `way` (n, 2).

    A segment is met from outside only, so that none is in the way of the light that it has just sent off.
    """
    point = point.copy()
    found = Meeting(np.full(len(point), -1), np.zeros(len(point)), point.copy(), np.zeros(len(point), np.intp))
    tiles, flying = np.zeros(len(point), np.intp), np.arange(len(point))
    for _ in range(MOST_CROSSINGS):
        if not flying.size:
            break
        segment, along, distance = _nearest(profile, point[flying], way[flying])
        hit = flying[segment >= 0]
        found.segment[hit], found.along[hit] = segment[segment >= 0], along[segment >= 0]
        found.point[hit] = point[hit] + distance[segment >= 0, None] * way[hit]
        found.tiles[hit] = tiles[hit]
        flying = flying[segment < 0]
        flying = flying[~_cross(profile, point, way, tiles, flying)]
    return found


def _cross(profile: Profile, point: Floats, way: Floats, tiles: Indices, flying: Indices) -> Flags:
    """Move rays to the next tile, in place; returns which of them have risen above the top before and leave."""
    sign = np.sign(way[flying, 0])
    side = profile.left + profile.period * (sign > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(sign == 0, np.inf, (side - point[flying, 0]) / way[flying, 0])
        z = np.where(way[flying, 1] == 0, point[flying, 1], point[flying, 1] + distance * way[flying, 1])
    point[flying, 0], point[flying, 1] = side - sign * profile.period, z
    tiles[flying] += sign.astype(np.intp)
    return np.asarray((way[flying, 1] >= 0) & (z >= profile.top))


def _nearest(profile: Profile, point: Floats, way: Floats) -> tuple[Indices, Floats, Floats]:
    """The first segment in the tile whose outside each ray meets (-1 for none), how far along it, and the distance."""
    segment, along, distance = np.full(len(point), -1), np.zeros(len(point)), np.full(len(point), np.inf)
    step = max(1, PAIRS // len(profile.ends))
    (ax, az), (ex, ez) = profile.ends[:, 0].T, (profile.ends[:, 1] - profile.ends[:, 0]).T
    for start in range(0, len(point), step):
        part = slice(start, start + step)
        (ox, oz), (dx, dz) = point[part, :, None].transpose(1, 0, 2), way[part, :, None].transpose(1, 0, 2)
        facing = dx * ez - dz * ex
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((ax - ox) * ez - (az - oz) * ex) / facing
            u = ((ax - ox) * dz - (az - oz) * dx) / facing
        ahead = (facing > 0) & (t > -ROUNDING * profile.period) & (u >= -ROUNDING) & (u <= 1 + ROUNDING)
        t[~ahead] = np.inf
        first = t.argmin(axis=1)
        rows = np.arange(len(first))
        distance[part], along[part] = t[rows, first], u[rows, first]
        segment[part] = np.where(np.isfinite(t[rows, first]), first, -1)
    return segment, along, distance


def _mirrored(profile: Profile, found: Meeting, way: Floats) -> Floats:
    """Directions after a specular reflection: about the exact normal, unless it faces away or sends light inside."""
    start, end = profile.normals[found.segment].swapaxes(0, 1)
    smooth = start + found.along[:, None] * (end - start)
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
    facet = _flat(profile.ends[found.segment])[:, 0]
    out = reflect(-way, smooth)
    serves = ((way * smooth).sum(axis=1) < 0) & ((out * facet).sum(axis=1) > 0)
    return np.where(serves[:, None], out, reflect(-way, facet))


def shares(paths: Paths) -> Floats:
    """Shares of the light that leaves after 1, 2, 3 and more hits, of a surface that absorbs nothing."""
    return np.bincount(np.clip(paths.hits, 1, 3), minlength=4)[1:] / len(paths.hits)


def exposure(profile: Profile, step: float, theta_i: float) -> tuple[Floats, Flags, Flags]:
    """Pieces (n, 2, 2) of the profile of at most `step` µm; which of them are shadowed, and which lit but masked.

    Shadowed: no direct light reaches the middle. Masked: what is reflected there meets the surface again.
    """
    lengths = np.hypot(*(profile.ends[:, 1] - profile.ends[:, 0]).T)
    counts = np.maximum(1, np.ceil(lengths / step)).astype(int)
    own = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(own)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = np.stack([number, number + 1], axis=1) / counts[own, None]
    start, end = profile.ends[own, 0], profile.ends[own, 1]
    pieces = start[:, None] + share[..., None] * (end - start)[:, None]
    middle, way = pieces.mean(axis=1), np.tile(incident(theta_i), (len(own), 1))
    lit = (way * _flat(pieces)[:, 0]).sum(axis=1) < -EDGE_ON
    lit[lit] = meet(profile, middle[lit], -way[lit]).segment < 0
    place = Meeting(own, share.mean(axis=1), middle, np.zeros(len(own), np.intp))
    masked = lit.copy()
    masked[lit] = meet(profile, middle[lit], _mirrored(profile, place, way)[lit]).segment >= 0
    return pieces, ~lit, masked
