"""Between measured incidences: lobes go where the light goes, keep their energy, and a diffuser stays one."""

import numpy as np
import pytest

import gonio
from gonio.detectors import HemisphereGrid
from gonio.interpolation import Interpolation
from gonio.models import GGX, Beckmann, Lambert, Microfacet, SmithCorrelated
from gonio.optics import Conductor
from gonio.sphere import direction

GRID = HemisphereGrid(theta_step=2.0, phi_step=3.0)
NM = np.array([450.0, 650.0])


def sampled(model, theta_i, phi_i=(0.0,), isotropic=True):
    table = np.stack(
        [[model.average(direction(t, p), GRID, NM).reshape(*GRID.shape, -1) for p in phi_i] for t in theta_i]
    )
    return Interpolation(table, GRID, np.array(theta_i), np.array(phi_i), isotropic)


def rough_gold(distribution):
    return Microfacet(distribution=distribution, masking=SmithCorrelated(), material=Conductor("Au"))


def albedo(function, wi):
    wo, weights = GRID.quadrature(wi, nodes=2)
    values = function(np.broadcast_to(wi, wo.shape), wo)
    return GRID.projected_solid_angles() @ (values * weights[..., None]).sum(axis=1)


@pytest.mark.parametrize("theta_i", [(0.0, 30.0, 60.0), (40.0,)])
def test_a_diffuser_is_one_from_everywhere(theta_i):
    function = sampled(Lambert(reflectance=0.5), theta_i)
    if len(theta_i) > 1:
        assert function.exponent == 0
    for theta in (0, 17, 45, 60, 85):
        wi = direction(theta, 123)
        values = function(
            wi, direction(*np.meshgrid([0, 20, 50, 80], [0, 100, 200], indexing="ij")), extrapolate="nearest"
        )
        if len(theta_i) > 1:
            np.testing.assert_allclose(values, 0.5 / np.pi, rtol=1e-6)
        assert albedo(lambda wi, wo: function(wi, wo, extrapolate="nearest"), wi) == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize("distribution", [Beckmann(0.3), Beckmann(0.6), GGX(0.3)], ids=repr)
@pytest.mark.parametrize(("step", "error"), [(30, 0.25), (15, 0.1)])
def test_lobes_between_are_near_the_truth_and_keep_their_energy(distribution, step, error):
    model = rough_gold(distribution)
    function = sampled(model, np.arange(0.0, 76.0, step))
    assert function.exponent > 0.5
    for theta in np.arange(step / 2, 75 - step / 2, step):
        wi = direction(theta, 0)
        around = [albedo(function, direction(t, 0)) for t in (theta - step / 2, theta + step / 2)]
        np.testing.assert_allclose(albedo(function, wi), np.mean(around, axis=0), rtol=0.01)
        wo, _ = GRID.quadrature(wi, nodes=1)
        truth, found = model.eval(wi, wo[:, 0], NM), function(wi, wo[:, 0])
        bright = truth > 0.1 * truth.max(axis=0)
        assert np.sqrt(np.mean(np.log(found[bright] / truth[bright]) ** 2)) < error


def test_beyond_the_measured_incidences_albedos_stay():
    function = sampled(rough_gold(Beckmann(0.4)), (0.0, 20.0, 40.0, 60.0))
    for theta in (70, 80, 87):
        wi = direction(theta, 40)
        far = albedo(lambda wi, wo: function(wi, wo, extrapolate="nearest"), wi)
        np.testing.assert_allclose(far, albedo(function, direction(60, 0)), rtol=0.08)
    with pytest.raises(ValueError, match="theta_i = 70 lies outside the measured range 0 to 60"):
        function(direction(70, 0), direction(70, 180))


def test_azimuths_are_joined_all_around_and_the_right_way():
    """Brushed gold, its grain turned by 20 degrees: between azimuths of the light the facets stay where they are."""
    model = rough_gold(Beckmann(alpha_x=0.6, alpha_y=0.3, rotation=20.0))
    function = sampled(model, (30.0, 40.0), np.arange(0.0, 360.0, 30.0), isotropic=False)
    wo = direction(*np.meshgrid(np.arange(0.0, 61.0, 10.0), np.arange(0.0, 360.0, 20.0), indexing="ij"))
    for phi in (15.0, 100.0, 345.0, 359.0):
        wi = direction(35, phi)
        found, truth = function(wi, wo), model.eval(np.broadcast_to(wi, wo.shape), wo, NM)
        bright = truth > 0.05 * truth.max()
        off = np.abs(np.log(found[bright] / truth[bright]))
        assert np.median(off) < 0.03
        assert np.quantile(off, 0.9) < 0.15
    part = sampled(model, (30.0, 40.0), (0.0, 30.0, 60.0), isotropic=False)
    with pytest.raises(ValueError, match=r"phi_i = .* lies outside the measured range 0 to 60"):
        part(direction(35, 200), direction(35, 30))
    assert part(direction(35, -1e-9), direction(35, 30)).shape == (2,)


def test_measurements_evaluate_by_it():
    model = rough_gold(Beckmann(0.3))
    table = sampled(model, (0.0, 30.0)).table
    known = gonio.measurement.tabulated(table, GRID, (0.0, 30.0), (0.0,), NM, attributes={"isotropic": 1})
    wi, wo = direction(20, 10), direction(25, 200)
    np.testing.assert_array_equal(
        known.eval(wi, wo), Interpolation(table, GRID, np.array([0.0, 30.0]), np.zeros(1), True)(wi, wo)
    )
