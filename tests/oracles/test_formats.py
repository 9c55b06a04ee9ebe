"""Foreign files: what another program reads is what was measured, the right way round, and loads again."""

import contextlib
import json

import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gonio
from gonio.brdf import BRDF
from gonio.detectors import HemisphereGrid
from gonio.formats import FORMATS, exr, loss
from gonio.measurement import tabulated
from gonio.sphere import angles, direction, reflect, rotate_z
from microsurfaces.atomic_write import atomic_write

THETA_I, PHI_I, WAVELENGTHS = [10.0, 30.25], [0.0, 250.0], [450.0, 632.8]
GRID = HemisphereGrid(theta_step=10.0, phi_step=15.0)


def chiral(wi_theta, wi_phi, theta, dphi, nm):
    """A value that tells every angle, and left from right, from every other."""
    turned = np.radians(dphi - 180 - 30)
    return nm / 1000 + np.radians(theta) * (1 + 0.5 * np.cos(turned)) + wi_theta / 100 + wi_phi / 1000


def table():
    return chiral(*np.meshgrid(THETA_I, PHI_I, GRID.theta, GRID.dphi, WAVELENGTHS, indexing="ij"))


def made(values, **attributes):
    about = {"seed": 2**40, "title": "chiral", "experiment": '{"seed": 1099511627776}', **attributes}
    return tabulated(values, GRID, THETA_I, PHI_I, WAVELENGTHS, standard_error=0.01 * values, attributes=about)


@pytest.fixture
def measurement():
    return made(table())


def parts_of(path):
    return {part.name(): part for part in OpenEXR.File(str(path), separate_channels=True).parts}


def test_exr_holds_every_measured_incidence_and_its_errors(measurement, tmp_path):
    parts = parts_of(gonio.export(measurement, tmp_path / "lobe.exr").path)
    names = ["theta_i010.0_phi_i000.0", "theta_i010.0_phi_i250.0", "theta_i30.25_phi_i000.0", "theta_i30.25_phi_i250.0"]
    assert list(parts) == [name + suffix for name in names for suffix in ("", "_standard_error")]
    for part in parts.values():
        assert set(part.channels) == {"T.450nm", "T.632,8nm"}
        assert part.header["spectralLayoutVersion"] == "1.0"


def test_exr_is_the_right_way_round(measurement, tmp_path):
    parts = parts_of(gonio.export(measurement, tmp_path / "lobe.exr").path)
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
    parts = parts_of(gonio.export(measurement, tmp_path / "lobe.exr").path)
    about = json.loads(parts["theta_i010.0_phi_i250.0"].header["gonio.json"])
    assert about["provenance"]["seed"] == str(2**40)
    assert json.loads(about["provenance"]["experiment"])["seed"] == 2**40
    assert about["units"] == "sr-1"
    bounds = np.array(about["dphi_bounds"])
    np.testing.assert_allclose(bounds.mean(axis=1), about["dphi"])
    np.testing.assert_allclose(np.diff(bounds), 15.0)
    # One number a row, for 24 columns: together the projected hemisphere.
    assert 24 * sum(about["projected_solid_angle"]) == pytest.approx(np.pi, rel=1e-14)
    assert "180 the specular side" in parts["theta_i010.0_phi_i250.0"].header["comments"]


def test_exr_loads_as_it_was(measurement, tmp_path):
    exported = gonio.export(measurement, tmp_path / "lobe.exr")
    again = gonio.load(exported.path)
    for name in ("brdf", "brdf_standard_error", "albedo"):
        np.testing.assert_allclose(again.dataset[name], measurement.dataset[name], rtol=1e-7)
    assert again.attributes["title"] == "chiral"
    assert not again.isotropic
    assert exported.loss.log_rms < 1e-7


def test_exr_in_colour(tmp_path):
    """Of a grey surface all channels are grey; of one that reflects at 633 nm alone, red is the brightest."""
    grey = np.broadcast_to(table()[..., :1], table().shape)
    parts = parts_of(gonio.export(made(grey), tmp_path / "grey.exr", "exr-rgb").path)
    channels = parts["theta_i010.0_phi_i250.0"].channels
    assert sorted(channels) == ["B", "G", "R"]
    for name in "RGB":
        np.testing.assert_allclose(channels[name].pixels, np.roll(grey[0, 1, :, :, 0], 12, axis=1), rtol=2e-7)
    red = parts_of(gonio.export(made(table() * [0.0, 1.0]), tmp_path / "red.exr", "exr-rgb").path)
    channels = red["theta_i010.0_phi_i000.0"].channels
    assert (channels["R"].pixels > 2 * channels["B"].pixels).all()
    again = gonio.load(tmp_path / "red.exr")
    assert (again.attributes["basis"], again.dataset.sizes["wavelength"]) == ("RGB", 3)


def lobe(wi, wo):
    """A soft lobe about the specular direction turned by 30 degrees: chiral, and brighter for light from phi = 40."""
    aim = rotate_z(reflect(wi, [0.0, 0.0, 1.0]), 30.0)
    return (np.exp(6 * ((aim * wo).sum(axis=-1) - 1)) * (1.2 + np.cos(np.radians(angles(wi)[1] - 40))))[:, None]


def test_exr_discs_are_pictures_from_above(tmp_path):
    source = BRDF(lobe, np.array([550.0]), np.array([50.0]), np.array([20.0]), isotropic=False)
    exported = gonio.export(source, tmp_path / "disc.exr", "exr-disc")
    channels = parts_of(exported.path)["theta_i050.0_phi_i020.0"].channels
    green, alpha = channels["G"].pixels, channels["A"].pixels
    row, column = np.unravel_index(green.argmax(), green.shape)
    across = np.sqrt(2) * np.sin(np.radians(25)) * np.array([-np.sin(np.radians(230)), np.cos(np.radians(230))])
    np.testing.assert_allclose([row, column], 179.5 + 180 * across, atol=1.5)
    assert alpha.mean() == pytest.approx(np.pi / 4, rel=1e-3)
    assert green[alpha == 0].max() == 0
    # Equal areas: the mean over the disc is the mean over solid angle.
    theta, phi = np.meshgrid((np.arange(300) + 0.5) * 0.3, np.arange(720) * 0.5, indexing="ij")
    values = lobe(direction(50, 20), direction(theta, phi).reshape(-1, 3))[:, 0]
    solid = np.sin(np.radians(theta)).ravel()
    assert green.sum() / alpha.sum() == pytest.approx((values * solid).sum() / solid.sum(), rel=1e-3)
    assert exported.loss.log_rms < 0.02


def test_incomplete_measurements_export_what_they_know(tmp_path):
    values = table()
    values[1, 1] = np.nan
    exported = gonio.export(made(values), tmp_path / "lobe.exr")
    assert gonio.load(exported.path).dataset["theta_i"].values.tolist() == [10.0]
    assert exported.notes[0].startswith("2 incidences are left out")
    with pytest.raises(ValueError, match="nothing to export"):
        gonio.export(made(np.full_like(values, np.nan)), tmp_path / "nothing.exr")
    assert len(list(tmp_path.iterdir())) == 1


def test_one_azimuth_of_a_grooved_specimen_is_no_function(measurement):
    known = {"surface_statistics": json.dumps({"rms_slope_x": 0.3, "rms_slope_y": 0.1})}
    one = tabulated(table()[:, :1], GRID, THETA_I, [0.0], WAVELENGTHS, attributes=known)
    wi = direction([20.0], [0.0])
    with pytest.raises(ValueError, match="--isotropic"):
        BRDF.of(one).evaluate(wi, wi)
    assert BRDF.of(one.as_isotropic()).evaluate(wi, wi).shape == (1, 2)
    known["surface_statistics"] = json.dumps({"rms_slope_x": 0.3, "rms_slope_y": 0.29})
    even = tabulated(table()[:, :1], GRID, THETA_I, [0.0], WAVELENGTHS, attributes=known)
    assert BRDF.of(even).isotropic


def test_the_loss_is_what_was_lost(measurement):
    source = BRDF.of(measurement)
    brighter = BRDF.of(made(1.1 * table()))
    cost = loss.Loss.between(source, brighter)
    assert (cost.albedo, cost.log_rms, cost.largest) == pytest.approx((0.1, np.log(1.1), 0.1))
    assert cost.noise == pytest.approx(0.01)
    one = table()
    one[1, 0, 3, 5, 1] *= 2
    cost = loss.Loss.between(source, BRDF.of(made(one)))
    assert cost.largest == pytest.approx(1.0)
    assert cost.where == (30.25, 0.0, GRID.theta[3], GRID.dphi[5])
    one[1, 0, 3, 5, 1] = np.nan
    cost = loss.Loss.between(source, BRDF.of(made(one)))
    assert (cost.unknown, cost.log_rms) == (1, 0.0)
    assert "knows nothing" in cost.sentence()


@pytest.mark.parametrize(
    ("wavelength", "name"), [(550.0, "T.550nm"), (632.8, "T.632,8nm"), (1e5, "T.100000nm"), (0.1, "T.0,1nm")]
)
def test_channel_names(wavelength, name):
    assert exr.channel_name(wavelength) == name


def test_the_suffix_or_the_format_decides(measurement, tmp_path):
    assert gonio.export(measurement, tmp_path / "a.EXR").path.exists()
    assert parts_of(gonio.export(measurement, str(tmp_path / "b.data"), format="exr").path)
    assert gonio.load(tmp_path / "b.data", format="exr").dataset.sizes["theta_i"] == 2
    for arguments in ((tmp_path / "a.xyz",), (tmp_path / "a",), (tmp_path / "a.exr", "exrr")):
        with pytest.raises(ValueError, match=r"the formats are .*\.exr"):
            gonio.export(measurement, *arguments)
    with pytest.raises(ValueError, match="there is no such file"):
        gonio.load(tmp_path / "missing.exr")


def test_formats_that_share_a_suffix_are_told_apart(measurement, tmp_path):
    """.bsdf is RGL's and Zemax's."""
    one = measurement.as_isotropic()
    for name, origin in (("rgl", "RGL"), ("zemax", "Zemax")):
        path = gonio.export(one, tmp_path / f"{name}.bsdf", name).path
        assert gonio.load(path).attributes["origin"].startswith(origin)
    (tmp_path / "none.bsdf").write_text("neither")
    with pytest.raises(ValueError, match=r"tensor file.*none\.bsdf"):
        gonio.load(tmp_path / "none.bsdf")


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_has_a_page(name):
    assert len(FORMATS[name].page) > 300
    assert FORMATS[name].suffix.startswith(".")


VALID = None


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_damaged_exr_files_are_one_sentence(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp()
    global VALID
    if VALID is None:
        VALID = gonio.export(made(table()), folder / "valid.exr").path.read_bytes()
    content = bytearray(VALID)
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = folder / "damaged.exr"
    path.write_bytes(bytes(content[: data.draw(st.integers(0, len(content)))]))
    with contextlib.suppress(ValueError):
        gonio.load(path)


def test_files_appear_whole_or_not_at_all(tmp_path):
    path = tmp_path / "result.exr"
    path.write_text("old")

    def fail():
        with atomic_write(path) as temporary:
            assert temporary.suffix == ".exr"
            temporary.write_text("half of the n")
            raise RuntimeError("the disc is full")

    with pytest.raises(RuntimeError):
        fail()
    assert [p.read_text() for p in tmp_path.iterdir()] == ["old"]
    with atomic_write(path) as temporary:
        temporary.write_text("new")
    assert [p.read_text() for p in tmp_path.iterdir()] == ["new"]


def test_an_unwritable_folder_is_an_os_error(measurement, tmp_path):
    with pytest.raises(OSError, match="lobe"):
        gonio.export(measurement, tmp_path / "missing" / "lobe.exr")
