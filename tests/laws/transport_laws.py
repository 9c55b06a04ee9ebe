"""What light must obey on any surface, whoever traces it: functions that raise where it does not."""

import functools
import math

import height_field_laws
import numpy as np
from reliefs import RELIEFS
from specimens import COARSE_GRID, GLASS, GREEN, GRID, STEEP
from statistical import assert_covers, assert_equal_within_noise

import microsurfaces as ms
from gonio import optics
from gonio.detectors import Apertures, HemisphereGrid, cone_quadrature
from gonio.goniometer import Goniometer
from gonio.models import CookTorrance
from gonio.sphere import direction
from gonio.transport.scene import Scene


def measure(relief, material, seed=1, **instrument):
    """A measurement at one wavelength, on one thread."""
    goniometer = Goniometer(wavelengths=GREEN, **instrument)
    return goniometer.measure(Scene(relief, material), seed=seed, threads=1)


def one_bin(measurement, theta_o, dphi, order="all"):
    """Share of the launched light in the bin about (theta_o, dphi), for every incidence; bins in steps of 1, 2, 5..."""
    data = measurement.dataset.sel(order=order, theta_o=theta_o, dphi=dphi).squeeze("wavelength")
    return (data["brdf"] * data["projected_solid_angle"]).values


def glass(cosine):
    return GLASS.reflectance(np.array([cosine]), GREEN).item()


def traced_both_ways(law):
    """The law for a height field, which is traced by its grid, and for its mesh, which is traced by Embree."""

    @functools.wraps(law)
    def both():
        for way in (lambda relief: relief, lambda relief: relief.mesh()):
            law(way)

    return both


@functools.cache
def rough():
    return STEEP.build(7)


@functools.cache
def flat():
    return ms.Flat().build(0)


def grooves(seed=0, **recipe):
    """V-grooves as a height field; their lines lie at equal distances."""
    mesh = ms.VGrooves(**recipe).build(seed)
    x, first = np.unique(mesh.vertices[:, 0], return_index=True)
    return ms.HeightField(np.tile(mesh.vertices[first[:-1], 2], (2, 1)), (x[1] - x[0], mesh.period[1] / 2))


@functools.cache
def cylinders(profile, distance):
    """A mesh with exact normals, and walls where the distance is 2."""
    return ms.Cylinders(profile=profile, radius=1.0, distance=distance, chords=1000).build(0)


@traced_both_ways
def a_lossless_surface_returns_all_light(way):
    budget = measure(way(rough()), optics.Mirror(), theta_i=(0, 60, 85), paths=300_000, detector=GRID).energy_budget()
    lost, absorbed = float(budget["lost"].max() + budget["truncated"].max()), float(budget["absorbed"].max())
    assert absorbed == 0, f"{absorbed:.2g} of the light is absorbed"
    assert lost < 1e-5, f"{lost:.2g} of the light is lost"


@traced_both_ways
def steep_grooves_lose_no_light(way):
    """Up to five hits near the bottom, a concave edge."""
    measurement = measure(way(grooves(angle=70)), optics.Mirror(), theta_i=(0, 60), paths=300_000)
    budget = measurement.energy_budget()
    lost = float((budget["lost"] + budget["truncated"]).max())
    assert lost < 2e-5, f"{lost:.2g} of the light is lost"


def light_of_one_bin(relief, azimuth):
    theta_i = (0, 35, 70)
    measurement = measure(relief, GLASS, theta_i=theta_i, phi_i=(0, 37, 211), paths=64, detector=GRID, azimuth=azimuth)
    for theta in theta_i:
        expected = glass(math.cos(math.radians(theta)))
        share = one_bin(measurement, theta, 180 if theta else 0)[theta_i.index(theta)]
        np.testing.assert_allclose(share, expected, rtol=2e-5, err_msg=f"theta_i = {theta}")


@traced_both_ways
def a_flat_mirror_sends_fresnel_into_one_bin(way):
    light_of_one_bin(way(flat()), "fixed")


@traced_both_ways
def turning_a_flat_mirror_changes_nothing(way):
    light_of_one_bin(way(flat()), "average")


@traced_both_ways
def a_flat_diffuser_is_rho_over_pi_everywhere(way):
    """In bins so wide that the cosine of their centre is 3 % off."""
    grid = HemisphereGrid(theta_step=30, phi_step=90)
    data = measure(way(flat()), optics.Lambertian(0.8), theta_i=(0, 60), paths=1_000_000, detector=grid).dataset
    bins = data.sel(order="all")
    assert_equal_within_noise(bins["brdf"].values, 0.8 / math.pi, bins["brdf_standard_error"].values, 15)


@traced_both_ways
def error_bars_cover_the_truth(way):
    """Scores of the bins of a flat diffuser."""
    grid = HemisphereGrid(theta_step=6, phi_step=12)
    data = measure(way(flat()), optics.Lambertian(1.0), theta_i=(0, 30, 60), paths=500_000, detector=grid).dataset
    bins = data.sel(order="all")
    scores = ((bins["brdf"] - 1 / math.pi) / bins["brdf_standard_error"]).values
    assert_covers(scores[..., 1:, :, :].ravel(), 15)  # bins of the cap are the same few paths turned about


@traced_both_ways
def error_bars_of_mirrors_cover_the_truth(way):
    """Light from above leaves grooves of 38 degrees after one hit if it came in high enough; that is all the chance."""
    relief, expected = way(grooves(angle=38)), 2 * math.cos(math.radians(76))
    scores = []
    for seed in range(100):
        data = measure(relief, optics.Mirror(), seed, paths=1600, detector=GRID).dataset.sel(order="1")
        scores.append(((data["albedo"] - expected) / data["albedo_standard_error"]).item())
    assert np.isfinite(scores).all()
    assert_covers(np.array(scores), 15)


@traced_both_ways
def a_source_cone_averages_fresnel_over_its_directions(way):
    theta, half_angle = 60.0, 29.0
    wo, weight = cone_quadrature(np.array([theta]), np.array([0.0]), half_angle, 32)
    expected = (weight[..., None] * GLASS.reflectance(wo[..., 2], GREEN)).sum()
    albedo = measure(
        way(flat()), GLASS, theta_i=(theta,), beam_half_angle=half_angle, paths=200_000, detector=GRID
    ).albedo()
    assert_equal_within_noise(albedo["albedo"].values, expected, albedo["albedo_standard_error"].values, 15)


@traced_both_ways
def cones_are_reciprocal(way):
    """Cone A lit and cone B seen is cone B lit and cone A seen."""
    relief = way(
        ms.Gaussian(alpha_x=0.3, alpha_y=0.6, rotation=20, samples=128, side=80.0, correlation_length=8.0).build(5)
    )
    a, b, half_angle = (20.0, 10.0), (60.0, 160.0), 15.0
    (there, there_error), (back, back_error) = (
        (data["brdf"].item(), data["brdf_standard_error_mc"].item())
        for data in (
            measure(
                relief, GLASS, theta_i=lit[:1], phi_i=lit[1:], beam_half_angle=half_angle, paths=1_000_000,
                detector=Apertures((watched,), half_angle),
            ).dataset.sel(order="all")
            for lit, watched in ((a, b), (b, a))
        )
    )  # fmt: skip
    assert there > 50 * there_error
    assert_equal_within_noise(there, back, math.hypot(there_error, back_error), 15)


@traced_both_ways
def a_right_angled_groove_returns_light_after_two_hits(way):
    measurement = measure(way(grooves(angle=45)), optics.Mirror(), paths=200_000, detector=GRID)
    assert one_bin(measurement, 0, measurement.dataset["dphi"], order="2").sum() > 1 - 2e-5


def half_pipes_share_light_between_one_two_and_three_hits():
    """Reference A.6: touching half cylinders, lit from above."""
    measurement = measure(cylinders("grooves", 2.0), optics.Mirror(), paths=400_000, orders=5, detector=GRID)
    albedo = measurement.dataset["albedo"].values.ravel()[1:5]
    np.testing.assert_allclose(albedo, (0.5, 0.30902, 0.09195, 0.03872), atol=5e-4)


def cylinders_hide_what_the_closed_form_hides():
    """Reference A.6: light that escapes after a single hit, at four projected angles."""
    for profile, distance, expected in (
        ("ridges", 2.0, (0.64039, 0.69096, 0.96353, 0.98880)),
        ("grooves", 2.0, (0.5, 0.56858, 0.67365, 0.66742)),
        ("grooves", 1.0, (1.0, 1.0, 0.87939, 1.0)),
    ):
        relief = cylinders(profile, distance)
        data = measure(relief, optics.Mirror(), theta_i=(0, 30, 60, 80), paths=200_000, detector=GRID).dataset
        np.testing.assert_allclose(data["albedo"].sel(order="1").values.ravel(), expected, atol=5e-4)


@traced_both_ways
def facets_reflect_with_fresnel_at_their_own_angle(way):
    """Grooves of 10 degrees, lit at 44 across: facets at 34 degrees send their part to 24, those at 54 to 64."""
    slope, theta = math.radians(10), math.radians(44)
    measurement = measure(way(grooves(angle=10)), GLASS, theta_i=(44,), paths=100_000, detector=HemisphereGrid(2, 15))
    for theta_o, tilt in ((24, slope), (64, -slope)):
        local = math.cos(theta - tilt)
        expected = local / (2 * math.cos(slope) * math.cos(theta)) * glass(local)
        np.testing.assert_allclose(one_bin(measurement, theta_o, 180, order="1"), expected, rtol=1e-3)


def orders_add_up_to_the_total():
    sums = measure(cylinders("grooves", 2.0), GLASS, theta_i=(0, 60), paths=100_000, detector=GRID).sums
    for name in ("weight", "count"):
        assert (sums[name].sel(order="all") == sums[name].drop_sel(order="all").sum("order")).all(), name
        assert (sums[name].isel(bin=-1) == sums[name].isel(bin=slice(-1)).sum("bin")).all(), name
    budget = sums["energy_budget"]
    assert (budget.sel(termination="launched") == budget.drop_sel(termination="launched").sum("termination")).all(), (
        "energy budget"
    )


@traced_both_ways
def where_the_tile_is_cut_changes_nothing(way):
    relief = rough()
    moved = ms.HeightField(np.roll(relief.heights, (34, 58), axis=(0, 1)), relief.spacing)
    data = [
        measure(way(r), optics.Mirror(), seed, theta_i=(20, 80), phi_i=(33,), paths=500_000, detector=GRID).dataset
        for seed, r in enumerate((relief, moved))
    ]
    one, other = (d.sel(order="all").squeeze() for d in data)
    full = ((one["count"] > 400) & (other["count"] > 400)).values
    error = np.hypot(one["brdf_standard_error_mc"], other["brdf_standard_error_mc"]).values
    assert full.sum() > 200
    assert_equal_within_noise(one["brdf"].values[full], other["brdf"].values[full], error[full], 15)


@traced_both_ways
def grooves_of_all_slopes_and_azimuths_are_cook_and_torrance(way):
    m, theta, grid = 0.5, 50.0, COARSE_GRID
    realisations = 32
    total = functools.reduce(
        lambda one, other: one.merge(other),
        (
            measure(
                way(grooves(seed, m=m)), GLASS, seed, theta_i=(theta,), azimuth="average", paths=50_000, detector=grid
            )
            for seed in range(realisations)
        ),
    )
    data = total.dataset.sel(order="1").squeeze()
    expected = CookTorrance(m=m, material=GLASS).average(direction(theta, 0), grid, GREEN).reshape(grid.shape)
    full = data["count"].values > 2000
    assert full.sum() > 20
    assert_equal_within_noise(
        data["brdf"].values[full], expected[full], data["brdf_standard_error"].values[full], realisations - 1
    )


def no_node_is_lower_than_what_it_stands_for():
    for name in ("33 x 33", "5 x 7", "towers"):
        height_field_laws.no_node_is_lower_than_what_it_stands_for(RELIEFS[name]())


def what_is_certain_to_escape_hits_nothing():
    for name in ("5 x 7", "gaussian .3", "cliffs", "needles", "walls", "towers", "ramps", "pyramid"):
        height_field_laws.what_is_certain_to_escape_hits_nothing(RELIEFS[name]())


def every_shortcut_is_a_proof():
    for name in ("gaussian .5", "needles on the seam", "33 x 33", "towers"):
        for material, setting in height_field_laws.INSTRUMENTS[1:3]:
            height_field_laws.every_shortcut_is_a_proof(RELIEFS[name](), material, setting)


def first_hits_are_those_of_embree():
    for name in ("between nodes", "5 x 7", "oblong cells", "walls", "steep"):
        height_field_laws.first_hits_are_those_of_embree(RELIEFS[name]())


def embree_measures_the_same():
    for name in ("walls", "oblong cells", "33 x 33"):
        height_field_laws.embree_measures_the_same(name, optics.Mirror())


def directions_are_put_into_the_bins_that_their_angles_lie_in():
    height_field_laws.directions_are_put_into_the_bins_that_their_angles_lie_in(5.0, 7.2, 37.0)


LAWS = (
    a_lossless_surface_returns_all_light,
    steep_grooves_lose_no_light,
    a_flat_mirror_sends_fresnel_into_one_bin,
    turning_a_flat_mirror_changes_nothing,
    a_flat_diffuser_is_rho_over_pi_everywhere,
    error_bars_cover_the_truth,
    error_bars_of_mirrors_cover_the_truth,
    a_source_cone_averages_fresnel_over_its_directions,
    cones_are_reciprocal,
    a_right_angled_groove_returns_light_after_two_hits,
    half_pipes_share_light_between_one_two_and_three_hits,
    cylinders_hide_what_the_closed_form_hides,
    facets_reflect_with_fresnel_at_their_own_angle,
    orders_add_up_to_the_total,
    where_the_tile_is_cut_changes_nothing,
    grooves_of_all_slopes_and_azimuths_are_cook_and_torrance,
    no_node_is_lower_than_what_it_stands_for,
    what_is_certain_to_escape_hits_nothing,
    every_shortcut_is_a_proof,
    first_hits_are_those_of_embree,
    embree_measures_the_same,
    directions_are_put_into_the_bins_that_their_angles_lie_in,
)
