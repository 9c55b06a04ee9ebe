"""Height maps and meshes in and out: foreign writers and readers judge, with a map that has no symmetry."""

import json
import struct

import numpy as np
import OpenEXR
import pytest
import tifffile
import trimesh
from PIL import Image
from pydantic import ValidationError

import microsurfaces as ms
from microsurfaces import HeightField, HeightFieldFile, MeshFile, save_surface

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


@pytest.mark.parametrize("suffix", [".ply", ".stl"])
@pytest.mark.parametrize("relief", [CHIRAL, ms.Cylinders(distance=2.5, chords=16).build(0)], ids=["field", "mesh"])
def test_meshes_come_back_through_trimesh_triangle_by_triangle(tmp_path, relief, suffix):
    save_surface(relief, tmp_path / f"a{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes()[:5] != b"solid"
    mesh = relief.mesh() if isinstance(relief, HeightField) else relief
    back = MeshFile(path=str(tmp_path / f"a{suffix}"), period=mesh.period, unit="um").build(0)
    rounded = mesh.vertices[mesh.faces].astype(np.float32)
    assert np.array_equal(back.vertices[back.faces].astype(np.float32), rounded)
    foreign = trimesh.load_mesh(str(tmp_path / f"a{suffix}"))
    np.testing.assert_allclose(foreign.bounds, np.stack([rounded.min((0, 1)), rounded.max((0, 1))]), atol=1e-12)


def test_saving_refuses_in_words_and_leaves_nothing_behind(tmp_path):
    mesh = ms.Cylinders().build(0)
    (tmp_path / "folder.npy").mkdir()
    for relief, name, sentence in [
        (CHIRAL, "a.bmp", r"suffix '\.bmp': expected one of \.npy, \.exr, \.ply, \.stl"),
        (CHIRAL, "folder.npy", r"cannot be written .*choose a place that is writable"),
        (CHIRAL, "a", r"suffix '': expected one of"),
        (mesh, "a.npy", r"a mesh is not a height map: save it as \.ply or \.stl"),
        (mesh, "a.exr", r"a mesh is not a height map"),
        (CHIRAL, "none/a.npy", r"cannot be written: the folder .*none does not exist"),
        (CHIRAL, "none/a.exr", r"cannot be written: the folder .*none does not exist"),
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
