"""Measured height maps and meshes in; any surface out to a file. A module for each family of formats."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Discriminator, Tag

from microsurfaces.arrays import Floats
from microsurfaces.atomic_write import atomic_write
from microsurfaces.files import images, profilometry, x3p
from microsurfaces.files.stored import MICROMETRES, Check, Stored, Unit, check_exists, check_map
from microsurfaces.height_field import HeightField
from microsurfaces.mesh import Mesh
from microsurfaces.recipe import Positive, recipe

_TAPER = 0.1  # of the map, at each of its four sides

_Pair = Annotated[tuple[Positive, Positive], Tag("pair")]
_Size = Annotated[
    _Pair | Annotated[Positive, Tag("one")], Discriminator(lambda v: "pair" if isinstance(v, tuple) else "one")
]


@recipe
class HeightFieldFile:
    """A measured height map: from a confocal or interference microscope, an AFM, a profilometer, or made by a program.

    Reads .x3p, .npy (floats or integers), .png (16-bit grey), .tif (one page, 16-bit or float) and .exr (channel Z);
    with SurfaceTopography, `pip install gonio[profilometry]`, also what instruments write: .sur, .plu, .gwy, .sdf,
    .al3d, .opd, .datx, .vk4 and others. Images are turned so that y is up. Nothing is removed or filled silently:
    level the map, and fill its gaps, before.

    A file that states its spacing and unit, as .x3p, those of instruments and the .exr and .png that
    `gonio surface --to` writes, needs no `pixel_size`, `unit` or `scale`; what is given all the same must agree.

    Light is traced over a periodic surface, and a measured map is not periodic, so say what to do: `mirror` repeats it
    mirrored in x and y, which keeps every slope but makes the tile four times as large and as symmetric in azimuth as
    a mirror; `taper` bends the outer tenth at each side to the mean height with a cosine window, which keeps the tile
    but weakens the roughness of 36 % of its area; `as is` joins opposite sides, and where they do not fit there is a
    cliff.

    A feel for the numbers: facets are as large as pixels, and the slopes that light sees are those between neighbouring
    pixels, noise of the instrument included. Heights of 16 bits over 10 µm have steps of 0.15 nm, a slope of 1.5e-4 on
    pixels of 1 µm.
    """

    path: str
    """The file; a relative path starts beside the TOML file, in Python at the current folder."""
    periodic: Literal["mirror", "taper", "as is"]
    """How the map becomes periodic."""
    pixel_size: _Size | None = None
    """Distance between neighbouring pixels, µm, or the pair (dx, dy); needed unless the file states it."""
    unit: Unit | None = None
    """Unit of the stored heights, after `scale`: nm, um, mm or m; needed unless the file states it."""
    scale: Positive | None = None
    """Height of one stored step, in `unit`: needed for integers, 1 for floats if not given."""

    def build(self, seed: int, realisation: int = 0, realisations: int = 1) -> HeightField:
        """The map, the same for every seed and realisation.

        Raises ValueError with one sentence for a file that is missing, damaged, of another type, empty or has gaps.
        """
        path = Path(self.path)
        stored = _read_map(path, 2 if self.periodic == "mirror" else 1)
        unit = self._unit(stored)
        spacing = self._spacing(stored)
        step = self._step(stored, unit)
        heights = (stored.numbers.astype(np.float64) * step + stored.offset) * MICROMETRES[unit]
        if bad := heights.size - int(np.count_nonzero(np.isfinite(heights))):
            raise ValueError(
                f"{path}: {bad} of {heights.size} heights are NaN or infinite: fill the gaps of the map first"
            )
        return HeightField(_PERIODIC[self.periodic](heights), spacing)

    def _unit(self, stored: Stored) -> Unit:
        unit = self.unit or stored.unit
        if unit is None:
            raise ValueError(f"{self.path} does not say what its heights are in: give unit, one of nm, um, mm, m")
        if stored.unit not in (None, unit):
            raise ValueError(
                f"{self.path} says that its heights are in {stored.unit}: found unit = {unit!r}, give {stored.unit!r} "
                "or nothing"
            )
        return unit

    def _spacing(self, stored: Stored) -> tuple[float, float]:
        given = (self.pixel_size, self.pixel_size) if isinstance(self.pixel_size, float) else self.pixel_size
        spacing = given or stored.pixel_size
        if spacing is None:
            raise ValueError(f"{self.path} does not say how far apart its pixels are: give pixel_size, in µm")
        if stored.pixel_size and not np.allclose(stored.pixel_size, spacing, rtol=1e-6, atol=0):
            raise ValueError(
                f"{self.path} says that its pixels are {stored.pixel_size} µm apart: found pixel_size = {spacing}, "
                "give the former or nothing"
            )
        return spacing

    def _step(self, stored: Stored, unit: Unit) -> float:
        if stored.step is None and self.scale is None and stored.numbers.dtype.kind in "iu":
            raise ValueError(
                f"{self.path} holds integers ({stored.numbers.dtype}): give scale, the height of one grey level in "
                f"{unit}"
            )
        if stored.step is not None and self.scale not in (None, stored.step):
            raise ValueError(
                f"{self.path} says that a stored 1 is {stored.step:g} {unit} high: found scale = {self.scale:g}, give "
                "nothing"
            )
        return self.scale or (1.0 if stored.step is None else stored.step)


@recipe
class MeshFile:
    """A surface given as triangles: anything trimesh reads (.ply, .stl, .obj, .off, .glb ...), overhangs allowed.

    The faces must be exactly one period: seen from above they cover an area of px times py, counted positive where they
    face up and negative where they face down, and shifted copies continue each other. z is up. Facets are facets:
    normals stored in the file are not used.
    """

    path: str
    """The file; a relative path starts beside the TOML file, in Python at the current folder."""
    period: tuple[Positive, Positive]
    """Period (px, py) of the surface along x and y, µm."""
    unit: Unit
    """Unit of the coordinates in the file: nm, um, mm or m."""

    def build(self, seed: int, realisation: int = 0, realisations: int = 1) -> Mesh:
        """The mesh, the same for every seed and realisation.

        Raises ValueError with one sentence for a file that is missing or damaged, and for a mesh that is not sound.
        """
        import trimesh

        path = Path(self.path)
        check_exists(path)
        try:
            loaded = trimesh.load_mesh(str(path), process=False)
        except Exception as error:  # trimesh raises whatever its many readers raise
            raise ValueError(
                f"{path} cannot be read as a mesh ({error}): expected a sound .ply, .stl, .obj, .off or .glb"
            ) from error
        if not len(loaded.faces):
            raise ValueError(f"{path} has no faces: expected a triangle mesh, found points only or a damaged file")
        mesh = Mesh(np.asarray(loaded.vertices) * MICROMETRES[self.unit], np.array(loaded.faces), self.period)
        try:
            mesh.check()
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
        return mesh


def save_surface(relief: HeightField | Mesh, path: str | Path) -> None:
    """Save a surface by the suffix of `path`: a height field as .npy, .png, .exr, .x3p, any as .ply, .stl, .obj.

    .npy holds the heights (ny, nx) in µm; .png 16-bit grey levels and .exr a float32 channel Z in metres, both with the
    top row first; .x3p float64 metres. All but .npy state their spacing and unit; `HeightFieldFile` reads all of them.
    .ply and .stl are binary, float32, and .obj is text, in µm. The file appears whole or not at all. Raises ValueError,
    in one sentence, for another suffix, for a mesh as a height map, and where the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _MAP_WRITERS and suffix not in _MESH_SUFFIXES:
        raise ValueError(
            f"{path} has suffix {path.suffix!r}: expected one of {', '.join((*_MAP_WRITERS, *_MESH_SUFFIXES))}"
        )
    if isinstance(relief, Mesh) and suffix in _MAP_WRITERS:
        raise ValueError(f"{path}: a mesh is not a height map: save it as {', '.join(_MESH_SUFFIXES)}")
    if not path.parent.is_dir():
        raise ValueError(f"{path} cannot be written: the folder {path.parent} does not exist, create it first")
    try:
        with atomic_write(path) as part:
            if isinstance(relief, HeightField) and suffix in _MAP_WRITERS:
                _MAP_WRITERS[suffix](relief, part)
            else:
                _write_triangles(relief, part)
    except (OSError, RuntimeError) as error:
        raise ValueError(
            f"{path} cannot be written ({error}): choose a place that is writable and has space"
        ) from error


def _read_map(path: Path, factor: int) -> Stored:
    """What a file holds; the sides of its map will grow by `factor`."""
    check_exists(path)
    suffix = path.suffix.lower()
    reader = _MAP_READERS.get(suffix, profilometry.read if suffix in profilometry.SUFFIXES else None)
    if reader is None:
        raise ValueError(
            f"{path} has suffix {path.suffix!r}: expected a height map, one of {', '.join(_MAP_READERS)} or a format "
            "of profilometers, such as .sur"
        )
    return reader(path, lambda shape, dtype: check_map(path, shape, np.dtype(dtype), factor))


_MAP_READERS: dict[str, Callable[[Path, Check], Stored]] = {
    ".npy": images.read_npy,
    ".png": images.read_png,
    ".tif": images.read_tiff,
    ".tiff": images.read_tiff,
    ".exr": images.read_exr,
    ".x3p": x3p.read,
}

_MAP_WRITERS: dict[str, Callable[[HeightField, Path], None]] = {
    ".npy": images.write_npy,
    ".png": images.write_png,
    ".exr": images.write_exr,
    ".x3p": x3p.write,
}

_MESH_SUFFIXES = (".ply", ".stl", ".obj")


def _write_triangles(relief: HeightField | Mesh, path: Path) -> None:
    mesh = relief.mesh() if isinstance(relief, HeightField) else relief
    mesh.to_trimesh().export(str(path))


def _mirror(heights: Floats) -> Floats:
    """The map and its mirror images, (2 ny, 2 nx); nodes at the edges are repeated, so that the seams are level."""
    wide = np.concatenate([heights, heights[:, ::-1]], axis=1)
    return np.concatenate([wide, wide[::-1]], axis=0)


def _taper(heights: Floats) -> Floats:
    """The map times a cosine window about its mean: the outer tenth at each side falls off like sin²."""
    window = _window(heights.shape[0])[:, None] * _window(heights.shape[1])
    mean = float(heights.mean())
    return mean + window * (heights - mean)


def _window(n: int) -> Floats:
    margin = max(1.0, _TAPER * n)
    to_edge = np.minimum(np.arange(n), np.arange(n)[::-1]) + 0.5
    window: Floats = np.sin(np.pi / 2 * np.minimum(to_edge / margin, 1)) ** 2
    return window


_PERIODIC: dict[str, Callable[[Floats], Floats]] = {
    "mirror": _mirror,
    "taper": _taper,
    "as is": lambda heights: heights,
}
