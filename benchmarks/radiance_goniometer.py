"""The same job done by a peer: Radiance's genBSDF over a tile of mirror, on the 145 Klems patches of light.

    .venv/bin/pip install pyradiance
    .venv/bin/python benchmarks/radiance_goniometer.py

Radiance knows no periodic surface. It gets the tile `TILES` x `TILES` times, one mesh shared by all, and starts its
paths over the middle one; light that slips past the outermost tiles counts as transmitted and is reported as `lost`.
"""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import microsurfaces as ms

Floats = NDArray[np.float64]

RINGS = ((0, 5, 1), (5, 15, 8), (15, 25, 16), (25, 35, 20), (35, 45, 24), (45, 55, 24), (55, 65, 24), (65, 75, 16),
         (75, 90, 12))  # fmt: skip
"""Klems' full basis: from theta to theta, degrees, in so many patches, of which the first is centred on phi = 0."""
PATCHES = sum(count for _, _, count in RINGS)
TILES = 5
GAP = 1e-3
"""Height of the starting plane over the highest point, in periods: from closer up Radiance overlooks the surface."""
EXACT = ("-ab", "0", "-lr", "1000", "-lw", "1e-9", "-st", "0")
"""No diffuse light, up to 1000 reflections, down to a weight of 1e-9, every specular ray."""


@dataclass(frozen=True)
class Result:
    """What Radiance measured; arrays are over patches of Klems' full basis, azimuths are gonio's."""

    shares: Floats
    """(145, 145): the share of the light from the patch of the second index that leaves into that of the first."""
    lost: Floats
    """(145,): the share that slipped past the outermost tiles."""
    seconds: float
    """Wall time, without building the mesh."""
    paths: int
    """Light paths, over all incident patches."""

    @property
    def albedo(self) -> Floats:
        """(145,): directional-hemispherical reflectance, by the patch that the light comes from."""
        return self.shares.sum(axis=0)

    @property
    def brdf(self) -> Floats:
        """(145, 145): cos-weighted means of the BRDF over both patches, exit first, 1/sr."""
        return self.shares / projected_solid_angles()[:, None]


class RadianceGoniometer:
    """Radiance, ready to light a height field or mesh whose facets reflect `reflectance` at every angle."""

    def __init__(self, relief: ms.HeightField | ms.Mesh, reflectance: float = 1.0, processes: int | None = None):
        try:
            import pyradiance
        except ModuleNotFoundError:
            raise ModuleNotFoundError("Radiance is missing: pip install pyradiance") from None
        self._radiance = pyradiance
        self._processes = processes or os.cpu_count() or 1
        self._folder = tempfile.TemporaryDirectory(prefix="radiance")
        mesh = relief if isinstance(relief, ms.Mesh) else relief.mesh()
        scale = 1 / max(mesh.period)
        vertices = (mesh.vertices - [0, 0, mesh.vertices[:, 2].max()]) * scale - [0, 0, GAP]
        width, depth = (length * scale for length in mesh.period)
        self._box = pyradiance.genbsdf.SamplingBox(0, width, 0, depth, vertices[:, 2].min(), 0)
        self._scene = self._tiles(self._compiled(vertices, mesh.faces, reflectance), width, depth)

    def measure(self, samples: int) -> Result:
        """Light every one of the 145 patches with about `samples` paths, the same ones every time."""
        started = time.perf_counter()
        back = self._radiance.generate_bsdf(
            self._scene, params=list(EXACT), nsamp=samples, nproc=self._processes, dim=self._box, front=False
        ).back
        seconds = time.perf_counter() - started
        shares, lost = (_by_source(_matrix(part)) for part in (back.reflectance, back.transmittance))
        return Result(shares, lost.sum(axis=0), seconds, PATCHES * self._launched(samples))

    def _launched(self, samples: int) -> int:
        """Paths a patch: genBSDF rounds them up to a grid of nearly square cells."""
        columns = int(np.sqrt(samples * self._box.xmax / self._box.ymax) + 1)
        return columns * int(samples / columns + 1)

    def _compiled(self, vertices: Floats, faces: NDArray[np.int32], reflectance: float) -> Path:
        """One tile as a file that Radiance traces."""
        obj, material, compiled = (Path(self._folder.name) / name for name in ("tile.obj", "tile.mat", "tile.rtm"))
        material.write_text("void mirror facet 0 0 3" + 3 * f" {reflectance:.9g}" + "\n")
        with obj.open("w") as file:
            file.write("usemtl facet\n")
            np.savetxt(file, vertices, fmt="v %.9g %.9g %.9g")
            np.savetxt(file, faces + 1, fmt="f %d %d %d")
        compiled.write_bytes(self._radiance.obj2mesh(obj, matfiles=[material]))
        return compiled

    def _tiles(self, tile: Path, width: float, depth: float) -> bytes:
        """The scene: the tile and its neighbours on all sides."""
        places = np.arange(TILES) - TILES // 2
        return "".join(
            f"void mesh tile_{i}_{j} 5 {tile} -t {x:.9g} {y:.9g} 0 0 0\n"
            for i, x in enumerate(places * width)
            for j, y in enumerate(places * depth)
        ).encode()


def projected_solid_angles() -> Floats:
    """∫ cosθ dω of every patch, (145,) sr; they sum to π."""
    low, high, count = np.array(RINGS, np.float64).T
    ring = np.pi * (np.sin(np.radians(high)) ** 2 - np.sin(np.radians(low)) ** 2) / count
    return np.repeat(ring, count.astype(int))


def patch(theta: float, phi: float) -> int:
    """The patch that contains a direction, to the source or to the detector, degrees."""
    ring = int(np.searchsorted([high for _, high, _ in RINGS[:-1]], theta, side="right"))
    count = RINGS[ring][2]
    return sum(n for _, _, n in RINGS[:ring]) + int(np.floor(phi * count / 360 + 0.5)) % count


def _matrix(text: bytes) -> Floats:
    return np.array(text.split(), np.float64).reshape(PATCHES, PATCHES)


def _by_source(matrix: Floats) -> Floats:
    """Columns by where the light comes from; Radiance has them by where it travels to, half a turn away."""
    rings = np.split(np.arange(PATCHES), np.cumsum([count for _, _, count in RINGS])[:-1])
    return matrix[:, np.concatenate([np.roll(ring, len(ring) // 2) for ring in rings])]


def main() -> None:
    """Time Radiance on a Gaussian height field of alpha 0.3."""
    goniometer = RadianceGoniometer(ms.Gaussian(alpha=0.3, samples=1024).build(1))
    result = goniometer.measure(10_000)
    print(f"{result.paths:,} paths in {result.seconds:.1f} s: {result.paths / result.seconds / 1e6:.3f} M paths/s; "
          f"albedo {result.albedo.min():.5f} to {result.albedo.max():.5f}, lost {result.lost.max():.5f}")  # fmt: skip


if __name__ == "__main__":
    main()
