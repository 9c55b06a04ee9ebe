"""Maps of the hemisphere and curves of the albedo."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from matplotlib import colormaps
from matplotlib import colors as colours
from matplotlib.contour import QuadContourSet
from pictures import GRID, from_function, measured, pixels, where, words_of
from synthetic import external

import gonio
from gonio import plots
from gonio.detectors import Apertures, Klems
from gonio.models import CookTorrance, Lambert
from gonio.plots import style
from gonio.plots.hemisphere import _Map, contour_levels, on_disc


def test_maps_are_seen_from_above_with_the_incident_direction_left():
    """Light at dphi = 130 only, between 90 (below) and 180 (right): the bright part is lower right, not upper."""
    made = from_function(lambda t, p: np.where((abs(t - 50) < 16) & (abs(p - 130) < 21), 1.0, 1e-3))
    picture = pixels(plots.hemisphere(made))
    above = picture[: picture.shape[0] // 2 + 40, : int(0.72 * picture.shape[1])]
    columns, rows = where(above, "#fde725", 20)
    disc_columns, disc_rows = where(above, "#440154", 20)
    assert len(columns) > 1000
    assert np.median(columns) > np.median(disc_columns) + 30
    assert np.median(rows) > np.median(disc_rows) + 30


def test_bins_without_light_or_with_little_are_blank():
    made = from_function(lambda t, p: (t < 45) * 0.3)
    made.dataset["count"][..., :3, :] = 9
    shown = _Map.of(made.dataset.isel(theta_i=0, phi_i=0), 550.0)
    np.testing.assert_array_equal(np.isnan(shown.value).all(axis=1), GRID.theta >= 45)
    np.testing.assert_array_equal(np.isnan(shown.error).all(axis=1), (GRID.theta >= 45) | (np.arange(19) < 3))
    assert np.nanmax(shown.error) == pytest.approx(100 * 0.1 / 0.3)


def test_a_map_of_differences_is_red_where_the_model_is_too_bright():
    """A model that is 40 % too bright on the incident side and as much too dark on the specular one."""
    measurement = from_function(lambda theta, dphi: np.where(np.cos(np.radians(dphi)) > 0, 1 / 1.4, 1 / 0.6))
    dims = ("theta_i", "phi_i", "theta_o", "dphi", "wavelength")
    measured = measurement.dataset["brdf"].sel(order="1")
    lobes = xr.Dataset(
        {
            "measured": (dims, measured.values),
            "model": (dims, np.ones(measured.shape)),
            "significance": (dims, (measured.values - 1) / 0.1),
        },
        {name: measured[name].values for name in dims},
    )
    comparison = SimpleNamespace(lobes=lobes, order="1", model=Lambert(0.5))
    picture = pixels(plots.difference(measurement, comparison))
    maps = picture[:, : int(0.65 * picture.shape[1])]  # the colour bars are on the right
    bright, dark = (where(maps, colours.to_hex(colormaps["RdBu_r"](share)), 25)[0] for share in (0.9, 0.1))
    assert min(len(bright), len(dark)) > 5000
    assert np.quantile(bright, 0.95) < np.quantile(dark, 0.05)


def test_the_disc_has_equal_areas():
    """A cap's share of the disc is its share of the hemisphere, 1 - cos."""
    theta = np.array([0.0, 20.0, 60.0, 90.0])
    np.testing.assert_allclose(on_disc(theta) ** 2, 1 - np.cos(np.radians(theta)), atol=1e-15)


def test_contours_are_few_and_round():
    assert contour_levels(0.9, 6.0) == [1, 2, 5]
    assert contour_levels(0.02, 11.0) == pytest.approx([0.03, 0.1, 0.3, 1, 3, 10])
    assert contour_levels(1e-4, 2.0) == pytest.approx([1e-3, 1e-2, 0.1, 1])


def test_contours_lie_where_the_value_is_theirs():
    """f = 10^(1 - theta/45): 1 at 45 degrees, a circle on the disc; f = 3 and 5 at other angles."""
    made = from_function(lambda t, p: 10 ** (1 - t / 45.0) + 0 * p, gonio.HemisphereGrid(theta_step=2.0, phi_step=5.0))
    figure = plots.hemisphere(made)
    (contours,) = [each for each in figure.axes[0].get_children() if isinstance(each, QuadContourSet)]
    paths = dict(zip(contours.levels, contours.get_paths(), strict=True))
    for level in (0.5, 1.0, 2.0, 5.0):
        theta = 45 * (1 - np.log10(level))
        np.testing.assert_allclose(paths[level].vertices[:, 1], on_disc(theta), atol=0.01)


def test_klems_patches_are_filled():
    """Every patch that has light is a polygon between its own edges, the azimuth phi_i turned away."""
    made = measured(Klems(basis="quarter"), wavelengths=(550.0,))
    figure = plots.hemisphere(made)
    incidence = style.choose_incidences(made)[0][1]
    value = incidence.data["brdf"].sel(order="all").values[:, 0]
    panel = figure.axes[1]
    assert len(panel.patches) == (value > 0).sum()
    polar, around = Klems(basis="quarter").limits()
    first = np.flatnonzero(value > 0)[0]
    corners = panel.patches[0].get_xy()
    assert {*np.round(corners[:, 1], 9)} == {*np.round(on_disc(polar[first]), 9)}
    assert np.ptp(corners[:, 0]) == pytest.approx(np.radians(2 * around[first, 1]))
    assert corners[:-1, 0].mean() == pytest.approx(np.radians(around[first, 0]))


# --- Albedo ----------------------------------------------------------------------------------------------------------


def curves_of(panel):
    """Data (theta_i, albedo) of the lines with error bars."""
    return [np.stack(container.lines[0].get_data(), axis=1) for container in panel.containers]


def test_curves_of_the_albedo_are_the_albedo_with_its_errors():
    made = measured(theta_i=(10.0, 50.0), phi_i=(0.0, 90.0), wavelengths=(450.0, 650.0))
    figure = plots.albedo(made)
    assert len(figure.axes) == 2
    data = made.dataset
    for panel, phi in zip(figure.axes, (0.0, 90.0), strict=True):
        curves = curves_of(panel)
        expected = [data.sel(order=o, phi_i=phi, wavelength=nm) for o in data["order"].values for nm in (450.0, 650.0)]
        assert len(curves) == len(expected) == 8
        for curve, chosen, container in zip(curves, expected, panel.containers, strict=True):
            np.testing.assert_array_equal(curve[:, 1], chosen["albedo"].values)
            ends = np.array([segment[:, 1] for segment in container.lines[2][0].get_segments()])
            np.testing.assert_allclose(np.diff(ends)[:, 0], 4 * chosen["albedo_standard_error"].values, rtol=1e-6)
        assert any(line.get_ydata()[0] == 1.0 for line in panel.lines if len(line.get_ydata()) == 2)


def test_models_have_their_albedo():
    """A Lambertian's is what it is called, at every angle."""
    made = external(Lambert(0.5), detector=GRID, theta_i=(10.0, 50.0), wavelengths=(450.0, 650.0))
    figure = plots.albedo(made, models=[Lambert(0.3)])
    panel = figure.axes[0]
    for curve in curves_of(panel):
        np.testing.assert_allclose(curve[:, 1], 0.5, rtol=1e-9)
    markers = [line for line in panel.lines if line.get_marker() == "o"]
    assert len(markers) == 2
    for line in markers:
        np.testing.assert_allclose(line.get_ydata(), 0.3, rtol=1e-9)


@pytest.mark.parametrize(
    "detector",
    [Apertures(directions=((30.0, 180.0),), half_angle=3.0), Klems(basis="quarter")],
    ids=["apertures", "klems"],
)
def test_albedo_is_drawn_of_every_detector(detector):
    made = measured(detector)
    model = CookTorrance(m=0.3, material=gonio.Conductor("Au"))
    picture = pixels(plots.albedo(made, models=[model]))
    for nm in (450.0, 650.0):
        assert len(where(picture, colours.to_hex(style.hue(nm)), 25)[0]) > 100


def test_albedo_of_what_nobody_counted_has_no_orders():
    for noise in (None, 0.05):
        made = external(detector=GRID, noise=noise, theta_i=(10.0, 50.0))
        words = words_of(plots.albedo(made))
        assert not any("hit" in text or "order" in text for text in words)
        assert ("± 2 standard errors" in words) == (noise is not None)
    with pytest.raises(ValueError, match="nothing to draw"):
        plots.albedo(external(detector=GRID, unknown=True))
