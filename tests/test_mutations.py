"""The test of the tests: a tracer that is damaged on purpose breaks the law that the damage offends.

A damage replaces one fragment of one function, in memory; what is compiled with that function is compiled anew.
"""

import __future__

import functools
import importlib
import inspect
import math
import textwrap
from typing import NamedTuple

import numba
import numpy as np
import pytest
from statistical import assert_covers, assert_equal_within_noise

import microsurfaces as ms
from gonio import optics
from gonio.detectors import Apertures, HemisphereGrid, cone_quadrature
from gonio.goniometer import Goniometer
from gonio.models import CookTorrance
from gonio.scene import Scene
from gonio.sphere import direction

COARSE = HemisphereGrid(theta_step=5, phi_step=15)
GLASS = optics.Dielectric(eta=1.5)
GREEN = np.array([550.0])


def measure(relief, material, seed=1, **instrument):
    """A measurement at one wavelength, on one thread."""
    goniometer = Goniometer(wavelengths=tuple(GREEN), **instrument)
    return goniometer.measure(Scene(relief, material), seed=seed, threads=1)


def one_bin(measurement, theta_o, dphi, order="all"):
    """Share of the launched light in the bin about (theta_o, dphi), for every incidence; bins in steps of 1, 2, 5..."""
    data = measurement.dataset.sel(order=order, theta_o=theta_o, dphi=dphi).squeeze("wavelength")
    return (data["brdf"] * data["projected_solid_angle"]).values


def glass(cosine):
    return GLASS.reflectance(np.array([cosine]), GREEN).item()


@functools.cache
def rough():
    """A small tile with steep slopes: most light that grazes it is hit again behind a seam."""
    return ms.Gaussian(alpha=0.6, samples=128, side=80.0, correlation_length=8.0).build(7)


@functools.cache
def cylinders(profile, distance):
    return ms.Cylinders(profile=profile, radius=1.0, distance=distance, chords=1000).build(0)


# -------------------------------------------------------------------------------------------------------- the laws


def a_lossless_surface_returns_all_light():
    ledger = measure(rough(), optics.Mirror(), theta_i=(0, 60, 85), paths=300_000, detector=COARSE).ledger()
    lost, absorbed = float(ledger["lost"].max() + ledger["truncated"].max()), float(ledger["absorbed"].max())
    assert absorbed == 0, f"{absorbed:.2g} of the light is absorbed"
    assert lost < 1e-5, f"{lost:.2g} of the light is lost"


def steep_grooves_lose_no_light():
    """Up to five hits near the bottom, a concave edge."""
    measurement = measure(ms.VGrooves(angle=70).build(0), optics.Mirror(), theta_i=(0, 60), paths=300_000)
    ledger = measurement.ledger()
    lost = float((ledger["lost"] + ledger["truncated"]).max())
    assert lost < 2e-5, f"{lost:.2g} of the light is lost"


def a_flat_mirror_sends_fresnel_into_one_bin(azimuth="fixed"):
    theta_i = (0, 35, 70)
    measurement = measure(
        ms.Flat().build(0), GLASS, theta_i=theta_i, phi_i=(0, 37, 211), paths=64, detector=COARSE, azimuth=azimuth
    )
    for theta in theta_i:
        expected = glass(math.cos(math.radians(theta)))
        share = one_bin(measurement, theta, 180 if theta else 0)[theta_i.index(theta)]
        np.testing.assert_allclose(share, expected, rtol=2e-5, err_msg=f"theta_i = {theta}")


def turning_a_flat_mirror_changes_nothing():
    a_flat_mirror_sends_fresnel_into_one_bin(azimuth="average")


def a_flat_diffuser_is_rho_over_pi_everywhere():
    """In bins so wide that the cosine of their centre is 3 % off."""
    grid = HemisphereGrid(theta_step=30, phi_step=90)
    data = measure(ms.Flat().build(0), optics.Lambertian(0.8), theta_i=(0, 60), paths=1_000_000, detector=grid).dataset
    bins = data.sel(order="all")
    assert_equal_within_noise(bins["brdf"].values, 0.8 / math.pi, bins["standard_error"].values, 15)


def error_bars_cover_the_truth():
    """Scores of the bins of a flat diffuser."""
    grid = HemisphereGrid(theta_step=6, phi_step=12)
    data = measure(
        ms.Flat().build(0), optics.Lambertian(1.0), theta_i=(0, 30, 60), paths=500_000, detector=grid
    ).dataset
    bins = data.sel(order="all")
    scores = ((bins["brdf"] - 1 / math.pi) / bins["standard_error"]).values
    assert_covers(scores[..., 1:, :, :].ravel(), 15)  # bins of the cap are the same few paths turned about


def error_bars_of_mirrors_cover_the_truth():
    """Half of the light leaves a half-pipe after one hit, if it comes from above; where it starts is all the chance."""
    relief = cylinders("grooves", 2.0)
    data = [
        measure(relief, optics.Mirror(), seed, paths=1600, detector=COARSE).dataset.sel(order="1")
        for seed in range(100)
    ]
    scores = [((d["albedo"] - 0.5) / d["albedo_standard_error"]).item() for d in data]
    assert np.isfinite(scores).all()
    assert_covers(np.array(scores), 15)


def a_source_cone_averages_fresnel_over_its_directions():
    theta, half_angle = 60.0, 29.0
    wo, weight = cone_quadrature(np.array([theta]), np.array([0.0]), half_angle, 32)
    expected = (weight[..., None] * GLASS.reflectance(wo[..., 2], GREEN)).sum()
    albedo = measure(
        ms.Flat().build(0), GLASS, theta_i=(theta,), beam_half_angle=half_angle, paths=200_000, detector=COARSE
    ).albedo()
    assert_equal_within_noise(albedo["albedo"].values, expected, albedo["standard_error"].values, 15)


def cones_are_reciprocal():
    """Cone A lit and cone B seen is cone B lit and cone A seen."""
    relief = ms.Gaussian(alpha_x=0.3, alpha_y=0.6, rotation=20, samples=128, side=80.0, correlation_length=8.0).build(5)
    a, b, half_angle = (20.0, 10.0), (60.0, 160.0), 15.0
    (there, there_error), (back, back_error) = (
        (data["brdf"].item(), data["standard_error_mc"].item())
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


def a_right_angled_groove_returns_light_after_two_hits():
    measurement = measure(ms.VGrooves(angle=45).build(0), optics.Mirror(), paths=200_000, detector=COARSE)
    assert one_bin(measurement, 0, measurement.dataset["dphi"], order="2").sum() > 1 - 2e-5


def half_pipes_share_light_between_one_two_and_three_hits():
    """Reference A.6: touching half cylinders, lit from above."""
    measurement = measure(cylinders("grooves", 2.0), optics.Mirror(), paths=400_000, orders=5, detector=COARSE)
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
        data = measure(relief, optics.Mirror(), theta_i=(0, 30, 60, 80), paths=200_000, detector=COARSE).dataset
        np.testing.assert_allclose(data["albedo"].sel(order="1").values.ravel(), expected, atol=5e-4)


def facets_reflect_with_fresnel_at_their_own_angle():
    """Grooves of 10 degrees, lit at 44 across: facets at 34 degrees send their part to 24, those at 54 to 64."""
    slope, theta = math.radians(10), math.radians(44)
    measurement = measure(
        ms.VGrooves(angle=10).build(0), GLASS, theta_i=(44,), paths=100_000, detector=HemisphereGrid(2, 15)
    )
    for theta_o, tilt in ((24, slope), (64, -slope)):
        local = math.cos(theta - tilt)
        expected = local / (2 * math.cos(slope) * math.cos(theta)) * glass(local)
        np.testing.assert_allclose(one_bin(measurement, theta_o, 180, order="1"), expected, rtol=1e-3)


def orders_add_up_to_the_total():
    sums = measure(cylinders("grooves", 2.0), GLASS, theta_i=(0, 60), paths=100_000, detector=COARSE).sums
    for name in ("weight", "hits"):
        assert (sums[name].sel(order="all") == sums[name].drop_sel(order="all").sum("order")).all(), name
        assert (sums[name].isel(bin=-1) == sums[name].isel(bin=slice(-1)).sum("bin")).all(), name
    ledger = sums["ledger"]
    assert (ledger.sel(fate="launched") == ledger.drop_sel(fate="launched").sum("fate")).all(), "ledger"


def where_the_tile_is_cut_changes_nothing():
    relief = rough()
    moved = ms.HeightField(np.roll(relief.heights, (34, 58), axis=(0, 1)), relief.spacing)
    data = [
        measure(r, optics.Mirror(), seed, theta_i=(20, 80), phi_i=(33,), paths=500_000, detector=COARSE).dataset
        for seed, r in enumerate((relief, moved))
    ]
    one, other = (d.sel(order="all").squeeze() for d in data)
    full = ((one["hits"] > 400) & (other["hits"] > 400)).values
    error = np.hypot(one["standard_error_mc"], other["standard_error_mc"]).values
    assert full.sum() > 200
    assert_equal_within_noise(one["brdf"].values[full], other["brdf"].values[full], error[full], 15)


def grooves_of_all_slopes_and_azimuths_are_cook_and_torrance():
    m, theta, grid = 0.5, 50.0, HemisphereGrid(theta_step=15, phi_step=30)
    realisations = 32
    total = functools.reduce(
        lambda one, other: one.merge(other),
        (
            measure(
                ms.VGrooves(m=m).build(seed), GLASS, seed, theta_i=(theta,), azimuth="average", paths=50_000,
                detector=grid,
            )
            for seed in range(realisations)
        ),
    )  # fmt: skip
    data = total.dataset.sel(order="1").squeeze()
    expected = CookTorrance(m=m, material=GLASS).average(direction(theta, 0), grid, GREEN).reshape(grid.shape)
    full = data["hits"].values > 2000
    assert full.sum() > 20
    assert_equal_within_noise(
        data["brdf"].values[full], expected[full], data["standard_error"].values[full], realisations - 1
    )


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
)

# ----------------------------------------------------------------------------------------------------- the damages


class Damage(NamedTuple):
    """What is broken, and the law that must see it."""

    name: str
    place: str
    """module.function or module.Class.method of gonio."""
    fragment: str
    """What is replaced; it occurs once in that function."""
    replacement: str
    law: object

    def inflict(self, monkeypatch):
        """Damage gonio until the monkeypatch is undone."""
        module_name, *owners, name = self.place.split(".")
        module = importlib.import_module(f"gonio.{module_name}")
        owner = functools.reduce(getattr, owners, module)
        original = inspect.getattr_static(owner, name)
        if hasattr(original, "py_func"):
            for caller in compiled_with(name, vars(module)):
                monkeypatch.setattr(module, caller, compiled(getattr(module, caller).py_func))
            monkeypatch.setattr(module, name, compiled(self._damaged(original.py_func)))
        elif isinstance(original, property):
            monkeypatch.setattr(owner, name, property(self._damaged(original.fget)))
        else:
            monkeypatch.setattr(owner, name, self._damaged(original))

    def _damaged(self, function):
        source = textwrap.dedent(inspect.getsource(function))
        assert source.count(self.fragment) == 1, f"{self.place} has changed: {self.fragment!r} is not in it once"
        undecorated = source[source.index("def ") :].replace(self.fragment, self.replacement)
        code = compile(undecorated, f"<{self.name}>", "exec", flags=__future__.annotations.compiler_flag)
        defined = {}
        exec(code, function.__globals__, defined)
        return defined[function.__name__]


compiled = numba.njit(nogil=True, error_model="numpy")
"""As gonio's kernels are, but never to be found in a cache; globals are looked up at the first call."""


def compiled_with(name, namespace):
    """Names of the kernels that call the kernel `name`, directly or through another."""
    callers, found = set(), {name}
    while found:
        found = {
            caller
            for caller, kernel in namespace.items()
            if hasattr(kernel, "py_func") and found.intersection(kernel.py_func.__code__.co_names)
        } - callers
        callers |= found
    return callers


DAMAGES = (
    Damage(
        "the cosine of the bin's centre",
        "detectors.HemisphereGrid.projected_solid_angles",
        "np.diff(sin2) / 2",
        "np.cos(np.radians(self.theta)) * -np.diff(np.cos(np.radians(self.theta_edges)))",
        a_flat_diffuser_is_rho_over_pi_everywhere,
    ),
    Damage(
        "an aperture's solid angle without its cosine",
        "detectors.Apertures.projected_solid_angles",
        " * self.axes[:, 2]",
        " * np.ones(self.bins)",
        cones_are_reciprocal,
    ),
    Damage(
        "a weight times the local cosine",
        "transport._move",
        "largest = max(",
        "weights[i, w] *= cosine\n                    largest = max(",
        a_lossless_surface_returns_all_light,
    ),
    Damage(
        "Fresnel at the macroscopic angle",
        "transport._move",
        "fresnel(cosine,",
        "fresnel(math.cos(lamp.theta),",
        facets_reflect_with_fresnel_at_their_own_angle,
    ),
    Damage(
        "no periodic wrap: what rises through a side escapes",
        "transport._pass_on",
        "if dz > 0 and z + reach * dz >= tile.top:",
        "if dz > 0:",
        where_the_tile_is_cut_changes_nothing,
    ),
    Damage(
        "wi for wo: azimuth from the mirror's side",
        "transport.bins_of",
        "phi_i / 360",
        "phi_i / 360 + 0.5",
        a_flat_mirror_sends_fresnel_into_one_bin,
    ),
    Damage(
        "wi for wo: light goes back where it came from",
        "transport._mirrored",
        "return dx - twice * nx, dy - twice * ny, dz - twice * nz",
        "return -dx, -dy, -dz",
        a_flat_mirror_sends_fresnel_into_one_bin,
    ),
    Damage(
        "azimuth clockwise",
        "transport._sector",
        "math.atan2(y, x)",
        "math.atan2(-y, x)",
        a_flat_mirror_sends_fresnel_into_one_bin,
    ),
    Damage(
        "normals of length 1 / nz",
        "scene.Scene.__init__",
        "self.mesh.normals().astype(np.float32)",
        "(self.mesh.normals() / self.mesh.normals()[:, 2:]).astype(np.float32)",
        facets_reflect_with_fresnel_at_their_own_angle,
    ),
    Damage(
        "exact normals ignored",
        "scene._corner_normals",
        "mesh.vertex_normals[mesh.faces]",
        "np.repeat(mesh.normals()[:, None], 3, axis=1)",
        cylinders_hide_what_the_closed_form_hides,
    ),
    Damage(
        "light leaks through the edges of facets",
        "scene.Scene.intersect",
        "return hits",
        "hits['primID'][np.minimum(hits['u'], hits['v']) < 1e-4] = -1\n    return hits",
        a_lossless_surface_returns_all_light,
    ),
    Damage(
        "a restart offset that leaps over concave edges",
        "scene.Scene.__init__",
        "OFFSET * largest",
        "1000 * OFFSET * largest",
        steep_grooves_lose_no_light,
    ),
    Damage(
        "no restart offset",
        "scene.Scene.__init__",
        "offset = OFFSET * largest",
        "offset = 0.0",
        a_lossless_surface_returns_all_light,
    ),
    Damage(
        "light of two hits thrown away",
        "transport._collect",
        "if fates[i] != _ESCAPED:",
        "if fates[i] != _ESCAPED or wave.hits[i] == 2:",
        a_right_angled_groove_returns_light_after_two_hits,
    ),
    Damage(
        "light of two hits counted among one",
        "transport._collect",
        "min(wave.hits[i], caught.shape[0]) - 1",
        "max(0, min(wave.hits[i], caught.shape[0]) - 2)",
        half_pipes_share_light_between_one_two_and_three_hits,
    ),
    Damage(
        "the last order left out of the total",
        "tally._absorb",
        "range(orders - 1, -2, -1)",
        "range(orders - 2, -2, -1)",
        orders_add_up_to_the_total,
    ),
    Damage(
        "the surface's turn not taken back",
        "transport._collect",
        "bins.turn + _surface_turn(wave.paths[i], turns[wave.members[i]], lamp.average)",
        "bins.turn",
        turning_a_flat_mirror_changes_nothing,
    ),
    Damage(
        "azimuths of a quarter turn",
        "transport._surface_turn",
        "average * (",
        "average * 0.25 * (",
        grooves_of_all_slopes_and_azimuths_are_cook_and_torrance,
    ),
    Damage(
        "a source cone without its cosine",
        "transport._incident",
        "psi += math.pi",
        "psi += 0.0",
        a_source_cone_averages_fresnel_over_its_directions,
    ),
    Damage(
        "a source cone of uniform radius",
        "transport._incident",
        "math.sqrt(lamp.beam * uniform(r0))",
        "math.sqrt(lamp.beam) * uniform(r0)",
        a_source_cone_averages_fresnel_over_its_directions,
    ),
    Damage(
        "diffuse light without its cosine",
        "transport._cosine_direction",
        "math.sqrt(uniform(r0))",
        "uniform(r0)",
        a_flat_diffuser_is_rho_over_pi_everywhere,
    ),
    Damage(
        "starts on half of the tile",
        "transport._launch",
        "* tile.half_x",
        "* tile.half_x / 2",
        half_pipes_share_light_between_one_two_and_three_hits,
    ),
    Damage(
        "the standard error of one replicate for that of their mean",
        "measurement._estimates",
        "pilot * (pilot - 1)",
        "pilot - 1",
        error_bars_cover_the_truth,
    ),
    Damage(
        "replicates that are one and the same",
        "transport._launch",
        "philox(path, path >> 32, replicate // 4, 0,",
        "philox(path, path >> 32, 0, 0,",
        error_bars_of_mirrors_cover_the_truth,
    ),
    Damage(
        "replicates of one diffuse randomness",
        "transport._move",
        "first_replicate + wave.members[i]",
        "wave.members[i] // 2",
        error_bars_cover_the_truth,
    ),
)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_the_laws_hold_for_the_tracer_as_it_is(law):
    law()


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.name)
def test_damage_is_seen(damage, monkeypatch):
    damage.inflict(monkeypatch)
    with pytest.raises((AssertionError, ArithmeticError)) as seen:
        damage.law()
    assert seen.type in (AssertionError, ArithmeticError), "a crash is not a law"


def test_no_law_is_idle():
    assert {damage.law for damage in DAMAGES} == set(LAWS)
