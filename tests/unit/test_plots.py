"""Pictures: what is drawn is what was measured, the right way round, with and without a GL library."""

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from pictures import BY_VTK_AND_BY_MATPLOTLIB, GRID, from_function, measured, pixels, where, words_of
from synthetic import TRUTH, external

import gonio
from gonio import plots
from gonio.comparison import compare
from gonio.detectors import Apertures, HemisphereGrid
from gonio.models import CookTorrance, Lambert
from gonio.plots import style
from gonio.plots.slices import Cut

KINDS = [plots.lobes, plots.slices, plots.hemisphere]


@pytest.fixture(scope="module")
def measurement():
    return measured()


# --- Every kind ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_draws_every_incidence(kind, measurement, tmp_path):
    path = tmp_path / "picture.png"
    kind(measurement, path)
    assert [p.name for p in tmp_path.iterdir()] == ["picture.png"]
    picture = pixels(path)
    assert picture.shape[1] > picture.shape[0] > 900
    # Four panels, each with its incident direction: its colour is in either half both ways, or in four columns.
    columns, rows = where(picture, style.SOURCE)
    halves = {(4 * c // picture.shape[1], 2 * r // picture.shape[0]) for c, r in zip(columns, rows, strict=True)}
    assert len(halves) >= 4


@pytest.mark.parametrize("kind", KINDS)
def test_the_suffix_chooses_the_file_type(kind, measurement, tmp_path):
    kind(measurement, str(tmp_path / "picture.pdf"))
    assert (tmp_path / "picture.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(ValueError, match=r"picture\.bmp2.*the suffixes are .*\.png"):
        kind(measurement, tmp_path / "picture.bmp2")
    with pytest.raises(FileNotFoundError):
        kind(measurement, tmp_path / "missing" / "picture.png")
    assert [p.name for p in tmp_path.iterdir()] == ["picture.pdf"]


@pytest.mark.parametrize("kind", KINDS)
def test_what_was_not_measured_is_left_out(kind):
    def stop(done, total, rays):
        if done >= total / 2:
            raise KeyboardInterrupt

    part = measured(progress=stop)
    assert sorted(set(part.dataset["paths"].values.flat)) == [0, 20_000]
    assert kind(part).axes
    part.dataset["albedo"][:] = np.nan
    with pytest.raises(ValueError, match="nothing to draw"):
        kind(part)


def test_many_incidences_are_thinned_evenly_and_told():
    many = from_function(lambda t, p: 0.3, theta_i=tuple(range(0, 80, 8)))
    incidences, words = style.choose_incidences(many)
    assert [incidence.theta for incidence in incidences] == [0, 16, 32, 40, 56, 72]
    assert words == "6 of 10 incidences"


def test_of_many_azimuths_the_first_shows_every_ring_and_few_share_the_panels():
    nine = from_function(lambda t, p: 0.3, theta_i=tuple(range(0, 90, 10)), phi_i=tuple(range(0, 360, 15)))
    incidences, words = style.choose_incidences(nine)
    assert [(each.theta, each.phi) for each in incidences] == [(t, 0) for t in (0, 20, 30, 50, 60, 80)]
    assert words == "6 of 216 incidences"
    two = from_function(lambda t, p: 0.3, theta_i=tuple(range(0, 90, 10)), phi_i=(0.0, 90.0))
    assert [(each.theta, each.phi) for each in style.choose_incidences(two)[0]] == [
        (t, phi) for phi in (0, 90) for t in (0, 40, 80)
    ]


def test_apertures_are_points_and_discs_but_no_lobes():
    directions = tuple((float(t), phi) for phi in (0.0, 180.0) for t in range(5, 80, 5))
    points = measured(Apertures(directions=directions, half_angle=3.0))
    assert pixels(plots.slices(points)).std() > 10
    assert pixels(plots.hemisphere(points)).std() > 10
    with pytest.raises(ValueError, match="lobes need a hemisphere of bins"):
        plots.lobes(points)


def test_importing_plots_imports_no_plotting_library():
    code = "import sys, gonio.plots; sys.exit(bool({'matplotlib', 'pyvista', 'vtk'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


# --- Figures ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_figure_is_returned_and_nothing_is_written(measurement, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for kind in (*KINDS, plots.albedo):
        figure = kind(measurement)
        assert isinstance(figure, Figure)
        assert figure._repr_png_().startswith(b"\x89PNG")
    assert not list(tmp_path.iterdir())


def test_many_figures_leave_nothing_open(measurement):
    from matplotlib import pyplot

    for _ in range(25):
        plots.albedo(measurement)
    assert pyplot.get_fignums() == []


def test_one_incidence_is_drawn_if_it_is_asked_for(measurement):
    for kind in KINDS:
        words = " ".join(words_of(kind(measurement, theta_i=50, phi_i=90)))
        assert "= 50°" in words
        assert "= 10°" not in words
    with pytest.raises(ValueError, match="theta_i = 20 was not measured: choose one of 10, 50 degrees"):
        plots.slices(measurement, theta_i=20)


def test_panels_go_into_axes_of_the_callers(measurement, tmp_path):
    whole = Figure(layout="constrained")
    left, right = whole.subfigures(1, 2)
    first, second = left.subplots(2, 1)
    polar, differing = right.subplots(2, 1, subplot_kw={"projection": "polar"})
    comparison = compare(measurement, CookTorrance(m=0.3, material=gonio.Conductor("Au")))
    here = {"theta_i": 50.0, "phi_i": 0.0}
    assert plots.slices(measurement, ax=first, **here) is whole
    assert plots.albedo(measurement, ax=second, phi_i=0.0) is whole
    assert plots.hemisphere(measurement, ax=polar, **here) is whole
    assert plots.difference(measurement, comparison, tmp_path / "all.png", ax=differing, **here) is whole
    assert (tmp_path / "all.png").exists()
    assert first.get_yscale() == "log"
    assert "50°" in first.get_title()
    assert {text.get_text() for text in second.get_legend().get_texts()} > {"450 nm", "650 nm"}
    assert len(whole.axes) == 4 + 2  # maps have colour bars
    assert whole.get_suptitle() == ""


@BY_VTK_AND_BY_MATPLOTLIB
def test_lobes_go_into_axes_of_the_callers(rendered, measurement, monkeypatch):
    monkeypatch.setattr(style, "can_render", lambda: rendered)
    whole = Figure()
    ax = whole.subplots()
    assert plots.lobes(measurement, theta_i=50, phi_i=0, ax=ax) is whole
    assert "50°" in ax.get_title()
    assert {"incident", "specular"} < set(words_of(whole))


def test_axes_have_room_for_one_panel(measurement):
    ax = Figure().subplots()
    with pytest.raises(ValueError, match="ax shows one incidence, and 4 were measured"):
        plots.slices(measurement, ax=ax)
    with pytest.raises(ValueError, match="ax shows one azimuth, and 2 were measured"):
        plots.albedo(measurement, ax=ax)
    with pytest.raises(ValueError, match="ax shows one panel, and here are 2"):
        plots.lobes(measurement, theta_i=50, ax=ax)
    with pytest.raises(ValueError, match="make it with subplot_kw"):
        plots.hemisphere(measurement, theta_i=50, phi_i=0, ax=ax)


# --- Slices ----------------------------------------------------------------------------------------------------------


def test_a_slice_has_the_specular_side_positive():
    """f = theta (2 - cos dphi) is 3 theta on the specular side and theta on the incident one."""
    made = from_function(lambda t, p: t * (2 - np.cos(np.radians(p))), HemisphereGrid(theta_step=2.0, phi_step=10.0))
    (incidence,), _ = style.choose_incidences(made)
    cut = Cut.of(made, incidence)
    value, _ = cut.read(incidence.data, "all", 550.0)
    away = np.abs(cut.angle) > 20
    np.testing.assert_allclose(value[away], np.where(cut.angle > 0, 3, 1)[away] * np.abs(cut.angle[away]), rtol=1e-12)
    assert cut.angle[0] < 0 < cut.angle[-1]
    assert (np.diff(cut.angle) > 0).all()
    # Near the pole several sectors lie within a degree of the plane, and all of them in the polar cap.
    members = np.diff(cut.weights.indptr)
    assert members[cut.angle == 0] == 36
    assert members[cut.angle == 2] == 5
    np.testing.assert_allclose(cut.weights.sum(axis=1), 1.0)


def test_pooled_errors_average_monte_carlo_noise_but_not_that_of_specimens():
    """n equal bins with errors 0.06 (independent) and 0.08 (common): hypot(0.06/sqrt n, 0.08)."""
    made = from_function(lambda t, p: 1.0, HemisphereGrid())
    (incidence,), _ = style.choose_incidences(made)
    cut = Cut.of(made, incidence)
    _, error = cut.read(incidence.data, "all", 550.0)
    members = np.diff(cut.weights.indptr)
    np.testing.assert_allclose(error, np.hypot(0.06 / np.sqrt(members), 0.08), rtol=1e-12)


def test_models_are_drawn_over_the_measurement(measurement):
    bare = pixels(plots.slices(measurement))
    models = (CookTorrance(m=0.3, material=gonio.Conductor("Au")), Lambert(reflectance=0.5))
    overlaid = pixels(plots.slices(measurement, models=models))
    assert bare.shape == overlaid.shape
    assert (bare != overlaid).any(axis=-1).sum() > 1000


def test_wavelengths_have_their_hue():
    blue, green, red = (style.hue(nm) for nm in (450.0, 550.0, 650.0))
    assert blue[2] == max(blue)
    assert green[1] == max(green)
    assert red[0] == max(red)
    assert len({style.hue(nm) for nm in range(300, 900, 40)}) > 10


# --- External measurements -------------------------------------------------------------------------------------------

TABLES = [{}, {"noise": 0.05}, {"noise": 0.05, "unknown": GRID.theta[:, None, None] > 70}]


@pytest.mark.parametrize("options", TABLES, ids=["exact", "errors", "holes"])
@pytest.mark.parametrize("kind", [*KINDS, plots.difference])
def test_every_kind_draws_an_external_measurement(kind, options):
    made = external(detector=GRID, theta_i=(10.0, 50.0), wavelengths=(450.0, 650.0), **options)
    model = CookTorrance(m=0.4, material=gonio.Conductor("Au"))
    further = (compare(made, model),) if kind is plots.difference else ()
    picture = pixels(kind(made, *further))
    # Two panels side by side, and two rows of maps if there are errors.
    columns, _ = where(picture, style.SOURCE)
    assert {2 * c // picture.shape[1] for c in columns} == {0, 1}
    if kind in (plots.hemisphere, plots.difference):
        assert (picture.shape[0] > 900) == ("noise" in options)
    nothing = external(detector=GRID, unknown=True)
    if not further:
        with pytest.raises(ValueError, match="nothing to draw"):
            kind(nothing)


def test_channels_of_a_colour_are_called_by_their_names():
    made = external(detector=GRID, wavelengths=(611.4, 549.1, 464.2), attributes={"basis": "RGB"})
    comparison = compare(made, TRUTH)
    words = words_of(plots.slices(made))
    assert {"R", "G", "B"} < set(words)
    for draw in (plots.lobes, plots.hemisphere, lambda made: plots.difference(made, comparison)):
        title = " ".join(words_of(draw(made)))
        assert "channel G" in title
        assert "nm" not in title


def test_what_nobody_counted_is_not_spoken_of():
    """No counts, no orders, and standard errors only where there are some."""
    for noise in (None, 0.05):
        made = external(detector=GRID, noise=noise)
        words = words_of(plots.slices(made))
        assert ("± 2 standard errors" in words) == (noise is not None)
        words += words_of(plots.hemisphere(made))
        assert not any("count" in text or "orders" in text for text in words)
        assert ("relative standard error (%)" in words) == (noise is not None)


def test_a_slice_averages_the_bins_that_are_known():
    """Near the pole several sectors lie in the plane: the value is the mean of those that are known."""
    grid = HemisphereGrid(theta_step=2.0, phi_step=10.0)
    made = external(
        Lambert(0.5), noise=0.1, detector=grid, unknown=((grid.dphi % 20 > 0) | (grid.dphi == 180))[:, None]
    )
    (incidence,), _ = style.choose_incidences(made)
    cut = Cut.of(made, incidence)
    value, error = cut.read(incidence.data, "all", 550.0)
    brdf, errors = (incidence.data[name].sel(order="all").values[..., 0] for name in ("brdf", "brdf_standard_error"))
    # 0 and 20 degrees on the incident side; of the specular one only 160 and 200.
    incident, specular = (np.flatnonzero(np.isin(grid.dphi, some)) for some in ((340, 0, 20), (160, 200)))
    np.testing.assert_allclose(value[cut.angle == -2], brdf[1, incident].mean(), rtol=1e-12)
    np.testing.assert_allclose(value[cut.angle == 2], brdf[1, specular].mean(), rtol=1e-12)
    np.testing.assert_allclose(error[cut.angle == 2], np.sqrt((errors[1, specular] ** 2).sum()) / 2, rtol=1e-12)
    assert np.isnan(value[cut.angle > 20]).all()
    assert np.isfinite(value[cut.angle < 2]).all()
