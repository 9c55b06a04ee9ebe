"""Zemax files: whoever follows the description finds the BRDF about the specular direction."""

import dataclasses
import math

import numpy as np
import pytest
from closed_forms import WAVELENGTHS, directions, lambertian, measured
from readers.zemax import SMALL, Zemax

from gonio.brdf import BRDF
from gonio.detectors import HemisphereGrid
from gonio.formats import zemax
from gonio.sphere import angles, direction, rotate_z


def shiny(turn=30.0, turning=0.0, theta_i=(0.0, 20.0, 40.0, 60.0, 80.0), wavelengths=(550.0,)):
    """A lobe about the specular direction turned by `turn`, whose strength depends on phi_i if `turning`."""
    gains = np.array(wavelengths) / 550

    def evaluate(wi, wo):
        _, phi = angles(wi)
        axis = rotate_z(wi * [-1, -1, 1], turn)
        near = np.maximum((axis * wo).sum(axis=-1), 0.0)
        return (0.1 + near**20 * (1 + turning * np.sin(np.radians(phi - 20))))[:, None] * gains

    phi_i = np.arange(0, 360, 30.0) if turning else np.zeros(1)
    return BRDF(
        evaluate,
        np.array(wavelengths),
        np.array(theta_i),
        phi_i,
        isotropic=not turning,
        detector=HemisphereGrid(theta_step=3.0, phi_step=6.0),
        attributes={"title": "shiny"},
    )


@pytest.mark.parametrize(
    ("brdf", "symmetry"),
    [
        (shiny(turn=0.0), "PlaneSymmetrical"),
        (shiny(), "Asymmetrical"),
        (shiny(turning=0.5, theta_i=(20.0, 50.0)), "Asymmetrical4D"),
    ],
)
def test_zemax_files_hold_the_lobe_about_the_mirror_direction(brdf, symmetry, tmp_path):
    path = tmp_path / "lobe.bsdf"
    zemax.write(brdf, path)
    file, back = Zemax(path), zemax.read(path)
    assert file.word == {
        "Source": "Measured",
        "Symmetry": symmetry,
        "SpectralContent": "Monochrome",
        "ScatterType": "BRDF",
    }
    random = np.random.default_rng(1)
    checked = 0
    for _ in range(200):
        p, i, a, r = (int(random.integers(len(axis))) for axis in file.axes)
        phi_i, theta_i, azimuth, radial = (file.axes[k][n] for k, n in enumerate((p, i, a, r)))
        wo = from_specular(theta_i, phi_i, azimuth, radial)
        if wo[2] <= 0.01:
            continue
        found = file.channels["Monochrome"][p * len(file.axes[1]) + i][a][r]
        expected = brdf.evaluate(direction([theta_i], phi_i), wo[None])[0, 0]
        assert found == pytest.approx(expected, rel=1e-6)
        checked += 1
    assert checked > 80
    # Our evaluation is that of whoever follows the description.
    theta_i, phi_i, theta_o, phi_o = directions(60, most=89)
    wo = direction(theta_o, phi_o)
    values = back.evaluate(direction(theta_i, phi_i), wo)[:, 0]
    ours = [file.value(*a, "Monochrome") for a in zip(theta_i, phi_i, theta_o, phi_o, strict=True)]
    np.testing.assert_allclose(values, ours, rtol=1e-9)


def from_specular(theta_i, phi_i, azimuth, radial):
    """The direction at these angles about the specular direction of light from theta_i, phi_i."""
    a, r, p, turn = (math.radians(x) for x in (azimuth, radial, theta_i, phi_i))
    x, y, z = math.sin(r) * math.cos(a), math.sin(r) * math.sin(a), math.cos(r)
    x, z = math.cos(p) * x - math.sin(p) * z, math.sin(p) * x + math.cos(p) * z
    return np.array([math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y, z])


@pytest.mark.parametrize("brdf", [shiny(), shiny(turn=0.0), shiny(turning=0.5, theta_i=(20.0, 40.0, 60.0))])
def test_between_its_nodes_a_zemax_file_is_close(brdf, tmp_path):
    path = tmp_path / "lobe.bsdf"
    zemax.write(brdf, path)
    _, phi_i, theta_o, phi_o = directions(4000, most=88)
    theta_i = np.random.default_rng(2).choice([20.0, 40.0, 60.0], 4000)
    wi, wo = direction(theta_i, phi_i), direction(theta_o, phi_o)
    error = np.abs(zemax.read(path).evaluate(wi, wo) / brdf.evaluate(wi, wo) - 1)
    assert np.sqrt(np.mean(error**2)) < (0.03 if brdf.isotropic else 0.05)


def test_the_tis_is_the_albedo(coarse, tmp_path):
    path = tmp_path / "lobe.bsdf"
    zemax.write(lambertian(0.7), path)
    tis = Zemax(path).tis["Monochrome"]
    np.testing.assert_allclose(tis, 0.7, rtol=1e-5)
    brdf = shiny(turn=0.0, theta_i=(0.0, 30.0))
    zemax.write(brdf, path)
    # 0.1 π + 2π ∫ cos^20 θ cos θ sin θ dθ at normal incidence.
    assert Zemax(path).tis["Monochrome"][0] == pytest.approx(0.1 * math.pi + 2 * math.pi / 22, rel=1e-3)


@pytest.fixture
def coarse(monkeypatch):
    """Zemax tables that are written in no time."""
    monkeypatch.setattr(zemax, "STEPS", {True: (20.0, 6.0), False: (20.0, 10.0)})


def test_zemax_colours_and_wavelengths(coarse, tmp_path):
    path = tmp_path / "lobe.bsdf"
    zemax.write(shiny(wavelengths=(632.8,)), path)
    back = zemax.read(path)
    assert (back.basis, back.wavelengths.tolist(), back.title) == ("spectrum", [632.8], "shiny")
    brdf = shiny(wavelengths=WAVELENGTHS)
    assert "CIE Y" in " ".join(zemax.write(brdf, path))
    assert zemax.read(path).basis == "Y"
    zemax.write(brdf, path, colour=True)
    back = zemax.read(path)
    assert (back.basis, list(Zemax(path).channels)) == ("XYZ", ["TristimulusX", "TristimulusY", "TristimulusZ"])
    _, phi_i, theta_o, phi_o = directions(1000)
    wi, wo = direction(np.full(1000, 40.0), phi_i), direction(theta_o, phi_o)
    np.testing.assert_allclose(back.evaluate(wi, wo), brdf.in_basis("XYZ").evaluate(wi, wo), rtol=0.03)


def test_only_what_exceeds_the_noise_makes_a_lobe_asymmetrical(coarse, tmp_path):
    path = tmp_path / "lobe.bsdf"
    clean = shiny(turn=0.0, theta_i=(0.0, 45.0)).measured()
    data = clean.dataset.copy(deep=True)
    noise = np.random.default_rng(0).standard_normal(data["brdf"].shape)
    data["brdf"] = data["brdf"] * (1 + 0.3 * noise)
    for known, symmetry in ((0.3, "PlaneSymmetrical"), (np.nan, "Asymmetrical")):
        data["brdf_standard_error"] = data["brdf"] * known
        notes = zemax.write(BRDF.of(dataclasses.replace(clean, external=data)), path)
        assert Zemax(path).word["Symmetry"] == symmetry
        assert "% of the energy" in " ".join(notes)


def test_one_azimuth_of_an_anisotropic_specimen_makes_no_zemax_file(tmp_path):
    with pytest.raises(ValueError, match="one azimuth of the light"):
        zemax.write(BRDF.of(measured(turning=0.1)), tmp_path / "lobe.bsdf")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("ScatterType BRDF", "ScatterType BTDF", "holds a BTDF"),
        ("AngleOfIncidence 2", "AngleOfIncidence 2000000000", "announces 2000000000 angles"),
        ("0 180 360", "0 180 170", "must increase"),
        ("SpectralContent Monochrome", "SpectralContent XYZ", "does not go with its 1 blocks"),
        ("5 6\n", "5 6 7\n", r"holds 14 values, expected 1 x 2 x 3 x 2"),
        ("1 2\n", "1 x\n", "not a number"),
        ("1 2\n", "1 1e99\n", "beyond"),
        ("ScatterRadial", "Radial", "there is no ScatterRadial"),
    ],
)
def test_what_is_wrong_with_a_zemax_file_is_said(old, new, complaint, tmp_path):
    path = tmp_path / "wrong.bsdf"
    path.write_text(SMALL.replace(old, new))
    with pytest.raises(ValueError, match=complaint):
        zemax.read(path)
