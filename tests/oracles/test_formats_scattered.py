"""Lists of directions of any origin, and the functions that they stand for."""

import dataclasses

import numpy as np
import pytest
from closed_forms import chiral, directions

from gonio.formats.scattered.rows import degrees
from gonio.formats.scattered.table import Table
from gonio.sphere import direction, half_vector


def listed(theta_i, phi_i, theta_o, dphi, function, **more):
    """A table of `function(theta_i, phi_i, theta_o, dphi)` over a grid of these nodes."""
    axes = [a.ravel() for a in np.meshgrid(theta_i, phi_i, theta_o, dphi, indexing="ij")]
    return Table(*axes, function(*axes)[:, None], np.array([550.0]), **more)


def test_a_grid_of_any_nodes_is_linear_in_the_angles_of_each_incidence():
    table = listed(
        (10, 25, 60), (0,), (0, 3, 10, 30, 33, 60, 75, 90), (0, 20, 50, 90, 140, 200, 250, 300, 330), chiral_550
    )
    brdf = table.to_brdf()
    assert brdf.isotropic
    for theta_i in (10.0, 25.0, 60.0):
        _, phi_i, theta_o, dphi = directions(100, most=89)
        found = brdf.evaluate(direction(theta_i, phi_i), direction(theta_o, phi_i + dphi))[:, 0]
        expected = [bilinear(table, theta_i, t, d) for t, d in zip(theta_o, dphi, strict=True)]
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def chiral_550(theta_i, phi_i, theta_o, dphi):
    return chiral(theta_i, phi_i, theta_o, dphi, 550.0)


def bilinear(table, theta_i, theta_o, dphi):
    """One value of a full grid whose azimuths go all around, by hand."""
    here = table.theta_i == theta_i
    rings, sectors = np.unique(table.theta_o), np.unique(table.dphi)
    values = table.values[here, 0].reshape(len(rings), len(sectors))
    ring = np.array([np.interp(theta_o, rings, column) for column in values.T])
    return np.interp(dphi, np.append(sectors, 360), np.append(ring, ring[0]))


def test_between_incidences_lobes_move_with_the_half_vector():
    """A function of the half vector alone is the same lobe, mirrored, at every incidence."""

    def of_half(theta_i, phi_i, theta_o, dphi):
        wh = half_vector(direction(theta_i, 0.0), direction(theta_o, dphi))
        return np.exp(-(((wh - direction(8.0, 120.0)) / 0.25) ** 2).sum(axis=-1))

    nodes = np.arange(0, 91, 2.0)
    brdf = listed((20, 40, 60), (0,), nodes, np.arange(0, 360, 5.0), of_half).to_brdf()
    _, phi_i, theta_o, dphi = directions(400, most=75)
    theta_i = np.linspace(20, 60, 400)
    found = brdf.evaluate(direction(theta_i, phi_i), direction(theta_o, phi_i + dphi))[:, 0]
    above = direction(theta_o, dphi) + direction(theta_i, 0.0)
    assert np.abs(found - of_half(theta_i, 0, theta_o, dphi))[above[:, 2] > 1.0].max() < 0.02


def test_scattered_directions_are_interpolated_over_triangles():
    random = np.random.default_rng(3)
    theta = np.degrees(np.arccos(np.sqrt(random.random(4000))))
    phi = 360 * random.random(4000)

    def flat(theta, phi):
        return 1 + 0.005 * theta * np.cos(np.radians(phi - 70))

    table = Table(
        np.full(4000, 40.0), np.full(4000, 15.0), theta, phi - 15, flat(theta, phi)[:, None], np.array([550.0])
    )
    _, _, theta_o, phi_o = directions(300, most=85)
    brdf = dataclasses.replace(table, isotropic=False).to_brdf()
    found = brdf.evaluate(direction(np.full(300, 40.0), 15.0), direction(theta_o, phi_o))[:, 0]
    np.testing.assert_allclose(found, flat(theta_o, phi_o), rtol=1e-9)
    # A single azimuth of the light: without being told otherwise, the lobe turns with it.
    turned = table.to_brdf().evaluate(direction(np.full(300, 40.0), 95.0), direction(theta_o, phi_o + 80))[:, 0]
    np.testing.assert_allclose(turned, flat(theta_o, phi_o), rtol=1e-9)


def test_the_azimuth_of_the_light_is_linear_and_closes():
    def turning(theta_i, phi_i, theta_o, dphi):
        return 1 + 0.1 * np.sin(np.radians(phi_i - 25))

    table = listed((0, 30), range(0, 360, 10), (0, 30, 60, 90), range(0, 360, 30), turning)
    # Light from the normal has one row only.
    keep = (table.theta_i > 0) | (table.phi_i == 0)
    table = dataclasses.replace(
        table, **{n: getattr(table, n)[keep] for n in ("theta_i", "phi_i", "theta_o", "dphi", "values")}
    )
    brdf = table.to_brdf()
    phi_i = np.linspace(-5, 360, 400)
    found = brdf.evaluate(direction(np.full(400, 30.0), phi_i), direction(np.full(400, 40.0), 77.0))[:, 0]
    np.testing.assert_allclose(found, turning(0, phi_i, 0, 0), atol=0.1 * np.radians(10) ** 2 / 8)
    at_normal = brdf.evaluate(direction(np.zeros(400), phi_i), direction(np.full(400, 40.0), 77.0))[:, 0]
    np.testing.assert_allclose(at_normal, turning(0, 0, 0, 0), rtol=1e-12)


def test_between_azimuths_lobes_turn_with_the_light():
    axes = ((20, 50), range(0, 360, 30), range(0, 91, 5), range(0, 360, 5))
    told = [listed(*axes, chiral_550, isotropic=isotropic).to_brdf() for isotropic in (True, False)]
    theta_i, phi_i, theta_o, phi_o = directions(500)
    wi, wo = direction(20 + theta_i / 4, phi_i), direction(theta_o, phi_o)
    np.testing.assert_allclose(told[1].evaluate(wi, wo), told[0].evaluate(wi, wo), rtol=1e-9)


def test_light_from_the_normal_has_no_azimuth():
    """An anisotropic table gives one azimuth at theta_i = 0; its lobe does not turn with the light."""

    def absolute(theta_i, phi_i, theta_o, dphi):
        return 1 + 0.01 * theta_o * np.cos(np.radians(phi_i + dphi - 30))

    first = listed((0,), (90,), range(0, 91, 15), range(0, 360, 15), absolute)
    more = listed((40,), (0, 90, 180, 270), range(0, 91, 15), range(0, 360, 15), absolute)
    columns = {
        n: np.concatenate([getattr(first, n), getattr(more, n)])
        for n in ("theta_i", "phi_i", "theta_o", "dphi", "values")
    }
    brdf = Table(**columns, wavelengths=np.array([550.0])).to_brdf()
    assert not brdf.isotropic
    phi_i = np.arange(0, 360, 7.0)
    found = brdf.evaluate(direction(np.zeros(len(phi_i)), phi_i), direction(np.full(len(phi_i), 45.0), 30.0))
    np.testing.assert_allclose(found, 1.45, rtol=1e-9)


def test_a_plane_of_incidence_says_nothing_about_what_lies_outside_of_it():
    theta = np.concatenate([np.arange(0.0, 80, 4), -np.arange(2.0, 80, 5)])
    n = len(theta)
    table = Table(np.full(n, 30.0), np.zeros(n), theta, np.zeros(n), (1 + theta / 100)[:, None], np.array([550.0]))
    brdf = table.to_brdf()
    wi = direction(np.full(4, 30.0), 0.0)
    inside = brdf.evaluate(wi, direction([5.0, 37.0, 33.0, 51.0], [0.0, 0.0, 180.0, 180.4]))[:, 0]
    np.testing.assert_allclose(inside, [1.05, 1.37, 0.67, 0.49], rtol=1e-9)
    assert np.isnan(brdf.evaluate(wi, direction([20.0, 37.0, 37.0, 88.0], [90.0, 3.0, 177.0, 0.0]))).all()
    known = brdf.measured().dataset["brdf"].sel(order="all").isel(theta_i=0, phi_i=0, wavelength=0).notnull()
    assert known.sel(dphi=[0, 180]).mean() > 0.8
    assert known.sel(theta_o=slice(5, None)).sel(dphi=slice(10, 170)).sum() == 0


def test_holes_stay_holes_and_rims_are_not_extended():
    table = listed((30,), (0,), np.arange(0, 71, 5.0), np.arange(0, 360, 10.0), chiral_550)
    shadow = (np.abs(table.theta_o - 30) <= 20) & (np.minimum(table.dphi, 360 - table.dphi) <= 20)
    brdf = dataclasses.replace(table, values=np.where(shadow[:, None], np.nan, table.values)).to_brdf()
    wi = direction(np.full(5, 30.0), 0.0)
    found = brdf.evaluate(wi, direction([30.0, 30.0, 72.0, 73.0, 89.0], [0.0, 170.0, 90.0, 90.0, 0.0]))[:, 0]
    assert np.isnan(found).tolist() == [True, False, False, True, True]


def test_one_side_of_an_isotropic_lobe_stands_for_both():
    table = listed((0, 50), (0,), np.arange(0, 91, 10.0), np.arange(0, 181, 20.0), chiral_550)
    theta_o, dphi = np.array([15.0, 44.0, 80.0]), np.array([13.0, 90.0, 171.0])
    wi = direction(np.full(3, 50.0), 0.0)
    left, right = (table.to_brdf().evaluate(wi, direction(theta_o, sign * dphi)) for sign in (1, -1))
    np.testing.assert_allclose(left, right, rtol=1e-12)
    assert np.isfinite(left).all()


def test_rounded_radians_are_the_angles_that_were_meant():
    exact = np.array([0.0, 5.0, 12.5, 33.33, 89.75])
    np.testing.assert_array_equal(degrees(np.radians(exact).round(6)), exact)
    assert degrees(np.radians(12.3456)) == pytest.approx(12.3456, rel=1e-14)


def test_repeated_rows_are_averaged_and_absurd_tables_refused():
    n = np.zeros(4)
    rows = {"theta_i": n + 30, "phi_i": n, "theta_o": n + 10, "dphi": n, "wavelength": n + 550}
    table = Table.of_rows(**rows, values=np.array([1.0, 2, 3, 6]), standard_error=n + 0.5)
    assert (table.values.item(), table.standard_error.item()) == (3.0, 0.5)
    many = np.arange(1000.0)
    with pytest.raises(ValueError, match="do not form a table"):
        Table.of_rows(many % 90, many, many % 89, many, many + 1, many)
    several = np.arange(20_000.0)
    with pytest.raises(ValueError, match="more than 10000"):
        Table(several / 300, several, several % 89, several, several[:, None], np.array([550.0])).to_brdf()
    with pytest.raises(ValueError, match="too many"):
        Table(many % 90, many, many % 89, many, many[:, None], np.array([550.0]), isotropic=False).to_brdf()
    with pytest.raises(ValueError, match=r"theta_o = 91 must lie between 0 and 90"):
        dataclasses.replace(table, theta_o=np.array([91.0])).to_brdf()


def test_interpolated_lists_keep_their_errors():
    table = listed((20, 50), (0,), np.arange(0, 91, 7.5), np.arange(0, 360, 20.0), chiral_550)
    brdf = dataclasses.replace(table, standard_error=0.02 * table.values).to_brdf()
    data = brdf.measured().dataset
    np.testing.assert_allclose(data["brdf_standard_error"], 0.02 * data["brdf"], rtol=1e-9)
