"""Text and JSON formats: foreign readers, and scalar ones after each format's definition, find what was measured.

The source is a closed form of the four angles and the wavelength, chiral and, if wanted, dependent on the azimuth of
the light, so that no two angles can be exchanged and no azimuth reversed.
"""

import csv
import dataclasses
import io
import json
import math
from pathlib import Path

import jsonschema
import numpy as np
import pandas
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gonio.brdf import BRDF, NOMINAL
from gonio.detectors import HemisphereGrid
from gonio.formats import astm, bird, json_arrays, openmaterial, table_csv, zemax
from gonio.formats.scattered import Table, degrees
from gonio.measurement import tabulated
from gonio.sphere import angles, direction, half_vector, rotate_z

DATA = Path(__file__).parents[1] / "data"
GRID = HemisphereGrid(theta_step=10.0, phi_step=15.0)
THETA_I, WAVELENGTHS = (0.0, 30.25, 60.0), (450.0, 550.0, 632.8)
ALL_AROUND = (0.0, 50.0, 130.0, 220.0, 300.0)

LISTS = {
    "csv": (table_csv, ".csv"),
    "astm": (astm, ".astm"),
    "bird": (bird, ".json"),
    "xompt": (openmaterial, ".xompt"),
}
FORMATS = {**LISTS, "bsdf": (zemax, ".bsdf")}


def chiral(theta_i, phi_i, theta_o, dphi, nm, turning=0.0):
    """Smooth, brightest where the mirror direction is turned by 30 degrees; `turning` is how much phi_i matters."""
    lobe = 0.3 * np.sin(np.radians(theta_o)) * (1 + np.cos(np.radians(dphi - 210)))
    return nm / 550 * (0.2 + lobe) + 0.004 * theta_i + turning * (1 + np.cos(np.radians(phi_i - 40)))


def measured(phi_i=(0.0,), turning=0.0, grid=GRID, basis="spectrum", wavelengths=WAVELENGTHS, known=None):
    """The closed form at the bins' centres, with errors; unknown (NaN) where `known(theta_o, dphi)` is false."""
    axes = np.meshgrid(THETA_I, phi_i, grid.theta, grid.dphi, wavelengths, indexing="ij")
    brdf = chiral(*axes, turning)
    if known is not None:
        brdf = np.where(known(axes[2], axes[3]), brdf, np.nan)
    flags = {"title": "chiral", "isotropic": int(not turning), "basis": basis}
    errors = 0.01 * brdf + 1e-4 * axes[2]
    return tabulated(brdf, grid, THETA_I, phi_i, wavelengths, standard_error=errors, attributes=flags)


def isotropic(**more):
    return BRDF.of(measured(**more))


def anisotropic(**more):
    return BRDF.of(measured(ALL_AROUND, turning=0.1, **more))


def lambertian(rho=0.5, wavelengths=WAVELENGTHS):
    values = np.full(len(wavelengths), rho / math.pi)
    return BRDF(
        lambda wi, wo: np.broadcast_to(values, (len(wo), len(values))),
        np.array(wavelengths), np.array(THETA_I), detector=GRID, attributes={"title": "matt"},
    )  # fmt: skip


def directions(count, seed=0, most=80.0):
    """Random pairs of directions, as angles in degrees."""
    random = np.random.default_rng(seed).random((4, count))
    return most * random[0], 360 * random[1], most * random[2], 360 * random[3]


# --- Readers that share nothing with ours ----------------------------------------------------------------------------


def rows_of_csv(path):
    """theta_i, phi_i, theta_o, phi_o in degrees, wavelength in nm, value."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    for row in csv.DictReader(lines):
        assert (float(row["phi_i"]) + float(row["dphi"]) - float(row["phi_o"])) % 360 == pytest.approx(0, abs=1e-9)
        yield (*(float(row[n]) for n in ("theta_i", "phi_i", "theta_o", "phi_o", "wavelength")), float(row["brdf"]))


def rows_of_astm(path):
    """As libbsdf's reader goes about it: words until VARS, then lines of numbers, angles in radians."""
    stream = io.StringIO(path.read_text())
    for line in stream:
        if "VARS" in line.split():
            break
    names = line.removeprefix("VARS ").strip().split(",")
    assert names[:4] == ["theta_i", "phi_i", "theta_r", "phi_r"]
    for line in stream:
        numbers = [float(number) for number in line.split(",")]
        for name, value in zip(names[4:], numbers[4:], strict=True):
            yield (*(math.degrees(angle) for angle in numbers[:4]), float(name.removesuffix("nm")), value)


def rows_of_bird(path):
    data = json.loads(path.read_text())["data"]
    assert all(data[n]["unit"] == "deg" for n in ("theta_i", "phi_i", "theta_r", "phi_r"))
    lists = (data[n]["values"] for n in ("theta_i", "phi_i", "theta_r", "phi_r", "wavelength_i", "BRDF"))
    yield from zip(*lists, strict=True)


def rows_of_xompt(path):
    for metres, theta_i, theta_o, phi, value in json.loads(path.read_text())["brdf"]["lookupTable"]:
        yield (math.degrees(theta_i), 0.0, math.degrees(theta_o), math.degrees(phi), 1e9 * metres, value)


READERS = {"csv": rows_of_csv, "astm": rows_of_astm, "bird": rows_of_bird, "xompt": rows_of_xompt}


class Zemax:
    """A tabular BSDF file after its vendor's description, looked up one pair of directions at a time."""

    def __init__(self, path):
        lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
        self.word = dict(line.split() for line in lines[:4])
        self.axes, line = [], 4
        for name in ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial"):
            keyword, count = lines[line].split()
            self.axes.append([float(angle) for angle in lines[line + 1].split()])
            assert (keyword, int(count)) == (name, len(self.axes[-1]))
            line += 2
        assert lines[line] == ""
        self.channels, self.tis, line = {}, {}, line + 1
        while line < len(lines):
            name, table = lines[line], []
            assert lines[line + 1] == "DataBegin"
            line += 2
            for _ in range(len(self.axes[0]) * len(self.axes[1])):
                word, tis = lines[line].split()
                assert word == "TIS"
                self.tis.setdefault(name, []).append(float(tis))
                table.append(
                    [[float(v) for v in row.split()] for row in lines[line + 1 : line + 1 + len(self.axes[2])]]
                )
                line += 1 + len(self.axes[2])
            assert lines[line] == "DataEnd"
            self.channels[name], line = table, line + 1

    def angles(self, theta_i, phi_i, theta_o, phi_o):
        """Azimuth and radial angle about the mirror direction, degrees."""
        t, a, p = math.radians(theta_o), math.radians(phi_o - phi_i), math.radians(theta_i)
        x, y, z = math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t)
        # The lamp lies at +x: tilt the mirror direction, at -x, up to the pole.
        x, z = math.cos(p) * x + math.sin(p) * z, -math.sin(p) * x + math.cos(p) * z
        return math.degrees(math.atan2(y, x)) % 360, math.degrees(math.acos(max(-1, min(1, z))))

    def value(self, theta_i, phi_i, theta_o, phi_o, channel):
        azimuth, radial = self.angles(theta_i, phi_i, theta_o, phi_o)
        if self.word["Symmetry"] == "PlaneSymmetrical":
            azimuth = min(azimuth, 360 - azimuth)
        rotations = [*self.axes[0], self.axes[0][0] + 360]
        total = 0.0
        for p, wp in self.weights(rotations, (phi_i - rotations[0]) % 360 + rotations[0]):
            for i, w in self.weights(self.axes[1], theta_i):
                block = self.channels[channel][p % len(self.axes[0]) * len(self.axes[1]) + i]
                for a, wa in self.weights(self.axes[2], azimuth):
                    for r, wr in self.weights(self.axes[3], radial):
                        total += wp * w * wa * wr * block[a][r]
        return total

    @staticmethod
    def weights(nodes, x):
        x = min(max(x, nodes[0]), nodes[-1])
        k = max(0, min(len(nodes) - 2, sum(node <= x for node in nodes) - 1))
        if len(nodes) == 1:
            return [(0, 1.0)]
        share = (x - nodes[k]) / (nodes[k + 1] - nodes[k])
        return [(k, 1 - share), (k + 1, share)]


# --- What every format must do ---------------------------------------------------------------------------------------


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
    lobes = source()
    module.write(lobes, path)
    back = module.read(path)
    ours, theirs = (x.measured().dataset.sel(order="all") for x in (lobes, back))
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
    # Whole rings and a shadow of the lamp are missing.
    lobes = isotropic(known=lambda theta, dphi: (theta < 65) & ((theta > 25) | (dphi != 0)))
    notes = module.write(lobes, path)
    assert name == "csv" or any("nothing is known of" in note for note in notes)
    back = module.read(path).measured().dataset["brdf"]
    np.testing.assert_array_equal(back.values, lobes.measured().dataset["brdf"].values)


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
    lobes = isotropic(basis=basis, wavelengths=NOMINAL[basis])
    module.write(lobes, path)
    back = module.read(path)
    assert (back.basis, back.channels) == (basis, tuple(basis))
    np.testing.assert_array_equal(back.wavelengths, NOMINAL[basis])
    np.testing.assert_array_equal(back.measured().dataset["brdf"], lobes.measured().dataset["brdf"])


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
    lobes = isotropic(grid=HemisphereGrid(theta_step=45.0, phi_step=90.0), wavelengths=(500.0, 600.0))
    for module, suffix in LISTS.values():
        module.write(lobes, folder / f"small{suffix}")
    (folder / "small.bsdf").write_text(
        "Source Measured\nSymmetry Asymmetrical\nSpectralContent Monochrome\nScatterType BRDF\nSampleRotation 1\n0\n"
        "AngleOfIncidence 2\n0 60\nScatterAzimuth 3\n0 180 360\nScatterRadial 2\n0 180\n\nMonochrome\nDataBegin\n"
        + 2 * "TIS 0.5\n1 2\n3 4\n5 6\n" + "DataEnd\n"
    )  # fmt: skip
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
        lobes = module.read(path)
        if lobes.measurement is None:
            lobes.evaluate(direction([20.0, 70.0], [0.0, 33.0]), direction([50.0, 10.0], [180.0, 7.0]))
    except ValueError as error:
        assert "damaged" in str(error)  # noqa: PT017 - most of them are no files of the format any more


# --- Other people's lists --------------------------------------------------------------------------------------------


def listed(theta_i, phi_i, theta_o, dphi, function, **more):
    """A table of `function(theta_i, phi_i, theta_o, dphi)` over a grid of these nodes."""
    axes = [a.ravel() for a in np.meshgrid(theta_i, phi_i, theta_o, dphi, indexing="ij")]
    return Table(*axes, function(*axes)[:, None], np.array([550.0]), **more)


def test_a_grid_of_any_nodes_is_linear_in_the_angles_of_each_incidence():
    table = listed(
        (10, 25, 60), (0,), (0, 3, 10, 30, 33, 60, 75, 90), (0, 20, 50, 90, 140, 200, 250, 300, 330), chiral_550
    )
    lobes = table.to_brdf()
    assert lobes.isotropic
    for theta_i in (10.0, 25.0, 60.0):
        _, phi_i, theta_o, dphi = directions(100, most=89)
        found = lobes.evaluate(direction(theta_i, phi_i), direction(theta_o, phi_i + dphi))[:, 0]
        expected = [bilinear(table, theta_i, t, d) for t, d in zip(theta_o, dphi, strict=True)]
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def chiral_550(theta_i, phi_i, theta_o, dphi):
    return chiral(theta_i, phi_i, theta_o, dphi, 550.0)


def bilinear(table, theta_i, theta_o, dphi):
    """One value of a full grid whose azimuths go all around, by hand."""
    here = table.theta_i == theta_i
    rings, sectors = np.unique(table.theta_o), np.unique(table.dphi)
    values = table.brdf[here, 0].reshape(len(rings), len(sectors))
    ring = np.array([np.interp(theta_o, rings, column) for column in values.T])
    return np.interp(dphi, np.append(sectors, 360), np.append(ring, ring[0]))


def test_between_incidences_lobes_move_with_the_half_vector():
    """A function of the half vector alone is the same lobe, mirrored, at every incidence."""

    def of_half(theta_i, phi_i, theta_o, dphi):
        wh = half_vector(direction(theta_i, 0.0), direction(theta_o, dphi))
        return np.exp(-(((wh - direction(8.0, 120.0)) / 0.25) ** 2).sum(axis=-1))

    nodes = np.arange(0, 91, 2.0)
    lobes = listed((20, 40, 60), (0,), nodes, np.arange(0, 360, 5.0), of_half).to_brdf()
    _, phi_i, theta_o, dphi = directions(400, most=75)
    theta_i = np.linspace(20, 60, 400)
    found = lobes.evaluate(direction(theta_i, phi_i), direction(theta_o, phi_i + dphi))[:, 0]
    above = direction(theta_o, dphi) + direction(theta_i, 0.0)
    assert np.abs(found - of_half(theta_i, 0, theta_o, dphi))[above[:, 2] > 1.0].max() < 0.02


def test_scattered_directions_are_interpolated_over_triangles():
    random = np.random.default_rng(3)
    theta = np.degrees(np.arccos(np.sqrt(random.random(4000))))
    phi = 360 * random.random(4000)

    def flat(theta, phi):
        return 1 + 0.005 * theta * np.cos(np.radians(phi - 70))

    table = Table(
        np.full(4000, 40.0), np.full(4000, 15.0), theta, phi - 15, flat(theta, phi)[:, None], np.array([550.0])
    )
    _, _, theta_o, phi_o = directions(300, most=85)
    lobes = dataclasses.replace(table, isotropic=False).to_brdf()
    found = lobes.evaluate(direction(np.full(300, 40.0), 15.0), direction(theta_o, phi_o))[:, 0]
    np.testing.assert_allclose(found, flat(theta_o, phi_o), rtol=1e-9)
    # A single azimuth of the light: without being told otherwise, the lobe turns with it.
    turned = table.to_brdf().evaluate(direction(np.full(300, 40.0), 95.0), direction(theta_o, phi_o + 80))[:, 0]
    np.testing.assert_allclose(turned, flat(theta_o, phi_o), rtol=1e-9)


def test_the_azimuth_of_the_light_is_linear_and_closes():
    def turning(theta_i, phi_i, theta_o, dphi):
        return 1 + 0.1 * np.sin(np.radians(phi_i - 25))

    table = listed((0, 30), range(0, 360, 10), (0, 30, 60, 90), range(0, 360, 30), turning)
    # Light from the normal has one row only.
    keep = (table.theta_i > 0) | (table.phi_i == 0)
    table = dataclasses.replace(
        table, **{n: getattr(table, n)[keep] for n in ("theta_i", "phi_i", "theta_o", "dphi", "brdf")}
    )
    lobes = table.to_brdf()
    phi_i = np.linspace(-5, 360, 400)
    found = lobes.evaluate(direction(np.full(400, 30.0), phi_i), direction(np.full(400, 40.0), 77.0))[:, 0]
    np.testing.assert_allclose(found, turning(0, phi_i, 0, 0), atol=0.1 * np.radians(10) ** 2 / 8)
    at_normal = lobes.evaluate(direction(np.zeros(400), phi_i), direction(np.full(400, 40.0), 77.0))[:, 0]
    np.testing.assert_allclose(at_normal, turning(0, 0, 0, 0), rtol=1e-12)


def test_between_azimuths_lobes_turn_with_the_light():
    axes = ((20, 50), range(0, 360, 30), range(0, 91, 5), range(0, 360, 5))
    told = [listed(*axes, chiral_550, isotropic=isotropic).to_brdf() for isotropic in (True, False)]
    theta_i, phi_i, theta_o, phi_o = directions(500)
    wi, wo = direction(20 + theta_i / 4, phi_i), direction(theta_o, phi_o)
    np.testing.assert_allclose(told[1].evaluate(wi, wo), told[0].evaluate(wi, wo), rtol=1e-9)


def test_light_from_the_normal_has_no_azimuth():
    """An anisotropic table gives one azimuth at theta_i = 0; its lobe does not turn with the light."""

    def absolute(theta_i, phi_i, theta_o, dphi):
        return 1 + 0.01 * theta_o * np.cos(np.radians(phi_i + dphi - 30))

    first = listed((0,), (90,), range(0, 91, 15), range(0, 360, 15), absolute)
    more = listed((40,), (0, 90, 180, 270), range(0, 91, 15), range(0, 360, 15), absolute)
    columns = {
        n: np.concatenate([getattr(first, n), getattr(more, n)])
        for n in ("theta_i", "phi_i", "theta_o", "dphi", "brdf")
    }
    lobes = Table(**columns, wavelengths=np.array([550.0])).to_brdf()
    assert not lobes.isotropic
    phi_i = np.arange(0, 360, 7.0)
    found = lobes.evaluate(direction(np.zeros(len(phi_i)), phi_i), direction(np.full(len(phi_i), 45.0), 30.0))
    np.testing.assert_allclose(found, 1.45, rtol=1e-9)


def test_a_plane_of_incidence_says_nothing_about_what_lies_outside_of_it():
    theta = np.concatenate([np.arange(0.0, 80, 4), -np.arange(2.0, 80, 5)])
    n = len(theta)
    table = Table(np.full(n, 30.0), np.zeros(n), theta, np.zeros(n), (1 + theta / 100)[:, None], np.array([550.0]))
    lobes = table.to_brdf()
    wi = direction(np.full(4, 30.0), 0.0)
    inside = lobes.evaluate(wi, direction([5.0, 37.0, 33.0, 51.0], [0.0, 0.0, 180.0, 180.4]))[:, 0]
    np.testing.assert_allclose(inside, [1.05, 1.37, 0.67, 0.49], rtol=1e-9)
    assert np.isnan(lobes.evaluate(wi, direction([20.0, 37.0, 37.0, 88.0], [90.0, 3.0, 177.0, 0.0]))).all()
    known = lobes.measured().dataset["brdf"].sel(order="all").isel(theta_i=0, phi_i=0, wavelength=0).notnull()
    assert known.sel(dphi=[0, 180]).mean() > 0.8
    assert known.sel(theta_o=slice(5, None)).sel(dphi=slice(10, 170)).sum() == 0


def test_holes_stay_holes_and_rims_are_not_extended():
    table = listed((30,), (0,), np.arange(0, 71, 5.0), np.arange(0, 360, 10.0), chiral_550)
    shadow = (np.abs(table.theta_o - 30) <= 20) & (np.minimum(table.dphi, 360 - table.dphi) <= 20)
    lobes = dataclasses.replace(table, brdf=np.where(shadow[:, None], np.nan, table.brdf)).to_brdf()
    wi = direction(np.full(5, 30.0), 0.0)
    found = lobes.evaluate(wi, direction([30.0, 30.0, 72.0, 73.0, 89.0], [0.0, 170.0, 90.0, 90.0, 0.0]))[:, 0]
    assert np.isnan(found).tolist() == [True, False, False, True, True]


def test_one_side_of_an_isotropic_lobe_stands_for_both():
    table = listed((0, 50), (0,), np.arange(0, 91, 10.0), np.arange(0, 181, 20.0), chiral_550)
    theta_o, dphi = np.array([15.0, 44.0, 80.0]), np.array([13.0, 90.0, 171.0])
    wi = direction(np.full(3, 50.0), 0.0)
    left, right = (table.to_brdf().evaluate(wi, direction(theta_o, sign * dphi)) for sign in (1, -1))
    np.testing.assert_allclose(left, right, rtol=1e-12)
    assert np.isfinite(left).all()


def test_rounded_radians_are_the_angles_that_were_meant():
    exact = np.array([0.0, 5.0, 12.5, 33.33, 89.75])
    np.testing.assert_array_equal(degrees(np.radians(exact).round(6)), exact)
    assert degrees(np.radians(12.3456)) == pytest.approx(12.3456, rel=1e-14)


def test_repeated_rows_are_averaged_and_absurd_tables_refused():
    n = np.zeros(4)
    rows = {"theta_i": n + 30, "phi_i": n, "theta_o": n + 10, "dphi": n, "wavelength": n + 550}
    table = Table.of_rows(**rows, brdf=np.array([1.0, 2, 3, 6]), standard_error=n + 0.5)
    assert (table.brdf.item(), table.standard_error.item()) == (3.0, 0.5)
    many = np.arange(1000.0)
    with pytest.raises(ValueError, match="do not form a table"):
        Table.of_rows(many % 90, many, many % 89, many, many + 1, many)
    several = np.arange(20_000.0)
    with pytest.raises(ValueError, match="more than 10000"):
        Table(several / 300, several, several % 89, several, several[:, None], np.array([550.0])).to_brdf()
    with pytest.raises(ValueError, match="too many"):
        Table(many % 90, many, many % 89, many, many[:, None], np.array([550.0]), isotropic=False).to_brdf()
    with pytest.raises(ValueError, match=r"theta_o = 91 must lie between 0 and 90"):
        dataclasses.replace(table, theta_o=np.array([91.0])).to_brdf()


def test_interpolated_lists_keep_their_errors():
    table = listed((20, 50), (0,), np.arange(0, 91, 7.5), np.arange(0, 360, 20.0), chiral_550)
    lobes = dataclasses.replace(table, standard_error=0.02 * table.brdf).to_brdf()
    data = lobes.measured().dataset
    np.testing.assert_allclose(data["brdf_standard_error"], 0.02 * data["brdf"], rtol=1e-9)


# --- CSV -------------------------------------------------------------------------------------------------------------


def test_pandas_reads_the_csv_with_its_column_names(tmp_path):
    path = tmp_path / "lobe.csv"
    lobes = isotropic()
    assert not table_csv.write(lobes, path)
    frame = pandas.read_csv(path, comment="#")
    assert list(frame) == [*table_csv.COLUMNS]
    wide = frame.set_index(["theta_i", "phi_i", "theta_o", "dphi", "wavelength"])
    for name in ("brdf", "brdf_standard_error"):
        ours = lobes.measured().dataset[name].sel(order="all")
        # Before pandas 3.1 its numbers are those of the file to eleven digits.
        np.testing.assert_allclose(wide[name].to_xarray().transpose(*ours.dims), ours, rtol=1e-11)


def test_the_csv_counts_hits_and_tells_where_it_came_from(tmp_path):
    path = tmp_path / "lobe.csv"
    source = measured()
    hits = np.arange(len(THETA_I) * GRID.bins).reshape(1, len(THETA_I), 1, *GRID.shape)
    dims = ("order", "theta_i", "phi_i", "theta_o", "dphi")
    counted = dataclasses.replace(source, external=source.external.assign(hits=(dims, hits)))
    about = dataclasses.replace(
        counted, attributes={**source.attributes, "title": "two\nlines", "experiment": '{"seed": 7}'}
    )
    table_csv.write(BRDF.of(about), path)
    frame = pandas.read_csv(path, comment="#")
    np.testing.assert_array_equal(frame["count"], np.repeat(hits.ravel(), len(WAVELENGTHS)))
    back = table_csv.read(path)
    assert (back.title, back.attributes["experiment"]) == ("two lines", '{"seed": 7}')
    assert path.read_text().startswith("# two lines\n")


@pytest.mark.parametrize(
    "text",
    [
        "brdf, theta_o ,THETA_I,dphi\n0.3,0,30,0\n0.4,20,30,0\n0.3,0,30,180\n0.6,20,30,180\n",
        "theta_i;phi_o;theta_o;brdf;note\r\n30,0;0;0;0,3;a\r\n30;0;20;4e-1;b\r\n30;180;0;0,3;\r\n30;180;20;0,6;c\r\n",
        "# by hand\n\n#\ntheta_i\tphi_i\tphi_o\ttheta_o\tbrdf\n30\t90\t90\t0\t.3\n30\t90\t90\t20\t.4\n"
        "30\t90\t-90\t20\t.6\n30\t90\t270\t0\t.3\n",
        "\ufefftheta_i,dphi,theta_o,brdf,wavelength\n30,180,20,.6,500\n30,180,0,.3,500\n30,0,20,.4,500\n30,0,0,.3,500",
        "theta_i,dphi,theta_o,brdf,standard_error\n30,180,20,.6,.1\n30,180,0,.3,\n30,0,20,.4,\n30,0,0,.3,.2",
    ],
)
def test_other_peoples_csv(text, tmp_path):
    path = tmp_path / "theirs.csv"
    path.write_bytes(text.encode())
    lobes = table_csv.read(path)
    assert lobes.isotropic
    assert lobes.basis == ("spectrum" if "wavelength" in text else "Y")
    found = lobes.evaluate(direction(np.full(3, 30.0), 77.0), direction([10.0, 15.0, 20.0], [77.0, 257.0, 257.0]))
    np.testing.assert_allclose(found[:, 0], [0.35, 0.525, 0.6], rtol=1e-9)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("theta_i,theta_o,brdf\n30,20,1\n", "dphi or phi_o are missing"),
        ("a,b\n1,2\n", "theta_i, theta_o, brdf, dphi or phi_o are missing"),
        ("theta_i,dphi,theta_o,brdf\n", "holds no values"),
        ("theta_i,dphi,theta_o,brdf\n30,0,much,1\n", "much"),
        ("theta_i,dphi,theta_o,brdf\n30,0,,1\n", "missing or no number"),
        ("theta_i,dphi,theta_o,brdf,wavelength\n30,0,1,1,-5\n", "wavelength = -5 must be positive"),
    ],
)
def test_what_is_wrong_with_a_csv_is_said(text, complaint, tmp_path):
    path = tmp_path / "theirs.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=complaint):
        table_csv.read(path)


def test_more_rows_than_a_spreadsheet_shows_are_noted(monkeypatch, tmp_path):
    monkeypatch.setattr(table_csv, "EXCEL_ROWS", 2160)
    assert "2160 rows" in table_csv.write(isotropic(), tmp_path / "long.csv")[0]


# --- ASTM ------------------------------------------------------------------------------------------------------------


def test_a_header_never_ends_early(tmp_path):
    path = tmp_path / "lobe.astm"
    lobes = isotropic()
    named = dataclasses.replace(lobes, attributes={**lobes.attributes, "title": "VARS\nNUM_POINTS 3"})
    astm.write(named, path)
    head = path.read_text().partition("VARS")[0].split()
    assert head.count("NUM_POINTS") == 1
    assert head[head.index("NUM_POINTS") + 1] == str(len(THETA_I) * GRID.bins)
    assert astm.read(path).measured().dataset["brdf"].equals(lobes.measured().dataset["brdf"])


@pytest.mark.parametrize(
    ("names", "basis"),
    [("R,G,B", "RGB"), ("X,Y,Z", "XYZ"), ("Red,Green,Blue", "RGB"), ("brdf", "Y"), ("633nm", "spectrum")],
)
def test_cornells_tables(names, basis, tmp_path):
    """Rounded radians, any order, negative azimuths, spaces, CR LF; one azimuth of the light means isotropic."""
    rows = [
        (0.523599, 1.570796, t, p, *(t + c for c in range(names.count(",") + 1)))
        for t in (1.0, 0.5, 0)
        for p in (2, -1)
    ]
    path = tmp_path / "cornell.astm"
    text = "\r\n".join(", ".join(map(str, row)) for row in rows)
    path.write_bytes(
        f"NAME blue paint\r\nNUM_POINTS 6\r\nVARS theta_i,phi_i,theta_r,phi_r,{names}\r\n{text}\r\n".encode()
    )
    lobes = astm.read(path)
    assert (lobes.basis, lobes.isotropic, lobes.theta_i.tolist()) == (basis, True, [30.0])
    phi = np.degrees([2.0, -1.0])
    found = lobes.evaluate(direction([30.0, 30.0], [90.0, 90.0]), direction(np.degrees([0.75, 0.25]), phi))
    np.testing.assert_allclose(found[:, 0], [0.75, 0.25], rtol=1e-6)


# --- BiRD ------------------------------------------------------------------------------------------------------------


def schema_errors(content):
    schema = json.loads((DATA / "bird_schema.json").read_text())
    checker = jsonschema.Draft202012Validator(schema, format_checker=jsonschema.FormatChecker())
    return [error.message for error in checker.iter_errors(content)]


@pytest.mark.parametrize(
    "source",
    [
        isotropic,
        lambda: anisotropic(grid=HemisphereGrid(theta_step=30.0, phi_step=30.0)),
        lambda: isotropic(basis="RGB", wavelengths=NOMINAL["RGB"]),
        lambertian,
    ],
)
def test_bird_files_follow_the_schema(source, tmp_path):
    path = tmp_path / "lobe.json"
    bird.write(source(), path)
    content = json.loads(path.read_text())
    assert not schema_errors(content)
    lengths = {len(content["data"][n]["values"]) for n in content["data"] if n != "adhoc_variables"}
    assert len(lengths) == 1
    # The schema can tell a wrong file.
    content["data"]["phi_r"]["values"][0] = 360
    content["data"]["BRDF"]["unit"] = "sr"
    del content["metadata"]["sample"]
    assert len(schema_errors(content)) == 3


def bird_file(path, **changes):
    """A file as a laboratory would have it: in the plane of incidence, radians, micrometres, per cent."""
    data = {
        "wavelength_i": {"unit": "μm", "values": [0.55] * 6},
        "theta_i": {"unit": "rad", "values": [math.pi / 6] * 6},
        "phi_i": {"unit": "°", "values": [90] * 6},
        "theta_r": {"unit": "deg", "values": [0, 10, 20, 0, 10, 20]},
        "phi_r": {"unit": "deg", "values": [90, 90, 90, 270, 270, 270]},
        "BRDF": {"unit": "sr^-1", "values": [0.3, 0.35, 0.4, 0.3, 0.45, 0.6]},
        "uBRDF": {"unit": "%", "values": [1, 2, 3, 1, 2, 3]},
        **changes,
    }
    data = {name: variable for name, variable in data.items() if variable is not None}
    path.write_text(json.dumps({"metadata": {"description": "tile", "method": "measurement"}, "data": data}))
    return path


def test_bird_files_of_laboratories(tmp_path):
    lobes = bird.read(bird_file(tmp_path / "lab.json"))
    assert (lobes.title, lobes.isotropic, lobes.attributes["method"]) == ("tile", True, "measurement")
    assert (lobes.theta_i.item(), lobes.wavelengths.item()) == (30.0, 550.0)
    found = lobes.evaluate(direction(np.full(3, 30.0), 12.0), direction([5.0, 15.0, 20.0], [12.0, 192.0, 192.0]))
    np.testing.assert_allclose(found[:, 0], [0.325, 0.525, 0.6], rtol=1e-9)
    data = lobes.measured().dataset.sel(order="all", theta_o=20.0).isel(theta_i=0, phi_i=0, wavelength=0)
    # An average from 15 degrees on, beyond which nothing changes after 20.
    np.testing.assert_allclose(data["brdf_standard_error"].sel(dphi=180), 0.03 * 0.6, rtol=0.1)


def test_bird_uncertainties_polarisations_and_what_is_refused(tmp_path):
    path = tmp_path / "lab.json"
    values = [0.3, 0.35, 0.4, 0.3, 0.45, 0.6]
    single = {"unit": "1/sr", "values": values, "uncertainty": {"value": 0.02, "unit": "1/sr"}}
    data = bird.read(bird_file(path, uBRDF=None, BRDF=single)).measured().dataset
    assert np.nanmax(data["brdf_standard_error"]) == pytest.approx(0.02)
    # Two polarisations of the light, one below the other.
    names = ("wavelength_i", "theta_i", "phi_i", "theta_r", "phi_r")
    plain = json.loads(bird_file(path).read_text())["data"]
    doubled = {name: {**plain[name], "values": 2 * plain[name]["values"]} for name in names}
    both = {"unit": "1/sr", "values": [v - 0.1 for v in values] + [v + 0.1 for v in values]}
    states = {"notation": "sp", "values": ["s"] * 6 + ["p"] * 6}
    lobes = bird.read(bird_file(path, **doubled, BRDF=both, uBRDF=None, polarization_i=states))
    np.testing.assert_allclose(lobes.evaluate(direction([30.0], 0.0), direction([20.0], 180.0)), 0.6)
    for changes, complaint in (
        ({"polarization_r": {"notation": "sp", "values": ["s"] * 6}}, "analyser"),
        ({"theta_r": {"unit": "gon", "values": [0] * 6}}, "'gon', expected deg or rad"),
        ({"theta_r": {"unit": "deg", "values": [0] * 5}}, "expected 6"),
        ({"BRDF": {"unit": "1/sr", "values": [[1, 2]] * 3}}, "flat list"),
        ({"phi_r": None}, "'phi_r' is missing"),
    ):
        with pytest.raises(ValueError, match=complaint):
            bird.read(bird_file(path, **changes))


def test_negative_values_and_missing_errors_are_told(tmp_path):
    path = tmp_path / "lobe.json"
    source = measured()
    data = source.external.copy(deep=True)
    data["brdf"][0, 0, 0, 0, 0, 0] = -1.0
    data["brdf_standard_error"][0, 0, 0, 3, 0, 0] = np.nan
    notes = bird.write(BRDF.of(dataclasses.replace(source, external=data)), path)
    content = json.loads(path.read_text())
    assert "negative" in notes[0]
    assert "uBRDF" not in content["data"]
    assert content["data"]["BRDF"]["values"][0] == 0
    assert not schema_errors(content)


def test_long_arrays_are_taken_out_of_json(tmp_path):
    path = tmp_path / "long.json"
    numbers = np.random.default_rng(0).standard_normal(5000)
    rows = numbers.reshape(-1, 5)
    content = {
        "a": {"values": numbers.tolist(), "unit": "[1]"},
        "b": [{"values": rows.tolist()}],
        "c": {"values": ["u"] * 999},
    }
    for indent in (None, 1):
        path.write_text(json.dumps(content, indent=indent))
        found = json_arrays.load(path, "values")
        assert isinstance(found["a"]["values"], np.ndarray)
        np.testing.assert_array_equal(found["a"]["values"], numbers)
        np.testing.assert_array_equal(found["b"][0]["values"], rows)
        assert found["c"] == content["c"]
    for damaged, complaint in (
        ("[" + "1," * 3000 + "]]", "damaged"),
        ("[[" + "1,2],[" * 3000 + "3]", "damaged"),
        ("[" + "1 2," * 3000 + "3]", "white space between numbers"),
        ("[" + "1," * 3000 + "true]", "true"),
        ("[1," * 3000, "no JSON"),
    ):
        path.write_text(f'{{"values": {damaged}}}')
        with pytest.raises(ValueError, match=complaint):
            json_arrays.load(path, "values")
    path.write_text(f'{{"values": [{"null, 1, " * 3000} 1 ]}}')
    assert np.isnan(json_arrays.load(path, "values")["values"]).sum() == 3000


# --- OpenMATERIAL ----------------------------------------------------------------------------------------------------

WAVELENGTH = {"type": "number", "minimum": 1e-9, "maximum": 17.16e-3}
SOLID_ANGLE = {"type": "number", "exclusiveMinimum": 0}
TEXTS = {"type": "array", "items": {"type": "string"}, "minItems": 1}
OPENMATERIAL = {
    "type": "object",
    "required": ["metadata", "brdf"],
    "properties": {
        "metadata": {
            "type": "object",
            "required": [
                "name", "uuid", "materialVersion", "openMaterial3dVersion",
                "copyrights", "license", "authors", "sources",
            ],
            "properties": {
                **{name: {"type": "string"} for name in ("name", "description", "license", "sources")},
                "uuid": {"type": "string", "pattern": "^[0-9a-fA-F]{8}(-[0-9a-fA-F]{4}){3}-[0-9a-fA-F]{12}$"},
                "materialVersion": {"type": "string", "pattern": r"^\d+\.\d+\.\d+$"},
                "openMaterial3dVersion": {"type": "string", "pattern": r"^\d+\.\d+\.\d+$"},
                "creationDate": {"type": "string", "pattern": r"^\d{8}T\d{6}Z$"},
                **dict.fromkeys(("copyrights", "authors"), TEXTS),
            },
        },
        "brdf": {
            "type": "object",
            "required": ["wavelengths", "lookupTable"],
            "properties": {
                "wavelengths": {"type": "array", "items": WAVELENGTH},
                "receiverSolidAngles": {
                    "type": "array",
                    "items": {
                        "type": "object",
                        "required": ["wavelength", "solidAngle"],
                        "properties": {"wavelength": WAVELENGTH, "solidAngle": SOLID_ANGLE},
                    },
                },
                "lookupTable": {
                    "type": "array",
                    "items": {
                        "type": "array",
                        "minItems": 5,
                        "maxItems": 5,
                        "prefixItems": [
                            WAVELENGTH,
                            {"type": "number", "minimum": 0, "maximum": 1.570796},
                            {"type": "number", "minimum": 0, "maximum": 1.570796},
                            {"type": "number", "minimum": 0, "maximum": 6.283185},
                            {"type": ["number", "null"], "minimum": 0},
                        ],
                    },
                },
            },
        },
    },
}  # fmt: skip
"""Condensed from the documentation of ASAM OpenMATERIAL 3D 1.1, "Material brdf schema"."""


@pytest.mark.parametrize("source", [isotropic, lambda: isotropic(known=lambda t, d: t < 50), anisotropic])
def test_openmaterial_files_follow_the_schema(source, tmp_path):
    path = tmp_path / "lobe.xompt"
    lobes = source()
    notes = openmaterial.write(lobes, path)
    content = json.loads(path.read_text())
    errors = jsonschema.Draft202012Validator(OPENMATERIAL).iter_errors(content)
    assert not [error.message for error in errors]
    rows = [row[:4] for row in content["brdf"]["lookupTable"]]
    assert rows == sorted(rows)
    assert content["brdf"]["wavelengths"] == sorted({row[0] for row in rows}) == [4.5e-7, 5.5e-7, 6.328e-7]
    assert ("mean over 5 azimuths" in " ".join(notes)) == (not lobes.isotropic)


def test_openmaterial_files_tell_the_solid_angles_of_the_bins(tmp_path):
    path = tmp_path / "lobe.xompt"
    openmaterial.write(isotropic(), path)
    brdf = json.loads(path.read_text())["brdf"]
    rings = [ring["solidAngle"] for ring in brdf["binSolidAngles"]]
    assert 24 * sum(rings) == pytest.approx(2 * math.pi, rel=1e-14)
    # The ring about 30 degrees, from 25 to 35, in 24 parts.
    expected = (math.cos(math.radians(25)) - math.cos(math.radians(35))) * 2 * math.pi / 24
    assert rings[3] == pytest.approx(expected, rel=1e-12)
    receiver = {r["wavelength"]: r["solidAngle"] for r in brdf["receiverSolidAngles"]}
    assert receiver == pytest.approx(dict.fromkeys((4.5e-7, 5.5e-7, 6.328e-7), 2 * math.pi / 240))


def test_openmaterial_tables_of_others(tmp_path):
    """Angles rounded to six decimals, one side of the plane of incidence, null for what was not measured."""
    path = tmp_path / "theirs.xompt"
    table = [
        [nm, *(round(math.radians(angle), 6) for angle in (i, o, p)), None if o > 60 else o + p / 10]
        for nm in (4e-7, 5e-7) for i in (0, 30) for o in range(0, 81, 20) for p in range(0, 181, 45)
    ]  # fmt: skip
    path.write_text(
        json.dumps({"metadata": {"name": "asphalt"}, "brdf": {"wavelengths": [], "lookupTable": table}}, indent=4)
    )
    lobes = openmaterial.read(path)
    assert (lobes.title, lobes.wavelengths.tolist(), lobes.theta_i.tolist()) == ("asphalt", [400.0, 500.0], [0.0, 30.0])
    found = lobes.evaluate(direction([30.0] * 3, 0.0), direction([30.0, 30.0, 80.0], [100.0, -100.0, 0.0]))
    np.testing.assert_allclose(found[:2], 40.0, rtol=1e-5)
    assert np.isnan(found[2]).all()


# --- Zemax -----------------------------------------------------------------------------------------------------------


def shiny(turn=30.0, turning=0.0, theta_i=(0.0, 20.0, 40.0, 60.0, 80.0), wavelengths=(550.0,)):
    """A lobe about the mirror direction turned by `turn`, whose strength depends on phi_i if `turning`."""
    gains = np.array(wavelengths) / 550

    def evaluate(wi, wo):
        _, phi = angles(wi)
        axis = rotate_z(wi * [-1, -1, 1], turn)
        near = np.maximum((axis * wo).sum(axis=-1), 0.0)
        return (0.1 + near**20 * (1 + turning * np.sin(np.radians(phi - 20))))[:, None] * gains

    phi_i = np.arange(0, 360, 30.0) if turning else np.zeros(1)
    return BRDF(
        evaluate, np.array(wavelengths), np.array(theta_i), phi_i, isotropic=not turning,
        detector=HemisphereGrid(theta_step=3.0, phi_step=6.0), attributes={"title": "shiny"},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("lobes", "symmetry"),
    [
        (shiny(turn=0.0), "PlaneSymmetrical"),
        (shiny(), "Asymmetrical"),
        (shiny(turning=0.5, theta_i=(20.0, 50.0)), "Asymmetrical4D"),
    ],
)
def test_zemax_files_hold_the_lobe_about_the_mirror_direction(lobes, symmetry, tmp_path):
    path = tmp_path / "lobe.bsdf"
    zemax.write(lobes, path)
    file, back = Zemax(path), zemax.read(path)
    assert file.word == {
        "Source": "Measured", "Symmetry": symmetry, "SpectralContent": "Monochrome", "ScatterType": "BRDF",
    }  # fmt: skip
    random = np.random.default_rng(1)
    checked = 0
    for _ in range(200):
        p, i, a, r = (int(random.integers(len(axis))) for axis in file.axes)
        phi_i, theta_i, azimuth, radial = (file.axes[k][n] for k, n in enumerate((p, i, a, r)))
        wo = from_mirror(theta_i, phi_i, azimuth, radial)
        if wo[2] <= 0.01:
            continue
        found = file.channels["Monochrome"][p * len(file.axes[1]) + i][a][r]
        expected = lobes.evaluate(direction([theta_i], phi_i), wo[None])[0, 0]
        assert found == pytest.approx(expected, rel=1e-6)
        checked += 1
    assert checked > 80
    # Our evaluation is that of whoever follows the description.
    theta_i, phi_i, theta_o, phi_o = directions(60, most=89)
    wo = direction(theta_o, phi_o)
    values = back.evaluate(direction(theta_i, phi_i), wo)[:, 0]
    ours = [file.value(*a, "Monochrome") for a in zip(theta_i, phi_i, theta_o, phi_o, strict=True)]
    np.testing.assert_allclose(values, ours, rtol=1e-9)


def from_mirror(theta_i, phi_i, azimuth, radial):
    """The direction at these angles about the mirror direction of light from theta_i, phi_i."""
    a, r, p, turn = (math.radians(x) for x in (azimuth, radial, theta_i, phi_i))
    x, y, z = math.sin(r) * math.cos(a), math.sin(r) * math.sin(a), math.cos(r)
    x, z = math.cos(p) * x - math.sin(p) * z, math.sin(p) * x + math.cos(p) * z
    return np.array([math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y, z])


@pytest.mark.parametrize("lobes", [shiny(), shiny(turn=0.0), shiny(turning=0.5, theta_i=(20.0, 40.0, 60.0))])
def test_between_its_nodes_a_zemax_file_is_close(lobes, tmp_path):
    path = tmp_path / "lobe.bsdf"
    zemax.write(lobes, path)
    _, phi_i, theta_o, phi_o = directions(4000, most=88)
    theta_i = np.random.default_rng(2).choice([20.0, 40.0, 60.0], 4000)
    wi, wo = direction(theta_i, phi_i), direction(theta_o, phi_o)
    error = np.abs(zemax.read(path).evaluate(wi, wo) / lobes.evaluate(wi, wo) - 1)
    assert np.sqrt(np.mean(error**2)) < (0.03 if lobes.isotropic else 0.05)


def test_the_tis_is_the_albedo(coarse, tmp_path):
    path = tmp_path / "lobe.bsdf"
    zemax.write(lambertian(0.7), path)
    tis = Zemax(path).tis["Monochrome"]
    np.testing.assert_allclose(tis, 0.7, rtol=1e-5)
    lobes = shiny(turn=0.0, theta_i=(0.0, 30.0))
    zemax.write(lobes, path)
    # 0.1 π + 2π ∫ cos^20 θ cos θ sin θ dθ at normal incidence.
    assert Zemax(path).tis["Monochrome"][0] == pytest.approx(0.1 * math.pi + 2 * math.pi / 22, rel=1e-3)


@pytest.fixture
def coarse(monkeypatch):
    """Zemax tables that are written in no time."""
    monkeypatch.setattr(zemax, "STEPS", {True: (20.0, 6.0), False: (20.0, 10.0)})


def test_zemax_colours_and_wavelengths(coarse, tmp_path):
    path = tmp_path / "lobe.bsdf"
    zemax.write(shiny(wavelengths=(632.8,)), path)
    back = zemax.read(path)
    assert (back.basis, back.wavelengths.tolist(), back.title) == ("spectrum", [632.8], "shiny")
    lobes = shiny(wavelengths=WAVELENGTHS)
    assert "CIE Y" in " ".join(zemax.write(lobes, path))
    assert zemax.read(path).basis == "Y"
    zemax.write(lobes, path, colour=True)
    back = zemax.read(path)
    assert (back.basis, list(Zemax(path).channels)) == ("XYZ", ["TristimulusX", "TristimulusY", "TristimulusZ"])
    _, phi_i, theta_o, phi_o = directions(1000)
    wi, wo = direction(np.full(1000, 40.0), phi_i), direction(theta_o, phi_o)
    np.testing.assert_allclose(back.evaluate(wi, wo), lobes.in_basis("XYZ").evaluate(wi, wo), rtol=0.03)


def test_only_what_exceeds_the_noise_makes_a_lobe_asymmetrical(coarse, tmp_path):
    path = tmp_path / "lobe.bsdf"
    clean = shiny(turn=0.0, theta_i=(0.0, 45.0)).measured()
    data = clean.dataset.copy(deep=True)
    noise = np.random.default_rng(0).standard_normal(data["brdf"].shape)
    data["brdf"] = data["brdf"] * (1 + 0.3 * noise)
    for known, symmetry in ((0.3, "PlaneSymmetrical"), (np.nan, "Asymmetrical")):
        data["brdf_standard_error"] = data["brdf"] * known
        notes = zemax.write(BRDF.of(dataclasses.replace(clean, external=data)), path)
        assert Zemax(path).word["Symmetry"] == symmetry
        assert "% of the energy" in " ".join(notes)


def test_one_azimuth_of_an_anisotropic_specimen_makes_no_zemax_file(tmp_path):
    with pytest.raises(ValueError, match="one azimuth of the light"):
        zemax.write(BRDF.of(measured(turning=0.1)), tmp_path / "lobe.bsdf")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("ScatterType BRDF", "ScatterType BTDF", "holds a BTDF"),
        ("AngleOfIncidence 2", "AngleOfIncidence 2000000000", "announces 2000000000 angles"),
        ("0 180 360", "0 180 170", "must increase"),
        ("SpectralContent Monochrome", "SpectralContent XYZ", "does not go with its 1 blocks"),
        ("5 6\n", "5 6 7\n", r"holds 14 values, expected 1 x 2 x 3 x 2"),
        ("1 2\n", "1 x\n", "not a number"),
        ("1 2\n", "1 1e99\n", "beyond"),
        ("ScatterRadial", "Radial", "there is no ScatterRadial"),
    ],
)
def test_what_is_wrong_with_a_zemax_file_is_said(old, new, complaint, small):
    path = small / "wrong.bsdf"
    path.write_text((small / "small.bsdf").read_text().replace(old, new))
    with pytest.raises(ValueError, match=complaint):
        zemax.read(path)
