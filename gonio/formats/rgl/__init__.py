"""RGL's tensor files (.bsdf): Mitsuba 3 `measured`, pbrt-v4 `measured`, Tekari, powitacq, BSDFProcessor.

The format of EPFL's material database. A BRDF is stored as what remains of it beside a microfacet model: with the half
vector m of wi and wo, a distribution of normals D and its projected area sigma,

    f(wi, wo) cos(theta_o) = S(x, y; wi) D(m) / (4 sigma(wi))

The table S is smooth where f is not, and stands on a square that is warped, for each incidence, so that the nodes lie
close where the lobe is. Any positive D and any warp are exact at the nodes; good ones make S flat between them.

**Container.** `tensor_file\\0`, version 1.0, the number of fields, then for each its name, dimensions, type, offset and
shape; payloads are aligned to 8 bytes, little endian, the last index fastest.

**Fields**, float32. `theta_i` (T) and `phi_i` (P), radians, ascending; one or two azimuths mean an isotropic BRDF,
otherwise they span 2 pi / r, and r = 2 and r = 4 stand for a half turn and for two mirror planes. `ndf`, `sigma`: D and
sigma on a square of rows v = (phi + pi) / 2 pi and columns u = sqrt(2 theta / pi). `vndf` (P, T, v, u): the density of
the nodes on the same square of m, of which phi is counted from phi_i in isotropic files. `luminance` (P, T, y, x): what
samplers multiply it by. `rgb` (P, T, 3, y, x), or `spectra` (P, T, wavelength, y, x) with `wavelengths` in nm: S at
x, y = 0 ... 1, the marginal and conditional distribution functions of `vndf`. `jacobian` (1 here; 0: S is f cos itself)
and `valid` (bits: nodes above the horizon of which something is known) are bytes, `description` is UTF-8.

**What is written.** D is the mean over incidences of 4 f cos(theta_i) cos(theta_o), so that S stays within few powers
of ten whatever the lobe: a diffuse floor or multiple scattering has its place in D. The nodes are not spread as visible
normals are: a share of them evenly over the square, and few below the horizon. The sampling density follows the BRDF
all the same, by `luminance`. Between the known incidences there are as many as it takes; azimuths go all around
(r = 1), because only Mitsuba knows other reductions.

**What is lost.** Values below 0 of a colour; everything finer than the nodes, in lobes narrower than about 2 degrees
first; f (not f cos) within a degree of the horizon, where nodes below it hold 0 and it comes out too large. Mitsuba
leaves r of an isotropic file to chance, so that its rows of sigma must be equal, as ours are. Readers hold the first
and the last theta_i beyond them. A renderer that starts at the eye takes wi for the viewer and wo for the light, which
is the same for a reciprocal BRDF. The colour variant opens in RGB programs only, the spectral variant (pbrt-v4's) in
spectral ones.

Source: J. Dupuy and W. Jakob, An Adaptive Parameterization for Efficient Material Acquisition and Rendering, ACM
Transactions on Graphics 37(6), 2018, doi:10.1145/3272127.3275059; https://github.com/rgl-epfl/brdf-loader.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.brdf import BRDF, NOMINAL
from gonio.detectors import HemisphereGrid
from gonio.sphere import angles, direction, half_vector, reflect
from microsurfaces.arrays import Floats, Vectors
from microsurfaces.atomic_write import atomic_write

Singles = NDArray[np.float32]
Blend: TypeAlias = Sequence[tuple[NDArray[np.intp], Floats]]
"""Slices of a table, and how much each of them counts, for every point."""

GRAZING = 89.99
"""Largest incidence that is written, degrees: at 90 no light falls on the surface."""
THETA_STEP = {True: 3.0, False: 5.0}
"""Largest step between written incidences in degrees, if isotropic and if not."""
STEEP = 75.0
"""Incidence from which steps are half as large: the lobe changes faster there."""
PHI_STEP = 10.0
"""Largest step between their azimuths, degrees."""
FEWEST, MOST = 16, 96
"""Nodes along x and along y."""
BUDGET = 48e6
"""Bytes of a file, beyond which it has fewer nodes."""
COLUMNS = 48
"""Columns and rows of the density of the nodes."""
ESTIMATE = {True: (128, 49), False: (64, 49)}
"""Columns and rows of the square on which D is estimated, if isotropic and if not."""
NDF = 512, 385
"""Columns of D as it is written, and rows if not isotropic."""
SIGMA = 64, 49
"""Columns of sigma, and rows if not isotropic."""
QUADRATURE = 128
"""Midpoints along either side of the square, where D is integrated."""

EVEN = 0.5
"""Share of the nodes that are spread evenly over the square, in u as in v."""
FLATTENED = 0.35
"""Power of D that the others follow: tails are looked at, too."""
RAMP, BELOW = 0.3, 0.02
"""Below the horizon nodes become sparse, down to this share, over this cosine."""
FLOOR = 1e-5
"""Least D, of its maximum: what is nowhere lit gets a finite ratio."""
DIM = 1e-6
"""Least luminance, of its maximum: nothing is impossible to sample."""

MAGIC = b"tensor_file\0\x01\x00"
TYPES = ["u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"]
"""Types of a field's numbers; their codes count from 1."""
ALIGNED = 8
LARGEST, FIELDS = 1 << 31, 256
"""Bytes of the largest file that is read, and how many fields it may have."""
CHUNK = 1 << 16
"""Pairs of directions evaluated at a time."""
BINS = 1 << 23
"""Values of the largest measurement that reading suggests."""


# --- The square ------------------------------------------------------------------------------------------------------


def _normals(u: ArrayLike, v: ArrayLike) -> Vectors:
    """Directions (..., 3) of points on the square."""
    return direction(90 * np.square(u), 360 * np.asarray(v) - 180)


def _square(w: Vectors) -> tuple[Floats, Floats]:
    """The point (u, v) of directions (..., 3)."""
    theta, phi = angles(w)
    return np.sqrt(theta / 90), (phi / 360 + 0.5) % 1


def _solid_angle(u: Floats) -> Floats:
    """In sr per unit of the square's area."""
    return np.asarray(2 * math.pi**2 * u * np.sin(np.square(u) * (math.pi / 2)))


def _cell(x: Floats, count: int) -> tuple[NDArray[np.intp], Floats]:
    """The interval of `count` nodes from 0 to 1 that `x` lies in, and how far in it."""
    at = np.clip(x, 0.0, 1.0) * (count - 1)
    lower = np.minimum(at.astype(np.intp), count - 2)
    return lower, at - lower


def _bilinear(table: NDArray[np.floating], u: Floats, v: Floats) -> Floats:
    """`table` (rows, columns) between its nodes."""
    (i, s), (j, t) = _cell(u, table.shape[1]), _cell(v, table.shape[0])
    upper = (1 - s) * table[j, i] + s * table[j, i + 1]
    return np.asarray((1 - t) * upper + t * ((1 - s) * table[j + 1, i] + s * table[j + 1, i + 1]))


def _blend(*axes: tuple[NDArray[np.floating], Floats]) -> Blend:
    """Slices around values, (nodes, values) for each axis; a table has a slice for every node, those of the last axis
    side by side."""
    blend: list[tuple[NDArray[np.intp], Floats]] = [(np.zeros(axes[0][1].shape, np.intp), np.ones(axes[0][1].shape))]
    for nodes, values in axes:
        if len(nodes) == 1:
            continue
        lower = np.clip(np.searchsorted(nodes, values) - 1, 0, len(nodes) - 2)
        share = np.clip((values - nodes[lower]) / (nodes[lower + 1] - nodes[lower]), 0.0, 1.0)
        blend = [
            (k * len(nodes) + lower + step, weight * part)
            for k, weight in blend
            for step, part in ((0, 1 - share), (1, share))
        ]
    return blend


@dataclass(frozen=True, eq=False)
class Warp:
    """Maps of the unit square, one a slice, under which points (u, v) of a bilinear density become even in (x, y)."""

    density: Floats
    """(slices, rows, columns), each integrating to 1."""
    along: Floats
    """Integrals of the rows up to each column."""
    total: Floats
    """(slices, rows): integrals up to each row."""

    @classmethod
    def of(cls, density: NDArray[np.floating]) -> Self:
        """From a density of any scale. Raises ValueError if a slice is negative, or 0 everywhere."""
        values = np.asarray(density, np.float64)
        if not (values >= 0).all():
            raise ValueError("vndf must not be negative")
        along, total = np.zeros_like(values), np.zeros(values.shape[:2])
        np.cumsum((values[..., 1:] + values[..., :-1]) / (2 * (values.shape[2] - 1)), axis=2, out=along[..., 1:])
        ends = along[..., -1]
        np.cumsum((ends[:, 1:] + ends[:, :-1]) / (2 * (values.shape[1] - 1)), axis=1, out=total[:, 1:])
        whole = total[:, -1:].copy()
        if not (whole > 0).all():
            raise ValueError("vndf is 0 everywhere in one of its slices")
        return cls(values / whole[..., None], along / whole[..., None], total / whole)

    def nodes(self, k: int, count: int) -> tuple[Floats, Floats]:
        """(u, v) of slice `k`, (count, count) each, at even steps in y (rows) and in x (columns)."""
        steps = np.linspace(0.0, 1.0, count)
        rows, columns = self.density.shape[1:]
        row = np.clip(np.searchsorted(self.total[k], steps) - 1, 0, rows - 2)
        ends = self.along[k, :, -1]
        t = _share((steps - self.total[k, row]) * (rows - 1), ends[row], ends[row + 1])[:, None]
        along, density = ((1 - t) * table[k, row] + t * table[k, row + 1] for table in (self.along, self.density))
        wanted = steps * along[:, -1:]
        column = np.clip((along[:, None, :] < wanted[:, :, None]).sum(axis=2) - 1, 0, columns - 2)
        below, left, right = (
            np.take_along_axis(table, index, axis=1)
            for table, index in ((along, column), (density, column), (density, column + 1))
        )
        s = _share((wanted - below) * (columns - 1), left, right)
        return (column + s) / (columns - 1), np.broadcast_to((row[:, None] + t) / (rows - 1), s.shape)

    def invert(self, u: Floats, v: Floats, blend: Blend) -> tuple[Floats, Floats]:
        """(x, y) of points (u, v) between slices: these are blended first, as all readers do."""
        rows, columns = self.density.shape[1:]
        (i, s), (j, t) = _cell(u, columns), _cell(v, rows)

        def at(table: Floats, *index: NDArray[np.intp] | int) -> Floats:
            return np.asarray(sum(weight * table[(k, *index)] for k, weight in blend))

        left, right = ((1 - t) * at(self.density, j, c) + t * at(self.density, j + 1, c) for c in (i, i + 1))
        x = s * (left + s / 2 * (right - left)) / (columns - 1)
        x += (1 - t) * at(self.along, j, i) + t * at(self.along, j + 1, i)
        first, second = at(self.along, j, -1), at(self.along, j + 1, -1)
        y = t * (first + t / 2 * (second - first)) / (rows - 1) + at(self.total, j)
        width = (1 - t) * first + t * second
        return x / np.where(width > 0, width, 1.0), y


def _share(area: Floats, start: Floats, end: Floats) -> Floats:
    """How far, 0 to 1, the line from `start` to `end` has `area` under it."""
    root = start + np.sqrt(np.maximum(start**2 + 2 * area * (end - start), 0.0))
    return np.clip(2 * area / np.where(root > 0, root, 1.0), 0.0, 1.0)


# --- Where the file's numbers stand ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Slice:
    """What a file wants to know of one incidence."""

    wi: Vectors
    """(3,)."""
    wo: Vectors
    """(y, x, 3), of which some lie below the horizon."""
    stored: Floats
    """(y, x): what is stored per f cos(theta_o)."""
    sampled: Floats
    """(y, x): what the luminance is per f cos(theta_o)."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """The directions at which a file wants to know a BRDF, of which nothing but a distribution of normals is known."""

    theta_i: Singles
    """Incidences in radians, ascending."""
    phi_i: Singles
    """Their azimuths in radians from -pi to pi; a single 0 if the BRDF is isotropic."""
    ndf: Singles
    """D in 1/sr on the square (v, u)."""
    sigma: Singles
    """Projected area towards (v, u)."""
    warp: Warp
    """Where the nodes are, a slice for each phi_i and theta_i."""
    count: int
    """Nodes along x and along y."""

    @classmethod
    def around(cls, ndf: Floats, theta_i: Floats, phi_i: Floats, count: int) -> Self:
        """For D on the square (v, u) and incidences in degrees."""
        rows = SIGMA[1] if len(phi_i) > 1 else 2
        u, v = np.meshgrid(np.linspace(0.0, 1.0, SIGMA[0]), np.linspace(0.0, 1.0, rows))
        sigma = _projected_area(ndf, _normals(u, v))
        u, v = np.meshgrid(np.linspace(0.0, 1.0, COLUMNS), np.linspace(0.0, 1.0, COLUMNS))
        wm = _normals(u, v)
        density = [_density(wm, direction(t, p), _bilinear(ndf, u, v), _solid_angle(u)) for p in phi_i for t in theta_i]
        return cls(
            theta_i=np.radians(theta_i).astype(np.float32), phi_i=np.radians(phi_i).astype(np.float32),
            ndf=ndf.astype(np.float32), sigma=sigma.astype(np.float32),
            warp=Warp.of(np.array(density, np.float32)), count=count,
        )  # fmt: skip

    def slice(self, p: int, t: int) -> Slice:
        """The nodes of light from `phi_i[p]` and `theta_i[t]`."""
        wi = direction(np.degrees(self.theta_i[t]), np.degrees(self.phi_i[p]))
        k = p * len(self.theta_i) + t
        u, v = self.warp.nodes(k, self.count)
        wm = _normals(u, v)
        cosine = wm @ wi
        return Slice(
            wi=wi,
            wo=reflect(wi, wm),
            stored=4 * _bilinear(self.sigma, *_square(wi)) / _bilinear(self.ndf, u, v),
            sampled=4 * cosine * _solid_angle(u) / _bilinear(self.warp.density[k], u, v),
        )


def _projected_area(ndf: Floats, w: Vectors) -> Floats:
    """Projected area (...) of the normals towards `w` (..., 3), by midpoints of the square."""
    middles = (np.arange(QUADRATURE) + 0.5) / QUADRATURE
    u, v = np.meshgrid(middles, middles)
    area = (_bilinear(ndf, u, v) * _solid_angle(u)).ravel() / QUADRATURE**2
    wm = _normals(u, v).reshape(-1, 3)
    flat = w.reshape(-1, 3)
    parts = [np.maximum(flat[k : k + 64] @ wm.T, 0.0) @ area for k in range(0, len(flat), 64)]
    return np.asarray(np.concatenate(parts).reshape(w.shape[:-1]))


def _density(wm: Vectors, wi: Vectors, ndf: Floats, solid_angle: Floats) -> Floats:
    """Density of the nodes for light from `wi` on the square of normals `wm` (v, u, 3)."""
    horizon = np.clip(1 + reflect(wi, wm)[..., 2] / RAMP, BELOW, 1.0)
    lobe = ndf**FLATTENED * solid_angle * horizon
    return np.asarray((1 - EVEN) * lobe / lobe.mean() + EVEN * horizon / horizon.mean())


def _estimated_ndf(lobes: BRDF) -> Floats:
    """D on the square (v, u): the mean over incidences of 4 f cos(theta_i) cos(theta_o), the channels' mean.

    For light that facets reflect once it is D itself, but for their reflectance and masking.
    """
    from scipy.interpolate import CubicSpline

    columns, rows = (np.linspace(0.0, 1.0, count) for count in ESTIMATE[lobes.isotropic])
    total, weight = _summed(lobes, _normals(*np.meshgrid(columns, rows)))
    if lobes.isotropic:
        total, weight = total.sum(axis=0, keepdims=True), weight.sum(axis=0, keepdims=True)
    mean = np.array([_filled(*row) for row in zip(total, weight, strict=True)])
    logarithm = np.log(np.maximum(mean, max(FLOOR * float(mean.max()), 1e-300)))
    fine = CubicSpline(columns, logarithm, axis=1)(np.linspace(0.0, 1.0, NDF[0]))
    if lobes.isotropic:
        fine = np.repeat(fine, 2, axis=0)
    else:
        fine[-1] = fine[0]
        fine = CubicSpline(rows, fine, axis=0, bc_type="periodic")(np.linspace(0.0, 1.0, NDF[1]))
    ndf = np.exp(fine)
    return np.asarray(ndf / _projected_area(ndf, direction(0.0)))


def _summed(lobes: BRDF, wm: Vectors) -> tuple[Floats, Floats]:
    """Sums over incidences of 4 f cos(theta_i) cos(theta_o) at normals `wm` (v, u, 3), weighted, and of the weights."""
    total, weight = np.zeros(wm.shape[:2]), np.zeros(wm.shape[:2])
    for theta in np.arange(1.5, 90.0, 3.0 if lobes.isotropic else 9.0):
        for phi in np.zeros(1) if lobes.isotropic else np.arange(0.0, 360.0, 30.0):
            wi = direction(theta, phi)
            wo, cosine = reflect(wi, wm), wm @ wi
            seen = (wo[..., 2] > 1e-3) & (cosine > 0)
            f = lobes.evaluate(np.broadcast_to(wi, wo[seen].shape), wo[seen]).mean(axis=1)
            known = np.isfinite(f)
            share = known * cosine[seen] * np.sin(np.radians(theta))
            total[seen] += share * 4 * wi[2] * wo[seen][:, 2] * np.where(known, f, 0.0)
            weight[seen] += share
    return total, weight


def _filled(total: Floats, weight: Floats) -> Floats:
    """total / weight where there is weight, the nearest of it elsewhere; 1 if there is none at all."""
    known = np.flatnonzero(weight)
    if not known.size:
        return np.ones(len(total))
    return np.interp(np.arange(len(total)), known, total[known] / weight[known])


# --- Writing ---------------------------------------------------------------------------------------------------------


def write(lobes: BRDF, path: Path, colour: bool) -> Sequence[str]:
    """Write the BRDF as linear sRGB if `colour`, otherwise at its wavelengths; sentences about what had to be bent.

    Raises ValueError if a spectrum is asked for and only colours are known, OSError where the file cannot be written.
    """
    order = np.argsort(lobes.wavelengths)
    if colour:
        lobes, order = lobes.in_basis("RGB"), np.arange(3)
    elif lobes.basis != "spectrum":
        raise ValueError(
            f"of this BRDF only the channels {lobes.basis} are known, and a spectral file wants values at wavelengths: "
            "write the colour variant"
        )
    theta_i, phi_i = _incidences(lobes)
    count = _count(len(theta_i) * len(phi_i), len(lobes.wavelengths))
    nodes = Nodes.around(_estimated_ndf(lobes), theta_i, phi_i, count)
    # The last azimuth is the first one again.
    azimuths = max(1, len(phi_i) - 1)
    answers = [_answer(lobes, nodes.slice(p, t)) for p in range(azimuths) for t in range(len(theta_i))]
    around = answers if lobes.isotropic else [*answers, *answers[: len(theta_i)]]
    grid = len(phi_i), len(theta_i)
    fields: dict[str, NDArray[Any]] = {
        "description": np.frombuffer(f"{lobes.title} (written by gonio)".encode(), np.uint8),
        "theta_i": nodes.theta_i,
        "phi_i": nodes.phi_i,
        "ndf": nodes.ndf,
        "sigma": nodes.sigma,
        "vndf": nodes.warp.density.astype(np.float32).reshape(*grid, COLUMNS, COLUMNS),
        "luminance": np.stack([answer.luminance for answer in around]).reshape(*grid, count, count),
        **({} if colour else {"wavelengths": lobes.wavelengths[order].astype(np.float32)}),
        "rgb" if colour else "spectra": np.stack([answer.values[order] for answer in around]).reshape(
            *grid, -1, count, count
        ),
        "jacobian": np.ones(1, np.uint8),
        "valid": np.packbits([answer.valid for answer in around]),
    }
    with atomic_write(path) as scratch, scratch.open("wb") as file:
        _store(file, fields)
    return [*_gaps(lobes), *_bent(answers)]


def _count(slices: int, channels: int) -> int:
    """Nodes along x and along y that the budget allows."""
    numbers = BUDGET / 4 / slices - COLUMNS**2
    return min(MOST, max(FEWEST, math.isqrt(max(0, int(numbers / (channels + 1))))))


def _incidences(lobes: BRDF) -> tuple[Floats, Floats]:
    """theta_i and phi_i of the file, degrees: those known, and what it takes between them."""
    theta_i = _spaced(lobes.theta_i, 0.0, GRAZING, THETA_STEP[lobes.isotropic])
    steep = theta_i[:-1] >= STEEP
    theta_i = np.union1d(theta_i, (theta_i[:-1] + theta_i[1:])[steep] / 2)
    if lobes.isotropic:
        return theta_i, np.zeros(1)
    return theta_i, _spaced((lobes.phi_i + 180) % 360 - 180, -180.0, 180.0, PHI_STEP)


def _spaced(known: Floats, low: float, high: float, step: float) -> Floats:
    """The known angles from `low` to `high` and, where they are further apart than `step`, some between them.

    Where far more are known than that takes, only every second or third of them: the file would be too large.
    """
    inside = np.unique(known[(known > low + 0.05) & (known < high - 0.05)])
    every = max(1, math.ceil(len(inside) * step / (1.5 * (high - low))))
    anchors = np.array([low, *inside[::every], high])
    # A quarter more than a step is not worth another piece.
    pieces = np.maximum(np.ceil(np.diff(anchors) / step - 0.25), 1).astype(int)
    steps = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(anchors, anchors[1:], pieces, strict=False)]
    return np.append(np.concatenate(steps), high)


@dataclass(frozen=True, eq=False)
class Answer:
    """What stands at the nodes of a slice."""

    values: Singles
    """(channel, y, x)."""
    luminance: Singles
    """(y, x)."""
    above: NDArray[np.bool_]
    """(y, x): above the horizon."""
    valid: NDArray[np.bool_]
    """(y, x): above it, and something is known."""
    negative: int
    """Directions with a value below 0 in some channel."""


def _answer(lobes: BRDF, one: Slice) -> Answer:
    """`lobes` in the directions of a slice."""
    above = one.wo[..., 2] > 0
    f = lobes.evaluate(np.broadcast_to(one.wi, one.wo[above].shape), one.wo[above])
    known = np.isfinite(f).all(axis=1)
    valid = above.copy()
    valid[above] = known
    power = np.zeros((*above.shape, f.shape[1]))
    power[valid] = np.maximum(f[known], 0.0) * one.wo[valid][:, 2:]
    dense = power.mean(axis=2) * one.sampled
    return Answer(
        values=np.moveaxis(_without_gaps(power * one.stored[..., None], above & ~valid, valid), -1, 0).astype(
            np.float32
        ),
        luminance=np.maximum(dense, max(DIM * float(dense.max()), 1e-30)).astype(np.float32),
        above=above,
        valid=valid,
        negative=int((f[known] < 0).any(axis=1).sum()),
    )


def _bent(answers: Sequence[Answer]) -> list[str]:
    """Sentences about values that could not be stored as they are."""
    above = sum(int(answer.above.sum()) for answer in answers)
    unknown = above - sum(int(answer.valid.sum()) for answer in answers)
    negative = sum(answer.negative for answer in answers)
    return [
        *([f"{100 * negative / above:.2g} % of the values were negative: they hold 0"] if negative else []),
        *([f"{100 * unknown / above:.2g} % of the values are not known: they hold the nearest"] if unknown else []),
    ]


def _without_gaps(table: Floats, gaps: NDArray[np.bool_], known: NDArray[np.bool_]) -> Floats:
    """`table` (y, x, channels) with the nearest known value in the gaps."""
    if not gaps.any() or not known.any():
        return table
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.where(gaps[..., None], table[tuple(nearest)], table)


def _gaps(lobes: BRDF) -> list[str]:
    """Sentences about incidences that the file has and that were not known."""
    notes = []
    low, high = float(lobes.theta_i[0]), float(lobes.theta_i[-1])
    if low > 0:
        notes.append(f"incidences below {low:g} degrees were not measured: the nearest stands for them")
    if high < GRAZING - 1:
        notes.append(f"incidences beyond {high:g} degrees were not measured: the nearest stands for them")
    if not lobes.isotropic:
        gaps = np.diff(lobes.phi_i, append=lobes.phi_i[0] + 360)
        widest = int(gaps.argmax())
        if len(gaps) < 3 or gaps[widest] > 1.5 * np.delete(gaps, widest).max():
            start, end = lobes.phi_i[widest], (lobes.phi_i[widest] + gaps[widest]) % 360
            notes.append(
                f"light from azimuths between {start:g} and {end:g} degrees was not measured: the nearest azimuth "
                "stands for it"
            )
    return notes


def _store(file: BinaryIO, fields: Mapping[str, NDArray[Any]]) -> None:
    """Write the container."""
    heads = [
        struct.pack(f"<H{len(name)}sHB", len(name), name.encode(), table.ndim, TYPES.index(_type(table)) + 1)
        for name, table in fields.items()
    ]
    file.write(MAGIC + struct.pack("<I", len(fields)))
    at = file.tell() + sum(map(len, heads)) + sum(8 * (1 + table.ndim) for table in fields.values())
    offsets = []
    for head, table in zip(heads, fields.values(), strict=True):
        at += -at % ALIGNED
        offsets.append(at)
        file.write(head + struct.pack(f"<{1 + table.ndim}Q", at, *table.shape))
        at += table.nbytes
    for offset, table in zip(offsets, fields.values(), strict=True):
        file.write(bytes(offset - file.tell()))
        file.write(np.ascontiguousarray(table, _type(table)).data)


def _type(table: NDArray[Any]) -> str:
    return table.dtype.newbyteorder("<").str.lstrip("|")


# --- Reading ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Interpolant:
    """A file's BRDF, interpolated as Mitsuba does."""

    theta_i: Floats
    phi_i: Floats
    """Radians, ascending."""
    ndf: Floats
    sigma: Floats
    """On the square (v, u)."""
    warp: Warp
    values: Singles
    """(slice, y, x, channel)."""
    jacobian: bool
    """Whether the values are to be multiplied by D / (4 sigma)."""

    @property
    def isotropic(self) -> bool:
        """Whether azimuths count from that of the light."""
        return len(self.phi_i) <= 2

    @property
    def reduction(self) -> int:
        """How many times the azimuths go into a full circle."""
        return 1 if self.isotropic else round(2 * math.pi / float(self.phi_i[-1] - self.phi_i[0]))

    def evaluate(self, wi: Vectors, wo: Vectors) -> Floats:
        """The BRDF (n, channels) in 1/sr for `wi`, `wo` (n, 3) above the horizon."""
        parts = [self._evaluated(wi[k : k + CHUNK], wo[k : k + CHUNK]) for k in range(0, len(wi), CHUNK)]
        return np.concatenate(parts) if parts else np.zeros((0, self.values.shape[-1]))

    def _evaluated(self, wi: Vectors, wo: Vectors) -> Floats:
        wi, wo = self._folded(wi, wo)
        theta, phi = angles(wi)
        phi = (phi + 180) % 360 - 180
        u, v = _square(half_vector(wi, wo))
        if self.isotropic:
            v = (v - phi / 360) % 1
        blend = _blend((self.phi_i, np.radians(phi)), (self.theta_i, np.radians(theta)))
        x, y = self.warp.invert(u, v, blend)
        (i, s), (j, t) = (_cell(axis, self.values.shape[1]) for axis in (x, y))
        result = np.zeros((len(wi), self.values.shape[-1]))
        for k, weight in blend:
            for row, column, share in (
                (j, i, (1 - t) * (1 - s)), (j, i + 1, (1 - t) * s), (j + 1, i, t * (1 - s)), (j + 1, i + 1, t * s)
            ):  # fmt: skip
                result += (weight * share)[:, None] * self.values[k, row, column]
        if self.jacobian:
            result *= (_bilinear(self.ndf, u, v) / (4 * _bilinear(self.sigma, *_square(wi))))[:, None]
        return result / wo[:, 2:]

    def _folded(self, wi: Vectors, wo: Vectors) -> tuple[Vectors, Vectors]:
        """Both directions turned (r = 2) or mirrored (r = 4) so that wi comes from the azimuths that the file has."""
        if self.reduction == 1:
            return wi, wo
        turn = np.ones(wi.shape)
        turn[:, 1] = np.where(np.signbit(wi[:, 1]), 1.0, -1.0)
        turn[:, 0] = np.where(np.signbit(wi[:, 0]), 1.0, -1.0) if self.reduction == 4 else turn[:, 1]
        return wi * turn, wo * turn

    def azimuths(self) -> Floats:
        """The light's known azimuths all around, degrees, 0 <= phi_i < 360; 0 alone if isotropic."""
        if self.isotropic:
            return np.zeros(1)
        phi = np.round(np.degrees(self.phi_i), 4)
        images = {1: (phi,), 2: (phi, phi + 180), 4: (phi, phi + 180, -phi, 180 - phi)}[self.reduction]
        return np.unique(np.concatenate(images) % 360)


def read(path: Path) -> BRDF:
    """A BRDF from a tensor file: ours or EPFL's, colours or spectra, isotropic or not, reductions 1, 2 and 4.

    Raises ValueError for what is none.
    """
    try:
        fields = _fields(path)
        interpolant = _interpolant(fields)
    except (OSError, ValueError, struct.error) as error:
        raise ValueError(f"{path}: not a tensor file of a BRDF, or it is damaged ({error})") from None
    colour = "spectra" not in fields
    theta_i = np.unique(np.minimum(np.round(np.degrees(interpolant.theta_i), 4), 90.0))
    phi_i = interpolant.azimuths()
    channels = interpolant.values.shape[-1]
    return BRDF(
        evaluate=interpolant.evaluate,
        wavelengths=np.array(NOMINAL["RGB"]) if colour else fields["wavelengths"].astype(np.float64),
        theta_i=theta_i,
        phi_i=phi_i,
        isotropic=interpolant.isotropic,
        basis="RGB" if colour else "spectrum",
        detector=_detector(len(theta_i) * len(phi_i) * channels),
        attributes={"title": _title(fields) or path.stem, "origin": f"RGL file {path.name}"},
    )


def _fields(path: Path) -> dict[str, NDArray[Any]]:
    """The fields of a container by name. Raises ValueError for what is none, before anything large is allocated."""
    size = path.stat().st_size
    if size > LARGEST:
        raise ValueError(f"it has {size} bytes, more than {LARGEST}")
    with path.open("rb") as file:

        def unpack(form: str) -> tuple[Any, ...]:
            return struct.unpack(form, file.read(struct.calcsize(form)))

        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError("it does not begin as one of version 1.0")
        (count,) = unpack("<I")
        if count > FIELDS:
            raise ValueError(f"it announces {count} fields, more than {FIELDS}")
        heads = {}
        for _ in range(count):
            name = file.read(unpack("<H")[0]).decode("utf-8", errors="replace")
            sides, code, offset = unpack("<HBQ")
            if sides > 8 or not 1 <= code <= len(TYPES):
                raise ValueError(f"its field {name[:20]!r} has {sides} dimensions and the type {code}")
            heads[name] = np.dtype(TYPES[code - 1]), offset, unpack(f"<{sides}Q")
            if max(heads[name][2], default=0) > size:
                raise ValueError(f"its field {name[:20]!r} has more rows than it has bytes")
        if sum(math.prod(shape) * kind.itemsize for kind, _, shape in heads.values()) > size:
            raise ValueError("it announces more numbers than it has")
        fields = {}
        for name, (kind, offset, shape) in heads.items():
            if offset + math.prod(shape) * kind.itemsize > size:
                raise ValueError(f"it ends before its field {name[:20]!r} does")
            file.seek(offset)
            fields[name] = np.fromfile(file, kind, math.prod(shape)).reshape(shape)
    return fields


def _interpolant(fields: Mapping[str, NDArray[Any]]) -> Interpolant:
    """The BRDF of these fields. Raises ValueError where they do not fit each other."""
    name = "spectra" if "spectra" in fields else "rgb"
    sides = {"theta_i": 1, "phi_i": 1, "ndf": 2, "sigma": 2, "vndf": 4, "jacobian": 1, name: 5}
    if name == "spectra":
        sides["wavelengths"] = 1
    for field, count in sides.items():
        kind = np.uint8 if field == "jacobian" else np.float32
        if field not in fields:
            raise ValueError(f"it has no field {field!r}")
        if fields[field].ndim != count or not fields[field].size or fields[field].dtype != kind:
            raise ValueError(f"its field {field!r} is {fields[field].dtype} {list(fields[field].shape)}")
        if not np.isfinite(fields[field]).all():
            raise ValueError(f"its field {field!r} holds numbers that are not finite")
    theta_i, phi_i, ndf, sigma = (fields[field].astype(np.float64) for field in ("theta_i", "phi_i", "ndf", "sigma"))
    vndf, values = fields["vndf"], fields[name]
    grid = len(phi_i), len(theta_i)
    channels = len(fields["wavelengths"]) if name == "spectra" else 3
    if vndf.shape[:2] != grid or values.shape[:3] != (*grid, channels) or values.shape[3] != values.shape[4]:
        raise ValueError(f"vndf {vndf.shape} and {name} {values.shape} do not fit {grid} azimuths and incidences")
    if min(*ndf.shape, *sigma.shape, *vndf.shape[2:], values.shape[3]) < 2:
        raise ValueError("one of its tables has fewer than 2 rows or columns")
    _insist_on_order(theta_i, "theta_i", 0.0, math.pi / 2)
    _insist_on_order(phi_i, "phi_i", -math.pi, math.pi)
    if name == "spectra":
        _insist_on_order(fields["wavelengths"], name, 0.0, math.inf)
    if not ((ndf >= 0).all() and (sigma > 0).all()):
        raise ValueError("ndf must not be negative, and sigma above 0")
    interpolant = Interpolant(
        theta_i=theta_i, phi_i=phi_i, ndf=ndf, sigma=sigma, warp=Warp.of(vndf.reshape(-1, *vndf.shape[2:])),
        values=np.ascontiguousarray(np.moveaxis(values, 2, -1)).reshape(-1, *values.shape[3:], channels),
        jacobian=bool(fields["jacobian"][0]),
    )  # fmt: skip
    if interpolant.reduction not in (1, 2, 4):
        raise ValueError(f"its azimuths span a circle / {interpolant.reduction}, and 1, 2 and 4 have a meaning")
    return interpolant


def _insist_on_order(nodes: NDArray[np.floating], name: str, low: float, high: float) -> None:
    slack = 1e-3
    inside = (nodes >= low - slack) & (nodes <= high + slack)
    if not (inside.all() and (np.diff(nodes) > 0).all()):
        raise ValueError(f"{name} must rise between {low:.4g} and {high:.4g}")


def _detector(others: int) -> HemisphereGrid:
    """Bins as small as 1 x 2 degrees, larger ones if there would be too many of them for so many other values."""
    grids = [HemisphereGrid(theta_step=step, phi_step=2 * step) for step in (1.0, 1.5, 2.0, 3.0, 5.0)]
    return next((grid for grid in grids if grid.bins * others <= BINS), grids[-1])


def _title(fields: Mapping[str, NDArray[Any]]) -> str:
    """The first line of the description."""
    if fields.get("description", np.zeros(0)).dtype != np.uint8:
        return ""
    lines = fields["description"].tobytes().decode("utf-8", errors="replace").split("\n", 1)
    return "".join(letter for letter in lines[0] if letter.isprintable())[:200]
