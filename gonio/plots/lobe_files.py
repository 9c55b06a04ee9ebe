"""Lobes for other programs and moving ones: glTF, VTK, GIF and MP4."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.plots.lobe_scene import Scale, View, arrows, polydata, surface
from microsurfaces.atomic_write import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VECTORS = (".svg", ".svgz", ".pdf", ".eps", ".ps")
MOVING = (".gif", ".mp4")
SOLID = (".gltf", ".glb", ".vtp")
APART = 2.6
"""Distance between lobes that stand side by side, in units of the outer arc."""
SECOND = 12
"""Pictures a second."""


def save_solids(views: Sequence[View], scale: Scale, path: Path) -> None:
    """Write the lobes side by side along x, the lamp's arrows and the mirror's too where the format has colours."""
    with atomic_write(path) as temporary:
        if path.suffix.lower() == ".vtp":
            parts = [
                polydata(shell, scale).translate((APART * k, 0.0, 0.0))
                for k, view in enumerate(views)
                for shell in view.shells
            ]
            parts[0].append_polydata(*parts[1:]).save(temporary)
        else:
            temporary.write_bytes(_gltf(views, scale, path.suffix.lower()))


def _gltf(views: Sequence[View], scale: Scale, suffix: str) -> bytes:
    """The bytes of a glTF file that holds everything."""
    trimesh: Any = import_module("trimesh")
    scene = trimesh.Scene()
    for k, view in enumerate(views):
        aside = trimesh.transformations.translation_matrix((APART * k, 0.0, 0.0))
        for n, shell in enumerate(view.shells):
            points, corners, colours = surface(shell, scale)
            alpha = np.full((len(points), 1), shell.opacity)
            faces = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
            rgba = np.rint(255 * np.hstack([colours, alpha])).astype(np.uint8)
            mesh = trimesh.Trimesh(points, faces, vertex_colors=rgba, process=False)
            scene.add_geometry(mesh, geom_name=f"lobe {k + 1}.{n + 1}", transform=aside)
        for n, arrow in enumerate(_arrow_meshes(view)):
            scene.add_geometry(arrow, geom_name=f"arrow {k + 1}.{n + 1}", transform=aside)
    if suffix == ".glb":
        return bytes(scene.export(file_type="glb"))
    return bytes(scene.export(file_type="gltf", embed_buffers=True)["model.gltf"])


def _arrow_meshes(view: View) -> Iterable[Any]:
    """Shafts and tips of the arrows of lamp and mirror."""
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


def check_movies(path: Path) -> None:
    """Raise ValueError if no library is installed that writes such a film."""
    try:
        for name in ("imageio", "imageio_ffmpeg")[: 2 if path.suffix.lower() == ".mp4" else 1]:
            import_module(name)
    except ImportError as error:
        raise ValueError(
            f'cannot write {str(path)!r} without {error.name}: pip install "gonio[report]", or draw a .png'
        ) from None


def save_movie(figures: Iterable[Figure], path: Path) -> None:
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


def _pixels(figure: Figure) -> Any:
    """A figure as an array (height, width, 3) of bytes, at two thirds of its size in print."""
    figure.set_dpi(100)
    figure.canvas.draw()
    return np.array(figure.canvas.buffer_rgba())[..., :3]  # type: ignore[attr-defined]
