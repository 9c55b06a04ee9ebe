"""A picture of light on a cross-section of a surface: shadowing, masking and multiple reflection, ray by ray.

The section is taken as a surface of its own, which goes on unchanged along y: so it is for cylinders and V-grooves, and
for a height field the picture is that of one of its lines. Light is traced in the plane of the section, in float64,
around the same periodic tile as everywhere; the lamp is on the left.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.plots.style import INK, LAMP, MIRROR, PAPER, new_figure, save
from gonio.sphere import reflect
from gonio.wording import percent
from microsurfaces import HeightField, Mesh
from microsurfaces.arrays import Floats, Indices

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.path import Path as Outline

    from gonio.plots.style import PathLike
    from microsurfaces import Surface

Flags = NDArray[np.bool_]

HITS = (LAMP, MIRROR, "#009e73", "#cc79a7")
"""Colours of light that has hit the surface 0, 1, 2, 3 and more times."""
SHADOWED, MASKED = "#111111", "#f0d000"
"""Stretches that the lamp does not reach, and those whose reflection is blocked."""

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
UNITS = {
    **dict.fromkeys(("angle", "rotation"), "°"),
    **dict.fromkeys(("distance", "floor_height", "protrusion"), " radii"),
    **dict.fromkeys(("correlation_length", "side", "radius", "width", "pixel_size"), " µm"),
}
"""Of the recipes' parameters; the others are numbers."""
LINE = 120
"""At most so many letters in a line of a title."""
UNTOLD = ("kind", "unit", "scale")
"""What a title says nothing of."""
RATIO = 0.64
"""Height over width of the stretch that is drawn."""


# --- The section -----------------------------------------------------------------------------------------------------


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


# --- Light on it -----------------------------------------------------------------------------------------------------


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
        struck = flying[segment >= 0]
        found.segment[struck], found.along[struck] = segment[segment >= 0], along[segment >= 0]
        found.point[struck] = point[struck] + distance[segment >= 0, None] * way[struck]
        found.tiles[struck] = tiles[struck]
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
    """Directions after a mirror reflection: about the exact normal, unless it faces away or sends light inside."""
    start, end = profile.normals[found.segment].swapaxes(0, 1)
    smooth = start + found.along[:, None] * (end - start)
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
    facet = _flat(profile.ends[found.segment])[:, 0]
    out = reflect(-way, smooth)
    serves = ((way * smooth).sum(axis=1) < 0) & ((out * facet).sum(axis=1) > 0)
    return np.where(serves[:, None], out, reflect(-way, facet))


def shares(paths: Paths) -> Floats:
    """Shares of the light that leaves after 1, 2, 3 and more hits, of a mirror that absorbs nothing."""
    return np.bincount(np.clip(paths.hits, 1, 3), minlength=4)[1:] / len(paths.hits)


def exposure(profile: Profile, step: float, theta_i: float) -> tuple[Floats, Flags, Flags]:
    """Pieces (n, 2, 2) of the profile of at most `step` µm; which of them are shadowed, and which lit but masked.

    Shadowed: the middle sees no lamp. Masked: the lamp's mirror image there is hidden by the surface.
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


# --- The picture -----------------------------------------------------------------------------------------------------


def paths(
    surface: Surface | HeightField | Mesh, path: PathLike, theta_i: float = 45.0, count: int = 15, seed: int = 0
) -> Path:
    """Draw what light does on a cross-section of a surface and return the path.

    `surface` is a recipe, built with `seed`, or what one has built. The section, y = const through the middle of the
    tile, is drawn to scale, and so is light from a lamp on the left at `theta_i` degrees: `count` parallel rays at
    equal distances, mirrored in the plane of the section until they leave, in a colour for the number of hits so far.
    Bands below the line mark what no direct light reaches (shadowed) and what is lit but sends its reflection into the
    surface again (masked). The stretch that is shown is the one with the most multiple reflection; shares speak of the
    whole line and of a mirror that absorbs nothing. Raises ValueError for an angle outside [0, 90) or no ray at all.
    """
    if not 0 <= theta_i < 90:
        raise ValueError(f"theta_i is {theta_i:g}: expected an angle from the normal in degrees, from 0 to below 90")
    if count < 1:
        raise ValueError(f"count is {count}: expected at least one ray to draw")
    relief = surface if isinstance(surface, HeightField | Mesh) else surface.build(seed)
    profile = Profile.of(relief)
    whole = trace(profile, _evenly(profile.left, profile.period, _enough(profile)), theta_i)
    window = _Window.of(profile, whole, stretch(relief, profile, RATIO))
    figure = new_figure(12.8, 7.2)
    panel, side = figure.subplots(1, 2, width_ratios=(4.0, 1.0))
    pieces, shadowed, masked = exposure(profile, window.width / 400, theta_i)
    _draw_solid(panel, window, profile, pieces, {SHADOWED: shadowed, MASKED: masked})
    _draw_rays(panel, window, profile, theta_i, count)
    _scale_bar(panel, window)
    extent = np.abs(np.ptp(pieces[..., 0], axis=1))
    _tell(side, theta_i, shares(whole), float(extent[shadowed].sum() / extent.sum()))
    _head(figure, surface, profile, window, theta_i)
    return save(figure, path)


@dataclass(frozen=True)
class _Window:
    """The stretch that is drawn, µm."""

    left: float
    bottom: float
    width: float
    middle: float
    """Mean height of the line."""

    @classmethod
    def of(cls, profile: Profile, whole: Paths, width: float) -> _Window:
        """The stretch of that width whose middle part has the most hits of light that hits more than once."""
        left = profile.left - width / 2
        if width < profile.period:
            places = (whole.points[1:, whole.hits > 1, 0] - profile.left) % profile.period
            heights, edges = np.histogram(places[np.isfinite(places)], 200, (0.0, profile.period))
            part = max(1, round(200 * 0.7 * width / profile.period))
            sums = np.convolve(np.concatenate([heights, heights[:part]]), np.ones(part), mode="valid")[:200]
            left = profile.left + edges[int(sums.argmax())] + (edges[part] - width) / 2
        shown = profile.between(left, left + width).ends[..., 1]
        return cls(left, float(shown.min()) - 0.09 * width, width, float((shown.min() + shown.max()) / 2))

    @property
    def right(self) -> float:
        return self.left + self.width

    @property
    def top(self) -> float:
        return self.bottom + RATIO * self.width


def _evenly(left: float, width: float, count: int) -> Floats:
    """The middles of `count` equal parts."""
    return left + width * (np.arange(count) + 0.5) / count


def _enough(profile: Profile) -> int:
    """How many rays tell the shares to a percent or so, in a second or so."""
    return int(np.clip(1e7 / len(profile.ends), 1000, 20_000))


def stretch(relief: HeightField | Mesh, profile: Profile, ratio: float) -> float:
    """The width, µm, that shows a few bumps and, in a picture `ratio` times as high, leaves room above them."""
    tall = float(np.ptp(profile.ends[..., 1]))
    if isinstance(relief, HeightField):
        length = relief.statistics().correlation_length_x
        return max(profile.period if length is None else min(5 * length, profile.period), tall / (0.6 * ratio))
    start, end = profile.ends[profile.ends[:, 0, 0].argsort()].swapaxes(0, 1)
    rises = np.sign(np.round(end[:, 1] - start[:, 1], 12))
    rises = rises[rises != 0]
    bumps = int(((rises > 0) & (np.roll(rises, -1) < 0)).sum())
    return max(3 * profile.period / max(bumps, 1), tall / (0.6 * ratio))


def _draw_solid(panel: Axes, window: _Window, profile: Profile, pieces: Floats, bands: dict[str, Flags]) -> None:
    """The body, its outline, and inside of it the bands."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import PathPatch

    shown = profile.between(window.left, window.right).ends
    solid = body(shown, window.bottom - window.width)
    panel.add_patch(PathPatch(solid, facecolor=PAPER, edgecolor="none"))
    for colour, flags in bands.items():
        runs = _runs(pieces[flags], profile.period)
        copies = [
            run + np.array([k * profile.period, 0.0]) for run in runs for k in profile.copies(window.left, window.right)
        ]
        band = LineCollection(copies, colors=colour, lw=11, capstyle="butt", joinstyle="round")
        panel.add_collection(band)
        band.set_clip_path(solid, panel.transData)
    panel.add_collection(LineCollection(list(shown), colors=INK, lw=1.6, capstyle="round"))
    panel.set(xlim=(window.left, window.right), ylim=(window.bottom, window.top), aspect="equal", xticks=[], yticks=[])
    for spine in panel.spines.values():
        spine.set(color="#b9b9b4")


def _runs(pieces: Floats, period: float) -> list[Floats]:
    """Polylines (m, 2) of the pieces that follow one another."""
    if not len(pieces):
        return []
    apart = np.abs(pieces[1:, 0] - pieces[:-1, 1]).max(axis=1) > 1e-9 * period
    groups = np.split(pieces, np.flatnonzero(apart) + 1)
    return [np.concatenate([group[:, 0], group[-1:, 1]]) for group in groups]


def body(ends: Floats, floor: float) -> Outline:
    """What lies below the segments: the sum of the strips below them, those under overhangs counted negative."""
    from matplotlib.path import Path as Outline

    below = ends[:, ::-1].copy()
    below[..., 1] = floor
    corners = np.concatenate([ends, below, ends[:, :1]], axis=1).reshape(-1, 2)
    codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY]
    return Outline(corners, np.tile(np.array(codes, np.uint8), len(ends)))


def _draw_rays(panel: Axes, window: _Window, profile: Profile, theta_i: float, count: int) -> None:
    """Rays that cross the middle of the relief at equal distances, leg by leg."""
    way = incident(theta_i)
    crossing = _evenly(window.left, window.width, count)
    traced = trace(profile, crossing + way[0] / way[1] * (profile.top - window.middle), theta_i)
    for number, (start, end) in _legs(traced, way, 4 * window.width):
        colour = HITS[min(number, 3)]
        panel.plot(
            *np.stack([start, end], axis=1), color=colour, lw=1.8, solid_capstyle="round", zorder=3 + number / 1e3
        )
        visible = _clipped(start, end, window)
        if visible is not None:
            _arrowhead(panel, *visible, colour, window)


def _legs(traced: Paths, way: Floats, far: float) -> Iterator[tuple[int, tuple[Floats, Floats]]]:
    """The number of hits so far and both ends of every straight piece of every path, `far` µm before and after."""
    for k, hits in enumerate(traced.hits):
        points = list(traced.points[: hits + 1, k])
        points[0] = points[0] - far * way
        if np.isfinite(traced.leaving[k]).all():
            points.append(points[-1] + far * traced.leaving[k])
        yield from enumerate(pairwise(points))


def _clipped(start: Floats, end: Floats, window: _Window) -> tuple[Floats, Floats] | None:
    """What of a leg is seen; None for nothing."""
    low, high = np.array([window.left, window.bottom]), np.array([window.right, window.top])
    along = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.stack([(low - start) / along, (high - start) / along])
    sides = np.where(along == 0, np.array([[-np.inf], [np.inf]]), sides)
    first, last = max(0.0, float(sides.min(axis=0).max())), min(1.0, float(sides.max(axis=0).min()))
    outside = ((along == 0) & ((start < low) | (start > high))).any()
    return None if outside or first >= last else (start + first * along, start + last * along)


def _arrowhead(panel: Axes, start: Floats, end: Floats, colour: str, window: _Window) -> None:
    """A head a bit behind the middle of a leg that is long enough to carry one."""
    length = float(np.hypot(*(end - start)))
    if length < 0.035 * window.width:
        return
    tip = start + (end - start) * min(0.6 + 0.01 * window.width / length, 0.9)
    tail = tip - (end - start) / length * 1e-3 * window.width
    style = {"arrowstyle": "-|>,head_length=0.5,head_width=0.22", "color": colour, "lw": 0, "mutation_scale": 16}
    panel.annotate("", tuple(tip), tuple(tail), arrowprops={**style, "shrinkA": 0, "shrinkB": 0}, zorder=5)


def round_length(width: float) -> float:
    """The longest round length, µm, that is at most a fifth of `width`."""
    rounds = np.outer(10.0 ** np.arange(-6, 8), (1, 2, 5)).ravel()
    return float(rounds[rounds <= width / 5].max())


def _scale_bar(panel: Axes, window: _Window) -> None:
    length = round_length(window.width)
    x, y = window.left + 0.03 * window.width, window.bottom + 0.022 * window.width
    panel.plot([x, x + length], [y, y], color=INK, lw=4, solid_capstyle="butt", zorder=6)
    panel.text(
        x + length / 2, y + 0.008 * window.width, f"{length:g} µm", color=INK, fontsize=13, ha="center", zorder=6
    )


def _tell(panel: Axes, theta_i: float, share: Floats, shadowed: float) -> None:
    """Beside the picture: where the lamp is, what the colours mean, and how much light they carry."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    panel.set(xlim=(-1.1, 1.1), ylim=(-5.4, 1.6), aspect="equal")
    panel.set_axis_off()
    _lamp(panel, theta_i)
    words = ("leaves after 1 hit", "leaves after 2 hits", "leaves after 3 or more")
    handles: list[Artist] = [Line2D([], [], color=LAMP, lw=3, label="from the lamp")]
    for colour, text, part in zip(HITS[1:], words, share, strict=True):
        handles.append(Line2D([], [], color=colour, lw=3, label=f"{text}:\n{percent(part)} of the light"))
    handles.append(Patch(color=SHADOWED, lw=0, label=f"shadowed: no direct light,\n{percent(shadowed)} of the plane"))
    masked = percent(1 - share[0])
    handles.append(Patch(color=MASKED, lw=0, label=f"masked: its reflection is\nblocked, {masked} of the light"))
    panel.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.75),
        fontsize=12,
        labelcolor=INK,
        frameon=False,
        labelspacing=0.9,
    )


def _lamp(panel: Axes, theta_i: float) -> None:
    """The direction of the light against the normal."""
    way = incident(theta_i)
    panel.plot([-1.0, 1.0], [0.0, 0.0], color=INK, lw=1.5)
    panel.plot([0.0, 0.0], [0.0, 1.3], color=INK, lw=1.2, ls="--")
    style = {"arrowstyle": "-|>", "color": LAMP, "lw": 3, "mutation_scale": 20, "shrinkA": 0, "shrinkB": 0}
    panel.annotate("", (0.0, 0.0), tuple(-1.2 * way), arrowprops=style)
    arc = np.radians(np.linspace(0.0, theta_i, 40))
    panel.plot(-0.62 * np.sin(arc), 0.62 * np.cos(arc), color=INK, lw=1.2)
    panel.text(0.1, 0.95, f"$\\theta_i$ = {theta_i:g}°", fontsize=13, color=INK)
    panel.text(0.1, 0.6, "lamp", fontsize=13, color=LAMP)


def name(surface: Any) -> str:
    """A recipe with what differs from its defaults; of what has been built, what it is."""
    if isinstance(surface, HeightField | Mesh):
        return {HeightField: "height field", Mesh: "mesh"}[type(surface)]
    told = []
    for field in fields(surface):
        value = getattr(surface, field.name)
        if field.name not in UNTOLD and value is not None and value != getattr(field.default, "default", field.default):
            words = Path(value).name if field.name == "path" else f"{value:g}" if isinstance(value, float) else value
            told.append(f"{field.name} = {words}{UNITS.get(field.name, '')}")
    words = f"{type(surface).__name__}: {', '.join(told)}" if told else type(surface).__name__
    return textwrap.fill(words.replace("$", r"\$"), LINE)


def _head(figure: Figure, surface: Any, profile: Profile, window: _Window, theta_i: float) -> None:
    line = f"cross-section y = {profile.y:.4g} µm, drawn to scale and taken as unchanged along y; mirror reflection"
    part = f"; {window.width:.3g} of {profile.period:.4g} µm" if window.width < profile.period else ""
    figure.suptitle(f"{name(surface)}\n{line}{part}", fontsize=13, color=INK)
