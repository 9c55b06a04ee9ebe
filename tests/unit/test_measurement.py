"""The result: its labels, its file, merging, and reading values between what was measured."""

import math
import os
import re
import stat
import subprocess

import numpy as np
import pytest
import xarray as xr
from synthetic import TRUTH, external

import microsurfaces as ms
from gonio import optics
from gonio.detectors import Apertures, HemisphereGrid
from gonio.goniometer import Goniometer
from gonio.measurement import tabulated
from gonio.netcdf import load, save
from gonio.sphere import direction
from gonio.transport.scene import Scene

GRID = HemisphereGrid(theta_step=5, phi_step=15)
ROUGH = ms.Gaussian(alpha=0.4, samples=128, side=75.0)


def measured(seed, surface_seed=1, **settings):
    settings = {"theta_i": (0, 30, 60), "paths": 20_000, "detector": GRID, "wavelengths": (450, 650)} | settings
    return Goniometer(**settings).measure(Scene(ROUGH.build(surface_seed), optics.Conductor("Cu")), seed=seed)


@pytest.fixture(scope="module")
def specimens():
    return [measured(seed, surface_seed=seed) for seed in (1, 2, 3)]


def test_labels_and_units(specimens):
    data = specimens[0].dataset
    assert data["brdf"].dims == ("order", "theta_i", "phi_i", "theta_o", "dphi", "wavelength")
    assert data["brdf"].attrs["units"] == "sr-1"
    assert list(data["order"].values) == ["all", "1", "2", "3+"]
    assert data["theta_o"].attrs["bounds"] == "theta_o_bounds"
    np.testing.assert_array_equal(data["theta_o_bounds"].values[1], (2.5, 7.5))
    total = (data["brdf"] * data["projected_solid_angle"]).sum(("theta_o", "dphi"))
    np.testing.assert_allclose(total.values, data["albedo"].values, rtol=1e-12)
    np.testing.assert_allclose(
        data["brdf"].sel(order="all"), data["brdf"].drop_sel(order="all").sum("order"), rtol=1e-12, atol=1e-15
    )
    budget = specimens[0].energy_budget()
    np.testing.assert_allclose(sum(budget[name] for name in budget), 1.0, rtol=1e-15)


def test_a_file_gives_back_the_measurement(tmp_path, specimens):
    path = save(specimens[0], tmp_path / "cu.nc")
    again = load(path)
    assert again.dataset.identical(specimens[0].dataset)
    assert again.sums.identical(specimens[0].sums)
    assert [p.name for p in tmp_path.iterdir()] == ["cu.nc"]
    with xr.open_dataset(path, engine="h5netcdf") as external:
        np.testing.assert_array_equal(external["brdf"].values, specimens[0].dataset["brdf"].values)
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask


@pytest.mark.needs("netcdf-bin")
def test_the_netcdf_library_itself_reads_the_file(tmp_path, specimens):
    """Unidata's C library, not the one that wrote it: names, units, dimensions and numbers."""
    path = save(specimens[0], tmp_path / "m.nc")
    text = subprocess.run(["ncdump", "-v", "albedo", path], capture_output=True, text=True, check=True).stdout
    assert "double brdf(order, theta_i, phi_i, theta_o, dphi, wavelength) ;" in text
    assert 'string brdf:units = "sr-1" ;' in text
    assert "group: sums {" in text
    listed = re.search(r"\balbedo =\s*(.*?);", text.split("data:")[1], flags=re.S)
    numbers = np.array(listed.group(1).split(","), np.float64)
    np.testing.assert_allclose(numbers, specimens[0].dataset["albedo"].values.ravel(), rtol=1e-12)


def test_a_failed_save_leaves_the_old_file(tmp_path, specimens, monkeypatch):
    path = save(specimens[0], tmp_path / "cu.nc")
    before = path.read_bytes()

    def full(*_args, **_kwargs):
        raise OSError("no space left on device")

    monkeypatch.setattr(type(path), "write_bytes", full)
    with pytest.raises(OSError, match="no space"):
        save(specimens[1], path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["cu.nc"]


@pytest.mark.parametrize("content", [b"", b"not a file of numbers", None])
def test_what_is_not_a_measurement_is_refused_in_a_sentence(tmp_path, content):
    path = tmp_path / "wrong.nc"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=r"wrong\.nc: (there is no such file|not a measurement)"):
        load(path)


def test_a_truncated_file_is_refused(tmp_path, specimens):
    path = save(specimens[0], tmp_path / "cu.nc")
    path.write_bytes(path.read_bytes()[:20_000])
    with pytest.raises(ValueError, match="not a measurement that gonio wrote, or it is damaged"):
        load(path)


def test_merging_is_exact_associative_and_commutative(specimens):
    a, b, c = specimens
    assert a.merge(b).merge(c).sums.identical(a.merge(b.merge(c)).sums)
    assert a.merge(b).sums.identical(b.merge(a).sums)


def test_merged_errors_are_the_scatter_between_specimens(specimens):
    a, b, c = specimens
    merged = a.merge(b).merge(c).dataset
    each = np.stack([m.dataset["albedo"].values for m in specimens])
    np.testing.assert_allclose(merged["albedo"].values, each.mean(axis=0), rtol=1e-12)
    error = each.std(axis=0, ddof=1) / math.sqrt(3)
    np.testing.assert_allclose(merged["albedo_standard_error"].values, error, rtol=1e-6, atol=1e-15)
    mc = np.sqrt(sum(m.dataset["albedo_standard_error_mc"].values ** 2 for m in specimens)) / 3
    np.testing.assert_allclose(merged["albedo_standard_error_mc"].values, mc, rtol=1e-9)
    assert (merged["degrees_of_freedom"] == 2).all()
    assert (merged["degrees_of_freedom_mc"] == 45).all()
    assert (specimens[0].dataset["brdf_standard_error"] == specimens[0].dataset["brdf_standard_error_mc"]).all()


def test_merging_refuses_another_instrument(specimens):
    with pytest.raises(ValueError, match="different goniometer cannot be merged"):
        specimens[0].merge(measured(9, paths=10_000))


def test_own_bins_are_the_measured_values(specimens):
    values = specimens[0].average(direction(30, 0), GRID)
    expected = specimens[0].dataset["brdf"].sel(order="all", theta_i=30, phi_i=0).values.reshape(-1, 2)
    np.testing.assert_array_equal(values, expected)


def test_values_at_bin_centres(specimens):
    isotropic = specimens[0].as_isotropic()
    table = isotropic.dataset["brdf"].sel(order="all", phi_i=0)
    centre = direction(35.0, 30.0 + 77.0)
    at_node = isotropic.eval(direction(30, 77), centre)
    np.testing.assert_allclose(at_node, table.sel(theta_i=30, theta_o=35, dphi=30).values, rtol=1e-9)
    assert (isotropic.eval(direction(30, 0), direction(100, 0)) == 0).all()


def test_a_coarser_detector_sees_averages_of_the_interpolated_lobe(specimens):
    coarse = HemisphereGrid(theta_step=15, phi_step=30)
    values = specimens[0].average(direction(30, 0), coarse)
    albedo = (values * coarse.projected_solid_angles()[:, None]).sum(axis=0)
    expected = specimens[0].albedo()["albedo"].sel(theta_i=30, phi_i=0).values
    np.testing.assert_allclose(albedo, expected, rtol=0.02)


def test_what_was_not_measured_is_refused(specimens):
    with pytest.raises(ValueError, match="theta_i = 75 lies outside the measured range 0 to 60 degrees"):
        specimens[0].as_isotropic().eval(direction(75, 0), direction(10, 0))
    with pytest.raises(ValueError, match="phi_i = 40 lies outside the measured range 0 to 0"):
        specimens[0].eval(direction(30, 40), direction(10, 0))
    apertures = measured(1, detector=Apertures(((20.0, 0.0), (20.0, 180.0)), 3.0))
    with pytest.raises(ValueError, match="between apertures or patches are not measured"):
        apertures.eval(direction(30, 0), direction(10, 0))


def test_apertures_and_grid_agree():
    """A round aperture sees the mean of a lobe that hardly changes across it."""
    scene = Scene(ms.Flat().build(0), optics.Lambertian(0.6))
    apertures = Apertures(((0.0, 0.0), (40.0, 100.0), (80.0, 200.0)), half_angle=8.0)
    data = Goniometer(theta_i=(20,), paths=400_000, detector=apertures, wavelengths=(550,)).measure(scene).dataset
    assert data["brdf"].dims == ("order", "theta_i", "phi_i", "detector", "wavelength")
    score = (data["brdf"] - 0.6 / math.pi) / data["brdf_standard_error"]
    assert (abs(score.sel(order="all")) < 5).all()
    np.testing.assert_allclose(data["albedo"].sel(order="all"), 0.6, rtol=1e-9)


# --- External measurements --------------------------------------------------------------------------------------------

HOLE = (np.arange(19) > 15)[:, None, None]


def made_outside(**options):
    known = {"title": "a table", "origin": "MERL file gold.binary", "isotropic": 1, "temperature": 23.5}
    return external(detector=GRID, theta_i=(0.0, 30.0, 60.0), wavelengths=(450.0, 650.0), attributes=known, **options)


@pytest.mark.parametrize(
    "options", [{}, {"noise": 0.1}, {"noise": 0.1, "unknown": HOLE}], ids=["exact", "errors", "holes"]
)
def test_a_file_gives_back_an_external_measurement(tmp_path, options):
    made = made_outside(**options)
    again = load(save(made, tmp_path / "table.nc"))
    assert again.sums is None
    assert again.dataset.identical(made.dataset)
    assert again.detector == GRID
    assert again.isotropic
    assert again.attributes["temperature"] == 23.5
    assert list(again.incidences()) == [(0.0, 0.0), (30.0, 0.0), (60.0, 0.0)]


def test_a_table_has_the_albedo_of_what_is_known():
    whole, part = made_outside(noise=0.1), made_outside(noise=0.1, unknown=HOLE)
    solid = np.where(HOLE[:, 0], 0.0, GRID.projected_solid_angles().reshape(GRID.shape))[..., None]
    for made, area in ((whole, GRID.projected_solid_angles().reshape(*GRID.shape, 1)), (part, solid)):
        brdf, error = (
            made.dataset[name].sel(order="all").fillna(0.0).values for name in ("brdf", "brdf_standard_error")
        )
        np.testing.assert_allclose(made.albedo()["albedo"], (brdf * area).sum(axis=(2, 3)), rtol=1e-12)
        expected = np.sqrt(((error * area) ** 2).sum(axis=(2, 3)))
        np.testing.assert_allclose(made.albedo()["albedo_standard_error"], expected, rtol=1e-12)
    assert made_outside().albedo()["albedo_standard_error"].isnull().all()


def test_an_incidence_of_which_nothing_is_known_was_not_measured():
    nothing = np.zeros((3, 1, 1, 1, 2), bool)
    nothing[1, ..., 0] = True
    nothing[2] = True
    made = made_outside(unknown=nothing)
    np.testing.assert_array_equal(made.measured, [[True], [True], [False]])
    assert list(made.incidences()) == [(0.0, 0.0), (30.0, 0.0)]
    assert made.dataset["albedo"].isnull().sum() == 3


def test_a_table_is_read_like_a_measurement():
    made = made_outside()
    np.testing.assert_array_equal(
        made.average(direction(30, 0), GRID), TRUTH.average(direction(30, 0), GRID, (450.0, 650.0))
    )
    centre = direction(35.0, 30.0 + 77.0)
    there = made.dataset["brdf"].sel(order="all", phi_i=0, theta_i=30, theta_o=35, dphi=30)
    np.testing.assert_allclose(made.eval(direction(30, 77), centre), there, rtol=1e-9)
    assert np.isnan(made_outside(unknown=HOLE).eval(direction(30, 77), direction(85.0, 107.0))).all()


def test_what_is_known_of_a_external_specimen():
    made = made_outside()
    assert made.material is None
    assert made.surface is None
    assert made.facets is None
    assert made.surface_statistics == {}
    told = external(attributes={"material": '{"kind": "Conductor", "name": "Au"}', "surface_statistics": '{"Sq": 1.0}'})
    assert told.material == optics.Conductor("Au")
    assert told.surface_statistics == {"Sq": 1.0}
    assert external(attributes={"material": "brushed steel"}).material is None


def test_what_nobody_counted_is_refused_in_a_sentence(specimens):
    made = made_outside()
    for one, other in ((made, made), (made, specimens[0]), (specimens[0], made)):
        with pytest.raises(ValueError, match="comes from another program's file, without the sums"):
            one.merge(other)
    with pytest.raises(ValueError, match="keeps no energy budget"):
        made.energy_budget()


def test_channels_have_names():
    assert made_outside().channels == ("450 nm", "650 nm")
    for basis, names in (("RGB", ("R", "G", "B")), ("XYZ", ("X", "Y", "Z"))):
        assert external(wavelengths=(600.0, 550.0, 450.0), attributes={"basis": basis}).channels == names
    assert external(attributes={"basis": "Y"}).channels == ("Y",)
    assert external(attributes={"basis": "spectrum"}).channels == ("550 nm",)
    assert external(attributes={"basis": "RGB"}).channels == ("550 nm",)


@pytest.mark.parametrize("damage", ["brdf", "brdf_standard_error", "theta_o", "detector"])
def test_a_damaged_table_is_refused_in_a_sentence(tmp_path, damage):
    made = made_outside()
    if damage == "detector":
        data = made.dataset.assign_attrs(detector='{"kind": "HemisphereGrid", "theta_step": 10, "phi_step": 15}')
    else:
        data = made.dataset.isel(theta_o=slice(1)) if damage == "theta_o" else made.dataset.drop_vars(damage)
    data.to_netcdf(tmp_path / "table.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match=r"table\.nc: not a measurement that gonio wrote, or it is damaged"):
        load(tmp_path / "table.nc")


def test_a_table_needs_as_many_values_as_its_detector_has_bins():
    with pytest.raises(ValueError, match="could not be broadcast"):
        tabulated(np.zeros((1, 1, 3, 4, 1)), GRID, 0.0, 0.0, 550.0)
