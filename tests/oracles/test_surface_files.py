"""Height maps and meshes in and out: foreign writers and readers judge, with a map that has no symmetry."""

import io
import json
import struct
import subprocess
import sys
import warnings
import zipfile
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import tifffile
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image, PngImagePlugin
from pydantic import ValidationError

import microsurfaces as ms
from microsurfaces import HeightField, HeightFieldFile, MeshFile, save_surface
from microsurfaces.files import profilometry

DATA = Path(__file__).parents[1] / "data" / "profilometry"

# Levels of grey; seen as an image, row 0 is the top. The surface has them the other way up.
IMAGE = np.array([[10, 20, 30, 40], [11, 12, 13, 14], [900, 1, 65535, 7]])
LEVELS = IMAGE[::-1]


def write_exr(path, channels, **attributes):
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, **attributes}
    OpenEXR.File(header, {name: np.ascontiguousarray(pixels) for name, pixels in channels.items()}).write(str(path))


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


def read(path, **given):
    return HeightFieldFile(
        **{"path": str(path), "pixel_size": 1.0, "unit": "um", "periodic": "as is", "scale": 1.0} | given
    ).build(0)


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

CHIRAL = HeightField(LEVELS * 1e-3 + 0.1, (0.5, 2.0))


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


# --- x3p --------------------------------------------------------------------------------------------------------------


def x3p(path, main, members=(), packed=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", packed) as archive:
        archive.writestr("main.xml", main)
        for name, content in dict(members).items():
            archive.writestr(name, bytes(content))


def main_xml(record3, cz="<DataType>D</DataType>", feature="SUR", axis="I", size=(4, 3, 1), head="", step="5e-7"):
    """A main.xml as ISO 25178-72 has it, of 4 x 3 points 0.5 µm and 2 µm apart."""
    x, y, z = size
    return f"""<?xml version="1.0" encoding="UTF-8"?>{head}
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2"><Record1><Revision>ISO25178-72:2017/DAM1</Revision>
<FeatureType>{feature}</FeatureType><Axes>
<CX><AxisType>{axis}</AxisType><DataType>D</DataType><Increment>{step}</Increment><Offset>0.0</Offset></CX>
<CY><AxisType>I</AxisType><DataType>D</DataType><Increment>2.0E-0006</Increment></CY>
<CZ><AxisType>A</AxisType>{cz}</CZ></Axes></Record1>
<Record3><MatrixDimension><SizeX>{x}</SizeX><SizeY>{y}</SizeY><SizeZ>{z}</SizeZ></MatrixDimension>{record3}</Record3>
<Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4></p:ISO5436_2>"""


LINK = "<DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink>"
VALID = LINK.replace("</DataLink>", "<ValidPointsLink>bindata/valid.bin</ValidPointsLink></DataLink>")
LIST = "<DataList>" + "".join(f"<Datum>{z}</Datum>" for z in LEVELS.ravel()) + "</DataList>"
ALL = np.packbits(np.ones(12, bool), bitorder="little").tobytes()
ALL_BUT_THE_SEVENTH = np.packbits(np.arange(12) != 6, bitorder="little").tobytes()


def z_axis(kind, step="1", offset="0"):
    return f"<DataType>{kind}</DataType><Increment>{step}</Increment><Offset>{offset}</Offset>"


X3P = {
    "float64": (main_xml(LINK), {"bindata/data.bin": LEVELS.astype("<f8")}),
    "float32": (main_xml(LINK, z_axis("F")), {"bindata/data.bin": LEVELS.astype("<f4")}),
    "int32": (main_xml(LINK, z_axis("L", "0.5", "-3")), {"bindata/data.bin": (2 * LEVELS + 6).astype("<i4")}),
    "int16": (
        main_xml(VALID, z_axis("I", "1.0E+0000", "32768")),
        {"bindata/data.bin": (LEVELS - 32768).astype("<i2"), "bindata/valid.bin": ALL},
    ),
    "text": (main_xml(LIST), {}),
}


@pytest.mark.parametrize("name", X3P)
def test_x3p_of_every_type_is_read_by_the_standard_with_the_first_row_at_the_lowest_y(tmp_path, name):
    x3p(tmp_path / "a.x3p", *X3P[name])
    field = HeightFieldFile(path=str(tmp_path / "a.x3p"), periodic="as is").build(0)
    np.testing.assert_allclose(field.heights, LEVELS * 1e6, rtol=1e-15)
    assert field.spacing == pytest.approx((0.5, 2.0), rel=1e-15)


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj"])
@pytest.mark.parametrize("relief", [CHIRAL, ms.Cylinders(distance=2.5, chords=16).build(0)], ids=["field", "mesh"])
def test_meshes_come_back_through_trimesh_triangle_by_triangle(tmp_path, relief, suffix):
    save_surface(relief, tmp_path / f"a{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes()[:5] != b"solid"
    mesh = relief.mesh() if isinstance(relief, HeightField) else relief
    back = MeshFile(path=str(tmp_path / f"a{suffix}"), period=mesh.period, unit="um").build(0)
    rounded = mesh.vertices[mesh.faces].astype(np.float32)
    if suffix == ".obj":  # text of eight decimals
        np.testing.assert_allclose(back.vertices[back.faces], mesh.vertices[mesh.faces], rtol=0, atol=0.6e-8)
    else:
        assert np.array_equal(back.vertices[back.faces].astype(np.float32), rounded)
    external = trimesh.load_mesh(str(tmp_path / f"a{suffix}"))
    np.testing.assert_allclose(external.bounds, np.stack([rounded.min((0, 1)), rounded.max((0, 1))]), atol=2e-6)
    assert [file.name for file in tmp_path.iterdir()] == [f"a{suffix}"]


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


def test_gaps_of_x3p_are_counted_whether_marked_by_bits_nan_or_empty_text(tmp_path):
    levels = LEVELS.astype("<i4")
    gap = np.where(np.arange(12).reshape(3, 4) == 6, np.nan, LEVELS)
    for main, members in (
        (main_xml(VALID, z_axis("L")), {"bindata/data.bin": levels, "bindata/valid.bin": ALL_BUT_THE_SEVENTH}),
        (main_xml(LINK), {"bindata/data.bin": gap}),
        (main_xml(LIST.replace(f"<Datum>{LEVELS[1, 2]}</Datum>", "<Datum/>")), {}),
    ):
        x3p(tmp_path / "a.x3p", main, members)
        with pytest.raises(ValueError, match="1 of 12 heights are NaN or infinite: fill the gaps of the map first"):
            HeightFieldFile(path=str(tmp_path / "a.x3p"), periodic="as is").build(0)


def bomb(size):
    """A deflated member of `size` zeros that is a thousandth as large, with its size as it is in the directory."""
    return bytes(size)


BILLION_LAUGHS = "<!DOCTYPE x [" + "".join(
    f'<!ENTITY a{i} "{f"&a{i - 1};" * 10 if i else "ha"}">' for i in range(10)
) + "]>"  # fmt: skip

HEIGHTS = {"bindata/data.bin": LEVELS.astype("<f8")}
BAD_X3P = {
    "no main.xml": (("", {}), "File is not a zip file|no item named"),
    "empty main.xml": (("", {}), "no element found"),
    "profile": ((main_xml(LINK, feature="PRF"), HEIGHTS), "it holds PRF I I A 1, not a surface on a regular grid"),
    "irregular": ((main_xml(LINK, axis="A"), HEIGHTS), "it holds SUR A I A 1, not a surface"),
    "layers": ((main_xml(LINK, size=(4, 3, 2)), HEIGHTS), "it holds SUR I I A 2, not a surface"),
    "type": ((main_xml(LINK, z_axis("Q")), HEIGHTS), "'Q'"),
    "no type": ((main_xml(LINK, ""), HEIGHTS), "has no Record1/Axes/CZ/DataType"),
    "step": ((main_xml(LINK, step="0"), HEIGHTS), "its increments are 0, 2e-06 and 1 m"),
    "nan step": ((main_xml(LINK, step="nan"), HEIGHTS), "its increments are nan, 2e-06 and 1 m"),
    "size": ((main_xml(LINK, size=("9" * 5000, 3, 1)), HEIGHTS), "digits"),
    "many": ((main_xml(LINK, size=(10**6, 10**6, 1)), HEIGHTS), "1000000 x 1000000 pixels: more than 67108864 nodes"),
    "negative": ((main_xml(LINK, size=(-4, -3, 1)), HEIGHTS), "-4 x -3 pixels: expected at least 2 x 2"),
    "short": ((main_xml(LINK), {"bindata/data.bin": bytes(88)}), "it holds 11 of 12 heights"),
    "long": ((main_xml(LINK), {"bindata/data.bin": bytes(104)}), "unpacks to 104 bytes, more than 96"),
    "no data": ((main_xml(LINK), {}), "no item named 'bindata/data.bin' in the archive"),
    "few": ((main_xml(LIST.replace("<Datum>1</Datum>", "")), {}), "it holds 11 of 12 heights"),
    "words": ((main_xml(LIST.replace("<Datum>1</Datum>", "<Datum>one</Datum>")), {}), "could not convert string"),
    "valid": (
        (main_xml(VALID), HEIGHTS | {"bindata/valid.bin": bytes(1)}),
        "it holds 8 bits of validity for 12 heights",
    ),
    "bomb of data": ((main_xml(LINK), {"bindata/data.bin": bomb(1 << 28)}), "unpacks to 268435456 bytes, more than 96"),
    "bomb of text": ((bomb(1 << 28), {}), "main.xml unpacks to 268435456 bytes, more than 67108864"),
    "laughs": ((main_xml(LIST, head=BILLION_LAUGHS, feature="&a9;"), {}), "its main.xml defines a document type"),
    "depth": (("<a>" * 10**6, {}), "its main.xml is nested too deeply"),
    "lzma": ((main_xml(LINK), HEIGHTS, zipfile.ZIP_LZMA), "its main.xml is packed neither plain nor by deflate"),
}


@pytest.mark.parametrize("name", BAD_X3P)
def test_a_bad_or_hostile_x3p_is_one_sentence(tmp_path, name):
    content, sentence = BAD_X3P[name]
    x3p(tmp_path / "a.x3p", *content)
    if name == "no main.xml":
        zipfile.ZipFile(tmp_path / "a.x3p", "w").close()
    with pytest.raises(ValueError, match=sentence) as error:
        HeightFieldFile(path=str(tmp_path / "a.x3p"), periodic="as is").build(0)
    assert str(error.value).startswith(str(tmp_path / "a.x3p"))
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_a_member_that_lies_about_its_size_is_cut_where_the_directory_says(tmp_path):
    x3p(tmp_path / "a.x3p", main_xml(LINK), {"bindata/data.bin": bomb(1 << 26)})
    lie = (tmp_path / "a.x3p").read_bytes().replace(struct.pack("<I", 1 << 26), struct.pack("<I", 96))
    (tmp_path / "a.x3p").write_bytes(lie)
    with pytest.raises(ValueError, match="Bad CRC-32"):
        HeightFieldFile(path=str(tmp_path / "a.x3p"), periodic="as is").build(0)


# --- Profilometers ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def surface_topography():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns that there is no MPI
        return pytest.importorskip("SurfaceTopography")


# Written by other libraries: tests/data/profilometry/README.md. The same rows from the top down, or with y upwards.
ROWS = np.array([[10, 20, 30, 40], [11, 12, 13, 14], [900, 1, 655, 7]]) * 1e-3
FOREIGN = {
    "x3pio_int16.x3p": ROWS,
    "x3pio_text.x3p": ROWS,
    "surfalize.x3p": ROWS,
    "surfalize.sdf": ROWS,
    "surfalize_ascii.sdf": ROWS,
    "surfalize.al3d": ROWS[::-1],
    "surfalize.sur": ROWS[::-1],
    "gwyfile.gwy": ROWS[::-1],
}


@pytest.mark.parametrize("name", FOREIGN)
def test_profilometers_say_heights_spacing_and_unit_themselves(request, name):
    if not name.endswith(".x3p"):
        request.getfixturevalue("surface_topography")
    field = HeightFieldFile(path=str(DATA / name), periodic="as is").build(0)
    assert field.spacing == pytest.approx((0.5, 2.0), rel=1e-6)
    heights = field.heights
    if name.endswith(".sur"):
        heights = heights - heights[-1, 0] + 0.01  # surfalize stores the distance from the middle of its integers
    np.testing.assert_allclose(heights, FOREIGN[name], rtol=0, atol=1.4e-5 if "int16" in name else 1e-7)


def test_surface_topography_reads_our_x3p(surface_topography, tmp_path):
    save_surface(CHIRAL, tmp_path / "a.x3p")
    with surface_topography.open_topography(str(tmp_path / "a.x3p")) as reader:
        topography = reader.topography().to_unit("µm")
        np.testing.assert_allclose(topography.heights().T, CHIRAL.heights, rtol=1e-14)
        assert topography.pixel_size == pytest.approx((0.5, 2.0), rel=1e-14)
        assert topography.positions()[1][0] == pytest.approx([0, 2, 4])  # rows at rising y


@pytest.mark.usefixtures("surface_topography")
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


@pytest.mark.usefixtures("surface_topography")
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


def test_every_suffix_of_surface_topography_is_known_or_left_out_on_purpose(surface_topography):
    theirs = {f".{suffix}" for reader in surface_topography.IO.readers for suffix in reader.file_extensions()}
    ours = {".npy", ".tif", ".tiff", ".x3p"}
    no_maps_or_no_heights = {".csv", ".hfm", ".hgt", ".mat", ".npz", ".xlsx", ".zip"}
    assert theirs - ours - no_maps_or_no_heights == set(profilometry.SUFFIXES)


def test_without_surface_topography_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    with pytest.raises(ValueError, match=r"gwyfile\.gwy is read by .*: pip install gonio\[profilometry\]$"):
        HeightFieldFile(path=str(DATA / "gwyfile.gwy"), periodic="as is").build(0)


def test_readers_are_imported_only_when_they_are_needed():
    program = (
        "import microsurfaces, sys; print(sys.modules.keys() & {'SurfaceTopography', 'PIL', 'OpenEXR', 'tifffile'})"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "set()\n"


# --- Bad height maps --------------------------------------------------------------------------------------------------


def with_gap(value):
    z = LEVELS.astype(float)
    z[1, 2] = value
    return z


def cut(path, write, share):
    write(path)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])


BIG = np.random.default_rng(1).integers(0, 65535, (100, 100)).astype(np.uint16)
COLOUR = np.zeros((4, 4, 3), dtype=np.uint8)
BAD_MAPS = {
    "nan.npy": (lambda p: np.save(p, with_gap(np.nan)), "1 of 12 heights are NaN or infinite: fill the gaps"),
    "inf.npy": (lambda p: np.save(p, with_gap(np.inf)), "1 of 12 heights are NaN or infinite"),
    "nan.tif": (lambda p: tifffile.imwrite(p, with_gap(np.nan).astype(np.float32)), "1 of 12 heights"),
    "nan.exr": (lambda p: write_exr(p, {"Z": with_gap(np.nan).astype(np.float32)}), "1 of 12 heights"),
    "none.npy": (lambda p: None, "does not exist: give the path of a file, relative to"),
    "folder.png": (lambda p: p.mkdir(), "is a folder: give the path of a file"),
    "empty.npy": (lambda p: p.write_bytes(b""), "cannot be read as a .npy file.*damaged or of another type"),
    "empty.png": (lambda p: p.write_bytes(b""), "cannot be read as a .png file"),
    "empty.tif": (lambda p: p.write_bytes(b""), "cannot be read as a .tif file"),
    "empty.exr": (lambda p: p.write_bytes(b""), "cannot be read as a .exr file"),
    "text.npy": (lambda p: p.write_text("height, height"), "cannot be read as a .npy file"),
    "text.png": (lambda p: p.write_text("height, height"), "cannot be read as a .png file"),
    "pickle.npy": (
        lambda p: np.save(p, np.array([{}, 1], dtype=object), allow_pickle=True),
        "cannot be read as a .npy",
    ),
    "cut.npy": (lambda p: cut(p, lambda q: np.save(q, BIG), 0.6), "cannot be read as a .npy file"),
    "cut.png": (lambda p: cut(p, Image.fromarray(BIG).save, 0.6), "cannot be read as a .png file"),
    "cut.tif": (lambda p: cut(p, lambda q: tifffile.imwrite(q, BIG), 0.6), "cannot be read as a .tif file"),
    "cut.exr": (
        lambda p: cut(p, lambda q: write_exr(q, {"Z": BIG.astype(np.float32)}), 0.6),
        "cannot be read as a .exr",
    ),
    "no pixels.npy": (lambda p: np.save(p, np.zeros((0, 5))), "5 x 0 pixels: expected at least 2 x 2"),
    "pixel.npy": (lambda p: np.save(p, np.zeros((1, 1))), "1 x 1 pixels: expected at least 2 x 2"),
    "pixel.png": (lambda p: Image.fromarray(BIG[:1, :1]).save(p), "1 x 1 pixels: expected at least 2 x 2"),
    "row.tif": (lambda p: tifffile.imwrite(p, BIG[:1]), "100 x 1 pixels: expected at least 2 x 2"),
    "list.npy": (lambda p: np.save(p, np.zeros(7)), r"shape \(7,\): expected one map"),
    "colour.png": (
        lambda p: Image.fromarray(COLOUR).save(p),
        r"shape \(4, 4, 3\): expected one map.*single grey channel",
    ),
    "colour.tif": (lambda p: tifffile.imwrite(p, COLOUR, photometric="rgb"), r"shape \(4, 4, 3\): expected one map"),
    "pages.tif": (lambda p: tifffile.imwrite(p, np.zeros((2, 9, 9), np.float32)), r"shape \(2, 9, 9\): .* single page"),
    "grey8.png": (lambda p: Image.fromarray(COLOUR[..., 0]).save(p), "8 bits a pixel: 256 levels make steps"),
    "palette.png": (lambda p: Image.fromarray(COLOUR[..., 0]).convert("P").save(p), "8 bits a pixel"),
    "grey8.tif": (lambda p: tifffile.imwrite(p, COLOUR[..., 0]), "8 bits a pixel"),
    "complex.npy": (lambda p: np.save(p, LEVELS * 1j), "values of type complex128: expected real heights"),
    "bool.npy": (lambda p: np.save(p, LEVELS > 9), "values of type bool: expected real heights"),
    "rgb.exr": (
        lambda p: write_exr(p, dict.fromkeys("RGB", IMAGE.astype(np.float32))),
        "channels B, G, R: expected .* Z",
    ),
    "map.jpg": (
        lambda p: Image.fromarray(COLOUR).save(p),
        r"suffix '\.jpg': expected a height map, one of \.npy, \.png",
    ),
    "huge.png": (lambda p: Image.new("I;16", (9000, 8000)).save(p), "9000 x 8000 pixels: more than"),
    "bomb.png": (
        lambda p: p.write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(">II", 10**6, 10**6)),
        "1000000 x 1000000 pixels: more than",
    ),
    "huge.npy": (
        lambda p: np.lib.format.open_memmap(p, "w+", np.uint16, (9000, 9000)),
        "9000 x 9000 pixels: more than",
    ),
}


@pytest.mark.parametrize("name", BAD_MAPS)
def test_a_bad_height_map_is_named_in_one_sentence(tmp_path, name):
    write, sentence = BAD_MAPS[name]
    write(tmp_path / name)
    with pytest.raises(ValueError, match=sentence) as error:
        read(tmp_path / name)
    assert str(error.value).startswith(str(tmp_path / name))
    assert "\n" not in str(error.value)


def test_a_map_that_would_be_too_large_once_mirrored_is_refused(tmp_path):
    np.lib.format.open_memmap(tmp_path / "a.npy", "w+", np.uint16, (5000, 5000))
    with pytest.raises(ValueError, match="5000 x 5000 pixels: more than 67108864 nodes once mirrored; crop"):
        read(tmp_path / "a.npy", periodic="mirror")


def test_a_tiff_whose_strip_unpacks_to_more_than_the_image_is_refused(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", BIG, compression="zlib", rowsperstrip=100)
    content = (tmp_path / "a.tif").read_bytes()
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        (start,), (count,) = tiff.pages[0].dataoffsets, tiff.pages[0].databytecounts
    bomb_of_zeros = zlib.compress(bytes(1 << 24), 9)
    assert len(bomb_of_zeros) < count
    (tmp_path / "a.tif").write_bytes(content[:start] + bomb_of_zeros + content[start + len(bomb_of_zeros) :])
    with pytest.raises(ValueError, match="a strip of it unpacks to more than the whole image"):
        read(tmp_path / "a.tif")
    tifffile.imwrite(tmp_path / "a.tif", BIG, compression="lzma")
    with pytest.raises(ValueError, match="its compression is number 34925, not one of none, LZW, PackBits, deflate"):
        read(tmp_path / "a.tif")


def test_an_exr_of_many_large_channels_is_refused_before_it_is_read(tmp_path):
    rows = {f"c{i}": np.zeros((2048, 2048), np.float16) for i in range(65)}
    write_exr(tmp_path / "a.exr", rows | {"Z": np.zeros((2048, 2048), np.float32)})
    with pytest.raises(ValueError, match="its channels hold 276824064 values, more than 268435456"):
        read(tmp_path / "a.exr")


def packed_in_strips(path):
    tifffile.imwrite(path, BIG[:20, :30], compression="zlib", rowsperstrip=7)


def packed_in_tiles(path):
    tifffile.imwrite(path, BIG[:20, :30].astype(np.float32), tile=(16, 16))


SOUND = {
    "saved.npy": lambda path: save_surface(CHIRAL, path),
    "saved.png": lambda path: save_surface(CHIRAL, path),
    "saved.exr": lambda path: save_surface(CHIRAL, path),
    "saved.x3p": lambda path: save_surface(CHIRAL, path),
    "text.x3p": lambda path: x3p(path, *X3P["text"]),
    "bits.x3p": lambda path: x3p(path, *X3P["int16"]),
    "strips.tif": packed_in_strips,
    "tiles.tif": packed_in_tiles,
}


@st.composite
def damaged(draw, content):
    """Bytes like `content`: cut, overwritten here and there, or with a part taken out, doubled or replaced."""
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(content)))
        stop = start + draw(st.sampled_from([0, 1, 2, 4, 8, 30, len(content)]))
        part = draw(
            st.one_of(st.binary(max_size=9), st.sampled_from([b"", b"\xff" * 4, b"\0" * 8, content[start:stop] * 2]))
        )
        content = content[:start] + part + content[stop:]
    return content


@st.composite
def damaged_x3p(draw, path):
    """An archive whose members are damaged, and which itself is sound."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = draw(st.sampled_from(["main.xml", *members]))
    members[name] = draw(damaged(members[name]))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


@pytest.mark.parametrize("name", SOUND)
@settings(max_examples=100, deadline=5000, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_content_does_more_than_raise_one_sentence(tmp_path, name, data):
    SOUND[name](tmp_path / name)
    stated = {"pixel_size": 1.0, "unit": "um", "scale": 1.0} if name.endswith((".npy", ".tif")) else {}
    kinds = [st.binary(max_size=200), damaged((tmp_path / name).read_bytes())]
    kinds += [damaged_x3p(tmp_path / name)] * 2 if name.endswith(".x3p") else []
    (tmp_path / name).write_bytes(data.draw(st.one_of(kinds)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # as Pillow and tifffile do before they raise, or read on
        try:
            field = HeightFieldFile(path=str(tmp_path / name), periodic="as is", **stated).build(0)
        except ValueError as error:
            assert str(error).startswith(str(tmp_path / name))  # noqa: PT017
            assert "\n" not in str(error)  # noqa: PT017
        else:
            assert np.isfinite(field.heights).all()


@pytest.mark.parametrize(
    ("wrong", "fields", "sentence"),
    [
        ({"unit": "inch"}, ["unit"], "'nm', 'um', 'mm' or 'm'"),
        ({"periodic": "yes"}, ["periodic"], "'mirror', 'taper' or 'as is'"),
        ({"pixel_size": 0.0}, ["pixel_size"], "greater than 0"),
        ({"pixel_size": (1.0, -1.0)}, ["pixel_size"], "greater than 0"),
        ({"pixel_size": "one"}, ["pixel_size"], "valid number"),
        ({"scale": -1.0}, ["scale"], "greater than 0"),
        ({"pixel_size": (1.0, 2.0, 3.0), "unit": 3}, ["pixel_size", "unit"], "at most 2 items"),
    ],
)
def test_bad_parameters_are_one_mistake_each(wrong, fields, sentence):
    given = {"path": "a.npy", "pixel_size": 1.0, "unit": "um", "periodic": "mirror"} | wrong
    with pytest.raises(ValidationError, match=sentence) as error:
        HeightFieldFile(**given)
    assert [mistake["loc"][0] for mistake in error.value.errors()] == fields


# --- Meshes -----------------------------------------------------------------------------------------------------------


def overhanging():
    """A profile that leans over, drawn along y: one period of 1 x 1."""
    x, z = [0, 0.7, 0.3, 1], [0, 0.0, 1, 0]
    vertices = [[a, y, b] for y in (0.0, 1.0) for a, b in zip(x, z, strict=True)]
    return trimesh.Trimesh(
        vertices, [f for i in range(3) for f in ([i, i + 1, i + 5], [i, i + 5, i + 4])], process=False
    )


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj", "off", "glb"])
def test_an_overhang_is_read_from_any_format_and_keeps_its_faces(tmp_path, suffix):
    overhanging().export(str(tmp_path / f"a.{suffix}"))
    mesh = MeshFile(path=str(tmp_path / f"a.{suffix}"), period=(1000.0, 1000.0), unit="mm").build(0)
    np.testing.assert_allclose(mesh.vertices[mesh.faces], 1000 * overhanging().triangles, atol=1e-4)
    assert (mesh.normals()[:, 2] < 0).sum() == 2
    assert mesh.single_valued is False


def test_bad_mesh_files_are_named_in_one_sentence(tmp_path):
    good = overhanging()
    good.export(str(tmp_path / "good.ply"))
    cut(tmp_path / "cut.ply", lambda p: good.export(str(p)), 0.6)
    cut(tmp_path / "cut.stl", lambda p: good.export(str(p)), 0.6)
    (tmp_path / "text.ply").write_text("hello")
    trimesh.PointCloud(good.vertices).export(str(tmp_path / "points.ply"))
    good.invert()
    good.export(str(tmp_path / "down.ply"))
    for name, period, sentence in [
        ("none.ply", (1.0, 1.0), "does not exist"),
        ("cut.ply", (1.0, 1.0), "cannot be read as a mesh|has no faces"),
        ("cut.stl", (1.0, 1.0), "cannot be read as a mesh|has no faces"),
        ("text.ply", (1.0, 1.0), "cannot be read as a mesh|has no faces"),
        ("points.ply", (1.0, 1.0), "has no faces: expected a triangle mesh"),
        ("good.ply", (1.0, 2.0), "cover 1 µm² .* 1 x 2 µm is 2 µm².*own period and unit"),
        ("down.ply", (1.0, 1.0), "point down.*reverse every face"),
    ]:
        with pytest.raises(ValueError, match=sentence) as error:
            MeshFile(path=str(tmp_path / name), period=period, unit="um").build(0)
        assert str(error.value).startswith(str(tmp_path / name))
        assert "\n" not in str(error.value)
