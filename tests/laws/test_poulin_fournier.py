"""Poulin and Fournier's cylinders: reference tables, ray casting in the plane, walks along the cone, limits."""

import itertools

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import quad
from specimens import GRID, reference_table

import microsurfaces as ms
from gonio.detectors import Apertures, HemisphereGrid, Klems
from gonio.models import (
    GGX,
    Beckmann,
    CookTorrance,
    Lambert,
    Microfacet,
    PoulinFournier,
    SmithCorrelated,
    SmithSeparable,
    Unmasked,
    VCavity,
)
from gonio.models.cylinders import edge_angle, shared, strip_width, visible
from gonio.optics import Conductor, Dielectric, Lambertian, Mirror
from gonio.sphere import angles, direction, rotate_z


def cylinders(local, kind="ridges", d=2.0, h=0.0, **more):
    return PoulinFournier(local=local, profile=kind, distance=d, floor_height=h, **more)


def rough(masking, distribution=Beckmann(0.3), material=Mirror()):  # noqa: B008 - frozen recipes
    return Microfacet(distribution=distribution, masking=masking, material=material)


def profile(kind, d, h):
    return kind == "ridges", d, edge_angle(d, h), strip_width(d, h)


# --- Tables -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", reference_table("table_pf"))
def test_reference_table(row):
    kind, value = row["kind"] + "s", {name: float(x) for name, x in row.items() if name != "kind"}
    d, h = value["d"], value["h"]
    wi, wo = direction(value["th_l"], value["az_l"]), direction(value["th_v"], value["az_v"])
    psi_i, psi_o = (np.arctan2(w[0], w[2]) for w in (wi, wo))
    phi1, phi2, strip = shared(*profile(kind, d, h), psi_i, psi_o)
    if phi2 > phi1:
        assert (phi1, phi2) == pytest.approx((value["phi1"], value["phi2"]), rel=1e-12, abs=1e-12)
    else:
        assert value["phi1"] == value["phi2"]
    assert strip == pytest.approx(value["w_lv"], rel=1e-8, abs=1e-14)
    plain, cavity = (
        cylinders(local, kind, d, h) for local in (rough(Unmasked()), CookTorrance(m=0.3, material=Mirror()))
    )
    for model, name in (
        (cylinders(Lambertian(1.0), kind, d, h), "f_diffuse(rho=1)"),
        (plain, "f_CT(m=.3,G=1,F=1)"),
        (cavity, "f_CT(m=.3,Vcav,F=1)"),
        (cylinders(rough(VCavity()), kind, d, h), "f_CT(m=.3,Vcav,F=1)"),
    ):
        assert model.eval(wi, wo)[0] == pytest.approx(value[name], rel=1e-8, abs=1e-14), name
    density = cylinders(Mirror(), kind, d, h).line_density(wi, psi_o * (1 - 1e-12))
    assert density[0, 0] == pytest.approx(value["P_mirror(F=1)[1/rad]"], rel=1e-8, abs=1e-14)


# Reference A.10: kind, d, h, psi in degrees, phi_lo, phi_hi, xi_lo, xi_hi.
INTERVALS = """
ridges 2 0 20 -1.221730476 1.423635299 0 0
ridges 2 0 50 -0.6981317008 1.162271215 0 0
ridges 2 0 70 -0.3490658504 0.900262461 0 0
ridges 2 0 85 -0.0872664626 0.5121082551 0 0
ridges 2 0 -70 -0.900262461 0.3490658504 0 0
ridges 1 0 20 -0.5235987756 0.5235987756 0 0
ridges 1 0 50 -0.5235987756 0.5235987756 0 0
ridges 1 0 70 -0.3490658504 0.503597537 0 0
ridges 1 0 85 -0.0872664626 0.3333332005 0 0
ridges 1 0 -70 -0.503597537 0.3490658504 0 0
ridges 3 0.5 20 -1.047197551 1.047197551 0 1.267949192
ridges 3 0.5 50 -0.6981317008 1.047197551 0 1.174127566
ridges 3 0.5 70 -0.3490658504 1.047197551 0 0.5839089058
ridges 3 0.5 85 -0.0872664626 0.6526383016 0 0
ridges 3 0.5 -70 -1.047197551 0.3490658504 0.6840402867 1.267949192
ridges 2.2 0 20 -1.221730476 1.570796327 0 0.1358222275
ridges 2.2 0 50 -0.6981317008 1.299654417 0 0
ridges 2.2 0 70 -0.3490658504 0.9715738797 0 0
ridges 2.2 0 85 -0.0872664626 0.5423432782 0 0
ridges 2.2 0 -70 -0.9715738797 0.3490658504 0.2 0.2
grooves 2 0 20 -0.872664626 1.570796327 0 0
grooves 2 0 50 0.1745329252 1.570796327 0 0
grooves 2 0 70 0.872664626 1.570796327 0 0
grooves 2 0 85 1.396263402 1.570796327 0 0
grooves 2 0 -70 -1.570796327 -0.872664626 0 0
grooves 1 0 20 -0.5235987756 0.5235987756 0 0
grooves 1 0 50 -0.5235987756 0.5235987756 0 0
grooves 1 0 70 -0.1745329252 0.5235987756 0 0
grooves 1 0 85 0.3490658504 0.5235987756 0 0
grooves 1 0 -70 -0.5235987756 0.1745329252 0 0
grooves 3 0.5 20 -1.047197551 1.047197551 0 1.267949192
grooves 3 0.5 50 -0.3490658504 1.047197551 0 1.267949192
grooves 3 0.5 70 0.3490658504 1.047197551 0 1.267949192
grooves 3 0.5 85 0.872664626 1.047197551 0 1.267949192
grooves 3 0.5 -70 -1.047197551 -0.3490658504 0 1.267949192
"""


@pytest.mark.parametrize("line", INTERVALS.strip().splitlines())
def test_visible_intervals(line):
    kind, *numbers = line.split()
    d, h, psi, *expected = map(float, numbers)
    assert visible(*profile(kind, d, h), np.radians(psi)) == pytest.approx(expected, abs=2e-9)


# --- Geometry ---------------------------------------------------------------------------------------------------------


def random_profiles(count, seed):
    rng = np.random.default_rng(seed)
    kinds = rng.choice(["ridges", "grooves"], count)
    heights = np.where(rng.random(count) < 0.4, 0.0, rng.uniform(0, 0.95, count))
    psi = np.where(rng.random(count) < 0.2, np.pi / 2 - 10 ** rng.uniform(-3, 0, count), rng.uniform(-1.5, 1.5, count))
    return zip(kinds, rng.uniform(0.1, 5.0, count), heights, psi, strict=True)


def test_what_is_seen_fills_the_picture():
    for kind, d, h, psi in random_profiles(2000, 1):
        lo, hi, xi_lo, xi_hi = visible(*profile(kind, d, h), psi)
        # A groove's normals lean the other way than its points, so that the same formula serves.
        seen = np.sin(hi - psi) - np.sin(lo - psi) + (xi_hi - xi_lo) * np.cos(psi)
        assert seen == pytest.approx(d * np.cos(psi), rel=1e-11, abs=1e-13)


def heights(kind, d, h, x):
    """The profile z(x) of reference A.1."""
    offset = (x + d / 2) % d - d / 2
    top = np.sqrt(np.maximum(1 - offset**2, 0.0))
    return np.maximum(h, top) if kind == "ridges" else -np.maximum(h, top)


def test_visible_intervals_against_rays():
    """Points of the arc well inside the interval see the direction, points well outside do not."""
    for kind, d, h, psi in random_profiles(150, 2):
        if abs(psi) > 1.45:
            continue  # the steps would be too long
        ridges, _, edge, _ = profile(kind, d, h)
        lo, hi, _, _ = visible(*profile(kind, d, h), psi)
        phi = np.linspace(-edge, edge, 61)[1:-1]
        x, z = (np.sin(phi), np.cos(phi)) if ridges else (-np.sin(phi), -np.cos(phi))
        reach = (1.0 - z) / np.cos(psi) + 1e-3
        t = np.linspace(1e-3, 1.0, 3000) * reach[:, None]
        clear = (z[:, None] + t * np.cos(psi) > heights(kind, d, h, x[:, None] + t * np.sin(psi)) - 1e-9).all(axis=1)
        clear &= np.cos(phi - psi) > 0
        margin = 0.02
        assert clear[(phi > lo + margin) & (phi < hi - margin)].all(), (kind, d, h, psi)
        assert not clear[(phi < lo - margin) | (phi > hi + margin)].any(), (kind, d, h, psi)


# --- Diffusers and rough mirrors --------------------------------------------------------------------------------------

LOCALS = [
    Lambertian(0.8),
    CookTorrance(m=0.3, material=Conductor("Cu"), k_d=0.2, k_s=0.8, reflectance=0.5),
    CookTorrance(scales=((0.1, 0.3), (0.4, 0.7)), material=Mirror()),
    rough(Unmasked()),
    rough(VCavity(), GGX(0.2)),
    rough(SmithCorrelated()),
    rough(SmithSeparable(), GGX(0.3), Dielectric(eta=1.5)),
]
PROFILES = [
    ("ridges", 2.0, 0.0),
    ("ridges", 3.0, 0.4),
    ("ridges", 1.0, 0.0),
    ("grooves", 2.0, 0.0),
    ("grooves", 3.0, 0.5),
]


def by_quadrature(model, wi, wo):
    """The integral of A.4 over the arc, the local model turned into the frame of every normal, by adaptive rules."""
    kind, d, h = model.profile, model.distance, model.floor_height
    local = Lambert(model.local.reflectance) if isinstance(model.local, Lambertian) else model.local
    psi_i, psi_o = (np.arctan2(w[0], w[2]) for w in (wi, wo))
    phi1, phi2, strip = shared(*profile(kind, d, h), psi_i, psi_o)

    def integrand(phi):
        c, s = np.cos(phi), np.sin(phi)
        turn = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        return local.eval(turn @ wi, turn @ wo)[0] * np.cos(phi - psi_i) * np.cos(phi - psi_o)

    wh = wi + wo
    peak = np.arctan2(wh[0], wh[2])
    points = sorted({phi1, *np.clip(peak + np.array([-0.5, -0.1, 0, 0.1, 0.5]), phi1, phi2), phi2})
    parts = [
        quad(integrand, a, b, epsabs=1e-13, epsrel=1e-10, limit=500)[0]
        for a, b in itertools.pairwise(points)
        if phi2 > phi1
    ]
    return sum(parts) / (d * np.cos(psi_i) * np.cos(psi_o)) + strip / d * local.eval(wi, wo)[0]


@pytest.mark.parametrize("local", LOCALS, ids=repr)
@pytest.mark.parametrize(("kind", "d", "h"), PROFILES)
def test_values_are_the_integral_over_the_arc(local, kind, d, h):
    model = cylinders(local, kind, d, h)
    rng = np.random.default_rng(3)
    for _ in range(5):
        wi, wo = (direction(rng.uniform(0, 85), rng.uniform(0, 360)) for _ in range(2))
        expected = by_quadrature(model, wi, wo)
        assert model.eval(wi, wo)[0] == pytest.approx(expected, rel=5e-8, abs=1e-12)  # of the adaptive rule


@pytest.mark.parametrize("local", LOCALS, ids=repr)
@pytest.mark.parametrize(("kind", "d", "h"), PROFILES)
def test_reciprocal_and_not_negative(local, kind, d, h):
    model = cylinders(local, kind, d, h, groups=((0.3, 20.0), (0.7, 110.0)))
    rng = np.random.default_rng(4)
    wi, wo = (direction(rng.uniform(0, 89.5, 2000), rng.uniform(0, 360, 2000)) for _ in range(2))
    forward, backward = model.eval(wi, wo, (450.0, 650.0)), model.eval(wo, wi, (450.0, 650.0))
    assert (forward >= 0).all()
    np.testing.assert_allclose(forward, backward, rtol=1e-8, atol=1e-11)
    assert model.eval(direction(100.0), direction(0.0))[0] == 0.0


def test_known_numbers_of_diffusers():
    up = direction(0.0)
    assert cylinders(Lambertian(0.8)).eval(up, up)[0] == pytest.approx(0.2, rel=1e-14)
    for kind, expected in (("ridges", 0.8020), ("grooves", 2 / 3)):
        energy = GRID.projected_solid_angles() @ cylinders(Lambertian(1.0), kind).average(up, GRID)
        assert energy[0] == pytest.approx(expected, abs=5e-5)


@pytest.mark.parametrize("local", [Lambertian(1.0), CookTorrance(m=0.3, material=Mirror()), rough(SmithCorrelated())])
@pytest.mark.parametrize("theta", [0.0, 50.0, 80.0])
def test_no_energy_is_created(local, theta):
    for kind in ("ridges", "grooves"):
        average = cylinders(local, kind, 2.5, 0.2).average(direction(theta, 30.0), GRID)
        assert (GRID.projected_solid_angles() @ average)[0] <= 1 + 1e-5


# --- Mirrors ----------------------------------------------------------------------------------------------------------


def energy(model, psi, order=1, azimuth=0.0):
    grid = HemisphereGrid(5.0, 15.0)
    return (grid.projected_solid_angles() @ model.average(direction(psi, azimuth), grid, order=order))[0]


@pytest.mark.parametrize(("kind", "d", "expected"), [
    ("ridges", 2.0, (0.64039, 0.69096, 0.96353, 0.98880)),
    ("grooves", 2.0, (0.5, 0.56858, 0.67365, 0.66742)),
    ("grooves", 1.0, (1.0, 1.0, 0.87939, 1.0)),
    ("ridges", 1.0, (1.0, 0.94244, 0.92129, 0.97708)),
])  # fmt: skip
def test_shares_of_single_reflections(kind, d, expected):
    for psi, share in zip((0.0, 30.0, 60.0, 80.0), expected, strict=True):
        assert energy(cylinders(Mirror(), kind, d), psi) == pytest.approx(share, abs=6e-6)


def test_orders_inside_half_pipes():
    model = cylinders(Mirror(), "grooves")
    shares = [energy(model, 0.0, order) for order in range(1, 5)]
    assert shares == pytest.approx((0.5, 0.30902, 0.09195, 0.03872), abs=6e-6)
    for d, h, psi in ((2.0, 0.0, 0.37), (2.0, 0.0, 33.3), (3.0, 0.5, 61.7), (1.0, 0.0, 80.4)):
        model = cylinders(Mirror(), "grooves", d, h)
        assert sum(energy(model, psi, order, 25.0) for order in range(1, 400)) == pytest.approx(1.0, abs=2e-5)


def walked(model, wi, orders, count=400_000):
    """Every reflection inside a circle followed one by one: directions, orders, weights and Fresnel cosines."""
    d, h = model.distance, model.floor_height
    psi, across = np.arctan2(wi[0], wi[2]), np.hypot(wi[0], wi[2])
    edge = edge_angle(d, h)
    lo, hi, _, _ = visible(*profile(model.profile, d, h), psi)
    phi = lo + (hi - lo) * (np.arange(count) + 0.5) / count
    weight = np.cos(phi - psi) * (hi - lo) / count / (d * np.cos(psi))
    # The direction of travel, reflected about the normal of every hit; the next hit lies where the chord ends.
    incoming, place, hits = np.full(count, psi), phi.copy(), np.ones(count, int)
    while True:
        outgoing = 2 * place - incoming
        i = place - incoming
        following = place + 2 * i - np.pi * np.sign(i)
        again = (np.abs(following) <= edge) & (hits <= orders)
        if not again.any():
            break
        incoming = np.where(again, np.pi + outgoing, incoming)
        incoming = np.where(again, (incoming + np.pi) % (2 * np.pi) - np.pi, incoming)
        place = np.where(again, following, place)
        hits += again
        # All directions are those that light comes from, as seen from the next hit.
        incoming = np.where(again & (np.cos(place - incoming) < 0), incoming + np.pi, incoming)
    outgoing = 2 * place - incoming
    wo = np.stack([across * np.sin(outgoing), np.full(count, -wi[1]), across * np.cos(outgoing)], axis=-1)
    return wo, hits, weight, np.abs(np.cos(phi - psi)) * across


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("detector", [
    GRID, Apertures(directions=((30.0, 170.0), (40.0, 200.0), (50.0, 215.0), (20.0, 120.0)), half_angle=12.0),
    Klems("quarter"),
], ids=("grid", "apertures", "patches"))  # fmt: skip
def test_bins_against_a_walk(order, detector):
    gold = Conductor(eta=0.2, k=3.0)
    model = cylinders(gold, "grooves", 2.0, 0.0)
    for wi in (direction(35.0, 25.0), direction(20.0, 0.0), direction(50.0, 90.0), direction(61.7, 300.0)):
        wo, hits, weight, cosine = walked(model, wi, order)
        chosen = hits == order
        weight = weight * gold.reflectance(cosine, 550.0)[:, 0] ** order
        if isinstance(detector, Apertures):
            seen = wo[chosen] @ detector.axes.T >= np.cos(np.radians(detector.half_angle))
            expected = weight[chosen] @ seen
        elif isinstance(detector, Klems):
            theta, phi = angles(wo[chosen])
            ring = np.searchsorted([9.0, 27.0, 45.0, 63.0], theta, side="right")
            count, first = np.array([1, 8, 12, 12, 8])[ring], np.array([0, 1, 9, 21, 33])[ring]
            expected = np.bincount(first + np.rint(phi * count / 360).astype(int) % count, weight[chosen], 41)
        else:
            theta, phi = angles(wo[chosen])
            ring = np.searchsorted(detector.theta_edges, theta, side="right") - 1
            sector = np.floor((phi - angles(wi)[1]) / 15 + 0.5).astype(int) % 24
            expected = np.bincount(ring * 24 + np.where(ring == 0, 0, sector), weight[chosen], detector.bins)
        share = model.average(wi, detector, order=order)[:, 0] * detector.projected_solid_angles()
        if isinstance(detector, HemisphereGrid):
            share[:24] = [share[:24].sum(), *[0.0] * 23]  # the walk puts the polar cap into one bin
        np.testing.assert_allclose(share, expected, atol=1.5e-5)
    assert share.shape == (detector.bins,)


def test_ridges_against_reflected_rays():
    """Rays that leave a ridge are followed over the neighbours' circles."""
    model = cylinders(Mirror(), "ridges", 2.4, 0.3)
    wi = direction(35.0, 20.0)
    psi, across = np.arctan2(wi[0], wi[2]), np.hypot(wi[0], wi[2])
    lo, hi, _, _ = visible(*profile("ridges", 2.4, 0.3), psi)
    phi = lo + (hi - lo) * (np.arange(200_000) + 0.5) / 200_000
    out = 2 * phi - psi
    away = np.cos(out) > 0
    for k in (-2, -1, 1, 2):
        # The line from (sin phi, cos phi) passes the neighbour's axis at this distance.
        miss = np.abs((2.4 * k - np.sin(phi)) * np.cos(out) + np.cos(phi) * np.sin(out))
        ahead = (2.4 * k - np.sin(phi)) * np.sin(out) - np.cos(phi) * np.cos(out) > 0
        away &= ~((miss < 1) & ahead)
    weight = np.where(away, np.cos(phi - psi), 0.0) * (hi - lo) / phi.size / (2.4 * np.cos(psi))
    wo = np.stack([across * np.sin(out), np.full(phi.size, -wi[1]), across * np.cos(out)], axis=-1)
    theta, azimuth = angles(wo)
    ring = np.searchsorted(GRID.theta_edges, np.minimum(theta, 90), side="right").clip(1, 18) - 1
    sector = np.floor((azimuth - 20.0) / 15 + 0.5).astype(int) % 24
    expected = np.bincount(ring * 24 + sector, weight, GRID.bins)
    strip = model.strip_share(wi)[0]
    expected[np.ravel_multi_index((7, 12), GRID.shape)] += strip
    assert strip > 0.01
    share = model.average(wi, GRID)[:, 0] * GRID.projected_solid_angles()
    np.testing.assert_allclose(share, expected, atol=2e-5)
    psi_o = (np.arange(20_000) + 0.5) * np.pi / 20_000 - np.pi / 2
    line = model.line_density(wi, psi_o)[:, 0].mean() * np.pi
    assert line + strip == pytest.approx(share.sum(), abs=2e-4)


# --- Limits, groups, recipes ------------------------------------------------------------------------------------------


def test_the_flat_limits():
    wi = direction(40.0, 30.0)
    for kind in ("ridges", "grooves"):
        for d, h in ((1e-3, 0.0), (1e5, 0.0), (3.0, 1 - 1e-9)):
            share = cylinders(Mirror(), kind, d, h).average(wi, GRID)[:, 0] * GRID.projected_solid_angles()
            assert share[np.ravel_multi_index((8, 12), GRID.shape)] == pytest.approx(1.0, abs=1e-3)
            value = cylinders(Lambertian(0.6), kind, d, h).eval(wi, direction(30.0, 200.0))[0]
            assert value == pytest.approx(0.6 / np.pi, rel=1e-3)


@pytest.mark.parametrize("local", [Lambertian(0.8), rough(VCavity()), Mirror()], ids=repr)
def test_woven_cylinders_look_the_same_after_a_quarter_turn(local):
    model = cylinders(local, groups=((0.5, 0.0), (0.5, 90.0)))
    first, second = (model.average(direction(40.0, phi), GRID) for phi in (17.0, 107.0))
    np.testing.assert_allclose(first, second, rtol=1e-4, atol=1e-9)
    turned = cylinders(local, groups=((1.0, 30.0),)).average(direction(40.0, 47.0), GRID)
    np.testing.assert_allclose(turned, cylinders(local).average(direction(40.0, 17.0), GRID), rtol=1e-4, atol=1e-9)


def test_a_mirror_has_no_values_and_says_so():
    with pytest.raises(ValueError, match="use average"):
        cylinders(Conductor("Au")).eval(direction(0.0), direction(0.0))
    with pytest.raises(ValueError, match="one reflection only"):
        cylinders(Mirror()).average(direction(0.0), GRID, order=2)
    with pytest.raises(ValueError, match="beyond one reflection"):
        cylinders(Lambertian(0.5)).average(direction(0.0), GRID, order=2)


def test_recipes_and_specimens():
    surface = ms.Cylinders(profile="grooves", distance=3.0, protrusion=0.5)
    model = PoulinFournier.of({}, Lambertian(0.5), surface)
    assert model == PoulinFournier(local=Lambertian(0.5), profile="grooves", distance=3.0, protrusion=0.5)
    same = PoulinFournier(local=Lambertian(0.5), profile="grooves", distance=3.0, floor_height=0.5)
    wi, wo = direction(40.0, 10.0), direction(30.0, 150.0)
    assert model.eval(wi, wo) == same.eval(wi, wo)
    with pytest.raises(ValueError, match="not known to be made of them"):
        PoulinFournier.of({}, Mirror(), ms.Flat())
    for wrong, words in (
        ({"floor_height": 0.1, "protrusion": 0.9}, "give one of them"),
        ({"groups": ((0.5, 0.0),)}, "sum to 0.5"),
        ({"local": rough(VCavity(), Beckmann(alpha_x=0.1, alpha_y=0.2))}, "must be isotropic"),
    ):
        with pytest.raises(ValidationError, match=words):
            PoulinFournier(**{"local": Mirror(), **wrong})
    assert rotate_z(wi, 0.0) == pytest.approx(wi)
