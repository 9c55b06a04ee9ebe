"""Height maps in and out: foreign writers and readers judge, with a map that has no symmetry."""

import json
import subprocess
import sys

import numpy as np
import OpenEXR
import pytest
import tifffile
from height_maps import CHIRAL, IMAGE, LEVELS, read, write_exr
from PIL import Image, PngImagePlugin

import microsurfaces as ms
from microsurfaces import HeightField, HeightFieldFile, save_surface

WRITERS = {
    "u2.npy": lambda path: np.save(path, LEVELS.astype(np.uint16)),
    "f4.npy": lambda path: np.save(path, LEVELS.astype(np.float32)),
    "i4 big-endian.npy": lambda path: np.save(path, LEVELS.astype(">i4")),
    "column order.npy": lambda path: np.save(path, np.asfortranarray(LEVELS.astype(float))),
    "u2.png": lambda path: Image.fromarray(IMAGE.astype(np.uint16)).save(path),
    "u2.tif": lambda path: tifffile.imwrite(path, IMAGE.astype(np.uint16)),
    "big-endian.tif": lambda path: tifffile.imwrite(path, IMAGE.astype(np.uint16), byteorder=">"),
    "f4.tiff": lambda path: tifffile.imwrite(path, IMAGE.astype(np.float32)),
    "zip.tif": lambda path: tifffile.imwrite(path, IMAGE.astype(np.float32), compression="zlib"),
    "pillow.tif": lambda path: Image.fromarray(IMAGE.astype(np.uint16)).save(path),
    "f4.exr": lambda path: write_exr(path, {"Z": IMAGE.astype(np.float32), "A": 0 * IMAGE.astype(np.float32)}),
    "UPPER.PNG": lambda path: Image.fromarray(IMAGE.astype(np.uint16)).save(path),
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_surface_with_y_upwards(tmp_path, name):
    WRITERS[name](tmp_path / name)
    field = read(tmp_path / name, pixel_size=(0.5, 2.0))
    np.testing.assert_array_equal(field.heights, LEVELS)
    assert field.spacing == (0.5, 2.0)


@pytest.mark.parametrize(("unit", "micrometres"), [("nm", 1e-3), ("um", 1), ("mm", 1e3), ("m", 1e6)])
def test_heights_are_converted_from_their_unit_and_grey_levels(tmp_path, unit, micrometres):
    WRITERS["u2.png"](tmp_path / "u2.png")
    field = read(tmp_path / "u2.png", unit=unit, scale=0.25)
    np.testing.assert_allclose(field.heights, LEVELS * 0.25 * micrometres, rtol=1e-15)


def test_floats_need_no_scale_and_integers_do(tmp_path):
    WRITERS["f4.npy"](tmp_path / "f4.npy")
    WRITERS["u2.npy"](tmp_path / "u2.npy")
    np.testing.assert_array_equal(read(tmp_path / "f4.npy", scale=None).heights, LEVELS)
    with pytest.raises(ValueError, match=r"u2\.npy holds integers \(uint16\): give scale, the height of one .* in um"):
        read(tmp_path / "u2.npy", scale=None)


def test_mirrored_maps_are_four_times_as_large_and_level_at_every_seam(tmp_path):
    WRITERS["f4.npy"](tmp_path / "f4.npy")
    h = read(tmp_path / "f4.npy", periodic="mirror").heights
    assert h.shape == (6, 8)
    np.testing.assert_array_equal(h[:3, :4], LEVELS)
    np.testing.assert_array_equal(h, h[::-1])
    np.testing.assert_array_equal(h, h[:, ::-1])


def test_tapered_maps_keep_their_inside_and_mean_and_meet_at_the_seams(tmp_path):
    z = np.add.outer(np.arange(40.0), 3 * np.arange(60.0))  # a slope: as is, it would end in a cliff
    np.save(tmp_path / "slope.npy", z)
    h = read(tmp_path / "slope.npy", periodic="taper").heights
    np.testing.assert_array_equal(h[4:-4, 6:-6], z[4:-4, 6:-6])
    assert h.mean() == pytest.approx(z.mean())
    across = np.abs(np.roll(h, -1, axis=1) - h)[:, -1]
    assert across.max() < 0.02 * np.ptp(z)
    # The first node lies half a cell inside the edge: sin²(π/2 · 0.5/6) of its height is left.
    share = np.sin(np.pi / 4 / 6) ** 2
    np.testing.assert_allclose(h[20, 0] - z.mean(), share * (z[20, 0] - z.mean()), rtol=1e-12)


# --- Saved surfaces ---------------------------------------------------------------------------------------------------


def test_npy_round_trip_is_exact(tmp_path):
    save_surface(CHIRAL, tmp_path / "a.npy")
    assert np.array_equal(np.load(tmp_path / "a.npy"), CHIRAL.heights)
    assert np.array_equal(read(tmp_path / "a.npy").heights, CHIRAL.heights)


def test_exr_has_metres_in_channel_z_top_row_first_and_knows_its_pixels(tmp_path):
    save_surface(CHIRAL, tmp_path / "a.exr")
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        np.testing.assert_array_equal(file.channels()["Z"].pixels, (CHIRAL.heights[::-1] * 1e-6).astype(np.float32))
        assert json.loads(file.header()["gonio.json"]) == {"pixel_size": [0.5, 2.0], "unit": "m"}
    field = read(tmp_path / "a.exr", unit="m", pixel_size=(0.5, 2.0))
    np.testing.assert_allclose(field.heights, CHIRAL.heights, rtol=2**-23)
    with pytest.raises(ValueError, match=r"says that its heights are in m: found unit = 'um', give 'm'"):
        read(tmp_path / "a.exr", pixel_size=(0.5, 2.0))
    with pytest.raises(
        ValueError, match=r"says that its pixels are \(0\.5, 2\.0\) µm apart: found pixel_size = \(2\.0, 0\.5\)"
    ):
        read(tmp_path / "a.exr", unit="m", pixel_size=(2.0, 0.5))


# How far a height may be off: half a grey level of .png, the rounding of the conversion to metres and back.
ROUNDING = {
    ".npy": 0.0,
    ".png": np.ptp(CHIRAL.heights) / 65535 * 0.501,
    ".exr": np.abs(CHIRAL.heights).max() * 2.0**-24 * 1.001,
    ".x3p": np.abs(CHIRAL.heights).max() * 2.0**-51,
}


@pytest.mark.parametrize("suffix", ROUNDING)
def test_every_height_format_comes_back_with_its_spacing_and_orientation(tmp_path, suffix):
    save_surface(CHIRAL, tmp_path / f"a{suffix}")
    stated = {"unit": "um", "pixel_size": (0.5, 2.0)} if suffix == ".npy" else {}
    field = HeightFieldFile(path=str(tmp_path / f"a{suffix}"), periodic="as is", **stated).build(0)
    assert field.spacing == pytest.approx((0.5, 2.0), rel=1e-15)
    np.testing.assert_allclose(field.heights, CHIRAL.heights, rtol=0, atol=ROUNDING[suffix])


@pytest.mark.parametrize("suffix", ROUNDING)
def test_the_same_relief_gives_the_same_bytes(tmp_path, suffix):
    for name in ("a", "b"):
        save_surface(CHIRAL, tmp_path / f"{name}{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_png_has_grey_levels_top_row_first_and_says_what_they_mean(tmp_path):
    save_surface(CHIRAL, tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "I;16"
        about = json.loads(image.text["gonio.json"])
        levels = np.asarray(image)
    assert about["pixel_size"] == [0.5, 2.0]
    heights = about["minimum"] + levels / 65535 * (about["maximum"] - about["minimum"])
    np.testing.assert_allclose(heights[::-1], CHIRAL.heights, rtol=0, atol=ROUNDING[".png"])
    with pytest.raises(ValueError, match=r"says that a stored 1 is .* um high: found scale = 1, give nothing"):
        read(tmp_path / "a.png", pixel_size=(0.5, 2.0))


def test_a_flat_surface_has_one_grey_level(tmp_path):
    save_surface(HeightField(np.full((3, 4), 2.5), (1, 1)), tmp_path / "flat.png")
    field = HeightFieldFile(path=str(tmp_path / "flat.png"), periodic="as is").build(0)
    assert np.array_equal(field.heights, np.full((3, 4), 2.5))


def test_what_neither_the_file_nor_the_recipe_says_is_asked_for(tmp_path):
    save_surface(CHIRAL, tmp_path / "a.npy")
    with pytest.raises(ValueError, match=r"a\.npy does not say how far apart its pixels are: give pixel_size, in µm"):
        read(tmp_path / "a.npy", pixel_size=None)
    with pytest.raises(
        ValueError, match=r"a\.npy does not say what its heights are in: give unit, one of nm, um, mm, m"
    ):
        read(tmp_path / "a.npy", unit=None)


def test_a_description_that_makes_no_sense_is_damage(tmp_path):
    good = {"pixel_size": [1, 1], "unit": "um", "minimum": 0, "maximum": 1}
    for about in (
        "{", "[]", "{}", "[" * 100_000, json.dumps(good | {"pixel_size": [1, 0]}), json.dumps(good | {"unit": "inch"}),
        json.dumps(good | {"maximum": -1}), json.dumps(good | {"minimum": "low"}),
        json.dumps(good | {"pixel_size": [1, 1, 1]}), json.dumps(good | {"maximum": float("inf")}),
    ):  # fmt: skip
        text = PngImagePlugin.PngInfo()
        text.add_text("gonio.json", about)
        Image.fromarray(IMAGE.astype(np.uint16)).save(tmp_path / "a.png", pnginfo=text)
        with pytest.raises(ValueError, match=r"a\.png cannot be read as a \.png file \(.*: it is damaged") as error:
            read(tmp_path / "a.png")
        assert "\n" not in str(error.value)
        assert len(str(error.value)) < 500


def test_saving_refuses_in_words_and_leaves_nothing_behind(tmp_path):
    mesh = ms.Cylinders().build(0)
    (tmp_path / "folder.npy").mkdir()
    for relief, name, sentence in [
        (CHIRAL, "a.bmp", r"suffix '\.bmp': expected one of \.npy, \.png, \.exr, \.x3p, \.ply, \.stl, \.obj$"),
        (CHIRAL, "folder.npy", r"cannot be written .*choose a place that is writable"),
        (CHIRAL, "a", r"suffix '': expected one of"),
        (mesh, "a.npy", r"a mesh is not a height map: save it as \.ply, \.stl, \.obj"),
        (mesh, "a.exr", r"a mesh is not a height map"),
        (mesh, "a.png", r"a mesh is not a height map"),
        (mesh, "a.x3p", r"a mesh is not a height map"),
        (CHIRAL, "none/a.npy", r"cannot be written: the folder .*none does not exist"),
        (CHIRAL, "none/a.exr", r"cannot be written: the folder .*none does not exist"),
        (CHIRAL, "none/a.x3p", r"cannot be written: the folder .*none does not exist"),
        (mesh, "none/a.stl", r"cannot be written: the folder .*none does not exist"),
    ]:
        with pytest.raises(ValueError, match=sentence):
            save_surface(relief, tmp_path / name)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.npy"]


def test_an_interrupted_save_keeps_the_old_file(tmp_path, monkeypatch):
    save_surface(CHIRAL, tmp_path / "a.npy")

    def full_disk(path, array):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "save", full_disk)
    with pytest.raises(ValueError, match="No space left on device"):
        save_surface(HeightField(np.zeros((2, 2)), (1, 1)), tmp_path / "a.npy")
    monkeypatch.undo()
    assert [p.name for p in tmp_path.iterdir()] == ["a.npy"]
    assert np.array_equal(np.load(tmp_path / "a.npy"), CHIRAL.heights)


def test_readers_are_imported_only_when_they_are_needed():
    program = (
        "import microsurfaces, sys; print(sys.modules.keys() & {'SurfaceTopography', 'PIL', 'OpenEXR', 'tifffile'})"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "set()\n"
