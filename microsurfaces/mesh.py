"""Mesh: triangles that repeat periodically; facet statistics, checks, displacement, exchange with trimesh.

Lengths are in µm. Faces run counter-clockwise seen from outside, that is, from above.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    import trimesh

_BLOCK = 1 << 14  # faces handled at a time: temporaries stay in the cache
_WALL = 1e-9  # facets steeper than this cosine count as vertical
_AREA_TOLERANCE = 1e-6  # relative: how exactly the faces must cover one period

SLOPE_AZIMUTHS = (0.0, 45.0, 90.0, 135.0)
"""Azimuths in degrees along which `Facets` keeps the distribution of the slopes."""

_STEPS = np.outer(2.0 ** np.arange(-13, 7), (1.0, 1.5)).ravel()
_FIRST = (1023 - 13) * 2 - 1  # exponent and first bit of the mantissa of the double before the first step

SLOPES: Floats = np.concatenate([-_STEPS[::-1], _STEPS])
"""Slopes at which that distribution is kept: two an octave from 2⁻¹³ to 96, downhill and uphill."""


@dataclass(frozen=True, kw_only=True)
class Statistics:
    """Roughness of one period, measured on the surface that light meets.

    Heights follow ISO 25178-2: arithmetic mean `Sa` and rms `Sq` (µm), skewness `Ssk`, kurtosis `Sku` (3 for a
    Gaussian), rms gradient `Sdq`. Slopes are those of the facets, weighted by the facets' area in the macroscopic
    plane. `beckmann_alpha_x` = √2 `rms_slope_x` is the roughness of the Beckmann distribution with that rms slope, and
    `beckmann_alpha` the m of an isotropic one: m² = <p²> + <q²>. `correlation_length_x` (µm) is the lag at which the
    periodic autocorrelation of the heights first falls to 1/e; `correlation_length` is the geometric mean of both.

    None says that a number has no meaning here: slopes where walls are vertical (their moments diverge), heights where
    the surface overhangs, shape of a flat surface, correlation lengths of a mesh.
    """

    Sa: float | None = None
    Sq: float | None = None
    Ssk: float | None = None
    Sku: float | None = None
    Sdq: float | None = None
    rms_slope_x: float | None = None
    rms_slope_y: float | None = None
    beckmann_alpha_x: float | None = None
    beckmann_alpha_y: float | None = None
    beckmann_alpha: float | None = None
    correlation_length_x: float | None = None
    correlation_length_y: float | None = None
    correlation_length: float | None = None

    def as_dict(self) -> dict[str, float | None]:
        """Name to value, in the order of the fields; plain Python numbers, so that it goes into JSON."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class Facets:
    """What the facets of one period are like: how fine they are, how they are tilted, how far the surface is smooth.

    `spacing` (µm along x and y) is the distance of the nodes of a height field, and for any other mesh the median over
    its triangles of their shortest edge. `radius_of_curvature` (µm) is 1 / the rms second derivative of a height field,
    along x or y, where that is larger; of a mesh with exact normals the smallest radius; None where there is none: a
    plane, or edges. `slope_cdf` (4, 80) is the share of the plane in which the slope along `SLOPE_AZIMUTHS` is at most
    `SLOPES`; what overhangs or stands upright is left out.
    """

    triangles: int
    period: tuple[float, float]
    spacing: tuple[float, float]
    single_valued: bool
    radius_of_curvature: float | None
    slope_cdf: Floats

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, so that it goes into JSON; shares to nine decimals."""
        return {**self.__dict__, "slope_cdf": self.slope_cdf.round(9).tolist()}

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Self:
        """From what `as_dict` made."""
        (px, py), (dx, dy) = table["period"], table["spacing"]
        cdf = np.asarray(table["slope_cdf"], np.float64)
        return cls(**{**table, "period": (px, py), "spacing": (dx, dy), "slope_cdf": cdf})

    def pooled(self, other: Facets, count: int, others: int) -> Facets:
        """The mean of this over `count` specimens and of `other` over `others`."""
        share = count / (count + others)
        radii = self.radius_of_curvature, other.radius_of_curvature
        return Facets(
            triangles=self.triangles,
            period=self.period,
            spacing=self.spacing,
            single_valued=self.single_valued and other.single_valued,
            radius_of_curvature=None if None in radii else share * radii[0] + (1 - share) * radii[1],  # type: ignore[operator]
            slope_cdf=share * self.slope_cdf + (1 - share) * other.slope_cdf,
        )


class SlopeLaw(NamedTuple):
    """The distribution of the slopes that a recipe asks for along an azimuth, at given slopes, arrays of one shape."""

    cdf: Floats
    """Share of the plane with at most that slope."""
    spread: Floats
    """Standard deviation of that share from one tile to another."""
    rounding: float
    """How far any tile may be from it because its facets are flat."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """One period of a surface as triangles; the arrays are read-only.

    `vertices` (n, 3) µm, `faces` (m, 3) indices, `period` (px, py) µm: the faces are a fundamental domain, shifted
    copies of which tile the plane; it may lie anywhere. `vertex_normals` (n, 3) are the exact unit normals where the
    geometry is smooth by definition, else None. `single_valued` says that the mesh came from a height field.
    """

    vertices: Floats
    faces: NDArray[np.int32]
    period: tuple[float, float]
    vertex_normals: Floats | None = None
    single_valued: bool = False

    def __post_init__(self) -> None:
        """Bring the arrays to their types, without a copy where they have them, and lock them."""
        object.__setattr__(self, "vertices", read_only(self.vertices, np.float64))
        object.__setattr__(self, "faces", read_only(self.faces, np.int32))
        object.__setattr__(self, "period", (float(self.period[0]), float(self.period[1])))
        if self.vertex_normals is not None:
            object.__setattr__(self, "vertex_normals", read_only(self.vertex_normals, np.float64))

    def area_vectors(self) -> Floats:
        """Facet normals times facet areas, (m, 3) µm²; the z component is the area in the macroscopic plane."""
        vectors = np.empty((len(self.faces), 3))
        for start in range(0, len(self.faces), _BLOCK):
            a, b, c = (self.vertices[corner] for corner in self.faces[start : start + _BLOCK].T)
            np.multiply(np.cross(b - a, c - a), 0.5, out=vectors[start : start + _BLOCK])
        return vectors

    def normals(self) -> Floats:
        """Unit facet normals (m, 3), outward."""
        vectors = self.area_vectors()
        vectors /= _length(vectors)[:, None]
        return vectors

    def areas(self) -> Floats:
        """True facet areas (m,) µm²."""
        return _length(self.area_vectors())

    def statistics(self) -> Statistics:
        """Roughness of the mesh; heights are integrated exactly over the flat facets, as seen from above."""
        vectors = self.area_vectors()
        cosines = vectors[:, 2] / _length(vectors)
        if np.any(cosines < -_WALL):
            return Statistics()
        heights = _height_moments(self.vertices[:, 2][self.faces], vectors[:, 2])
        exact = cosines if self.vertex_normals is None else self.vertex_normals[:, 2]
        if min(cosines.min(), exact.min()) < _WALL:
            return Statistics(**heights)
        total = vectors[:, 2].sum()
        squares = (float(np.sum(vectors[:, k] ** 2 / vectors[:, 2]) / total) for k in (0, 1))
        return Statistics(**heights, **slope_moments(*squares))

    @functools.cached_property
    def facets(self) -> Facets:
        """Fineness, tilt and curvature of the facets."""
        vectors = self.area_vectors()
        vectors = vectors[vectors[:, 2] > _WALL * _length(vectors)]
        p, q = -vectors[:, 0] / vectors[:, 2], -vectors[:, 1] / vectors[:, 2]
        edge = float(np.median(self._edges(self.vertices).min(axis=1)))
        return Facets(
            triangles=len(self.faces),
            period=self.period,
            spacing=(edge, edge),
            single_valued=self.single_valued,
            radius_of_curvature=self._smallest_radius(),
            slope_cdf=slope_cdf(p, q, vectors[:, 2]),
        )

    def slope_distribution(self, bins: int = 101, limit: float | None = None) -> tuple[Floats, Floats, Floats]:
        """Density of the facet slopes (p, q) = (dz/dx, dz/dy), weighted by area in the plane: P22, (bins, bins).

        Returns (density, p_edges, q_edges) as `numpy.histogram2d` does. The density integrates to the share of the
        plane whose slopes lie within ±`limit` (the largest slope if None).
        """
        vectors = self.area_vectors()
        vectors = vectors[vectors[:, 2] > _WALL * _length(vectors)]
        p, q = -vectors[:, 0] / vectors[:, 2], -vectors[:, 1] / vectors[:, 2]
        return slope_density(p, q, vectors[:, 2] / np.prod(self.period), bins, limit)

    def normal_distribution(self, theta_bins: int = 90, phi_bins: int = 1) -> tuple[Floats, Floats, Floats]:
        """Distribution of the facet normals D (theta_bins, phi_bins) in 1/sr: true area per plane area and solid angle.

        Returns (D, theta_edges, phi_edges), edges in degrees; ∫ D cosθ dω = 1 over the upper hemisphere where nothing
        overhangs. Facets that face down are not counted.
        """
        vectors = self.area_vectors()
        areas = _length(vectors)
        return normal_density(vectors / areas[:, None], areas / np.prod(self.period), theta_bins, phi_bins)

    def check(self) -> None:
        """Raise ValueError, in one sentence, unless the faces are one upward period of sound triangles."""
        n, m = len(self.vertices), len(self.faces)
        if self.vertices.shape != (n, 3) or self.faces.shape != (m, 3) or n < 3 or m < 1:
            raise ValueError(
                f"vertices has shape {self.vertices.shape} and faces {self.faces.shape}: "
                "expected (n, 3) and (m, 3) with at least one face"
            )
        if bad := int(np.count_nonzero(~np.isfinite(self.vertices).all(axis=1))):
            raise ValueError(
                f"{bad} of {n} vertices are NaN or infinite: expected finite coordinates in µm; repair the mesh"
            )
        if self.faces.min() < 0 or self.faces.max() >= n:
            raise ValueError(
                f"faces refers to vertices {self.faces.min()} to {self.faces.max()}: expected indices from 0 to {n - 1}"
            )
        if not all(np.isfinite(p) and p > 0 for p in self.period):
            raise ValueError(f"period is {self.period}: expected two positive lengths in µm")
        if self.vertex_normals is not None and self.vertex_normals.shape != (n, 3):
            raise ValueError(
                f"vertex_normals has shape {self.vertex_normals.shape}: expected ({n}, 3), one normal a vertex"
            )
        self._check_cover()

    def _check_cover(self) -> None:
        """Degenerate faces, wrong orientation and an open period."""
        vectors = self.area_vectors()
        areas, m = _length(vectors), len(vectors)
        if bad := int(np.count_nonzero(areas <= 1e-12 * areas.mean())):
            raise ValueError(f"{bad} of {m} faces are degenerate (no area): remove them or merge their vertices")
        expected, total = self.period[0] * self.period[1], float(vectors[:, 2].sum())
        if abs(total - expected) <= _AREA_TOLERANCE * expected:
            return
        if abs(total + expected) <= _AREA_TOLERANCE * expected:
            raise ValueError(
                "the faces point down: expected counter-clockwise order seen from above; reverse every face"
            )
        if abs(np.abs(vectors[:, 2]).sum() - expected) <= _AREA_TOLERANCE * expected:
            bad = int(np.count_nonzero(vectors[:, 2] < 0))
            raise ValueError(
                f"{bad} of {m} faces point down in a mesh that does not overhang: orient all faces upwards"
            )
        raise ValueError(
            f"the faces cover {total:.9g} µm² seen from above, but one period of {self.period[0]:.9g} x "
            f"{self.period[1]:.9g} µm is {expected:.9g} µm²: give the mesh's own period and unit, and close its holes"
        )

    def displaced(self, displacement: Callable[[Floats], ArrayLike] | ArrayLike) -> Mesh:
        """The mesh with every vertex moved along its normal by `displacement` µm.

        `displacement` is an array (n,) or a function of the vertices (n, 3) that returns one. Normals are the
        area-weighted means over all facets that meet at a point of the periodic surface; copies of one point, at the
        seams and at creases, move together (by the value of the first), so that nothing tears.
        """
        values = np.asarray(displacement(self.vertices) if callable(displacement) else displacement, dtype=np.float64)
        if values.shape != (len(self.vertices),):
            raise ValueError(
                f"displacement has shape {values.shape}: expected ({len(self.vertices)},), one value a vertex"
            )
        points, first = self._points()
        normals = np.zeros((len(first), 3))
        vectors = self.area_vectors()
        for corner in self.faces.T:
            np.add.at(normals, points[corner], vectors)
        normals /= _length(normals)[:, None]
        return Mesh(self.vertices + (values[first][:, None] * normals)[points], self.faces, self.period)

    def _edges(self, values: Floats) -> Floats:
        """How far apart `values` (n, 3) are at the ends of every facet's edges, (m, 3)."""
        corners = [values[corner] for corner in self.faces.T]
        return np.stack([_length(b - a) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)], axis=1)

    def _smallest_radius(self) -> float | None:
        """Radius of curvature where the exact normals turn fastest; None where there are none or nothing turns."""
        if self.vertex_normals is None:
            return None
        curvature = float((self._edges(self.vertex_normals) / self._edges(self.vertices)).max())
        return 1 / curvature if curvature > 0 else None

    def _points(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """For each vertex the point of the periodic surface it lies on, and for each point its first vertex."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import cKDTree

        low = self.vertices.min(axis=0)
        box = np.array([*self.period, 0.0])
        wrapped = self.vertices - low
        wrapped[:, :2] %= box[:2]
        pairs = cKDTree(np.minimum(wrapped, np.where(box > 0, np.nextafter(box, 0), np.inf)), boxsize=box).query_pairs(
            1e-7 * max(self.period), output_type="ndarray"
        )
        n = len(self.vertices)
        graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
        points = connected_components(graph, directed=False)[1]
        return points, np.unique(points, return_index=True)[1]

    def to_trimesh(self) -> trimesh.Trimesh:
        """The same triangles as a `trimesh.Trimesh`; the period is in its `metadata`."""
        import trimesh

        return trimesh.Trimesh(
            self.vertices,
            self.faces,
            vertex_normals=self.vertex_normals,
            metadata={"period": self.period},
            process=False,
        )

    @staticmethod
    def from_trimesh(mesh: trimesh.Trimesh, period: tuple[float, float]) -> Mesh:
        """One period from a `trimesh.Trimesh` in µm, checked; raises ValueError if it is not sound."""
        result = Mesh(np.array(mesh.vertices), np.array(mesh.faces), period)
        result.check()
        return result


def read_only(values: ArrayLike, dtype: Any) -> NDArray[Any]:
    """A C-ordered view that cannot be written to; a copy only where type or order ask for one."""
    view = np.ascontiguousarray(values, dtype=dtype).view()
    view.flags.writeable = False
    return view


def slope_moments(variance_x: float, variance_y: float) -> dict[str, float]:
    """The slope fields of `Statistics` from <p²> and <q²>."""
    total, x, y = (float(np.sqrt(v)) for v in (variance_x + variance_y, variance_x, variance_y))
    return {
        "Sdq": total,
        "rms_slope_x": x,
        "rms_slope_y": y,
        "beckmann_alpha_x": float(np.sqrt(2)) * x,
        "beckmann_alpha_y": float(np.sqrt(2)) * y,
        "beckmann_alpha": total,
    }


def height_fields(mean_abs: float, second: float, third: float, fourth: float) -> dict[str, float | None]:
    """The height fields of `Statistics` from the central moments; a flat surface has no shape."""
    Sq = float(np.sqrt(second))
    shape = (float(third / Sq**3), float(fourth / Sq**4)) if Sq > 0 else (None, None)
    return {"Sa": float(mean_abs), "Sq": Sq, "Ssk": shape[0], "Sku": shape[1]}


def slope_cdf(p: Floats, q: Floats, weights: Floats | None = None) -> Floats:
    """Share of the weight of slopes (p, q), arrays (m,), whose slope along `SLOPE_AZIMUTHS` is at most `SLOPES`."""
    classes = len(_STEPS) + 1
    sums = np.zeros((len(SLOPE_AZIMUTHS), 2 * classes))
    for start in range(0, len(p), _BLOCK):
        block = slice(start, start + _BLOCK)
        for row, azimuth in zip(sums, np.radians(SLOPE_AZIMUTHS), strict=True):
            along = np.cos(azimuth) * p[block] + np.sin(azimuth) * q[block]
            # The steps are where the exponent or the first bit of the mantissa changes.
            index = np.clip((np.abs(along).view(np.int64) >> 51) - _FIRST, 0, classes - 1) + classes * (along < 0)
            row += np.bincount(index, None if weights is None else weights[block], 2 * classes)
    beyond = np.cumsum(sums.reshape(-1, 2, classes)[..., ::-1], axis=-1)[..., ::-1] / sums.sum(axis=1)[:, None, None]
    return np.concatenate([beyond[:, 1, :0:-1], 1 - beyond[:, 0, 1:]], axis=1)


def slope_density(
    p: Floats, q: Floats, weights: Floats, bins: int, limit: float | None
) -> tuple[Floats, Floats, Floats]:
    """Weighted density of slopes in a square of half-width `limit`: (density, p_edges, q_edges)."""
    if limit is None:
        limit = max(float(np.abs(p).max()), float(np.abs(q).max())) * (1 + 1e-9) or 1.0
    edges = np.linspace(-limit, limit, bins + 1)
    sums = np.histogram2d(p.ravel(), q.ravel(), bins=(edges, edges), weights=weights.ravel())[0]
    return sums / (edges[1] - edges[0]) ** 2, edges, edges.copy()


def normal_density(normals: Floats, weights: Floats, theta_bins: int, phi_bins: int) -> tuple[Floats, Floats, Floats]:
    """Weight per solid angle of unit normals (m, 3) with z ≥ 0: (density, theta_edges, phi_edges) in degrees."""
    theta_edges, phi_edges = np.linspace(0, 90, theta_bins + 1), np.linspace(0, 360, phi_bins + 1)
    sums = np.zeros((theta_bins, phi_bins))
    for start in range(0, len(normals), _BLOCK):
        x, y, z = normals[start : start + _BLOCK].T
        theta, phi = np.degrees(np.arctan2(np.hypot(x, y), z)), np.degrees(np.arctan2(y, x)) % 360
        sums += np.histogram2d(theta, phi, bins=(theta_edges, phi_edges), weights=weights[start : start + _BLOCK])[0]
    solid_angles = -np.diff(np.cos(np.radians(theta_edges))) * np.radians(360 / phi_bins)
    return sums / solid_angles[:, None], theta_edges, phi_edges


def _length(vectors: Floats) -> Floats:
    squares: Floats = np.einsum("ij,ij->i", vectors, vectors)
    return np.sqrt(squares, out=squares)


def _height_moments(z: Floats, weights: Floats) -> dict[str, float | None]:
    """Central moments of heights linear over triangles with corners z (m, 3), exact: ∫ z^k = 2 k!/(k+2)! h_k(z) A.

    h_k is the complete homogeneous symmetric polynomial of the three corners.
    """
    z = z - np.average(z.mean(axis=1), weights=weights)
    a, b, c = z.T
    h2 = a * a + b * b + c * c + a * b + b * c + c * a
    h3 = (a + b + c) * h2 - (a * b + b * c + c * a) * (a + b + c) + a * b * c
    h4 = (a + b + c) * h3 - (a * b + b * c + c * a) * h2 + a * b * c * (a + b + c)
    means = (np.average(v, weights=weights) for v in (_mean_absolute(z), h2 / 6, h3 / 10, h4 / 15))
    return height_fields(*means)


def _mean_absolute(z: Floats) -> Floats:
    """Mean of |z| over triangles on which z is linear, from the corners z (m, 3).

    The corner that lies alone on its side of zero cuts off a smaller triangle, of mean height z_alone / 3.
    """
    low, middle, high = np.sort(z, axis=1).T
    alone, others = np.where(middle > 0, -low, high), np.where(middle > 0, -high, low)
    between = np.where(middle > 0, -middle, middle)
    crosses = (low < 0) & (high > 0)
    cut = np.where(crosses, alone**3, 0) / np.where(crosses, (alone - others) * (alone - between), 1) / 3
    mean: Floats = np.where(crosses, 2 * cut - (alone + others + between) / 3, np.abs(low + middle + high) / 3)
    return mean
