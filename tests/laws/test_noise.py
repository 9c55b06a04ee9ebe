"""Noise of a known size goes in, and comes out again: the light's, the specimens', and what would help."""

import functools
from dataclasses import replace

import numpy as np
import pytest

import gonio
import microsurfaces as ms
from gonio.detectors import HemisphereGrid
from gonio.goniometer import Goniometer, empty_sums, enter
from gonio.noise import Noise, Noises, noises, variances
from gonio.tally import UNIT, Tally
from gonio.transport.scene import Scene

GRID = HemisphereGrid(theta_step=10.0, phi_step=15.0)
REPLICATES = 16
ALBEDO = 0.6


def injected(realisations, light, specimens, tilt=0.0, seed=0):
    """Specimens whose bins differ by the relative amount `specimens`, and all of a specimen's together by `tilt`.

    Every replicate of every bin has noise of its own, relative size `light` for the mean of a specimen.
    """
    rng = np.random.default_rng(seed)
    goniometer = Goniometer(theta_i=(0,), paths=REPLICATES * 1000, replicates=REPLICATES, detector=GRID, orders=2)
    area = GRID.projected_solid_angles()
    width = len(goniometer.wavelengths)
    mean = ALBEDO / np.pi * area * 1000 * UNIT  # of one replicate
    merged = None
    for _ in range(realisations):
        own = mean * (1 + specimens * rng.standard_normal(GRID.bins)) * (1 + tilt * rng.standard_normal())
        noise = light * np.sqrt(REPLICATES) * rng.standard_normal((GRID.bins, REPLICATES))
        caught = np.zeros((2, GRID.bins + 1, REPLICATES, width + 1), np.int64)
        caught[0, :-1, :, :-1] = (own[:, None] + mean[:, None] * noise)[..., None]
        caught[0, -1] = caught[0, :-1].sum(axis=0)
        caught[0, ..., -1] = 100
        tally = Tally.empty(REPLICATES, 1000, (3, GRID.bins + 1, width))
        tally.add(range(REPLICATES), caught, np.zeros((REPLICATES, 3, width), np.int64))
        sums = empty_sums(goniometer)
        enter(tally, sums, (0, 0))
        specimen = replace(blank(goniometer), sums=sums)
        merged = specimen if merged is None else merged.merge(specimen)
    return merged


@functools.cache
def blank(goniometer, seed=0):
    """A measurement of hardly any light."""
    scene = Scene(ms.Flat().build(seed=0), gonio.Lambertian(0.5))
    return replace(goniometer, paths=32).measure(scene, seed=seed)


@pytest.mark.parametrize(("light", "specimens"), [(0.02, 0.05), (0.05, 0.02), (0.03, 0.0), (0.0, 0.04)])
def test_noise_that_was_put_in_comes_out(light, specimens):
    realisations = 8
    found = noises(injected(realisations, light, specimens))
    whole = np.hypot(light, specimens)
    # Mean squares of B (K - 1) independent values scatter by the square root of 2 / B (K - 1), relatively.
    sure = 4 * whole**2 * np.sqrt(2 / (GRID.bins * (realisations - 1))) / realisations
    assert found.bins.monte_carlo**2 == pytest.approx(light**2 / realisations, abs=sure / 4, rel=1e-6)
    assert found.bins.specimens**2 == pytest.approx(specimens**2 / realisations, abs=sure, rel=1e-6)
    assert found.bins.total**2 == pytest.approx(whole**2 / realisations, abs=2 * sure)
    assert found.realisations == realisations


def test_variances_of_every_bin_are_unbiased():
    """Averaged over many bins, also where there is no difference between specimens at all."""
    for specimens in (0.0, 0.03):
        measurement = injected(4, 0.04, specimens, seed=3)
        parts = variances(measurement).sel(order="all")
        relative = parts / (ALBEDO / np.pi) ** 2
        expected = specimens**2 / 4
        spread = np.sqrt(2 / 3) * (0.04**2 + specimens**2) / 4 / np.sqrt(GRID.bins)
        found = relative["brdf_specimens"].isel(wavelength=0)
        assert float(found.mean()) == pytest.approx(expected, abs=4 * spread)
        assert (found < 0).any() or specimens
        both = parts["brdf_specimens"] + parts["brdf_monte_carlo"]
        np.testing.assert_allclose(both, measurement.dataset["brdf_standard_error"].sel(order="all") ** 2, rtol=1e-9)


def test_specimens_that_differ_as_a_whole_show_in_albedos():
    """A single number is estimated from K specimens: its square has K - 1 degrees of freedom."""
    tilts = [noises(injected(12, 0.02, 0.0, tilt=0.05, seed=seed)).albedo.specimens ** 2 for seed in range(20)]
    expected = 0.05**2 / 12
    assert np.mean(tilts) == pytest.approx(expected, abs=4 * expected * np.sqrt(2 / 11 / len(tilts)))


def test_what_more_work_brings():
    noise = Noise(monte_carlo=0.03, specimens=0.04)
    assert noise.total == pytest.approx(0.05)
    assert noise.with_more() == noise.total
    assert noise.with_more(paths=9) == pytest.approx(np.hypot(0.01, 0.04))
    assert noise.with_more(specimens=4) == pytest.approx(0.025)
    assert noise.with_more(area=16) == pytest.approx(np.hypot(0.03, 0.01))
    assert Noise.together([Noise(0.03, 0.0), Noise(0.01, 0.02)]) == Noise(
        pytest.approx(np.sqrt(0.0005)), pytest.approx(np.sqrt(0.0002))
    )


def test_the_advice_names_the_larger_noise():
    few = Noises(Noise(0.04, 0.01), Noise(0.002, 0.001), 4)
    assert few.sentences() == [
        "Relative standard error of the bins: 4.1 % (4 % Monte Carlo noise, 1 % because specimens differ).",
        "Relative standard error of the albedos: 0.22 % (0.2 % Monte Carlo noise, 0.1 % because specimens differ).",
        "More paths help most: for the bins 4 times the paths give 2.2 %, patches of twice the side 4 %.",
    ]
    many = Noises(Noise(0.01, 0.04), Noise(0.001, 0.002), 4)
    assert many.sentences()[-1] == (
        "Larger or more specimens help most: for the bins patches of twice the side 2.2 %, realisations = 16 2.1 %, "
        "but 4 times the paths give 4 %."
    )


def test_more_specimens_of_a_real_surface_bring_what_was_foretold():
    """A prediction made from 8 specimens holds for 32, with twice the side and with 4 times the paths."""
    goniometer = Goniometer(theta_i=(40,), paths=20_000, detector=GRID, wavelengths=(550,))

    def measured(count, first=0, side=60.0, samples=96, paths=20_000):
        surface = ms.Gaussian(alpha=0.3, correlation_length=10.0, side=side, samples=samples)
        parts = (
            replace(goniometer, paths=paths).measure(Scene(surface.build(seed=k), gonio.Mirror()), seed=k)
            for k in range(first, first + count)
        )
        merged = next(parts)
        for part in parts:
            merged = merged.merge(part)
        return noises(merged).bins

    now = measured(8)
    assert now.specimens > 2 * now.monte_carlo
    assert measured(32, 100).total == pytest.approx(now.with_more(specimens=4), rel=0.15)
    assert measured(8, 200, side=120.0, samples=192).specimens == pytest.approx(
        now.with_more(paths=1e9, area=4), rel=0.2
    )
    # Stratified starts do better than independent ones.
    assert 0.7 < measured(8, 0, paths=80_000).monte_carlo / now.with_more(paths=4, area=1e9) < 1.05


def test_one_specimen_says_what_to_do():
    with pytest.raises(ValueError, match="realisations = 4"):
        variances(injected(1, 0.02, 0.02))


def test_too_few_hits_are_told_and_take_no_part():
    goniometer = Goniometer(theta_i=(0,), paths=16, detector=GRID)
    dim = noises(blank(goniometer, 1).merge(blank(goniometer, 2)))
    assert not dim.bins.known
    assert dim.sentences() == ["No bin has a count of 10, too few to tell how uncertain bins are: trace more paths."]
    lit = Noises(Noise(0.03, 0.01), Noise(0.01, 0.02), 2)
    assert Noises.together([dim, lit, lit]).bins == Noise(pytest.approx(0.03), pytest.approx(0.01))
    assert not Noises.together([dim, dim]).bins.known
