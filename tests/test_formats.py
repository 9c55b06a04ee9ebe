"""Export: what another program reads is what was measured, the right way round."""

import json
from types import SimpleNamespace

import numpy as np
import OpenEXR
import pytest
import xarray as xr

import gonio
from gonio.detectors import HemisphereGrid
from gonio.formats import WRITERS, exr
from microsurfaces.files import replacing

THETA_I, PHI_I, WAVELENGTHS = [10.0, 30.25], [0.0, 250.0], [450.0, 632.8]


def chiral(wi_theta, wi_phi, theta, dphi, nm):
    """A value that tells every angle, and left from right, from every other."""
    turned = np.radians(dphi - 180 - 30)
    return nm / 1000 + np.radians(theta) * (1 + 0.5 * np.cos(turned)) + wi_theta / 100 + wi_phi / 1000


@pytest.fixture
def measurement():
    grid = HemisphereGrid(theta_step=10.0, phi_step=15.0)
    axes = np.meshgrid([0, 1], THETA_I, PHI_I, grid.theta, grid.dphi, WAVELENGTHS, indexing="ij")
    brdf = chiral(*axes[1:])
    dims = ("order", "theta_i", "phi_i", "theta_o", "dphi", "wavelength")
    paths = np.array([[1000, 2**40], [1000, 0]])
    edges = {"theta_o": grid.theta_edges, "dphi": grid.dphi_edges}
    dataset = xr.Dataset(
        {
            "brdf": (dims, np.where(axes[0] == 0, brdf, 0.0)),
            "standard_error": (dims, 0.01 * brdf),
            "projected_solid_angle": (dims[3:5], grid.projected_solid_angles().reshape(grid.shape)),
            "paths": (dims[1:3], paths),
            "realisations": (dims[1:3], np.full((2, 2), 4)),
            **{f"{n}_bounds": ((n, "bounds"), np.stack([e[:-1], e[1:]], axis=1)) for n, e in edges.items()},
        },
        coords={
            "order": ["all", "1"],
            "theta_i": THETA_I,
            "phi_i": PHI_I,
            "theta_o": grid.theta,
            "dphi": grid.dphi,
            "wavelength": WAVELENGTHS,
        },
        attrs={"seed": 2**40, "title": "chiral", "experiment": '{"seed": 1099511627776}'},
    )
    return SimpleNamespace(dataset=dataset, detector=grid, wavelengths=np.array(WAVELENGTHS))


def parts_of(path):
    return {part.name(): part for part in OpenEXR.File(str(path), separate_channels=True).parts}


def test_exr_holds_every_measured_incidence_and_its_errors(measurement, tmp_path):
    parts = parts_of(gonio.export(measurement, tmp_path / "lobe.exr"))
    names = ["theta_i010.0_phi_i000.0", "theta_i010.0_phi_i250.0", "theta_i30.25_phi_i000.0"]
    assert list(parts) == [name + suffix for name in names for suffix in ("", "_standard_error")]
    for part in parts.values():
        assert set(part.channels) == {"T.450nm", "T.632,8nm"}
        assert part.header["spectralLayoutVersion"] == "1.0"


def test_exr_is_the_right_way_round(measurement, tmp_path):
    parts = parts_of(gonio.export(measurement, tmp_path / "lobe.exr"))
    for (theta_i, phi_i), name in {
        (10.0, 250.0): "theta_i010.0_phi_i250.0",
        (30.25, 0.0): "theta_i30.25_phi_i000.0",
    }.items():
        about = json.loads(parts[name].header["gonio.json"])
        assert (about["theta_i"], about["phi_i"]) == (theta_i, phi_i)
        assert about["dphi"] == list(range(-180, 180, 15))
        for nm, channel in zip(WAVELENGTHS, ("T.450nm", "T.632,8nm"), strict=True):
            expected = chiral(theta_i, phi_i, *np.meshgrid(about["theta_o"], about["dphi"], indexing="ij"), nm)
            found = parts[name].channels[channel].pixels
            np.testing.assert_array_equal(found, expected.astype(np.float32))
            errors = parts[name + "_standard_error"].channels[channel].pixels
            np.testing.assert_allclose(errors, 0.01 * expected, rtol=2e-7)


def test_exr_tells_its_grid_and_where_it_came_from(measurement, tmp_path):
    parts = parts_of(gonio.export(measurement, tmp_path / "lobe.exr"))
    about = json.loads(parts["theta_i010.0_phi_i250.0"].header["gonio.json"])
    assert about["provenance"]["seed"] == str(2**40)
    assert json.loads(about["provenance"]["experiment"])["seed"] == 2**40
    assert about["paths"] == str(2**40)
    assert about["units"] == "sr-1"
    bounds = np.array(about["dphi_bounds"])
    np.testing.assert_allclose(bounds.mean(axis=1), about["dphi"])
    np.testing.assert_allclose(np.diff(bounds), 15.0)
    # One number a row, for 24 columns: together the projected hemisphere.
    assert 24 * sum(about["projected_solid_angle"]) == pytest.approx(np.pi, rel=1e-14)
    assert "180 the mirror's" in parts["theta_i010.0_phi_i250.0"].header["comments"]


def test_exr_says_what_it_cannot_hold(measurement, tmp_path):
    measurement.dataset["paths"][:] = 0
    with pytest.raises(ValueError, match="nothing to export"):
        gonio.export(measurement, tmp_path / "lobe.exr")
    measurement.dataset = measurement.dataset.isel(dphi=0)
    with pytest.raises(ValueError, match="Apertures"):
        gonio.export(measurement, tmp_path / "lobe.exr")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("wavelength", "name"), [(550.0, "T.550nm"), (632.8, "T.632,8nm"), (1e5, "T.100000nm"), (0.1, "T.0,1nm")]
)
def test_channel_names(wavelength, name):
    assert exr.channel_name(wavelength) == name


def test_the_suffix_or_the_format_decides(measurement, tmp_path):
    assert gonio.export(measurement, tmp_path / "a.EXR").exists()
    assert parts_of(gonio.export(measurement, str(tmp_path / "b.data"), format="exr"))
    for arguments in ((tmp_path / "a.xyz",), (tmp_path / "a",), (tmp_path / "a.exr", "merl")):
        with pytest.raises(ValueError, match=r"the formats are .*\.exr"):
            gonio.export(measurement, *arguments)
    assert set(WRITERS) == {".exr"}


def test_files_appear_whole_or_not_at_all(tmp_path):
    path = tmp_path / "result.exr"
    path.write_text("old")

    def fail():
        with replacing(path) as temporary:
            assert temporary.suffix == ".exr"
            temporary.write_text("half of the n")
            raise RuntimeError("the disc is full")

    with pytest.raises(RuntimeError):
        fail()
    assert [p.read_text() for p in tmp_path.iterdir()] == ["old"]
    with replacing(path) as temporary:
        temporary.write_text("new")
    assert [p.read_text() for p in tmp_path.iterdir()] == ["new"]


def test_an_unwritable_folder_is_an_os_error(measurement, tmp_path):
    with pytest.raises(OSError, match="lobe"):
        gonio.export(measurement, tmp_path / "missing" / "lobe.exr")
