"""Gaussian surfaces against the closed forms of their covariance, discretisation included.

Realisations of different seeds are independent: every expected value is judged by a t-score over seeds, at one
family-wise level a law.
"""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import stats

from microsurfaces import Gaussian, HeightField

LEVEL = 1e-3  # probability that a law is found broken though it holds


def assert_means(values, expected, bias=0.0):
    """Means over the first axis (independent realisations) are as expected, all of them together at LEVEL."""
    values = np.asarray(values).reshape(len(values), -1)
    error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
    distance = np.maximum(np.abs(values.mean(axis=0) - np.ravel(expected)) - bias, 0)
    each = 1 - (1 - LEVEL) ** (1 / values.shape[1])
    assert (distance / error).max() < stats.t.ppf(1 - each / 2, len(values) - 1)


def covariance(x, y, sigma, tau_x, tau_y, rotation, side):
    """Closed form: the Gaussian of the surface's own axes, summed over the periods that matter."""
    angle, total = np.radians(rotation), 0.0
    for k in range(-3, 4):
        for n in range(-3, 4):
            u = (x + k * side) * np.cos(angle) + (y + n * side) * np.sin(angle)
            v = (y + n * side) * np.cos(angle) - (x + k * side) * np.sin(angle)
            total = total + np.exp(-((u / tau_x) ** 2) - (v / tau_y) ** 2)
    return sigma**2 * total


CASES = {
    "isotropic": ({"alpha": 0.3}, (1.5, 10.0, 10.0, 0.0)),
    "anisotropic": ({"alpha_x": 0.2, "alpha_y": 0.45}, (1.5, 15.0, 20 / 3, 0.0)),
    "rotated": ({"alpha_x": 0.2, "alpha_y": 0.45, "rotation": 25.0}, (1.5, 15.0, 20 / 3, 25.0)),
}


@pytest.mark.parametrize("samples", [8, 9])
@pytest.mark.parametrize("case", CASES)
def test_the_covariance_of_the_nodes_is_the_periodic_sum_to_rounding(case, samples):
    roughness, form = CASES[case]
    surface = Gaussian(**roughness, side=60.0, samples=samples)
    x = np.arange(samples) * 60.0 / samples
    expected = covariance(x, x[:, None], *form, 60.0)
    np.testing.assert_allclose(surface.covariance(), expected, atol=1e-14 * expected[0, 0] * samples)


@pytest.mark.parametrize("samples", [8, 9])
@pytest.mark.parametrize("case", CASES)
def test_realisations_have_that_covariance(case, samples):
    """4,000 tiles, products averaged over all pairs of nodes of one offset (on a torus all of them are alike)."""
    roughness, form = CASES[case]
    surface = Gaussian(**roughness, side=60.0, samples=samples)
    z = np.array([surface.build(seed).heights for seed in range(4000)])
    products = np.fft.ifft2(np.abs(np.fft.fft2(z)) ** 2).real / samples**2
    x = np.arange(samples) * 60.0 / samples
    assert_means(products, covariance(x, x[:, None], *form, 60.0))


@pytest.mark.parametrize("cells", [2, 4, 8])
def test_slopes_of_both_facet_kinds_have_the_covariance_of_finite_differences(cells):
    """var(p) = var(q) = 2 (sigma/tau)² (1-exp(-e²))/e²; corr(p, q) = +-(1-exp(-e²))/2, the sign by the diagonal."""
    alpha, seeds = 0.4, 60
    surface = Gaussian(alpha=alpha, correlation_length=10.0, side=200.0, samples=20 * cells)
    e2 = 1 / cells**2
    variance = alpha**2 / 2 * (1 - np.exp(-e2)) / e2
    correlation = (1 - np.exp(-e2)) / 2
    moments = []
    for seed in range(seeds):
        p, q = surface.build(seed).slopes()
        falling = np.indices(p.shape[:2]).sum(axis=0) % 2 == 0
        products = (p * q).mean(axis=2)
        moments.append([np.mean(p**2), np.mean(q**2), products[falling].mean(), products[~falling].mean()])
    assert_means(moments, [variance, variance, correlation * variance, -correlation * variance])


def test_statistics_of_the_class_are_as_asked_and_tiles_spread_as_predicted():
    """One tile's mean square slope spreads by √(3π/4) tau/side along an axis, √(π/2) tau/side in the mean of both."""
    alpha, seeds, areas = 0.3, 64, 30
    surface = Gaussian(alpha=alpha, correlation_length=10.0, side=10.0 * areas, samples=10 * areas)
    found = [surface.build(seed).statistics() for seed in range(seeds)]
    squares = np.array([[s.rms_slope_x**2, s.rms_slope_y**2, s.beckmann_alpha**2 / 2] for s in found])
    expected = alpha**2 / 2 * (1 - np.exp(-0.01)) / 0.01
    assert_means(squares, expected)
    spread = np.array([np.sqrt(3 * np.pi / 4), np.sqrt(3 * np.pi / 4), np.sqrt(np.pi / 2)]) / areas
    ratio = squares.var(axis=0, ddof=1) / (expected * spread) ** 2 * (seeds - 1)
    each = (1 - (1 - LEVEL) ** (1 / 3)) / 2
    assert np.all(ratio > stats.chi2.ppf(each, seeds - 1))
    assert np.all(ratio < stats.chi2.isf(each, seeds - 1))


def test_height_and_correlation_length_are_as_asked():
    seeds, side = 48, 400.0
    surface = Gaussian(alpha=0.3, correlation_length=10.0, side=side, samples=400)
    found = [surface.build(seed).statistics() for seed in range(seeds)]
    lengths = np.array([[s.correlation_length_x, s.correlation_length_y] for s in found])
    # Taking out the mean lowers the correlation by the share π tau²/side² of the variance; e tau/2 is its slope there.
    # The ratio of two fluctuating means is off by terms of the same order.
    share = np.pi * 10.0**2 / side**2
    assert_means(lengths, 10.0, bias=share * np.e * 10.0 / 2)
    assert_means([s.Sq**2 for s in found], 1.5**2 * (1 - share))


def test_the_correlation_lengths_follow_the_anisotropy():
    surface = Gaussian(alpha_x=0.15, alpha_y=0.6, correlation_length=10.0, side=800.0, samples=400)
    found = [surface.build(seed).statistics() for seed in range(24)]
    share = np.pi * 10.0**2 / 800.0**2
    for name, expected in (("x", 20.0), ("y", 5.0)):
        lengths = [getattr(s, f"correlation_length_{name}") for s in found]
        # Chords of the correlation between lags of 2 µm cut its curvature 4e-1/tau² off: at most dx²/tau²/4 of tau.
        assert_means(lengths, expected, bias=expected * (share * np.e / 2 + (2 / expected) ** 2 / 4))


@pytest.mark.parametrize("rotation", [0.0, 30.0, 90.0, 135.0])
def test_the_slope_matrix_turns_with_the_rotation(rotation):
    """Mean over the facets of (p², q², pq): on alternating diagonals pq is the centred second difference of C."""
    ax, ay, tau, dx = 0.2, 0.5, 10.0, 2.0
    surface = Gaussian(alpha_x=ax, alpha_y=ay, rotation=rotation, side=240.0, samples=120)
    form = (tau * np.sqrt(ax * ay) / 2, tau * np.sqrt(ay / ax), tau * np.sqrt(ax / ay), rotation, 240.0)

    def acf(x, y):
        return covariance(x, y, *form)

    expected = [
        2 * (acf(0, 0) - acf(dx, 0)) / dx**2,
        2 * (acf(0, 0) - acf(0, dx)) / dx**2,
        (acf(dx, -dx) - acf(dx, dx)) / 2 / dx**2,
    ]
    c, s = np.cos(np.radians(rotation)), np.sin(np.radians(rotation))
    continuum = np.array([(c * ax) ** 2 + (s * ay) ** 2, (s * ax) ** 2 + (c * ay) ** 2, c * s * (ax**2 - ay**2)]) / 2
    np.testing.assert_allclose(expected, continuum, atol=0.1 * ay**2 / 2)  # the sense of the rotation, within (dx/tau)²
    moments = []
    for seed in range(60):
        p, q = surface.build(seed).slopes()
        moments.append([np.mean(p**2), np.mean(q**2), np.mean(p * q)])
    assert_means(moments, expected)


def test_heights_and_slopes_are_normal():
    """Nodes 4 tau apart are independent (correlation 1e-7), so that Kolmogorov and Smirnov's test holds."""
    surface = Gaussian(alpha=0.4, correlation_length=10.0, side=240.0, samples=120)
    fields = [surface.build(seed) for seed in range(60)]
    heights = np.concatenate([f.heights[::20, ::20].ravel() for f in fields])
    slopes = np.concatenate([f.slopes()[0][::20, ::20, 0].ravel() for f in fields])
    sd = np.sqrt(0.4**2 / 2 * (1 - np.exp(-0.04)) / 0.04)
    assert stats.kstest(heights, "norm", args=(0, 2.0)).pvalue > LEVEL / 2
    assert stats.kstest(slopes, "norm", args=(0, sd)).pvalue > LEVEL / 2


@pytest.mark.parametrize("samples", [2, 3, 5, 64, 97])
def test_any_size_builds_a_tile_of_the_side_asked(samples):
    field = Gaussian(alpha=0.3, side=77.0, samples=samples).build(1)
    assert isinstance(field, HeightField)
    assert field.heights.shape == (samples, samples)
    assert field.period == pytest.approx((77.0, 77.0))


def test_scale_invariance():
    """Ten times longer in every length is the same surface, ten times as large."""
    small = Gaussian(alpha=0.3, correlation_length=10.0, side=200.0, samples=32).build(4)
    large = Gaussian(alpha=0.3, correlation_length=100.0, side=2000.0, samples=32).build(4)
    np.testing.assert_allclose(large.heights, 10 * small.heights, atol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({}, "alpha is missing: give either alpha alone, or alpha_x and alpha_y together"),
        ({"alpha": 0.1, "alpha_x": 0.2}, "alpha = 0.1 and alpha_x = 0.2: give either"),
        ({"alpha_y": 0.2}, "alpha_y = 0.2: give either"),
        ({"alpha": 0.1, "alpha_x": 0.2, "alpha_y": 0.2}, "give either"),
        ({"alpha": -0.1}, "greater than 0"),
        ({"alpha": float("inf")}, "finite"),
        (
            {"alpha": 0.1, "side": 39.0},
            "side = 39 µm is less than 4 correlation lengths of 10 µm: make the side larger",
        ),
        ({"alpha_x": 0.1, "alpha_y": 0.4, "side": 79.0}, "less than 4 correlation lengths of 20 µm"),
        ({"alpha": 0.1, "samples": 1}, "greater than or equal to 2"),
        ({"alpha": 0.1, "samples": 1_000_000}, "less than or equal to 16384"),
        ({"alpha": 0.1, "tau": 3.0}, "[Uu]nexpected"),
    ],
)
def test_bad_parameters_are_refused(wrong, sentence):
    with pytest.raises(ValidationError, match=sentence):
        Gaussian(**wrong)
