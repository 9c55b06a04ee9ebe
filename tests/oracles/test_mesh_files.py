"""Meshes in and out, through trimesh and face by face."""

import numpy as np
import pytest
import trimesh
from height_maps import CHIRAL, cut

import microsurfaces as ms
from microsurfaces import HeightField, MeshFile, save_surface


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
