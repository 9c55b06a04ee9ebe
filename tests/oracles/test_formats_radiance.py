"""Radiance's BSDF files: Radiance itself reads what is written here, and what it writes is read as it reads it."""

import re

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from readers.radiance import query, run

from gonio.brdf import BRDF
from gonio.formats import radiance
from gonio.formats.radiance import klems, reading, tensor_tree, writing
from gonio.formats.radiance.colours import WHITE
from gonio.formats.text import numbers
from gonio.sphere import direction, half_vector, rotate_z

VARIANTS = ("klems-full", "klems-half", "klems-quarter", "tensor3", "tensor4")
COLOURS = np.array([450.0, 550.0, 650.0])
GAINS = np.array([0.5, 0.8, 1.0])
THETA_I = np.arange(0.0, 90.0, 5.0)


@pytest.fixture(scope="module", autouse=True)
def _small_trees():
    """Laws hold for trees of rank 4 with 16 cells as well as with 32, sixteen times as fast."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(tensor_tree.RESOLUTION, 4, 4)
        yield


def lobe(wo, axis, sharpness=15.0):
    return np.exp(-sharpness * (1 - (wo * axis).sum(axis=1)))


def chiral(wi, wo):
    """The specular direction turned by 30 degrees; neither mirror symmetric nor reciprocal."""
    return (0.02 + lobe(wo, rotate_z(wi * (-1, -1, 1), 30.0)))[:, None] * GAINS


def anisotropic(wi, wo):
    """A lobe whose size and place depend on the azimuth of the light."""
    phi = np.arctan2(wi[:, 1], wi[:, 0])
    size = (1 + 0.8 * wi[:, 0]) * (1 + 0.5 * np.sin(2 * phi))
    return (0.02 + size * lobe(wo, rotate_z(wi * (-1, -1, 1), 30 + 40 * wi[:, 1])))[:, None] * GAINS


def reciprocal(wi, wo):
    return (0.02 + lobe(half_vector(wi, wo), np.array([0.0, 0.0, 1.0]), 40.0))[:, None] * GAINS


SOURCES = {
    "chiral": BRDF(chiral, COLOURS, THETA_I, attributes={"title": 'a <chiral> & "odd"\x07 lobe'}),
    "anisotropic": BRDF(anisotropic, COLOURS, THETA_I, np.arange(0.0, 360.0, 15.0), isotropic=False),
    "reciprocal": BRDF(reciprocal, COLOURS, THETA_I),
    "lambertian": BRDF(lambda wi, wo: np.full((len(wi), 1), 0.5 / np.pi), np.array([550.0]), THETA_I),
}
CASES = [
    (source, variant) for source in SOURCES for variant in VARIANTS if (source, variant[6:]) != ("anisotropic", "3")
]


def pairs(count=1500, seed=0):
    random = np.random.default_rng(seed).random((4, count))
    theta = np.degrees(np.arcsin(np.sqrt(random[:2])))
    return direction(theta[0], 360 * random[2]), direction(theta[1], 360 * random[3])


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The files of all cases, made when first asked for, with what was said about them."""
    folder, made = tmp_path_factory.mktemp("radiance"), {}

    def make(source, variant):
        if (source, variant) not in made:
            path = folder / f"{source}_{variant}.xml"
            made[source, variant] = path, radiance.write(SOURCES[source], path, variant)
        return made[source, variant]

    return make


def luminance(source, wi, wo):
    return SOURCES[source].in_basis("Y").evaluate(wi, wo)[:, 0]


@pytest.mark.parametrize(("source", "variant"), CASES)
def test_radiance_and_we_read_the_same(written, source, variant):
    path, _ = written(source, variant)
    wi, wo = pairs()
    theirs, _ = query(path, wi, wo)
    found = radiance.read(path)
    ours = found.evaluate(wi, wo)
    # Radiance's own ripple; with a Lambertian part that it has split off, a little more.
    np.testing.assert_allclose(theirs[:, 1], ours[:, 1 if found.basis == "XYZ" else 0], rtol=4e-4)
    if found.basis == "XYZ":
        ours = ours / WHITE
        hue = np.abs(ours / ours.sum(axis=1, keepdims=True) - theirs / theirs.sum(axis=1, keepdims=True)).max()
        # Matrices keep chromaticities in a byte each.
        assert hue < (0.015 if variant.startswith("klems") else 1e-4)


@pytest.mark.parametrize(("source", "variant"), [case for case in CASES if case[0] in ("chiral", "anisotropic")])
def test_radiance_sees_the_lobe_the_right_way_round(written, source, variant):
    wi, wo = pairs(seed=1)
    theirs = query(written(source, variant)[0], wi, wo)[0][:, 1]
    flip = np.array([1, -1, 1])

    def likeness(wi, wo):
        return np.corrcoef(theirs, luminance(source, wi, wo))[0, 1]

    assert likeness(wi, wo) > (0.8 if variant == "klems-quarter" else 0.9)
    for wrong in (likeness(wi * flip, wo * flip), likeness(wo, wi), likeness(wi, wo * (-1, -1, 1))):
        assert wrong < 0.5


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_lambertian_reads_its_albedo_over_pi(written, variant):
    path, notes = written("lambertian", variant)
    wi, wo = pairs(100)
    values, totals = query(path, wi, wo)
    np.testing.assert_allclose(values, 0.5 / np.pi, rtol=3.1e-4)
    np.testing.assert_allclose(totals, 0.5, rtol=3.1e-4)
    np.testing.assert_allclose(radiance.read(path).evaluate(wi, wo), 0.5 / np.pi, rtol=5e-5)
    assert not notes


def test_trees_of_rank_4_have_32_cells(tmp_path, monkeypatch):
    monkeypatch.setitem(tensor_tree.RESOLUTION, 4, 5)
    path = tmp_path / "fine.xml"
    radiance.write(SOURCES["lambertian"], path, "tensor4")
    assert len(numbers(re.search("{(.*)}", path.read_text(), re.DOTALL)[1])) == 32**4
    values, _ = query(path, *pairs(100))
    np.testing.assert_allclose(values, 0.5 / np.pi, rtol=3.1e-4)


@pytest.mark.parametrize("source", ["chiral", "anisotropic"])
def test_entries_are_averages_over_both_patches(written, source):
    """At the centres of patches that Radiance's own list names, against a product rule in each of them."""
    edges = np.sin(np.radians([0, 5, 15, 25, 35, 45, 55, 65, 75, 90])) ** 2
    counts = np.array([1, 8, 16, 20, 24, 24, 24, 16, 12])
    random = np.random.default_rng(2)
    nodes = (np.arange(8) + 0.5) / 8
    patches = [[(r, random.integers(counts[r])) for r in rings] for rings in random.integers(0, 9, (40, 2))]
    expected, wi, wo = [], [], []
    for incident, exiting in patches:
        ways = []
        for ring, k in (incident, exiting):
            sin2 = edges[ring] + (edges[ring + 1] - edges[ring]) * nodes
            theta, phi = np.meshgrid(np.degrees(np.arcsin(np.sqrt(sin2))), (k + nodes - 0.5) * 360 / counts[ring])
            ways.append(direction(theta, phi).reshape(-1, 3))
        travelling, out = ways
        light = np.repeat(travelling * (-1, -1, 1), len(out), axis=0)
        expected.append(luminance(source, light, np.tile(out, (len(travelling), 1))).mean())
        middle = [
            np.degrees(np.arcsin(np.sqrt(edges[ring : ring + 2].mean()))) * (ring > 0)
            for ring, _ in (incident, exiting)
        ]
        wi.append(direction(middle[0], incident[1] * 360 / counts[incident[0]] + 180))
        wo.append(direction(middle[1], exiting[1] * 360 / counts[exiting[0]]))
    found = query(written(source, "klems-full")[0], np.array(wi), np.array(wo))[0][:, 1]
    expected = np.array(expected)
    np.testing.assert_allclose(found, expected, atol=2e-3 * expected.max(), rtol=0.01)


def test_the_matrix_is_the_one_that_radiance_makes_of_the_function(tmp_path):
    """bsdf2klems averages a function by itself: 256 random samples an entry."""
    (tmp_path / "chiral.cal").write_text(
        "towards(ix,iy,iz,ox,oy,oz) : (-.8660254038*ix + .5*iy)*ox + (-.5*ix - .8660254038*iy)*oy + iz*oz;\n"
        "chiral(ix,iy,iz,ox,oy,oz) : .02 + exp(-15*(1 - towards(ix,iy,iz,ox,oy,oz)));\n"
    )
    theirs = run(
        tmp_path, "bsdf2klems", "-q", "-n", "256", "-forward", "+backward", "-f", "chiral.cal", "chiral"
    ).decode()
    radiance.write(
        BRDF(lambda wi, wo: chiral(wi, wo)[:, 2:], np.array([550.0]), THETA_I), tmp_path / "ours.xml", "klems-quarter"
    )
    first = re.compile("Reflection Back.*?<ScatteringData>(.*?)</ScatteringData>", re.DOTALL)
    ours, theirs = (numbers(first.search(t)[1]) for t in ((tmp_path / "ours.xml").read_text(), theirs))
    error = np.abs(ours / theirs - 1)
    assert np.median(error) < 2e-3
    assert np.percentile(error, 95) < 0.03


@pytest.mark.parametrize("variant", VARIANTS)
def test_hemispherical_reflectances_are_those_of_the_source(written, variant):
    """Of patches and cells of incidence around the normal, where they hardly depend on where in it the light is."""
    theta = np.array([1.0, 2.0, 3.0])
    wi = direction(theta, 45.0)
    _, found = query(written("chiral", variant)[0], wi, wi)
    expected = SOURCES["chiral"].in_basis("Y")
    areas = expected.detector.projected_solid_angles()
    totals = [expected.average(w, expected.detector)[:, 0] @ areas for w in direction(theta, 45.0)]
    np.testing.assert_allclose(found, totals, rtol=1e-2 if variant == "klems-quarter" else 5e-3)


@pytest.mark.parametrize("variant", ["klems-full", "klems-half", "klems-quarter", "tensor4"])
def test_what_is_reciprocal_stays_reciprocal(written, variant):
    """Radiance's own check; its tree samples random directions, which may fall into different cells."""
    for source, most in (("reciprocal", 0.1), ("chiral", 100.0)):
        report = run(".", "checkBSDF", written(source, variant)[0]).decode()
        line = re.search(r"Reciprocity Error.*\n\S+ Refl\s+(\S+)\s+(\S+)\s+(\S+)", report)
        average = float(line[2])
        assert average <= most
        assert source == "reciprocal" or average > 10


def test_grey_is_grey_and_colours_come_back(tmp_path):
    wi, wo = pairs(200)
    for variant in ("klems-full", "tensor3", "tensor4"):
        path = tmp_path / f"grey_{variant}.xml"
        radiance.write(BRDF(lambda wi, wo: chiral(wi, wo) / GAINS, COLOURS, THETA_I), path, variant)
        values, _ = query(path, wi, wo)
        np.testing.assert_allclose(values, np.broadcast_to(values[:, 1:2], values.shape), rtol=0.05)
    for variant in ("klems-full", "tensor4"):
        path = tmp_path / f"colour_{variant}.xml"
        radiance.write(SOURCES["chiral"], path, variant)
        one = SOURCES["chiral"].in_basis("XYZ").evaluate(wi[:1], wo[:1])
        found = radiance.read(path).evaluate(wi, wo)
        np.testing.assert_allclose(found / found[:, 1:2], np.broadcast_to(one / one[:, 1:2], found.shape), rtol=1e-4)


def test_colours_of_a_rank_3_tree_are_written_if_radiance_can_read_them(written, tmp_path):
    path, notes = written("chiral", "tensor3")
    assert any("only the luminance" in note for note in notes)
    assert radiance.read(path).basis == "Y"

    def without_floor(wi, wo):
        return chiral(wi, wo) - 0.02 * GAINS

    path = tmp_path / "dark.xml"
    assert not radiance.write(BRDF(without_floor, COLOURS, THETA_I), path, "tensor3")
    wi, wo = pairs(500)
    values, _ = query(path, wi, wo)
    ours = radiance.read(path).evaluate(wi, wo) / WHITE
    bright = values[:, 1] > 0.01
    np.testing.assert_allclose(values[bright], ours[bright], rtol=3e-3)


@pytest.mark.parametrize("rank", [3, 4])
def test_nested_trees_are_read_as_radiance_reads_them(tmp_path, rank):
    (tmp_path / "f.cal").write_text(
        "f(ix,iy,iz,ox,oy,oz) : .02 + exp(-15*(1 + .6*ix*ox - .8*ix*oy + .8*iy*ox + .6*iy*oy - iz*oz));\n"
    )
    path = tmp_path / "nested.xml"
    options = ("-forward", "+backward", f"-t{rank}", "-g", "4", "-f", "f.cal", "f")
    path.write_bytes(run(tmp_path, "bsdf2ttree", *options))
    assert path.read_text().count("{") > 100
    wi, wo = pairs()
    values, _ = query(path, wi, wo)
    np.testing.assert_allclose(radiance.read(path).evaluate(wi, wo)[:, 0], values[:, 1], rtol=4e-4)


def test_what_rttree_reduce_prunes_is_still_the_lobe(written, tmp_path):
    path, _ = written("chiral", "tensor3")
    head, grid, tail = re.split("[{}]", path.read_text())
    pruned = run(tmp_path, "rttree_reduce", "-h", "-fa", "-r", "3", "-g", "6", "-t", "80", input=grid.encode()).decode()
    small = tmp_path / "pruned.xml"
    small.write_text(head + pruned + tail)
    assert small.stat().st_size < path.stat().st_size * 0.6
    wi, wo = pairs()
    values, _ = query(small, wi, wo)
    ours = radiance.read(small).evaluate(wi, wo)[:, 0]
    np.testing.assert_allclose(ours, values[:, 1], rtol=4e-4)
    assert np.corrcoef(ours, radiance.read(path).evaluate(wi, wo)[:, 0])[0, 1] > 0.99


def as_window_has_it(text):
    """Commas, another order of the wavelengths, and the blocks of a glazing around ours."""
    head, blocks = text.split("<WavelengthData>", 1)
    solar = re.sub(
        ">Visible<", ">Solar<", "<WavelengthData>" + blocks.split("</WavelengthData>")[0] + "</WavelengthData>"
    )
    solar = re.sub(
        "<ScatteringData>.*?</ScatteringData>", "<ScatteringData>1,2,3</ScatteringData>", solar, flags=re.DOTALL
    )
    with_commas = re.sub(
        r"(<ScatteringData>)(.*?)(</ScatteringData>)",
        lambda m: m[1] + ",\t".join(m[2].split()) + "," + m[3],
        "<WavelengthData>" + blocks,
        flags=re.DOTALL,
    )
    return head + solar + with_commas


def test_files_as_window_writes_them(written, tmp_path):
    path, _ = written("anisotropic", "klems-half")
    other = tmp_path / "window.xml"
    other.write_text(as_window_has_it(path.read_text()))
    wi, wo = pairs(300)
    np.testing.assert_array_equal(radiance.read(other).evaluate(wi, wo), radiance.read(path).evaluate(wi, wo))
    np.testing.assert_allclose(query(other, wi, wo)[0][:, 1], radiance.read(other).evaluate(wi, wo)[:, 1], rtol=4e-4)


def test_rows_hold_the_incident_patches_one_after_another(written, tmp_path):
    text = written("anisotropic", "klems-quarter")[0].read_text()
    path = tmp_path / "rows.xml"
    path.write_text(text.replace("<IncidentDataStructure>Columns", "<IncidentDataStructure>Rows"))
    wi, wo = pairs(500)
    np.testing.assert_allclose(query(path, wi, wo)[0][:, 1], radiance.read(path).evaluate(wi, wo)[:, 1], rtol=4e-4)


@pytest.mark.parametrize("variant", ["klems-full", "tensor4"])
def test_the_other_side_is_seen_from_the_other_side(written, tmp_path, variant):
    text = written("anisotropic", variant)[0].read_text().replace("Reflection Back", "Reflection Front")
    path = tmp_path / f"front_{variant}.xml"
    path.write_text(text)
    wi, wo = pairs(500)
    # Turned about y, what lies above for us lies below for Radiance.
    turn = np.array([-1, 1, -1])
    np.testing.assert_allclose(
        query(path, wi * turn, wo * turn)[0][:, 1], radiance.read(path).evaluate(wi, wo)[:, 1], rtol=4e-4
    )
    both = tmp_path / f"both_{variant}.xml"
    blocks = re.search("<WavelengthData>.*</WavelengthData>", written("chiral", variant)[0].read_text(), re.DOTALL)[0]
    both.write_text(text.replace("</DataDefinition>", "</DataDefinition>" + blocks))
    chosen = radiance.read(both)
    np.testing.assert_array_equal(
        chosen.evaluate(wi, wo), radiance.read(written("chiral", variant)[0]).evaluate(wi, wo)
    )


def test_the_angle_basis_is_what_the_file_says(tmp_path):
    """Radiance's half basis had 73 patches once."""
    edges, counts = (0, 6.5, 19.5, 32.5, 46.5, 61.5, 76.5, 90), (1, 8, 12, 16, 20, 12, 4)
    basis = klems.AngleBasis("LBNL/Klems Half", edges, counts)
    numbered = np.arange(73.0)[:, None] + np.zeros(73)
    path = tmp_path / "old.xml"
    path.write_text(writing._document("old", writing._matrix_frame(basis), {"Visible": numbered}))
    found = radiance.read(path)
    wo = direction([0.0, 62.0, 80.0, 80.0], [0.0, 0.0, 44.0, 46.0])
    np.testing.assert_array_equal(found.evaluate(direction(np.full(4, 30.0), 0.0), wo)[:, 0], [0, 57, 69, 70])
    np.testing.assert_allclose(found.theta_i, [0, 13, 26, 39.5, 54, 69, 83.25])


def test_what_is_not_known_is_said(tmp_path):
    def above_20(wi, wo):
        return np.where(wo[:, 2:] < np.cos(np.radians(20.0)), 1.0, np.nan)

    path = tmp_path / "holes.xml"
    notes = radiance.write(BRDF(above_20, np.array([550.0]), np.arange(0.0, 61.0, 10.0)), path)
    assert any("beyond 60 degrees" in note for note in notes)
    # The cap and the second ring of 8, of 145 exiting patches; the ring from 15 to 25 degrees is known in part.
    assert any(f"of {9 / 145:.2%} of the pairs" in note for note in notes)
    values = radiance.read(path).evaluate(*pairs(500))
    assert set(np.unique(values)) == {0.0, 1.0}


def test_a_rank_3_tree_refuses_what_is_anisotropic(tmp_path):
    with pytest.raises(ValueError, match="tensor4"):
        radiance.write(SOURCES["anisotropic"], tmp_path / "never.xml", "tensor3")
    assert not list(tmp_path.iterdir())


def test_the_square_of_shirley_and_chiu_keeps_areas_and_comes_back():
    random = np.random.default_rng(3).random((2000, 2))
    w = tensor_tree.exiting(random)
    np.testing.assert_allclose(tensor_tree.square(w[:, 0], w[:, 1]), random, atol=1e-12)
    np.testing.assert_allclose((w**2).sum(axis=1), 1.0)
    assert (w[:, 2] >= 0).all()
    # Equal squares have equal projected solid angles: moments of the disc.
    fine = tensor_tree.exiting(tensor_tree._places(64, np.array([[0.5, 0.5]]))).reshape(-1, 3)
    np.testing.assert_allclose((fine[:, :2] ** 2).mean(axis=0), 0.25, rtol=1e-3)


def minimal(structure="TensorTree4", data="{ 1 }", basis="<AngleBasis>LBNL/Shirley-Chiu</AngleBasis>", extra=""):
    return (
        f"<WindowElement><Optical><Layer><DataDefinition><IncidentDataStructure>{structure}</IncidentDataStructure>{extra}"
        "</DataDefinition><WavelengthData><Wavelength>Visible</Wavelength><WavelengthDataBlock>"
        f"<WavelengthDataDirection>Reflection Back</WavelengthDataDirection>{basis}<ScatteringData>{data}"
        "</ScatteringData></WavelengthDataBlock></WavelengthData></Layer></Optical></WindowElement>"
    )


KLEMS = "<ColumnAngleBasis>LBNL/Klems Quarter</ColumnAngleBasis><RowAngleBasis>{}</RowAngleBasis>"
RINGS = "<AngleBasis><AngleBasisName>mine</AngleBasisName>{}</AngleBasis>"
RING = "<AngleBasisBlock><nPhis>{}</nPhis><ThetaBounds><UpperTheta>{}</UpperTheta></ThetaBounds></AngleBasisBlock>"
BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]><x>&b;</x>'


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "no well-formed XML"),
        ("theta phi 1 2 3", "no well-formed XML"),
        ("<a>", "no well-formed XML"),
        ('<?xml version="1.0" encoding="no-such"?><a/>', "no well-formed XML"),
        ("<a/>", "no WindowElement/Optical/Layer"),
        (BOMB, "defines entities"),
        (BOMB.encode("utf-16"), "zero bytes"),
        ('<!DOCTYPE x SYSTEM "file:///etc/passwd"><x/>', "defines entities"),
        ("<a>" * 30000 + "</a>" * 30000, "too many"),
        ("<a " + " ".join(f'b{i}="1"' for i in range(60000)) + "/>", "too many"),
        ("<a>" * 20000 + "</a>" * 20000, "no WindowElement/Optical/Layer"),
        (minimal("Tensors"), "its data structure is 'tensors'"),
        (minimal(data=""), "braces"),
        (minimal(data="{ 1 } { 1 }"), "braces"),
        (minimal(data="{" * 50 + "1" + "}" * 50), "braces"),
        (minimal(data="}{"), "braces"),
        (minimal(data="{ 1 "), "braces"),
        (minimal(data="{ }"), "2\\^\\(4 k\\) values"),
        (minimal(data="{ 1 2 3 }"), "2\\^\\(4 k\\) values"),
        (minimal(data="{" + "{ 1 }" * 15 + "}"), "16 branches"),
        (minimal(data="{" + "{ 1 }" * 16 + "2 }"), "outside"),
        (minimal(data="5 { 1 }"), "outside"),
        (minimal(data="{ one }"), "not a number"),
        (minimal(data="{ nan }"), "not finite"),
        (minimal(data="{ 1e999 }"), "not finite"),
        (minimal(data="{ 1e15 }"), "beyond 1e+15".replace("+", "\\+")),
        (minimal("Columns", basis=KLEMS.format("LBNL/Klems Quarter")), "not a number"),
        (minimal("Columns", "1 2 3", KLEMS.format("LBNL/Klems Quarter")), "3 numbers instead of 41 times 41"),
        (minimal("Columns", "1 2 3", KLEMS.format("LBNL/Klems Eighth")), "'LBNL/Klems Eighth' is not one of"),
        (minimal("Columns", "1", KLEMS.format("mine"), RINGS.format("")), "ascending rings"),
        (minimal("Columns", "1", KLEMS.format("mine"), RINGS.format(RING.format(10**9, 90))), "ascending rings"),
        (minimal("Columns", "1", KLEMS.format("mine"), RINGS.format(RING.format(4, "nan"))), "ascending rings"),
        (minimal("Columns", "1", KLEMS.format("mine"), RINGS.format(RING.format(4, 120))), "ascending rings"),
        (minimal("Columns", "1", KLEMS.format("mine"), RINGS.format(RING.format("four", 90))), "ascending rings"),
        (minimal().replace("Reflection Back", "Transmission Back"), "no visible reflection"),
        (minimal().replace("Visible", "Solar"), "no visible reflection"),
    ],
)
def test_other_files_are_refused_in_one_sentence(tmp_path, content, message):
    path = tmp_path / "wrong.xml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=message) as raised:
        radiance.read(path)
    assert str(raised.value).startswith(f"{path}: not a BSDF file")
    assert "\n" not in str(raised.value)


def test_a_huge_file_is_not_even_opened(tmp_path):
    path = tmp_path / "huge.xml"
    with path.open("wb") as file:
        file.truncate(reading.LARGEST + 1)
    with pytest.raises(ValueError, match="100 million bytes"):
        radiance.read(path)


def test_negative_numbers_and_chromaticities_that_are_none_do_no_harm(tmp_path):
    path = tmp_path / "odd.xml"
    text = minimal(data="{ -1 }")
    block = re.search("<WavelengthData>.*</WavelengthData>", text)[0]
    for name, value in (("CIE-u", "0.2"), ("CIE-v", "0")):
        text = text.replace("</Layer>", block.replace("Visible", name).replace("-1", value) + "</Layer>")
    path.write_text(text)
    assert (radiance.read(path).evaluate(*pairs(10)) == 0).all()


SEEDS = [
    minimal(data="{" + "{ 1 }" * 16 + "}"),
    minimal("TensorTree3", "{ 1 2 3 4 5 6 7 8 }"),
    minimal(
        "Rows",
        " ".join(["1"] * 4),
        KLEMS.format("mine").replace("LBNL/Klems Quarter", "mine"),
        RINGS.format(RING.format(2, 90)),
    ),
]


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@example(("<a/>", 0, 0, b""))
@given(
    st.tuples(
        st.sampled_from(SEEDS),
        st.integers(0, 900),
        st.integers(0, 40),
        st.one_of(
            st.binary(max_size=8),
            st.sampled_from([b"{", b"}", b"<", b">", b"&amp;", b"-", b"e9", b"nan", b"TensorTree3"]),
        ),
    )
)
def test_no_bytes_raise_anything_but_value_errors(tmp_path, case):
    text, at, cut, inserted = case
    content = text.encode()
    path = tmp_path / "fuzz.xml"
    path.write_bytes(content[:at] + inserted + content[at + cut :])
    try:
        values = radiance.read(path).evaluate(*pairs(5))
    except ValueError as error:
        assert str(error).startswith(f"{path}: ")  # noqa: PT017 - either is right
    else:
        assert np.isfinite(values).all()
