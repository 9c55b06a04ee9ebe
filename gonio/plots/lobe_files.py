"""Lobes for other programs and moving ones: glTF, VTK, GIF and MP4."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gonio.brdf import BRDF
from gonio.detectors import HemisphereGrid
from gonio.plots.lobe_scene import View, arrows, polydata, surface
from gonio.plots.lobes import PLAIN, LobeScene, LobeStyle, on_grid
from gonio.plots.style import PathLike, check_path, choose_incidences
from microsurfaces.atomic_write import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gonio.measurement import Measurement
    from gonio.models import Model

FILMS = (".gif", ".mp4")
"""Suffixes of `lobe_film`."""
MESHES = (".gltf", ".glb", ".vtp")
"""Suffixes of `lobe_meshes`."""
FRAMES = 24
"""Pictures of a film, from the lowest to the highest measured theta_i and back."""
FRAME_GRID = HemisphereGrid(theta_step=2.0, phi_step=4.0)
"""Bins between measured incidences; half a patch wide at most."""
APART = 2.6
"""Distance between lobes that stand side by side, in units of the outer arc."""
SECOND = 12
"""Pictures a second."""


def lobe_film(
    measurement: Measurement, path: PathLike, *, wavelength: float | None = None, style: LobeStyle = PLAIN
) -> Path:
    """Write lobes that move over theta_i, forth and back, as a .gif or .mp4 file, and return its path.

    Drawn as `lobes` draws them, at the first azimuth, interpolated between measured incidences, which the caption
    tells. Raises ValueError for any other suffix, for fewer than two measured theta_i and where the library that writes
    such films is not installed.
    """
    path = _checked(path, FILMS)
    if style.overlaid:
        raise ValueError("a film shows incidences one after another: leave out overlaid")
    _check_libraries(path)
    scene = LobeScene.of(_between(on_grid(measurement)), (), wavelength, style, moving=True)
    _write_film((replace(scene, views=[view]).figure() for view in scene.views), path)
    return path


def lobe_meshes(
    measurement: Measurement,
    path: PathLike,
    *,
    models: Sequence[Model | BRDF] = (),
    wavelength: float | None = None,
    style: LobeStyle = PLAIN,
) -> Path:
    """Write the lobes of `lobes` as .gltf, .glb or .vtp for other programs, and return the path.

    They stand side by side along x, in units of the outer arc, each coloured at its vertices; glTF has arrows of the
    incident and of the specular direction too, VTK the values `brdf_cos` in 1/sr. Raises ValueError for any other
    suffix and for what cannot be drawn.
    """
    path = _checked(path, MESHES)
    scene = LobeScene.of(measurement, models, wavelength, style)
    with atomic_write(path) as temporary:
        if path.suffix.lower() == ".vtp":
            parts = [
                polydata(shell, scene.scale).translate((APART * k, 0.0, 0.0))
                for k, view in enumerate(scene.views)
                for shell in view.shells
            ]
            parts[0].append_polydata(*parts[1:]).save(temporary)
        else:
            temporary.write_bytes(_gltf(scene, path.suffix.lower()))
    return path


def _checked(path: PathLike, suffixes: Sequence[str]) -> Path:
    """The path; ValueError for another suffix, FileNotFoundError without a folder."""
    path = Path(path)
    check_path(path, suffixes)
    return path


# --- Meshes -----------------------------------------------------------------------------------------------------------


def _gltf(scene: LobeScene, suffix: str) -> bytes:
    """The bytes of a glTF file that holds everything."""
    trimesh: Any = import_module("trimesh")
    world = trimesh.Scene()
    for k, view in enumerate(scene.views):
        aside = trimesh.transformations.translation_matrix((APART * k, 0.0, 0.0))
        for n, shell in enumerate(view.shells):
            points, corners, colours = surface(shell, scene.scale)
            alpha = np.full((len(points), 1), shell.opacity)
            faces = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
            rgba = np.rint(255 * np.hstack([colours, alpha])).astype(np.uint8)
            mesh = trimesh.Trimesh(points, faces, vertex_colors=rgba, process=False)
            world.add_geometry(mesh, geom_name=f"lobe {k + 1}.{n + 1}", transform=aside)
        for n, arrow in enumerate(_arrow_meshes(view)):
            world.add_geometry(arrow, geom_name=f"arrow {k + 1}.{n + 1}", transform=aside)
    if suffix == ".glb":
        return bytes(world.export(file_type="glb"))
    return bytes(world.export(file_type="gltf", embed_buffers=True)["model.gltf"])


def _arrow_meshes(view: View) -> Iterable[Any]:
    """Shafts and tips of the arrows of the incident and the specular direction."""
    from matplotlib.colors import to_rgba

    trimesh: Any = import_module("trimesh")
    for incidence in view.incidences:
        for tail, head, colour in arrows(incidence):
            middle = tail + 0.65 * (head - tail)
            shaft = trimesh.creation.cylinder(0.015, segment=(tail, middle), sections=16)
            tip = trimesh.creation.cone(0.04, float(np.linalg.norm(head - middle)), sections=24)
            tip.apply_transform(trimesh.geometry.align_vectors((0, 0, 1), head - middle))
            tip.apply_translation(middle)
            both = trimesh.util.concatenate([shaft, tip])
            both.visual.vertex_colors = np.tile(
                np.uint8(np.rint(255 * np.array(to_rgba(colour)))), (len(both.vertices), 1)
            )
            yield both


# --- Films ------------------------------------------------------------------------------------------------------------


def _check_libraries(path: Path) -> None:
    """Raise ValueError if no library is installed that writes such a film."""
    try:
        for name in ("imageio", "imageio_ffmpeg")[: 2 if path.suffix.lower() == ".mp4" else 1]:
            import_module(name)
    except ImportError as error:
        raise ValueError(
            f'cannot write {str(path)!r} without {error.name}: pip install "gonio[report]", or draw a .png'
        ) from None


def _between(measurement: Measurement) -> Measurement:
    """Incidences of a film, from the lowest to the highest measured theta_i at the first azimuth."""
    chosen, _ = choose_incidences(measurement, panels=1000)
    phi = chosen[0].phi
    theta = [incidence.theta for incidence in chosen if incidence.phi == phi]
    if len(theta) < 2:
        raise ValueError("a film needs two measured theta_i at least, and this measurement has one: draw a picture")
    between = np.unique(np.linspace(min(theta), max(theta), FRAMES).round())
    return BRDF.of(measurement).sampled(between, [phi], FRAME_GRID)


def _write_film(figures: Iterable[Figure], path: Path) -> None:
    """Write figures as a film that goes forth and back."""
    import imageio.v3

    frames = [_pixels(figure) for figure in figures]
    film = np.stack(frames + frames[-2:0:-1])
    with atomic_write(path) as temporary:
        if path.suffix.lower() == ".gif":
            imageio.v3.imwrite(temporary, film, extension=".gif", duration=1000 / SECOND, loop=0)
        else:
            # Codecs want sizes that are even.
            even = film[:, : film.shape[1] // 2 * 2, : film.shape[2] // 2 * 2]
            imageio.v3.imwrite(temporary, even, extension=".mp4", fps=SECOND, macro_block_size=2)


def _pixels(figure: Figure) -> NDArray[np.uint8]:
    """A figure as an array (height, width, 3) of bytes, at two thirds of its size in print."""
    from PIL import Image

    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=100)
    return np.asarray(Image.open(content).convert("RGB"))
