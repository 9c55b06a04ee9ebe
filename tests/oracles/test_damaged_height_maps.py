"""Height maps that are damaged, hostile or of another kind: one sentence each."""

import io
import struct
import warnings
import zipfile
import zlib

import numpy as np
import pytest
import tifffile
from height_maps import CHIRAL, IMAGE, LEVELS, X3P, cut, read, write_exr, x3p
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from pydantic import ValidationError

from microsurfaces import HeightFieldFile, save_surface


def with_gap(value):
    z = LEVELS.astype(float)
    z[1, 2] = value
    return z


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
