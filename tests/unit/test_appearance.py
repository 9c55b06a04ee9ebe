"""Appearance: shading obeys the law of the cosine, energy, and where things are."""

import numpy as np
import pytest

from gonio import appearance
from gonio.brdf import BRDF
from gonio.detectors import HemisphereGrid
from gonio.measurement import tabulated
from gonio.models import AshikhminShirley, Beckmann, Lambert, Microfacet, SmithCorrelated, SmithMultipleScattering
from gonio.optics import Conductor, Mirror
from gonio.sphere import angles, direction, reflect

SIZE = 65
CENTRES = (np.arange(SIZE) + 0.5) * (2 / SIZE) - 1
X, Z = np.meshgrid(CENTRES, -CENTRES)
INSIDE = X**2 + Z**2 < 1
NORMALS = np.stack([X, -np.sqrt(np.clip(1 - X**2 - Z**2, 0, None)), Z], axis=-1)
GOLD = Microfacet(distribution=Beckmann(0.3), masking=SmithCorrelated(), material=Conductor("Au"))


def test_a_diffuse_ball_shows_the_cosine():
    image = appearance.sphere(Lambert(reflectance=0.6), SIZE, irradiance=np.pi, sky=None)
    light = np.array(appearance.LIGHT) / np.linalg.norm(appearance.LIGHT)
    expected = 0.6 * np.clip(NORMALS @ light, 0, None)
    well_inside = X**2 + Z**2 < 0.99
    np.testing.assert_allclose(image[well_inside], np.repeat(expected[well_inside][:, None], 3, axis=1), atol=1e-9)
    covered = appearance.silhouette(SIZE) > 0
    assert np.isnan(image[~covered]).all()
    assert np.isfinite(image[covered]).all()


@pytest.mark.parametrize("model", [Lambert(reflectance=0.5), GOLD], ids=("diffuse", "gold"))
def test_in_a_white_furnace_a_ball_shows_its_albedo(model):
    """Radiance 1 from everywhere: towards the eye goes the albedo of light from the eye's place."""
    image = appearance.sphere(model, SIZE, irradiance=0.0, sky=np.ones_like)
    theta = np.degrees(np.arccos(-NORMALS[INSIDE][:, 1]))
    grid = HemisphereGrid(2.0, 3.0)
    nodes = np.arange(0.0, 90.0, 5.0)
    lobes = appearance.coloured(model)
    albedo = [grid.projected_solid_angles() @ lobes.average(direction(t, 0), grid) for t in nodes]
    chosen = theta < 80
    for channel in range(3):
        expected = np.interp(theta[chosen], nodes, np.array(albedo)[:, channel])
        np.testing.assert_allclose(image[INSIDE][chosen, channel], expected, rtol=0.02)


def test_the_highlight_is_where_a_smooth_ball_would_show_the_source():
    image = appearance.sphere(GOLD, SIZE, sky=None)
    row, column = np.unravel_index(np.nan_to_num(image[..., 0]).argmax(), (SIZE, SIZE))
    light = np.array(appearance.LIGHT) / np.linalg.norm(appearance.LIGHT)
    half = light - np.array([0.0, 1.0, 0.0])
    half /= np.linalg.norm(half)
    assert (X[row, column], Z[row, column]) == pytest.approx((half[0], half[2]), abs=0.08)
    # Gold is gold.
    red, green, blue = image[row, column]
    assert red > green > 1.3 * blue


def test_the_sky_is_up():
    image = appearance.sphere(GOLD, SIZE, irradiance=0.0)
    top, bottom = image[8, SIZE // 2], image[-9, SIZE // 2]
    assert top[2] > 1.5 * bottom[2]


@pytest.fixture(scope="module")
def known():
    """Gold as another program would have measured it."""
    grid = HemisphereGrid(2.0, 3.0)
    return appearance.coloured(GOLD).sampled(np.arange(0.0, 86.0, 5.0), 0.0, grid)


def test_a_measurement_looks_like_the_model_it_samples(known):
    ours, theirs = appearance.sphere(known, SIZE), appearance.sphere(GOLD, SIZE)
    inner = X**2 + Z**2 < 0.95
    np.testing.assert_allclose(ours[inner], theirs[inner], rtol=0.05, atol=0.01)


def test_a_measured_ball_keeps_its_energy_to_the_rim(known):
    """In the furnace a measured surface shows the measured albedo, that of the last incidence beyond it."""
    image = appearance.sphere(known, SIZE, irradiance=0.0, sky=np.ones_like)
    theta = np.degrees(np.arccos(-NORMALS[INSIDE][:, 1]))
    albedo = known.dataset["albedo"].values[0, :, 0]
    for channel in range(3):
        expected = np.interp(theta, known.dataset["theta_i"], albedo[:, channel])
        np.testing.assert_allclose(image[INSIDE][:, channel], expected, rtol=0.01)


def test_narrow_lobes_keep_their_energy_at_grazing_angles():
    narrow = Microfacet(distribution=Beckmann(0.1), masking=SmithCorrelated(), material=Mirror())
    fine = HemisphereGrid(0.5, 1.0)
    for theta in (75.0, 84.0):
        shares = appearance._shares(appearance.coloured(narrow), theta, 0.0, appearance._Bins.around_specular(), 2)
        wi = direction(theta, 0.0)
        expected = fine.projected_solid_angles() @ appearance.coloured(narrow).average(wi, fine)[:, 0]
        assert shares.sum(axis=0) == pytest.approx([expected] * 3, rel=0.03)


def test_bins_of_the_sky_fill_the_hemisphere():
    for bins in (appearance._Bins.even(), appearance._Bins.around_specular()):
        assert bins.area.sum() == pytest.approx(np.pi, rel=1e-12)


def test_models_with_a_grain_are_known_by_it():
    assert appearance.coloured(GOLD).isotropic
    assert not appearance.coloured(AshikhminShirley(n_u=10, n_v=400)).isotropic


def test_a_model_of_random_walks_is_walked_once_for_all_texels():
    model = SmithMultipleScattering(distribution=Beckmann(0.3), material=Mirror(), walks=20_000)
    image = appearance.sphere(model, 33, irradiance=0.0, sky=np.ones_like)
    # Lossless facets send all light back, after one reflection or more.
    inside = appearance.silhouette(33) == 1
    np.testing.assert_allclose(image[inside], 1.0, atol=0.01)


def test_the_silhouette_is_a_disc():
    share = appearance.silhouette(SIZE)
    assert share.sum() == pytest.approx(np.pi / 4 * SIZE**2, rel=1e-3)
    between = (share > 0) & (share < 1)
    assert np.abs(np.hypot(X, Z)[between] - 1).max() < 1.5 / SIZE
    assert between.sum() > 2 * SIZE


def with_noise(known, relative):
    """`known` with Gaussian noise of this relative size in every bin, and errors that tell it."""
    rng = np.random.default_rng(1)
    values = known.dataset["brdf"].sel(order="all").values
    noisy = values * (1 + relative * rng.standard_normal(values.shape))
    nodes = (known.dataset[name].values for name in ("theta_i", "phi_i", "wavelength"))
    return tabulated(noisy, known.detector, *nodes, relative * values, attributes=known.attributes)


def test_noise_is_averaged_over_patches_that_are_told(known):
    noisy = with_noise(known, 0.3)
    smooth, radius = appearance.softened(noisy)
    assert 3 <= radius <= 10
    clean, rough, soft = (appearance.sphere(m, SIZE, sky=None) for m in (known, noisy, smooth))
    lit = np.nan_to_num(clean[..., 0]) > 0.2 * np.nanmax(clean[..., 0])
    sparkle, left = (np.std(image[lit] / clean[lit] - 1) for image in (rough, soft))
    assert sparkle > 0.1
    assert left < 0.04
    # More noise asks for larger patches.
    assert appearance.softened(with_noise(known, 0.15))[1] < radius


def test_light_is_kept_where_noise_is_averaged(known):
    noisy = with_noise(known, 0.3)
    smooth, _ = appearance.softened(noisy)
    for name in ("isotropic", "basis"):
        assert smooth.attributes[name] == known.attributes[name]
    np.testing.assert_allclose(smooth.dataset["albedo"], noisy.dataset["albedo"], rtol=1e-9)


def test_what_has_no_noise_stays_as_it_is(known):
    assert appearance.softened(known) == (known, 0.0)
    quiet = with_noise(known, 0.01)
    assert appearance.softened(quiet) == (quiet, 0.0)


def brushed(wi, wo):
    """Light that is smeared across the grain: normals leave x alone more than y."""
    half = wi + wo
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    return np.exp(-60 * half[:, 0] ** 2 - 3 * half[:, 1] ** 2)[:, None]


def test_brushed_balls_have_streaks_across_their_grain():
    lobes = BRDF(brushed, np.array([550.0]), np.array([0.0]), np.arange(0.0, 360.0, 30.0), isotropic=False)
    image = appearance.sphere(lobes, SIZE, light_direction=(0.0, -1.0, 0.0), sky=None)[..., 1]
    bright = np.nan_to_num(image) > 0.5 * np.nanmax(image)
    rows, columns = np.nonzero(bright)
    # x runs along circles of latitude: facets tilt along meridians, and the streak is upright.
    assert rows.std() > 2 * columns.std()


def test_a_plate_glows_where_its_mirror_would():
    image = appearance.plate(GOLD, size=(61, 71), light_theta=60.0)
    row, column = np.unravel_index(image[..., 0].argmax(), image.shape[:2])
    assert column == 35
    theta = np.linspace(80.0, 20.0, 61)[row]
    # Rough lobes peak beyond the specular direction.
    assert theta >= 60
    assert angles(reflect(direction(60, 90), [0, 0, 1.0]))[1] == pytest.approx(270)


def test_exposure_is_shared_and_white_is_white():
    dim, bright = np.full((4, 4, 3), 0.25), np.full((4, 4, 3), 1.0)
    bright[0, 0] = np.nan
    a, b = appearance.exposed(dim, bright)
    assert b[1, 1].tolist() == [255] * 4
    assert b[0, 0].tolist() == [0] * 4
    assert a[0, 0, 0] == pytest.approx(255 * (1.055 * 0.25 ** (1 / 2.4) - 0.055), abs=1)
    assert appearance.exposed(dim, white=0.25)[0][0, 0, 0] == 255


def test_a_small_highlight_does_not_leave_the_rest_in_the_dark():
    image = np.full((20, 20, 3), 0.1)
    image[:4, :4] = 50.0
    assert appearance.exposure(image) == pytest.approx(appearance.STOPS * 0.1)
    assert appearance.exposure(np.zeros((3, 3, 3))) == 1.0


def test_a_lossless_mirror_of_facets_loses_little():
    """Single scattering of a smooth lossless metal: nearly the whole furnace comes back."""
    model = Microfacet(distribution=Beckmann(0.2), masking=SmithCorrelated(), material=Mirror())
    image = appearance.sphere(model, 33, irradiance=0.0, sky=np.ones_like)
    assert image[16, 16].tolist() == pytest.approx([1.0] * 3, rel=0.02)
