"""Profilometers' files: written by other libraries, and SurfaceTopography reads ours."""

import struct
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from height_maps import CHIRAL, read

from microsurfaces import HeightFieldFile, save_surface
from microsurfaces.files import profilometry

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it warns that there is no MPI
    import SurfaceTopography

DATA = Path(__file__).parents[1] / "data" / "profilometry"

# Written by other libraries: tests/data/profilometry/README.md. The same rows from the top down, or with y upwards.
ROWS = np.array([[10, 20, 30, 40], [11, 12, 13, 14], [900, 1, 655, 7]]) * 1e-3

WRITTEN_BY_OTHERS = {
    "x3pio_int16.x3p": ROWS,
    "x3pio_text.x3p": ROWS,
    "surfalize.x3p": ROWS,
    "surfalize.sdf": ROWS,
    "surfalize_ascii.sdf": ROWS,
    "surfalize.al3d": ROWS[::-1],
    "surfalize.sur": ROWS[::-1],
    "gwyfile.gwy": ROWS[::-1],
}


@pytest.mark.parametrize("name", WRITTEN_BY_OTHERS)
def test_profilometers_say_heights_spacing_and_unit_themselves(name):
    field = HeightFieldFile(path=str(DATA / name), periodic="as is").build(0)
    assert field.spacing == pytest.approx((0.5, 2.0), rel=1e-6)
    heights = field.heights
    if name.endswith(".sur"):
        heights = heights - heights[-1, 0] + 0.01  # surfalize stores the distance from the middle of its integers
    np.testing.assert_allclose(heights, WRITTEN_BY_OTHERS[name], rtol=0, atol=1.4e-5 if "int16" in name else 1e-7)


def test_surface_topography_reads_our_x3p(tmp_path):
    save_surface(CHIRAL, tmp_path / "a.x3p")
    with SurfaceTopography.open_topography(str(tmp_path / "a.x3p")) as reader:
        topography = reader.topography().to_unit("µm")
        np.testing.assert_allclose(topography.heights().T, CHIRAL.heights, rtol=1e-14)
        assert topography.pixel_size == pytest.approx((0.5, 2.0), rel=1e-14)
        assert topography.positions()[1][0] == pytest.approx([0, 2, 4])  # rows at rising y


def test_what_a_profilometer_does_not_say_is_asked_for_and_what_it_says_must_agree(tmp_path):
    np.savetxt(tmp_path / "bare.asc", ROWS)
    with pytest.raises(ValueError, match=r"bare\.asc does not say what its heights are in: give unit"):
        HeightFieldFile(path=str(tmp_path / "bare.asc"), periodic="as is").build(0)
    field = read(tmp_path / "bare.asc", pixel_size=(0.5, 2.0), scale=None)
    np.testing.assert_array_equal(field.heights, ROWS[::-1])
    stated = {"path": str(DATA / "gwyfile.gwy"), "periodic": "as is"}
    assert HeightFieldFile(**stated, unit="m", pixel_size=(0.5, 2.0)).build(0).spacing == (0.5, 2.0)
    for wrong, sentence in [
        ({"unit": "um"}, "says that its heights are in m: found unit = 'um', give 'm' or nothing"),
        ({"pixel_size": 1.0}, r"says that its pixels are .* apart: found pixel_size = \(1\.0, 1\.0\), give the former"),
        ({"scale": 2.0}, "says that a stored 1 is 1 m high: found scale = 2, give nothing"),
    ]:
        with pytest.raises(ValueError, match=sentence):
            HeightFieldFile(**stated, **wrong).build(0)


def test_gaps_and_damage_of_a_profilometers_file_are_one_sentence(tmp_path):
    good = (DATA / "surfalize.sdf").read_bytes()
    lowest = struct.pack("<d", np.finfo(np.float64).min)  # what ISO 25178-71 writes where nothing was measured
    for content, sentence in [
        (good[:-8] + lowest, "1 of 12 heights are NaN or infinite: fill the gaps"),
        (good[:-8], r"cannot be read as a \.sdf file \(.*\): it is damaged or of another type"),
        (b"height, height", r"cannot be read as a \.sdf file"),
        (b"", r"cannot be read as a \.sdf file"),
    ]:
        (tmp_path / "a.sdf").write_bytes(content)
        with pytest.raises(ValueError, match=sentence) as error:
            HeightFieldFile(path=str(tmp_path / "a.sdf"), periodic="as is").build(0)
        assert "\n" not in str(error.value)


def test_every_suffix_of_surface_topography_is_known_or_left_out_on_purpose():
    theirs = {f".{suffix}" for reader in SurfaceTopography.IO.readers for suffix in reader.file_extensions()}
    ours = {".npy", ".tif", ".tiff", ".x3p"}
    no_maps_or_no_heights = {".csv", ".hfm", ".hgt", ".mat", ".npz", ".xlsx", ".zip"}
    assert theirs - ours - no_maps_or_no_heights == set(profilometry.SUFFIXES)


def test_without_surface_topography_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    with pytest.raises(ValueError, match=r"gwyfile\.gwy is read by .*: pip install gonio\[profilometry\]$"):
        HeightFieldFile(path=str(DATA / "gwyfile.gwy"), periodic="as is").build(0)
