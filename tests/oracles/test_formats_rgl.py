"""RGL's tensor files: Mitsuba reads what was measured, and we read what Mitsuba reads."""

import dataclasses

import numpy as np
import pytest
from readers.mitsuba import MITSUBA, evaluated, mitsuba, pairs

from gonio.brdf import BRDF, NOMINAL
from gonio.detectors import HemisphereGrid
from gonio.formats import rgl
from gonio.formats.rgl import tensor_file, writing
from gonio.formats.rgl.ndf import estimated_ndf
from gonio.formats.rgl.slices import Nodes
from gonio.models import GGX, Beckmann, Lambert, Microfacet, SmithSeparable
from gonio.optics import Conductor
from gonio.sphere import direction, rotate_z

RGB = (450.0, 550.0, 650.0)
SEVEN = (400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0)
GOLD = Conductor("Au")


def microfacets(distribution):
    return Microfacet(distribution=distribution, masking=SmithSeparable(), material=GOLD)


def brdf_of(evaluate, wavelengths=RGB, theta_i=np.arange(0.0, 90.0, 5.0), phi_i=np.zeros(1), basis="RGB"):  # noqa: B008
    return BRDF(
        evaluate=evaluate,
        wavelengths=np.array(wavelengths),
        theta_i=theta_i,
        phi_i=phi_i,
        isotropic=len(phi_i) == 1,
        basis=basis,
    )


def of(model, wavelengths=RGB, **more):
    return brdf_of(lambda wi, wo: model.eval(wi, wo, wavelengths), wavelengths, **more)


def turned(model, degrees=30.0):
    """A lobe about the specular direction turned by so much: left and right differ."""
    return brdf_of(lambda wi, wo: model.eval(rotate_z(wi, degrees), wo, RGB))


BRUSHED = Beckmann(alpha_x=0.3, alpha_y=0.15, rotation=20.0)
ALL_AROUND = np.arange(0.0, 360.0, 30.0)
SOURCES = {
    "smooth": of(microfacets(Beckmann(alpha=0.1))),
    "gold": of(microfacets(Beckmann(alpha=0.3))),
    "ggx": of(microfacets(GGX(alpha=0.3))),
    "lambertian": of(Lambert(0.5)),
    "floor": brdf_of(lambda wi, wo: microfacets(Beckmann(alpha=0.3)).eval(wi, wo, RGB) + 0.1 / np.pi),
    "chiral": turned(microfacets(Beckmann(alpha=0.5))),
    "spectral": of(microfacets(Beckmann(alpha=0.3)), SEVEN, basis="spectrum"),
    "brushed": of(microfacets(BRUSHED), phi_i=ALL_AROUND),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The file of a source, written when it is first wanted."""
    folder, written = tmp_path_factory.mktemp("rgl"), {}

    def file(name):
        if name not in written:
            written[name] = folder / f"{name}.bsdf"
            assert not [
                note for note in rgl.write(SOURCES[name], written[name], name != "spectral") if "85" not in note
            ]
        return written[name]

    return file


def off(found, expected, brighter=0.01):
    """|ln| of the ratio of f cos(theta_o) where it counts."""
    counts = expected > brighter
    return np.abs(np.log(np.maximum(found[counts], 1e-12) / expected[counts]))


@MITSUBA
@pytest.mark.parametrize("name", [name for name in SOURCES if name != "spectral"])
def test_mitsuba_evaluates_the_source(files, name):
    wi, wo = pairs(quarter=SOURCES[name].isotropic)
    expected = SOURCES[name].evaluate(wi, wo) * wo[:, 2:]
    errors = off(evaluated(files(name), wi, wo), expected)
    assert np.median(errors) < 2e-3
    assert np.quantile(errors, 0.95) < 0.01


@MITSUBA
def test_mitsuba_evaluates_spectra(files):
    wi, wo = pairs(1000, quarter=True)
    expected = SOURCES["spectral"].evaluate(wi, wo) * wo[:, 2:]
    ours = rgl.read(files("spectral"))
    np.testing.assert_allclose(ours.wavelengths, SEVEN)
    for four in ([0, 1, 2, 3], [3, 4, 5, 6]):
        found = evaluated(files("spectral"), wi, wo, [SEVEN[k] for k in four])
        assert np.quantile(off(found, expected[:, four]), 0.95) < 0.01
        np.testing.assert_allclose(ours.evaluate(wi, wo)[:, four] * wo[:, 2:], found, rtol=5e-4, atol=1e-7)


@MITSUBA
@pytest.mark.parametrize("name", ["gold", "lambertian", "chiral", "brushed"])
def test_we_evaluate_as_mitsuba_does(files, name):
    wi, wo = pairs(seed=8, quarter=SOURCES[name].isotropic)
    ours = rgl.read(files(name)).evaluate(wi, wo) * wo[:, 2:]
    np.testing.assert_allclose(ours, evaluated(files(name), wi, wo), rtol=5e-4, atol=1e-7)


@MITSUBA
@pytest.mark.parametrize("name", ["chiral", "brushed"])
def test_the_mirror_image_is_another_brdf(files, name):
    wi, wo = pairs(quarter=SOURCES[name].isotropic)
    mirror = np.array([1.0, -1.0, 1.0])
    image = SOURCES[name].evaluate(wi * mirror, wo * mirror) * wo[:, 2:]
    assert np.quantile(off(evaluated(files(name), wi, wo), image), 0.5) > 0.3


def test_half_of_the_light_from_a_lambertian_surface(files):
    wi, wo = pairs(20_000)
    f = rgl.read(files("lambertian")).evaluate(wi, wo)
    steep = (wi[:, 2] > 0.1) & (wo[:, 2] > 0.1)
    assert np.quantile(np.abs(f[steep] * np.pi / 0.5 - 1), 0.99) < 0.02
    for theta in (0.0, 30.0, 60.0, 85.0):
        assert albedo_by(rgl.read(files("lambertian")), theta) == pytest.approx(0.5, rel=2e-3)


def albedo_by(source, theta):
    """Directional albedo (channels,) by quadrature over half vectors, which are as narrow as the lobe at no angle."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    u, phi = (nodes + 1) / 2, (np.arange(200) + 0.5) * 1.8
    wm = direction(90 * u[:, None] ** 3, phi).reshape(-1, 3)
    solid_angle = weights / 2 * 3 * u**2 * (np.pi / 2) * np.sin(np.pi / 2 * u**3) * (2 * np.pi / 200)
    wi = direction(theta, 220.0)
    cosine = wm @ wi
    wo = 2 * cosine[:, None] * wm - wi
    seen = (wo[:, 2] > 0) & (cosine > 0)
    f = source.evaluate(np.broadcast_to(wi, wo[seen].shape), wo[seen])
    return (4 * cosine * wo[:, 2] * np.repeat(solid_angle, 200))[seen] @ f


@MITSUBA
@pytest.mark.parametrize("name", ["smooth", "gold", "lambertian", "floor", "chiral", "brushed"])
def test_mitsuba_samples_what_it_evaluates(files, name):
    mi = mitsuba("scalar_rgb")
    bsdf = mi.load_dict({"type": "measured", "filename": str(files(name))})
    context, si, rng = mi.BSDFContext(), mi.SurfaceInteraction3f(), np.random.default_rng(1)
    strata = 60
    for theta in (0.0, 45.0, 75.0):
        si.wi = mi.Vector3f(*direction(theta, 220.0))
        weights = []
        for point in (np.mgrid[:strata, :strata].reshape(2, -1).T + rng.uniform(size=(strata**2, 2))) / strata:
            sample, weight = bsdf.sample(context, si, 0.5, point.tolist())
            weights.append(np.array(weight))
            if len(weights) % 10 == 0 and sample.wo.z > 0.01:
                value = np.array(bsdf.eval(context, si, sample.wo))
                np.testing.assert_allclose(weights[-1] * sample.pdf, value, rtol=1e-3)
        spread = np.std(weights, axis=0) / np.mean(weights, axis=0)
        assert (spread < 0.25).all()  # nodes follow the lobe: an unlucky sample is no firefly
        np.testing.assert_allclose(np.mean(weights, axis=0), albedo_by(SOURCES[name], theta), rtol=5e-3)


@MITSUBA
@pytest.mark.parametrize("light", [{"type": "constant"}, {"type": "directional", "direction": [0.6, 0.7, -1.0]}])
@pytest.mark.parametrize("alpha", [0.1, 0.3])
def test_a_sphere_looks_as_with_the_model_of_mitsuba(tmp_path, alpha, light):
    mi = mitsuba("scalar_rgb")
    model, index = microfacets(GGX(alpha=alpha)), GOLD.refractive_index(RGB)
    rgl.write(of(model), tmp_path / "gold.bsdf", colour=True)
    conductor = {"type": "roughconductor", "distribution": "ggx", "alpha": alpha}
    conductor |= {
        name: {"type": "rgb", "value": part.tolist()} for name, part in (("eta", index.real), ("k", index.imag))
    }

    def picture(bsdf):
        camera = {
            "type": "perspective",
            "fov": 28.0,
            "to_world": mi.ScalarTransform4f().look_at([0, -4, 1.5], [0] * 3, [0, 0, 1]),
        }
        camera["film"] = {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}}
        camera["sampler"] = {"type": "independent", "sample_count": 64}
        scene = {"type": "scene", "integrator": {"type": "path", "max_depth": 2}, "camera": camera, "light": light}
        return np.array(mi.render(mi.load_dict({**scene, "ball": {"type": "sphere", "bsdf": bsdf}}), seed=1))

    expected, found = picture(conductor), picture({"type": "measured", "filename": str(tmp_path / "gold.bsdf")})
    np.testing.assert_allclose(found.mean(axis=(0, 1)), expected.mean(axis=(0, 1)), rtol=5e-3)
    noise = 0.1 if light["type"] == "constant" else 2e-3
    assert np.sqrt(np.mean((found - expected) ** 2)) < noise * expected.mean()


@MITSUBA
def test_the_container_is_what_mitsuba_reads(files, capsys):
    mi = mitsuba("scalar_rgb")
    from mitsuba import tensor_io

    assert mi
    ours, read = tensor_file.load(files("spectral")), tensor_io.read(str(files("spectral")))
    assert capsys.readouterr().out.startswith("Loading tensor data")
    assert set(read) == {
        "description",
        "theta_i",
        "phi_i",
        "ndf",
        "sigma",
        "vndf",
        "luminance",
        "wavelengths",
        "spectra",
        "jacobian",
        "valid",
    }
    for name, table in read.items():
        np.testing.assert_array_equal(ours[name], table)
        assert ours[name].dtype == table.dtype
        assert np.isfinite(table).all()
    grid = read["luminance"].shape
    assert np.unpackbits(read["valid"])[: np.prod(grid)].reshape(grid).mean() > 0.85
    assert (read["luminance"] > 0).all()


def test_the_file_is_exact_at_its_nodes(files):
    """What an instrument that measures there would store, it gets back."""
    source, written = SOURCES["chiral"], rgl.read(files("chiral"))
    theta_i, phi_i = writing._incidences(source)
    nodes = Nodes.around(estimated_ndf(source), theta_i, phi_i, writing.MOST)
    for t in (0, 7, 20):
        one = nodes.slice(0, t)
        up = one.wo[..., 2] > 0.05
        wi, wo = np.broadcast_to(one.wi, one.wo[up].shape), one.wo[up]
        expected = source.evaluate(wi, wo)
        np.testing.assert_allclose(written.evaluate(wi, wo), expected, rtol=1e-3, atol=1e-4 * expected.max())


def test_known_incidences_are_nodes():
    theta_i, phi_i = writing._incidences(SOURCES["brushed"])
    assert np.isin(np.arange(0.0, 90.0, 5.0), theta_i.round(9)).all()
    assert theta_i[-1] == writing.GRAZING
    assert np.diff(theta_i).max() <= 5.0 + 1e-9
    assert np.isin(np.arange(-180.0, 181.0, 30.0), phi_i.round(9)).all()
    assert np.diff(phi_i).max() <= 10.0 + 1e-9
    dense = dataclasses.replace(SOURCES["gold"], theta_i=np.arange(0.0, 90.0, 0.5))
    assert len(writing._incidences(dense)[0]) < 60


def test_a_measured_table_survives(tmp_path):
    grid = HemisphereGrid(theta_step=1.5, phi_step=3.0)
    table = BRDF.of(SOURCES["gold"].sampled(np.arange(0.0, 90.0, 10.0), [0.0], grid))
    assert rgl.write(table, tmp_path / "table.bsdf", colour=True) == [
        "incidences beyond 80 degrees were not measured: the nearest stands for them"
    ]
    read, (wi, wo) = rgl.read(tmp_path / "table.bsdf"), pairs()
    errors = off(read.evaluate(wi, wo) * wo[:, 2:], table.evaluate(wi, wo) * wo[:, 2:])
    assert np.quantile(errors, 0.95) < 0.01
    again = read.sampled(read.theta_i, 0.0, grid, nodes=1)
    np.testing.assert_allclose(again.wavelengths, NOMINAL["RGB"])
    for theta in (10.0, 40.0, 70.0):
        before = table.measured().albedo()["albedo"].sel(theta_i=theta).values
        np.testing.assert_allclose(again.albedo()["albedo"].sel(theta_i=theta).values, before, rtol=5e-3)
    assert read.detector == HemisphereGrid(theta_step=1.0, phi_step=2.0)


def test_what_is_bent_is_said(tmp_path):
    def patchy(wi, wo):
        f = np.full((len(wi), 3), 0.1)
        f[wo[:, 0] > 0.8, 1] = -0.1
        f[wo[:, 1] > 0.8] = np.nan
        return f

    source = brdf_of(patchy, theta_i=np.array([10.0, 60.0]))
    notes = rgl.write(source, tmp_path / "patchy.bsdf", colour=True)
    assert [note.split(":")[0] for note in notes[:2]] == [
        "incidences below 10 degrees were not measured",
        "incidences beyond 60 degrees were not measured",
    ]
    assert [note.split(" % ")[1] for note in notes[2:]] == [
        "of the values were negative: they hold 0",
        "of the values are not known: they hold the nearest",
    ]
    fields = tensor_file.load(tmp_path / "patchy.bsdf")
    assert all(np.isfinite(table).all() for table in fields.values())
    assert (fields["rgb"] >= 0).all()
    part = dataclasses.replace(SOURCES["brushed"], phi_i=np.array([0.0, 45.0, 90.0]))
    assert "azimuths between 90 and 0 degrees" in writing._gaps(part)[-1]


def test_black_stays_black(tmp_path):
    rgl.write(brdf_of(lambda wi, wo: np.zeros((len(wi), 3))), tmp_path / "black.bsdf", colour=True)
    assert (rgl.read(tmp_path / "black.bsdf").evaluate(*pairs()) == 0).all()


@MITSUBA
def test_wavelengths_rise_and_one_is_enough(tmp_path):
    for wavelengths in ((650.0, 450.0), (632.8,)):
        source = of(microfacets(Beckmann(alpha=0.5)), wavelengths, basis="spectrum")
        rgl.write(source, tmp_path / "a.bsdf", colour=False)
        read, (wi, wo) = rgl.read(tmp_path / "a.bsdf"), pairs(200, quarter=True)
        np.testing.assert_allclose(read.wavelengths, sorted(wavelengths), rtol=1e-6)
        expected = source.evaluate(wi, wo)[:, np.argsort(wavelengths)] * wo[:, 2:]
        assert np.median(off(read.evaluate(wi, wo) * wo[:, 2:], expected)) < 1e-3
        four = [wavelengths[0]] * 4
        channel = sorted(wavelengths).index(wavelengths[0])
        found = evaluated(tmp_path / "a.bsdf", wi, wo, four)
        assert np.median(off(found, expected[:, [channel] * 4])) < 1e-3


def test_colours_are_no_spectrum(tmp_path):
    with pytest.raises(ValueError, match="only the channels RGB"):
        rgl.write(SOURCES["gold"], tmp_path / "a.bsdf", colour=False)
    assert not list(tmp_path.iterdir())
