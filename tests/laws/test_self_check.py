"""The self-check: sound measurements pass, each check can go wrong alone, and it sees that a tracer is damaged."""

import functools
import json
import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
import xarray as xr
from damages import DAMAGES
from scipy import stats
from statistical import LEVEL
from synthetic import external

import gonio
import microsurfaces as ms
from gonio.detectors import Apertures, HemisphereGrid
from gonio.experiment import Experiment
from gonio.goniometer import Goniometer
from gonio.measurement import ENERGY_BUDGET
from gonio.optics import Conductor, Dielectric, Lambertian, Mirror
from gonio.self_check import SelfCheckReport, check, check_file
from gonio.transport.scene import Scene

pytestmark = pytest.mark.slow

NAMES = (
    "energy budget", "orders", "values", "energy", "furnace", "lost light", "reciprocity", "normals", "resolution",
    "replicates", "realisations", "completeness", "sparse bins", "polarisation", "geometric optics",
)  # fmt: skip
LAUNCHED, ESCAPED, ABSORBED, _, LOST = range(len(ENERGY_BUDGET))
COPPER, GLASS = Conductor("Cu"), Dielectric(eta=1.5)
ROUGH = ms.Gaussian(alpha=0.3, samples=128, side=120.0)
STEEP = ms.Gaussian(alpha=0.9, samples=64, side=32.0, correlation_length=8.0)
RIDGES = ms.Cylinders(distance=2.5, floor_height=0.3)


def experiment(surface, material=COPPER, realisations=4, seed=1, **instrument):
    coarse = {"theta_i": (0, 60), "wavelengths": (450, 650), "paths": 4000, "replicates": 8}
    goniometer = Goniometer(**coarse | {"detector": HemisphereGrid(theta_step=15, phi_step=30)} | instrument)
    return Experiment(surface=surface, material=material, goniometer=goniometer, realisations=realisations, seed=seed)


def cones(surface, material, theta_i, phi_i=(10, 160), half_angle=15, **settings):
    """Every direction that is lit is seen as well, in cones of one width."""
    seen = Apertures(tuple((float(theta), float(phi)) for theta in theta_i for phi in phi_i), half_angle)
    pairs = {"theta_i": theta_i, "phi_i": phi_i, "beam_half_angle": half_angle, "detector": seen, "wavelengths": (550,)}
    return experiment(surface, material, **pairs | settings)


SOUND = {
    "flat": experiment(ms.Flat()),
    "rough": experiment(ROUGH),
    "anisotropic": experiment(ms.Gaussian(alpha_x=0.2, alpha_y=0.4, rotation=20, samples=192, side=120.0)),
    "ridges": experiment(RIDGES, realisations=1),
    "grooves": experiment(ms.Cylinders(profile="grooves", chords=64)),
    "V-grooves of all slopes": experiment(ms.VGrooves(m=0.4)),
    "V-grooves of one slope": experiment(ms.VGrooves(angle=30)),
    "mirror": experiment(ROUGH, Mirror()),
    "diffuser": experiment(ROUGH, Lambertian(1.0)),
    "cones": cones(ROUGH, GLASS, (20, 40), paths=8000),
    "steep mirror": experiment(STEEP, Mirror(), realisations=1, paths=20_000),
    "steep grooves": experiment(ms.VGrooves(angle=70), Mirror(), paths=200_000),
    "cones on a plane": cones(ms.Flat(), GLASS, (45, 60), (10, 180, 200), half_angle=20, paths=20_000),
    "cones on a steep mirror": cones(STEEP, Mirror(), (45, 75), realisations=1, paths=100_000),
    "cones on a steep diffuser": cones(STEEP, Lambertian(1.0), (45, 75), realisations=1, paths=50_000),
    "cones on turned grooves": cones(
        ms.VGrooves(angle=20), GLASS, (20, 60), (0, 160), realisations=1, paths=50_000, azimuth="average"
    ),
}


@functools.cache
def measured(name):
    return SOUND[name].run(threads=1)


@functools.cache
def sound(name):
    return check(measured(name))


def unsound(report):
    return {one.name: one.status for one in report.checks if one.status in ("failed", "warning")}


def numbers(report):
    return {one.name: one.numbers for one in report.checks}


def changes(before, after):
    pairs = zip(before.checks, after.checks, strict=True)
    return {now.name: now.status for was, now in pairs if now.status != was.status}


# --- Sound measurements -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SOUND)
def test_a_sound_measurement_passes(name):
    report = sound(name)
    assert report.passed, report.summary()
    assert tuple(one.name for one in report.checks) == NAMES
    assert set(unsound(report)) <= {"realisations", "polarisation"}


@pytest.mark.parametrize("name", SOUND)
def test_every_sentence_tells_its_numbers_and_limits(name):
    for one, line in zip(sound(name).checks, sound(name).sentences(), strict=True):
        assert line == f"{one.name}, {one.status}: {one.sentence}"
        assert (one.status == "not applicable") == (not one.numbers)
        told = np.abs([float(word) for word in re.findall(r"[\d.]*\d(?:e[+-]\d+)?", one.sentence)])
        for number in map(abs, one.numbers.values()):
            assert np.isclose(told[:, None], (number, 100 * number), rtol=0.05, atol=0).any(), (number, line)


def test_a_file_has_the_report_of_its_measurement(tmp_path):
    for name in ("rough", "cones"):
        path = gonio.save(measured(name), tmp_path / "measured.nc")
        assert check_file(path) == sound(name)
        assert SelfCheckReport.from_json(gonio.load(path).attributes["self_check"]) == sound(name)


def test_a_merged_measurement_passes():
    other = replace(SOUND["cones"], seed=2).run(threads=1)
    report = check(measured("cones").merge(other))
    assert report.passed
    assert numbers(report)["realisations"]["realisations"] == 8


def test_random_checks_do_not_fail_by_chance():
    """40 tiles: nothing fails, and reciprocity has no more small p-values than chance explains."""
    tiles = [
        cones(ms.Gaussian(alpha=0.3, samples=64, side=100.0), GLASS, (20, 40), paths=1000, realisations=2, seed=seed)
        for seed in range(40)
    ]
    reports = [check(tile.run(threads=1)) for tile in tiles]
    assert [report.summary() for report in reports if not report.passed] == []
    found = [numbers(report) for report in reports]
    assert all(one["normals"] for one in found)
    p_values = [1 - (1 - one["reciprocity"]["p_value"]) ** one["reciprocity"]["pairs"] for one in found]
    assert stats.kstest(p_values, "uniform", alternative="greater").pvalue > LEVEL


# --- Each check can go wrong ------------------------------------------------------------------------------------------


def one_unit_absorbed(sums):
    sums["energy_budget"].values[0, 0, ABSORBED, 0] += 1


def swapped_terminations(share):
    """Light that was absorbed is said to be lost."""

    def swap(sums):
        budget = sums["energy_budget"].values
        moved = (share * budget[:, :, LAUNCHED]).astype(np.int64)
        budget[:, :, ABSORBED] -= moved
        budget[:, :, LOST] += moved

    return swap


def an_order_dropped(sums):
    sums["weight"].loc[{"order": "2"}] = 0


def one_count_more(sums):
    sums["count"].values[0, 0, 0, 0] += 1


def no_square(sums):
    sums["realisation_squares_high"].values[0, 0, 0, -1] += 1


def more_light_than_came(sums):
    sums["weight"].values *= 2
    budget = sums["energy_budget"].values
    budget[:, :, ESCAPED] *= 2
    budget[:, :, ABSORBED] -= budget[:, :, ESCAPED] // 2


def some_light_absorbed(sums):
    """One unit of the weight of single hits, in the fullest bin."""
    weight, budget = sums["weight"].values[0, 0], sums["energy_budget"].values[0, 0]
    for order in (0, 1):
        for place in (weight[1, :-1, 0].argmax(), -1):
            weight[order, place, 0] -= 1
    budget[ESCAPED, 0] -= 1
    budget[ABSORBED, 0] += 1


def an_aperture_half_blind(sums):
    """In one of the two directions that are a pair, orders adding up."""
    weight = sums["weight"].values[0, 0, :, 2]
    weight[1:] //= 2
    weight[0] = weight[1:].sum(axis=0)


FAULTS = (
    ("rough", one_unit_absorbed, {"energy budget": "failed"}),
    ("rough", an_order_dropped, {"orders": "failed"}),
    ("cones", one_count_more, {"orders": "failed"}),
    ("ridges", no_square, {"orders": "failed"}),
    ("rough", more_light_than_came, {"energy budget": "failed", "orders": "failed", "energy": "failed"}),
    ("mirror", some_light_absorbed, {"furnace": "failed"}),
    ("diffuser", some_light_absorbed, {"furnace": "failed"}),
    ("rough", swapped_terminations(5e-4), {"lost light": "warning"}),
    ("rough", swapped_terminations(5e-3), {"lost light": "failed"}),
    ("cones", an_aperture_half_blind, {"reciprocity": "failed"}),
)
"""A sound measurement, what is changed in its sums, and the checks that end otherwise."""


@pytest.mark.parametrize(("name", "change", "expected"), FAULTS)
def test_changed_sums_are_seen(name, change, expected):
    sums = measured(name).sums.copy(deep=True)
    change(sums)
    assert changes(sound(name), check(replace(measured(name), sums=sums))) == expected


def scaled_values(file):
    file["brdf"][...] = file["brdf"][...] * (1 + 1e-6)


def more_absorbed(file):
    file["absorbed"][0, 0, 0] += 1e-9


def no_count(file):
    del file["count"]


@pytest.mark.parametrize("change", [scaled_values, more_absorbed, no_count])
def test_changed_values_in_a_file_are_seen(change, tmp_path):
    path = gonio.save(measured("cones"), tmp_path / "cones.nc")
    with h5py.File(path, "r+") as file:
        change(file)
    assert changes(sound("cones"), check_file(path)) == {"values": "failed"}


@pytest.mark.parametrize(
    ("built", "asked"),
    [
        (ms.Gaussian(alpha=0.33, samples=256, side=300.0), {"alpha": 0.3}),
        (RIDGES, {"floor_height": 0.35}),
        (ms.VGrooves(m=0.4), {"m": 0.45}),
        (ms.VGrooves(angle=30), {"angle": 40.0}),
    ],
)
def test_another_surface_than_was_asked_for_is_seen(built, asked):
    measurement = experiment(built, Mirror()).run(threads=1)
    table = json.loads(measurement.attributes["experiment"])
    table["surface"] |= asked
    attributes = {**measurement.attributes, "experiment": json.dumps(table)}
    assert unsound(check(measurement)) == {}
    assert unsound(check(replace(measurement, attributes=attributes))) == {"normals": "failed"}


SETTINGS = (
    (experiment(ms.Gaussian(alpha=0.3, samples=32, side=120.0)), "resolution"),
    (experiment(ms.Cylinders(distance=2.5, floor_height=0.3, chords=16), Mirror()), "resolution"),
    (experiment(ROUGH, replicates=2), "replicates"),
    (experiment(ROUGH, realisations=1), "realisations"),
    (experiment(ROUGH, detector=HemisphereGrid(), wavelengths=(550,)), "sparse bins"),
    (experiment(ms.Gaussian(alpha=0.5, samples=128, side=120.0), GLASS), "polarisation"),
    (experiment(ms.Gaussian(alpha=0.3, correlation_length=0.3, side=3.6, samples=128)), "geometric optics"),
    (experiment(ms.Gaussian(alpha=0.02, samples=128, side=120.0)), "geometric optics"),
    (experiment(ms.Cylinders(radius=0.5), Mirror()), "geometric optics"),
)
"""Settings that limit what may be concluded, and the check that says so."""


@pytest.mark.parametrize(("settings", "name"), SETTINGS)
def test_settings_that_say_little_are_warned_of(settings, name):
    report = check(settings.run(threads=1))
    assert unsound(report) == {name: "warning"}
    assert report.passed
    assert report.summary()[1].startswith(f"{name}, warning: ")


def test_an_interruption_is_warned_of():
    def interrupt(done, total, rays):
        if done > 6000:
            raise KeyboardInterrupt

    report = check(experiment(ms.Flat(), realisations=1).run(threads=1, progress=interrupt))
    assert unsound(report) == {"completeness": "warning"}
    assert numbers(report)["completeness"] == {"incidences": 1, "limit": 2}


def test_a_hole_is_seen():
    """One facet lies where another is already, so that the areas are right."""
    plane = ms.Flat().build(0).mesh()
    torn = ms.Mesh(plane.vertices, plane.faces[[1, *range(1, len(plane.faces))]], plane.period)
    measurement = SOUND["flat"].goniometer.measure(Scene(torn, Mirror()), threads=1)
    report = check(measurement)
    assert unsound(report) == {"lost light": "failed", "realisations": "warning"}
    assert not report.passed


def test_every_check_is_seen_to_go_wrong():
    changed = {name for *_, expected in FAULTS for name in expected}
    assert changed | {name for _, name in SETTINGS} | {"values", "normals", "completeness"} == set(NAMES)


def test_what_cannot_be_checked_is_told_in_a_sentence(tmp_path):
    sums = measured("flat").sums.copy(deep=True)
    sums["paths"].values[:] = 0
    with pytest.raises(ValueError, match="no measured incidence to check"):
        check(replace(measured("flat"), sums=sums))
    text, table, cut = tmp_path / "text.nc", tmp_path / "table.nc", tmp_path / "cut.nc"
    text.write_text("no measurement")
    xr.Dataset({"brdf": ("x", np.ones(3))}).to_netcdf(table, engine="h5netcdf")
    gonio.save(measured("flat"), cut)
    with h5py.File(cut, "r+") as file:
        file.attrs["facets"] = "null"
    for path in (text, table, cut, tmp_path / "none.nc"):
        with pytest.raises(
            ValueError, match=f"{path.name}: (not a measurement that gonio wrote|there is no such file)"
        ):
            check_file(path)


# --- What the self-check sees of a damaged tracer ---------------------------------------------------------------------

DAMAGED = {
    "an aperture's solid angle without its cosine": ("cones on a plane", {"reciprocity": "failed"}),
    "a weight times the local cosine": ("steep mirror", {"furnace": "failed"}),
    "Embree: Fresnel at the macroscopic angle": ("cones on turned grooves", {"reciprocity": "failed"}),
    "no periodic wrap: what rises through a side escapes": ("cones on a steep mirror", {"reciprocity": "failed"}),
    "normals of length 1 / nz": ("cones on turned grooves", {"reciprocity": "failed"}),
    "light leaks through the edges of facets": ("steep grooves", {"lost light": "failed"}),
    "a restart offset that leaps over concave edges": ("steep grooves", {"lost light": "failed"}),
    "no restart offset": ("steep grooves", {"lost light": "failed"}),
    "the last order left out of the total": (
        "steep mirror",
        {"energy budget": "failed", "orders": "failed", "furnace": "failed"},
    ),
    "azimuths of a quarter turn": ("cones on turned grooves", {"reciprocity": "failed"}),
    "a source cone without its cosine": ("cones on a plane", {"reciprocity": "failed"}),
    "a source cone of uniform radius": ("cones on a plane", {"reciprocity": "failed"}),
    "diffuse light without its cosine": ("cones on a steep diffuser", {"reciprocity": "failed"}),
    "starts on half of the tile": ("cones on a steep mirror", {"reciprocity": "failed"}),
}
"""A damage, a measurement that shows it, and the checks that end otherwise; the laws of the tracer see them all."""


def damage(name):
    return {one.name: one for one in DAMAGES}[name]


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_tracer_has_no_clean_report(name, monkeypatch):
    measurement, expected = DAMAGED[name]
    before = sound(measurement)
    damage(name).inflict(monkeypatch)
    assert changes(before, check(SOUND[measurement].run(threads=1))) == expected


@pytest.mark.parametrize(
    "name", ["the cosine of the bin's centre", "the standard error of one replicate for that of their mean"]
)
def test_a_sound_reader_sees_what_a_damaged_one_wrote(name, monkeypatch, tmp_path):
    before = sound("rough")
    with monkeypatch.context() as damaged:
        damage(name).inflict(damaged)
        path = gonio.save(SOUND["rough"].run(threads=1), tmp_path / "rough.nc")
    assert changes(before, check_file(path)) == {"values": "failed"}


def test_an_external_measurement_has_no_report(tmp_path):
    path = gonio.save(external(), tmp_path / "table.nc")
    with pytest.raises(ValueError, match=r"table\.nc comes from another program, without the sums"):
        check_file(path)
    with pytest.raises(ValueError, match="neither merged nor checked"):
        check(external())
