import math

import numpy as np
import pytest

from gonio.detectors import Apertures, HemisphereGrid, Klems
from gonio.models import PoulinFournier
from gonio.optics import Mirror
from gonio.sphere import angles, direction, rotate_z

GRIDS = [
    HemisphereGrid(),
    HemisphereGrid(theta_step=5, phi_step=15),
    HemisphereGrid(theta_step=5, phi_step=15, spacing="projected_area"),
    HemisphereGrid(theta_step=90, phi_step=180),
]


@pytest.mark.parametrize("grid", GRIDS, ids=repr)
def test_a_grid_covers_the_hemisphere_once(grid):
    assert math.isclose(grid.projected_solid_angles().sum(), math.pi, rel_tol=1e-14)
    assert grid.theta_edges[0] == 0
    assert math.isclose(grid.theta_edges[-1], 90, rel_tol=1e-15)
    assert (np.diff(grid.theta_edges) > 0).all()
    inside = (grid.theta_edges[:-1] <= grid.theta) & (grid.theta <= grid.theta_edges[1:])
    assert inside.all()


@pytest.mark.parametrize(("basis", "patches"), [("full", 145), ("half", 77), ("quarter", 41)])
def test_klems_patches_cover_the_hemisphere_once(basis, patches):
    detector = Klems(basis)
    assert detector.bins == len(detector.directions) == patches
    assert math.isclose(detector.projected_solid_angles().sum(), math.pi, rel_tol=1e-14)
    polar, around = detector.limits()
    np.testing.assert_array_equal(np.unique(polar), detector.theta_edges)
    np.testing.assert_allclose(np.bincount(np.searchsorted(detector.theta_edges, polar[:, 0]), around[:, 1]), 180)
    wo, _ = detector.quadrature(direction(0, 0), nodes=5)
    assert (detector.owner(wo) == np.arange(patches)[:, None]).all()


def test_equal_projected_areas_are_equal():
    areas = GRIDS[2].projected_solid_angles()
    np.testing.assert_allclose(areas, areas[0], rtol=1e-12)


def test_no_edge_lies_on_the_plane_of_incidence_or_on_a_whole_step():
    grid = HemisphereGrid()
    assert grid.shape == (91, 360)
    assert not np.isin(grid.dphi_edges % 360, (0, 180)).any()
    assert not any(grid.edge_at(theta) for theta in range(90))
    assert grid.edge_at(30.5)
    np.testing.assert_array_equal(grid.theta[:90], np.arange(90))


@pytest.mark.parametrize(
    "detector",
    [*GRIDS[1:], Klems(), Klems("half"), Apertures(directions=((0, 0), (40, 130), (80, 300)), half_angle=10)],
    ids=repr,
)
def test_quadrature_averages_with_the_cosine(detector):
    """The mean of 1/cosθ is solid angle over projected solid angle; the mean of a constant is itself."""
    wi = direction(30, 70)
    wo, weight = detector.quadrature(wi, nodes=16)
    np.testing.assert_allclose(weight.sum(axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(wo, axis=-1), 1, rtol=1e-12)
    areas = detector.projected_solid_angles()
    if isinstance(detector, Apertures):
        solid = np.full(3, 2 * math.pi * (1 - math.cos(math.radians(10))))
    else:
        edges = np.cos(np.radians(detector.theta_edges))
        sectors = detector.sectors if isinstance(detector, Klems) else np.full(detector.shape[0], detector.shape[1])
        solid = np.repeat(-np.diff(edges) * 2 * math.pi / sectors, sectors)
    np.testing.assert_allclose((weight / wo[..., 2]).sum(axis=1), solid / areas, rtol=2e-3)
    chosen = np.array([2, 1])
    np.testing.assert_array_equal(detector.quadrature(wi, 4, chosen)[0], detector.quadrature(wi, 4)[0][chosen])


def test_a_grid_turns_with_the_lamp_and_apertures_do_not():
    grid, apertures = GRIDS[1], Apertures(directions=((40, 130),), half_angle=5)
    turned = rotate_z(grid.quadrature(direction(30, 0))[0], 70)
    np.testing.assert_allclose(grid.quadrature(direction(30, 70))[0], turned, atol=1e-12)
    wo, weight = apertures.quadrature(direction(30, 70))
    centre = (weight[..., None] * wo).sum(axis=1)
    theta, phi = angles(centre / np.linalg.norm(centre))
    assert abs(phi[0] - 130) < 1e-9
    assert 39 < theta[0] < 40  # the cosine pulls the mean towards the normal


def test_light_from_the_pole_keeps_the_azimuth_that_dphi_counts_from():
    """Across cylinders at azimuth 0, lit from above with phi_i = 30, light leaves at dphi = 150 and 330."""
    grid = HemisphereGrid(theta_step=10.0, phi_step=10.0)
    model = PoulinFournier(local=Mirror(), distance=1.5)
    lobe = model.average(direction(0.0, 30.0), grid)[:, 0].reshape(grid.shape)
    lit = grid.dphi[(lobe[1:] > 0).any(axis=0)]
    np.testing.assert_allclose(lit, [150.0, 330.0])
    strips = PoulinFournier(local=Mirror(), distance=5.0).average(direction(0.0, 30.0), grid)[:, 0]
    assert strips.argmax() == 0  # the pole itself is in the first sector
    np.testing.assert_allclose(angles(direction(0.0, 211.0))[1], 211.0)
    np.testing.assert_allclose(direction(0.0, 211.0), [0.0, 0.0, 1.0], atol=1e-99)
