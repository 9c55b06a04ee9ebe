"""The result: its labels, its file, merging, and reading values between what was measured."""

import math
import os
import stat

import numpy as np
import pytest
import xarray as xr

import microsurfaces as ms
from gonio import optics
from gonio.detectors import Apertures, HemisphereGrid
from gonio.goniometer import Goniometer
from gonio.measurement import load, save
from gonio.scene import Scene
from gonio.sphere import direction

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
    ledger = specimens[0].ledger()
    np.testing.assert_allclose(sum(ledger[name] for name in ledger), 1.0, rtol=1e-15)


def test_a_file_gives_back_the_measurement(tmp_path, specimens):
    path = save(specimens[0], tmp_path / "cu.nc")
    again = load(path)
    assert again.dataset.identical(specimens[0].dataset)
    assert again.sums.identical(specimens[0].sums)
    assert [p.name for p in tmp_path.iterdir()] == ["cu.nc"]
    with xr.open_dataset(path, engine="h5netcdf") as foreign:
        np.testing.assert_array_equal(foreign["brdf"].values, specimens[0].dataset["brdf"].values)
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask


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
    assert (specimens[0].dataset["standard_error"] == specimens[0].dataset["standard_error_mc"]).all()


def test_merging_refuses_another_instrument(specimens):
    with pytest.raises(ValueError, match="different goniometer cannot be merged"):
        specimens[0].merge(measured(9, paths=10_000))


def test_own_bins_are_the_measured_values(specimens):
    values = specimens[0].average(direction(30, 0), GRID)
    expected = specimens[0].dataset["brdf"].sel(order="all", theta_i=30, phi_i=0).values.reshape(-1, 2)
    np.testing.assert_array_equal(values, expected)


def test_values_at_bin_centres_and_in_between(specimens):
    isotropic = specimens[0].declared_isotropic()
    table = isotropic.dataset["brdf"].sel(order="all", phi_i=0)
    centre = direction(35.0, 30.0 + 77.0)
    at_node = isotropic.eval(direction(30, 77), centre)
    np.testing.assert_allclose(at_node, table.sel(theta_i=30, theta_o=35, dphi=30).values, rtol=1e-9)
    # The mirror direction stays the mirror direction: at 45 degrees it mixes those of 30 and 60.
    between = isotropic.eval(direction(45, 0), direction(45, 180))
    mean = (table.sel(theta_i=30, theta_o=30, dphi=180) + table.sel(theta_i=60, theta_o=60, dphi=180)) / 2
    np.testing.assert_allclose(between, mean.values, rtol=1e-9)
    assert (isotropic.eval(direction(30, 0), direction(100, 0)) == 0).all()


def test_a_coarser_detector_sees_averages_of_the_interpolated_lobe(specimens):
    coarse = HemisphereGrid(theta_step=15, phi_step=30)
    values = specimens[0].average(direction(30, 0), coarse)
    albedo = (values * coarse.projected_solid_angles()[:, None]).sum(axis=0)
    expected = specimens[0].albedo()["albedo"].sel(theta_i=30, phi_i=0).values
    np.testing.assert_allclose(albedo, expected, rtol=0.02)


def test_what_was_not_measured_is_refused(specimens):
    with pytest.raises(ValueError, match="theta_i = 75 lies outside the measured range 0 to 60 degrees"):
        specimens[0].declared_isotropic().eval(direction(75, 0), direction(10, 0))
    with pytest.raises(ValueError, match="phi_i = 40 lies outside the measured range 0 to 0"):
        specimens[0].eval(direction(30, 40), direction(10, 0))
    apertures = measured(1, detector=Apertures(((20.0, 0.0), (20.0, 180.0)), 3.0))
    with pytest.raises(ValueError, match="between apertures are not measured"):
        apertures.eval(direction(30, 0), direction(10, 0))


def test_apertures_and_grid_agree():
    """A round aperture sees the mean of a lobe that hardly changes across it."""
    scene = Scene(ms.Flat().build(0), optics.Lambertian(0.6))
    apertures = Apertures(((0.0, 0.0), (40.0, 100.0), (80.0, 200.0)), half_angle=8.0)
    data = Goniometer(theta_i=(20,), paths=400_000, detector=apertures, wavelengths=(550,)).measure(scene).dataset
    assert data["brdf"].dims == ("order", "theta_i", "phi_i", "detector", "wavelength")
    score = (data["brdf"] - 0.6 / math.pi) / data["standard_error"]
    assert (abs(score.sel(order="all")) < 5).all()
    np.testing.assert_allclose(data["albedo"].sel(order="all"), 0.6, rtol=1e-9)
