"""The test of the tests: a tracer that is damaged on purpose breaks the law that the damage offends.

A damage replaces one fragment of one function, in memory; what is compiled with that function is compiled anew.
"""

import __future__

import functools
import importlib
import inspect
import math
import pkgutil
import textwrap
from typing import NamedTuple

import numba
import numpy as np
import pytest
import test_height_field_walk
from reliefs import RELIEFS
from statistical import assert_covers, assert_equal_within_noise

import gonio.transport
import microsurfaces as ms
from gonio import optics
from gonio.detectors import Apertures, HemisphereGrid, cone_quadrature
from gonio.goniometer import Goniometer
from gonio.models import CookTorrance
from gonio.sphere import direction
from gonio.transport.scene import Scene

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


def traced_both_ways(law):
    """The law for a height field, which is traced by its grid, and for its mesh, which is traced by Embree."""

    @functools.wraps(law)
    def both():
        for way in (lambda relief: relief, lambda relief: relief.mesh()):
            law(way)

    return both


@functools.cache
def rough():
    """A small tile with steep slopes: most light that grazes it is hit again behind a seam."""
    return ms.Gaussian(alpha=0.6, samples=128, side=80.0, correlation_length=8.0).build(7)


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


# -------------------------------------------------------------------------------------------------------- the laws


@traced_both_ways
def a_lossless_surface_returns_all_light(way):
    ledger = measure(way(rough()), optics.Mirror(), theta_i=(0, 60, 85), paths=300_000, detector=COARSE).energy_budget()
    lost, absorbed = float(ledger["lost"].max() + ledger["truncated"].max()), float(ledger["absorbed"].max())
    assert absorbed == 0, f"{absorbed:.2g} of the light is absorbed"
    assert lost < 1e-5, f"{lost:.2g} of the light is lost"


@traced_both_ways
def steep_grooves_lose_no_light(way):
    """Up to five hits near the bottom, a concave edge."""
    measurement = measure(way(grooves(angle=70)), optics.Mirror(), theta_i=(0, 60), paths=300_000)
    ledger = measurement.energy_budget()
    lost = float((ledger["lost"] + ledger["truncated"]).max())
    assert lost < 2e-5, f"{lost:.2g} of the light is lost"


def light_of_one_bin(relief, azimuth):
    theta_i = (0, 35, 70)
    measurement = measure(
        relief, GLASS, theta_i=theta_i, phi_i=(0, 37, 211), paths=64, detector=COARSE, azimuth=azimuth
    )
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
        data = measure(relief, optics.Mirror(), seed, paths=1600, detector=COARSE).dataset.sel(order="1")
        scores.append(((data["albedo"] - expected) / data["albedo_standard_error"]).item())
    assert np.isfinite(scores).all()
    assert_covers(np.array(scores), 15)


@traced_both_ways
def a_source_cone_averages_fresnel_over_its_directions(way):
    theta, half_angle = 60.0, 29.0
    wo, weight = cone_quadrature(np.array([theta]), np.array([0.0]), half_angle, 32)
    expected = (weight[..., None] * GLASS.reflectance(wo[..., 2], GREEN)).sum()
    albedo = measure(
        way(flat()), GLASS, theta_i=(theta,), beam_half_angle=half_angle, paths=200_000, detector=COARSE
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
    measurement = measure(way(grooves(angle=45)), optics.Mirror(), paths=200_000, detector=COARSE)
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
    sums = measure(cylinders("grooves", 2.0), GLASS, theta_i=(0, 60), paths=100_000, detector=COARSE).sums
    for name in ("weight", "count"):
        assert (sums[name].sel(order="all") == sums[name].drop_sel(order="all").sum("order")).all(), name
        assert (sums[name].isel(bin=-1) == sums[name].isel(bin=slice(-1)).sum("bin")).all(), name
    ledger = sums["energy_budget"]
    assert (ledger.sel(termination="launched") == ledger.drop_sel(termination="launched").sum("termination")).all(), (
        "ledger"
    )


@traced_both_ways
def where_the_tile_is_cut_changes_nothing(way):
    relief = rough()
    moved = ms.HeightField(np.roll(relief.heights, (34, 58), axis=(0, 1)), relief.spacing)
    data = [
        measure(way(r), optics.Mirror(), seed, theta_i=(20, 80), phi_i=(33,), paths=500_000, detector=COARSE).dataset
        for seed, r in enumerate((relief, moved))
    ]
    one, other = (d.sel(order="all").squeeze() for d in data)
    full = ((one["count"] > 400) & (other["count"] > 400)).values
    error = np.hypot(one["brdf_standard_error_mc"], other["brdf_standard_error_mc"]).values
    assert full.sum() > 200
    assert_equal_within_noise(one["brdf"].values[full], other["brdf"].values[full], error[full], 15)


@traced_both_ways
def grooves_of_all_slopes_and_azimuths_are_cook_and_torrance(way):
    m, theta, grid = 0.5, 50.0, HemisphereGrid(theta_step=15, phi_step=30)
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
        test_height_field_walk.test_no_node_is_lower_than_what_it_stands_for(RELIEFS[name]())


def what_is_certain_to_escape_hits_nothing():
    for name in ("5 x 7", "gaussian .3", "cliffs", "needles", "walls", "towers", "ramps", "pyramid"):
        test_height_field_walk.test_what_is_certain_to_escape_hits_nothing(RELIEFS[name]())


def every_shortcut_is_a_proof():
    for name in ("gaussian .5", "needles on the seam", "33 x 33", "towers"):
        for material, setting in test_height_field_walk.INSTRUMENTS[1:3]:
            test_height_field_walk.test_every_shortcut_is_a_proof(RELIEFS[name](), material, setting)


def first_hits_are_those_of_embree():
    for name in ("between nodes", "5 x 7", "oblong cells", "walls", "steep"):
        test_height_field_walk.test_first_hits_are_those_of_embree(RELIEFS[name]())


def embree_measures_the_same():
    for name in ("walls", "oblong cells", "33 x 33"):
        test_height_field_walk.test_embree_measures_the_same(name, optics.Mirror())


def directions_are_put_into_the_bins_that_their_angles_lie_in():
    test_height_field_walk.test_directions_are_put_into_the_bins_that_their_angles_lie_in(5.0, 7.2, 37.0)


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
        module = max((name for name in MODULES if f"gonio.{self.place}".startswith(f"{name}.")), key=len)
        *owners, name = f"gonio.{self.place}".removeprefix(f"{module}.").split(".")
        owner = functools.reduce(getattr, owners, MODULES[module])
        original = inspect.getattr_static(owner, name)
        if isinstance(original, property):
            monkeypatch.setattr(owner, name, property(self._damaged(original.fget)))
        elif isinstance(original, classmethod):
            monkeypatch.setattr(owner, name, classmethod(self._damaged(original.__func__)))
        elif owners:
            monkeypatch.setattr(owner, name, self._damaged(original))
        elif hasattr(original, "py_func"):
            callers = {kernel: compiled(kernel.py_func) for kernel in compiled_with(original)}
            replace_everywhere(monkeypatch, {**callers, original: compiled(self._damaged(original.py_func))})
        else:
            replace_everywhere(monkeypatch, {original: self._damaged(original)})

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

MODULES = {
    name: importlib.import_module(name)
    for package in (gonio, gonio.transport)
    for name in (f"{package.__name__}.{found.name}" for found in pkgutil.iter_modules(package.__path__))
}
"""The modules of gonio, and those of its transport, by their names."""


def compiled_with(kernel):
    """The kernels that call `kernel`, directly or through another, wherever they are."""
    kernels = {k for module in MODULES.values() for k in vars(module).values() if hasattr(k, "py_func")}
    callers, found = set(), {kernel}
    while found:
        found = {
            caller
            for caller in kernels - callers
            if any(caller.py_func.__globals__.get(name) in found for name in caller.py_func.__code__.co_names)
        }
        callers |= found
    return callers


def replace_everywhere(monkeypatch, replacements):
    """Put others in the place of functions, in every module that has imported them."""
    for module in MODULES.values():
        for name, value in list(vars(module).items()):
            if inspect.isroutine(value) or hasattr(value, "py_func"):
                monkeypatch.setattr(module, name, replacements.get(value, value))


DAMAGES = (
    # What is measured.
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
        "the last order left out of the total",
        "tally._absorb",
        "whole[w] += value",
        "whole[w] += value * (order < orders - 1)",
        orders_add_up_to_the_total,
    ),
    Damage(
        "the standard error of one replicate for that of their mean",
        "measurement._estimates",
        "pilot * (pilot - 1)",
        "pilot - 1",
        error_bars_cover_the_truth,
    ),
    # What all paths have in common.
    Damage(
        "a weight times the local cosine",
        "transport.light.attenuate",
        "i, weak = struck[n], 0",
        "i, weak = struck[n], 0\n        weights[i, 0] *= cosines[n]",
        a_lossless_surface_returns_all_light,
    ),
    Damage(
        "Fresnel in the middle of the table's intervals",
        "transport.light._look_up",
        "u = cosines[n] * intervals - place",
        "u = 0.5",
        a_flat_mirror_sends_fresnel_into_one_bin,
    ),
    Damage(
        "wi for wo: azimuth from the mirror's side",
        "transport.scoring.bins_of",
        "phi_i / 360",
        "phi_i / 360 + 0.5",
        a_flat_mirror_sends_fresnel_into_one_bin,
    ),
    Damage(
        "wi for wo: light goes back where it came from",
        "transport.light.mirrored",
        "return dx - twice * nx, dy - twice * ny, dz - twice * nz",
        "return -dx, -dy, -dz",
        a_flat_mirror_sends_fresnel_into_one_bin,
    ),
    Damage(
        "azimuth clockwise",
        "transport.scoring.score",
        "c * x + s * y, c * y - s * x",
        "c * x - s * y, -c * y - s * x",
        a_flat_mirror_sends_fresnel_into_one_bin,
    ),
    Damage(
        "azimuth clockwise from the lamp",
        "transport.scoring.score",
        "c * y - s * x",
        "s * x - c * y",
        directions_are_put_into_the_bins_that_their_angles_lie_in,
    ),
    Damage(
        "the ring where a step of the table begins",
        "transport.scoring.score",
        "while sin2 >= edges[ring]:",
        "while False:",
        directions_are_put_into_the_bins_that_their_angles_lie_in,
    ),
    Damage(
        "the sector where a step of the table begins",
        "transport.scoring.score",
        "while _passed(",
        "while False and _passed(",
        directions_are_put_into_the_bins_that_their_angles_lie_in,
    ),
    Damage(
        "light of two hits thrown away",
        "transport.scoring.score",
        "if terminations[i] != ESCAPED:",
        "if terminations[i] != ESCAPED or hits[i] == 2:",
        a_right_angled_groove_returns_light_after_two_hits,
    ),
    Damage(
        "light of two hits counted among one",
        "transport.scoring.score",
        "min(hits[i], scored.shape[0]) - 1",
        "max(0, min(hits[i], scored.shape[0]) - 2)",
        half_pipes_share_light_between_one_two_and_three_hits,
    ),
    Damage(
        "the surface's turn not taken back",
        "transport.scoring.score",
        "bins.turn + surface_turn(paths[i], turns[slots[i]], True)",
        "bins.turn",
        turning_a_flat_mirror_changes_nothing,
    ),
    Damage(
        "azimuths of a quarter turn",
        "transport.source.surface_turn",
        "average * (",
        "average * 0.25 * (",
        grooves_of_all_slopes_and_azimuths_are_cook_and_torrance,
    ),
    Damage(
        "a source cone without its cosine",
        "transport.source.incident",
        "psi += math.pi",
        "psi += 0.0",
        a_source_cone_averages_fresnel_over_its_directions,
    ),
    Damage(
        "a source cone of uniform radius",
        "transport.source.incident",
        "math.sqrt(source.source_sin2 * uniform(r0))",
        "math.sqrt(source.source_sin2) * uniform(r0)",
        a_source_cone_averages_fresnel_over_its_directions,
    ),
    Damage(
        "diffuse light without its cosine",
        "transport.light.cosine_direction",
        "math.sqrt(uniform(r0))",
        "uniform(r0)",
        a_flat_diffuser_is_rho_over_pi_everywhere,
    ),
    # Embree's paths.
    Damage(
        "Embree: Fresnel at the macroscopic angle",
        "transport.embree._move",
        "min(1.0, -(dx * nx + dy * ny + dz * nz))",
        "math.cos(source.theta)",
        facets_reflect_with_fresnel_at_their_own_angle,
    ),
    Damage(
        "Embree: no periodic wrap, what rises through a side escapes",
        "transport.embree._pass_on",
        "if dz > 0 and z + reach * dz >= tile.top:",
        "if dz > 0:",
        where_the_tile_is_cut_changes_nothing,
    ),
    Damage(
        "normals of length 1 / nz",
        "transport.scene.Scene._build",
        "self.mesh.normals().astype(np.float32)",
        "(self.mesh.normals() / self.mesh.normals()[:, 2:]).astype(np.float32)",
        facets_reflect_with_fresnel_at_their_own_angle,
    ),
    Damage(
        "exact normals ignored",
        "transport.scene._corner_normals",
        "mesh.vertex_normals[mesh.faces]",
        "np.repeat(mesh.normals()[:, None], 3, axis=1)",
        cylinders_hide_what_the_closed_form_hides,
    ),
    Damage(
        "light leaks through the edges of facets",
        "transport.scene.Scene.intersect",
        "return hits",
        "hits['primID'][np.minimum(hits['u'], hits['v']) < 1e-4] = -1\n    return hits",
        a_lossless_surface_returns_all_light,
    ),
    Damage(
        "a restart offset that leaps over concave edges",
        "transport.scene.Scene._build",
        "OFFSET * largest",
        "1000 * OFFSET * largest",
        steep_grooves_lose_no_light,
    ),
    Damage(
        "no restart offset",
        "transport.scene.Scene._build",
        "offset = OFFSET * largest",
        "offset = 0.0",
        a_lossless_surface_returns_all_light,
    ),
    Damage(
        "Embree: starts on half of the tile",
        "transport.embree._launch",
        "* tile.half_x",
        "* tile.half_x / 2",
        half_pipes_share_light_between_one_two_and_three_hits,
    ),
    Damage(
        "Embree: replicates that are one and the same",
        "transport.embree._launch",
        "philox(path, path >> 32, replicate // 4, 0,",
        "philox(path, path >> 32, 0, 0,",
        error_bars_of_mirrors_cover_the_truth,
    ),
    Damage(
        "Embree: replicates of one diffuse randomness",
        "transport.embree._move",
        "first_replicate + state.slots[i]",
        "state.slots[i] // 2",
        error_bars_cover_the_truth,
    ),
    Damage(
        "Embree: what is absorbed is in no ledger",
        "transport.embree._settle",
        "UNIT - carried",
        "0",
        a_flat_mirror_sends_fresnel_into_one_bin,
    ),
    # The tables of a height field.
    Damage(
        "certified without a look at the facets near by",
        "transport.accelerator._nearby",
        "_highest(",
        "0 * _highest(",
        what_is_certain_to_escape_hits_nothing,
    ),
    Damage(
        "certified without a look at the heights of a ring",
        "transport.accelerator._ring",
        "(top - ",
        "0 * (top - ",
        what_is_certain_to_escape_hits_nothing,
    ),
    Damage(
        "certified without a look at the larger rings",
        "transport.accelerator._ring",
        "near, coarser[",
        "near, 0 * coarser[",
        what_is_certain_to_escape_hits_nothing,
    ),
    Damage(
        "heights seen from the middle of a ring",
        "transport.accelerator._ring",
        "/ near",
        "/ (1.5 * near)",
        what_is_certain_to_escape_hits_nothing,
    ),
    Damage(
        "certified slopes rounded down",
        "transport.accelerator._encode",
        "out[j, i, k] = code",
        "out[j, i, k] = max(code - 1, 0)",
        what_is_certain_to_escape_hits_nothing,
    ),
    Damage(
        "a facet's slope at the sides of a sector only",
        "transport.accelerator._steepest",
        "slope / math.cos(math.pi / SECTORS)",
        "slope",
        what_is_certain_to_escape_hits_nothing,
    ),
    Damage(
        "slopes of the lower triangles only",
        "transport.accelerator._steepest",
        "max(s0, s1)",
        "s0",
        what_is_certain_to_escape_hits_nothing,
    ),
    Damage(
        "certificates that end at the side of the tile",
        "transport.accelerator._highest",
        "range(x0 // nx, x1 // nx + 1)",
        "range(0, 1)",
        what_is_certain_to_escape_hits_nothing,
    ),
    Damage(
        "sectors as narrow as their middle",
        "transport.accelerator._boxes",
        "np.arange(2)",
        "np.full(2, 0.5)",
        what_is_certain_to_escape_hits_nothing,
    ),
    Damage(
        "highest points rounded down",
        "transport.accelerator._cells",
        "h + margin",
        "h - margin",
        no_node_is_lower_than_what_it_stands_for,
    ),
    Damage(
        "nodes without their last column",
        "transport.accelerator._merge",
        "min(2 * i + 1, columns - 1)",
        "2 * i",
        no_node_is_lower_than_what_it_stands_for,
    ),
    Damage(
        "bundles as narrow as their middle",
        "transport.accelerator._dilated",
        "reach = 1 if",
        "reach = 0 if",
        every_shortcut_is_a_proof,
    ),
    Damage(
        "bundles as narrow as the last node",
        "transport.accelerator._dilated",
        "else 2",
        "else 1",
        no_node_is_lower_than_what_it_stands_for,
    ),
    # The paths over a height field.
    Damage(
        "guesses accepted without a proof",
        "transport.height_field._guess",
        "& seen &",
        "&",
        every_shortcut_is_a_proof,
    ),
    Damage(
        "guesses that see the lamp behind them",
        "transport.height_field._guess",
        "horizon_sector(-u, -v)",
        "horizon_sector(u, v)",
        every_shortcut_is_a_proof,
    ),
    Damage(
        "guesses accepted after one step",
        "transport.height_field._guess",
        "& (facet == facets[n, 1])",
        "",
        every_shortcut_is_a_proof,
    ),
    Damage(
        "guesses beyond the side of the tile",
        "transport.height_field._improve",
        " if inside else -1",
        "",
        every_shortcut_is_a_proof,
    ),
    Damage(
        "escape certain at half the certified slope",
        "transport.height_field._search",
        "horizon_slope2[code]",
        "0.25 * horizon_slope2[code]",
        every_shortcut_is_a_proof,
    ),
    Damage(
        "bundles free as far as the end of a node",
        "transport.height_field._free_way",
        "min(end, (top - z) / dz)",
        "end",
        every_shortcut_is_a_proof,
    ),
    Damage(
        "nodes passed above where rays enter them",
        "transport.height_field._walk",
        "<= max_mipmap[np.uint64(offsets[level]",
        "+ (0.0 if rises else dz * (way - end)) <= max_mipmap[np.uint64(offsets[level]",
        every_shortcut_is_a_proof,
    ),
    Damage(
        "diagonals that all run alike",
        "transport.height_field._walk",
        "(i + j) & 1",
        "0",
        first_hits_are_those_of_embree,
    ),
    Damage(
        "the upper triangle's plane for the lower's",
        "transport.height_field._facet",
        "p = h11 - h01 if triangle else h10 - h00",
        "p = h11 - h01",
        first_hits_are_those_of_embree,
    ),
    Damage(
        "no look below the diagonal",
        "transport.height_field._meet",
        "& below_diagonal",
        "& False",
        first_hits_are_those_of_embree,
    ),
    Damage(
        "a facet met although the ray passes above its edge",
        "transport.height_field._meet",
        "(below_edge and ",
        "(True and ",
        first_hits_are_those_of_embree,
    ),
    Damage(
        "the other triangle spared for the own",
        "transport.height_field._walk",
        "= columns[n], rows[n], triangles[n]",
        "= columns[n], rows[n], 1 - triangles[n]",
        embree_measures_the_same,
    ),
    Damage(
        "no periodic wrap: what rises through a side escapes",
        "transport.height_field._walk",
        "crossings += 1",
        "termination = ESCAPED if rises else termination",
        where_the_tile_is_cut_changes_nothing,
    ),
    Damage(
        "the next tile lies a little off",
        "transport.height_field._walk",
        "x - over_x * nx",
        "x - over_x * nx * 1.01",
        first_hits_are_those_of_embree,
    ),
    Damage(
        "what rises has escaped",
        "transport.height_field._walk",
        "if rises and z + dz * way > top:",
        "if rises:",
        embree_measures_the_same,
    ),
    Damage(
        "vertical light hits the other triangle",
        "transport.height_field._drop",
        "triangle = _triangle_at(u, v, odd)",
        "triangle = 1 - _triangle_at(u, v, odd)",
        embree_measures_the_same,
    ),
    Damage(
        "slopes of square cells",
        "transport.height_field._normals",
        "q * per_y",
        "q * per_x",
        embree_measures_the_same,
    ),
    Damage(
        "Fresnel at the angle from the vertical",
        "transport.height_field._mirror",
        "-(dx * nx + dy * ny + dz * nz)",
        "abs(dz)",
        facets_reflect_with_fresnel_at_their_own_angle,
    ),
    Damage(
        "starts on half of the tile",
        "transport.height_field._launch",
        "along_x * nx",
        "along_x * nx / 2",
        where_the_tile_is_cut_changes_nothing,
    ),
    Damage(
        "replicates that are one and the same",
        "transport.height_field._launch",
        "philox(path, path >> 32, replicate // 4, 0,",
        "philox(path, path >> 32, 0, 0,",
        error_bars_of_mirrors_cover_the_truth,
    ),
    Damage(
        "replicates of one diffuse randomness",
        "transport.height_field._diffuse",
        "first_replicate + slots[n]",
        "slots[n] // 2",
        error_bars_cover_the_truth,
    ),
    Damage(
        "what is absorbed is in no ledger",
        "transport.height_field._enter_in_ledger",
        "UNIT - carried",
        "0",
        a_flat_mirror_sends_fresnel_into_one_bin,
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
