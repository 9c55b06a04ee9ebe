"""PAB-Opto files: Radiance makes the right BSDF of them, and sets of other origin are read as they are meant."""

import contextlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from readers.radiance import query, run

from gonio.brdf import BRDF
from gonio.detectors import HemisphereGrid
from gonio.formats import pab
from gonio.formats.radiance.colours import WHITE
from gonio.sphere import direction, rotate_z

COLOURS = np.array([450.0, 550.0, 650.0])
GAINS = np.array([0.5, 0.8, 1.0])
GRID = HemisphereGrid(theta_step=10.0, phi_step=15.0)


def lobe(wo, axis):
    return np.exp(-8 * (1 - (wo * axis).sum(axis=1)))


def chiral(wi, wo):
    """The specular direction turned by 30 degrees."""
    return (0.02 + lobe(wo, rotate_z(wi * (-1, -1, 1), 30.0)))[:, None] * GAINS


def anisotropic(wi, wo):
    """Bright for light from +y, and turned with it."""
    return ((1 + wi[:, 1]) * (0.02 + lobe(wo, rotate_z(wi * (-1, -1, 1), 30 + 30 * wi[:, 0]))))[:, None] * GAINS


SOURCES = {
    "isotropic": BRDF(chiral, COLOURS, np.array([0.0, 20.0, 40.0, 60.0]), detector=GRID),
    "anisotropic": BRDF(
        anisotropic,
        COLOURS,
        np.array([0.0, 30.0, 60.0]),
        np.arange(0.0, 360.0, 45.0),
        isotropic=False,
        detector=GRID,
    ),
}


def values_of(brdf):
    return brdf.measured().dataset["brdf"].sel(order="all").values


@pytest.mark.parametrize("source", SOURCES)
def test_a_set_comes_back_as_it_was(tmp_path, source):
    brdf = SOURCES[source]
    path = tmp_path / "set.pab"
    notes = pab.write(brdf, path)
    count = len(brdf.theta_i) * len(brdf.phi_i)
    names = path.read_text().split()
    assert len(names) == len(set(names)) == count
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted([*names, "set.pab"])
    assert notes == [f"set.pab lists the files of the {count} incidences, {names[0]} and so on"]
    found = pab.read(path)
    assert (found.basis, found.isotropic, found.detector) == ("XYZ", source == "isotropic", GRID)
    np.testing.assert_array_equal(found.theta_i, brdf.theta_i)
    np.testing.assert_array_equal(found.phi_i, brdf.phi_i)
    np.testing.assert_allclose(values_of(found), values_of(brdf.in_basis("XYZ")), rtol=1e-5)


def test_a_file_is_what_the_format_says(tmp_path):
    brdf = BRDF(
        lambda wi, wo: anisotropic(wi, wo)[:, 1:2],
        np.array([550.0]),
        np.array([30.0]),
        np.array([100.0, 250.25]),
        isotropic=False,
        detector=HemisphereGrid(theta_step=2.0, phi_step=2.0),
        attributes={"title": 'a "quoted"\n#title'},
    )
    pab.write(brdf, tmp_path / "one.pab")
    file = tmp_path / "one_theta_i030.0_phi_i250.25.pab"
    lines = file.read_text().splitlines()
    assert lines[:6] == [
        "#sample_name \"a 'quoted' #title\"",
        "#colorimetry: CIE-Y",
        "#format: theta phi BRDF",
        "#intheta 30",
        "#inphi 250.25",
        "#upphi 90",
    ]
    theta, phi, values = np.loadtxt(file).T
    assert len(values) == brdf.detector.bins
    expected = brdf.evaluate(np.tile(direction(30.0, 250.25), (len(phi), 1)), direction(theta, phi))[:, 0]
    away = theta > 0
    np.testing.assert_allclose(values[away], expected[away], rtol=0.02, atol=0.002)


def test_a_lambertian_reads_its_albedo_over_pi_and_grey_is_grey(tmp_path):
    for channels in (1, 3):
        brdf = BRDF(
            lambda wi, wo, channels=channels: np.full((len(wi), channels), 0.5 / np.pi),
            COLOURS[:channels],
            np.array([0.0, 45.0]),
            detector=GRID,
        )
        path = tmp_path / f"white{channels}.pab"
        pab.write(brdf, path)
        rows = np.loadtxt(tmp_path / path.read_text().split()[1])
        np.testing.assert_allclose(rows[:, 2:], 0.5 / np.pi, rtol=1e-4)
        assert rows.shape[1] == 2 + channels
        found = pab.read(path).in_basis("Y")
        wi, wo = direction(np.full(50, 20.0), 0.0), direction(np.linspace(0, 89, 50), 77.0)
        np.testing.assert_allclose(found.evaluate(wi, wo), 0.5 / np.pi, rtol=1e-5)


@pytest.mark.parametrize(("source", "incident"), [("isotropic", (10.0, 50.0)), ("anisotropic", (10.0, 50.0))])
def test_radiance_makes_the_right_bsdf_of_a_set(tmp_path, source, incident):
    brdf = SOURCES[source]
    pab.write(brdf, tmp_path / "set.pab")
    names = (tmp_path / "set.pab").read_text().split()
    (tmp_path / "set.sir").write_bytes(run(tmp_path, "pabopto2bsdf", "-s", source, *names))
    (tmp_path / "set.xml").write_bytes(run(tmp_path, "bsdf2klems", "-h", "-n", "32", "set.sir"))
    random = np.random.default_rng(0)
    wi = direction(random.uniform(*incident, 1500), random.uniform(0, 360, 1500))
    wo = direction(np.degrees(np.arcsin(np.sqrt(random.random(1500)))), random.uniform(0, 360, 1500))
    found, _ = query(tmp_path / "set.xml", wi, wo)
    flip = np.array([1, -1, 1])

    def likeness(wi, wo):
        return np.corrcoef(found[:, 1], brdf.evaluate(wi, wo)[:, 1])[0, 1]

    assert likeness(wi, wo) > 0.85
    for wrong in (likeness(wi * flip, wo * flip), likeness(wo, wi), likeness(wi, wo * (-1, -1, 1))):
        assert wrong < 0.6
    colour = brdf.in_basis("XYZ").evaluate(wi[:1], wo[:1])[0] / WHITE
    hue = found.sum(axis=0) / found.sum()
    np.testing.assert_allclose(hue, colour / colour.sum(), atol=0.02)


def scattered(path, header, light, count=3000, cosine=False, turn=0.0, seed=0):
    """A file of scattered directions of the chiral lobe, its azimuths counted from `turn`."""
    random = np.random.default_rng(seed).random((2, count))
    theta, phi = np.degrees(np.arcsin(np.sqrt(random[0]))), 360 * random[1]
    wo = direction(theta, phi)
    values = chiral(np.broadcast_to(direction(*light), wo.shape), wo)[:, 1]
    if cosine:
        values = values * wo[:, 2]
    rows = [f"{t:.4f} {(p - turn) % 360:.4f} {v:.6g}" for t, p, v in zip(theta, phi, values, strict=True)]
    # What comes through the specimen is of no interest here.
    rows[10:10] = ["120 30 5.0", "91 200 5.0"]
    path.write_text("\n".join([*header, *rows]) + "\n")


def test_sets_of_other_origin(tmp_path):
    common = ["#some remark, 1 2 3", '#sample_name "foil 3"']
    scattered(
        tmp_path / "a.txt", [*common, "#format: theta phi BSDF", "#incident_angle 10 0", "#upphi 90"], (10.0, 0.0)
    )
    header = [*common, "#upphi 60", "#format: theta phi DSF", "#colorimetry: CIE-Y", "#intheta 40.0", "#inphi -30"]
    scattered(tmp_path / "b.txt", header, (40.0, 0.0), cosine=True, turn=30.0, seed=1)
    # Without a line about "up", azimuths are counted from +y.
    header = [*common, "#format:  theta  phi  BRDF", "#intheta 60", "#inphi 270"]
    scattered(tmp_path / "c.txt", header, (60.0, 0.0), turn=90.0, seed=2)
    (tmp_path / "foil.pab").write_text("# as it came\na.txt\n\nb.txt\nc.txt\n")
    found = pab.read(tmp_path / "foil.pab")
    assert (found.title, found.basis, found.isotropic) == ("foil 3", "Y", True)
    np.testing.assert_allclose(found.theta_i, [10, 40, 60])
    wo = direction(np.repeat([5.0, 20.0, 40.0, 60.0], 24), np.tile(np.arange(0.0, 360.0, 15.0), 4))
    for theta_i in (10.0, 40.0, 60.0):
        wi = np.broadcast_to(direction(theta_i, 0.0), wo.shape)
        np.testing.assert_allclose(found.evaluate(wi, wo)[:, 0], chiral(wi, wo)[:, 1], atol=0.02)
    alone = pab.read(tmp_path / "b.txt")
    np.testing.assert_allclose(alone.theta_i, [40.0])


def test_directions_upon_others_do_no_harm(tmp_path):
    """Points that lie upon others, as negative polar angles make them, belong to no triangle."""
    rows = [(t, p) for t in (0, 30, 60, 85) for p in range(0, 360, 45)] + [(-30, 45), (8180, 9.5), (60, 315), (0, 135)]
    path = tmp_path / "set.pab"
    for seed in range(20):
        order = np.random.default_rng(seed).permutation(len(rows))
        lines = "".join("{} {} 4.0\n".format(*rows[k]) for k in order)
        path.write_text("#format: theta phi BRDF\n#intheta 30\n#inphi 0\n#upphi 90\n" + lines)
        with contextlib.suppress(ValueError):
            values = pab.read(path).measured().dataset["brdf"].values
            np.testing.assert_allclose(values[np.isfinite(values)], 4.0)


def test_what_is_not_known_has_no_line(tmp_path):
    def above_45(wi, wo):
        return np.where(wo[:, 2:] < np.cos(np.radians(45.0)), 1.0, np.nan)

    path = tmp_path / "holes.pab"
    brdf = BRDF(above_45, np.array([550.0]), np.array([0.0, 30.0]), detector=GRID)
    # Of the cap, eight rings of 10 degrees and half a one, those up to 45 degrees hold nothing.
    assert pab.write(brdf, path)[1].startswith("50.00% of the bins")
    values = values_of(pab.read(path))
    assert np.isnan(values[:, :, :5]).all()
    assert (values[:, :, 5:] == 1).all()


HEADER = "#format: theta phi BRDF\n#intheta 30\n#inphi 0\n#upphi 90\n"
COLOURED = "#colorimetry: CIE-XYZ\n" + HEADER


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"x.pab": ""}, "names no files"),
        ({"x.pab": "# nothing\n"}, "names no files"),
        ({"x.pab": "hello\n"}, "no file 'hello' beside it"),
        ({"x.pab": "../x.pab\n"}, "no file '../x.pab' beside it"),
        ({"x.pab": "/etc/passwd\n"}, "no file '/etc/passwd' beside it"),
        ({"x.pab": "\0\n"}, "beside it"),
        ({"x.pab": "y" * 5000}, "beside it"),
        ({"x.pab": "a\na\n", "a": HEADER + "0 0 1\n"}, "twice"),
        ({"x.pab": "x.pab\n"}, "x.pab: it has no line '#format"),
        ({"x.pab": "a\n", "a": "1 2 3\n"}, "a: it has no line '#format"),
        ({"x.pab": HEADER}, "no values"),
        ({"x.pab": HEADER + "120 0 1\n"}, "no values"),
        ({"x.pab": HEADER + "0 0 1\n1 2\n"}, "lines of 3"),
        ({"x.pab": COLOURED + "0 0 1\n"}, "lines of 5"),
        ({"x.pab": HEADER + "0 0 one\n"}, "not a number"),
        ({"x.pab": HEADER + "0 0 inf\n"}, "not finite"),
        ({"x.pab": HEADER.replace("BRDF", "magic") + "0 0 1\n"}, "BSDF, BRDF, BTDF or DSF"),
        ({"x.pab": HEADER.replace("#intheta 30\n", "") + "0 0 1\n"}, "with an angle each"),
        ({"x.pab": HEADER.replace("30", "thirty") + "0 0 1\n"}, "with an angle each"),
        ({"x.pab": HEADER.replace("30", "150") + "0 0 1\n"}, "theta_i = 150"),
        ({"x.pab": HEADER.replace("30", "nan") + "0 0 1\n"}, "is none"),
        ({"x.pab": HEADER.replace("inphi 0", "inphi 1e9") + "0 0 1\n"}, "is none"),
        ({"x.pab": HEADER.replace("#upphi 90", "#upphi up") + "0 0 1\n"}, "with an angle each"),
        ({"x.pab": HEADER + "#incident_angle 1 2 3\n0 0 1\n"}, "with an angle each"),
        ({"x.pab": "a\nb\n", "a": HEADER + "0 0 1\n", "b": COLOURED + "0 0 1 1 1\n"}, "a colour"),
    ],
)
def test_other_files_are_refused_in_one_sentence(tmp_path, files, message):
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=message) as raised:
        pab.read(tmp_path / "x.pab")
    assert str(raised.value).startswith(f"{tmp_path / 'x.pab'}: neither a PAB-Opto file")
    assert "\n" not in str(raised.value)


def test_huge_files_are_not_even_opened(tmp_path):
    (tmp_path / "x.pab").write_text("a\n")
    for name in ("a", "b"):
        with (tmp_path / name).open("wb") as file:
            file.truncate(pab.LARGEST + 1)
        with pytest.raises(ValueError, match="larger than 1024 MiB"):
            pab.read(tmp_path / ("x.pab" if name == "a" else "b"))


def test_nothing_is_left_behind_where_nothing_can_be_written(tmp_path):
    with pytest.raises(OSError, match="missing"):
        pab.write(SOURCES["isotropic"], tmp_path / "missing" / "set.pab")

    def fails(wi, wo):
        raise RuntimeError("no such lobe")

    with pytest.raises(RuntimeError):
        pab.write(BRDF(fails, COLOURS, np.array([0.0]), detector=GRID), tmp_path / "set.pab")
    assert not list(tmp_path.iterdir())


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    text=st.sampled_from([HEADER, COLOURED]).flatmap(
        lambda head: st.tuples(
            st.just(head + "".join(f"{t} {p} 1 1 1\n" for t in (0, 30, 60) for p in (0, 90, 180, 270))),
            st.integers(0, 250),
            st.integers(0, 30),
            st.one_of(
                st.binary(max_size=8),
                st.sampled_from([b"#", b"\n", b"-", b"e9", b"1e308", b"nan", b"DSF", b"#detector {}\n"]),
            ),
        )
    )
)
def test_no_bytes_raise_anything_but_value_errors(tmp_path, text):
    content, at, cut, inserted = text
    path = tmp_path / "x.pab"
    path.write_bytes(content.encode()[:at] + inserted + content.encode()[at + cut :])
    wi, wo = direction([0.0, 30.0, 80.0], 10.0), direction([1.0, 45.0, 89.0], [0.0, 100.0, 350.0])
    try:
        values = pab.read(path).evaluate(wi, wo)
    except ValueError as error:
        assert str(error).startswith(f"{path}: ")  # noqa: PT017 - either is right
    else:
        assert values.shape[0] == 3
