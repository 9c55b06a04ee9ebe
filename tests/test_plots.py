"""Pictures: what is drawn is what was measured, the right way round, with and without a GL library."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from matplotlib import colormaps
from matplotlib import colors as colours
from PIL import Image
from synthetic import TRUTH, foreign

import gonio
import microsurfaces as ms
from gonio import plots
from gonio.compare import compare
from gonio.detectors import Apertures, HemisphereGrid
from gonio.models import CookTorrance, Lambert

KINDS = [plots.lobes, plots.slices, plots.hemisphere]
GRID = HemisphereGrid(theta_step=5.0, phi_step=10.0)
SCENE = gonio.Scene(ms.Gaussian(alpha=0.3, side=100.0, samples=64).build(seed=1), gonio.Conductor("Au"))


def measured(detector=GRID, progress=None, **options):
    options = {"theta_i": (10.0, 50.0), "phi_i": (0.0, 90.0), "wavelengths": (450.0, 650.0), **options}
    return gonio.Goniometer(paths=20_000, replicates=4, detector=detector, **options).measure(SCENE, 1, 1, progress)


@pytest.fixture(scope="module")
def measurement():
    return measured()


def from_function(f, grid=GRID, theta_i=(40.0,), error=0.1, mc=0.06):
    """What the plots use of a measurement whose BRDF in every bin is f(theta_o, dphi)."""
    dims = ("order", "theta_i", "phi_i", "theta_o", "dphi", "wavelength")
    shape = (4, len(theta_i), 1, *grid.shape, 1)
    brdf = np.broadcast_to(f(grid.theta[:, None], grid.dphi[None, :]), grid.shape)
    brdf = np.broadcast_to(brdf[None, None, None, :, :, None], shape)
    edges = {"theta_o": grid.theta_edges, "dphi": grid.dphi_edges}
    dataset = xr.Dataset(
        {
            "brdf": (dims, brdf),
            "standard_error": (dims, np.full(shape, error)),
            "standard_error_mc": (dims, np.full(shape, mc)),
            "hits": (dims[:-1], np.full(shape[:-1], 100)),
            "projected_solid_angle": (dims[3:5], grid.projected_solid_angles().reshape(grid.shape)),
            **{f"{n}_bounds": ((n, "bounds"), np.stack([e[:-1], e[1:]], axis=1)) for n, e in edges.items()},
        },
        coords={
            "order": ["all", "1", "2", "3+"],
            "theta_i": list(theta_i),
            "phi_i": [0.0],
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
        measured=np.ones((len(theta_i), 1), bool),
    )


def pixels(path):
    return np.asarray(Image.open(path).convert("RGB")).astype(float)


def where(picture, colour, tolerance=40):
    """Columns and rows of the pixels near an RGB colour."""
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    rows, columns = np.nonzero(np.abs(picture - wanted).max(axis=-1) < tolerance)
    return columns, rows


# --- Every kind ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_draws_every_incidence(kind, measurement, tmp_path):
    path = kind(measurement, tmp_path / "picture.png")
    assert [p.name for p in tmp_path.iterdir()] == ["picture.png"]
    picture = pixels(path)
    assert picture.shape[1] > picture.shape[0] > 900
    # Four panels, each with its lamp: clusters of lamp-coloured pixels in either half both ways, or in four columns.
    columns, rows = where(picture, plots.LAMP)
    halves = {(4 * c // picture.shape[1], 2 * r // picture.shape[0]) for c, r in zip(columns, rows, strict=True)}
    assert len(halves) >= 4


@pytest.mark.parametrize("kind", KINDS)
def test_the_suffix_chooses_the_file_type(kind, measurement, tmp_path):
    assert kind(measurement, str(tmp_path / "picture.pdf")).read_bytes().startswith(b"%PDF")
    with pytest.raises(ValueError, match=r"picture\.bmp2.*the suffixes are .*\.png"):
        kind(measurement, tmp_path / "picture.bmp2")
    with pytest.raises(FileNotFoundError):
        kind(measurement, tmp_path / "missing" / "picture.png")
    assert [p.name for p in tmp_path.iterdir()] == ["picture.pdf"]


@pytest.mark.parametrize("kind", KINDS)
def test_what_was_not_measured_is_left_out(kind, tmp_path):
    def stop(done, total, rays):
        if done >= total / 2:
            raise KeyboardInterrupt

    part = measured(progress=stop)
    assert sorted(set(part.dataset["paths"].values.flat)) == [0, 20_000]
    assert kind(part, tmp_path / "picture.png").exists()
    part.dataset["albedo"][:] = np.nan
    with pytest.raises(ValueError, match="nothing to draw"):
        kind(part, tmp_path / "nothing.png")


def test_many_incidences_are_thinned_evenly_and_told():
    many = from_function(lambda t, p: 0.3, theta_i=tuple(range(0, 80, 8)))
    incidences, words = plots._incidences(many)
    assert [incidence.theta for incidence in incidences] == [0, 16, 32, 40, 56, 72]
    assert words == "6 of 10 incidences"


def test_apertures_are_points_and_discs_but_no_lobes(tmp_path):
    directions = tuple((float(t), phi) for phi in (0.0, 180.0) for t in range(5, 80, 5))
    points = measured(Apertures(directions=directions, half_angle=3.0))
    plots.slices(points, tmp_path / "slices.png")
    plots.hemisphere(points, tmp_path / "hemisphere.png")
    with pytest.raises(ValueError, match="lobes need a hemisphere of bins"):
        plots.lobes(points, tmp_path / "lobes.png")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["hemisphere.png", "slices.png"]


def test_importing_plots_imports_no_plotting_library():
    code = "import sys, gonio.plots; sys.exit(bool({'matplotlib', 'pyvista', 'vtk'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


# --- Lobes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rendered", [True, False])
def test_lobes_have_the_lamp_left_and_the_mirror_right(rendered, tmp_path, monkeypatch):
    """A lobe turned to dphi = 150 is bright right of the middle, by VTK as by matplotlib."""
    if rendered and not plots._can_render():
        pytest.skip("no GL library for VTK")
    monkeypatch.setattr(plots, "_can_render", lambda: rendered)
    lobe = from_function(lambda t, p: np.exp(-(((t - 40) / 15) ** 2) - ((p - 150) / 20) ** 2))
    picture = pixels(plots.lobes(lobe, tmp_path / "lobes.png"))
    picture[:, int(0.8 * picture.shape[1]) :] = 255.0
    lamp, mirror = (where(picture, colour)[0] for colour in (plots.LAMP, plots.MIRROR))
    assert min(len(lamp), len(mirror)) > 100
    assert np.median(lamp) < 0.4 * picture.shape[1] < np.median(mirror)
    red, green, blue = np.moveaxis(picture, -1, 0)
    bright = np.nonzero((green > 150) & (green > 1.5 * blue) & (green > 0.9 * red))[1]
    assert len(bright) > 100
    assert np.median(bright) > 0.4 * picture.shape[1]


@pytest.mark.parametrize(
    "grid",
    [
        HemisphereGrid(),
        HemisphereGrid(theta_step=2.0, phi_step=3.0),
        GRID,
        HemisphereGrid(theta_step=15.0, phi_step=30.0),
        HemisphereGrid(theta_step=3.0, phi_step=5.0, spacing="projected_area"),
    ],
)
def test_a_lambertian_lobe_is_a_sphere(grid):
    """f cos, but where the horizon cuts the patch, and as round as the patch that it is averaged over lets it be."""
    data = from_function(lambda t, p: 0.5 / np.pi, grid).dataset.isel(theta_i=0, phi_i=0)
    lobe = plots._Lobe.of(data, 550.0)
    patch = plots._patch(data)
    expected = 0.5 / np.pi * np.cos(np.radians(lobe.theta))
    inside = lobe.theta < 90 - patch
    # cos averaged over a patch of radius r differs by cos r²/4 at most, on pieces that are half a patch wide.
    tolerance = 0.5 / np.pi * (np.radians(patch) ** 2 / 4 + 0.01)
    np.testing.assert_allclose(
        lobe.value[inside], np.broadcast_to(expected[:, None], lobe.value.shape)[inside], atol=tolerance
    )
    assert lobe.theta[0] == 0
    assert lobe.theta[-1] == 90
    assert not lobe.value[-1].any()
    assert lobe.solid_angle == pytest.approx(np.pi, rel=0.01)


def test_patches_average_with_the_solid_angle():
    """One bin of light near the pole keeps its energy and makes no spike: a patch of it at most, (1 - (d/r)²)² wide."""
    grid = HemisphereGrid()
    spike = from_function(lambda t, p: ((t == 2) & (p == 90)) * 1.0, grid).dataset.isel(theta_i=0, phi_i=0)
    lobe = plots._Lobe.of(spike, 550.0)
    energy = grid.projected_solid_angles().reshape(grid.shape)[2, 90]
    patch = np.pi * np.radians(plots.PATCH) ** 2 / 3
    assert lobe.value.max() == pytest.approx(energy / patch, rel=0.1)
    assert lobe.dphi[np.unravel_index(lobe.value.argmax(), lobe.value.shape)[1]] == 90


def test_the_radius_is_logarithmic_only_for_needles_and_unequal_lobes():
    def shape(width, height=1.0):
        theta = np.linspace(0.0, 90.0, 91)
        value = height * np.exp(-((theta / width) ** 2))
        return plots._Lobe(theta, np.arange(0.0, 360.0, 5.0), np.repeat(value[:, None], 72, axis=1))

    assert not plots._Scale.of([shape(30), shape(30, 0.5)]).logarithmic
    assert plots._Scale.of([shape(3)]).logarithmic
    scale = plots._Scale.of([shape(30), shape(30, 0.01)])
    assert scale.logarithmic
    # Three decades from the centre to the arc.
    np.testing.assert_allclose(
        scale.radius(np.array([0.0, 1e-3, 1e-2, 1e-1, 1.0])), [0, 0, 1 / 3, 2 / 3, 1], atol=1e-12
    )
    assert "logarithmic" in scale.words


@pytest.mark.parametrize(
    ("outcome", "works"),
    [
        (SimpleNamespace(returncode=0), True),
        (SimpleNamespace(returncode=-11), False),
        (subprocess.TimeoutExpired("python", 120), False),
        (OSError("no processes left"), False),
    ],
)
def test_the_probe_survives_a_segmentation_fault(outcome, works, monkeypatch):
    def run(*_, **__):
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    monkeypatch.setattr(plots.subprocess, "run", run)
    assert plots._can_render.__wrapped__() is works


# --- Slices ----------------------------------------------------------------------------------------------------------


def test_a_slice_has_the_mirrors_side_positive():
    """f = theta (2 - cos dphi) is 3 theta toward the mirror and theta toward the lamp."""
    made = from_function(lambda t, p: t * (2 - np.cos(np.radians(p))), HemisphereGrid(theta_step=2.0, phi_step=10.0))
    (incidence,), _ = plots._incidences(made)
    cut = plots._Cut.of(made, incidence)
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
    (incidence,), _ = plots._incidences(made)
    cut = plots._Cut.of(made, incidence)
    _, error = cut.read(incidence.data, "all", 550.0)
    members = np.diff(cut.weights.indptr)
    np.testing.assert_allclose(error, np.hypot(0.06 / np.sqrt(members), 0.08), rtol=1e-12)


def test_models_are_drawn_over_the_measurement(measurement, tmp_path):
    bare = pixels(plots.slices(measurement, tmp_path / "bare.png"))
    models = (CookTorrance(m=0.3, material=gonio.Conductor("Au")), Lambert(reflectance=0.5))
    overlaid = pixels(plots.slices(measurement, tmp_path / "models.png", models=models))
    assert bare.shape == overlaid.shape
    assert (bare != overlaid).any(axis=-1).sum() > 1000


def test_wavelengths_have_their_hue():
    blue, green, red = (plots._hue(nm) for nm in (450.0, 550.0, 650.0))
    assert blue[2] == max(blue)
    assert green[1] == max(green)
    assert red[0] == max(red)
    assert len({plots._hue(nm) for nm in range(300, 900, 40)}) > 10


# --- Maps of the hemisphere ------------------------------------------------------------------------------------------


def test_maps_are_seen_from_above_with_the_lamp_left(tmp_path):
    """Light at dphi = 130 only, between 90 (below) and 180 (right): the bright part is lower right, not upper."""
    made = from_function(lambda t, p: np.where((abs(t - 50) < 16) & (abs(p - 130) < 21), 1.0, 1e-3))
    picture = pixels(plots.hemisphere(made, tmp_path / "map.png"))
    above = picture[: picture.shape[0] // 2 + 40, : int(0.72 * picture.shape[1])]
    columns, rows = where(above, "#fde725", 20)
    disc_columns, disc_rows = where(above, "#440154", 20)
    assert len(columns) > 1000
    assert np.median(columns) > np.median(disc_columns) + 30
    assert np.median(rows) > np.median(disc_rows) + 30


def test_bins_without_light_or_with_little_are_blank():
    made = from_function(lambda t, p: (t < 45) * 0.3)
    made.dataset["hits"][..., :3, :] = 9
    shown = plots._Map.of(made.dataset.isel(theta_i=0, phi_i=0), 550.0)
    np.testing.assert_array_equal(np.isnan(shown.value).all(axis=1), GRID.theta >= 45)
    np.testing.assert_array_equal(np.isnan(shown.error).all(axis=1), (GRID.theta >= 45) | (np.arange(19) < 3))
    assert np.nanmax(shown.error) == pytest.approx(100 * 0.1 / 0.3)


def test_a_map_of_differences_is_red_where_the_model_is_too_bright(tmp_path):
    """A model that is 40 % too bright on the lamp's side and as much too dark on the mirror's."""
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
    verdict = SimpleNamespace(lobes=lobes, order="1", model=Lambert(0.5))
    picture = pixels(plots.difference(measurement, verdict, tmp_path / "map.png"))
    maps = picture[:, : int(0.65 * picture.shape[1])]  # the colour bars are on the right
    bright, dark = (where(maps, colours.to_hex(colormaps["RdBu_r"](share)), 25)[0] for share in (0.9, 0.1))
    assert min(len(bright), len(dark)) > 5000
    assert np.quantile(bright, 0.95) < np.quantile(dark, 0.05)


# --- Measurements from elsewhere -------------------------------------------------------------------------------------

TABLES = [{}, {"noise": 0.05}, {"noise": 0.05, "unknown": GRID.theta[:, None, None] > 70}]


def words_of(draw, monkeypatch):
    """Everything that is written in a figure."""
    from matplotlib.text import Text

    drawn = []
    monkeypatch.setattr(plots, "_save", lambda figure, path: drawn.append(figure) or path)
    draw()
    return [text.get_text() for text in drawn[0].findobj(Text) if text.get_text()]


@pytest.mark.parametrize("options", TABLES, ids=["exact", "errors", "holes"])
@pytest.mark.parametrize("kind", [*KINDS, plots.difference])
def test_every_kind_draws_a_measurement_from_elsewhere(kind, options, tmp_path):
    made = foreign(detector=GRID, theta_i=(10.0, 50.0), wavelengths=(450.0, 650.0), **options)
    model = CookTorrance(m=0.4, material=gonio.Conductor("Au"))
    further = (compare(made, model),) if kind is plots.difference else ()
    picture = pixels(kind(made, *further, tmp_path / "picture.png"))
    # Two panels side by side, and two rows of maps if there are errors.
    columns, _ = where(picture, plots.LAMP)
    assert {2 * c // picture.shape[1] for c in columns} == {0, 1}
    if kind in (plots.hemisphere, plots.difference):
        assert (picture.shape[0] > 900) == ("noise" in options)
    nothing = foreign(detector=GRID, unknown=True)
    if not further:
        with pytest.raises(ValueError, match="nothing to draw"):
            kind(nothing, tmp_path / "nothing.png")


def test_channels_of_a_colour_are_called_by_their_names(monkeypatch):
    made = foreign(detector=GRID, wavelengths=(611.4, 549.1, 464.2), attributes={"basis": "RGB"})
    verdict = compare(made, TRUTH)
    words = words_of(lambda: plots.slices(made, "x.png"), monkeypatch)
    assert {"R", "G", "B"} < set(words)
    for draw in (plots.lobes, plots.hemisphere, lambda m, path: plots.difference(m, verdict, path)):
        title = " ".join(words_of(lambda draw=draw: draw(made, "x.png"), monkeypatch))
        assert "channel G" in title
        assert "nm" not in title


def test_what_nobody_counted_is_not_spoken_of(monkeypatch):
    """No hits, no orders, and standard errors only where there are some."""
    for noise in (None, 0.05):
        made = foreign(detector=GRID, noise=noise)
        words = words_of(lambda made=made: plots.slices(made, "x.png"), monkeypatch)
        assert ("± 2 standard errors" in words) == (noise is not None)
        words += words_of(lambda made=made: plots.hemisphere(made, "x.png"), monkeypatch)
        assert not any("hits" in text or "orders" in text for text in words)
        assert ("relative standard error (%)" in words) == (noise is not None)


def test_a_slice_averages_the_bins_that_are_known():
    """Near the pole several sectors lie in the plane: the value is the mean of those that are known."""
    grid = HemisphereGrid(theta_step=2.0, phi_step=10.0)
    made = foreign(Lambert(0.5), noise=0.1, detector=grid, unknown=((grid.dphi % 20 > 0) | (grid.dphi == 180))[:, None])
    (incidence,), _ = plots._incidences(made)
    cut = plots._Cut.of(made, incidence)
    value, error = cut.read(incidence.data, "all", 550.0)
    brdf, errors = (incidence.data[name].sel(order="all").values[..., 0] for name in ("brdf", "standard_error"))
    # 0 and 20 degrees on the lamp's side; of the mirror's only 160 and 200.
    lamp, mirror = (np.flatnonzero(np.isin(grid.dphi, some)) for some in ((340, 0, 20), (160, 200)))
    np.testing.assert_allclose(value[cut.angle == -2], brdf[1, lamp].mean(), rtol=1e-12)
    np.testing.assert_allclose(value[cut.angle == 2], brdf[1, mirror].mean(), rtol=1e-12)
    np.testing.assert_allclose(error[cut.angle == 2], np.sqrt((errors[1, mirror] ** 2).sum()) / 2, rtol=1e-12)
    assert np.isnan(value[cut.angle > 20]).all()
    assert np.isfinite(value[cut.angle < 2]).all()


@pytest.mark.parametrize("rendered", [True, False])
def test_a_lobe_has_a_hole_where_nothing_is_known(rendered, tmp_path, monkeypatch):
    """Only the plane of incidence is known: of the lobe a ribbon is left."""
    if rendered and not plots._can_render():
        pytest.skip("no GL library for VTK")
    monkeypatch.setattr(plots, "_can_render", lambda: rendered)
    counts = []
    for unknown in (False, GRID.dphi % 180 > 0):
        made = foreign(Lambert(0.5), detector=GRID, unknown=np.reshape(unknown, (-1, 1)))
        picture = pixels(plots.lobes(made, tmp_path / "lobes.png"))[:, :700]
        red, green, blue = np.moveaxis(picture, -1, 0)
        counts.append(((green > red + 40) & (green > 0.8 * blue)).sum())
    assert 100 < counts[1] < 0.3 * counts[0]
