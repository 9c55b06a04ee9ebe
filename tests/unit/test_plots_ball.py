"""Spheres and plates: the same light for all, told; what is measured looks as its model does."""

import numpy as np
import pytest
from PIL import Image

from gonio import appearance, plots
from gonio.detectors import HemisphereGrid
from gonio.models import Beckmann, Lambert, Microfacet, SmithCorrelated
from gonio.optics import Conductor

GOLD = Microfacet(distribution=Beckmann(0.3), masking=SmithCorrelated(), material=Conductor("Au"))
SIZE = 90


@pytest.fixture(scope="module")
def measurement():
    return appearance.coloured(GOLD).sampled(np.arange(0.0, 86.0, 5.0), 0.0, HemisphereGrid(2.0, 3.0))


def pictures(figure):
    """(sphere, plate) RGBA of every column."""
    shown = [panel.images[0].get_array() for panel in figure.axes]
    count = len(shown) // 2
    return list(zip(shown[:count], shown[count:], strict=True))


def test_a_measurement_and_its_model_look_alike_and_a_diffuser_does_not(measurement, tmp_path):
    path = tmp_path / "sphere.png"
    figure = plots.sphere(measurement, path, models=(GOLD, Lambert(reflectance=0.5)), size=SIZE)
    assert [p.name for p in tmp_path.iterdir()] == ["sphere.png"]
    assert [panel.get_title() for panel in figure.axes[:3]] == [
        "measured, all orders",
        "Microfacet, 1 hit",
        "Lambert, 1 hit",
    ]
    (ours, our_plate), (gold, gold_plate), (white, white_plate) = (
        [picture.astype(float)[..., :3] for picture in column] for column in pictures(figure)
    )
    assert np.abs(ours - gold).mean() < 3
    assert np.abs(our_plate - gold_plate).mean() < 5
    assert np.abs(ours - white).mean() > 15
    assert np.abs(our_plate - white_plate).mean() > 20
    # On paper: white corners, gold in the middle of the first sphere, which is in the left third.
    with Image.open(path) as picture:
        drawn = np.asarray(picture.convert("RGB")).astype(int)
    assert drawn.shape[1] > drawn.shape[0] > 800
    assert (drawn[:20, :20] == 255).all()
    middle = drawn[int(0.4 * drawn.shape[0]), drawn.shape[1] // 6]
    assert middle[0] > middle[1] > middle[2] + 20


def test_the_rim_is_smooth_and_the_spheres_share_one_exposure(measurement):
    models = (Lambert(reflectance=0.2), Lambert(reflectance=0.8))
    _, (dim, _), (bright, _) = pictures(plots.sphere(measurement, models=models, size=SIZE))
    alpha = dim[..., 3] / 255
    assert alpha.mean() == pytest.approx(np.pi / 4, abs=0.003)
    assert ((alpha > 0.1) & (alpha < 0.9)).sum() > SIZE
    # One exposure: a quarter of the light everywhere, decoded from the screen.
    shown = [np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4) for x in (dim / 255, bright / 255)]
    clear = (alpha == 1) & (bright[..., :3].max(axis=-1) < 250)
    np.testing.assert_allclose(shown[0][clear][:, :3] * 4, shown[1][clear][:, :3], rtol=0.06)


def test_the_light_the_exposure_and_the_noise_are_told(measurement):
    data = measurement.dataset["brdf"].sel(order="all").values
    noisy = appearance.tabulated(
        data,
        measurement.detector,
        measurement.dataset["theta_i"].values,
        0.0,
        measurement.dataset["wavelength"].values,
        0.3 * data,
        {**measurement.attributes, "title": "gold & $"},
    )
    figure = plots.sphere(noisy, size=SIZE)
    told = figure.get_supxlabel().replace("\n", " ")
    smooth, radius = appearance.softened(noisy)
    white = appearance.exposure(appearance.sphere(smooth, SIZE))
    for words in ("a source of irradiance 2 from the upper left", "a clear sky", f"White is radiance {white:.2g}"):
        assert words in told
    head = figure.get_suptitle().replace("\n", " ")
    assert "gold & \\$" in head
    assert f"averaged within {radius:g}°" in head
    assert "averaged" not in plots.sphere(measurement, size=SIZE).get_suptitle()


def test_models_without_values_and_too_many_models_are_told(measurement):
    class Delta:
        order = "1"

        def eval(self, wi, wo, wavelengths):
            raise ValueError("a mirror has no values")

        def average(self, wi, detector, wavelengths):
            raise NotImplementedError

    figure = plots.sphere(measurement, models=(Delta(), *[Lambert(reflectance=0.5)] * 4), size=SIZE)
    assert len(figure.axes) == 2 * 3
    told = figure.get_supxlabel().replace("\n", " ")
    assert "no values in single directions: Delta." in told
    assert "2 more models are not shown." in told


def test_the_suffix_chooses_the_file_type(measurement, tmp_path):
    plots.sphere(measurement, str(tmp_path / "sphere.pdf"), size=30)
    assert (tmp_path / "sphere.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(ValueError, match=r"sphere\.bmp2.*the suffixes are .*\.png"):
        plots.sphere(measurement, tmp_path / "sphere.bmp2", size=30)
    assert [p.name for p in tmp_path.iterdir()] == ["sphere.pdf"]
