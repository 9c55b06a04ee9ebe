"""Text and JSON formats: foreign readers find what was measured, and what is written comes back."""

import math

import numpy as np
import pytest
from closed_forms import ALL_AROUND, GRID, THETA_I, WAVELENGTHS, anisotropic, chiral, directions, isotropic, lambertian
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from readers.lists import READERS
from readers.zemax import SMALL

from gonio.brdf import NOMINAL
from gonio.detectors import HemisphereGrid
from gonio.formats import astm, bird, openmaterial, table_csv, zemax
from gonio.sphere import direction

LISTS = {
    "csv": (table_csv, ".csv"),
    "astm": (astm, ".astm"),
    "bird": (bird, ".json"),
    "xompt": (openmaterial, ".xompt"),
}
FORMATS = {**LISTS, "bsdf": (zemax, ".bsdf")}


@pytest.mark.parametrize(
    ("name", "source"),
    [*((name, isotropic) for name in LISTS), *((name, anisotropic) for name in ("csv", "astm", "bird"))],
)
def test_a_foreign_reader_finds_the_closed_form(name, source, tmp_path):
    module, suffix = LISTS[name]
    path = tmp_path / f"lobe{suffix}"
    module.write(source(), path)
    rows = np.array(list(READERS[name](path)))
    incidences = len(THETA_I) * (1 if source is isotropic else len(ALL_AROUND))
    assert len(rows) == incidences * GRID.bins * len(WAVELENGTHS)
    assert len(np.unique(rows[:, :5].round(6), axis=0)) == len(rows)
    theta_i, phi_i, theta_o, phi_o, nm, value = rows.T
    turning = 0.0 if source is isotropic else 0.1
    np.testing.assert_allclose(value, chiral(theta_i, phi_i, theta_o, phi_o - phi_i, nm, turning), rtol=1e-12)
    assert phi_o.min() >= 0
    assert phi_o.max() < 360


@pytest.mark.parametrize("name", LISTS)
@pytest.mark.parametrize("source", [isotropic, anisotropic])
def test_lists_of_bins_come_back_exactly(name, source, tmp_path):
    module, suffix = LISTS[name]
    path = tmp_path / f"lobe{suffix}"
    brdf = source()
    module.write(brdf, path)
    back = module.read(path)
    ours, theirs = (x.measured().dataset.sel(order="all") for x in (brdf, back))
    if (name, source) == ("xompt", anisotropic):
        ours = ours.mean("phi_i").expand_dims("phi_i", 1)
    assert back.isotropic == (source is isotropic or name == "xompt")
    assert (back.title, back.basis) == ("chiral", "spectrum")
    assert module.__name__.split(".")[-1] not in ("", back.attributes["origin"])
    assert path.name in back.attributes["origin"]
    np.testing.assert_array_equal(theirs["brdf"].values, ours["brdf"].values)
    for axis in ("theta_i", "theta_o", "dphi", "wavelength"):
        np.testing.assert_allclose(theirs[axis], ours[axis], rtol=0, atol=1e-12)
    if name in ("csv", "bird"):
        np.testing.assert_array_equal(theirs["brdf_standard_error"].values, ours["brdf_standard_error"].values)
    else:
        assert theirs["brdf_standard_error"].isnull().all()


@pytest.mark.parametrize("name", LISTS)
def test_bins_of_which_nothing_is_known_stay_unknown(name, tmp_path):
    module, suffix = LISTS[name]
    path = tmp_path / f"part{suffix}"
    # Whole rings and a shadow of the source are missing.
    brdf = isotropic(known=lambda theta, dphi: (theta < 65) & ((theta > 25) | (dphi != 0)))
    notes = module.write(brdf, path)
    assert name == "csv" or any("nothing is known of" in note for note in notes)
    back = module.read(path).measured().dataset["brdf"]
    np.testing.assert_array_equal(back.values, brdf.measured().dataset["brdf"].values)


@pytest.mark.parametrize("name", FORMATS)
def test_a_matt_white_is_half_over_pi_everywhere(name, tmp_path):
    module, suffix = FORMATS[name]
    path = tmp_path / f"matt{suffix}"
    module.write(lambertian(), path)
    back = module.read(path)
    theta_i, phi_i, theta_o, phi_o = directions(400, most=89.0)
    values = back.evaluate(direction(theta_i, phi_i), direction(theta_o, phi_o))
    np.testing.assert_allclose(values, 0.5 / math.pi, rtol=1e-6)
    assert back.sampled([0, 50], back.phi_i, GRID).albedo()["albedo"].values == pytest.approx(0.5, rel=1e-6)
    assert not back.evaluate(direction([30.0], [0.0]), direction([100.0], [0.0])).any()


@pytest.mark.parametrize("name", ["csv", "bird", "xompt", "astm"])
@pytest.mark.parametrize("basis", ["RGB", "XYZ"])
def test_colours_come_back_as_colours(name, basis, tmp_path):
    module, suffix = LISTS[name]
    path = tmp_path / f"coloured{suffix}"
    brdf = isotropic(basis=basis, wavelengths=NOMINAL[basis])
    module.write(brdf, path)
    back = module.read(path)
    assert (back.basis, back.channels) == (basis, tuple(basis))
    np.testing.assert_array_equal(back.wavelengths, NOMINAL[basis])
    np.testing.assert_array_equal(back.measured().dataset["brdf"], brdf.measured().dataset["brdf"])


@pytest.mark.parametrize("name", FORMATS)
def test_what_is_no_such_file_is_refused_in_one_sentence(name, tmp_path):
    module, suffix = FORMATS[name]
    path = tmp_path / f"bad{suffix}"
    for content in (b"", b"\x00" * 1000, b"{}", b"[" * 100_000, b'{"metadata": {}, "data": {}, "brdf": {}}', b"VARS"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="bad") as caught:
            module.read(path)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 500


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A valid, short file of every format."""
    folder = tmp_path_factory.mktemp("small")
    brdf = isotropic(grid=HemisphereGrid(theta_step=45.0, phi_step=90.0), wavelengths=(500.0, 600.0))
    for module, suffix in LISTS.values():
        module.write(brdf, folder / f"small{suffix}")
    (folder / "small.bsdf").write_text(SMALL)
    return folder


@pytest.mark.parametrize("name", FORMATS)
@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damaged_files_raise_nothing_but_value_errors(name, small, data):
    module, suffix = FORMATS[name]
    valid = (small / f"small{suffix}").read_bytes()
    kind = data.draw(st.sampled_from(["bytes", "truncated", "mutated", "numbers"]))
    if kind == "bytes":
        content = data.draw(st.binary(max_size=300))
    elif kind == "truncated":
        content = valid[: data.draw(st.integers(0, len(valid)))]
    else:
        piece = st.binary(max_size=4)
        if kind == "numbers":
            piece = st.sampled_from(
                [b"1e999", b"-1", b"nan", b"null", b"", b",", b"9" * 30, b"[", b"]", b'"', b"\n", b"inf"]
            )
        content = valid
        for _ in range(data.draw(st.integers(1, 4))):
            at, width = data.draw(st.integers(0, len(content))), data.draw(st.integers(0, 6))
            content = content[:at] + data.draw(piece) + content[at + width :]
    path = small / f"damaged{suffix}"
    path.write_bytes(content)
    try:
        brdf = module.read(path)
        if brdf.measurement is None:
            brdf.evaluate(direction([20.0, 70.0], [0.0, 33.0]), direction([50.0, 10.0], [180.0, 7.0]))
    except ValueError as error:
        assert "damaged" in str(error)  # noqa: PT017 - most of them are no files of the format any more
