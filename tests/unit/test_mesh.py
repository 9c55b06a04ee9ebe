"""Mesh: closed forms of solids, what is refused, displacement, trimesh as a foreign judge."""

import numpy as np
import pytest

import microsurfaces as ms
from microsurfaces import Mesh


def pyramid(height=0.7):
    """Square pyramid of half width 1 standing on a tile of 2 x 2."""
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, height]], dtype=float)
    faces = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    return Mesh(vertices, faces, (2.0, 2.0))


def extruded(x, z):
    """A polyline from (0, z0) to (1, z0) drawn along y over a tile of 1 x 1."""
    n = len(x)
    vertices = np.array([[a, y, b] for y in (0.0, 1.0) for a, b in zip(x, z, strict=True)])
    faces = [f for i in range(n - 1) for f in ([i, i + 1, i + n + 1], [i, i + n + 1, i + n])]
    return Mesh(vertices, faces, (1.0, 1.0))


def post():
    """A ridge of height 2 with vertical walls, over 0.3 of the tile."""
    return extruded([0, 0.2, 0.2, 0.5, 0.5, 1], [0, 0, 2, 2, 0, 0])


def overhanging():
    return extruded([0, 0.7, 0.3, 1], [0, 0.0, 1, 0])


def test_statistics_of_a_pyramid_are_those_of_a_beta_distribution():
    h = 0.7  # the share of the plane above z is (1 - z/h)²: heights are h Beta(1, 2)
    s = pyramid(h).statistics()
    expected = {
        "Sa": 16 / 81 * h,
        "Sq": h / np.sqrt(18),
        "Ssk": 2 * np.sqrt(2) / 5,
        "Sku": 2.4,
        "Sdq": h,
        "rms_slope_x": h / np.sqrt(2),
        "rms_slope_y": h / np.sqrt(2),
        "beckmann_alpha_x": h,
        "beckmann_alpha_y": h,
        "beckmann_alpha": h,
    }
    found = {name: value for name, value in s.as_dict().items() if value is not None}
    assert found == pytest.approx(expected, rel=1e-13)


def test_areas_normals_and_distributions_of_a_pyramid():
    mesh, h = pyramid(), 0.7
    np.testing.assert_allclose(mesh.areas(), np.hypot(1, h), rtol=1e-15)
    np.testing.assert_allclose(
        mesh.normals() * np.hypot(1, h), [[0, -h, 1], [h, 0, 1], [0, h, 1], [-h, 0, 1]], atol=1e-15
    )
    D, theta, phi = mesh.normal_distribution(theta_bins=90, phi_bins=4)
    row = int(np.degrees(np.arctan(h)))
    solid_angle = (np.cos(np.radians(row)) - np.cos(np.radians(row + 1))) * np.pi / 2
    np.testing.assert_allclose(D[row], np.hypot(1, h) / 4 / solid_angle, rtol=1e-13)
    assert np.count_nonzero(D) == 4
    assert (theta[0], theta[-1], phi[-1]) == (0, 90, 360)
    density, p, q = mesh.slope_distribution(bins=5, limit=1.0)
    assert density[0, 2] == density[4, 2] == density[2, 0] == density[2, 4] == pytest.approx(0.25 / 0.4**2)
    assert density.sum() * (p[1] - p[0]) * (q[1] - q[0]) == pytest.approx(1)


def test_heights_of_a_post_with_vertical_walls_have_moments_and_its_slopes_have_none():
    mesh = post()
    mesh.check()
    s = mesh.statistics()
    assert s.Sq == pytest.approx(2 * np.sqrt(0.3 * 0.7))
    assert s.Sa == pytest.approx(2 * 2 * 0.3 * 0.7)
    assert s.Ssk == pytest.approx(0.4 / np.sqrt(0.21))  # of a Bernoulli variable
    assert s.Sdq is s.rms_slope_x is s.beckmann_alpha is s.correlation_length is None
    assert mesh.slope_distribution()[0].sum() > 0


def test_what_overhangs_has_no_height_parameters():
    mesh = overhanging()
    mesh.check()
    assert set(mesh.statistics().as_dict().values()) == {None}


def test_trimesh_agrees_on_areas_and_normals_and_gives_the_mesh_back():
    mesh = ms.Gaussian(alpha=0.4, side=100.0, correlation_length=10.0, samples=40).build(5).mesh()
    external = mesh.to_trimesh()
    np.testing.assert_allclose(external.area_faces, mesh.areas(), rtol=1e-12)
    np.testing.assert_allclose(external.face_normals, mesh.normals(), atol=1e-13)
    back = Mesh.from_trimesh(external, mesh.period)
    assert np.array_equal(back.vertices, mesh.vertices)
    assert np.array_equal(back.faces, mesh.faces)
    assert external.metadata["period"] == mesh.period


def test_blocks_of_faces_change_nothing(monkeypatch):
    mesh = ms.Gaussian(alpha=0.4, samples=33, side=100.0).build(5).mesh()
    whole = mesh.area_vectors()
    monkeypatch.setattr("microsurfaces.mesh._BLOCK", 100)
    assert np.array_equal(mesh.area_vectors(), whole)


def test_arrays_are_read_only():
    mesh = ms.Cylinders().build(0)
    for array in (mesh.vertices, mesh.faces, mesh.vertex_normals, ms.Flat().build(0).heights):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def changed(**changes):
    mesh = pyramid()
    return Mesh(**{"vertices": mesh.vertices, "faces": mesh.faces, "period": mesh.period} | changes)


def spoilt(value):
    vertices = pyramid().vertices.copy()
    vertices[2, 1] = value
    return vertices


FACES = pyramid().faces
BROKEN = {
    "nan": (changed(vertices=spoilt(np.nan)), r"1 of 5 vertices are NaN or infinite.*repair"),
    "infinite": (changed(vertices=spoilt(np.inf)), r"1 of 5 vertices are NaN or infinite"),
    "index": (changed(faces=FACES + 1), r"vertices 1 to 5: expected indices from 0 to 4"),
    "negative index": (changed(faces=FACES - 1), r"vertices -1 to 3: expected indices from 0 to 4"),
    "degenerate": (changed(faces=[*FACES, [0, 0, 1]]), r"1 of 5 faces are degenerate"),
    "period": (changed(period=(2.0, -2.0)), r"period is \(2\.0, -2\.0\): expected two positive"),
    "period nan": (changed(period=(2.0, np.nan)), r"expected two positive"),
    "open": (changed(period=(2.0, 2.1)), r"cover 4 µm² .* 2 x 2\.1 µm is 4\.2 µm².*close its holes"),
    "hole": (changed(faces=FACES[:3]), r"cover 3 µm² .* is 4 µm²"),
    "upside down": (changed(faces=FACES[:, ::-1]), r"faces point down.*reverse every face"),
    "mixed": (changed(faces=[*FACES[:3], FACES[3][::-1]]), r"1 of 4 faces point down"),
    "quads": (changed(faces=[[0, 1, 2, 3]]), r"faces \(1, 4\): expected \(n, 3\) and \(m, 3\)"),
    "no faces": (changed(faces=np.zeros((0, 3))), r"at least one face"),
    "normals": (changed(vertex_normals=np.zeros((4, 3))), r"vertex_normals has shape \(4, 3\): expected \(5, 3\)"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_mesh_is_named_in_one_sentence(name):
    mesh, sentence = BROKEN[name]
    with pytest.raises(ValueError, match=sentence) as error:
        mesh.check()
    assert "\n" not in str(error.value)


def test_a_plane_is_displaced_by_a_function_of_place():
    mesh = ms.Flat(side=2.0).build(0).mesh()
    moved = mesh.displaced(lambda v: np.cos(np.pi * v[:, 0]))
    np.testing.assert_allclose(moved.vertices[:, 2], np.cos(np.pi * mesh.vertices[:, 0]), atol=1e-15)
    np.testing.assert_array_equal(moved.vertices[:, :2], mesh.vertices[:, :2])
    with pytest.raises(ValueError, match=r"shape \(3,\): expected \(9,\), one value a vertex"):
        mesh.displaced(np.zeros(3))
