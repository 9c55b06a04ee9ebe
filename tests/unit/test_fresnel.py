"""Fresnel's equations against complex amplitudes and published values."""

import numpy as np
import pytest
from specimens import SPECULAR, reference_table

from gonio.optics import (
    fresnel_conductor,
    fresnel_dielectric,
    fresnel_table,
    fresnel_transmittance,
)

COSINES = np.concatenate([[0.0, 1e-12, 1e-6, 1e-3], np.linspace(0.01, 1.0, 200)])

INDICES = np.array([0.2, 0.7, 1 / 1.5, 1.0, 1.0000001, 1.33, 1.5, 2.4, 10.0])


def amplitudes(cos_i, index):
    """Reflectances from the complex amplitudes of a textbook: tangential E and H are continuous."""
    index = np.asarray(index, complex)
    cos_t = np.sqrt(1.0 - (1.0 - cos_i**2) / index**2 + 0j)
    cos_t = np.where((cos_t * index).imag < 0, -cos_t, cos_t)
    r_s = (cos_i - index * cos_t) / (cos_i + index * cos_t)
    r_p = (index * cos_i - cos_t) / (index * cos_i + cos_t)
    return np.abs(r_s) ** 2, np.abs(r_p) ** 2


@pytest.mark.parametrize(
    "row",
    reference_table("table_fresnel"),
    ids=lambda r: "-".join(r.values()),
)
def test_reference_table_to_all_its_digits(row):
    cos_i = np.cos(np.radians(float(row["theta"])))
    r_s, r_p = fresnel_conductor(cos_i, float(row["n"]), float(row["k"]))
    expected = [float(row[name]) for name in ("Rs", "Rp", "F")]
    assert [r_s, r_p, (r_s + r_p) / 2] == pytest.approx(expected, rel=6e-10)
    if float(row["k"]) == 0:
        assert fresnel_dielectric(cos_i, float(row["n"])) == pytest.approx(expected[:2], rel=6e-10)


def test_conductor_agrees_with_complex_amplitudes():
    rng = np.random.default_rng(1)
    cos_i, eta, k = rng.uniform(0, 1, 5000), 10 ** rng.uniform(-2, 1, 5000), 10 ** rng.uniform(-6, 1.5, 5000)
    for ours, theirs in zip(fresnel_conductor(cos_i, eta, k), amplitudes(cos_i, eta + 1j * k), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-14)


def test_dielectric_agrees_with_complex_amplitudes_and_is_total_beyond_the_critical_angle():
    c, eta = np.meshgrid(COSINES, INDICES[INDICES != 1.0])
    r_s, r_p = fresnel_dielectric(c, eta)
    for ours, theirs in zip((r_s, r_p), amplitudes(c, eta), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-13)
    total = np.sqrt(1 - c**2) > eta * (1 + 1e-9)
    assert total.any()
    assert (r_s[total] == 1.0).all()
    assert (r_p[total] == 1.0).all()


def test_what_is_not_reflected_is_transmitted():
    c, eta = np.meshgrid(COSINES, INDICES)
    for r, t in zip(fresnel_dielectric(c, eta), fresnel_transmittance(c, eta), strict=True):
        np.testing.assert_allclose(r + t, 1.0, rtol=0, atol=4e-15)


def test_conductor_without_extinction_is_a_dielectric():
    c, eta = np.meshgrid(COSINES, INDICES)
    for a, b in zip(fresnel_conductor(c, eta, 0.0), fresnel_dielectric(c, eta), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-14)


@pytest.mark.parametrize("material", SPECULAR[1:], ids=repr)
def test_the_table_of_reflectances_is_exact_to_ten_digits(material):
    """Its polynomials, added up as the transport does, at cosines between and on their borders."""
    wavelengths = np.arange(380.0, 781.0, 5.0)
    index = material.refractive_index(wavelengths)
    table = fresnel_table(index.real, index.imag)
    intervals = len(table)
    assert intervals > 0
    cosines = np.concatenate(
        [COSINES, np.arange(intervals) / intervals, np.random.default_rng(2).uniform(0, 1, 20_000)]
    )
    place = np.minimum((cosines * intervals).astype(int), intervals - 1)
    u = cosines * intervals - place
    values = sum(table[place, power] * u[:, None] ** power for power in range(6))
    exact = np.mean(fresnel_conductor(cosines[:, None], index.real, index.imag), axis=0)
    assert np.abs(values - exact).max() < 2.0**-34


@pytest.mark.parametrize("eta", [0.7, 1 / 1.5])
def test_no_table_is_made_of_total_reflection(eta):
    assert fresnel_table(np.array([eta]), np.array([0.0])).shape == (0, 6, 1)
    assert fresnel_table(np.array([1.5, eta]), np.array([0.0, 0.0])).shape == (0, 6, 2)


def test_no_contrast_no_reflection_and_brewster_and_grazing():
    assert np.array_equal(fresnel_dielectric(COSINES, 1.0), np.zeros((2, COSINES.size)))
    assert np.array_equal(fresnel_transmittance(COSINES, 1.0), np.ones((2, COSINES.size)))
    assert fresnel_dielectric(1 / np.hypot(1.0, 1.5), 1.5)[1] == pytest.approx(0.0, abs=1e-30)
    assert fresnel_dielectric(0.0, 1.5) == (1.0, 1.0)
    assert fresnel_conductor(0.0, 0.2, 3.9) == (1.0, 1.0)
    assert fresnel_dielectric(1.0, 1.5) == pytest.approx((0.04, 0.04), rel=1e-14)


@pytest.mark.parametrize("material", SPECULAR, ids=repr)
def test_no_material_reflects_more_than_it_receives(material):
    wavelengths = np.arange(380.0, 781.0, 5.0)
    reflectance = material.reflectance(COSINES[:, None], wavelengths)
    assert reflectance.shape == (COSINES.size, 1, wavelengths.size)
    assert (reflectance >= 0.0).all()
    assert (reflectance <= 1.0).all()
    np.testing.assert_allclose(material.reflectance(0.0, wavelengths), 1.0, rtol=1e-12)
