"""BRDF: models, measurements and Python functions answer the same questions in the same way."""

import numpy as np
import pytest
from example_models import MODELS
from synthetic import TRUTH, external

import gonio
from gonio.brdf import BRDF
from gonio.comparison import compare
from gonio.detectors import Apertures, HemisphereGrid
from gonio.models import GGX, Microfacet, PoulinFournier, SmithCorrelated
from gonio.sphere import direction

NM = (450.0, 650.0)
GRID = HemisphereGrid(theta_step=10.0, phi_step=15.0)
GOLD = gonio.CookTorrance(m=0.4, material=gonio.Conductor("Au"))
ONE_OF_EACH = list(
    {type(model): model for model in MODELS[::-1] if model.__class__.__name__ != "PoulinFournier"}.values()
)
PAIRS = direction([[20.0], [70.0]], 10.0), direction([5.0, 40.0, 80.0], 200.0)


def white(wi, wo):
    """Half of the light, diffusely."""
    return np.full(len(wi), 0.5 / np.pi)


def sampled(model):
    """A measurement that holds a model's averages."""
    return BRDF.of(model, NM).sampled([20.0, 70.0], [0.0], GRID)


@pytest.mark.parametrize("model", ONE_OF_EACH, ids=lambda model: type(model).__name__)
def test_a_model_answers_as_itself(model):
    brdf = BRDF.of(model, NM)
    wi = direction(40.0, 30.0)
    np.testing.assert_array_equal(brdf.average(wi, GRID), model.average(wi, GRID, NM))
    np.testing.assert_array_equal(brdf.eval(*PAIRS), model.eval(*PAIRS, NM))
    assert brdf.wavelengths.tolist() == list(NM)
    assert brdf.title == repr(model)


def test_a_function_answers_as_the_model_of_the_same_formula():
    model = Microfacet(distribution=GGX(0.4), masking=SmithCorrelated(), material=gonio.Mirror())
    one, other = BRDF.of(model, NM), BRDF.of(lambda wi, wo: model.eval(wi, wo), NM)
    np.testing.assert_array_equal(one.eval(*PAIRS), other.eval(*PAIRS))
    wi = direction(40.0)
    np.testing.assert_allclose(other.average(wi, GRID, nodes=24), one.average(wi, GRID), rtol=2e-3)
    assert one.isotropic
    assert other.isotropic


def test_a_measurement_answers_with_its_bins():
    measurement = sampled(GOLD)
    brdf = BRDF.of(measurement.as_isotropic())
    for theta in (20.0, 70.0):
        values = measurement.dataset["brdf"].sel(order="all", theta_i=theta, phi_i=0.0).values.reshape(-1, len(NM))
        np.testing.assert_array_equal(brdf.average(direction(theta), GRID), values)
        there = brdf.albedo(theta), measurement.dataset["albedo"].sel(order="all", theta_i=theta, phi_i=0.0)
        np.testing.assert_allclose(*there, rtol=1e-12)


def test_albedos_of_what_is_known_exactly():
    np.testing.assert_allclose(BRDF.of(white).albedo(65.0), 0.5, rtol=1e-12)
    np.testing.assert_allclose(BRDF.of(gonio.Lambert(0.5)).albedo(65.0, 120.0), 0.5, rtol=1e-12)


@pytest.mark.parametrize(
    "source", [GOLD, white, sampled(GOLD).as_isotropic()], ids=["model", "function", "measurement"]
)
def test_every_source_keeps_the_same_rules(source):
    brdf = BRDF.of(source)
    below = direction(120.0)
    assert (brdf.eval(direction(20.0), below) == 0.0).all()
    assert (brdf.eval(below, direction(20.0)) == 0.0).all()
    assert brdf.eval(*PAIRS).shape == (2, 3, len(brdf.wavelengths))
    assert brdf.average(direction(20.0), GRID).shape == (GRID.bins, len(brdf.wavelengths))
    eye = Apertures(((30.0, 180.0),), 5.0)
    assert brdf.average(direction(20.0), eye).shape == (1, len(brdf.wavelengths))
    for wrong in (np.ones(2), np.ones((3, 4)), 1.0):
        with pytest.raises(ValueError, match="the last axis of directions must be 3"):
            brdf.eval(wrong, direction(20.0))
        with pytest.raises(ValueError, match="the last axis of directions must be 3"):
            brdf.average(wrong, GRID)


@pytest.mark.parametrize("model", ONE_OF_EACH, ids=lambda model: type(model).__name__)
def test_models_refuse_what_is_no_direction(model):
    with pytest.raises(ValueError, match=r"wo has shape \(2,\): the last axis of directions must be 3"):
        model.eval(direction(20.0), np.ones(2))


def test_a_singular_model_has_averages_and_says_why_it_has_no_values():
    brdf = BRDF.of(PoulinFournier(local=gonio.Mirror(), distance=3.0, floor_height=0.0))
    assert brdf.average(direction(30.0, 20.0), GRID).max() > 0.0
    with pytest.raises(ValueError, match="no value at a point; use average"):
        brdf.eval(*PAIRS)


def test_a_function_of_the_wrong_shape_is_told():
    def wrong(wi, wo):
        return np.ones((len(wi), 3))

    with pytest.raises(ValueError, match=r"function wrong returned an array of shape \(4, 3\) for 4 pairs"):
        BRDF.of(wrong, NM)


def test_a_measurement_has_the_wavelengths_that_it_has():
    with pytest.raises(ValueError, match="known at 450, 650 nm and not at 550 nm"):
        BRDF.of(sampled(GOLD), [550.0])


@pytest.mark.parametrize("source", [GOLD, white], ids=["model", "function"])
def test_what_is_no_measurement_is_exported_like_one(source, tmp_path):
    brdf = BRDF.of(source)
    exported = gonio.export(brdf, tmp_path / "a.bsdf")
    back = BRDF.of(gonio.load(exported.path))
    for theta in (0.0, 30.0, 60.0):
        expected = brdf.in_basis(back.basis).albedo(theta)
        np.testing.assert_allclose(back.albedo(theta), expected, rtol=2e-3)


def test_two_measurements_of_one_truth_are_consistent_within_the_noise_of_both():
    """The noise of the one that stands for the model counts: without it chi² would be 2."""
    one = external(truth=TRUTH, noise=0.05, seed=1)
    other = external(truth=TRUTH, noise=0.05, seed=2)
    table = compare(one, other.as_isotropic()).table
    assert table["reduced_chi2"].item() == pytest.approx(1.0, abs=0.1)
