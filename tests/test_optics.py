"""Fresnel's equations against complex amplitudes and published values; materials and their tables."""

import csv
from pathlib import Path

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from gonio import optics
from gonio.optics import (
    CONDUCTORS,
    DIELECTRICS,
    Conductor,
    Dielectric,
    Lambertian,
    Material,
    Mirror,
    fresnel_conductor,
    fresnel_dielectric,
    fresnel_table,
    fresnel_transmittance,
)

DATA = Path(__file__).parent / "data"
COSINES = np.concatenate([[0.0, 1e-12, 1e-6, 1e-3], np.linspace(0.01, 1.0, 200)])
INDICES = np.array([0.2, 0.7, 1 / 1.5, 1.0, 1.0000001, 1.33, 1.5, 2.4, 10.0])
SPECULAR = [Mirror(), *(Conductor(name) for name in CONDUCTORS), *(Dielectric(name) for name in DIELECTRICS)]


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
    list(csv.DictReader((DATA / "table_fresnel.csv").read_text().splitlines())),
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


# Values as quoted by refractiveindex.info at 550 nm for the page that each table was copied from, and Sellmeier's
# formulas with the coefficients of the original publications.
@pytest.mark.parametrize(
    ("name", "index", "tolerance"),
    [("Au", 0.4241 + 2.4721j, 6e-5), ("Al", 1.015 + 6.627j, 6e-4), ("Ag", 0.060 + 3.597j, 6e-4)],
)
def test_metals_at_550_nm(name, index, tolerance):
    value = Conductor(name).refractive_index(550.0)[0]
    assert value.real == pytest.approx(index.real, abs=tolerance)
    assert value.imag == pytest.approx(index.imag, abs=tolerance)


# Johnson and Christy's own points, eV and (n, k), from their tables I (1972) and I (1974).
@pytest.mark.parametrize(
    ("name", "energy", "index"),
    [
        ("Au", 2.26, 0.43 + 2.455j),
        ("Cu", 1.88, 0.22 + 3.747j),
    ],
)
def test_published_points(name, energy, index):
    value = Conductor(name).refractive_index(1239.841984 / energy)[0]
    assert value == pytest.approx(index, abs=0.01)


SELLMEIER = {
    "SiO2": ((0.6961663, 0.4079426, 0.8974794), (0.0684043**2, 0.1162414**2, 9.896161**2)),
    "N-BK7": ((1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)),
}


@pytest.mark.parametrize("name", SELLMEIER)
def test_glasses_follow_their_sellmeier_formula(name):
    wavelengths = np.arange(380.0, 780.5, 0.5)
    b, c = (np.array(x)[:, None] for x in SELLMEIER[name])
    l2 = (wavelengths / 1000.0) ** 2
    formula = np.sqrt(1.0 + (b * l2 / (l2 - c)).sum(axis=0))
    np.testing.assert_allclose(Dielectric(name).refractive_index(wavelengths).real, formula, rtol=0, atol=5e-6)


def test_quoted_indices_of_glasses():
    assert Dielectric("N-BK7").refractive_index(550.0)[0] == pytest.approx(1.51852, abs=6e-6)
    assert Dielectric("N-BK7").refractive_index(587.5618)[0] == pytest.approx(1.51680, abs=6e-6)
    assert Dielectric("SiO2").refractive_index(550.0)[0] == pytest.approx(1.4599, abs=6e-5)


@pytest.mark.parametrize("name", optics.materials())
def test_every_table_covers_the_visible_and_names_its_source(name):
    table = optics.index_table(name)
    assert table.wavelengths[0] <= 380.0
    assert table.wavelengths[-1] >= 780.0
    assert (np.diff(table.wavelengths) > 0).all()
    assert (table.index.real > 0).all()
    assert (table.index.imag >= 0).all()
    assert "CC0" in (Path(optics.__file__).parent / "data" / f"{name}.csv").read_text()
    assert any(year in optics.citation(name) for year in ("1965", "1972", "1974", "1975", "1995", "2016", "2017"))


def test_every_table_is_known_by_name():
    files = {path.stem for path in (Path(optics.__file__).parent / "data").glob("*.csv")}
    assert files == set(optics.materials()) == {*CONDUCTORS, *DIELECTRICS}
    assert len(files) == 12


def test_a_point_of_the_table_is_returned_as_it_is_and_between_points_it_is_linear():
    table = optics.index_table("Cr")
    np.testing.assert_allclose(table(table.wavelengths), table.index, rtol=1e-15)
    middle = (table.wavelengths[1:] + table.wavelengths[:-1]) / 2
    np.testing.assert_allclose(table(middle), (table.index[1:] + table.index[:-1]) / 2, rtol=1e-12)


def test_outside_the_table_is_told_in_one_sentence():
    with pytest.raises(
        ValueError, match=r"^Au has no refractive index at 100, 2500 nm: its table covers 203.3 to 1937 nm"
    ):
        Conductor("Au").reflectance(1.0, (100.0, 550.0, 2500.0))
    with pytest.raises(ValueError, match="nan nm"):
        Dielectric("SiO2").refractive_index(np.nan)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Conductor("gold"), "did you mean 'Au'"),
        (lambda: Conductor("aluminum"), "did you mean 'Al'"),
        (lambda: Conductor("unobtainium"), "choose one of Ag, Al, Au, Cr, Cu, Fe, Ni, Ti, W"),
        (lambda: Conductor("SiO2"), "give it as a Dielectric"),
        (lambda: Dielectric("Au"), "give it as a Conductor"),
        (lambda: Dielectric("BK7"), "did you mean 'N-BK7'"),
        (lambda: Conductor(), "either a name, such as 'Au', or both eta and k"),
        (lambda: Conductor(eta=1.0), "either a name"),
        (lambda: Conductor("Au", eta=1.0, k=1.0), "either a name"),
        (lambda: Conductor(eta=0.0, k=1.0), "greater than 0"),
        (lambda: Conductor(eta=1.0, k=-1.0), "greater than or equal to 0"),
        (lambda: Dielectric(), "either a name, such as 'N-BK7', or eta"),
        (lambda: Dielectric("SiO2", eta=1.5), "either a name"),
        (lambda: Dielectric(eta=float("inf")), "finite"),
        (lambda: Lambertian(1.1), "less than or equal to 1"),
    ],
)
def test_wrong_materials_are_told_in_words(make, words):
    with pytest.raises(ValidationError, match=words):
        make()


@pytest.mark.parametrize(
    "material", [*SPECULAR, Conductor(eta=0.2, k=3.9), Dielectric(eta=1.5), Lambertian(0.5)], ids=repr
)
def test_materials_round_trip_by_kind(material):
    adapter = TypeAdapter(Material)
    assert adapter.validate_json(adapter.dump_json(material, exclude_none=True)) == material
    assert eval(repr(material), vars(optics)) == material


def test_one_index_for_all_wavelengths():
    assert np.array_equal(Conductor(eta=0.2, k=3.9).refractive_index((400.0, 10_000.0)), [0.2 + 3.9j] * 2)
    assert np.array_equal(Dielectric(eta=1.5).refractive_index((400.0, 10_000.0)), [1.5 + 0j] * 2)
    assert Dielectric("TiO2").refractive_index((380.0, 550.0)).imag.max() == 0.0
