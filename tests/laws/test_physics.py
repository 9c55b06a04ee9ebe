"""The laws: what must hold for light on any surface, whatever the code looks like."""

import math

import numpy as np
import pytest
import trimesh
from scipy import stats
from specimens import GLASS, GOLD, GREEN, GRID, RGB, SPECULAR, STEEP
from statistical import assert_equal_within_noise

import microsurfaces as ms
from gonio import optics
from gonio.detectors import Apertures, HemisphereGrid, cone_quadrature
from gonio.goniometer import Goniometer
from gonio.tally import UNIT
from gonio.transport.scene import EmbreeMesh, Scene

pytestmark = pytest.mark.slow

INDICES = [optics.Conductor(eta=1.5, k=0.0), optics.Dielectric(eta=1 / 1.5)]


def shares(measurement, order="all"):
    """Share of the launched light in every bin, (theta_i, phi_i, theta_o, dphi, wavelength)."""
    area = measurement.dataset["projected_solid_angle"].values[..., None]
    return measurement.dataset["brdf"].sel(order=order).values * area


# ---------------------------------------------------------------------------------------------------- flat surfaces


@pytest.mark.parametrize("material", [*SPECULAR, *INDICES], ids=repr)
def test_flat_mirror_sends_fresnel_into_one_bin(material):
    theta_i, phi_i = tuple(range(90)), (0.0, 37.3, 211.0)
    grid = HemisphereGrid(theta_step=5, phi_step=5)
    goniometer = Goniometer(theta_i=theta_i, phi_i=phi_i, paths=4, replicates=2, detector=grid, wavelengths=RGB)
    measurement = goniometer.measure(Scene(ms.Flat().build(0), material), threads=1)
    light = shares(measurement)
    expected = material.reflectance(np.cos(np.radians(theta_i)), np.array(RGB))
    for i, theta in enumerate(theta_i):
        ring = np.searchsorted(grid.theta_edges, theta, side="right") - 1
        sector = 0 if theta == 0 else grid.shape[1] // 2
        np.testing.assert_allclose(light[i, :, ring, sector], np.tile(expected[i], (3, 1)), rtol=2e-5)
        assert (light[i].sum(axis=(1, 2)) == light[i, :, ring, sector]).all(), "light in another bin"


@pytest.mark.parametrize("reflectance", [0.0, 0.05, 0.5, 0.8, 1.0])
def test_flat_lambertian_is_rho_over_pi_everywhere(reflectance):
    goniometer = Goniometer(
        theta_i=(0, 40, 80), paths=1_000_000, detector=HemisphereGrid(theta_step=10, phi_step=30), wavelengths=GREEN
    )
    data = goniometer.measure(Scene(ms.Flat().build(0), optics.Lambertian(reflectance)), seed=1).dataset.sel(
        order="all"
    )
    if reflectance == 0:
        assert (data["brdf"] == 0).all()
        return
    assert_equal_within_noise(
        data["brdf"].values,
        reflectance / math.pi,
        data["brdf_standard_error"].values,
        goniometer.replicates - 1,
        1e-3 / 4,
    )
    np.testing.assert_allclose(data["albedo"].values, reflectance, rtol=1e-9)


# --------------------------------------------------------------------------------------------------- energy


def lumpy_mesh():
    """A plane with a floating ball in every period: an overhang."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.35)
    ball.apply_translation([0.9, 0.2, 0.6])  # pokes out of its own tile
    plane = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    return ms.Mesh.from_trimesh(trimesh.util.concatenate([plane, ball]), (1.0, 1.0))


RELIEFS = {
    "flat": lambda: ms.Flat().build(0),
    "gaussian .3": lambda: ms.Gaussian(alpha=0.3).build(1),
    "gaussian .7": lambda: ms.Gaussian(alpha=0.7).build(2),
    "gaussian anisotropic": lambda: ms.Gaussian(alpha_x=0.1, alpha_y=0.6, rotation=30, samples=301).build(3),
    "ridges": lambda: ms.Cylinders(profile="ridges", radius=1.0, distance=2.0).build(0),
    "ridges apart": lambda: ms.Cylinders(profile="ridges", radius=1.0, distance=3.0, floor_height=0.3).build(0),
    "grooves": lambda: ms.Cylinders(profile="grooves", radius=1.0, distance=2.0).build(0),
    "grooves apart": lambda: ms.Cylinders(profile="grooves", radius=1.0, distance=3.0).build(0),
    "v-grooves": lambda: ms.VGrooves(m=0.5).build(4),
    "v-groove 45": lambda: ms.VGrooves(angle=45).build(0),
    "overhang": lumpy_mesh,
}


@pytest.mark.parametrize("name", RELIEFS)
def test_a_lossless_surface_returns_all_light(name):
    """2 million paths for each of five incidences: nothing but restart offsets may swallow light."""
    goniometer = Goniometer(theta_i=(0, 30, 60, 80, 88), phi_i=(10,), paths=2_000_000, wavelengths=GREEN, detector=GRID)
    measurement = goniometer.measure(Scene(RELIEFS[name](), optics.Mirror()), seed=2)
    budget = measurement.sums["energy_budget"].astype("int64")
    astray = budget.sel(termination="lost") + budget.sel(termination="truncated")
    assert (budget.sel(termination="launched") == 2_000_000 * UNIT).all()
    assert (budget.sel(termination="escaped") + astray == budget.sel(termination="launched")).all()
    assert (budget.sel(termination="absorbed") == 0).all()
    assert (astray / (2_000_000 * UNIT) < (1e-6 if name.startswith("gaussian") else 1e-5)).all()
    weight = measurement.sums["weight"]
    assert (weight.sel(order="all") == weight.drop_sel(order="all").sum("order")).all()
    assert (weight.isel(bin=-1) == weight.isel(bin=slice(-1)).sum("bin")).all()


@pytest.mark.parametrize(
    "material", [optics.Conductor("Cu"), optics.Dielectric("N-BK7"), optics.Lambertian(0.7)], ids=repr
)
def test_the_energy_budget_closes(material):
    scene = Scene(ms.Gaussian(alpha=0.8, samples=256, side=150.0).build(1), material)
    goniometer = Goniometer(theta_i=(0, 70), paths=100_000, detector=Apertures(((20.0, 30.0), (20.0, 32.0)), 4.0))
    budget = goniometer.measure(scene).sums["energy_budget"]
    assert (budget.sel(termination="launched") == budget.drop_sel(termination="launched").sum("termination")).all()
    assert (budget.sel(termination="absorbed") > 0).all()


# ------------------------------------------------------------------------------------------------- closed forms


def test_a_right_angled_groove_returns_light_after_two_hits():
    goniometer = Goniometer(theta_i=(0,), paths=1_000_000, wavelengths=GREEN)
    measurement = goniometer.measure(Scene(ms.VGrooves(angle=45).build(0), optics.Mirror()))
    albedo = measurement.dataset["albedo"].sel(theta_i=0, phi_i=0, wavelength=550)
    assert float(albedo.sel(order="2")) > 1 - 1e-5
    back = measurement.dataset["count"].sel(order="2", theta_i=0, phi_i=0, theta_o=0).values
    assert back.sum() > (1 - 1e-5) * 1_000_000


@pytest.mark.parametrize(("kind", "distance", "expected"), [
    ("ridges", 2.0, (0.64039, 0.69096, 0.96353, 0.98880)),
    ("grooves", 2.0, (0.5, 0.56858, 0.67365, 0.66742)),
    ("grooves", 1.0, (1.0, 1.0, 0.87939, 1.0)),
    ("ridges", 1.0, (1.0, 0.94244, 0.92129, 0.97708)),
])  # fmt: skip
def test_single_reflections_of_mirror_cylinders(kind, distance, expected):
    """The escape fractions of reference A.6, at four projected angles."""
    relief = ms.Cylinders(profile=kind, radius=1.0, distance=distance, chords=1000).build(0)
    goniometer = Goniometer(theta_i=(0, 30, 60, 80), paths=1_000_000, wavelengths=GREEN, detector=GRID)
    data = goniometer.measure(Scene(relief, optics.Mirror()), seed=3).dataset.sel(order="1")
    # Chords of 1000 per half turn move the terminator by up to a chord: 1e-4 of the light.
    np.testing.assert_allclose(data["albedo"].values.ravel(), expected, atol=2e-4)


def test_reflections_inside_half_pipes():
    """Shares of one, two, three and more hits in touching half cylinders lit from above (reference A.6)."""
    relief = ms.Cylinders(profile="grooves", radius=1.0, distance=2.0, chords=1000).build(0)
    measurement = Goniometer(paths=4_000_000, wavelengths=GREEN).measure(Scene(relief, optics.Mirror()), seed=4)
    albedo = measurement.dataset["albedo"].values[:, 0, 0, 0]
    np.testing.assert_allclose(albedo[1:3], (0.5, 0.30902), atol=2e-4)


# --------------------------------------------------------------------------------------------------- symmetries


@pytest.mark.parametrize(("relief", "material"), [
    (lambda: ms.Gaussian(alpha_x=0.2, alpha_y=0.5, rotation=20, samples=512, side=300.0).build(5), GOLD),
    (lambda: ms.Gaussian(alpha=1.0, samples=512, side=300.0).build(6), optics.Mirror()),
    (lambda: ms.Cylinders(profile="grooves", radius=1.0, distance=2.2).build(0), optics.Lambertian(0.9)),
], ids=("anisotropic", "multiple scattering", "interreflection"))  # fmt: skip
def test_cone_to_cone_reciprocity(relief, material):
    """Cone A lit and cone B seen is cone B lit and cone A seen."""
    a, b, half_angle = (25.0, 10.0), (50.0, 170.0), 6.0
    scene = Scene(relief(), material)
    seen = []
    for lit, watched in ((a, b), (b, a)):
        goniometer = Goniometer(
            theta_i=(lit[0],), phi_i=(lit[1],), beam_half_angle=half_angle, paths=4_000_000, wavelengths=RGB,
            detector=Apertures((watched,), half_angle),
        )  # fmt: skip
        data = goniometer.measure(scene, seed=8).dataset.sel(order="all")
        seen.append((data["brdf"].values.ravel(), data["brdf_standard_error_mc"].values.ravel()))
    (there, error_there), (back, error_back) = seen
    assert (there > 100 * error_there).all()
    assert_equal_within_noise(there, back, np.hypot(error_there, error_back), 15)


def noise_free_difference(one, other):
    """t-scores of all well filled bins of two measurements, pooled over wavelengths."""
    a, b = (m.dataset.sel(order="all").isel(wavelength=0) for m in (one, other))
    full = (a["count"] > 400) & (b["count"] > 400)
    error = np.hypot(a["brdf_standard_error_mc"], b["brdf_standard_error_mc"]).values[full]
    return a["brdf"].values[full], b["brdf"].values[full], error


def test_where_the_tile_is_cut_changes_nothing_but_noise():
    relief = STEEP.build(7)
    moved = ms.HeightField(np.roll(relief.heights, (34, 58), axis=(0, 1)), relief.spacing)
    mesh = relief.mesh()
    # Every face one or more periods away from its neighbours: the same periodic surface, cut into crumbs.
    shift = np.random.default_rng(0).integers(-1, 2, (len(mesh.faces), 2)) * mesh.period
    corners = mesh.vertices[mesh.faces] + np.pad(shift, ((0, 0), (0, 1)))[:, None, :]
    crumbs = ms.Mesh(corners.reshape(-1, 3), np.arange(corners.shape[0] * 3).reshape(-1, 3), mesh.period)
    goniometer = Goniometer(theta_i=(20, 85), phi_i=(33,), paths=1_000_000, detector=GRID, wavelengths=GREEN)
    first, *others = (
        goniometer.measure(Scene(r, optics.Mirror()), seed=s) for s, r in enumerate((relief, moved, crumbs))
    )
    for other in others:
        measured, expected, error = noise_free_difference(first, other)
        assert measured.size > 200
        assert_equal_within_noise(measured, expected, error, 15)


def test_the_average_over_azimuths_is_isotropic():
    relief = ms.VGrooves(m=0.4).build(9)
    goniometer = Goniometer(
        theta_i=(35,),
        phi_i=(0, 77),
        azimuth="average",
        paths=1_000_000,
        detector=GRID,
        wavelengths=GREEN,
    )
    measurement = goniometer.measure(Scene(relief, optics.Mirror()), seed=10)
    data = measurement.dataset.sel(order="all").isel(wavelength=0, theta_i=0)
    full = (data["count"] > 400).all("phi_i").values
    error = data["brdf_standard_error_mc"].values[:, full]
    assert_equal_within_noise(*data["brdf"].values[:, full], np.hypot(*error), 15)
    assert measurement.isotropic


def test_a_source_cone_averages_fresnel_over_its_directions():
    theta, half_angle = 70.0, 15.0
    wo, weight = cone_quadrature(np.array([theta]), np.array([0.0]), half_angle, 32)
    expected = (weight[..., None] * GLASS.reflectance(wo[..., 2], GREEN)).sum()
    goniometer = Goniometer(theta_i=(theta,), beam_half_angle=half_angle, paths=1_000_000, wavelengths=GREEN)
    albedo = goniometer.measure(Scene(ms.Flat().build(0), GLASS), seed=11).albedo()
    assert_equal_within_noise(
        float(albedo["albedo"].squeeze()), expected, float(albedo["albedo_standard_error"].squeeze()), 15
    )


# ------------------------------------------------------------------------------------------ what the field expects

# Measured against Smith's height-correlated model with a tracer of its own: reference B.8 (mean, rms) of the ratio
# minus one, in per cent, over bins of 5 x 15 degrees with more than 10,000 counts and theta_o < 60. Six patches leave
# noise of their own: from one set of six to the next the mean moves by 0.3 % and the rms at m = 0.2, 60 degrees lies
# between 1.6 and 2.6 %, so the law is stated for these sets.
BAND = 1.3
"""Three standard errors of the difference between their six patches' mean and ours, 3 x sqrt(2) x 0.3, per cent."""

PATCHES = {0.2: range(1012, 1018), 0.5: range(100, 106), 0.8: range(100, 106)}
SMITH = {
    0.2: {0: (-0.1, 1.7), 30: (0.0, 1.8), 60: (0.1, 1.7)},
    0.5: {0: (0.2, 1.5), 30: (0.2, 1.4), 60: (1.1, 1.9)},
    0.8: {0: (1.1, 1.7), 30: (1.9, 2.4), 60: (3.3, 3.0)},
}


@pytest.mark.parametrize("m", SMITH)
def test_gaussian_surfaces_against_smith(m):
    from gonio.models import Beckmann, Microfacet, SmithCorrelated
    from gonio.sphere import direction

    surface = ms.Gaussian(alpha=m, correlation_length=12.0, side=1024.0, samples=1024)
    goniometer = Goniometer(theta_i=(0, 30, 60), paths=800_000, wavelengths=GREEN, detector=GRID)
    total, alphas = None, []
    for patch in PATCHES[m]:
        relief = surface.build(patch)
        alphas.append(relief.statistics().beckmann_alpha)
        measurement = goniometer.measure(Scene(relief, optics.Mirror()), seed=patch)
        total = measurement if total is None else total.merge(measurement)
    alpha = math.sqrt(np.mean(np.square(alphas)))
    model = Microfacet(distribution=Beckmann(alpha=alpha), masking=SmithCorrelated(), material=optics.Mirror())
    data = total.dataset.sel(order="1").isel(phi_i=0, wavelength=0)
    for theta, (mean, rms) in SMITH[m].items():
        expected = model.average(direction(theta, 0), goniometer.detector)[:, 0].reshape(goniometer.detector.shape)
        row = data.sel(theta_i=theta)
        chosen = (row["count"].values > 10_000) & (goniometer.detector.theta[:, None] < 60)
        ratio = 100 * (row["brdf"].values[chosen] / expected[chosen] - 1)
        assert chosen.sum() > 20
        assert abs(ratio.mean() - mean) <= BAND, f"m {m} theta {theta}: mean {ratio.mean():.2f} %, expected {mean}"
        assert ratio.std() <= 1.3 * rms, f"m {m} theta {theta}: rms {ratio.std():.2f} %, expected {rms}"


# ------------------------------------------------------------------------------------------------ reproducibility


@pytest.mark.parametrize("by", ["grid", "Embree"])
def test_the_same_bytes_for_any_threads_and_waves(by, monkeypatch):
    from gonio import transport
    from gonio.transport.accelerator import Accelerator

    relief = ms.Gaussian(alpha=0.9, samples=200, side=120.0).build(1)
    scene = Scene(relief if by == "grid" else relief.mesh(), optics.Lambertian(0.9))
    assert isinstance(scene.geometry.traced, Accelerator) == (by == "grid")
    goniometer = Goniometer(theta_i=(10, 70), paths=40_000, azimuth="average", beam_half_angle=2, detector=GRID)
    first = goniometer.measure(scene, seed=2**40, threads=1)
    assert first.sums.identical(goniometer.measure(scene, seed=2**40, threads=2).sums)
    assert not first.sums.identical(goniometer.measure(scene, seed=2**40 + 1, threads=2).sums)
    # Fewer lanes than a group has replicates, and a number that no group divides.
    for wave in (2, 97):
        monkeypatch.setattr(transport.trace, "__defaults__", (wave,))
        assert first.sums.identical(goniometer.measure(scene, seed=2**40, threads=3).sums)


def test_random_numbers_are_philox():
    """Known answers of the Random123 distribution for Philox4x32-10."""
    from gonio.randomness import philox

    pi = (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344, 0xA4093822, 0x299F31D0)
    assert philox(*(0,) * 6) == (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)
    assert philox(*(0xFFFFFFFF,) * 6) == (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)
    assert philox(*pi) == (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1)


def test_paths_start_uniformly_and_one_in_every_cell():
    from gonio.randomness import philox
    from gonio.transport.source import start

    paths = 4**6
    x, y = np.array([start(path, paths, philox(path, 0, 0, 0, 1, 2)[0]) for path in range(paths)]).T
    cells = np.floor(x * 64).astype(int) * 64 + np.floor(y * 64).astype(int)
    assert (np.bincount(cells, minlength=paths) == 1).all()
    for inside in (x * 64 % 1, y * 64 % 1):
        assert stats.kstest(inside, "uniform").pvalue > 1e-3


def test_height_fields_and_meshes_are_lit_at_the_same_places():
    from gonio.transport import embree, height_field
    from gonio.transport.accelerator import Accelerator
    from gonio.transport.source import Replicates, Source

    paths, replicates, none = 4**4, 3, (0.0, 0.0, 0.0)
    group = Replicates(4, np.array([0.1, 0.5, 0.9]), paths)
    relief = ms.HeightField(np.random.default_rng(1).normal(size=(6, 8)), (0.25, 0.5))
    accelerator, tile = Accelerator.of(relief), EmbreeMesh(relief.mesh()).tile
    sources = (
        Source(0.3, 1.0, 0.0, none, False, (1, 2)),
        Source(0.3, 1.0, 0.01, none, True, (1, 2)),
        Source(0.3, 1.0, 0.0, (0.1, 0.2, 0.3), False, (1, 2)),
    )
    for source in sources:
        wave, flight = embree._empty_wave(paths * replicates, 1), height_field.PathState.of(paths * replicates, 1)
        beam = height_field.illumination_of(source, accelerator, paths * replicates)
        embree._launch(wave, 0, 0, paths * replicates, group, source, tile)
        height_field._launch(flight, 0, paths, group, source, beam, accelerator)
        places = np.stack([flight.x * 0.25 - 1, flight.y * 0.5 - 1.5], axis=-1)
        np.testing.assert_allclose(wave.origins[:, :2], places, atol=1e-6)
        directions = np.stack([flight.dx, flight.dy, flight.dz], axis=-1)
        np.testing.assert_allclose(wave.directions, directions, atol=1e-6)
        np.testing.assert_array_equal(wave.slots, flight.slots)
        np.testing.assert_array_equal(wave.paths, flight.paths[: paths * replicates])
        assert (flight.z == accelerator.top).all()
        assert len(np.unique(flight.x)) > 0.9 * paths * replicates
