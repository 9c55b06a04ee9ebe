"""Light paths over a profile, against closed forms and against the tracer in space."""

import numpy as np
import pytest

import gonio
import microsurfaces as ms
from gonio.transport.profile import Profile, exposure, incident, shares, trace

GAUSSIAN = ms.Gaussian(alpha=0.6, correlation_length=10.0, side=120.0, samples=128)
SURFACES = [
    ms.Flat(),
    GAUSSIAN,
    ms.Gaussian(alpha_x=0.1, alpha_y=0.4, rotation=30.0, side=200.0, samples=128),
    ms.Cylinders(),
    ms.Cylinders(profile="grooves", distance=2.5),
    ms.Cylinders(distance=3.0, floor_height=0.4),
    ms.VGrooves(angle=60.0),
    ms.VGrooves(m=0.4, grooves=16),
]


def evenly(profile, count):
    return profile.left + profile.period * (np.arange(count) + 0.5) / count


# --- Closed forms ----------------------------------------------------------------------------------------------------


def unfolded(x, theta_i, angle):
    """Hits and leaving direction of a ray that meets the plane z = 0 at x in the V-groove |x| < 1.

    Mirror the groove about its walls again and again: all walls are radii of one circle about its bottom, `opening`
    apart, and the light is a straight line. It hits the walls that it crosses within their length.
    """
    bottom, length, opening = -np.tan(np.radians(angle)), 1 / np.cos(np.radians(angle)), 180 - 2 * angle
    way = incident(theta_i)
    turn = x * way[1] + bottom * way[0]  # (point - bottom) x way: the distance from the bottom, with a sign
    sign, first = np.sign(turn), 90 + theta_i
    after = [angle + k * opening for k in range(-20, 21)]
    crossed = sorted((sign * (wall - first), wall) for wall in after if 0 < sign * (wall - first) < 180)
    walls = [wall for along, wall in crossed if abs(turn) < length * np.sin(np.radians(along))]
    leaving = first + 180
    for wall in reversed(walls):
        leaving = 2 * wall - leaving
    return len(walls), np.array([np.cos(np.radians(leaving)), np.sin(np.radians(leaving))])


@pytest.mark.parametrize("angle", [20.0, 45.0, 60.0, 75.0, 82.0])
@pytest.mark.parametrize("theta_i", [0.0, 25.0, 60.0, 85.0])
def test_a_groove_is_a_straight_line_when_it_is_unfolded(angle, theta_i):
    profile = Profile.of(ms.VGrooves(angle=angle).build(seed=0))
    x = np.linspace(-0.9993, 0.9987, 501)
    traced = trace(profile, x, theta_i)
    expected = [unfolded(at, theta_i, angle) for at in x]
    np.testing.assert_array_equal(traced.hits, [hits for hits, _ in expected])
    np.testing.assert_allclose(traced.leaving, [way for _, way in expected], atol=1e-9)
    assert traced.hits.max() <= np.ceil(180 / (180 - 2 * angle))


def test_right_angles_send_light_back():
    traced = trace(Profile.of(ms.VGrooves(angle=45.0).build(seed=0)), np.linspace(-0.99, 0.98, 100), 20.0)
    twice = traced.hits == 2
    assert twice.any()
    np.testing.assert_allclose(traced.leaving[twice], np.tile(-incident(20.0), (twice.sum(), 1)), atol=1e-12)


@pytest.mark.parametrize("theta_i", [0.0, 30.0, 70.0])
def test_a_cylinder_turns_light_by_the_impact_parameter(theta_i):
    """A ray that passes the axis at b radii meets the normal at asin b and turns by 180° - 2 asin b."""
    ridges = ms.Cylinders(distance=6.0, radius=2.0, chords=4000)
    profile = Profile.of(ridges.build(seed=0))
    shift = np.tan(np.radians(theta_i))
    b = np.linspace(-0.95, 0.95, 101)
    axis = profile.left  # the seams lie on the highest points
    traced = trace(profile, axis + 2.0 * b / np.cos(np.radians(theta_i)) - 2.0 * shift, theta_i)
    once = traced.hits == 1
    height = traced.points[1, :, 1]
    once &= height > 1e-6  # not those that meet the floor before the cylinder
    assert once.sum() > 50
    # From the incident direction, theta_i on the left, clockwise by twice the angle of the normal to it.
    out = np.radians(-theta_i) + 2 * np.arcsin(b)
    expected = np.stack([np.sin(out), np.cos(out)], axis=-1)
    # Chords are 180°/4000 wide: their sagitta displaces the hit by 1e-7 radii.
    np.testing.assert_allclose(traced.leaving[once], expected[once], atol=2e-6)


def test_legs_are_straight_and_end_on_the_surface_in_whatever_period():
    """Far from the normal light crosses from tile to tile: unfolded, nothing is to be seen of it."""
    profile, theta_i = Profile.of(GAUSSIAN.build(3)), 70.0
    traced = trace(profile, profile.left + 2.0 + 3.2 * profile.period * np.arange(500) / 500, theta_i)
    tiles = (traced.points[:2, :, 0] - profile.left) // profile.period
    assert (tiles[1] > tiles[0]).sum() > 50
    twice = traced.hits == 2
    assert twice.sum() > 10
    nodes = profile.ends[:, 0]
    for points in (traced.points[1], traced.points[2, twice]):
        on = np.interp(points[:, 0], *nodes.T, period=profile.period)
        np.testing.assert_allclose(points[:, 1], on, atol=1e-9)
    first, second = np.diff(traced.points[:3, twice], axis=0)
    ways = [leg / np.linalg.norm(leg, axis=-1, keepdims=True) for leg in (first, second)]
    np.testing.assert_allclose(ways[0], np.tile(incident(theta_i), (twice.sum(), 1)), atol=1e-9)
    # A reflection changes the direction along the normal: no change along the facet.
    segment = ((traced.points[2, twice, 0] - profile.left) % profile.period // np.diff(nodes[:2, 0])).astype(int)
    along = np.diff(profile.ends[segment], axis=1)[:, 0]
    np.testing.assert_allclose(((traced.leaving[twice] - ways[1]) * along).sum(axis=1), 0.0, atol=1e-9)


@pytest.mark.parametrize("theta_i", [35.0, 50.0, 80.0])
def test_a_ridge_throws_the_shadow_that_geometry_asks_for(theta_i):
    """Touching half cylinders: light passes their axes at 1 to 2 cos(theta_i) - 1 radii, where the next one begins.

    A ray that passes at b meets the normal at asin b - theta_i from z, which is the place sin of that.
    """
    pieces, shadowed, _ = exposure(Profile.of(ms.Cylinders(chords=2000).build(seed=0)), 1e-2, theta_i)
    extent = np.ptp(pieces[..., 0], axis=1) / 10.0
    t = np.radians(theta_i)
    least, most = np.sin(np.arcsin(1 - 2 * np.cos(t)) - t), np.sin(np.pi / 2 - t)
    assert extent[~shadowed].sum() == pytest.approx(most - least, abs=2e-3)


def test_facets_seen_edge_on_receive_nothing():
    """45° grooves at 45°: the far walls lie along the light."""
    pieces, shadowed, masked = exposure(Profile.of(ms.VGrooves(angle=45.0).build(seed=0)), 1e-3, 45.0)
    np.testing.assert_array_equal(shadowed, pieces[:, 1, 1] < pieces[:, 0, 1])
    assert not masked.any()


@pytest.mark.parametrize("surface", SURFACES, ids=str)
@pytest.mark.parametrize("theta_i", [0.0, 35.0, 75.0])
def test_lit_parts_receive_all_the_light_and_masked_parts_what_hits_again(surface, theta_i):
    """A lit piece receives its own width across the beam: all of them together period · cos, masked ones the rest."""
    profile = Profile.of(surface.build(seed=3))
    pieces, shadowed, masked = exposure(profile, profile.period / 4000, theta_i)
    (dx, dz), way = (pieces[:, 1] - pieces[:, 0]).T, incident(theta_i)
    received = (dz * way[0] - dx * way[1]) / (profile.period * np.cos(np.radians(theta_i)))
    assert not (shadowed & masked).any()
    assert received[~shadowed].sum() == pytest.approx(1.0, abs=3e-3)
    once = shares(trace(profile, evenly(profile, 4000), theta_i))[0]
    assert received[masked].sum() == pytest.approx(1 - once, abs=3e-3)


# --- The tracer in space ---------------------------------------------------------------------------------------------


def line(recipe, seed):
    """One line of a height field, unchanged along y."""
    field = recipe.build(seed)
    return ms.HeightField(np.tile(field.heights[len(field.heights) // 2], (4, 1)), field.spacing)


SPECIMENS = {
    "v60": ms.VGrooves(angle=60.0).build(0),
    "v75": ms.VGrooves(angle=75.0).build(0),
    "ensemble": ms.VGrooves(m=0.8, grooves=16).build(2),
    "ridges": ms.Cylinders().build(0),
    "grooves": ms.Cylinders(profile="grooves", distance=2.2).build(0),
    "gaussian": line(GAUSSIAN, 5),
}


@pytest.mark.parametrize("specimen", SPECIMENS)
def test_orders_are_those_of_the_tracer_in_space(specimen):
    """Light from the left has phi_i = 180; 54 shares are judged at a common level of 1e-3."""
    relief, theta_i, count = SPECIMENS[specimen], (10.0, 40.0, 70.0), 20_000
    goniometer = gonio.Goniometer(
        theta_i=theta_i,
        phi_i=(180.0,),
        wavelengths=(550.0,),
        paths=60_000,
        replicates=4,
        detector=gonio.HemisphereGrid(theta_step=10.0, phi_step=10.0),
    )
    data = goniometer.measure(gonio.Scene(relief, gonio.Mirror()), seed=1).dataset
    light = (data["brdf"] * data["projected_solid_angle"]).sum(("theta_o", "dphi")).squeeze(("phi_i", "wavelength"))
    profile = Profile.of(relief)
    for angle in theta_i:
        ours = shares(trace(profile, evenly(profile, count), angle))
        theirs = light.sel(theta_i=angle, order=["1", "2", "3+"]).values
        # The noise of 240,000 independent paths, which stratified ones stay below; and our even grid may miss by half
        # a step at every place where the order changes, 40 at most.
        tolerance = 4.3 * np.sqrt(ours * (1 - ours) / 240_000) + 20 / count
        assert (np.abs(theirs - ours) < tolerance).all(), (angle, theirs, ours)
        assert ours.sum() == pytest.approx(1.0)


# --- The section -----------------------------------------------------------------------------------------------------


def test_a_mesh_is_cut_where_its_height_field_is():
    field = GAUSSIAN.build(2)
    lines = Profile.of(field)
    cut = Profile.of(field.mesh())
    nodes = lines.ends[:, 0]
    np.testing.assert_allclose(np.interp(nodes[:, 0], cut.ends[:, 0, 0], cut.ends[:, 0, 1]), nodes[:, 1], atol=1e-9)
    x = evenly(lines, 1000)
    np.testing.assert_allclose(shares(trace(cut, x, 60.0)), shares(trace(lines, x, 60.0)), atol=2e-3)


def test_it_does_not_matter_where_the_tile_begins():
    mesh = ms.VGrooves(m=0.6, grooves=8).build(1)
    moved = ms.Mesh(mesh.vertices + np.array([5.3, 1.1, 0.0]), mesh.faces, mesh.period)
    here, there = Profile.of(mesh), Profile.of(moved)
    x = evenly(here, 3000)
    np.testing.assert_array_equal(trace(here, x, 65.0).hits, trace(there, x + 5.3, 65.0).hits)


def test_facets_across_the_side_of_the_tile_are_split():
    """A plane of two triangles, tilted sides and all, is the same plane wherever it is cut."""
    vertices = np.array([[0, 0, 0], [4, 0, 0], [5, 4, 0], [1, 4, 0]], float)
    profile = Profile.of(ms.Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), (4.0, 4.0)))
    assert profile.left == 0
    assert profile.ends[..., 0].max() == 4
    assert np.ptp(profile.ends[..., 0], axis=1).sum() == pytest.approx(4.0)
    np.testing.assert_array_equal(trace(profile, evenly(profile, 50), 30.0).hits, 1)


def test_overhangs_are_traced_too():
    """Below a mushroom's hat light is caught from both sides; from above the hat is a flat mirror."""
    x, z = np.array([0.0, 4, 4, 3, 7, 6, 6, 10]), np.array([0.0, 0, 2, 3, 3, 2, 0, 0])
    line = np.stack([x, 0 * x, z], axis=-1)
    vertices = np.concatenate([line, line + np.array([0, 10, 0])])
    i = np.arange(7)
    faces = np.concatenate([np.stack([i, i + 1, i + 9], 1), np.stack([i, i + 9, i + 8], 1)])
    profile = Profile.of(ms.Mesh(vertices, faces, (10.0, 10.0)))
    down = trace(profile, np.array([1.0, 5.0, 9.0]), 0.0)
    np.testing.assert_array_equal(down.hits, 1)
    np.testing.assert_allclose(down.points[1, :, 1], [0, 3, 0])
    pieces, shadowed, _ = exposure(profile, 0.01, 0.0)
    level = pieces[..., 1].max(axis=1) == 0
    x = pieces.mean(axis=1)[:, 0]
    np.testing.assert_array_equal(shadowed[level], ((x > 3) & (x < 7))[level])
