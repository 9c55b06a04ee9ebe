"""Measured height maps and meshes in; any surface out to a file.

Images have row 0 at the top and y upwards: the last row is the first of `HeightField.heights`. Arrays in .npy files are
heights[j, i] at (i dx, j dy), as in `HeightField`: row 0 is the lowest y.
"""

from __future__ import annotations

import json
import math
import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Tag

from microsurfaces.height_field import HeightField
from microsurfaces.mesh import Floats, Mesh
from microsurfaces.recipe import Positive, recipe

Result = TypeVar("Result")

Unit = Literal["nm", "um", "mm", "m"]
_MICROMETRES = {"nm": 1e-3, "um": 1.0, "mm": 1e3, "m": 1e6}

_MOST_NODES = 8192**2  # 134 million triangles: above 10 GB of memory once light is traced
_TAPER = 0.1  # of the map, at each of its four sides

_Pair = Annotated[tuple[Positive, Positive], Tag("pair")]
_Size = Annotated[
    _Pair | Annotated[Positive, Tag("one")], Discriminator(lambda v: "pair" if isinstance(v, tuple) else "one")
]


@recipe
class HeightFieldFile:
    """A measured height map: from a confocal or interference microscope, an AFM, a profilometer, or made by a program.

    Reads .npy (floats or integers), .png (16-bit grey), .tif (one page, 16-bit or float) and .exr (channel Z). Images
    are turned so that y is up. Nothing is removed or filled silently: level the map, and fill its gaps, before.

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
    pixel_size: _Size
    """Distance between neighbouring pixels, µm, or the pair (dx, dy)."""
    unit: Unit
    """Unit of the stored heights, after `scale`: nm, um, mm or m."""
    periodic: Literal["mirror", "taper", "as is"]
    """How the map becomes periodic."""
    scale: Positive | None = None
    """Height of one stored step, in `unit`: needed for integers, 1 for floats if not given."""

    def build(self, seed: int) -> HeightField:
        """The map, the same for every seed.

        Raises ValueError with one sentence for a file that is missing, damaged, of another type, empty or has gaps.
        """
        path, factor = Path(self.path), 2 if self.periodic == "mirror" else 1
        raw, declared = _read_map(path, factor)
        if raw.dtype.kind in "iu" and self.scale is None:
            raise ValueError(
                f"{path} holds integers ({raw.dtype}): give scale, the height of one grey level in {self.unit}"
            )
        spacing = self.pixel_size if isinstance(self.pixel_size, tuple) else (self.pixel_size, self.pixel_size)
        _check_declared(path, declared, spacing, self.unit)
        heights = raw.astype(np.float64) * ((self.scale or 1.0) * _MICROMETRES[self.unit])
        if bad := heights.size - int(np.count_nonzero(np.isfinite(heights))):
            raise ValueError(
                f"{path}: {bad} of {heights.size} heights are NaN or infinite: fill the gaps of the map first"
            )
        return HeightField(_PERIODIC[self.periodic](heights), spacing)


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

    def build(self, seed: int) -> Mesh:
        """The mesh, the same for every seed.

        Raises ValueError with one sentence for a file that is missing or damaged, and for a mesh that is not sound.
        """
        import trimesh

        path = Path(self.path)
        _check_exists(path)
        try:
            loaded = trimesh.load_mesh(str(path), process=False)
        except Exception as error:  # trimesh raises whatever its many readers raise
            raise ValueError(
                f"{path} cannot be read as a mesh ({error}): expected a sound .ply, .stl, .obj, .off or .glb"
            ) from error
        if not len(loaded.faces):
            raise ValueError(f"{path} has no faces: expected a triangle mesh, found points only or a damaged file")
        mesh = Mesh(np.asarray(loaded.vertices) * _MICROMETRES[self.unit], np.array(loaded.faces), self.period)
        try:
            mesh.check()
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
        return mesh


def save_surface(relief: HeightField | Mesh, path: str | Path) -> None:
    """Save a surface by the suffix of `path`: .npy or .exr (height fields), .ply or .stl (any surface).

    .npy holds the heights (ny, nx) in µm; .exr their channel Z in metres, float32, top row first, and the pixel size in
    the attribute gonio.json; .ply and .stl are binary, float32, in µm. The file appears whole or not at all. Raises
    ValueError, in one sentence, for another suffix, for a mesh as a height map, and where the file cannot be written.
    """
    path = Path(path)
    save = _WRITERS.get(path.suffix.lower())
    if save is None:
        raise ValueError(f"{path} has suffix {path.suffix!r}: expected one of {', '.join(_WRITERS)}")
    if isinstance(relief, Mesh) and path.suffix.lower() in (".npy", ".exr"):
        raise ValueError(f"{path}: a mesh is not a height map: save it as .ply or .stl")
    if not path.parent.is_dir():
        raise ValueError(f"{path} cannot be written: the folder {path.parent} does not exist, create it first")
    try:
        with replacing(path) as part:
            save(relief, part)
    except (OSError, RuntimeError) as error:
        raise ValueError(
            f"{path} cannot be written ({error}): choose a place that is writable and has space"
        ) from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, of the same suffix, that takes its place if the block succeeds.

    Nothing is left behind if it fails. Raises OSError if the folder does not exist or cannot be written.
    """
    temporary = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    temporary.touch()
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _read_map(path: Path, factor: int) -> tuple[NDArray[Any], dict[str, Any]]:
    """Stored numbers, row 0 at the lowest y, and what the file says of them; the sides will grow by `factor`."""
    _check_exists(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path} has suffix {path.suffix!r}: expected a height map, one of {', '.join(_READERS)}")
    return reader(path, lambda shape, dtype: _check_map(path, shape, np.dtype(dtype), factor))


def _check_exists(path: Path) -> None:
    if not path.is_file():
        found = "is a folder" if path.is_dir() else "does not exist"
        raise ValueError(f"{path} {found}: give the path of a file, relative to {Path.cwd()} or absolute")


def _check_map(path: Path, shape: tuple[int, ...], dtype: np.dtype[Any], factor: int) -> None:
    """Refuse what cannot be a height map, before its pixels are read."""
    if len(shape) != 2:
        raise ValueError(f"{path} has shape {shape}: expected one map (ny, nx), a single grey channel on a single page")
    if min(shape) < 2:
        raise ValueError(f"{path} has {shape[1]} x {shape[0]} pixels: expected at least 2 x 2")
    if math.prod(shape) * factor**2 > _MOST_NODES:
        grown = " once mirrored" if factor > 1 else ""
        raise ValueError(
            f"{path} has {shape[1]} x {shape[0]} pixels: more than {_MOST_NODES} nodes{grown}; crop or thin out the map"
        )
    if dtype.kind not in "iuf":
        raise ValueError(f"{path} holds values of type {dtype}: expected real heights, floats or 16-bit integers")
    if dtype.itemsize < 2:
        raise ValueError(
            f"{path} has 8 bits a pixel: 256 levels make steps instead of slopes; expected 16-bit integers or floats"
        )


def _check_declared(path: Path, declared: dict[str, Any], spacing: tuple[float, float], unit: str) -> None:
    """Refuse a unit or pixel size other than the one that the file itself states."""
    if declared.get("unit", unit) != unit:
        raise ValueError(
            f"{path} says that its heights are in {declared['unit']}: found unit = {unit!r}, give {declared['unit']!r}"
        )
    stated = declared.get("pixel_size", spacing)
    if not np.allclose(stated, spacing, rtol=1e-6, atol=0):
        raise ValueError(
            f"{path} says that its pixels are {tuple(stated)} µm apart: found pixel_size = {spacing}, give the former"
        )


Check = Callable[[tuple[int, ...], Any], None]


def _damaged(path: Path, error: Exception) -> ValueError:
    kind = path.suffix.lower()
    return ValueError(
        f"{path} cannot be read as a {kind} file ({error}): it is damaged or of another type; export it again"
    )


def _read_npy(path: Path, check: Check) -> tuple[NDArray[Any], dict[str, Any]]:
    try:
        stored = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise _damaged(path, error) from error
    check(stored.shape, stored.dtype)
    return np.array(stored), {}


def _read_png(path: Path, check: Check) -> tuple[NDArray[Any], dict[str, Any]]:
    from PIL import Image

    types = {"I;16": np.uint16, "I;16B": np.uint16, "I": np.int32, "F": np.float32}
    with path.open("rb") as file:
        head = file.read(24)  # signature and size: Pillow would warn of a large image before it could be refused
        if head.startswith(b"\x89PNG") and len(head) == 24:
            check(struct.unpack(">II", head[16:])[::-1], np.uint16)
        try:
            image = Image.open(file, formats=["PNG"])
        except (
            OSError,
            ValueError,
            SyntaxError,
            Image.DecompressionBombError,
            Image.DecompressionBombWarning,
        ) as error:
            raise _damaged(path, error) from error
        bands = len(image.getbands())
        check((image.height, image.width) + ((bands,) if bands > 1 else ()), types.get(image.mode, np.uint8))
        try:
            return np.flipud(np.asarray(image)), {}
        except (OSError, ValueError, SyntaxError) as error:
            raise _damaged(path, error) from error


def _read_tiff(path: Path, check: Check) -> tuple[NDArray[Any], dict[str, Any]]:
    import tifffile

    try:
        tiff = tifffile.TiffFile(path)
    except (OSError, ValueError) as error:
        raise _damaged(path, error) from error
    with tiff:
        page = tiff.pages[0]
        check(page.shape if len(tiff.pages) == 1 else (len(tiff.pages), *page.shape), page.dtype)
        try:
            return np.flipud(page.asarray()), {}
        except (OSError, ValueError, RuntimeError) as error:
            raise _damaged(path, error) from error


def _read_exr(path: Path, check: Check) -> tuple[NDArray[Any], dict[str, Any]]:
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
            header = dict(file.header())  # closing empties it
        low, high = header["dataWindow"]
        names = [channel.name for channel in header["channels"]]
    except (RuntimeError, ValueError, KeyError) as error:
        raise _damaged(path, error) from error
    if "Z" not in names:
        raise ValueError(f"{path} has the channels {', '.join(names)}: expected heights in channel Z")
    check((int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1), np.float32)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            pixels = np.flipud(file.channels()["Z"].pixels)
        return pixels, json.loads(header.get("gonio.json", "{}"))
    except (RuntimeError, ValueError, KeyError) as error:
        raise _damaged(path, error) from error


_READERS: dict[str, Callable[[Path, Check], tuple[NDArray[Any], dict[str, Any]]]] = {
    ".npy": _read_npy,
    ".png": _read_png,
    ".tif": _read_tiff,
    ".tiff": _read_tiff,
    ".exr": _read_exr,
}


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


def _save_npy(relief: HeightField | Mesh, path: Path) -> None:
    assert isinstance(relief, HeightField)
    np.save(path, relief.heights)


def _save_exr(relief: HeightField | Mesh, path: Path) -> None:
    import OpenEXR

    assert isinstance(relief, HeightField)
    metres = np.ascontiguousarray(np.flipud(relief.heights * 1e-6), dtype=np.float32)
    header = {
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        "gonio.json": json.dumps({"pixel_size": relief.spacing, "unit": "m"}),
    }
    OpenEXR.File(header, {"Z": metres}).write(str(path))


def _save_triangles(relief: HeightField | Mesh, path: Path) -> None:
    mesh = relief.mesh() if isinstance(relief, HeightField) else relief
    mesh.to_trimesh().export(str(path))


_WRITERS: dict[str, Callable[[HeightField | Mesh, Path], None]] = {
    ".npy": _save_npy,
    ".exr": _save_exr,
    ".ply": _save_triangles,
    ".stl": _save_triangles,
}
