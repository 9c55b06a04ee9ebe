"""MERL files against the format's published definition, evaluated here one pair of directions at a time."""

import itertools
import math
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from readers.merl import SCALES, pair_of_bin, stored

from gonio.brdf import BRDF
from gonio.colour import PRIMARIES
from gonio.formats import merl
from gonio.sphere import angles, direction

GAINS = np.array([1.0, 0.5, 0.25])


def handed(wi, wo):
    """Chiral, yet reciprocal: both factors of `twist` change their sign when light and detector are exchanged."""
    twist = (wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0]) * (wi[:, 2] - wo[:, 2])
    return (0.5 + 0.3 * twist + 0.1 * wi[:, 2] * wo[:, 2] + 0.1 * (wi * wo).sum(axis=1))[:, None] * GAINS


def one_way(wi, wo):
    """Chiral and not reciprocal: bright where the specular direction is turned by 30 degrees."""
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    axis = np.stack([-c * wi[:, 0] + s * wi[:, 1], -s * wi[:, 0] - c * wi[:, 1], wi[:, 2]], axis=1)
    return (0.1 + wi[:, 2] * (1 + (axis * wo).sum(axis=1)) ** 2)[:, None] * GAINS


def brdf_of(function, theta_i=(0.0, 45.0, 89.0), **more):
    return BRDF(function, np.array(PRIMARIES), np.array(theta_i), basis="RGB", **more)


def pairs(count, seed=0):
    """Directions above the horizon, uniform in projected area; those on an edge of a bin are as rare as can be."""
    random = np.random.default_rng(seed).random((4, count))
    theta = np.degrees(np.arcsin(np.sqrt(random[:2])))
    return direction(theta[0], 360 * random[2]), direction(theta[1], 360 * random[3])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("merl")


@pytest.fixture(scope="module")
def centred(folder):
    """`handed`, chiral and reciprocal."""
    path = folder / "handed.binary"
    return path, merl.write(brdf_of(handed), path)


@pytest.fixture(scope="module")
def averaged(folder):
    """`one_way`, which is not reciprocal."""
    path = folder / "one_way.binary"
    return path, merl.write(brdf_of(one_way), path)


def test_the_file_is_as_long_and_begins_as_it_should(centred):
    content = centred[0].read_bytes()
    assert len(content) == 34_992_012
    assert content[:12] == bytes.fromhex("5a0000005a000000b4000000")


def test_the_published_reader_finds_the_brdf_at_the_centres_of_bins(centred):
    content = centred[0].read_bytes()
    random = np.random.default_rng(1)
    seen = below = 0
    for i, j, k in random.integers((0, 0, 0), (90, 90, 180), (3000, 3)) + 0.5:
        wi, wo = pair_of_bin(i, j, k)
        found = stored(content, wi, wo)
        if min(wi[2], wo[2]) <= 0:
            corners = itertools.product((i - 0.5, i + 0.5), (j - 0.5, j + 0.5), (k - 0.5, k + 0.5))
            highest = max(min(w[2] for w in pair_of_bin(*corner)) for corner in corners)
            assert (max(found) < 0) == (highest <= 0) or abs(highest) < 1e-9
            below += 1
            continue
        seen += 1
        turn = random.uniform(0, 2 * math.pi)
        turned = [
            (math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y, z)
            for x, y, z in (wi, wo)
        ]
        expected = handed(np.array([wi]), np.array([wo]))[0]
        for first, second in ((wi, wo), (wo, wi), turned):
            values = np.multiply(stored(content, first, second), SCALES)
            np.testing.assert_allclose(values, expected, rtol=1e-12)
    assert seen > 2000
    assert below > 500


def test_what_is_not_reciprocal_becomes_the_mean_of_both_ways(averaged):
    path, notes = averaged
    content = path.read_bytes()
    for i, j, k in ((10, 20, 30), (40, 5, 100), (25, 45, 170), (0, 60, 0)):
        wi, wo = pair_of_bin(i + 0.5, j + 0.5, k + 0.5)
        there, back = np.array([wi]), np.array([wo])
        expected = (one_way(there, back) + one_way(back, there))[0] / 2
        np.testing.assert_allclose(np.multiply(stored(content, wi, wo), SCALES), expected, rtol=1e-12)
    wi, wo = pairs(4000, seed=3)
    there, back = one_way(wi, wo)[:, 0], one_way(wo, wi)[:, 0]
    assert "averaged" in notes[0]
    median = float(notes[0].split("differed by ")[1].split(" %")[0])
    assert median == pytest.approx(100 * np.median(2 * np.abs(there - back) / (there + back)), rel=0.5)


def test_a_reciprocal_brdf_is_said_to_be_one(centred):
    assert float(centred[1][0].split("differed by ")[1].split(" %")[0]) < 1e-10


def test_reading_is_what_the_published_reader_does(averaged):
    path, _ = averaged
    content, found = path.read_bytes(), merl.read(path)
    wi, wo = pairs(3000, seed=2)
    expected = np.array([stored(content, *pair) for pair in zip(wi.tolist(), wo.tolist(), strict=True)]) * SCALES
    expected[expected[:, 0] < 0] = np.nan
    np.testing.assert_allclose(found.evaluate(wi, wo), expected, rtol=1e-12)
    assert np.isfinite(expected).mean() > 0.99
    assert (found.basis, found.isotropic, found.channels) == ("RGB", True, ("R", "G", "B"))
    assert found.attributes["origin"] == "MERL file one_way.binary"
    # An albedo through the whole of the reading: the mean of both ways, over the hemisphere.
    wi = direction(30.0, 0.0)
    albedo = (found.average(wi, found.detector) * found.detector.projected_solid_angles()[:, None]).sum(axis=0)
    other = brdf_of(lambda wi, wo: (one_way(wi, wo) + one_way(wo, wi)) / 2)
    expected = (other.average(wi, found.detector) * found.detector.projected_solid_angles()[:, None]).sum(axis=0)
    np.testing.assert_allclose(albedo, expected, rtol=1e-3)


def test_the_variant_with_360_bins_tells_both_ways_apart(folder):
    table = np.random.default_rng(4).random((3, 90, 90, 360))
    table[:, 40] *= -1
    path = folder / "whole.binary"
    path.write_bytes(struct.pack("<3i", 90, 90, 360) + table.astype("<f8").tobytes())
    content, (wi, wo) = path.read_bytes(), pairs(2000, seed=5)
    expected = (
        np.array([stored(content, *p, phi_bins=360) for p in zip(wi.tolist(), wo.tolist(), strict=True)]) * SCALES
    )
    expected[expected[:, 0] < 0] = np.nan
    np.testing.assert_allclose(merl.read(path).evaluate(wi, wo), expected, rtol=1e-12)
    assert np.isnan(expected).any()


def test_a_lambertian_reads_its_albedo_over_pi(folder):
    path = folder / "lambert.binary"
    notes = merl.write(
        BRDF(lambda wi, wo: np.full((len(wi), 1), 0.5 / np.pi), np.array([550.0]), np.array([0.0])), path
    )
    assert any("beyond 0 degrees" in note for note in notes)
    content = path.read_bytes()
    for wi, wo in zip(*(w.tolist() for w in pairs(300, seed=6)), strict=True):
        np.testing.assert_allclose(np.multiply(stored(content, wi, wo), SCALES), 0.5 / np.pi, rtol=1e-12)
    values = np.frombuffer(content, "<f8", offset=12).reshape(3, -1)
    assert set(np.unique(values[0][values[0] < 0])) == {-1.0}
    np.testing.assert_array_equal(values[0] < 0, values[2] < 0)


def test_edges_are_the_lower_ones_and_known_incidences_come_first(folder):
    def known_to_60(wi, wo):
        """Beyond 60 degrees a wrong value stands."""
        return np.where(angles(wi)[0] <= 60.0001, handed(wi, wo).T, 99.0).T

    path = folder / "edge.binary"
    notes = merl.write(brdf_of(known_to_60, theta_i=(0.0, 60.0)), path, sample="edge")
    assert any("beyond 60 degrees" in note for note in notes)
    content = path.read_bytes()
    for i, j, k in np.random.default_rng(7).integers((0, 1, 0), (60, 45, 180), (500, 3)):
        wi, wo = pair_of_bin(i, j, k)
        theta = [math.degrees(math.acos(w[2])) if w[2] > 0 else 90.0 for w in (wi, wo)]
        if max(theta) > 89.9 or abs(theta[0] - 60) < 0.1 or abs(theta[1] - 60) < 0.1:
            continue
        expected = handed(np.array([wi]), np.array([wo]))[0] if min(theta) < 60 else np.full(3, 99.0)
        inside = pair_of_bin(i + 1e-3, j + 1e-3, k + 1e-3)
        np.testing.assert_allclose(np.multiply(stored(content, *inside), SCALES), expected, rtol=1e-9)


def test_colours_that_srgb_does_not_have_are_cut_and_counted(folder):
    def pure(wi, wo):
        return np.full((len(wi), 3), 0.1) * (0.0, 1.0, 0.0)

    path = folder / "green.binary"
    notes = merl.write(BRDF(pure, np.array([450.0, 510.0, 570.0]), np.array([0.0, 89.0])), path)
    assert any("negative" in note for note in notes)
    planes = np.frombuffer(path.read_bytes(), "<f8", offset=12).reshape(3, -1)
    assert set(np.unique(planes[0])) == {-1.0, 0.0}
    assert planes[1].max() > 0


def test_an_anisotropic_brdf_is_refused_with_advice(folder):
    with pytest.raises(ValueError, match='azimuth = "average"'):
        merl.write(brdf_of(handed, isotropic=False, phi_i=np.array([0.0, 90.0])), folder / "never.binary")
    assert not (folder / "never.binary").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not a MERL file"),
        (b"\x5a", "not a MERL file"),
        (struct.pack("<3i", 90, 90, 180), "12 bytes instead of 34992012"),
        (struct.pack("<3i", 90, 90, 180) + bytes(1000), "1012 bytes instead of 34992012"),
        (struct.pack("<3i", 90, 90, 360) + bytes(34_992_000), "34992012 bytes instead of 69984012"),
        (struct.pack("<3i", 90, 90, 180) + bytes(34_992_001), "34992013 bytes instead of 34992012"),
        (struct.pack("<3i", 2**31 - 1, 2**31 - 1, 2**31 - 1) + bytes(100), "not a MERL file"),
        (struct.pack("<3i", -90, -90, 180) + bytes(100), "not a MERL file"),
    ],
)
def test_other_files_are_refused_in_one_sentence(tmp_path, content, message):
    path = tmp_path / "wrong.binary"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message) as raised:
        merl.read(path)
    assert str(raised.value).startswith(str(path))
    assert "\n" not in str(raised.value)


def test_numbers_that_are_none_are_unknown(tmp_path):
    table = np.ones((3, 90 * 90 * 180))
    table[1, ::3], table[2, 1::3] = np.nan, np.inf
    path = tmp_path / "holes.binary"
    path.write_bytes(struct.pack("<3i", 90, 90, 180) + table.astype("<f8").tobytes())
    values = merl.read(path).evaluate(*pairs(3000))
    assert np.isnan(values).all(axis=1).mean() == pytest.approx(2 / 3, abs=0.05)
    np.testing.assert_allclose(values[np.isfinite(values)].max(), 1.66 / 1500)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    head=st.one_of(
        st.binary(max_size=40),
        st.tuples(*[st.sampled_from([90, 180, 360, 0, -1, 2**31 - 1])] * 3).map(lambda n: struct.pack("<3i", *n)),
    ),
    rest=st.binary(max_size=200),
)
def test_no_bytes_raise_anything_but_value_errors(tmp_path, head, rest):
    path = tmp_path / "fuzz.binary"
    path.write_bytes(head + rest)
    with pytest.raises(ValueError, match="MERL"):
        merl.read(path)
