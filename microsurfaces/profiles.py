"""Surfaces given by a profile that runs along y: the plane, micro-cylinders, V-grooves."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from microsurfaces.arrays import Floats
from microsurfaces.height_field import HeightField
from microsurfaces.mesh import Mesh, SlopeLaw
from microsurfaces.recipe import Positive, recipe
from microsurfaces.seeds import derived_seed


@recipe
class Flat:
    """A perfectly flat surface: the plane z = 0.

    Use it to check an instrument: a flat mirror must send everything into one direction, a flat Lambertian surface of
    reflectance R must give R/π everywhere.
    """

    side: Positive = 100.0
    """Side of the square tile, µm; no result depends on it."""

    def build(self, seed: int, realisation: int = 0, realisations: int = 1) -> HeightField:
        """The plane, 2 x 2 nodes; the same for every seed and realisation."""
        return HeightField(np.zeros((2, 2)), (self.side / 2, self.side / 2))

    def expected_slopes(self, azimuth: float, slopes: Floats) -> SlopeLaw:
        """Distribution of the slopes along `azimuth`, degrees, at `slopes`: all of them are 0."""
        return _both_ways(np.ones_like, azimuth, slopes, 0.0, 0.0)


@recipe
class Cylinders:
    """Parallel micro-cylinders along y, ridges or grooves: brushed metal, hair, the surface of Poulin and Fournier.

    Ridges are the tops of cylinders of one `radius` whose axes lie in the plane z = 0, `distance` radii apart, above a
    floor at z = h `radius`. Grooves are their exact mirror image in z: cylinders pressed into a plane, with flat lands
    between them. With d the distance, the normals of the exposed arc go up to the angle

        phi_e = min(asin(min(d/2, 1)), acos(h))        from z,

    and a flat strip of w = max(0, d - 2 sin(phi_e)) radii is left over in each period of d radii.

    A feel for the numbers: distance 2 on floor 0 are touching half-cylinders, every normal from wall to wall and the
    strongest anisotropy; both a small and a large distance lead back to the plane, as does a floor close to 1. For
    d < 2 the floor is hidden until h > √(1 - d²/4).

    One period is meshed, uniformly in the angle of the normal and with exact vertex normals, so that vertical walls
    (h = 0, d ≥ 2) are right; their slope moments diverge and are None in the statistics. The tile is square and its
    seams lie on the highest points.

    Reference: P. Poulin and A. Fournier, A model for anisotropic reflection, doi:10.1145/97880.97909.
    """

    profile: Literal["ridges", "grooves"] = "ridges"
    """Cylinders that stand out of the surface, or that are cut into it."""
    distance: Positive = 2.0
    """Distance d between neighbouring axes, in radii."""
    floor_height: Annotated[float, Field(ge=0, lt=1)] | None = None
    """Height h of the floor above the axes, in radii (of grooves: depth of the lands below them); 0 if not given."""
    protrusion: Annotated[float, Field(gt=0, le=1)] | None = None
    """1 - h, how far ridges stand out of the floor in radii: give this or the floor height."""
    radius: Positive = 10.0
    """Radius of the cylinders, µm."""
    chords: Annotated[int, Field(ge=8, le=100_000)] = 256
    """Facets over half a turn (180°) of the cylinder; with exact normals 256 are enough for bins of 1°."""

    @model_validator(mode="after")
    def _one_floor(self) -> Cylinders:
        if self.floor_height is not None and self.protrusion is not None:
            raise ValueError(
                f"floor_height = {self.floor_height:g} and protrusion = {self.protrusion:g}: both name one height "
                "(protrusion = 1 - floor_height), give one of them"
            )
        return self

    def edge_angle(self) -> float:
        """phi_e, the largest angle between z and a normal of the exposed arc, radians."""
        h = 1 - self.protrusion if self.protrusion is not None else self.floor_height or 0.0
        return float(min(np.arcsin(min(self.distance / 2, 1.0)), np.arccos(h)))

    def expected_slopes(self, azimuth: float, slopes: Floats) -> SlopeLaw:
        """Distribution of the slopes along `azimuth`, degrees, at `slopes`; facets are off by half a chord at most."""
        edge = self.edge_angle()
        level = max(0.0, self.distance - 2 * math.sin(edge))

        def within(steepness: Floats) -> Floats:
            """Share of the plane whose slope across the cylinders is at most that, either way."""
            inside = np.minimum(np.sin(np.arctan(steepness)), math.sin(edge))
            return np.asarray((level + 2 * inside) / (level + 2 * math.sin(edge)))

        return _both_ways(within, azimuth, slopes, 0.0, edge / self._chords() / 2 / self.distance)

    def _chords(self) -> int:
        """Facets of half an arc."""
        return max(8, math.ceil(self.chords * self.edge_angle() / np.pi))

    def build(self, seed: int, realisation: int = 0, realisations: int = 1) -> Mesh:
        """One period, the same for every seed and realisation."""
        edge = self.edge_angle()
        angles = np.linspace(0, edge, self._chords() + 1)
        flat = self.distance / 2 - math.sin(edge) > 1e-12  # else cusps: both arcs end in the very same line
        half = self.distance / 2 if flat else float(np.sin(angles)[-1])
        if self.profile == "ridges":
            left, right = _arc(-half, angles, 1), _arc(half, -angles[::-1], 1)
            pieces = [left, _level(left[-1, 0], right[0, 0], left[-1, 1]), right] if flat else [left, right]
        else:
            arc = _arc(0.0, np.concatenate([angles[::-1], -angles[1:]]), -1)
            lands = [_level(-half, arc[0, 0], arc[0, 1]), _level(arc[-1, 0], half, arc[-1, 1])]
            pieces = [lands[0], arc, lands[1]] if flat else [arc]
        vertices, normals, faces = _extruded(pieces, self.radius, 2 * half)
        return Mesh(vertices, faces, (2 * half * self.radius,) * 2, vertex_normals=normals)


@recipe
class VGrooves:
    """Symmetric V-grooves along y with coplanar upper edges: the surface of Torrance, Sparrow, Cook.

    All grooves have one `width`, independent of their slope, and their upper edges lie in the plane z = 0. An ensemble
    of them, averaged over all azimuths (`azimuth = "average"` of the goniometer), has exactly the single-scattering
    BRDF of Cook and Torrance, F D G / (4 cos cos) with G = min(1, ...), where the slopes follow Beckmann's distribution
    with roughness m:

        tan(angle) = m √(-ln(1 - u)),        u uniform in (0, 1), stratified over the grooves, in random order.

    The steepest slopes are cut at u = 1 - 1e-4, 3.03 m. With `angle` instead of m all grooves are the same: 45° turns
    the surface into a retroreflector across the grooves.

    A feel for the numbers: light leaves a groove of angle a after at most ceil(180 / (180 - 2 a)) hits. A result for
    the ensemble needs many grooves, paths/500 at the very least, paths/100 for a strict test, and many small tiles are
    better than one large one: measure many realisations of 64 grooves. `build(seed, k, K)` for k in range(K)
    stratifies the slopes of each tile and of all K tiles together.

    References: K. E. Torrance and E. M. Sparrow, Theory for off-specular reflection from roughened surfaces,
    doi:10.1364/JOSA.57.001105; R. L. Cook and K. E. Torrance, A reflectance model for computer graphics,
    doi:10.1145/357290.357293.
    """

    m: Positive | None = None
    """Roughness of Beckmann's distribution of slopes."""
    angle: Annotated[float, Field(gt=0, lt=90)] | None = None
    """One angle for every facet, from the horizontal, degrees: give this or m."""
    grooves: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """Grooves in a tile: 64 if not given, or 1 where they are all alike."""
    width: Positive = 2.0
    """Width of a groove, edge to edge, µm."""

    stratified: ClassVar[bool] = True
    """Whether a realisation depends on how many there are."""

    @model_validator(mode="after")
    def _one_slope(self) -> VGrooves:
        if (self.m is None) == (self.angle is None):
            found = "m is missing" if self.m is None else f"m = {self.m:g} and angle = {self.angle:g}"
            raise ValueError(f"{found}: give either m (a distribution of slopes) or angle (one slope)")
        return self

    def build(self, seed: int, realisation: int = 0, realisations: int = 1) -> Mesh:
        """Tile number `realisation` of `realisations` whose slopes are stratified over all of them together."""
        if not 0 <= realisation < realisations:
            raise ValueError(
                f"realisation = {realisation}: expected 0 to {realisations - 1}, there are {realisations} of them"
            )
        slopes = self._slopes(seed, realisations)[realisation]
        count = len(slopes)
        profile = np.zeros((2 * count + 1, 2))
        profile[:, 0] = (np.arange(2 * count + 1) - count) / 2
        profile[1::2, 1] = -slopes / 2
        vertices, _, faces = _extruded([profile], self.width, count)
        return Mesh(vertices, faces, (count * self.width,) * 2)

    def expected_slopes(self, azimuth: float, slopes: Floats) -> SlopeLaw:
        """Distribution of the slopes along `azimuth`, degrees, at `slopes`.

        The slopes are stratified: however the distribution is cut, all but one of the grooves lie on a known side.
        """
        if self.m is None:
            angle = math.tan(math.radians(self.angle or 0.0))
            return _both_ways(lambda slope: np.where(slope < angle, 0.0, 1.0), azimuth, slopes, 0.0, 0.0)
        m = self.m

        def within(slope: Floats) -> Floats:
            """Share of the grooves that are at most that steep."""
            return np.where(slope < m * math.sqrt(-math.log(1e-4)), -np.expm1(-((slope / m) ** 2)), 1.0)

        return _both_ways(within, azimuth, slopes, 1 / (4 * (self.grooves or 64)), 0.0)

    def _slopes(self, seed: int, tiles: int) -> Floats:
        """tan of the facet angle of every groove of every tile, (tiles, grooves).

        The distribution is cut into as many equal shares as there are grooves; each tile has one slope of each share,
        and the slopes that the tiles have of one share are stratified in turn.
        """
        if self.m is None:
            return np.full((tiles, self.grooves or 1), math.tan(math.radians(self.angle or 0.0)))
        random = np.random.Generator(np.random.Philox(derived_seed(seed, "surface")))
        count = self.grooves or 64
        ranks = random.permuted(np.arange(count * tiles).reshape(count, tiles), axis=1).T
        u = np.minimum((ranks + random.random(ranks.shape)) / ranks.size, 1 - 1e-4)
        return random.permuted(self.m * np.sqrt(-np.log1p(-u)), axis=1)


def _both_ways(
    within: Callable[[Floats], Floats], azimuth: float, slopes: Floats, spread: float, rounding: float
) -> SlopeLaw:
    """The law of a profile along y that rises as often as it falls, `within` being the law of its steepness."""
    steepness = np.abs(slopes) / max(abs(math.cos(math.radians(azimuth))), 1e-9)
    cdf = (1 + np.where(slopes < 0, -1, 1) * within(np.minimum(steepness, 1e9))) / 2
    return SlopeLaw(cdf, np.full(slopes.shape, spread), rounding)


def _arc(centre: float, angles: Floats, sign: int) -> Floats:
    """Points of the unit circle about (centre, 0) with normals at `angles` from z: rows x, z, normal x, normal z.

    `sign` is 1 where the normals point away from the centre (a ridge) and -1 where they point to it (a groove).
    """
    sine, cosine = np.sin(angles), np.cos(angles)
    return np.stack([centre + sign * sine, sign * cosine, sine, cosine], axis=-1)


def _level(start: float, end: float, z: float) -> Floats:
    """A horizontal line from x = start to end, in the columns of `_arc`."""
    return np.array([[start, z, 0.0, 1.0], [end, z, 0.0, 1.0]])


def _extruded(pieces: list[Floats], scale: float, length: float) -> tuple[Floats, Floats, NDArray[np.int32]]:
    """(vertices, normals, faces) of polylines in x and z, x increasing, drawn along y and scaled.

    The pieces share no vertices, so that each keeps its own normals where they meet.
    """
    line = np.concatenate(pieces)
    n, last = len(line), np.cumsum([len(piece) for piece in pieces]) - 1
    vertices = np.empty((2, n, 3))
    vertices[..., 0], vertices[..., 2] = scale * line[:, 0], scale * line[:, 1]
    vertices[..., 1] = scale * np.array([[-length / 2], [length / 2]])
    normals = np.zeros((2, n, 3))
    normals[..., 0::2] = line[:, 2:] if line.shape[1] == 4 else (0.0, 1.0)
    i = np.setdiff1d(np.arange(n), last).astype(np.int32)
    faces = np.stack([i, i + 1, i + n + 1, i, i + n + 1, i + n], axis=-1)
    return vertices.reshape(-1, 3), normals.reshape(-1, 3), faces.reshape(-1, 3)
