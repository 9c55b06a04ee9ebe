"""RGL's tensor files of others: they are read as Mitsuba reads them, and damaged ones are told."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from readers.mitsuba import MITSUBA, evaluated, mitsuba, pairs

from gonio.detectors import HemisphereGrid
from gonio.formats import rgl
from gonio.formats.rgl import tensor_file


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


@MITSUBA
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
    np.testing.assert_allclose(found, evaluated(path, wi, wo, wavelengths), rtol=2e-3, atol=1e-7)
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
            tensor_file.store(file, external(3, np.radians(phi_i)))
        read = rgl.read(path)
        np.testing.assert_allclose(read.phi_i, np.arange(0.0, 360.0, 45.0))
        measured = read.sampled(read.theta_i, read.phi_i, HemisphereGrid(theta_step=15.0, phi_step=30.0), nodes=1)
        assert measured.dataset["brdf"].notnull().all()


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    """The bytes of a small file."""
    path = tmp_path_factory.mktemp("small") / "small.bsdf"
    with path.open("wb") as file:
        tensor_file.store(file, external(1, [0.0], theta=2, rows=3, columns=3, count=2, colours=4))
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
        tensor_file.store(file, fields)
    with pytest.raises(ValueError, match=message):
        rgl.read(tmp_path / "a.bsdf")


def test_a_missing_field_or_an_odd_circle(tmp_path):
    fields = external(1, np.linspace(-np.pi, -np.pi / 3, 4))
    for change, message in (({}, "a circle / 3"), ({"sigma": None}, "no field 'sigma'")):
        kept = {name: table for name, table in {**fields, **change}.items() if table is not None}
        with (tmp_path / "a.bsdf").open("wb") as file:
            tensor_file.store(file, kept)
        with pytest.raises(ValueError, match=message):
            rgl.read(tmp_path / "a.bsdf")
    with pytest.raises(ValueError, match="not a tensor file"):
        rgl.read(tmp_path)


def test_announced_sizes_are_not_believed(tmp_path, valid):
    head = tensor_file.MAGIC + (1).to_bytes(4, "little") + b"\x03\x00ndf\x02\x00\x0a" + (64).to_bytes(8, "little")
    for sides in ((1 << 40, 1 << 40), (1 << 63, 0), (100, 100), (0, 1 << 64 - 1)):
        content = head + b"".join(side.to_bytes(8, "little") for side in sides) + bytes(200)
        assert "more" in complaint(tmp_path / "a.bsdf", content)
    many = tensor_file.MAGIC + b"\xff" * 4 + valid[18:]
    assert "announces 4294967295 fields" in complaint(tmp_path / "a.bsdf", many)


def mutations(valid):
    """Bytes that resemble a file: some of its bytes replaced, cut out or repeated, or none of it."""
    place = st.integers(0, len(valid) - 1)
    patch = st.tuples(place, st.binary(min_size=1, max_size=8))
    cut = st.tuples(place, place)
    return st.one_of(
        st.binary(max_size=300),
        st.binary(max_size=300).map(lambda tail: tensor_file.MAGIC + tail),
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
