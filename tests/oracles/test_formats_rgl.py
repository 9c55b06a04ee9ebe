"""RGL's tensor files: Mitsuba reads what was measured, and we read what Mitsuba reads."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gonio.brdf import BRDF, NOMINAL
from gonio.detectors import HemisphereGrid
from gonio.formats import rgl
from gonio.models import GGX, Beckmann, Lambert, Microfacet, SmithSeparable
from gonio.optics import Conductor
from gonio.sphere import direction, rotate_z

RGB = (450.0, 550.0, 650.0)
SEVEN = (400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0)
GOLD = Conductor("Au")


def microfacets(distribution):
    return Microfacet(distribution=distribution, masking=SmithSeparable(), material=GOLD)


def lobes(evaluate, wavelengths=RGB, theta_i=np.arange(0.0, 90.0, 5.0), phi_i=np.zeros(1), basis="RGB"):  # noqa: B008
    return BRDF(
        evaluate=evaluate,
        wavelengths=np.array(wavelengths),
        theta_i=theta_i,
        phi_i=phi_i,
        isotropic=len(phi_i) == 1,
        basis=basis,
    )


def of(model, wavelengths=RGB, **more):
    return lobes(lambda wi, wo: model.eval(wi, wo, wavelengths), wavelengths, **more)


def turned(model, degrees=30.0):
    """A lobe about the mirror direction turned by so much: left and right differ."""
    return lobes(lambda wi, wo: model.eval(rotate_z(wi, degrees), wo, RGB))


BRUSHED = Beckmann(alpha_x=0.3, alpha_y=0.15, rotation=20.0)
ALL_AROUND = np.arange(0.0, 360.0, 30.0)
SOURCES = {
    "smooth": of(microfacets(Beckmann(alpha=0.1))),
    "gold": of(microfacets(Beckmann(alpha=0.3))),
    "ggx": of(microfacets(GGX(alpha=0.3))),
    "lambertian": of(Lambert(0.5)),
    "floor": lobes(lambda wi, wo: microfacets(Beckmann(alpha=0.3)).eval(wi, wo, RGB) + 0.1 / np.pi),
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


def pairs(count=2000, seed=7, quarter=False):
    """Directions wi, wo (count, 3), both even over the hemisphere, or wi over the quarter with x, y < 0.

    Mitsuba leaves the reduction of an isotropic file to chance, and it is never folded into another quarter from there.
    """
    rng = np.random.default_rng(seed)
    theta = np.degrees(np.arccos(rng.uniform(0.0, 1.0, (2, count))))
    wi, wo = direction(theta, rng.uniform(-180.0, 180.0, (2, count)))
    return np.where(quarter, [-1.0, -1.0, 1.0] * np.abs(wi), wi), wo


def mitsuba(variant):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant(variant)
    return mi


def theirs(path, wi, wo, wavelengths=None):
    """f cos(theta_o) by Mitsuba's `measured`, (n, channels)."""
    mi = mitsuba("scalar_rgb" if wavelengths is None else "scalar_spectral")
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    context, si = mi.BSDFContext(), mi.SurfaceInteraction3f()
    values = []
    for one, other in zip(wi, wo, strict=True):
        si.wi = mi.Vector3f(*one)
        if wavelengths is not None:
            si.wavelengths = wavelengths
        values.append(np.array(bsdf.eval(context, si, mi.Vector3f(*other))))
    return np.array(values)


def off(found, expected, brighter=0.01):
    """|ln| of the ratio of f cos(theta_o) where it counts."""
    counts = expected > brighter
    return np.abs(np.log(np.maximum(found[counts], 1e-12) / expected[counts]))


@pytest.mark.parametrize("name", [name for name in SOURCES if name != "spectral"])
def test_mitsuba_evaluates_the_source(files, name):
    wi, wo = pairs(quarter=SOURCES[name].isotropic)
    expected = SOURCES[name].evaluate(wi, wo) * wo[:, 2:]
    errors = off(theirs(files(name), wi, wo), expected)
    assert np.median(errors) < 2e-3
    assert np.quantile(errors, 0.95) < 0.01


def test_mitsuba_evaluates_spectra(files):
    wi, wo = pairs(1000, quarter=True)
    expected = SOURCES["spectral"].evaluate(wi, wo) * wo[:, 2:]
    ours = rgl.read(files("spectral"))
    np.testing.assert_allclose(ours.wavelengths, SEVEN)
    for four in ([0, 1, 2, 3], [3, 4, 5, 6]):
        found = theirs(files("spectral"), wi, wo, [SEVEN[k] for k in four])
        assert np.quantile(off(found, expected[:, four]), 0.95) < 0.01
        np.testing.assert_allclose(ours.evaluate(wi, wo)[:, four] * wo[:, 2:], found, rtol=5e-4, atol=1e-7)


@pytest.mark.parametrize("name", ["gold", "lambertian", "chiral", "brushed"])
def test_we_evaluate_as_mitsuba_does(files, name):
    wi, wo = pairs(seed=8, quarter=SOURCES[name].isotropic)
    ours = rgl.read(files(name)).evaluate(wi, wo) * wo[:, 2:]
    np.testing.assert_allclose(ours, theirs(files(name), wi, wo), rtol=5e-4, atol=1e-7)


@pytest.mark.parametrize("name", ["chiral", "brushed"])
def test_the_mirror_image_is_another_brdf(files, name):
    wi, wo = pairs(quarter=SOURCES[name].isotropic)
    mirror = np.array([1.0, -1.0, 1.0])
    image = SOURCES[name].evaluate(wi * mirror, wo * mirror) * wo[:, 2:]
    assert np.quantile(off(theirs(files(name), wi, wo), image), 0.5) > 0.3


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


def test_the_container_is_what_mitsuba_reads(files, capsys):
    mi = mitsuba("scalar_rgb")
    from mitsuba import tensor_io

    assert mi
    ours, read = rgl._fields(files("spectral")), tensor_io.read(str(files("spectral")))
    assert capsys.readouterr().out.startswith("Loading tensor data")
    assert set(read) == {
        "description", "theta_i", "phi_i", "ndf", "sigma", "vndf", "luminance", "wavelengths", "spectra", "jacobian",
        "valid",
    }  # fmt: skip
    for name, table in read.items():
        np.testing.assert_array_equal(ours[name], table)
        assert ours[name].dtype == table.dtype
        assert np.isfinite(table).all()
    grid = read["luminance"].shape
    assert np.unpackbits(read["valid"])[: np.prod(grid)].reshape(grid).mean() > 0.85
    assert (read["luminance"] > 0).all()


def external(seed, phi_i, colours=3, jacobian=1, **shapes):
    """Fields of a file that somebody else could have written, of smooth random numbers."""
    rng = np.random.default_rng(seed)
    sizes = {"theta": 5, "rows": 9, "columns": 12, "count": 7, **shapes}
    grid = (len(phi_i), sizes["theta"])
    square = (sizes["rows"], sizes["columns"])

    def numbers(*shape):
        return rng.uniform(0.2, 1.0, shape).astype(np.float32)

    name = "rgb" if colours == 3 else "spectra"
    spectral = {} if colours == 3 else {"wavelengths": np.linspace(380, 720, colours).astype(np.float32)}
    return {
        "description": np.frombuffer(b"made up\nfor a test", np.uint8),
        "theta_i": np.linspace(0.0, 1.4, sizes["theta"]).astype(np.float32),
        "phi_i": np.array(phi_i, np.float32),
        "ndf": numbers(2 if len(phi_i) <= 2 else 6, 10),
        "sigma": numbers(2 if len(phi_i) <= 2 else 6, 8),
        "vndf": numbers(*grid, *square),
        "luminance": numbers(*grid, sizes["count"], sizes["count"]),
        name: numbers(*grid, colours, sizes["count"], sizes["count"]),
        "jacobian": np.array([jacobian], np.uint8),
        **spectral,
    }


@pytest.mark.parametrize(
    ("phi_i", "more"),
    [
        ([0.0], {}),
        ([0.0], {"jacobian": 0}),
        ([0.0, 3.0], {}),
        (np.linspace(-np.pi, np.pi, 9), {}),
        (np.linspace(-np.pi, 0.0, 6), {}),
        (np.linspace(-np.pi, -np.pi / 2, 4), {"jacobian": 0}),
        (np.linspace(-np.pi, -np.pi / 2, 4), {"colours": 4}),
    ],
)
def test_files_of_others_are_read_as_mitsuba_reads_them(tmp_path, capsys, phi_i, more):
    mitsuba("scalar_rgb")
    from mitsuba import tensor_io

    fields, path = external(3, phi_i, **more), tmp_path / "other.bsdf"
    tensor_io.write(str(path), **fields)
    assert capsys.readouterr().out.startswith("Wrote")
    source, (wi, wo) = rgl.read(path), pairs(seed=4, quarter=len(phi_i) <= 2)
    wavelengths = None if source.basis == "RGB" else fields["wavelengths"].tolist()
    found = source.evaluate(wi, wo) * wo[:, 2:]
    np.testing.assert_allclose(found, theirs(path, wi, wo, wavelengths), rtol=2e-3, atol=1e-7)
    assert source.isotropic == (len(phi_i) <= 2)
    assert source.title == "made up"
    assert source.attributes["origin"] == "RGL file other.bsdf"


def test_reductions_stand_for_a_full_circle(tmp_path):
    for quarters, phi_i in (
        (4, np.linspace(-180, 180, 9)),
        (2, np.linspace(-180, 0, 5)),
        (1, np.linspace(-180, -90, 3)),
    ):
        path = tmp_path / f"{quarters}.bsdf"
        with path.open("wb") as file:
            rgl._store(file, external(3, np.radians(phi_i)))
        read = rgl.read(path)
        np.testing.assert_allclose(read.phi_i, np.arange(0.0, 360.0, 45.0))
        measured = read.sampled(read.theta_i, read.phi_i, HemisphereGrid(theta_step=15.0, phi_step=30.0), nodes=1)
        assert measured.dataset["brdf"].notnull().all()


def test_the_file_is_exact_at_its_nodes(files):
    """What an instrument that measures there would store, it gets back."""
    source, written = SOURCES["chiral"], rgl.read(files("chiral"))
    theta_i, phi_i = rgl._incidences(source)
    nodes = rgl.Nodes.around(rgl._estimated_ndf(source), theta_i, phi_i, rgl.MOST)
    for t in (0, 7, 20):
        one = nodes.slice(0, t)
        up = one.wo[..., 2] > 0.05
        wi, wo = np.broadcast_to(one.wi, one.wo[up].shape), one.wo[up]
        expected = source.evaluate(wi, wo)
        np.testing.assert_allclose(written.evaluate(wi, wo), expected, rtol=1e-3, atol=1e-4 * expected.max())


def test_known_incidences_are_nodes():
    theta_i, phi_i = rgl._incidences(SOURCES["brushed"])
    assert np.isin(np.arange(0.0, 90.0, 5.0), theta_i.round(9)).all()
    assert theta_i[-1] == rgl.GRAZING
    assert np.diff(theta_i).max() <= 5.0 + 1e-9
    assert np.isin(np.arange(-180.0, 181.0, 30.0), phi_i.round(9)).all()
    assert np.diff(phi_i).max() <= 10.0 + 1e-9
    dense = dataclasses.replace(SOURCES["gold"], theta_i=np.arange(0.0, 90.0, 0.5))
    assert len(rgl._incidences(dense)[0]) < 60


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

    source = lobes(patchy, theta_i=np.array([10.0, 60.0]))
    notes = rgl.write(source, tmp_path / "patchy.bsdf", colour=True)
    assert [note.split(":")[0] for note in notes[:2]] == [
        "incidences below 10 degrees were not measured",
        "incidences beyond 60 degrees were not measured",
    ]
    assert [note.split(" % ")[1] for note in notes[2:]] == [
        "of the values were negative: they hold 0",
        "of the values are not known: they hold the nearest",
    ]
    fields = rgl._fields(tmp_path / "patchy.bsdf")
    assert all(np.isfinite(table).all() for table in fields.values())
    assert (fields["rgb"] >= 0).all()
    part = dataclasses.replace(SOURCES["brushed"], phi_i=np.array([0.0, 45.0, 90.0]))
    assert "azimuths between 90 and 0 degrees" in rgl._gaps(part)[-1]


def test_black_stays_black(tmp_path):
    rgl.write(lobes(lambda wi, wo: np.zeros((len(wi), 3))), tmp_path / "black.bsdf", colour=True)
    assert (rgl.read(tmp_path / "black.bsdf").evaluate(*pairs()) == 0).all()


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
        found = theirs(tmp_path / "a.bsdf", wi, wo, four)
        assert np.median(off(found, expected[:, [channel] * 4])) < 1e-3


def test_colours_are_no_spectrum(tmp_path):
    with pytest.raises(ValueError, match="only the channels RGB"):
        rgl.write(SOURCES["gold"], tmp_path / "a.bsdf", colour=False)
    assert not list(tmp_path.iterdir())


# --- Files that are none ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    """The bytes of a small file."""
    path = tmp_path_factory.mktemp("small") / "small.bsdf"
    with path.open("wb") as file:
        rgl._store(file, external(1, [0.0], theta=2, rows=3, columns=3, count=2, colours=4))
    return path.read_bytes()


def complaint(path, content):
    """Why reading it is refused; "" if it is a file, which can be evaluated then."""
    path.write_bytes(content)
    try:
        source = rgl.read(path)
    except ValueError as error:
        return str(error)
    source.evaluate(*pairs(3))
    return ""


@pytest.mark.parametrize("length", [0, 5, 14, 18, 30, 200, -1])
def test_truncated_files(valid, tmp_path, length):
    path = tmp_path / "a.bsdf"
    assert complaint(path, valid) == ""
    assert complaint(path, valid[:length]).startswith(f"{path}: not a tensor file of a BRDF, or it is damaged (")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"theta_i": np.array([0.5, 0.2], np.float32)}, "theta_i must rise"),
        ({"phi_i": np.array([np.nan], np.float32)}, "not finite"),
        ({"phi_i": np.zeros(2, np.float32)}, "do not fit"),
        ({"vndf": np.zeros((1, 2, 3, 3), np.float32)}, "0 everywhere"),
        ({"vndf": np.full((1, 2, 3, 3), -1, np.float32)}, "not be negative"),
        ({"vndf": np.full((1, 2, 3, 3), np.inf, np.float32)}, "not finite"),
        ({"sigma": np.zeros((2, 2), np.float32)}, "above 0"),
        ({"ndf": np.ones((2, 1), np.float32)}, "fewer than 2"),
        ({"ndf": np.ones((2, 2))}, "float64"),
        ({"jacobian": np.zeros(0, np.uint8)}, "jacobian"),
        ({"spectra": np.full((1, 2, 4, 2, 2), np.inf, np.float32)}, "not finite"),
        ({"wavelengths": np.array([4, 3, 2, 1], np.float32)}, "must rise"),
    ],
)
def test_fields_that_make_no_brdf(tmp_path, change, message):
    fields = {**external(1, [0.0], theta=2, rows=3, columns=3, count=2, colours=4), **change}
    with (tmp_path / "a.bsdf").open("wb") as file:
        rgl._store(file, fields)
    with pytest.raises(ValueError, match=message):
        rgl.read(tmp_path / "a.bsdf")


def test_a_missing_field_or_an_odd_circle(tmp_path):
    fields = external(1, np.linspace(-np.pi, -np.pi / 3, 4))
    for change, message in (({}, "a circle / 3"), ({"sigma": None}, "no field 'sigma'")):
        kept = {name: table for name, table in {**fields, **change}.items() if table is not None}
        with (tmp_path / "a.bsdf").open("wb") as file:
            rgl._store(file, kept)
        with pytest.raises(ValueError, match=message):
            rgl.read(tmp_path / "a.bsdf")
    with pytest.raises(ValueError, match="not a tensor file"):
        rgl.read(tmp_path)


def test_announced_sizes_are_not_believed(tmp_path, valid):
    head = rgl.MAGIC + (1).to_bytes(4, "little") + b"\x03\x00ndf\x02\x00\x0a" + (64).to_bytes(8, "little")
    for sides in ((1 << 40, 1 << 40), (1 << 63, 0), (100, 100), (0, 1 << 64 - 1)):
        content = head + b"".join(side.to_bytes(8, "little") for side in sides) + bytes(200)
        assert "more" in complaint(tmp_path / "a.bsdf", content)
    many = rgl.MAGIC + b"\xff" * 4 + valid[18:]
    assert "announces 4294967295 fields" in complaint(tmp_path / "a.bsdf", many)


def mutations(valid):
    """Bytes that resemble a file: some of its bytes replaced, cut out or repeated, or none of it."""
    place = st.integers(0, len(valid) - 1)
    patch = st.tuples(place, st.binary(min_size=1, max_size=8))
    cut = st.tuples(place, place)
    return st.one_of(
        st.binary(max_size=300),
        st.binary(max_size=300).map(lambda tail: rgl.MAGIC + tail),
        st.lists(patch, min_size=1, max_size=4).map(lambda patches: patched(valid, patches)),
        cut.map(lambda ends: valid[: ends[0]] + valid[ends[1] :]),
    )


def patched(valid, patches):
    content = bytearray(valid)
    for at, new in patches:
        content[at : at + len(new)] = new
    return bytes(content)


def test_any_bytes_are_a_file_or_a_value_error(valid, tmp_path):
    path = tmp_path / "a.bsdf"

    @settings(max_examples=200, deadline=None)
    @given(mutations(valid))
    def check(content):
        sentence = complaint(path, content)
        assert sentence == "" or (sentence.startswith(f"{path}: not a tensor file") and "\n" not in sentence)

    check()
