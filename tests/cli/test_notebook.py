"""What notebooks show: small pictures and key numbers in HTML that needs nothing from outside, and lobes that turn."""

import re
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from IPython.core.formatters import DisplayFormatter

import gonio
import microsurfaces as ms
from gonio.detectors import Apertures, HemisphereGrid
from gonio.experiment import Experiment
from gonio.html_drawing import in_plane, plane_of_incidence
from gonio.measurement import tabulated
from gonio.models import Lambert
from gonio.plots.interactive import interactive
from microsurfaces.html_card import html_card, image

RELIEF = ms.Gaussian(alpha=0.3, side=100.0, samples=64).build(seed=1)


def measured(detector=None, **options):
    options = {"theta_i": (10.0, 50.0), "wavelengths": (450.0, 650.0), **options}
    detector = detector or HemisphereGrid(theta_step=5.0, phi_step=10.0)
    instrument = gonio.Goniometer(paths=20_000, replicates=4, detector=detector, **options)
    return instrument.measure(gonio.Scene(RELIEF, gonio.Conductor("Au")), seed=1, threads=1)


@pytest.fixture(scope="module")
def measurement():
    return measured()


def experiment(**options):
    return Experiment(surface=ms.Gaussian(alpha=0.3), material=gonio.Conductor("Au"), **options)


def parsed(thing):
    """What `_repr_html_` says, as a tree and as rows of its table; nothing in it comes from outside."""
    text = thing._repr_html_()
    assert len(text.encode()) < 100_000
    assert not re.search(r"<script|https?:|url\(|<link|@import", text)
    tree = ET.fromstring(re.sub(r"(<img [^>]*)>", r"\1/>", text))
    rows = dict(tuple("".join(cell.itertext()) for cell in row) for row in tree.iter("tr"))
    return tree, rows


def test_a_measurement_shows_lobes_and_numbers(measurement):
    tree, rows = parsed(measurement)
    assert rows["theta_i"] == "10°, 50°"
    assert rows["wavelengths"] == "450 nm, 650 nm"
    assert rows["material"] == "Conductor(name='Au')"
    assert rows["paths"] == "40,000 in all"
    albedo = float(measurement.dataset["albedo"].sel(order="all", theta_i=10.0, phi_i=0.0, wavelength=650.0))
    assert rows["albedo"].startswith(f"{albedo:.4g} ± ")
    polygons = list(tree.iter("polygon"))
    assert len(polygons) == 2
    # The lobe at 50 degrees leans to the specular side, the right.
    points = [tuple(map(float, pair.split(","))) for pair in polygons[1].get("points").split()]
    farthest = max(points, key=lambda point: np.hypot(*point))
    assert np.degrees(np.arctan2(farthest[0], -farthest[1])) == pytest.approx(52, abs=12)
    assert np.hypot(*farthest) == pytest.approx(100, abs=0.2)


def test_apertures_and_external_measurements_have_cards(measurement):
    points = measured(Apertures(directions=((20.0, 180.0),), half_angle=5.0))
    tree, _ = parsed(points)
    assert not list(tree.iter("polygon"))
    assert len(list(tree.iter("line"))) == 4
    grid = HemisphereGrid(15.0, 30.0)
    external = tabulated(
        np.full((1, 1, *grid.shape, 3), 0.1), grid, 20.0, 0.0, [600, 550, 450], attributes={"basis": "RGB"}
    )
    _, rows = parsed(external)
    assert rows["wavelengths"] == "R, G, B"
    assert rows["origin"] == "external"
    assert "±" not in rows["albedo"]


def test_what_was_not_measured_is_told(measurement):
    data = measurement.dataset.copy(deep=True)
    data["albedo"][:] = np.nan
    _, rows = parsed(gonio.Measurement(None, measurement.attributes, data))
    assert rows["theta_i"] == "nothing was measured"
    assert "albedo" not in rows


def test_titles_are_text_and_not_html():
    evil = "<script>alert('&')</script>"
    tree, _ = parsed(experiment(title=evil))
    assert evil in "".join(tree.itertext())
    assert not list(tree.iter("script"))
    assert "&lt;b&gt;" in html_card("<b>", {"<b>": "<b>" * 200})
    assert "<b>" not in html_card("<b>", {"<b>": "<b>" * 200})
    assert 'alt="&quot;&lt;"' in image(np.zeros((2, 2), np.uint8), '"<')


def test_an_experiment_shows_its_incident_directions():
    tree, rows = parsed(experiment(goniometer=gonio.Goniometer(theta_i=(0.0, 30.0, 60.0)), realisations=2, seed=5))
    assert rows["surface"].startswith("Gaussian(alpha=0.3")
    assert rows["light"] == "3 incidences, 3 wavelengths"
    assert rows["paths"] == "2,000,000 an incidence, of 2 specimens"
    assert rows["seed"] == "5"
    assert len(list(tree.iter("line"))) == 6


def test_a_relief_shows_its_middle_and_its_roughness():
    tree, rows = parsed(RELIEF)
    statistics = RELIEF.statistics()
    assert f"Sq = {statistics.Sq:.3g} µm" in rows["heights"]
    assert rows["rms slopes"] == f"{statistics.rms_slope_x:.3g} along x, {statistics.rms_slope_y:.3g} along y"
    assert next(tree.iter("img")).get("src").startswith("data:image/png;base64,")
    parsed(ms.HeightField(np.zeros((3, 5)), (1.0, 1.0)))


def test_light_comes_from_the_left_and_y_is_up():
    """A ridge along y is bright on its left flank, and a picture's first row is the largest y."""
    import base64
    import io

    from PIL import Image

    heights = np.zeros((160, 160))
    heights[120:, 40:80] = np.arange(40)
    heights[120:, 80:120] = np.arange(40)[::-1]
    tree, _ = parsed(ms.HeightField(heights, (1.0, 1.0)))
    content = base64.b64decode(next(tree.iter("img")).get("src").partition(",")[2])
    with Image.open(io.BytesIO(content)) as picture:
        grey = np.asarray(picture).astype(int)
    assert grey[10, 60] > grey[150, 60] > grey[10, 100]


def test_a_sketch_has_the_source_on_the_left_and_lobes_in_the_plane():
    assert plane_of_incidence([90.0]).count('x1="-90.0" y1="-0.0" x2="-110.0"') == 1
    grid = HemisphereGrid(5.0, 10.0)
    dphi = np.broadcast_to(grid.dphi, grid.shape)
    table = np.where(np.abs(dphi - 180) < 45, 1.0, 0.0)[None, None, ..., None]
    data = tabulated(table, grid, 30.0, 0.0, 550.0).dataset.isel(order=0, theta_i=0, phi_i=0, wavelength=0)
    angles, values = in_plane(data)
    assert (np.diff(angles) >= 0).all()
    steep = np.abs(angles) > 10
    np.testing.assert_allclose(values[steep], np.where(angles > 0, np.cos(np.radians(angles)), 0.0)[steep], atol=1e-9)


# --- Lobes that turn -------------------------------------------------------------------------------------------------


def test_lobes_turn_and_have_a_slider(measurement):
    figure = interactive(measurement, 450.0)
    steps = figure.layout.sliders[0].steps
    assert [step.label for step in steps] == ["10°, 0°", "50°, 0°"]
    lobes = [trace for trace in figure.data if trace.type == "surface" and trace.meta is not None]
    assert len(lobes) == 2
    for number, (lobe, step) in enumerate(zip(lobes, steps, strict=True)):
        visible, head = step.args[0]["visible"], step.args[1]["title.text"]
        shown = [trace for trace, flag in zip(figure.data, visible, strict=True) if flag]
        assert lobe in shown
        assert all(trace.meta in (None, number) for trace in shown)
        assert "450 nm" in head
        assert "radius" in head
        radius = np.sqrt(np.asarray(lobe.x) ** 2 + np.asarray(lobe.y) ** 2 + np.asarray(lobe.z) ** 2)
        # The highest vertex may be one of those that are left out to keep the page small.
        assert 0.9 < np.nanmax(radius) <= 1.0 + 1e-3
        assert np.asarray(lobe.z).min() >= 0
    # It begins with the second, whose peak is on the specular side: the source is at x > 0.
    assert [trace.visible for trace in lobes] == [False, True]
    assert np.asarray(lobes[1].x)[np.unravel_index(np.nanargmax(radius), radius.shape)] < -0.4
    assert len(figure.to_json()) < 3e6


def test_a_diffuser_is_half_a_ball_of_light():
    """BRDF times cosine of a Lambertian is a sphere that touches the plane: its radius is the cosine."""
    grid = HemisphereGrid(5.0, 10.0)
    table = Lambert(reflectance=0.5).average([0, 0, 1], grid, [550.0]).reshape(1, 1, *grid.shape, 1)
    figure = interactive(tabulated(table, grid, 0.0, 0.0, 550.0, attributes={"title": "a <b> & $"}))
    assert figure.layout.title.text.startswith("a &lt;b&gt; &amp; $")
    lobe = next(trace for trace in figure.data if trace.meta == 0)
    x, y, z = (np.asarray(getattr(lobe, name)) for name in "xyz")
    centre = np.sqrt(x**2 + y**2 + (z - 0.5) ** 2)
    inner = np.asarray(lobe.customdata)[..., 0] < 80
    np.testing.assert_allclose(centre[inner], 0.5, atol=0.02)
    assert np.asarray(lobe.customdata)[0, 0, 2] == pytest.approx(0.5 / np.pi, rel=0.01)


def test_what_cannot_turn_is_told(measurement, monkeypatch):
    points = measured(Apertures(directions=((20.0, 180.0),), half_angle=5.0))
    with pytest.raises(ValueError, match="lobes need a hemisphere of bins"):
        interactive(points)
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    with pytest.raises(RuntimeError, match="pip install plotly"):
        interactive(measurement)


def test_ipython_shows_the_cards(measurement):
    formatter = DisplayFormatter()
    formatter.active_types = ["text/html", "text/plain"]
    for thing in (measurement, RELIEF, experiment()):
        shown, _ = formatter.format(thing)
        assert shown["text/html"] == thing._repr_html_()
