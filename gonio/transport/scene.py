"""The traced sample: tables of a height field, or Embree over one period of a mesh. The only importer of embreex.

The tile is the box of one period, centred on the origin so that float32 coordinates stay small. Triangles of the
neighbouring periods that reach into a seam around the tile are added, so that a ray which leaves the tile is known to
be free before it re-enters opposite, and no ray can slip through where the periods meet.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from gonio.optics import Material
from gonio.transport.accelerator import Accelerator
from microsurfaces import HeightField, Mesh, Statistics
from microsurfaces.arrays import Float32s

SEAM = 1e-3
"""Width of the seam in periods."""

OFFSET = 1e-6
"""Restart offset along the facet normal, in units of the largest coordinate: smaller loses rays in bulk, larger leaks
at concave edges."""


class Tile(NamedTuple):
    """The box of one period, centred; µm. Numbers that every kernel needs."""

    half_x: float
    half_y: float
    outer_x: float
    """Half width of the box with its seam: inside it all geometry is present."""
    outer_y: float
    bottom: float
    """Below this there is no surface: a ray here is lost."""
    top: float
    """Above this there is no surface: a ray that rises here has escaped. Paths start here."""
    offset: float
    """Restart offset along the facet normal."""


class EmbreeMesh:
    """One period of a mesh and the seam around it, with Embree's acceleration structure (1 s per million triangles).

    Raises ValueError for a mesh that is not sound.
    """

    def __init__(self, mesh: Mesh) -> None:
        mesh.check()
        vertices, faces, repeated = _with_seam(mesh)
        largest = float(np.abs(vertices).max())
        offset = OFFSET * largest
        half_x, half_y = mesh.period[0] / 2, mesh.period[1] / 2
        self.tile = Tile(
            half_x,
            half_y,
            half_x * (1 + 2 * SEAM),
            half_y * (1 + 2 * SEAM),
            float(vertices[:, 2].min()) - 4 * offset,
            float(vertices[:, 2].max()) + 4 * offset,
            offset,
        )
        normals, corner_normals = mesh.normals().astype(np.float32), _corner_normals(mesh)
        self.normals = np.concatenate([normals, normals[repeated]])
        """Facet normals (triangles, 3), seam included."""
        self.corner_normals = np.concatenate([corner_normals, corner_normals[repeated if len(corner_normals) else []]])
        """Exact normals at the triangles' corners (triangles, 3, 3), empty where facets are facets."""
        self._embree = EmbreeScene(EmbreeDevice(), robust=True)
        self._geometry = TriangleMesh(self._embree, vertices, faces)
        self.intersect(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), np.ones(1, np.float32))

    def intersect(self, origins: Float32s, directions: Float32s, reach: Float32s) -> dict[str, NDArray[Any]]:
        """Closest hits of rays (n, 3), (n, 3) within the distances `reach` (n,).

        Returns embreex' dictionary: primID (n,) int32, -1 for none, tfar, u and v (n,) float32, Ng (n, 3). Releases
        the interpreter's lock, so threads may share a mesh.
        """
        hits: dict[str, NDArray[Any]] = self._embree.run(origins, directions, dists=reach, output=True)
        return hits


class Geometry:
    """A relief, ready to be traced: heavy, and shared by any number of scenes, measurements and threads.

    A height field has the tables of its own walk, an `Accelerator` (0.2 s per million nodes); any mesh, and so one with
    overhangs or walls, goes to Embree, an `EmbreeMesh`. `relief.mesh()` has Embree trace a height field too.
    """

    def __init__(self, relief: HeightField | Mesh) -> None:
        self.relief = relief
        self.traced = Accelerator.of(relief) if isinstance(relief, HeightField) else EmbreeMesh(relief)

    @functools.cached_property
    def statistics(self) -> Statistics:
        """Statistics of the relief."""
        return self.relief.statistics()


class Scene:
    """A relief and what it is made of.

    `relief` is a `HeightField`, a `Mesh`, or the `geometry` of another scene, which is shared then; `material` a
    material recipe.
    """

    def __init__(self, relief: HeightField | Mesh | Geometry, material: Material) -> None:
        self.geometry = relief if isinstance(relief, Geometry) else Geometry(relief)
        self.material = material

    @property
    def relief(self) -> HeightField | Mesh:
        """The relief that was built or read."""
        return self.geometry.relief


def _with_seam(mesh: Mesh) -> tuple[Float32s, NDArray[np.int32], NDArray[np.intp]]:
    """Centred vertices (n, 3), faces (m, 3), and which faces of `mesh` are repeated behind its own in the seam."""
    period = np.array([*mesh.period, 0.0])
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    # The relief's own corner is the tile's, so that a height field needs no more than its border cells.
    centre = np.array([low[0], low[1], (low[2] + high[2]) / 2]) + period / 2
    base = mesh.vertices - centre
    outer = (0.5 + SEAM) * period[:2]
    # What a shift by whole periods brings into the box has a corner within a seam of the box's sides, or outside.
    border = np.asarray((np.abs(base[:, :2]) > period[:2] - outer).any(axis=1))
    candidates = np.flatnonzero(border[mesh.faces].any(axis=1))
    corners = base[mesh.faces[candidates], :2]
    least, most = corners.min(axis=1), corners.max(axis=1)
    reach = np.ceil((high - low)[:2] / period[:2] + SEAM).astype(int)
    vertices, faces, repeated, count = [base.astype(np.float32)], [mesh.faces], [candidates[:0]], len(base)
    for i, j in np.ndindex(*(2 * reach + 1)):
        shift = (np.array([i, j]) - reach) * period[:2]
        chosen = candidates[((least < outer - shift) & (most > -outer - shift)).all(axis=1)]
        if not shift.any() or not chosen.size:
            continue
        used, renumbered = np.unique(mesh.faces[chosen], return_inverse=True)
        vertices.append((base[used] + [*shift, 0.0]).astype(np.float32))
        faces.append((renumbered.reshape(-1, 3) + count).astype(np.int32))
        repeated.append(chosen)
        count += len(used)
    return np.concatenate(vertices), np.concatenate(faces), np.concatenate(repeated)


def _corner_normals(mesh: Mesh) -> Float32s:
    """Exact normals of every triangle's corners (m, 3, 3); shape (0, 3, 3) for a mesh of plain facets."""
    if mesh.vertex_normals is None:
        return np.zeros((0, 3, 3), np.float32)
    return mesh.vertex_normals[mesh.faces].astype(np.float32)
