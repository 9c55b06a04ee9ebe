"""Figures of measurements and of surfaces: lobes, slices, maps, albedo, differences, fits, spheres, reliefs and paths.

The only importer of matplotlib and pyvista, both lazily. Every figure has the lamp on the left and the mirror direction
on the right, says what its units are and shows the noise where it can.
"""

from gonio.plots.albedo import albedo
from gonio.plots.ball import sphere
from gonio.plots.difference import difference
from gonio.plots.fits import fits
from gonio.plots.hemisphere import hemisphere
from gonio.plots.interactive import interactive
from gonio.plots.lobes import lobes
from gonio.plots.paths import paths
from gonio.plots.relief import relief
from gonio.plots.slices import slices
from gonio.plots.surface_view import show

__all__ = [
    "albedo",
    "difference",
    "fits",
    "hemisphere",
    "interactive",
    "lobes",
    "paths",
    "relief",
    "show",
    "slices",
    "sphere",
]
