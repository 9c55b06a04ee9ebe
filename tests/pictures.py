"""What the tests of pictures share: measurements to draw, and what a picture shows."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

import gonio
import microsurfaces as ms
from gonio.detectors import HemisphereGrid, Klems

GRID = HemisphereGrid(theta_step=5.0, phi_step=10.0)
SCENE = gonio.Scene(ms.Gaussian(alpha=0.3, side=100.0, samples=64).build(seed=1), gonio.Conductor("Au"))
GL = pytest.mark.needs("libegl1", "libgl1-mesa-dri")
BY_VTK_AND_BY_MATPLOTLIB = pytest.mark.parametrize("rendered", [pytest.param(True, marks=GL), False])


def measured(detector=GRID, progress=None, **options):
    light = {} if isinstance(detector, Klems) else {"theta_i": (10.0, 50.0), "phi_i": (0.0, 90.0)}
    options = {**light, "wavelengths": (450.0, 650.0), **options}
    return gonio.Goniometer(paths=20_000, replicates=4, detector=detector, **options).measure(SCENE, 1, 1, progress)


def from_function(f, grid=GRID, theta_i=(40.0,), phi_i=(0.0,), error=0.1, mc=0.06):
    """What the plots use of a measurement whose BRDF in every bin is f(theta_o, dphi)."""
    dims = ("order", "theta_i", "phi_i", "theta_o", "dphi", "wavelength")
    shape = (4, len(theta_i), len(phi_i), *grid.shape, 1)
    brdf = np.broadcast_to(f(grid.theta[:, None], grid.dphi[None, :]), grid.shape)
    brdf = np.broadcast_to(brdf[None, None, None, :, :, None], shape)
    edges = {"theta_o": grid.theta_edges, "dphi": grid.dphi_edges}
    dataset = xr.Dataset(
        {
            "brdf": (dims, brdf),
            "brdf_standard_error": (dims, np.full(shape, error)),
            "brdf_standard_error_mc": (dims, np.full(shape, mc)),
            "count": (dims[:-1], np.full(shape[:-1], 100)),
            "projected_solid_angle": (dims[3:5], grid.projected_solid_angles().reshape(grid.shape)),
            **{f"{n}_bounds": ((n, "bounds"), np.stack([e[:-1], e[1:]], axis=1)) for n, e in edges.items()},
        },
        coords={
            "order": ["all", "1", "2", "3+"],
            "theta_i": list(theta_i),
            "phi_i": list(phi_i),
            "theta_o": grid.theta,
            "dphi": grid.dphi,
            "wavelength": [550.0],
        },
        attrs={"title": "a test with a $ in it"},
    )
    return SimpleNamespace(
        dataset=dataset,
        detector=grid,
        wavelengths=np.array([550.0]),
        channels=("550 nm",),
        attributes={},
        measured=np.ones((len(theta_i), len(phi_i)), bool),
    )


def pixels(picture):
    """RGB (rows, columns, 3), 0 to 255, of a figure or of a file."""
    if isinstance(picture, Figure):
        content = io.BytesIO()
        picture.savefig(content, format="png")
        picture = content
    return np.asarray(Image.open(picture).convert("RGB")).astype(float)


def where(picture, colour, tolerance=40):
    """Columns and rows of the pixels near an RGB colour."""
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    rows, columns = np.nonzero(np.abs(picture - wanted).max(axis=-1) < tolerance)
    return columns, rows


def words_of(figure):
    """Everything that is written in a figure."""
    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]
