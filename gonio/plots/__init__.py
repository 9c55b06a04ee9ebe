"""Figures of measurements and of surfaces: lobes, slices, maps, albedo, differences, fits, spheres, reliefs and paths.

Functions return a `matplotlib.figure.Figure`, which a notebook shows, and write it if they are given a path; with `ax`
those of one panel draw into axes of yours. Nothing goes through pyplot, and no window opens but by `show_lobes` and
`show_surface`. Every figure has the incident direction on the left and the specular direction on the right, says what
its units are and shows the noise where it can.

>>> figure = gonio.plots.slices(measurement, models=[model])  # doctest: +SKIP
>>> gonio.plots.slices(measurement, "slices.png", theta_i=30)  # doctest: +SKIP

The only importer of matplotlib and pyvista, both lazily.
"""

from gonio.plots.albedo import albedo
from gonio.plots.ball import sphere
from gonio.plots.difference import difference
from gonio.plots.fits import fits
from gonio.plots.hemisphere import hemisphere
from gonio.plots.interactive import interactive
from gonio.plots.lobe_files import lobe_film, lobe_meshes
from gonio.plots.lobes import LobeStyle, lobes, show_lobes
from gonio.plots.paths import paths
from gonio.plots.relief import relief
from gonio.plots.slices import slices
from gonio.plots.surface_view import show_surface

__all__ = [
    "LobeStyle",
    "albedo",
    "difference",
    "fits",
    "hemisphere",
    "interactive",
    "lobe_film",
    "lobe_meshes",
    "lobes",
    "paths",
    "relief",
    "show_lobes",
    "show_surface",
    "slices",
    "sphere",
]
