"""The instrument: its error bars, its stopping rule, and what happens when it is stopped."""

import math

import numpy as np
import pytest
from pydantic import ValidationError
from statistical import assert_covers

import microsurfaces as ms
from gonio import goniometer as instrument
from gonio import optics
from gonio.detectors import Apertures, HemisphereGrid, Klems, cone_quadrature
from gonio.goniometer import Goniometer
from gonio.tally import UNIT
from gonio.transport.scene import Scene

GRID = HemisphereGrid(theta_step=5, phi_step=15)


def v_groove_share(theta_i, angle):
    """Light that leaves a mirror V-groove after one hit: each facet's lit part times what leaves unhindered (B.6)."""
    wi = np.array([math.sin(theta_i), math.cos(theta_i)])
    share = 0.0
    for wm in (np.array([math.sin(angle), math.cos(angle)]), np.array([-math.sin(angle), math.cos(angle)])):
        facing = wi @ wm
        wo = 2 * facing * wm - wi
        if facing > 0 and wo[1] > 0:
            free = min(1.0, 2 * wm[1] * wi[1] / facing, 2 * wm[1] * wo[1] / facing)
            share += free * facing / (2 * math.cos(angle) * wi[1])
    return share


def v_groove():
    goniometer = Goniometer(theta_i=(40,), paths=2048, wavelengths=(550,), detector=GRID)
    scene = Scene(ms.VGrooves(angle=37).build(0), optics.Mirror())
    return goniometer, scene, ("1", None), v_groove_share(math.radians(40), math.radians(37))


def flat_fresnel():
    material, theta, half_angle = optics.Dielectric(eta=1.5), 65.0, 20.0
    wo, weight = cone_quadrature(np.array([theta]), np.array([0.0]), half_angle, 32)
    exact = (weight[..., None] * material.reflectance(wo[..., 2], np.array([550.0]))).sum()
    goniometer = Goniometer(theta_i=(theta,), beam_half_angle=half_angle, paths=2048, wavelengths=(550,), detector=GRID)
    return goniometer, Scene(ms.Flat().build(0), material), ("all", None), exact


def mirror_cylinder():
    """A bin of the cone on which mirror ridges reflect (A.6): [sin((b - psi)/2) - sin((a - psi)/2)] / (d cos psi)."""
    psi = math.radians(33.3)
    a, b = math.radians(-42.5), math.radians(-37.5)
    exact = (math.sin((b - psi) / 2) - math.sin((a - psi) / 2)) / (2 * math.cos(psi))
    relief = ms.Cylinders(profile="ridges", radius=1.0, distance=2.0, chords=1000).build(0)
    goniometer = Goniometer(theta_i=(33.3,), paths=8192, wavelengths=(550,), detector=GRID)
    return goniometer, Scene(relief, optics.Mirror()), ("1", (8, 12)), exact


CASES = {"v-groove": v_groove, "flat Fresnel": flat_fresnel, "mirror cylinders": mirror_cylinder}


def score(measurement, order, place, exact):
    """t-score of a known share of the light: an albedo, or what one bin holds."""
    data = measurement.dataset.sel(order=order).isel(theta_i=0, phi_i=0, wavelength=0)
    if place is None:
        return (float(data["albedo"]) - exact) / float(data["albedo_standard_error"])
    ring, sector = place
    area = GRID.projected_solid_angles().reshape(GRID.shape)[place]
    value, error = (float(data[name][ring, sector]) * area for name in ("brdf", "brdf_standard_error"))
    return (value - exact) / error


@pytest.mark.slow
@pytest.mark.parametrize("target_error", [None, 0.1], ids=("paths", "target_error"))
def test_error_bars_cover_the_truth(target_error):
    """1,000 small measurements of three cases whose exact value is known: their t-scores are Student's t."""
    scores = []
    for case in CASES.values():
        goniometer, scene, (order, place), exact = case()
        if target_error is not None:
            settings = {name: getattr(goniometer, name) for name in ("theta_i", "beam_half_angle", "wavelengths")}
            goniometer = Goniometer(**settings, detector=GRID, paths=1024, target_error=target_error)
        runs = (goniometer.measure(scene, seed=seed, threads=1) for seed in range(334))
        scores.append([score(run, order, place, exact) for run in runs])
    assert_covers(np.array(scores), 15)


def test_target_error_is_reached():
    scene = Scene(ms.Gaussian(alpha=0.4, samples=256, side=150.0).build(1), optics.Conductor("Cu"))
    goniometer = Goniometer(theta_i=(10, 60), paths=10_000, target_error=0.02, detector=GRID, wavelengths=(450, 650))
    data = goniometer.measure(scene).dataset.sel(order="all")
    assert (data["replicates"] > goniometer.replicates).all()
    light = data["brdf"] * data["projected_solid_angle"]
    good = data["brdf_standard_error_mc"] < 0.02 * data["brdf"]
    share = light.where(good).sum(("theta_o", "dphi")) / light.sum(("theta_o", "dphi"))
    assert (share > 0.45).all(), "half of the light should be in bins with less error than asked for"


def test_further_specimens_can_be_measured_as_often_as_the_first():
    scene = Scene(ms.Flat().build(0), optics.Lambertian(0.5))
    goniometer = Goniometer(theta_i=(0, 50), paths=1600, target_error=0.2, detector=GRID, wavelengths=(550,))
    first = goniometer.measure(scene, seed=1)
    again = goniometer.measure(scene, seed=2, replicates=first.sums["replicates"].values.ravel())
    merged = first.merge(again)
    assert (merged.sums["paths"] == 2 * first.sums["paths"]).all()
    assert (merged.sums["realisations"] == 2).all()


def test_launched_paths_are_those_asked_for_rounded_up_to_whole_replicates():
    scene = Scene(ms.Flat().build(0), optics.Mirror())
    measurement = Goniometer(paths=1001, replicates=10, detector=GRID, wavelengths=(550,)).measure(scene)
    assert int(measurement.sums["paths"].item()) == 1010
    assert int(measurement.sums["energy_budget"].sel(termination="launched").item()) == 1010 * UNIT


def test_ctrl_c_keeps_the_incidences_already_measured():
    scene = Scene(ms.Gaussian(alpha=0.3, samples=128, side=60.0).build(1), optics.Mirror())
    goniometer = Goniometer(theta_i=(0, 30, 60), paths=50_000, detector=GRID, wavelengths=(550,))

    def interrupt(done, total, rays):
        if done > 75_000:
            raise KeyboardInterrupt

    stopped, whole = goniometer.measure(scene, seed=3, progress=interrupt), goniometer.measure(scene, seed=3)
    assert stopped.interrupted
    assert not whole.interrupted
    assert list(stopped.incidences()) == [(0.0, 0.0)]
    same = stopped.dataset["brdf"].sel(theta_i=0).values == whole.dataset["brdf"].sel(theta_i=0).values
    assert same.all()
    assert np.isnan(stopped.dataset["brdf"].sel(theta_i=60)).all()


def test_progress_counts_paths_and_rays_to_the_end():
    scene = Scene(ms.Flat().build(0), optics.Mirror())
    calls = []
    Goniometer(theta_i=(0, 20), paths=3200, detector=GRID, wavelengths=(550,)).measure(
        scene, progress=lambda *numbers: calls.append(numbers)
    )
    assert calls[-1] == (6400, 6400, 12800)
    assert all(done <= total for done, total, _ in calls)


def test_what_cannot_fit_is_refused_in_words(monkeypatch):
    monkeypatch.setattr(instrument, "_memory", lambda: 2**20)
    with pytest.raises(MemoryError, match=r"needs about .* GiB of memory .* wider bins"):
        Goniometer(theta_i=(0, 30)).measure(Scene(ms.Flat().build(0), optics.Mirror()))


@pytest.mark.parametrize(("arguments", "sentence"), [
    ({"theta_i": (90.0,)}, "less than 90"),
    ({"theta_i": (-1.0,)}, "greater than or equal to 0"),
    ({"theta_i": (30.0, 10.0)}, "must increase"),
    ({"theta_i": ()}, "at least 1"),
    ({"phi_i": (360.0,)}, "less than 360"),
    ({"wavelengths": (550.0, 550.0)}, "must increase"),
    ({"paths": 0}, "greater than or equal to 1"),
    ({"target_error": 0.0}, "greater than 0"),
    ({"theta_i": (80.0,), "beam_half_angle": 12.0}, "below the horizon"),
    ({"theta_i": (22.5,), "detector": HemisphereGrid(theta_step=5)}, "bin edge"),
    ({"azimuth": "random"}, "'fixed' or 'average'"),
    ({"theta_i": (10.0,), "detector": Klems()}, "leave theta_i"),
])  # fmt: skip
def test_impossible_settings_are_refused(arguments, sentence):
    with pytest.raises(ValidationError, match=sentence):
        Goniometer(**arguments)


@pytest.mark.parametrize(("detector", "arguments", "sentence"), [
    (HemisphereGrid, {"theta_step": 7.0}, "must divide 90 degrees"),
    (HemisphereGrid, {"phi_step": 8.0}, "must divide 180 degrees"),
    (HemisphereGrid, {"theta_step": 0.0}, "greater than 0"),
    (Apertures, {"directions": ((88.0, 0.0),), "half_angle": 3.0}, "above the horizon"),
    (Apertures, {"directions": ()}, "at least 1"),
])  # fmt: skip
def test_impossible_detectors_are_refused(detector, arguments, sentence):
    with pytest.raises(ValidationError, match=sentence):
        detector(**arguments)


def test_orders_can_be_kept_apart_one_by_one():
    """Half cylinders lit from above: shares of 1, 2, 3 and 4 hits of the closed form, and their sum is unchanged."""
    scene = Scene(ms.Cylinders(profile="grooves", radius=1.0, distance=2.0, chords=1000).build(0), optics.Mirror())
    few, many = (
        Goniometer(paths=200_000, wavelengths=(550,), orders=orders, detector=HemisphereGrid(10, 15)).measure(scene)
        for orders in (2, 5)
    )
    assert list(few.dataset["order"].values) == ["all", "1", "2+"]
    assert list(many.dataset["order"].values) == ["all", "1", "2", "3", "4", "5+"]
    albedo = many.dataset["albedo"].values[:, 0, 0, 0]
    np.testing.assert_allclose(albedo[1:5], (0.5, 0.30902, 0.09195, 0.03872), atol=5e-4)
    for label, parts in (("1", ["1"]), ("2+", ["2", "3", "4", "5+"])):
        assert (few.sums["weight"].sel(order=label) == many.sums["weight"].sel(order=parts).sum("order")).all()


@pytest.mark.parametrize("traced", ["grid", "embree"])
def test_a_mirror_sends_each_klems_patch_to_its_opposite(traced):
    """The matrix of a flat mirror: what comes from a patch leaves through the one opposite, wherever in it it began."""
    relief = ms.Flat().build(0)
    scene = Scene(relief if traced == "grid" else relief.mesh(), optics.Mirror())
    for basis in ("full", "half", "quarter"):
        detector = Klems(basis)
        data = Goniometer(paths=512, wavelengths=(550,), detector=detector).measure(scene).dataset
        areas = detector.projected_solid_angles()
        for k, (theta, phi) in enumerate(detector.directions):
            lobe = data["brdf"].sel(order="all", theta_i=theta, phi_i=phi).values[:, 0]
            opposite = detector.directions.index((theta, (phi + 180) % 360 if theta else 0.0))
            assert lobe[opposite] == pytest.approx(1 / areas[k], rel=1e-9)
            assert np.delete(lobe, opposite).max() == 0
        assert int((data["paths"] > 0).sum()) == detector.bins


def test_klems_matrices_are_reciprocal():
    """Patch to patch is a quantity of both: rough gold, asymmetric, light from a and seen from b, and the other way."""
    detector = Klems("quarter")
    relief = ms.Gaussian(alpha=0.6, correlation_length=8.0, side=100.0, samples=64).build(3)
    instrument = Goniometer(paths=40_000, wavelengths=(550,), detector=detector)
    data = instrument.measure(Scene(relief, optics.Conductor("Au"))).dataset.sel(order="all")
    chosen = [dict(zip(("theta_i", "phi_i"), at, strict=True)) for at in detector.directions]
    matrix, error = (
        np.stack([data[name].sel(**at).values[:, 0] for at in chosen]) for name in ("brdf", "brdf_standard_error")
    )
    hits = np.stack([data["count"].sel(**at).values for at in chosen])
    upper = np.triu((hits >= 30) & (hits.T >= 30), 1)
    assert upper.sum() > 500
    z = (matrix - matrix.T)[upper] / np.hypot(error, error.T)[upper]
    # Student's t with about 30 degrees of freedom.
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
    assert z.std() == pytest.approx(np.sqrt(30 / 28), abs=4 * np.sqrt(0.6 / z.size))
    # And it is no symmetric matter: neighbours of equal theta differ.
    assert np.abs(matrix - np.roll(matrix, 1, axis=1))[upper].max() > 20 * error[upper].mean()


def test_klems_patches_see_a_diffuser_as_it_is():
    scene = Scene(ms.Flat().build(0), optics.Lambertian(0.5))
    data = Goniometer(paths=20_000, wavelengths=(550,), detector=Klems("quarter")).measure(scene).dataset
    lit = data["brdf"].sel(order="all").where(data["paths"] > 0).stack(incidence=("theta_i", "phi_i"))
    lobe = lit.dropna("incidence").values
    error = (
        data["brdf_standard_error"].sel(order="all").stack(incidence=("theta_i", "phi_i")).dropna("incidence").values
    )
    z = (lobe - 0.5 / np.pi) / error
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
    assert np.abs(z).max() < 8
