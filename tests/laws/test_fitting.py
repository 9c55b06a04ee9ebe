"""Fits: true values come back, intervals cover, and what a wrong model does to its parameters is told."""

from dataclasses import replace

import numpy as np
import pytest
from statistical import assert_covers
from synthetic import GRID, TRUTH, external, poisson, synthetic

import microsurfaces as ms
from gonio.detectors import Apertures, HemisphereGrid
from gonio.fitting import fit, rank
from gonio.fitting.binning import joined
from gonio.goniometer import Goniometer
from gonio.models import (
    GGX,
    AshikhminShirley,
    Beckmann,
    CookTorrance,
    Lambert,
    Microfacet,
    OrenNayar,
    PoulinFournier,
    SmithCorrelated,
    SmithSeparable,
    VCavity,
    Ward,
)
from gonio.models.parameters import with_values
from gonio.optics import Conductor, Dielectric, Lambertian, Mirror
from gonio.sphere import direction
from gonio.transport.scene import Scene

pytestmark = pytest.mark.slow

WIDE = HemisphereGrid(theta_step=10.0, phi_step=20.0)


def smith(alpha, distribution=Beckmann):
    return Microfacet(distribution=distribution(alpha), masking=SmithCorrelated(), material=Mirror())


# --- The truth comes back ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("truth", "start"),
    [
        (Lambert(0.37), {"reflectance": 0.9}),
        (CookTorrance(m=0.3, material=Mirror(), k_d=0.2, k_s=0.7), {"m": 0.8, "k_d": 0.1, "k_s": 0.3}),
        (CookTorrance(m_x=0.2, m_y=0.5, material=Mirror()), {"m_x": 0.4, "m_y": 0.4}),
        (CookTorrance(m=0.2, material=Dielectric(eta=1.6)), {"m": 0.5, "material.eta": 1.3}),
        (CookTorrance(m=0.3, material=Conductor(eta=0.5, k=3.0)), {"material.eta": 1.0, "material.k": 2.0}),
        (smith(0.6, GGX), {"distribution.alpha": 0.1}),
        (
            PoulinFournier(profile="grooves", distance=1.4, local=Lambertian(0.6)),
            {"distance": 3.0, "local.reflectance": 0.9},
        ),
        (
            PoulinFournier(distance=3.0, floor_height=0.4, local=Lambertian(0.6)),
            {"distance": 4.0, "floor_height": 0.1, "local.reflectance": 0.9},
        ),
        (PoulinFournier(distance=1.6, local=Conductor(eta=0.5, k=3.0)), {"distance": 2.5}),
        (OrenNayar(sigma=25.0, reflectance=0.6), {"sigma": 5.0, "reflectance": 0.9}),
        (Ward(alpha=0.2, specular=0.3, reflectance=0.4), {"alpha": 0.5, "specular": 0.1, "reflectance": 0.1}),
        (AshikhminShirley(n=50.0, specular=0.3, reflectance=0.4), {"n": 200.0, "specular": 0.6}),
    ],
    ids=repr,
)
def test_without_noise_the_parameters_come_back(truth, start):
    measurement = synthetic(truth=truth, noise=0.0, theta_i=(10.0, 55.0), order=truth.order, detector=WIDE)
    found = fit(measurement, with_values(truth, start), free=start)
    for parameter in found.parameters:
        value = truth
        for part in parameter.name.split("."):
            value = getattr(value, part)
        assert parameter.value == pytest.approx(value, rel=2e-3), found.sentences()
        assert not parameter.at_bound
    assert found.l1 < 1e-3


# --- Intervals --------------------------------------------------------------------------------------------------------


def test_intervals_cover():
    """In 30 repeats t-scores of known parameters are as they should be, noise of two wavelengths being one."""
    truth = Microfacet(distribution=Beckmann(0.35), masking=SmithCorrelated(), material=Dielectric(eta=1.5))
    exact = {"distribution.alpha": 0.35, "material.eta": 1.5}
    scores = {name: [] for name in exact}
    inside = 0
    for seed in range(30):
        measurement = poisson(
            seed, 40_000 / 0.05, truth, theta_i=(20.0, 60.0), wavelengths=(450.0, 650.0), detector=WIDE
        )
        for p in fit(measurement, truth, free=exact).parameters:
            scores[p.name].append((p.value - exact[p.name]) / p.standard_error)
            inside += p.interval[0] <= exact[p.name] <= p.interval[1]
    for values in scores.values():
        assert_covers(np.array(values), 200)
    assert 0.88 <= inside / 60 <= 1.0


def test_a_wrong_model_knows_its_parameters_less_well():
    """The noise goes away with more light, the lack of fit stays, and covers what parts of the data would say."""
    wrong = CookTorrance(m=0.5, material=Mirror())
    few, many = (fit(synthetic(smith(0.6), noise, theta_i=(0.0, 60.0)), wrong).parameters[0] for noise in (0.1, 0.001))
    assert many.noise < 0.02 * few.noise
    assert many.lack_of_fit == pytest.approx(few.lack_of_fit, rel=0.6)
    assert many.lack_of_fit > 10 * many.noise
    parts = [fit(synthetic(smith(0.6), 0.001, theta_i=(theta,)), wrong).parameters[0] for theta in (0.0, 60.0)]
    assert abs(parts[0].value - parts[1].value) > 10 * many.noise
    for part in parts:
        assert abs(part.value - many.value) < 4 * np.hypot(many.lack_of_fit, part.lack_of_fit)


def test_correlated_parameters_are_told():
    """Under one incidence the weight of the lobe and the index of glass do the same thing."""
    truth = CookTorrance(m=0.2, material=Dielectric(eta=1.5), k_s=0.8)
    found = fit(poisson(1, 100_000, truth, theta_i=(0.0,)), truth, free=("k_s", "material.eta"))
    assert abs(found.correlation[0, 1]) > 0.95
    assert any("hardly tells them apart" in sentence for sentence in found.warnings())
    assert not fit(poisson(1, 100_000, truth, theta_i=(0.0,)), truth, free=("m", "material.eta")).warnings()


def test_the_reflectance_at_normal_incidence_follows_from_the_index():
    truth = CookTorrance(m=0.2, material=Dielectric(eta=1.5))
    found = fit(poisson(2, 100_000, truth, theta_i=(0.0, 60.0)), truth, free=("m", "material.eta"))
    (nm, value, error) = found.normal_reflectance[0]
    eta = found.parameters[1]
    assert nm == 550.0
    assert value == pytest.approx(((eta.value - 1) / (eta.value + 1)) ** 2, rel=1e-9)
    slope = 4 * (eta.value - 1) / (eta.value + 1) ** 3
    assert error == pytest.approx(slope * eta.standard_error, rel=1e-2)
    assert abs(value - 0.04) < 4 * error


def test_a_parameter_at_its_limit_is_told():
    found = fit(synthetic(Lambert(1.0), 0.01), Lambert(0.5))
    brighter = replace(found, parameters=found.parameters)
    assert brighter.parameters[0].at_bound
    assert any("stands at its limit" in sentence for sentence in found.sentences())


# --- Which model ------------------------------------------------------------------------------------------------------


def test_the_truth_is_ranked_first():
    measurement = poisson(3, 20_000)
    models = (CookTorrance(m=0.3, material=Mirror()), TRUTH, Lambert(0.5), smith(0.3, GGX))
    first, *others = rank([fit(measurement, model) for model in models])
    best = first.fit
    assert best.model.distribution.alpha == pytest.approx(0.4, abs=0.02)
    assert isinstance(best.model.distribution, Beckmann)
    assert first.difference == 0.0
    assert all(other.difference > 10.0 and other.told_apart for other in others)
    assert best.dispersion == pytest.approx(1.0, abs=0.2)


def test_a_useless_parameter_costs():
    """The same lobe with one more parameter: about two units of the criterion worse, on average over noise."""
    differences = []
    for seed in range(8):
        measurement = poisson(seed, 20_000, smith(0.3), detector=WIDE)
        axes = ["distribution.alpha_x", "distribution.alpha_y"]
        plain, more = (fit(measurement, smith(0.3), free) for free in (["distribution.alpha"], axes))
        differences.append({len(f.parameters): d for f, d, _ in rank([plain, more])})
    gain = np.mean([d[2] - d[1] for d in differences])
    assert -0.5 < gain < 3.0  # 2 - chi2 of one degree of freedom: 1 +- 0.5


def test_two_names_of_one_model_are_not_told_apart():
    measurement = poisson(4, 20_000, detector=WIDE)
    other = Microfacet(distribution=Beckmann(0.4), masking=SmithSeparable(), material=Mirror())
    _, second = rank([fit(measurement, model) for model in (TRUTH, other)])
    assert second.difference == pytest.approx(0.0, abs=1.0)
    assert not second.told_apart


def test_wavelengths_that_travelled_together_count_once():
    """Twice the wavelengths, the very same counts: the same difference between models."""
    models = (TRUTH, CookTorrance(m=0.3, material=Mirror()))
    one, two = (poisson(5, 5_000, wavelengths=nm, detector=WIDE) for nm in ((550.0,), (450.0, 650.0)))
    differences = [rank([fit(measurement, model) for model in models])[1].difference for measurement in (one, two)]
    assert differences[0] == pytest.approx(differences[1], rel=0.05)


def test_fits_of_different_data_are_not_ranked():
    one, other = (fit(synthetic(theta_i=(theta,)), Lambert(0.5)) for theta in (0.0, 30.0))
    with pytest.raises(ValueError, match="same order, incidences"):
        rank([one, other])


# --- What the field expects -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("alpha", "limit"), [(0.3, 0.01), (0.5, 0.01), (0.8, 0.02)])
def test_smith_finds_the_roughness_of_gaussian_surfaces(alpha, limit):
    """Eight traced patches: Smith's alpha is the facets', and V-cavities must bend their m to imitate the lobes."""
    surface = ms.Gaussian(alpha=alpha, correlation_length=12.0, side=480.0, samples=480)
    goniometer = Goniometer(
        theta_i=(0, 30, 60), paths=100_000, wavelengths=(550,), detector=HemisphereGrid(1.0, 1.0), orders=2
    )
    total = None
    for patch in range(8):
        part = goniometer.measure(Scene(surface.build(patch), Mirror()), seed=patch)
        total = part if total is None else total.merge(part)
    facets = total.surface_statistics["beckmann_alpha"]
    (found,) = fit(total, smith(0.2)).parameters
    assert found.value == pytest.approx(facets, rel=limit)
    assert found.facets == facets
    bent = fit(total, CookTorrance(m=0.2, material=Mirror()))
    assert bent.parameters[0].value / facets - 1 > (0.005 if alpha == 0.3 else 0.04)
    assert f"it is {bent.parameters[0].value / facets - 1:+.1%} away" in bent.sentences()[0]


# --- Bins -------------------------------------------------------------------------------------------------------------


def test_bins_are_joined_as_long_as_the_lobe_keeps_its_shape():
    fine = HemisphereGrid(1.0, 1.0)
    chosen = []
    for alpha in (0.02, 0.1, 0.5):
        energy = smith(alpha).average(direction(30.0), fine) * fine.projected_solid_angles()[:, None]
        wider, owner = joined(fine, [energy])
        chosen.append(wider.theta_step)
        light = np.bincount(owner, energy[:, 0], wider.bins)
        assert light.sum() == pytest.approx(energy.sum())
        assert wider == fine or light.sum() ** 2 / (light**2).sum() >= 40
    assert chosen[0] == 1.0
    assert chosen == sorted(chosen)
    assert chosen[-1] > 3.0


def test_apertures_are_fitted_as_they_are():
    detector = Apertures(directions=tuple((theta, 180.0) for theta in range(10, 60, 5)), half_angle=2.0)
    found = fit(synthetic(detector=detector, noise=0.001), smith(0.2))
    assert found.parameters[0].value == pytest.approx(0.4, abs=4 * found.parameters[0].standard_error)
    assert found.bins == 10


# --- External measurements --------------------------------------------------------------------------------------------


def test_parameters_of_a_table_without_errors_come_back():
    truth = CookTorrance(m=0.3, material=Dielectric(eta=1.6))
    measurement = external(truth, theta_i=(10.0, 55.0), detector=WIDE)
    found = fit(measurement, with_values(truth, {"m": 0.5, "material.eta": 1.3}), free=("m", "material.eta"))
    assert [p.value for p in found.parameters] == pytest.approx([0.3, 1.6], rel=1e-3)
    assert found.order == "all"
    assert all(np.isnan(p.noise) and p.standard_error == p.lack_of_fit for p in found.parameters)
    assert np.isnan(found.dispersion)
    words = " ".join(found.sentences())
    assert "nan" not in words
    assert "the variance of the noise" not in words
    assert "intervals speak of lack of fit only" in words
    assert "CookTorrance, which speaks of the light of one hit, was fitted to all of it" in words


def test_intervals_cover_with_and_without_errors():
    """Scatter between blocks of bins stands for the noise where nobody tells it."""
    for told in (True, False):
        scores, inside = [], 0
        for seed in range(100):
            measurement = external(Lambert(0.4), 0.05, seed, detector=WIDE, theta_i=(20.0, 60.0))
            if not told:
                measurement.dataset["brdf_standard_error"][:] = np.nan
            (p,) = fit(measurement, Lambert(0.5)).parameters
            scores.append((p.value - 0.4) / p.standard_error)
            inside += p.interval[0] <= 0.4 <= p.interval[1]
        assert_covers(np.array(scores), 200 if told else 30)
        assert 0.88 <= inside / 100 <= 1.0


def test_with_errors_only_noise_is_left_of_the_right_model():
    measurement = external(smith(0.4), 0.03, 1, theta_i=(0.0, 60.0))
    right, wrong = (fit(measurement, model) for model in (smith(0.2), CookTorrance(m=0.2, material=Mirror())))
    assert right.dispersion == pytest.approx(1.0, abs=0.25)
    assert wrong.dispersion > 5.0
    assert "consistent with noise" in " ".join(right.sentences())
    best, other = rank([wrong, right])
    assert best.fit is right
    assert other.told_apart


def test_without_errors_models_are_ranked_by_their_residuals():
    models = (CookTorrance(m=0.2, material=Mirror()), smith(0.2))
    best, other = rank([fit(external(smith(0.4), theta_i=(0.0, 60.0)), model) for model in models])
    assert isinstance(best.fit.model, Microfacet)
    assert other.told_apart


@pytest.mark.parametrize("noise", [None, 0.01])
def test_bins_that_are_not_known_do_not_decide_a_fit(noise):
    """A hole in the middle of the lobe, and an incidence of which nothing is known."""
    hole = np.zeros((3, 1, *GRID.shape, 1), bool)
    hole[:, :, 4:8, 10:15] = True
    hole[1] = True
    measurement = external(smith(0.3), noise, theta_i=(0.0, 30.0, 60.0), unknown=hole)
    found = fit(measurement, smith(0.6))
    (p,) = found.parameters
    assert p.value == pytest.approx(0.3, abs=1e-4 if noise is None else 4 * p.standard_error)
    assert found.incidences == ((0.0, 0.0), (60.0, 0.0))
    assert found.bins + found.left_out == 2 * GRID.bins
    assert f"{found.left_out} bins took no part" in " ".join(found.sentences())
    by_turns = np.arange(2) != np.arange(GRID.shape[1])[:, None] % 2
    with pytest.raises(ValueError, match="no bin is known at all of these wavelengths"):
        fit(external(wavelengths=(450.0, 650.0), unknown=by_turns), TRUTH)


def test_channels_of_a_colour_have_names():
    truth = CookTorrance(m=0.3, material=Conductor(eta=0.5, k=3.0))
    measurement = external(truth, 0.01, wavelengths=(611.4, 549.1, 464.2), detector=WIDE, attributes={"basis": "RGB"})
    found = fit(measurement, truth, free=("material.eta", "material.k"), wavelengths=(611.4, 464.2))
    assert found.channels == ("R", "B")
    sentences = [sentence for sentence in found.sentences() if sentence.startswith("F0")]
    assert [sentence.split(" at ")[1][0] for sentence in sentences] == ["R", "B"]


# --- What is said of mistakes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"free": ("roughness",)},
            "'roughness' is no parameter of CookTorrance that can be fitted; choose from m, m_x",
        ),
        ({"free": ("material.eta",)}, "'material.eta' is no parameter"),
        ({"free": ()}, "no parameter to fit; name some of m"),
        ({"free": ("m", "m")}, "named twice"),
        ({"free": ("m", "m_x")}, "cannot be fitted together"),
        ({"theta_i": (45.0,)}, "theta_i = 45: not measured; choose from 30 degrees"),
        ({"wavelengths": (400.0,)}, "wavelengths = 400: not measured; choose from 550 nm"),
    ],
)
def test_mistakes_are_told_in_words(options, words):
    with pytest.raises(ValueError, match=words):
        fit(synthetic(detector=WIDE), CookTorrance(m=0.3, material=Mirror()), **options)


def test_a_restricted_fit_is_one_of_the_rest_alone():
    measurement = synthetic(theta_i=(0.0, 30.0, 60.0), wavelengths=(450.0, 650.0))
    found = fit(measurement, smith(0.3), theta_i=(30.0,), wavelengths=(650.0,))
    assert found.incidences == ((30.0, 0.0),)
    assert found.wavelengths == (650.0,)
    assert found.bins == GRID.bins


def test_weights_give_way():
    mixed = CookTorrance(m=0.3, material=Mirror(), k_d=0.2, k_s=0.8)
    assert with_values(mixed, {"k_d": 0.5}).k_s == 0.5
    both = with_values(mixed, {"k_d": 0.9, "k_s": 0.9})
    assert (both.k_d, both.k_s) == (0.5, 0.5)
    assert with_values(mixed, {"k_d": 0.1}).k_s == 0.8
    anisotropic = with_values(mixed, {"m_x": 0.1, "m_y": 0.2})
    assert (anisotropic.m, anisotropic.m_x, anisotropic.m_y) == (None, 0.1, 0.2)
    v_cavity = Microfacet(distribution=Beckmann(0.2), masking=VCavity(), material=Conductor("Au"))
    constant = with_values(v_cavity, {"material.eta": 0.2, "material.k": 3.0})
    assert constant.material == Conductor(eta=0.2, k=3.0)
