"""Micro-cylinders and V-grooves against their closed forms: the circle, phi_e and w, slope densities, strata."""

import numpy as np
import pytest
from pydantic import ValidationError

from microsurfaces import Cylinders, Flat, VGrooves

EPS = np.finfo(float).eps

# distance d, floor h, edge angle phi_e in degrees, width w of the flat strip in radii
GEOMETRIES = [
    (2.0, 0.0, 90.0, 0.0),
    (1.0, 0.0, 30.0, 0.0),
    (np.sqrt(2), 0.0, 45.0, 0.0),
    (3.0, 0.0, 90.0, 1.0),
    (3.0, 0.5, 60.0, 3 - np.sqrt(3)),
    (1.0, 0.8, 30.0, 0.0),  # the floor lies below the cusps, at √3/2
    (1.5, 0.96, np.degrees(np.arccos(0.96)), 1.5 - 2 * 0.28),
]
PROFILES = ["ridges", "grooves"]


def built(profile, d, h, radius=5.0, chords=256):
    return Cylinders(profile=profile, distance=d, floor_height=h, radius=radius, chords=chords).build(0)


def section(mesh):
    """The profile at the lower end in y: x, z and the exact normals of its vertices, in radii of 5 µm, x centred."""
    edge = mesh.vertices[:, 1] == mesh.vertices[:, 1].min()
    return mesh.vertices[edge][:, [0, 2]] / 5.0, mesh.vertex_normals[edge]


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(("d", "h", "edge", "w"), GEOMETRIES)
def test_every_vertex_lies_on_its_circle_or_flat_with_the_exact_normal(profile, d, h, edge, w):
    mesh = built(profile, d, h)
    assert mesh.period == pytest.approx((5 * d, 5 * d), rel=4 * EPS)
    points, normals = section(mesh)
    assert np.abs(normals[:, 1]).max() == 0
    sign = 1 if profile == "ridges" else -1
    tilt = np.degrees(np.arctan2(np.abs(normals[:, 0]), normals[:, 2]))
    assert tilt.max() == pytest.approx(edge, abs=1e-12)
    axes = np.array([-d / 2, d / 2]) if profile == "ridges" else np.array([0.0])
    radial = points[:, None] - np.stack([axes, 0 * axes], axis=1) - sign * normals[:, None, [0, 2]]
    off_circle = np.abs(radial).max(axis=2).min(axis=1)  # from the nearer of the circles
    flat = off_circle > 8 * EPS * max(d, 1)
    np.testing.assert_allclose(points[flat, 1], sign * np.cos(np.radians(edge)), atol=4 * EPS)
    np.testing.assert_array_equal(normals[flat, 2], 1)
    assert np.count_nonzero(flat) == (0 if w == 0 else 2 if profile == "ridges" else 4)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(("d", "h", "edge", "w"), GEOMETRIES)
def test_the_slope_density_is_that_of_circle_and_flat(profile, d, h, edge, w):
    """The plane's share of facets flatter than the vertex angle a is (w + 2 sin a)/d, for every a, exactly."""
    mesh = built(profile, d, h)
    tilts = np.arccos(np.clip(mesh.normals()[:, 2], -1, 1))
    shares = mesh.area_vectors()[:, 2] / np.prod(mesh.period)
    vertex_angles = np.unique(np.arctan2(np.abs(mesh.vertex_normals[:, 0]), mesh.vertex_normals[:, 2]).round(12))
    for a in vertex_angles[1:]:
        assert shares[tilts < a].sum() == pytest.approx((w + 2 * np.sin(a)) / d, abs=1e-11)
    assert shares[tilts < 1e-9].sum() == pytest.approx(w / d, abs=1e-14)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(("d", "h", "edge", "w"), [g for g in GEOMETRIES if g[2] < 90])
def test_the_mean_square_slope_approaches_that_of_the_circle(profile, d, h, edge, w):
    """(2/d) [ln tan(π/4 + phi_e/2) - sin phi_e], from below and at second order in the chord."""
    e = np.radians(edge)
    exact = 2 / d * (np.log(np.tan(np.pi / 4 + e / 2)) - np.sin(e))
    coarse, fine = (built(profile, d, h, chords=n).statistics().rms_slope_x ** 2 for n in (120, 240))
    assert coarse < fine < exact
    assert (exact - coarse) / (exact - fine) == pytest.approx(4, rel=0.05)
    assert built(profile, d, h).statistics().rms_slope_y == 0


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("d", [2.0, 3.0])
def test_vertical_walls_have_no_slope_moments(profile, d):
    s = built(profile, d, 0.0).statistics()
    assert s.Sdq is s.rms_slope_x is s.rms_slope_y is s.beckmann_alpha is None
    # Heights of half circles over the plane: mean π/(2d), mean square 4/(3d); chords are off by (π/256)²/12.
    assert s.Sq == pytest.approx(5 * np.sqrt(4 / (3 * d) - (np.pi / (2 * d)) ** 2), rel=1e-3)


@pytest.mark.parametrize(("d", "h", "edge", "w"), GEOMETRIES)
def test_grooves_are_the_mirror_image_of_ridges(d, h, edge, w):
    """z_groove(x) = -z_ridge(x - d/2): half a period apart, both having their seams on top."""
    (ridges, _), (grooves, _) = (section(built(name, d, h)) for name in ("ridges", "grooves"))
    x = np.linspace(0, d / 2, 777)
    right = np.interp(x, *ridges.T)
    np.testing.assert_allclose(np.interp(x - d / 2, *grooves.T), -right, atol=1e-8)  # sqrt(eps) at vertical walls
    np.testing.assert_allclose(np.interp(d / 2 - x, *grooves.T), -right, atol=1e-8)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(("d", "h", "edge", "w"), GEOMETRIES)
def test_the_seams_lie_on_the_highest_points(profile, d, h, edge, w):
    z = built(profile, d, h).vertices
    seams = np.abs(np.abs(z[:, 0]) - np.abs(z[:, 0]).max()) < 1e-12
    assert np.ptp(z[seams, 2]) == 0
    assert z[seams, 2].max() == pytest.approx(z[:, 2].max(), abs=1e-15)


def test_pieces_meet_in_the_very_same_points_but_keep_their_own_normals():
    mesh = built("ridges", 1.0, 0.0)
    cusp = np.flatnonzero(np.abs(mesh.vertices[:, 0]) < 1e-9)
    assert len(cusp) == 4
    assert len(np.unique(mesh.vertices[cusp], axis=0)) == 2
    np.testing.assert_allclose(sorted(mesh.vertex_normals[cusp, 0]), [-0.5, -0.5, 0.5, 0.5], atol=4 * EPS)


def test_protrusion_is_one_minus_the_floor():
    one, other = (
        Cylinders(distance=3.0, **height).build(0) for height in ({"protrusion": 0.25}, {"floor_height": 0.75})
    )
    assert np.array_equal(one.vertices, other.vertices)


def test_chords_are_uniform_in_the_normal_angle():
    normals = built("ridges", 2.0, 0.0, chords=90).vertex_normals
    angles = np.unique(np.degrees(np.arctan2(normals[:, 0], normals[:, 2])).round(9))
    np.testing.assert_allclose(np.diff(angles), 2.0, atol=1e-8)
    assert (angles[0], angles[-1]) == (-90, 90)


def test_v_grooves_have_equal_widths_and_coplanar_edges():
    mesh = VGrooves(m=0.7, grooves=50, width=3.0).build(2)
    x, z = mesh.vertices[:101, 0], mesh.vertices[:101, 2]
    np.testing.assert_allclose(np.diff(x), 1.5, rtol=1e-13)
    assert np.all(z[0::2] == 0)
    assert np.all(z[1::2] < 0)
    assert mesh.period == (150.0, 150.0)
    mesh.check()


def facet_slopes(mesh):
    """tan of the facet angle of each groove, and the check that both flanks have it."""
    normals = mesh.normals()[::2]
    slopes = normals[:, 0] / normals[:, 2]
    np.testing.assert_allclose(slopes[0::2], -slopes[1::2], rtol=1e-12)
    return slopes[0::2]


@pytest.mark.parametrize("m", [0.2, 1.0])
def test_v_groove_slopes_are_stratified_beckmann_slopes(m):
    """P(tan < t) = 1 - exp(-t²/m²): one slope in each of 500 equal shares, in no order."""
    slopes = facet_slopes(VGrooves(m=m, grooves=500).build(9))
    shares = np.floor((1 - np.exp(-((slopes / m) ** 2))) * 500).astype(int)
    assert sorted(shares) == list(range(500))
    assert np.abs(np.corrcoef(shares, np.arange(500))[0, 1]) < 5 / np.sqrt(500)
    assert slopes.max() <= m * np.sqrt(-np.log(1e-4)) * (1 + 1e-12)


def test_strips_are_stratified_each_and_together():
    surface = VGrooves(m=0.5, grooves=20)
    tiles = [facet_slopes(surface.build(4, k, 25)) for k in range(25)]
    shares = [1 - np.exp(-((s / 0.5) ** 2)) for s in tiles]
    assert all(sorted(np.floor(s * 20).astype(int)) == list(range(20)) for s in shares)
    assert sorted(np.floor(np.concatenate(shares) * 500).astype(int)) == list(range(500))
    # No tile is steeper than another by design: within its shares each takes any of the 25 places.
    places = np.floor(np.array(shares) * 500) % 25
    error = np.sqrt((25**2 - 1) / 12 / 20)
    assert np.abs(places.mean(axis=1) - 12).max() < 4.5 * error  # 25 means, 2e-4 in all
    with pytest.raises(ValueError, match="realisation = 25: expected 0 to 24"):
        surface.build(4, 25, 25)


def test_a_fixed_angle_is_the_angle_of_every_facet():
    mesh = VGrooves(angle=37.0, grooves=4).build(0)
    np.testing.assert_allclose(np.degrees(np.arctan(np.abs(facet_slopes(mesh)))), 37.0, rtol=1e-14)
    assert mesh.statistics().rms_slope_x == pytest.approx(np.tan(np.radians(37.0)), rel=1e-14)


def test_flat_is_flat():
    field = Flat(side=7.0).build(0)
    assert field.period == (7.0, 7.0)
    assert not field.heights.any()


@pytest.mark.parametrize(
    ("recipe", "wrong", "sentence"),
    [
        (
            Cylinders,
            {"floor_height": 0.0, "protrusion": 0.5},
            "floor_height = 0 and protrusion = 0.5.*give one of them",
        ),
        (Cylinders, {"floor_height": 1.0}, "less than 1"),
        (Cylinders, {"distance": 0.0}, "greater than 0"),
        (Cylinders, {"profile": "bumps"}, "'ridges' or 'grooves'"),
        (Cylinders, {"chords": 3}, "greater than or equal to 8"),
        (VGrooves, {}, "m is missing: give either m .* or angle"),
        (VGrooves, {"m": 0.5, "angle": 45.0}, "m = 0.5 and angle = 45: give either"),
        (VGrooves, {"angle": 90.0}, "less than 90"),
        (VGrooves, {"m": -1.0}, "greater than 0"),
        (VGrooves, {"m": 0.5, "grooves": 0}, "greater than or equal to 1"),
        (Flat, {"side": 0.0}, "greater than 0"),
    ],
)
def test_bad_parameters_are_refused(recipe, wrong, sentence):
    with pytest.raises(ValidationError, match=sentence):
        recipe(**wrong)
