"""A window onto a surface."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.plots import style
from gonio.plots.style import COLOURS

if TYPE_CHECKING:
    from microsurfaces import Mesh


def require_screen() -> None:
    """Raise RuntimeError where no window can be opened."""
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise RuntimeError("there is no screen to open a window on (DISPLAY is not set): save to a file instead")
    if not style.can_render():
        raise RuntimeError("there is no GL library to draw with: install libegl1 and libgl1-mesa-dri (names in Debian)")


def show_surface(mesh: Mesh) -> None:
    """Open a window with one period of a surface, true to scale and coloured by height; return when it is closed.

    Raises RuntimeError where there is no screen, or no GL library to draw with.
    """
    require_screen()
    import pyvista

    faces: Any = mesh.faces.astype(np.int64)
    surface = pyvista.PolyData.from_regular_faces(mesh.vertices, faces)
    surface["height (µm)"] = mesh.vertices[:, 2]
    plotter: Any = pyvista.Plotter(title="gonio: surface")
    # Beside the surface: a level bar would write its numbers over its name.
    bar: Any = {"vertical": True, "position_x": 0.88, "position_y": 0.2, "height": 0.6, "n_labels": 5, "fmt": "%.3g"}
    plotter.add_mesh(surface, cmap=COLOURS, scalar_bar_args=bar)
    plotter.add_axes()
    plotter.show()
