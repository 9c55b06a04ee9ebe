"""Path-traced pictures of scenes made of a measured surface, by Mitsuba 3 where it is installed.

The measurement becomes a temporary file of RGL's (`.bsdf`), which Mitsuba's plugin `measured` evaluates and samples:
unlike `appearance`, light is reflected as often as it likes, and shadows fall. z is up; light is
`appearance`'s source and sky. Values are radiances in linear sRGB.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio import appearance
from gonio.appearance import Sky, daylight
from gonio.brdf import BRDF
from gonio.formats import export, load
from gonio.formats.rgl import read
from gonio.measurement import Measurement
from gonio.sphere import direction
from microsurfaces.arrays import Floats
from microsurfaces.atomic_write import atomic_write
from microsurfaces.recipe import did_you_mean

PathLike = str | os.PathLike[str]

SCENES = ("sphere", "cylinder", "ball")
"""A sphere or an upright cylinder on a floor, and a ball alone, as `appearance.sphere` shows it."""

FAST, SAFE = "llvm_ad_rgb", "scalar_rgb"
"""Variants of Mitsuba: the first compiles with LLVM, a library of its own, which may be missing or too old."""

PROBE = f"""
import mitsuba as mi
mi.set_variant({FAST!r})
scene = {{name: {{"type": kind}} for name, kind in dict(a="path", b="perspective", c="constant", d="sphere").items()}}
print(mi.render(mi.load_dict({{"type": "scene", **scene}}), spp=1)[0, 0, 0])
"""
"""A program that ends well where the fast variant works."""

FLOOR = 0.35
"""Reflectance of the floor."""

DEPTH = 16
"""Most reflections of a path before the last."""

SUFFIXES = (".exr", ".png")


def render(
    source: Measurement | BRDF | PathLike,
    path: PathLike,
    *,
    scene: str = "sphere",
    size: int = 512,
    spp: int = 256,
    seed: int = 0,
    isotropic: bool = False,
) -> Path:
    """Path-trace `scene`, made of a surface with this BRDF, by Mitsuba 3; write the picture and return its path.

    `source` is a measurement, a BRDF or a file of either: `.nc` or a foreign one, sampled again for Mitsuba, or `.bsdf`
    of RGL's, taken as it is. `scene` is "sphere" or "cylinder" on a floor, or "ball", a sphere alone seen from afar.
    The picture has `size`² texels of `spp` paths each; `.exr` holds radiances in linear sRGB, `.png` is exposed for a
    screen. `isotropic` declares of a measurement that the surface looks the same from every azimuth of the light.
    Raises ValueError for a suffix, a scene or a number that does not do and for a measurement that does not know enough
    of the BRDF, RuntimeError where Mitsuba is not installed.

    >>> gonio.render(measurement, "gold.png", scene="cylinder")  # doctest: +SKIP
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"cannot render into {str(path)!r}: the suffixes are {' and '.join(SUFFIXES)}")
    if not isinstance(source, Measurement | BRDF) and Path(source).suffix.lower() != ".bsdf":
        source = load(source)
    if isotropic and isinstance(source, Measurement):
        source = source.as_isotropic()
    image = radiances(source, scene, size, spp, seed=seed)
    with atomic_write(path) as temporary:
        _write(image, temporary)
    return path


def radiances(
    source: Measurement | BRDF | PathLike,
    scene: str = "sphere",
    size: int = 512,
    spp: int = 256,
    sky: Sky = daylight,
    irradiance: float = appearance.IRRADIANCE,
    seed: int = 0,
) -> Floats:
    """The radiances (size, size, 3) that `render` writes, of any `sky`, and of a source of any irradiance, 0 for
    none."""
    _check(scene, size, spp)
    with _mitsuba() as mi, tempfile.TemporaryDirectory() as folder:
        file = _bsdf_file(source, Path(folder))
        world = mi.load_dict(_scene(mi, scene, file, size, sky, irradiance))
        return np.array(mi.render(world, spp=spp, seed=seed), np.float64)[..., :3]


def _check(scene: str, size: int, spp: int) -> None:
    if scene not in SCENES:
        raise ValueError(f"there is no scene {scene!r}{did_you_mean(scene, SCENES)}: they are {', '.join(SCENES)}")
    for name, value, most in (("size", size, 8192), ("spp", spp, 65536)):
        if not 1 <= value <= most:
            raise ValueError(f"{name} = {value}: must be a whole number from 1 to {most}")


def _bsdf_file(source: Measurement | BRDF | PathLike, folder: Path) -> Path:
    """An RGL file of linear sRGB that Mitsuba can open: the one that was given, or a temporary one."""
    if isinstance(source, Measurement | BRDF):
        return export(source, folder / "surface.bsdf", "rgl").path
    path = Path(source)
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    lobes = read(path)
    return path if lobes.basis == "RGB" else export(lobes, folder / "surface.bsdf", "rgl").path


@contextmanager
def _mitsuba() -> Iterator[ModuleType]:
    """Mitsuba in a variant that works here; the one that was set before is set again."""
    try:
        import mitsuba as mi
    except (ImportError, NameError):
        # Mitsuba trips over a name of its own where a library of the system is missing.
        raise RuntimeError(
            "rendering needs Mitsuba 3, which is not installed or cannot be loaded: pip install mitsuba (and on a bare "
            "Debian apt-get install libatomic1)"
        ) from None
    before = mi.variant()
    try:
        _choose_variant(mi)
        yield mi
    finally:
        if before is not None:
            mi.set_variant(before)


def _choose_variant(mi: ModuleType) -> None:
    """Set the fast variant if it works, or the one that needs nothing but Mitsuba."""
    mi.set_variant(FAST if _fast_variant_works() else SAFE)


@functools.cache
def _fast_variant_works() -> bool:
    """Whether a small picture can be rendered; in a process of its own, because old LLVM libraries end theirs."""
    done = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, check=False)
    return done.returncode == 0


# --- The world -------------------------------------------------------------------------------------------------------


def _scene(mi: ModuleType, name: str, file: Path, size: int, sky: Sky, irradiance: float) -> dict[str, Any]:
    """What Mitsuba loads."""
    light_direction = np.asarray(appearance.LIGHT) / np.linalg.norm(appearance.LIGHT)
    world: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH + 1},
        "sensor": _camera(mi, name, size),
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(_sky_map(sky)), "to_world": _upright(mi)},
        "surface": {"type": "measured", "filename": str(file)},
    }
    for thing, shape in _things(mi, name).items():
        world[thing] = shape | {"bsdf": {"type": "ref", "id": "surface"}}
    if irradiance > 0:
        light = {"type": "rgb", "value": float(irradiance)}
        world["light"] = {"type": "directional", "direction": (-light_direction).tolist(), "irradiance": light}
    if name != "ball":
        floor = {"type": "diffuse", "reflectance": {"type": "rgb", "value": FLOOR}}
        world["floor"] = {"type": "disk", "to_world": mi.ScalarTransform4f().scale(3000), "bsdf": floor}
    return world


def _things(mi: ModuleType, name: str) -> dict[str, dict[str, Any]]:
    """The shapes that have the measured surface."""
    if name == "cylinder":
        lid = mi.ScalarTransform4f().translate([0, 0, 1.8]).scale(0.8)
        return {
            "side": {"type": "cylinder", "p0": [0, 0, 0], "p1": [0, 0, 1.8], "radius": 0.8},
            "lid": {"type": "disk", "to_world": lid},
        }
    return {"sphere": {"type": "sphere", "center": [0, 0, 0 if name == "ball" else 1], "radius": 1}}


def _camera(mi: ModuleType, name: str, size: int) -> dict[str, Any]:
    """What looks along +y: from afar at the ball, from near and a little above at the others."""
    film = {
        "type": "hdrfilm",
        "width": size,
        "height": size,
        "pixel_format": "rgb",
        "rfilter": {"type": "box" if name == "ball" else "gaussian"},
    }
    transform = mi.ScalarTransform4f()
    if name == "ball":
        place = transform.look_at(origin=[0, -3, 0], target=[0, 0, 0], up=[0, 0, 1])
        return {"type": "orthographic", "to_world": place, "film": film}
    place = transform.look_at(origin=[0, -7.5, 2.2], target=[0, 0, 0.95], up=[0, 0, 1])
    return {"type": "perspective", "fov": 21.5, "to_world": place, "film": film}


def _upright(mi: ModuleType) -> Any:
    """Mitsuba's sky has its zenith along y: turn it to z."""
    return mi.ScalarTransform4f().rotate([1, 0, 0], 90)


def _sky_map(sky: Sky, rows: int = 512) -> NDArray[np.float32]:
    """`sky` (rows, 2 rows, 3) by polar angle from the zenith and azimuth, as `_upright` has it in the world."""
    theta = (np.arange(rows)[:, None] + 0.5) * (180 / rows)
    phi = (np.arange(2 * rows) + 0.5) * (180 / rows)
    # Mitsuba counts azimuths from -z to x; turned upright, from y to x.
    return np.ascontiguousarray(sky(direction(theta, 90.0 - phi)), np.float32)


def _write(image: Floats, path: Path) -> None:
    """Radiances, or a picture for a screen."""
    if path.suffix.lower() == ".exr":
        import OpenEXR

        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"RGB": image.astype(np.float32)}).write(str(path))
        return
    from PIL import Image

    Image.fromarray(appearance.exposed(image)[0][..., :3]).save(path, format="PNG")
