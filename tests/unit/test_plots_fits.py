"""The picture of fits: what is drawn is what was fitted, in its own light, and the intervals are those of the fits."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from pictures import GRID, measured, pixels, where, words_of
from synthetic import external

import gonio
from gonio import plots
from gonio.fitting import fit
from gonio.models import GGX, Beckmann, CookTorrance, Lambert, Microfacet, SmithCorrelated, Ward
from gonio.plots import style
from gonio.sphere import direction

GOLD = gonio.Conductor("Au")
WAVELENGTHS = (450.0, 650.0)


@pytest.fixture(scope="module")
def measurement():
    return measured(theta_i=(0.0, 20.0, 40.0, 60.0), phi_i=(0.0,))


@pytest.fixture(scope="module")
def found(measurement):
    return fit(measurement, CookTorrance(m=0.3, material=GOLD))


def panels(figure):
    """The panels of slices, of residuals, and of parameters."""
    left, right = (half.get_axes() for half in figure.subfigs)
    return left[: len(left) // 2], left[len(left) // 2 :], right


def bars(panel):
    """Ends of every error bar, (n, 2 ends, 2 coordinates)."""
    segments = [ends for part in panel.findobj(LineCollection) for ends in part.get_segments()]
    return np.array([ends for ends in segments if len(ends)])


def curve(panel, colour):
    """x and y of the line of this colour."""
    (line,) = (line for line in panel.lines if line.get_color() == colour and len(line.get_xdata()) > 2)
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def brdf(measurement, order, name="brdf"):
    """Values in the plane of incidence on the specular side beyond 20 degrees, where a bin stands for itself."""
    here = measurement.dataset[name].sel(order=order, theta_i=40, phi_i=0, dphi=180, wavelength=450)
    return here.sel(theta_o=slice(20, 80)).values


def test_slices_show_the_light_that_was_fitted_with_two_standard_errors(measurement, found):
    above, _, _ = panels(plots.fits(measurement, [found]))
    assert [panel.get_title() for panel in above] == [rf"$\theta_i$ = {theta}°, $\phi_i$ = 0°" for theta in (0, 40, 60)]
    ends = bars(above[1])
    ends = ends[(ends[:, 0, 0] >= 20) & (ends[:, 0, 0] <= 80)]
    once, error = (brdf(measurement, "1", name) for name in ("brdf", "brdf_standard_error"))
    np.testing.assert_allclose(ends[:, :, 1].mean(axis=1), once, rtol=1e-12)
    np.testing.assert_allclose(np.diff(ends[:, :, 1], axis=1)[:, 0], 4 * error, rtol=1e-9)
    assert (brdf(measurement, "all") > once).any()


def test_curves_are_the_fitted_model_over_the_same_bins(measurement, found):
    above, below, _ = panels(plots.fits(measurement, [found]))
    exact = found.model.average(direction(40.0, 0.0), GRID, np.array([450.0])).reshape(GRID.shape)
    specular = exact[(GRID.theta >= 20) & (GRID.theta <= 80), list(GRID.dphi).index(180.0)]
    angle, value = curve(above[1], style.FITTED[0])
    there = (angle >= 20) & (angle <= 80)
    np.testing.assert_allclose(value[there], specular, rtol=1e-9)
    angle, rest = curve(below[1], style.FITTED[0])
    np.testing.assert_allclose(rest[there], 100 * (specular / brdf(measurement, "1") - 1), rtol=1e-9, atol=1e-9)


def test_parameters_have_their_intervals_and_the_facets_roughness(measurement, found):
    value = found.parameters[0].value
    parameter = replace(found.parameters[0], interval=(value - 0.01, value + 0.03))
    figure = plots.fits(measurement, [replace(found, parameters=(parameter,))])
    _, _, (roughness, left_over) = panels(figure)
    (ends,) = bars(roughness)
    np.testing.assert_allclose(ends[:, 0], parameter.interval, rtol=1e-12)
    facets = measurement.surface_statistics["beckmann_alpha"]
    (line,) = (line for line in roughness.lines if line.get_linestyle() == "--")
    assert line.get_xdata()[0] == facets
    assert roughness.get_title() == f"roughness, facets {facets:.4g}"
    (said,) = (text for text in words_of(figure) if text.startswith("CookTorrance: m = "))
    numbers = [float(part) for part in said.replace("(", "").replace(")", "").split() if part[0].isdigit()]
    assert numbers == pytest.approx([parameter.value, *parameter.interval], abs=parameter.standard_error)
    (bar,) = left_over.patches
    assert bar.get_width() == pytest.approx(100 * found.l1)


def test_the_title_says_what_was_fitted(measurement, found):
    one = fit(measurement, CookTorrance(m=0.3, material=GOLD), theta_i=(20, 40), wavelengths=(650,))
    figure = plots.fits(measurement, [one])
    title = figure.get_suptitle()
    assert "CookTorrance fitted to light of 1 hit; incident at 20° and 40°; 650 nm" in title
    assert "drawn" not in title
    assert [panel.get_title() for panel in panels(figure)[0]] == [
        rf"$\theta_i$ = {theta}°, $\phi_i$ = 0°" for theta in (20, 40)
    ]
    every = plots.fits(measurement, [found]).get_suptitle()
    assert "incident at 0°, 20°, 40° and 60°; 450 and 650 nm; drawn: 450 nm, 3 of 4 incidences" in every


def test_models_of_different_light_are_told_apart(measurement, found):
    """One model speaks of one hit, the other of all light: each is held against its own."""
    facets = [Microfacet(distribution=d, masking=SmithCorrelated(), material=GOLD) for d in (Beckmann(0.3), GGX(0.2))]
    beckmann, ggx = (fit(measurement, model, theta_i=(40,)) for model in facets)
    ward = fit(measurement, Ward(alpha=0.3, specular=0.5, reflectance=0.1), theta_i=(40,))
    figure = plots.fits(measurement, [beckmann, ggx, ward])
    title = " ".join(figure.get_suptitle().split())
    assert "Microfacet (Beckmann) and Microfacet (GGX) fitted to light of 1 hit" in title
    assert "Ward fitted to light of all orders" in title
    (above,), (below,), right = panels(figure)
    assert [panel.get_title().partition(",")[0] for panel in right] == [
        "roughness",
        "specular",
        "reflectance",
        "residual",
    ]
    assert sum(line.get_marker() in "osD" and len(line.get_xdata()) == 1 for line in right[0].lines) == 3
    for k, order in ((0, "1"), (2, "all")):
        angle, model = curve(above, style.FITTED[k])
        _, rest = curve(below, style.FITTED[k])
        there = (angle >= 20) & (angle <= 80)
        np.testing.assert_allclose(rest[there], 100 * (model[there] / brdf(measurement, order) - 1), rtol=1e-9)


def test_a_parameter_at_its_limit_has_no_interval(measurement, found):
    pressed = replace(found, parameters=(replace(found.parameters[0], at_bound=True),))
    figure = plots.fits(measurement, [pressed, found])
    (ends,) = bars(panels(figure)[2][0])
    np.testing.assert_allclose(ends[:, 0], found.parameters[0].interval, rtol=1e-12)
    assert [text.endswith("(at its limit)") for text in words_of(figure) if ": m = " in text] == [True, False]


def test_an_external_measurement_has_its_channels_and_no_facets():
    colours = external(Lambert(0.5), detector=GRID, wavelengths=(611.4, 549.1, 464.2), attributes={"basis": "RGB"})
    figure = plots.fits(colours, [fit(colours, Lambert(0.4))])
    assert "Lambert fitted to all light; incident at 30°; R, G and B; drawn: channel G" in figure.get_suptitle()
    told = " ".join(words_of(figure))
    assert "facets" not in told
    assert "standard errors" not in told
    assert "noise" not in told


def test_the_file_has_curves_on_the_left_and_intervals_on_the_right(measurement, found, tmp_path):
    second = replace(found, model=CookTorrance(m=0.2, material=GOLD))
    plots.fits(measurement, [found, second], tmp_path / "fits.png")
    picture = pixels(tmp_path / "fits.png")
    for colour in style.FITTED[:2]:
        columns, _ = where(picture, colour, 12)
        share = columns / picture.shape[1]
        assert (share < 0.7).sum() > 300
        assert (share > 0.72).sum() > 100
    plots.fits(measurement, [found], tmp_path / "fits.pdf")
    assert (tmp_path / "fits.pdf").read_bytes().startswith(b"%PDF")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fits.pdf", "fits.png"]


def test_too_many_fits_are_told_and_none_is_a_mistake(measurement, found):
    figure = plots.fits(measurement, [found] * 5)
    assert "4 of 5 fits" in figure.get_suptitle()
    assert "CookTorrance 4" in {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    with pytest.raises(ValueError, match="no fits to draw"):
        plots.fits(measurement, [])
