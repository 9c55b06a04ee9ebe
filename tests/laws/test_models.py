"""Models: reference tables, reciprocity, furnaces, limits, and bin averages to their stated tolerance."""

import time

import numpy as np
import pytest
from adaptive_quadrature import bin_average
from example_models import MODELS, smith
from pydantic import TypeAdapter, ValidationError
from specimens import GRID, reference_table

from gonio.detectors import Apertures, HemisphereGrid
from gonio.models import (
    GGX,
    Beckmann,
    CookTorrance,
    Lambert,
    Microfacet,
    Mixture,
    Model,
    OrenNayar,
    PoulinFournier,
    SmithCorrelated,
    SmithSeparable,
    Unmasked,
    VCavity,
    matching,
)
from gonio.models.averages import TOLERANCE
from gonio.models.cook_torrance import NORMALISATIONS
from gonio.optics import Conductor, Dielectric, Lambertian, Mirror
from gonio.sphere import direction, half_vector, rotate_z
from microsurfaces import Cylinders, Gaussian
from microsurfaces.recipe import members

ELSEWHERE = {"SmithMultipleScattering"}
"""Models that are random, and tested by themselves."""
MATERIALS = {
    "F=1": Mirror(),
    "n=1.5": Dielectric(eta=1.5),
    "n=0.2,k=3.9": Conductor(eta=0.2, k=3.9),
    "n=1.1,k=6.85": Conductor(eta=1.1, k=6.85),
}


def micro(distribution, masking, material=Mirror()):  # noqa: B008 - a frozen recipe
    return Microfacet(distribution=distribution, masking=masking, material=material)


def pairs(count, seed=1):
    """Random pairs of directions above the horizon, some of them grazing."""
    rng = np.random.default_rng(seed)
    theta = np.concatenate([rng.uniform(0, 89.9, (count // 2, 2)), 90 - 10 ** rng.uniform(-6, 1, (count // 2, 2))])
    phi = rng.uniform(0, 360, theta.shape)
    return direction(theta[:, 0], phi[:, 0]), direction(theta[:, 1], phi[:, 1])


def albedo(model, theta_i, grid=GRID, wavelengths=(550.0,)):
    return grid.projected_solid_angles() @ model.average(direction(theta_i, 20.0), grid, wavelengths)


# --- Values -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", reference_table("table_ct"))
def test_reference_table(row):
    wi, wo = direction(float(row["th_l"]), float(row["ph_l"])), direction(float(row["th_v"]), float(row["ph_v"]))
    wh, m, material = half_vector(wi, wo), float(row["m"]), MATERIALS[row["Fresnel"]]
    ours = {
        "F": material.reflectance(wi @ wh, 550.0)[0],
        "D_Walter": Beckmann(m).density(wh),
        "G_Vcav": VCavity().g2(None, wi, wo, wh),
        "f CT (V-cavity = slides, 1/pi)": CookTorrance(m=m, material=material).eval(wi, wo)[0],
        "f Smith sep.": micro(Beckmann(m), SmithSeparable(), material).eval(wi, wo)[0],
        "f Smith corr.": smith(m, material).eval(wi, wo)[0],
        "f GGX Smith corr. (alpha=m)": micro(GGX(m), SmithCorrelated(), material).eval(wi, wo)[0],
    }
    for name, value in ours.items():
        assert value == pytest.approx(float(row[name]), rel=1e-12), name


EXTRA = {
    "Beckmann m_x=0.15 m_y=0.45, F=1": Beckmann(alpha_x=0.15, alpha_y=0.45),
    "GGX a_x=0.15 a_y=0.45, F=1": GGX(alpha_x=0.15, alpha_y=0.45),
    "0.4*m(0.15)+0.6*m(0.5), F=1": Mixture(components=((0.4, Beckmann(0.15)), (0.6, Beckmann(0.5)))),
}


@pytest.mark.parametrize("row", reference_table("table_ct_extra"))
def test_reference_table_of_anisotropy_and_scales(row):
    wi, wo = direction(float(row["th_l"]), float(row["ph_l"])), direction(float(row["th_v"]), float(row["ph_v"]))
    distribution = EXTRA[row["model"]]
    for masking, name in ((VCavity(), "f V-cavity"), (SmithCorrelated(), "f Smith corr.")):
        assert micro(distribution, masking).eval(wi, wo)[0] == pytest.approx(float(row[name]), rel=1e-12)
    parameters = {"Bec": {"m_x": 0.15, "m_y": 0.45}, "0.4": {"scales": ((0.15, 0.4), (0.5, 0.6))}}.get(row["model"][:3])
    if parameters:
        turned = CookTorrance(material=Mirror(), rotation=33.0, **parameters).eval(*rotate_z((wi, wo), 33.0))
        assert turned[0] == pytest.approx(float(row["f V-cavity"]), rel=1e-11)


@pytest.mark.parametrize(("name", "factor"), [
    ("microsurface", 1), ("textbook", 1), ("half", 1 / 2), ("printed_1982", 4), ("pi_for_four", 4 / np.pi),
    ("four_for_pi", np.pi),
])  # fmt: skip
def test_normalisations_in_circulation(name, factor):
    """Prefactor and distribution as reference B.1 lists them, E = exp(-tan^2 / m^2) / cos^4."""
    prefactor, denominator = {
        "microsurface": (1 / 4, np.pi), "textbook": (1 / np.pi, 4), "half": (1 / (2 * np.pi), 4),
        "printed_1982": (1 / np.pi, 1), "pi_for_four": (1 / np.pi, np.pi), "four_for_pi": (1 / 4, 1),
    }[name]  # fmt: skip
    wi, wo = direction([20.0, 60.0], 10.0), direction([40.0, 70.0], 150.0)
    wh, m = half_vector(wi, wo), 0.4
    lobe = np.exp(-(1 / wh[:, 2] ** 2 - 1) / m**2) / wh[:, 2] ** 4 / (denominator * m**2)
    expected = prefactor * lobe * VCavity().g2(None, wi, wo, wh) / (wi[:, 2] * wo[:, 2])
    model = CookTorrance(m=m, material=Mirror(), normalisation=name)
    np.testing.assert_allclose(model.eval(wi, wo)[:, 0], expected, rtol=1e-11)
    assert factor == pytest.approx(NORMALISATIONS[name], rel=1e-15)
    energy = albedo(model, 30.0)[0] / albedo(CookTorrance(m=m, material=Mirror()), 30.0)[0]
    assert energy == pytest.approx(factor, rel=1e-9)


@pytest.mark.parametrize("m", [1e-3, 0.05, 0.3, 1.0, 5.0])
def test_straight_above_it_is_one_over_4_pi_m2(m):
    up = direction(0.0)
    for model in (CookTorrance(m=m, material=Mirror()), smith(m)):
        assert model.eval(up, up)[0] == pytest.approx(1 / (4 * np.pi * m * m), rel=1e-14)
    assert CookTorrance(m=0.3, material=Mirror()).eval(up, up)[0] == pytest.approx(0.884194, rel=1e-6)


def test_the_normalisation_is_that_of_the_textbooks_with_1_over_pi_and_4_m2():
    wi, wo = pairs(200)
    wh, m = half_vector(wi, wo), 0.4
    tan2 = (wh[:, 0] ** 2 + wh[:, 1] ** 2) / wh[:, 2] ** 2
    textbook = (
        np.exp(-tan2 / m**2)
        / (4 * m**2 * wh[:, 2] ** 4)
        * VCavity().g2(None, wi, wo, wh)
        / (np.pi * wi[:, 2] * wo[:, 2])
    )
    ours = CookTorrance(m=m, material=Mirror()).eval(wi, wo)[:, 0]
    np.testing.assert_allclose(ours, textbook, rtol=1e-9, atol=1e-290)


def test_weights_of_the_diffuse_and_the_specular_part():
    wi, wo, gold = direction(30.0, 5.0), direction(40.0, 170.0), Conductor("Au")
    lobe = CookTorrance(m=0.3, material=gold).eval(wi, wo, (450.0, 650.0))
    mixed = CookTorrance(m=0.3, material=gold, k_d=0.25, k_s=0.6, reflectance=0.5).eval(wi, wo, (450.0, 650.0))
    np.testing.assert_allclose(mixed, 0.25 * 0.5 / np.pi + 0.6 * lobe, rtol=1e-14)


def test_colour_is_the_materials():
    wi, wo, gold = direction(30.0), direction(40.0, 170.0), Conductor("Au")
    wavelengths = (400.0, 550.0, 700.0)
    white = smith(0.3).eval(wi, wo)
    expected = white * gold.reflectance(wi @ half_vector(wi, wo), wavelengths)
    np.testing.assert_allclose(smith(0.3, gold).eval(wi, wo, wavelengths), expected, rtol=1e-13)


# --- Laws, for every model --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS, ids=repr)
def test_reciprocal_finite_and_not_negative(model):
    wi, wo = pairs(20_000)
    forward, backward = model.eval(wi, wo, (450.0, 650.0)), model.eval(wo, wi, (450.0, 650.0))
    assert forward.shape == (20_000, 2)
    assert np.isfinite(forward).all()
    assert (forward >= 0.0).all()
    np.testing.assert_allclose(forward, backward, rtol=1e-11, atol=1e-290)


@pytest.mark.parametrize("model", MODELS, ids=repr)
def test_nothing_below_the_horizon_and_nothing_lost_by_broadcasting(model):
    up, level, down = direction(10.0), direction(90.0) * [1, 1, 0], direction(120.0, 30.0)
    for wi, wo in ((up, down), (down, up), (down, down), (up, level), (level, up), (level, -level)):
        assert model.eval(wi, wo)[0] == 0.0
    grid = model.eval(direction([[0.0], [40.0]]), direction([10.0, 50.0, 100.0], 60.0), (400.0, 500.0))
    assert grid.shape == (2, 3, 2)
    assert (grid[:, 2] == 0.0).all()
    one = model.eval(direction(40.0), direction(50.0, 60.0), 500.0)
    np.testing.assert_allclose(grid[1, 1, 1:], one, rtol=1e-14)
    assert (model.average(down, HemisphereGrid(15.0, 30.0)) == 0.0).all()


@pytest.mark.parametrize("model", MODELS, ids=repr)
@pytest.mark.parametrize("theta_i", [0.0, 30.0, 60.0, 80.0, 88.0, 89.9])
def test_no_model_creates_energy(model, theta_i):
    assert albedo(model, theta_i, wavelengths=(450.0, 650.0)).max() <= 1.0 + TOLERANCE


def test_every_model_has_an_example():
    assert {type(model).__name__ for model in MODELS} == set(members(Model)) - ELSEWHERE


@pytest.mark.parametrize("model", MODELS, ids=repr)
def test_models_are_recipes(model):
    adapter = TypeAdapter(Model)
    assert adapter.validate_json(adapter.dump_json(model, exclude_none=True)) == model
    assert hash(model) == hash(adapter.validate_json(adapter.dump_json(model, exclude_none=True)))


# --- Furnaces ---------------------------------------------------------------------------------------------------------


def facets(nodes=150, alpha=0.5):
    """Facet normals and their D dw, over slopes: exact for Beckmann up to the quadrature."""
    u, weight = np.polynomial.legendre.leggauss(nodes)
    radius, azimuth = (u + 1) * 3.5, (np.arange(nodes) + 0.5) * 2 * np.pi / nodes
    slope = alpha * radius[:, None]
    wm = np.stack(np.broadcast_arrays(slope * np.cos(azimuth), slope * np.sin(azimuth), 1.0), axis=-1)
    length = np.linalg.norm(wm, axis=-1)
    jacobian = slope * alpha * (3.5 * weight)[:, None] * (2 * np.pi / nodes) / length**3
    return wm / length[..., None], jacobian


@pytest.mark.parametrize("alpha", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("theta", [0.0, 40.0, 75.0, 88.0])
def test_weak_white_furnace(alpha, theta):
    """The visible facets fill the picture: the integral of G1 <V, m> D is the cosine."""
    wm, solid = facets(alpha=alpha)
    wo = direction(theta, 33.0)
    seen = np.maximum(wm @ wo, 0.0) * Beckmann(alpha).density(wm) * solid
    g1 = 1.0 / (1.0 + Beckmann(alpha).smith_lambda(wo))
    # The edge where facets turn away from the eye limits the quadrature.
    assert (g1 * seen).sum() == pytest.approx(wo[2], rel=3e-4, abs=2e-5)


SHAPES = [
    GGX(0.4),
    GGX(alpha_x=0.15, alpha_y=0.6, rotation=25.0),
    Beckmann(alpha_x=0.15, alpha_y=0.6, rotation=-40.0),
    Mixture(components=((0.3, Beckmann(0.1)), (0.7, GGX(0.5)))),
]


def fine_hemisphere(rings=3000, sectors=128):
    """Directions and their dw, finer towards the pole."""
    u, weight = np.polynomial.legendre.leggauss(rings)
    u, weight = (u + 1) / 2, weight / 2
    theta = np.pi / 2 * u**2
    phi = (np.arange(sectors) + 0.5) * 2 * np.pi / sectors
    solid = np.sin(theta) * np.pi * u * weight * 2 * np.pi / sectors
    return direction(np.degrees(theta)[:, None], np.degrees(phi)), solid[:, None]


@pytest.mark.parametrize("distribution", SHAPES, ids=repr)
def test_facets_cover_the_plane_and_fill_the_picture(distribution):
    """The integral of D cos is 1, and that of G1 <V, m> D is the cosine: Smith's masking of any distribution."""
    wm, solid = fine_hemisphere()
    facets = distribution.density(wm) * solid
    assert (facets * wm[..., 2]).sum() == pytest.approx(1.0, rel=1e-6)
    for theta in (10.0, 60.0, 80.0):
        wo = direction(theta, 50.0)
        seen = (np.maximum(wm @ wo, 0.0) * facets).sum()
        assert seen / (1.0 + distribution.smith_lambda(wo)) == pytest.approx(wo[2], rel=2e-4)


@pytest.mark.parametrize("distribution", [Beckmann(0.5), GGX(0.5)], ids=repr)
@pytest.mark.parametrize("theta", [20.0, 60.0, 85.0])
def test_smith_lambda_is_the_slopes_beyond_the_line_of_sight(distribution, theta):
    """Lambda = integral of (q / mu - 1) P2(q) over slopes q above mu = cot theta (reference B.3)."""
    from scipy.integrate import quad

    a = 0.5
    gaussian = isinstance(distribution, Beckmann)

    def slopes(q):  # the density of the slope along one axis
        return np.exp(-((q / a) ** 2)) / (a * np.sqrt(np.pi)) if gaussian else a**2 / (2 * (a**2 + q**2) ** 1.5)

    mu = 1 / np.tan(np.radians(theta))
    expected = quad(lambda q: (q - mu) / mu * slopes(q), mu, np.inf, epsabs=1e-13, epsrel=1e-11)[0]
    assert distribution.smith_lambda(direction(theta)) == pytest.approx(expected, rel=1e-7)


def test_unmasked_facets_create_energy():
    """With G = 1 every facet that faces the source reflects all of its light, whatever stands before it."""
    free = micro(Beckmann(0.3), Unmasked())
    wm, solid = fine_hemisphere()
    for theta in (0.0, 80.0):
        wi = direction(theta)
        wo = 2 * (wm @ wi)[..., None] * wm - wi
        up = (wo[..., 2] > 0) & (wm @ wi > 0)
        expected = (np.where(up, wm @ wi * Beckmann(0.3).density(wm) / wi[2], 0.0) * solid).sum()
        assert albedo(free, theta)[0] == pytest.approx(expected, rel=1e-4)
    assert albedo(free, 80.0)[0] > 1.09


@pytest.mark.parametrize("alpha", [1e-3, 0.3, 5.0])
def test_area_of_the_facets_is_that_of_the_plane(alpha):
    wm, solid = facets(alpha=alpha)
    assert (Beckmann(alpha).density(wm) * wm[..., 2] * solid).sum() == pytest.approx(1 - np.exp(-(7.0**2)), rel=1e-10)


# Single-scatter albedos with F = 1: an independent integration over facets, and the published three decimals.
PRINTED = [
    (0.1, 75, 0.9699, 0.9751),
    (0.3, 0, 0.9955, 0.9997),
    (0.3, 45, 0.9567, 0.9671),
    (0.3, 75, 0.9273, 0.9025),
    (0.6, 0, 0.7975, 0.8562),
    (0.6, 45, 0.8263, 0.8331),
    (0.6, 75, 0.9333, 0.9055),
]


@pytest.mark.parametrize(("m", "theta_i", "grooves", "gaussian"), PRINTED)
def test_single_scatter_albedos(m, theta_i, grooves, gaussian):
    # The last printed digit comes from a coarser quadrature than ours; the law below checks the values to 1e-6.
    assert albedo(CookTorrance(m=m, material=Mirror()), theta_i)[0] == pytest.approx(grooves, abs=4e-4)
    assert albedo(smith(m), theta_i)[0] == pytest.approx(gaussian, abs=4e-4)


@pytest.mark.parametrize("m", [0.05, 0.3, 0.6, 1.0, 5.0])
def test_albedo_under_normal_light_is_one_integral(m):
    """Facets of slope t, a share 2 t / m^2 exp(-t^2 / m^2), send the light to twice their tilt if that is above."""
    from scipy.integrate import quad
    from scipy.special import erfc

    def visible(t, masked):
        cosine = np.cos(2 * np.arctan(t))
        a = cosine / (m * np.sqrt(1 - cosine**2)) if t > 0 else np.inf
        smith_lambda = (np.exp(-a * a) / (a * np.sqrt(np.pi)) - erfc(a)) / 2 if a < 20 else 0.0
        grooves = min(1.0, 2 * cosine)  # NH / VH = 1 here
        return 2 * t / m**2 * np.exp(-((t / m) ** 2)) * (grooves if masked == "grooves" else 1 / (1 + smith_lambda))

    for model, masked in ((CookTorrance(m=m, material=Mirror()), "grooves"), (smith(m), "smith")):
        exact = quad(visible, 0, 1 - 1e-15, args=(masked,), points=[3**-0.5], epsrel=1e-10, limit=500)[0]
        assert albedo(model, 0.0)[0] == pytest.approx(exact, rel=2e-6)


@pytest.mark.parametrize("alpha", [1e-3, 1e-2])
def test_the_smoother_the_closer_to_a_mirror(alpha):
    grid = GRID
    for model in (CookTorrance(m=alpha, material=Dielectric(eta=1.5)), smith(alpha, Dielectric(eta=1.5))):
        value = model.average(direction(30.0, 20.0), grid)[:, 0] * grid.projected_solid_angles()
        mirror = np.ravel_multi_index((6, 12), grid.shape)
        assert value.sum() == pytest.approx(0.04152262598, rel=3 * alpha**2 + TOLERANCE)
        assert value[mirror] / value.sum() == pytest.approx(1.0, abs=0.01 if alpha > 2e-3 else 1e-10)


# --- Bin averages -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "theta_i", "ring", "sector"),
    [
        (CookTorrance(m=0.05, material=Mirror()), 45.0, 3, 12),  # a narrow lobe in one wide bin
        (CookTorrance(m=0.05, material=Mirror()), 45.0, 3, 11),  # its flank
        (CookTorrance(m=0.6, material=Mirror()), 60.0, 2, 20),  # the kink of min() crosses the bin
        (smith(0.6), 75.0, 6, 12),
        (smith(0.2), 80.0, 5, 12),
    ],
)
def test_one_bin_against_adaptive_integration(model, theta_i, ring, sector):
    grid, wi = HemisphereGrid(15.0, 15.0), direction(theta_i, 20.0)
    index = int(np.ravel_multi_index((ring, sector), grid.shape))
    value = model.average(wi, grid)
    mean = (value[:, 0] @ grid.projected_solid_angles()) / np.pi
    assert value[index, 0] == pytest.approx(bin_average(model, wi, grid, index), rel=TOLERANCE, abs=TOLERANCE * mean)


@pytest.mark.parametrize("m", [0.05, 0.2, 0.6])
@pytest.mark.parametrize("theta_i", [0.0, 45.0, 80.0])
def test_wide_bins_are_sums_of_narrow_ones(m, theta_i):
    """Bins of 15 degrees hold 3 x 3 bins of 5 degrees exactly, and so must their energies."""
    wide, narrow, wi = HemisphereGrid(15.0, 15.0), HemisphereGrid(5.0, 5.0), direction(theta_i, 20.0)
    ring = np.searchsorted(wide.theta_edges, narrow.theta, side="right") - 1
    sector = np.round(narrow.dphi / 15.0).astype(int) % wide.shape[1]
    owner = np.ravel_multi_index(np.meshgrid(ring, sector, indexing="ij"), wide.shape).ravel()
    for model in (CookTorrance(m=m, material=Mirror()), smith(m)):
        parts = model.average(wi, narrow)[:, 0] * narrow.projected_solid_angles()
        whole = model.average(wi, wide)[:, 0]
        sums = np.bincount(owner, parts, wide.bins) / wide.projected_solid_angles()
        mean = parts.sum() / np.pi
        assert (np.abs(whole - sums) <= 2 * TOLERANCE * np.maximum(whole, mean)).all()
        assert whole @ wide.projected_solid_angles() == pytest.approx(parts.sum(), rel=TOLERANCE)


def test_a_full_hemisphere_of_one_degree_bins_is_quick():
    grid, gold = HemisphereGrid(1.0, 1.0), Conductor("Au")
    started = time.process_time()
    average = CookTorrance(m=0.3, material=gold).average(direction(45.0), grid, (450.0, 550.0, 650.0))
    assert average.shape == (32_760, 3)
    assert time.process_time() - started < 10.0


def test_a_small_aperture_sees_the_value_at_its_centre():
    detector = Apertures(directions=((30.0, 180.0), (40.0, 100.0)), half_angle=0.01)
    wi, model = direction(30.0, 0.0), smith(0.3, Conductor("Au"))
    expected = model.eval(wi, detector.axes, (450.0, 650.0))
    np.testing.assert_allclose(model.average(wi, detector, (450.0, 650.0)), expected, rtol=1e-5)


def test_an_aperture_around_a_narrow_lobe_receives_all_of_it():
    detector = Apertures(directions=((30.0, 180.0),), half_angle=15.0)
    for model in (CookTorrance(m=0.02, material=Mirror()), smith(0.02)):
        received = model.average(direction(30.0), detector)[0, 0] * detector.projected_solid_angles()[0]
        assert received == pytest.approx(1.0, abs=TOLERANCE)


def test_a_lobe_too_narrow_for_its_bin_is_told():
    with pytest.raises(ValueError, match="lobe too narrow for 1 bins of this detector"):
        smith(1e-3).average(direction(89.99, 20.0), HemisphereGrid(15.0, 15.0))


# --- Recipes ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Lambert(1.5), "less than or equal to 1"),
        (lambda: CookTorrance(m=-0.1, material=Mirror()), "greater than 0"),
        (
            lambda: CookTorrance(m=0.1, material=Mirror(), k_d=0.6, k_s=0.6),
            r"k_d \+ k_s = 0.6 \+ 0.6 must not exceed 1",
        ),
        (lambda: CookTorrance(m=0.1, material=Lambertian(0.5)), "material"),
        (lambda: CookTorrance(m_x=0.1, material=Mirror()), "m_x and m_y together"),
        (lambda: CookTorrance(m=0.1, scales=((0.1, 1.0),), material=Mirror()), "m and scales was given"),
        (lambda: CookTorrance(scales=((0.1, 0.5), (0.2, 0.4)), material=Mirror()), "sum to 0.9"),
        (lambda: Mixture(components=((0.5, Beckmann(0.1)),)), "sum to 0.5"),
        (lambda: GGX(alpha_x=0.1), "alpha_x and alpha_y together"),
        (lambda: Beckmann(alpha=0.0), "greater than 0"),
        (lambda: Beckmann(alpha=float("nan")), "finite"),
    ],
)
def test_wrong_models_are_told_in_words(make, words):
    with pytest.raises(ValidationError, match=words):
        make()


def test_the_model_of_a_specimen():
    statistics, gold = {"beckmann_alpha": 0.25, "Ssk": None}, Conductor("Au")
    assert CookTorrance.of(statistics, gold) == CookTorrance(m=0.25, material=gold)
    assert Microfacet.of(statistics, gold) == smith(0.25, gold)
    assert Lambert.of(statistics, Lambertian(0.3)) == Lambert(0.3)
    assert matching(statistics, gold) == (CookTorrance(m=0.25, material=gold), smith(0.25, gold))
    tilt = np.degrees(np.arctan(0.25 / np.sqrt(2)))
    assert matching(statistics, Lambertian(0.3)) == (Lambert(0.3), OrenNayar(sigma=tilt, reflectance=0.3))
    assert matching({"beckmann_alpha": 0.0}, Lambertian(0.3)) == (Lambert(0.3),)
    cylinders = Cylinders(distance=1.5)
    rounded = PoulinFournier(local=gold, distance=1.5, floor_height=cylinders.floor_height)
    assert matching(statistics, gold, cylinders)[0] == rounded
    assert matching({"beckmann_alpha": 0.0}, gold) == ()
    assert CookTorrance.of({**statistics, "beckmann_alpha_x": 0.2, "beckmann_alpha_y": 0.3}, gold).m_y == 0.3
    nearly = {**statistics, "beckmann_alpha_x": 0.245, "beckmann_alpha_y": 0.255}
    assert Microfacet.of(nearly, gold).distribution == Beckmann(0.25)
    brushed = Gaussian(alpha_x=0.1, alpha_y=0.3, rotation=30.0)
    scale = 0.25 / np.sqrt(0.05)
    found = Beckmann.of(nearly, brushed)
    assert (found.alpha_x, found.alpha_y, found.rotation) == pytest.approx((0.1 * scale, 0.3 * scale, 30.0))
    with pytest.raises(ValueError, match="fit it"):
        GGX.of(statistics)
    for alpha in (0.0, None):
        with pytest.raises(ValueError, match="must be above 0 for a microfacet model"):
            CookTorrance.of({"beckmann_alpha": alpha}, gold)
    with pytest.raises(ValueError, match="mirror facets"):
        Microfacet.of(statistics, Lambertian(0.5))
    with pytest.raises(ValueError, match="use a microfacet model"):
        Lambert.of(statistics, gold)
