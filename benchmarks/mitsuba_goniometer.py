"""An independent virtual goniometer on Mitsuba 3 (llvm_ad_rgb), to compare gonio with: the same job, none of its code.

It shares only the height field with gonio. The relief is one Mitsuba mesh, so Embree answers every ray; the whole
measurement (stratified starts, mirror reflections with Fresnel's weights, periodic sides, bins) is one symbolic loop
that DrJit compiles into one kernel, launched once for every `CHUNK` paths. Nothing is kept per path.

What made it fast, on a 1024 x 1024 relief: Embree's coherent packets for the first two rays of a path, and its faster
triangle test that is not watertight, whose leaks are noticed and traced again.

Install with `pip install mitsuba` and `apt-get install libllvm19`; another LLVM is taken from DRJIT_LIBLLVM_PATH.
"""

from __future__ import annotations

import math
import os
import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microsurfaces import HeightField

Floats = NDArray[np.float64]

LIBRARIES = ("/usr/lib/*-linux-gnu/libLLVM*.so*", "/usr/lib/llvm-*/lib/libLLVM*.so*")
"""Where Debian keeps LLVM."""


def _renderer() -> tuple[Any, Any]:
    """The modules drjit and mitsuba, with their LLVM found; an ImportError says what is missing."""
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        found = [path for pattern in LIBRARIES for path in Path("/").glob(pattern[1:])]
        if not found:
            raise ImportError(
                "Mitsuba needs LLVM: apt-get install libllvm19, or set DRJIT_LIBLLVM_PATH to its library."
            )
        os.environ["DRJIT_LIBLLVM_PATH"] = str(max(found, key=_version))
    try:
        import drjit
        import mitsuba
    except ImportError as error:
        raise ImportError("This comparison needs Mitsuba 3: pip install mitsuba.") from error
    mitsuba.set_variant("llvm_ad_rgb")
    return drjit, mitsuba


def _version(library: Path) -> list[int]:
    """19, 1 for libLLVM.so.19.1 and 15, 1 for libLLVM-15.so.1."""
    return [int(number) for number in re.findall(r"\d+", library.name)]


dr, mi = _renderer()

CHUNK = 1 << 22
"""Paths in one launch."""

RINGS, SECTORS, ORDERS = 91, 360, 3
"""Bins of 1 degree x 1 degree (a cap and a half ring at the poles and the horizon); 1, 2, or 3 and more hits."""

MARGIN = 8
"""Cells of the neighbouring periods around the tile, so that no ray meets the border of the mesh."""

OFFSET = 1e-6
"""Restart offset along the facet normal, in units of the largest coordinate."""

COHERENT_HITS = 2
"""A path that has hit less often than this is traced in a packet with its neighbours."""

MAX_HITS = 1000
MAX_IDLE = 100
"""Rays in a row, sides crossed or leaks retried, without a hit."""
MIN_WEIGHT = 1e-9


@dataclass(frozen=True)
class Result:
    """What one incidence gave. Bins are numbered ring after ring, as gonio's."""

    albedo: Floats
    """(W,)"""
    albedo_by_order: Floats
    """(orders, W)"""
    brdf: Floats
    """Averages over the bins, 1/sr, (orders, rings * sectors, W)."""
    hits: Floats
    """Paths counted in the bins, (orders, rings * sectors)."""
    lost: int
    """Paths that went under the surface or reached a limit."""
    seconds: float
    """How long it took, compilation included if it was the first call and not `prepare`d."""


@dataclass
class Paths:
    """The state of the loop."""

    origin: mi.Vector3f
    direction: mi.Vector3f
    weight: mi.Vector3f
    hits: mi.UInt32
    idle: mi.UInt32
    active: mi.Bool


class MitsubaGoniometer:
    """A relief of a conductor with the complex indices `index` (3,), ready to be measured."""

    def __init__(self, relief: HeightField, index: NDArray[np.complex128]) -> None:
        if len(index) != 3:
            raise ValueError(f"index holds {len(index)} wavelengths: expected 3, as many as fit a record of the bins")
        self.index = [complex(n) for n in index]
        vertices, faces = _mesh(relief)
        corners = vertices[faces].astype(np.float64)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        # Four floats a facet are fetched at once, three are not.
        self.normals = mi.Float(np.pad(normals, ((0, 0), (0, 1))).astype(np.float32).ravel())
        self.period = relief.period
        self.outer = [float(x) * (1 - 1e-6) for x in vertices[:, :2].max(axis=0)]
        self.offset = OFFSET * float(np.abs(vertices).max())
        self.bottom = float(vertices[:, 2].min()) - 4 * self.offset
        self.top = float(vertices[:, 2].max()) + 4 * self.offset
        self.scene = _scene(vertices, faces)

    def prepare(self) -> float:
        """Compile the kernel; seconds that this takes."""
        return self.measure(30.0, 4096, 0).seconds

    def measure(self, theta_i: float, paths: int, seed: int = 0) -> Result:
        """Trace `paths` light paths that come from `theta_i` degrees and azimuth 0."""
        started = time.perf_counter()
        sums = np.zeros((ORDERS * RINGS * SECTORS + 1, 4))
        for first in range(0, paths, CHUNK):
            target = dr.zeros(mi.Float64, sums.size)
            with dr.suspend_grad():
                self._trace(theta_i, first, min(CHUNK, paths - first), paths, seed, target)
            sums += target.numpy().reshape(sums.shape)
        return _result(sums, paths, time.perf_counter() - started)

    def _trace(self, theta_i: float, first: int, count: int, paths: int, seed: int, target: mi.Float64) -> None:
        """Trace the paths `first` to `first + count` and add them to the bins `target`."""
        theta = math.radians(theta_i)
        source = mi.Vector3f(dr.opaque(mi.Float, -math.sin(theta)), 0, dr.opaque(mi.Float, -math.cos(theta)))
        hits, idle, active = mi.UInt32(0), mi.UInt32(0), dr.full(mi.Bool, True, count)
        start = Paths(self._start(first, count, paths, seed), source, mi.Vector3f(1), hits, idle, active)
        (end,) = dr.while_loop((start,), lambda p: p.active, lambda p: (self._step(p),), mode="symbolic")
        escaped = (end.direction.z > 0) & (end.origin.z >= self.top - self.offset)
        bins = dr.select(escaped, _bin(end.direction, end.hits), ORDERS * RINGS * SECTORS)
        record = mi.Vector4d(mi.Vector4f(end.weight.x, end.weight.y, end.weight.z, 1))
        dr.scatter_reduce(dr.ReduceOp.Add, target, record, bins, mode=dr.ReduceMode.Expand)
        dr.eval(target)

    def _start(self, first: int, count: int, paths: int, seed: int) -> mi.Vector3f:
        """Points above the relief, one in each of `paths` equal parts of a Morton curve over the tile."""
        path = mi.UInt64(dr.arange(mi.UInt32, count)) + dr.opaque(mi.UInt64, first)
        part = dr.opaque(mi.UInt64, min((1 << 64) // paths, (1 << 64) - 1))
        jitter, fine = mi.sample_tea_32(mi.UInt32(path), dr.opaque(mi.UInt32, seed))
        jitter = mi.UInt64(jitter)
        code = path * part + jitter * (part >> 32) + ((jitter * (part & 0xFFFFFFFF)) >> 32)
        coarse = mi.UInt32(code >> 32)
        x, y = (_unit((_even_bits(coarse >> bit) << 16) | _even_bits(fine >> bit)) for bit in (0, 1))
        return mi.Vector3f((x - 0.5) * self.period[0], (y - 0.5) * self.period[1], self.top)

    def _step(self, paths: Paths) -> Paths:
        """Trace every path to its next facet and reflect it there, or to the top or a side of the tile."""
        o, d = paths.origin, paths.direction
        reach, rises = self._reach(o, d)
        ray = mi.Ray3f(mi.Point3f(o), d, reach, 0, [])
        found = self.scene.ray_intersect_preliminary(ray, paths.hits < COHERENT_HITS, paths.active)
        met = paths.active & found.is_valid()
        normal = dr.gather(mi.Vector4f, self.normals, found.prim_index, met).xyz
        cosine = -dr.dot(d, normal)
        hit = met & (cosine > 0)
        end = dr.fma(d, dr.select(met, found.t, reach), o)
        leaked = (met & ~hit) | (~met & (end.z < self.bottom))
        origin = dr.select(leaked, self._aside(o, d), dr.select(hit, dr.fma(normal, self.offset, end), end))
        weight = dr.select(hit, paths.weight * self._reflectance(cosine), paths.weight)
        hits, idle = dr.select(hit, paths.hits + 1, paths.hits), dr.select(hit, 0, paths.idle + 1)
        goes_on = (met | leaked | ~rises) & (hits < MAX_HITS) & (idle < MAX_IDLE) & (dr.max(weight) > MIN_WEIGHT)
        direction = dr.select(hit, dr.fma(normal, 2 * cosine, d), d)
        return Paths(self._wrapped(origin), direction, weight, hits, idle, paths.active & goes_on)

    def _reach(self, o: mi.Vector3f, d: mi.Vector3f) -> tuple[mi.Float, mi.Bool]:
        """Distance to the side of the mesh or to the top, and whether the top comes first."""
        x = (self.outer[0] - dr.select(d.x < 0, -o.x, o.x)) / dr.abs(d.x)
        y = (self.outer[1] - dr.select(d.y < 0, -o.y, o.y)) / dr.abs(d.y)
        side, top = dr.minimum(x, y), (self.top - o.z) / d.z
        rises = (d.z > 0) & (top <= side)
        return dr.select(rises, top, side), rises

    def _wrapped(self, position: mi.Vector3f) -> mi.Vector3f:
        """A position brought back into the tile by whole periods."""
        x, y = (p - period * dr.round(p / period) for p, period in zip(position.xy, self.period, strict=True))
        return mi.Vector3f(x, y, position.z)

    def _aside(self, o: mi.Vector3f, d: mi.Vector3f) -> mi.Vector3f:
        """An origin moved off its ray, upwards rather than down: a ray that slipped through an edge tries again."""
        aside = mi.Vector3f(0.3, 0.2, 0.9)
        return dr.fma(dr.fma(d, -dr.dot(aside, d), aside), self.offset, o)

    def _reflectance(self, cosine: mi.Float) -> mi.Vector3f:
        """Unpolarised reflectances of the three indices (Born & Wolf, Principles of Optics, 14.2)."""
        return mi.Vector3f(*(_fresnel(cosine, n.real, n.imag) for n in self.index))


def _fresnel(cosine: mi.Float, eta: float, k: float) -> mi.Float:
    """(R_s + R_p) / 2 of the index `eta` + i `k`, with one division."""
    cos2 = cosine * cosine
    sin2 = 1 - cos2
    real = (eta * eta - k * k) - sin2
    modulus = dr.sqrt(dr.fma(real, real, 4 * (eta * k) ** 2))
    twice = 2 * dr.sqrt(dr.maximum(0, 0.5 * (modulus + real))) * cosine
    p = dr.fma(cos2, modulus, sin2 * sin2)
    return (modulus + cos2 - twice) * p / ((modulus + cos2 + twice) * dr.fma(twice, sin2, p))


def _bin(direction: mi.Vector3f, hits: mi.UInt32) -> mi.UInt32:
    """The bin of every direction: order, ring, sector."""
    ring = mi.UInt32(dr.rad2deg(dr.atan2(dr.norm(direction.xy), direction.z)) + 0.5)
    sector = mi.Int32(dr.floor(dr.rad2deg(dr.atan2(direction.y, direction.x)) + 0.5))
    sector = mi.UInt32(dr.select(sector < 0, sector + SECTORS, sector))
    order = dr.minimum(hits - 1, ORDERS - 1)
    return (order * RINGS + dr.minimum(ring, RINGS - 1)) * SECTORS + sector


def _even_bits(code: mi.UInt32) -> mi.UInt32:
    """Bits 0, 2, 4 ... of a Morton code, closed up."""
    code = code & 0x55555555
    for shift, mask in ((1, 0x33333333), (2, 0x0F0F0F0F), (4, 0x00FF00FF), (8, 0x0000FFFF)):
        code = (code | (code >> shift)) & mask
    return code


def _unit(bits: mi.UInt32) -> mi.Float:
    """A number in (0, 1)."""
    return (mi.Float(bits >> 9) + 0.5) * 2.0**-23


def _mesh(relief: HeightField) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Vertices (n, 3), centred, and faces (m, 3) of the tile and `MARGIN` cells around it."""
    ny, nx = relief.heights.shape
    j, i = np.arange(-MARGIN, ny + MARGIN + 1), np.arange(-MARGIN, nx + MARGIN + 1)
    vertices = np.empty((len(j), len(i), 3), np.float32)
    vertices[..., 0] = (i - nx / 2) * relief.spacing[0]
    vertices[..., 1] = ((j - ny / 2) * relief.spacing[1])[:, None]
    vertices[..., 2] = (relief.heights - (relief.heights.max() + relief.heights.min()) / 2)[np.ix_(j % ny, i % nx)]
    index = np.arange(len(j) * len(i), dtype=np.uint32).reshape(len(j), len(i))
    v00, v10, v01, v11 = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    falling = ((j[:-1] % ny)[:, None] + i[:-1] % nx) % 2 == 0
    lower = np.stack([v00, v10, np.where(falling, v01, v11)], axis=-1)
    upper = np.stack([np.where(falling, v10, v00), v11, v01], axis=-1)
    return vertices.reshape(-1, 3), np.stack([lower, upper], axis=2).reshape(-1, 3)


def _scene(vertices: NDArray[np.float32], faces: NDArray[np.uint32]) -> mi.Scene:
    """The mesh in Embree's hands."""
    mesh = mi.Mesh("relief", len(vertices), len(faces))
    buffers = mi.traverse(mesh)
    buffers["vertex_positions"], buffers["faces"] = mi.Float(vertices.ravel()), mi.UInt32(faces.ravel())
    buffers.update()
    return mi.load_dict({"type": "scene", "relief": mesh})


def _result(sums: Floats, paths: int, seconds: float) -> Result:
    """Sums of weights, and counts, turned into averages."""
    records = sums[:-1].reshape(ORDERS, RINGS * SECTORS, 4)
    weights, hits = records[..., :3], records[..., 3]
    edges = np.radians([0, *np.arange(0.5, 90), 90])
    projected = np.repeat(np.diff(np.sin(edges) ** 2) * math.pi / SECTORS, SECTORS)
    by_order = weights.sum(axis=1) / paths
    brdf = weights / (paths * projected[:, None])
    return Result(by_order.sum(axis=0), by_order, brdf, hits, round(sums[-1, 3]), seconds)
