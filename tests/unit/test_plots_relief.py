"""Figures of microsurfaces: what is drawn is what the surface reports, beside what its recipe asks for."""

from pathlib import Path

import numpy as np
import pictures
import pytest
from matplotlib import colormaps
from pictures import pixels

import microsurfaces as ms
from gonio.plots.relief import ALONG, Slopes, correlations, inclinations, radial, relief, shade, summary

GAUSSIAN = ms.Gaussian(alpha=0.3, correlation_length=10.0, side=300.0, samples=256)
SKEWED = ms.Gaussian(alpha_x=0.1, alpha_y=0.4, correlation_length=10.0, side=300.0, samples=256)
STEEL = ms.HeightFieldFile(
    path=str(Path(__file__).parents[2] / "configs" / "ground_steel.png"),
    pixel_size=0.5,
    unit="um",
    scale=0.001,
    periodic="mirror",
)
FIELDS = [GAUSSIAN, SKEWED, ms.Gaussian(alpha=0.05, side=100.0, samples=64), GAUSSIAN.build(4), ms.Flat(), STEEL]
MESHES = [
    ms.Cylinders(),
    ms.Cylinders(profile="grooves", distance=2.5),
    ms.VGrooves(angle=60.0),
    ms.VGrooves(angle=45.0),
    ms.VGrooves(m=0.4),
    ms.Gaussian(alpha=0.3, side=100.0, samples=64).build(1).mesh(),
]


def words_of(figure):
    return "\n".join(pictures.words_of(figure))


def titled(figure, title):
    """The panel of that title."""
    (panel,) = (axes for axes in figure.axes if axes.get_title().startswith(title))
    return panel


# --- Every kind ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("surface", [*FIELDS, *MESHES], ids=lambda surface: str(surface)[:40])
def test_every_surface_is_drawn(surface, tmp_path):
    relief(surface, tmp_path / "relief.png")
    picture = pixels(tmp_path / "relief.png")
    assert [p.name for p in tmp_path.iterdir()] == ["relief.png"]
    assert picture.shape[:2] == (1080, 1920)
    assert (picture < 250).any(axis=-1).mean() > 0.05


@pytest.mark.parametrize("surface", [*FIELDS, *MESHES], ids=lambda surface: str(surface)[:40])
def test_every_axis_has_a_name_and_no_letter_is_cut_off(surface):
    figure = relief(surface)
    figure.canvas.draw()
    for panel in figure.axes:
        assert panel.get_xlabel() or panel.get_ylabel(), panel.get_title()
        labels = (panel.title, panel.xaxis.label, panel.yaxis.label)
        boxes = [(figure.bbox, text.get_window_extent()) for text in (figure.texts[0], *labels)]
        if panel.get_legend():
            boxes.append((panel.get_window_extent(), panel.get_legend().get_window_extent()))
        for outer, inner in boxes:
            assert outer.x0 - 1 < inner.x0 <= inner.x1 < outer.x1 + 1, panel.get_title()
            assert outer.y0 - 1 < inner.y0 <= inner.y1 < outer.y1 + 1, panel.get_title()


def test_the_seed_makes_another_specimen():
    one, same, other = (words_of(relief(GAUSSIAN, seed=seed)) for seed in (1, 1, 2))
    assert one == same
    assert one != other
    assert summary(GAUSSIAN.build(2).statistics()) in other


def test_numbers_are_those_of_the_statistics():
    statistics = GAUSSIAN.build(1).statistics()
    told = summary(statistics)
    for number in (statistics.Sq, statistics.rms_slope_x, statistics.beckmann_alpha_y, statistics.correlation_length_x):
        assert f"{number:.3g}" in told
    assert "µm" in told
    assert "no rms" in summary(ms.Cylinders().build(0).statistics())
    assert summary(ms.Statistics()) == "the surface overhangs"


# --- Slopes ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("surface", "alphas"), [(GAUSSIAN, (0.3, 0.3)), (SKEWED, (0.1, 0.4))])
def test_the_target_of_a_gaussian_is_beckmanns_closed_form(surface, alphas):
    """Slopes along an axis have the variance alpha²/2; facets 8 nodes or more a correlation length see 1 % less."""
    slopes = Slopes.of(surface, surface.build(0))
    middle = (slopes.edges[1:] + slopes.edges[:-1]) / 2
    for target, alpha in zip(slopes.target, alphas, strict=True):
        expected = np.exp(-((middle / alpha) ** 2)) / (alpha * np.sqrt(np.pi))
        np.testing.assert_allclose(target, expected, atol=0.02 * expected.max())
        assert (target * np.diff(slopes.edges)).sum() == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("surface", [GAUSSIAN, SKEWED, ms.VGrooves(m=0.4), ms.VGrooves(angle=60.0), ms.Flat()], ids=str)
def test_densities_have_the_moments_that_are_reported(surface):
    built = surface.build(1)
    slopes, statistics = Slopes.of(surface, built), built.statistics()
    middle, step = (slopes.edges[1:] + slopes.edges[:-1]) / 2, np.diff(slopes.edges)
    for density, rms in zip(slopes.density, (statistics.rms_slope_x, statistics.rms_slope_y), strict=True):
        assert (density * step).sum() == pytest.approx(1.0, abs=2e-3)
        assert np.sqrt((density * step * middle**2).sum()) == pytest.approx(rms, abs=0.01 * rms + step[0] / 2)
    assert slopes.beyond == pytest.approx(0.0, abs=2e-3)


def test_x_is_x_and_y_is_y():
    """The skewed surface is four times as steep along y."""
    slopes = Slopes.of(SKEWED, SKEWED.build(0))
    assert slopes.density[0].max() == pytest.approx(4 * slopes.density[1].max(), rel=0.1)
    figure = relief(SKEWED)
    for axis, letter in enumerate("xy"):
        panel = titled(figure, f"slopes along {letter}")
        assert f"partial {letter}" in panel.get_xlabel()
        (line,) = panel.get_lines()
        np.testing.assert_array_equal(line.get_ydata(), Slopes.of(SKEWED, SKEWED.build(0)).target[axis])


def test_what_asks_for_nothing_is_held_against_the_gaussian_of_its_rms():
    field = SKEWED.build(3)
    slopes = Slopes.of(field, field)
    middle, statistics = (slopes.edges[1:] + slopes.edges[:-1]) / 2, field.statistics()
    for target, sigma in zip(slopes.target, (statistics.rms_slope_x, statistics.rms_slope_y), strict=True):
        expected = np.exp(-((middle / sigma) ** 2) / 2) / (sigma * np.sqrt(2 * np.pi))
        np.testing.assert_allclose(target, expected, atol=0.01 * expected.max())
    words = words_of(relief(field))
    assert "same rms" in words
    assert "asked for" not in words


def test_steep_walls_are_told_and_not_drawn():
    """Of half cylinders the share 1 - sin(atan s) of the plane is steeper than s."""
    slopes = Slopes.of(ms.Cylinders(), ms.Cylinders().build(0))
    assert slopes.edges[-1] == 4.0
    assert slopes.beyond == pytest.approx(1 - 4 / np.sqrt(17), abs=5e-3)
    np.testing.assert_allclose(slopes.density[0], slopes.target[0], atol=0.05 * slopes.target[0].max())


def test_inclinations_are_shares_of_the_plane():
    """Half cylinders: the share sin(t) of the plane is at most at t; equal grooves: all at their angle."""
    angles, share = inclinations(ms.Cylinders(chords=2000).build(0))
    np.testing.assert_allclose(share, np.sin(np.radians(angles)), atol=3e-3)
    angles, share = inclinations(ms.VGrooves(angle=60.05).build(0))
    np.testing.assert_allclose(share, angles > 60.05, atol=3e-3)


# --- Correlation, spectrum, relief -----------------------------------------------------------------------------------


def test_correlations_run_along_x_and_y():
    field = SKEWED.build(2)
    acf = field.acf()
    (lag_x, x), (lag_y, y) = correlations(field, acf)
    step = field.spacing[0]
    assert (lag_x[3], x[3], y[3]) == (3 * step, acf[0, 3], acf[3, 0])
    assert len(lag_y) == 129
    panel = titled(relief(SKEWED, seed=2), "autocorrelation")
    measured_x, measured_y, target_x, target_y = panel.get_lines()[:4]
    np.testing.assert_array_equal(measured_x.get_ydata(), x)
    np.testing.assert_array_equal(measured_y.get_ydata(), y)
    # tau_x = tau √(alpha_y / alpha_x) = 20 µm, tau_y = 5 µm.
    for line, tau in ((target_x, 20.0), (target_y, 5.0)):
        lag, value = line.get_data()
        np.testing.assert_allclose(value[lag < 100], np.exp(-((lag[lag < 100] / tau) ** 2)), atol=1e-9)


def test_the_spectrum_is_averaged_over_rings():
    """Of k² the mean over a ring is about k²; of a random field that of its class, as well as its waves allow."""
    field = GAUSSIAN.build(3)
    psd, kx, ky = field.psd()
    k, mean = radial(np.hypot(kx, ky[:, None]) ** 2, kx, ky)
    np.testing.assert_allclose(mean[k > 0.2], k[k > 0.2] ** 2, rtol=0.01)
    assert (np.diff(k) > 0).all()
    k, mean = radial(psd, kx, ky)
    k, mean = k[(k > 0.06) & (k < 0.4)], mean[(k > 0.06) & (k < 0.4)]
    # A ring has about as many waves as its area in units of dk²; pairs of them are one, each has an exponential law.
    waves = np.pi * (k / kx[1]) ** 2 * 2 * np.sinh(np.log(128) / 40)
    scores = (mean / spectrum(k) - 1) / np.sqrt(2 / waves)
    assert len(scores) > 10
    assert np.abs(scores).max() < 4.0
    assert scores.mean() == pytest.approx(0.0, abs=4 / np.sqrt(len(scores)))


def spectrum(k):
    """Of `GAUSSIAN`: π sigma² tau² exp(-k² tau² / 4)."""
    return np.pi * (1.5 * 10.0) ** 2 * np.exp(-((k * 10.0) ** 2) / 4)


def test_the_target_spectrum_is_the_closed_form():
    panel = titled(relief(GAUSSIAN), "spectrum")
    k, target = panel.get_lines()[1].get_data()
    # The mean over a ring is not the value at its middle where the spectrum falls fast.
    np.testing.assert_allclose(target[k < 0.3], spectrum(k[k < 0.3]), rtol=0.02)


def test_the_relief_is_lit_from_the_upper_left_and_level_parts_keep_their_colours():
    x = np.arange(64.0)
    bump = 8.0 * np.exp(-((x - 32) ** 2 + (x[:, None] - 32) ** 2) / 50)
    field = ms.HeightField(bump, (1.0, 1.0))
    grey = np.full((64, 64, 3), 0.5)
    shaded = shade(grey, field.heights, field)[..., 0]
    # Rows count upward.
    assert shaded[37, 27] > 0.6 > 0.4 > shaded[27, 37]
    assert shaded[2, 2] == pytest.approx(0.5, abs=1e-3)
    flat = ms.Flat().build(0)
    np.testing.assert_allclose(shade(grey[:2, :2], flat.heights, flat), 0.5)


def test_heights_have_their_colours_in_the_picture():
    """A terrace on the right half: yellow there, dark on the left, and the map's own lower half below."""
    heights = np.zeros((64, 64))
    heights[:32, 32:] = 3.0
    picture = pixels(relief(ms.HeightField(heights, (1.0, 1.0))))[:820, 180:880]
    high, low = (
        np.nonzero(np.abs(picture - 255 * np.array(colormaps["viridis"](end)[:3])).max(axis=-1) < 8)
        for end in (1.0, 0.0)
    )
    assert min(len(high[0]), len(low[0])) > 10_000
    assert high[0].mean() > low[0].mean() + 50
    assert high[1].mean() > low[1].mean() + 50


def test_the_section_is_to_scale():
    for surface in (GAUSSIAN, ms.VGrooves(angle=60.0)):
        figure = relief(surface)
        figure.canvas.draw()
        panel = titled(figure, "section")
        box, (left, right), (bottom, top) = panel.get_window_extent(), panel.get_xlim(), panel.get_ylim()
        assert box.width / (right - left) == pytest.approx(box.height / (top - bottom), rel=1e-6)


def test_colours_of_x_and_y_are_kept():
    lines = titled(relief(GAUSSIAN), "autocorrelation").get_lines()
    assert tuple(line.get_color() for line in lines[:2]) == ALONG


def test_unknown_files_are_refused(tmp_path):
    with pytest.raises(ValueError, match="the suffixes are"):
        relief(ms.VGrooves(angle=60.0), tmp_path / "x.bmp2")
    assert not list(tmp_path.iterdir())
