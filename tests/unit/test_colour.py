"""Colours: what the CIE and IEC have published of white points and spectra."""

import numpy as np
import pytest

from gonio.colour import encoded, rgb_weights, xyz_of_rgb, xyz_weights

WHITES = {"D65": (0.95047, 1.08883), "A": (1.09850, 0.35585), "E": (1.00000, 1.00000)}
"""X and Z at Y = 1 of the illuminants, 2 degree observer (ASTM E308)."""


@pytest.mark.parametrize("illuminant", WHITES)
def test_white_has_the_published_colour(illuminant):
    x, y, z = xyz_weights([400, 500, 600, 700], illuminant).sum(axis=1)
    assert y == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose([x, z], WHITES[illuminant], rtol=2e-4)


@pytest.mark.parametrize("illuminant", WHITES)
@pytest.mark.parametrize("wavelengths", [[550], [450, 550, 650], [650, 450, 550], np.arange(380, 781, 5)])
def test_white_is_white_in_srgb(wavelengths, illuminant):
    np.testing.assert_allclose(rgb_weights(wavelengths, illuminant).sum(axis=1), 1, atol=1e-12)


def test_one_line_has_its_published_chromaticity():
    nodes = np.arange(380, 781, 5.0)
    for nm, x, y in ((450, 0.15664, 0.01771), (550, 0.30160, 0.69231), (650, 0.72599, 0.27401)):
        xyz = xyz_weights(nodes, "E")[:, nodes == nm].ravel()
        np.testing.assert_allclose(xyz[:2] / xyz.sum(), (x, y), atol=1e-4)


def test_the_order_of_wavelengths_does_not_matter():
    np.testing.assert_allclose(rgb_weights([650, 450, 550]), rgb_weights([450, 550, 650])[:, [2, 0, 1]], atol=1e-15)


def test_srgb_of_its_primaries():
    np.testing.assert_allclose(xyz_of_rgb()[:, 0], (0.4124, 0.2126, 0.0193), atol=1e-4)
    np.testing.assert_allclose(xyz_of_rgb()[1], (0.2126, 0.7152, 0.0722), atol=1e-4)


def test_the_screen_curve():
    np.testing.assert_allclose(encoded([-1, 0, 0.001, 0.2140, 1, 2]), [0, 0, 0.01292, 0.5, 1, 1], atol=1e-4)


def test_the_same_wavelength_twice_is_refused():
    with pytest.raises(ValueError, match="different from each other"):
        xyz_weights([550, 550])
