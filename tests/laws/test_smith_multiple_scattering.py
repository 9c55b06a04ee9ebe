"""All orders of scattering under Smith's assumptions, against slow walks, quadrature and conservation laws."""

import os

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy import stats
from scipy.special import ndtr, ndtri
from specimens import COARSE_GRID
from statistical import assert_covers, assert_equal_within_noise, sidak

from gonio.detectors import Apertures, HemisphereGrid, Klems
from gonio.models.distributions import BECKMANN, GGX, Beckmann, Mixture
from gonio.models.masking import SmithCorrelated
from gonio.models.microfacet import Microfacet
from gonio.models.smith_multiple_scattering import BATCHES, SmithMultipleScattering
from gonio.models.visible_normals import projected_area, visible_normal
from gonio.optics import Conductor, Lambertian, Mirror
from gonio.sphere import angles, direction, half_vector, reflect

pytestmark = pytest.mark.slow

FREEDOM = BATCHES - 1
METAL = Conductor(eta=0.2, k=1.5)

SHAPES = [
    Beckmann(0.7),
    GGX(0.6),
    Beckmann(alpha_x=0.3, alpha_y=0.9, rotation=25.0),
    GGX(alpha_x=0.8, alpha_y=0.2, rotation=-40.0),
    Mixture(components=((0.4, Beckmann(0.2)), (0.6, GGX(alpha_x=0.4, alpha_y=0.9, rotation=15.0)))),
]


def smith(distribution, material=Mirror(), walks=100_000, seed=0):  # noqa: B008 - a frozen recipe
    return SmithMultipleScattering(distribution=distribution, material=material, walks=walks, seed=seed)


# --- The walk as published, step by step, with heights and with normals by rejection ----------------------------------


def proposed(lobes, v, rng):
    """A facet normal for every direction (n, 3), and which are kept: those kept have the density of visible normals."""
    c, s = lobes[:, 4], lobes[:, 5]
    x, y, z = v.T[..., None]
    stretched = np.stack(np.broadcast_arrays(lobes[:, 2] * (c * x + s * y), lobes[:, 3] * (c * y - s * x), z), axis=-1)
    across = np.hypot(stretched[..., 0], stretched[..., 1])
    gaussian = lobes[:, 0] == BECKMANN
    bound = lobes[:, 1] * np.where(gaussian, np.maximum(z + 6 * across, 0), 2 * np.hypot(across, z))
    total = bound.cumsum(axis=1)
    j = (rng.random(len(v))[:, None] * total[:, -1:] > total).sum(axis=1)
    rows = np.arange(len(v))
    # Slopes of a Gaussian surface, or points of a hemisphere.
    radius, turn = np.minimum(np.sqrt(-np.log(rng.random(len(v)))), 6.0), rng.uniform(0, 2 * np.pi, len(v))
    height = rng.random(len(v))
    radius = np.where(gaussian[j], radius, np.sqrt(1 - height**2))
    normal = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.where(gaussian[j], 1.0, height)], axis=-1)
    facing = lobes[j, 1] * np.where(gaussian[j], 1, 2) * np.maximum((stretched[rows, j] * normal).sum(axis=1), 0)
    kept = rng.random(len(v)) * bound[rows, j] < facing
    x, y = lobes[j, 2] * normal[:, 0], lobes[j, 3] * normal[:, 1]
    wm = np.stack([c[j] * x - s[j] * y, s[j] * x + c[j] * y, normal[:, 2]], axis=-1)
    return wm / np.linalg.norm(wm, axis=-1, keepdims=True), kept


def seen_normals(lobes, v, rng):
    """One visible normal for every direction (n, 3)."""
    wm, missing = np.empty_like(v), np.arange(len(v))
    while missing.size:
        copies = max(1, 50_000 // missing.size)
        found, kept = proposed(lobes, np.repeat(v[missing], copies, axis=0), rng)
        kept = kept.reshape(missing.size, copies)
        first, any_kept = kept.argmax(axis=1), kept.any(axis=1)
        wm[missing] = np.where(
            any_kept[:, None], found.reshape(missing.size, copies, 3)[np.arange(missing.size), first], wm[missing]
        )
        missing = missing[~any_kept]
    return wm


def slow_walk(distribution, material, wi, count, rng, wavelengths):
    """Exit directions, hits and weights of paths through a Gaussian height field, as the paper has them."""
    lobes = distribution.lobes()
    travel, height = np.repeat(-wi[None], count, axis=0), np.full(count, np.inf)
    hits, weights, flying = np.zeros(count, int), np.ones((count, len(wavelengths))), np.arange(count)
    while flying.size:
        w, u = travel[flying], 1 - rng.random(flying.size)
        up = w[:, 2] > 0
        facing = np.where(up[:, None], w, -w)
        rate = distribution.smith_lambda(facing) + ~up
        with np.errstate(divide="ignore", over="ignore"):
            lower = ndtr(height[flying]) * u ** np.where(up, -1 / rate, 1 / rate)
        escaped = lower >= 1
        flying, w = flying[~escaped], w[~escaped]
        height[flying] = ndtri(lower[~escaped])
        wm = seen_normals(lobes, -w, rng)
        weights[flying] *= material.reflectance(np.clip(-(w * wm).sum(axis=1), 0, 1), wavelengths)
        travel[flying] = reflect(-w, wm)
        hits[flying] += 1
    return travel, hits, weights


def binned(grid, wi, wo, hits, weights, orders):
    """What arrives in every bin of a grid, (orders + 1, bins, W)."""
    theta, phi = angles(wo)
    ring = np.searchsorted(grid.theta_edges[1:-1], theta, side="right")
    sector = np.floor((phi - angles(wi)[1]) / grid.phi_step + 0.5).astype(int) % grid.shape[1]
    caught = np.zeros((orders + 1, grid.bins, weights.shape[1]))
    np.add.at(caught, (np.minimum(hits, orders), ring * grid.shape[1] + sector), weights)
    caught[0] = caught[1:].sum(axis=0)
    return caught


@pytest.mark.parametrize(
    ("distribution", "theta_i"),
    [
        *zip(SHAPES, (0.0, 50.0, 50.0, 80.0, 50.0), strict=True),
        *zip(SHAPES[:2], (80.0, 80.0), strict=True),
        (GGX(1.5), 70.0),
        (Beckmann(1.5), 55.0),
    ],
    ids=repr,
)
def test_bins_against_the_walk_as_published(distribution, theta_i):
    """Every order, order 1 included: our depths, normals and shares against heights and rejections."""
    rng, wi, wavelengths, size = np.random.default_rng(1), direction(theta_i, 20.0), (550.0,), 2000
    walks = [np.split(x, BATCHES) for x in slow_walk(distribution, METAL, wi, BATCHES * size, rng, wavelengths)]
    batches = np.array([binned(COARSE_GRID, wi, *batch, 3) for batch in zip(*walks, strict=True)])
    slow = batches / (size * COARSE_GRID.projected_solid_angles()[:, None])
    expected, its_error = slow.mean(axis=0), slow.std(axis=0, ddof=1) / np.sqrt(BATCHES)
    model = smith(distribution, METAL, walks=200_000)
    value, error = model.estimate(wi, COARSE_GRID, wavelengths)
    # A bin whose paths can be counted on fingers has no Gaussian error.
    enough = (batches > 0).sum(axis=0) >= BATCHES - 2
    assert enough[:3].any(axis=(1, 2)).all()
    assert_equal_within_noise(value[enough], expected[enough], np.hypot(error, its_error)[enough], FREEDOM, sidak(18))
    albedo, error = model.albedo(wi, wavelengths)
    slow = batches.sum(axis=2) / size
    both = np.hypot(error, slow.std(axis=0, ddof=1) / np.sqrt(BATCHES))
    assert_equal_within_noise(albedo, slow.mean(axis=0), both, FREEDOM, sidak(18))


# --- Facets -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("distribution", SHAPES, ids=repr)
def test_projected_area_is_smiths_lambda(distribution):
    theta = np.array([0.0, 1.0, 30.0, 70.0, 89.0, 89.9999])
    for phi in (0.0, 77.0):
        for w in direction(theta, phi):
            masked = distribution.smith_lambda(w)
            lobes = distribution.lobes()
            assert projected_area(lobes, *w) == pytest.approx(w[2] * (1 + masked), rel=1e-12)
            assert projected_area(lobes, *-w) == pytest.approx(w[2] * masked, rel=1e-9, abs=1e-300)


@pytest.mark.parametrize("distribution", SHAPES, ids=repr)
@pytest.mark.parametrize("theta", [0.0, 40.0, 85.0, 95.0, 130.0])
def test_visible_normals_have_their_density(distribution, theta):
    """Chi^2 over cells of the hemisphere, from above and from below the horizon."""
    v, lobes, count = direction(theta, 35.0), distribution.lobes(), 20_000
    area = projected_area(lobes, *v)
    found = np.array([visible_normal(lobes, *v, walk, 3, 11, 0) for walk in range(count)])
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=1e-14)
    assert (found[:, 2] > 0).all()
    assert (found @ v > -1e-12).all()
    rings, sectors, fine = 6, 8, 60
    u = (np.arange(rings * fine) + 0.5) / (rings * fine)
    phi = (np.arange(sectors * fine) + 0.5) * 360 / (sectors * fine)
    # Cells of equal steps in sqrt(theta): finer towards the pole.
    wm = direction(90 * u[:, None] ** 2, phi)
    solid = np.sin(np.pi / 2 * u**2) * np.pi * u / (rings * fine) * 2 * np.pi / (sectors * fine)
    share = np.maximum(wm @ v, 0.0) * distribution.density(wm) * solid[:, None] / area
    share = share.reshape(rings, fine, sectors, fine).sum(axis=(1, 3)).ravel()
    assert share.sum() == pytest.approx(1.0, abs=2e-3)
    tilt, azimuth = angles(found)
    cell = np.minimum((np.sqrt(tilt / 90) * rings).astype(int), rings - 1) * sectors + (azimuth / 360 * sectors).astype(
        int
    )
    expected, got = count * share / share.sum(), np.bincount(cell, minlength=rings * sectors)
    few = expected < 10
    expected, got = (np.append(x[~few], x[few].sum()) for x in (expected, got))
    expected, got = expected[expected > 0], got[expected > 0]
    assert stats.chisquare(got, expected * got.sum() / expected.sum()).pvalue > sidak(25)


# --- Conservation -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("distribution", [*SHAPES, Beckmann(0.02), GGX(3.0), GGX(alpha_x=0.05, alpha_y=5.0)], ids=repr)
@pytest.mark.parametrize("theta_i", [0.0, 60.0, 89.0, 89.999])
def test_a_mirror_returns_everything(distribution, theta_i):
    albedo, error = smith(distribution, walks=20_000).albedo(direction(theta_i, 20.0))
    assert albedo[0, 0] == pytest.approx(1.0, abs=1e-13)
    assert error[0, 0] < 1e-13
    assert albedo[1:].sum() == pytest.approx(1.0, abs=1e-13)


@pytest.mark.parametrize("distribution", SHAPES, ids=repr)
@pytest.mark.parametrize("theta_i", [0.0, 45.0, 80.0])
@pytest.mark.parametrize("material", [Mirror(), Conductor("Au")], ids=repr)
def test_bins_add_up_to_the_albedo(distribution, theta_i, material):
    wi, wavelengths, seeds = direction(theta_i, 20.0), (450.0, 650.0), 16
    found = [smith(distribution, material, 6_400, seed).estimate(wi, COARSE_GRID, wavelengths) for seed in range(seeds)]
    for value, error in found:
        np.testing.assert_allclose(value[0], value[1:].sum(axis=0), rtol=1e-12)
        assert (error[1] == 0).all()
    totals = np.einsum("b,sobw->sow", COARSE_GRID.projected_solid_angles(), [value for value, _ in found])
    mean, scatter = totals.mean(axis=0), totals.std(axis=0, ddof=1) / np.sqrt(seeds)
    albedo, error = smith(distribution, material, seed=seeds).albedo(wi, wavelengths)
    # Order 1 is integrated to 1e-5 of itself.
    assert_equal_within_noise(mean, albedo, np.hypot(scatter, error) + 2e-5 * albedo, seeds - 1, sidak(30))
    assert (albedo[1:] > 0).all()
    assert (albedo[0] <= 1 + 1e-12).all()


@pytest.mark.parametrize("distribution", SHAPES, ids=repr)
@pytest.mark.parametrize("theta_i", [0.0, 40.0, 80.0])
def test_order_1_of_the_walk_is_the_microfacet_model(distribution, theta_i):
    grid, wi = HemisphereGrid(5.0, 15.0), direction(theta_i, 20.0)
    once = Microfacet(distribution=distribution, masking=SmithCorrelated(), material=METAL)
    expected = grid.projected_solid_angles() @ once.average(wi, grid)
    albedo, error = smith(distribution, METAL, walks=400_000).albedo(wi)
    assert_equal_within_noise(albedo[1], expected, np.hypot(error[1], 1e-5), FREEDOM, sidak(15))


# --- Values -----------------------------------------------------------------------------------------------------------


def twice(distribution, material, wi, wo, nodes=200):
    """Order 2 in 1/sr by quadrature over the direction w in between.

    With a, b, c the rates of the way down, between and up: a facet's density of directions is D / (4 sigma), and the
    integral over both depths is a b / ((a + b)(a + c)) if w goes up, a b / ((a + c)(b + c)) if down.
    """
    u, weight = np.polynomial.legendre.leggauss(nodes)
    phi = np.radians(np.arange(2 * nodes) * 180 / nodes)
    total, sky = 0.0, distribution.smith_lambda
    a, c = 1 + sky(wi), sky(wo)
    for low, high in ((-wi[2], 0.0), (0.0, wo[2])):
        z = low + (high - low) * (u + 1) / 2
        sine = np.sqrt(1 - z**2)
        w = np.stack(np.broadcast_arrays(sine[:, None] * np.cos(phi), sine[:, None] * np.sin(phi), z[:, None]), axis=-1)
        first, second = half_vector(wi, w), half_vector(wo, -w)
        facets = distribution.density(first) * distribution.density(second)
        facets *= material.reflectance(np.clip(first @ wi, 0, 1), 550.0)[..., 0]
        facets *= material.reflectance(np.clip(second @ wo, 0, 1), 550.0)[..., 0]
        met = 1 / (a + sky(w)) if high > 0 else 1 / (1 + sky(-w) + c)
        part = facets * met / (16 * np.abs(w[..., 2]) * wi[2] * wo[2] * (a + c))
        total += (part * weight[:, None]).sum() * (high - low) / 2 * np.pi / nodes
    return total


PAIRS = (
    (direction(0.0), direction(30.0, 10.0)),
    (direction(45.0, 20.0), direction(45.0, 200.0)),
    (direction(60.0, 20.0), direction(50.0, 160.0)),
    (direction(80.0, 20.0), direction(70.0, 215.0)),
)


@pytest.mark.parametrize("distribution", SHAPES, ids=repr)
def test_order_2_is_an_integral(distribution):
    source, eye = (np.array(w) for w in zip(*PAIRS, strict=True))
    value, error = smith(distribution, METAL, walks=100_000).eval_with_error(source, eye)
    exact = np.array([twice(distribution, METAL, *pair) for pair in PAIRS])
    coarse = np.array([twice(distribution, METAL, *pair, nodes=150) for pair in PAIRS])
    np.testing.assert_allclose(coarse, exact, rtol=3e-3)
    both = np.hypot(error[2, :, 0], np.abs(coarse - exact))
    assert_equal_within_noise(value[2, :, 0], exact, both, FREEDOM, sidak(5))
    once = Microfacet(distribution=distribution, masking=SmithCorrelated(), material=METAL)
    np.testing.assert_allclose(value[1], once.eval(source, eye), rtol=1e-14)
    np.testing.assert_allclose(value[0], value[1:].sum(axis=0), rtol=1e-12)
    assert (error[1] == 0).all()


@pytest.mark.parametrize("distribution", SHAPES, ids=repr)
def test_reciprocal_at_every_order(distribution):
    rng = np.random.default_rng(5)
    wi, wo = (direction(rng.uniform(0, 85, 12), rng.uniform(0, 360, 12)) for _ in range(2))
    forward, backward = (
        smith(distribution, METAL, 20_000, seed).eval_with_error(*pair) for seed, pair in ((1, (wi, wo)), (2, (wo, wi)))
    )
    error = np.hypot(forward.standard_error, backward.standard_error)
    assert_equal_within_noise(forward.value, backward.value, error, FREEDOM, sidak(5))


@pytest.mark.parametrize("distribution", [Beckmann(0.9), GGX(alpha_x=0.5, alpha_y=1.0, rotation=30.0)], ids=repr)
def test_values_integrate_to_the_albedo(distribution):
    wi, grid, seeds = direction(50.0, 20.0), HemisphereGrid(90 / 8, 360 / 16), 16
    wo, weight = grid.quadrature(wi, 2)
    flux = weight * grid.projected_solid_angles()[:, None]
    sums = [
        np.einsum("obqw,bq->o", smith(distribution, METAL, 320, s).eval_with_error(wi, wo).value, flux)
        for s in range(seeds)
    ]
    albedo, error = smith(distribution, METAL, 400_000, seed=99).albedo(wi)
    mean, scatter = np.mean(sums, axis=0), np.std(sums, axis=0, ddof=1) / np.sqrt(seeds)
    # The rule's own error is below 1e-4 of order 1, which is smooth.
    once = np.einsum(
        "bqw,bq->",
        Microfacet(distribution=distribution, masking=SmithCorrelated(), material=METAL).eval(wi, wo),
        flux,
    )
    assert once == pytest.approx(mean[1], rel=1e-12)
    assert_equal_within_noise(mean, albedo[:, 0], np.hypot(scatter, error[:, 0]) + 1e-4 * albedo[:, 0], seeds - 1)


def test_bins_are_averages_of_values():
    """Any detector: bins of a grid and apertures, some of which overlap."""
    wi, model = direction(50.0, 20.0), smith(Beckmann(alpha_x=0.5, alpha_y=0.8, rotation=30.0), METAL, 400_000)
    apertures = Apertures(directions=((30.0, 170.0), (35.0, 180.0), (0.0, 0.0), (60.0, 300.0)), half_angle=10.0)
    grid = HemisphereGrid(30.0, 60.0)
    for detector, nodes in ((apertures, 3), (grid, 6), (Klems("quarter"), 5)):
        wo, weight = detector.quadrature(wi, nodes)
        values, errors = smith(model.distribution, METAL, 10_000, seed=7).eval_with_error(wi, wo)
        expected = np.einsum("obqw,bq->obw", values, weight)
        # The same walks serve all nodes of a bin: their errors add up.
        its_error = np.einsum("obqw,bq->obw", errors, weight)
        value, error = model.estimate(wi, detector)
        both = np.hypot(error, its_error) + 1e-3 * expected
        assert_equal_within_noise(value, expected, both, FREEDOM, sidak(3))


def test_an_aperture_over_everything_sees_the_albedo():
    everything, wi = Apertures(directions=((0.0, 0.0),), half_angle=90.0), direction(40.0, 20.0)
    value, error = smith(GGX(0.5)).estimate(wi, everything)
    albedo, its_error = smith(GGX(0.5), seed=1).albedo(wi)
    assert_equal_within_noise(value[:, 0] * np.pi, albedo, np.hypot(error[:, 0] * np.pi, its_error), FREEDOM)


def test_a_smooth_surface_is_a_mirror():
    grid, wi = HemisphereGrid(5.0, 15.0), direction(30.0, 20.0)
    model = smith(Beckmann(1e-2), METAL)
    share = model.average(wi, grid)[:, 0] * grid.projected_solid_angles()
    assert share.sum() == pytest.approx(METAL.reflectance(wi[2], 550.0)[0], rel=3e-4)
    assert share[np.ravel_multi_index((6, 12), grid.shape)] > 0.99 * share.sum()
    assert model.albedo(wi).value[2:].sum() < 1e-12


# --- Errors, seeds, doors ---------------------------------------------------------------------------------------------


def test_error_bars_cover():
    """t-scores of many seeds against a run with 100 times as many walks."""
    wi, wo, seeds = direction(50.0, 20.0), direction([10.0, 60.0], [80.0, 200.0]), 150
    grid, shape = HemisphereGrid(30.0, 60.0), GGX(alpha_x=0.4, alpha_y=0.8)

    def scores(ask):
        truth = ask(smith(shape, METAL, 640_000, seed=1_000))
        found = [ask(smith(shape, METAL, 6_400, seed)) for seed in range(seeds)]
        values, errors = (np.array([getattr(x, name)[2:] for x in found]) for name in ("value", "standard_error"))
        # The mean square of the errors is the variance; of a bin's orders only one is counted.
        ratio = (values.var(axis=0, ddof=1) / (errors**2).mean(axis=0))[0]
        assert abs(ratio.mean() - 1) < stats.norm.isf(sidak(3) / 2) * np.sqrt(2 / ((seeds - 1) * ratio.size))
        return (values - truth.value[2:]) / np.hypot(errors, truth.standard_error[2:])

    # Orders 2 and 3+ apart, and one of the bins or pairs each: those of one walk are not independent.
    for ask in (
        lambda model: model.albedo(wi),
        lambda model: model.estimate(wi, grid),
        lambda model: model.eval_with_error(wi, wo),
    ):
        t = scores(ask)
        for order in (0, 1):
            each = t[:, order].reshape(seeds, -1)
            assert_covers(each[:, each.shape[1] // 2], FREEDOM, sidak(6))


def test_the_same_seed_gives_the_same_bits_on_any_number_of_threads(monkeypatch):
    wi, wo = direction(50.0, 20.0), direction([10.0, 60.0], [80.0, 200.0])
    model, other = smith(SHAPES[-1], METAL, 10_000, 2**40), smith(SHAPES[-1], METAL, 10_000, 2**41)

    def everything(model):
        parts = model.albedo(wi), model.estimate(wi, COARSE_GRID), model.eval_with_error(wi, wo)
        return np.concatenate([np.ravel(x) for part in parts for x in part])

    first = everything(model)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    assert (everything(model) == first).all()
    assert (everything(other) != first).any()
    alone = model.eval_with_error(wi, wo[1])
    np.testing.assert_array_equal(alone.value, model.eval_with_error(wi, wo).value[:, 1])


def test_shapes_and_what_is_below_the_horizon():
    model, two = smith(Beckmann(0.5), METAL, 1000), (450.0, 650.0)
    up, down, level = direction(10.0), direction(120.0, 30.0), direction(90.0) * [1, 1, 0]
    for wi, wo in ((up, down), (down, up), (down, down), (up, level), (level, up)):
        assert (model.eval(wi, wo) == 0.0).all()
    assert model.eval(direction([[0.0], [40.0]]), direction([10.0, 50.0, 100.0], 60.0), two).shape == (2, 3, 2)
    np.testing.assert_array_equal(model.eval(up, up, two), model.eval_with_error(up, up, two).value[0])
    assert model.estimate(up, COARSE_GRID, two, orders=5).value.shape == (6, COARSE_GRID.bins, 2)
    np.testing.assert_array_equal(model.average(up, COARSE_GRID, two), model.estimate(up, COARSE_GRID, two).value[0])
    assert model.eval_with_error(up, up, two, orders=1).value.shape == (2, 2)
    for below in (down, level):
        assert (model.average(below, COARSE_GRID) == 0.0).all()
        assert (model.albedo(below).value == 0.0).all()
    one, both = model.albedo(up, orders=1), model.albedo(up, orders=2)
    np.testing.assert_allclose(one.value, both.value[[0, 0]])
    grazing = smith(GGX(0.5), walks=1000).eval_with_error(direction(90 - 1e-9), direction(90 - 1e-10, 180.0))
    assert all(np.isfinite(x).all() for x in grazing)
    for ask in (model.albedo, lambda *a, **b: model.estimate(a[0], COARSE_GRID, **b)):
        with pytest.raises(ValueError, match="orders = 0 must be 1 or more"):
            ask(up, orders=0)


def test_recipes_and_specimens():
    model = smith(SHAPES[-1], Conductor("Au"), 5000, 3)
    adapter = TypeAdapter(SmithMultipleScattering)
    assert adapter.validate_json(adapter.dump_json(model, exclude_none=True)) == model
    found = SmithMultipleScattering.of({"beckmann_alpha": 0.25}, Conductor("Au"))
    assert found == SmithMultipleScattering(distribution=Beckmann(0.25), material=Conductor("Au"))
    with pytest.raises(ValueError, match="mirror facets"):
        SmithMultipleScattering.of({"beckmann_alpha": 0.25}, Lambertian(0.5))
    for wrong in ({"walks": 10}, {"seed": -1}, {"walks": 1e6}):
        with pytest.raises(ValidationError):
            SmithMultipleScattering(**{"distribution": Beckmann(0.5), "material": Mirror(), **wrong})
