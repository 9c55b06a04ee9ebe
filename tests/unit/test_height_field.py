"""HeightField: closed forms of a sinusoid, the triangles it becomes, what is refused."""

import tracemalloc

import numpy as np
import pytest

from microsurfaces import Flat, HeightField


def wave(n=360, amplitude=2.0, length=90.0, axis=1):
    x = np.arange(n) * length / n
    z = amplitude * np.sin(2 * np.pi * x / length)
    shape = (6, n) if axis == 1 else (n, 6)
    heights = np.broadcast_to(z if axis == 1 else z[:, None], shape)
    step = length / n
    return HeightField(heights, (step, 3.0) if axis == 1 else (3.0, step))


@pytest.mark.parametrize(("axis", "along", "across"), [(1, "x", "y"), (0, "y", "x")])
def test_statistics_of_a_sinusoid(axis, along, across):
    n, a, length = 360, 2.0, 90.0
    s = wave(n, a, length, axis).statistics().as_dict()
    slope = np.sqrt(2) * a * np.sin(np.pi / n) / (length / n)  # of chords between nodes
    assert s["Sq"] == pytest.approx(a / np.sqrt(2), rel=1e-13)
    assert s["Sa"] == pytest.approx(2 * a / n / np.tan(np.pi / n), rel=1e-12)  # 2a/π for large n
    assert s["Ssk"] == pytest.approx(0, abs=1e-13)
    assert s["Sku"] == pytest.approx(1.5, rel=1e-13)
    assert s[f"rms_slope_{along}"] == pytest.approx(slope, rel=1e-12)
    assert s[f"rms_slope_{across}"] == 0
    assert s[f"beckmann_alpha_{along}"] == pytest.approx(np.sqrt(2) * slope, rel=1e-12)
    assert s["beckmann_alpha"] == s["Sdq"] == pytest.approx(slope, rel=1e-12)
    # Chords between neighbouring lags lie below the cosine by at most (2π/n)²/8.
    exact = np.arccos(np.exp(-1)) * length / (2 * np.pi)
    assert s[f"correlation_length_{along}"] == pytest.approx(exact, abs=(2 * np.pi / n) ** 2 / 8 * length)
    assert s[f"correlation_length_{across}"] is s["correlation_length"] is None


def test_correlation_and_spectrum_of_a_sinusoid():
    field = wave()
    lags = np.arange(360) * 2 * np.pi / 360
    np.testing.assert_allclose(field.acf(), np.broadcast_to(np.cos(lags), (6, 360)), atol=1e-12)
    psd, kx, ky = field.psd()
    assert psd.sum() * kx[1] * ky[1] / (4 * np.pi**2) == pytest.approx(2.0, rel=1e-12)
    assert {abs(kx[i]) for i in np.argwhere(psd > 1e-6 * psd.max())[:, 1]} == {2 * np.pi / 90}
    assert psd.shape == (len(ky), len(kx))


@pytest.mark.parametrize("shape", [(2, 2), (5, 4), (7, 9)])
def test_the_mesh_is_the_height_field_and_its_copies_at_the_seams(shape):
    field = HeightField(np.random.default_rng(3).normal(size=shape), (0.5, 2.0))
    mesh = field.mesh()
    ny, nx = shape
    grid = mesh.vertices.reshape(ny + 1, nx + 1, 3)
    np.testing.assert_array_equal(grid[:-1, :-1, 2], field.heights)
    np.testing.assert_array_equal(grid[-1, :, 2], grid[0, :, 2])
    np.testing.assert_array_equal(grid[:, -1, 2], grid[:, 0, 2])
    np.testing.assert_allclose(grid[-1, -1, :2], field.period)
    assert (mesh.period, mesh.single_valued, mesh.vertex_normals) == (field.period, True, None)
    mesh.check()


def test_slopes_and_normals_are_those_of_the_mesh_facets_in_their_order():
    field = HeightField(np.random.default_rng(3).normal(size=(7, 4)), (0.5, 2.0))
    normals = field.mesh().normals()
    np.testing.assert_allclose(field.normals(), normals, atol=1e-15)
    p, q = field.slopes()
    np.testing.assert_allclose(p.ravel(), -normals[:, 0] / normals[:, 2], atol=1e-13)
    np.testing.assert_allclose(q.ravel(), -normals[:, 1] / normals[:, 2], atol=1e-13)
    field_s, mesh_s = field.statistics(), field.mesh().statistics()
    for name in ("Sdq", "rms_slope_x", "rms_slope_y", "beckmann_alpha_x", "beckmann_alpha"):
        assert getattr(field_s, name) == pytest.approx(getattr(mesh_s, name), rel=1e-13)


@pytest.mark.parametrize("method", ["slope_distribution", "normal_distribution"])
def test_distributions_are_those_of_the_mesh(method):
    field = HeightField(np.random.default_rng(3).normal(size=(30, 20)), (2.0, 3.0))
    for ours, meshes in zip(getattr(field, method)(7), getattr(field.mesh(), method)(7), strict=True):
        np.testing.assert_allclose(ours, meshes, rtol=1e-9, atol=1e-12)


def test_diagonals_alternate():
    mesh = HeightField(np.zeros((4, 4)), (1.0, 1.0)).mesh()
    corners = mesh.vertices[mesh.faces][..., :2].reshape(4, 4, 2, 3, 2)
    for j, i in np.ndindex(4, 4):
        lower, upper = ({tuple(c) for c in triangle} for triangle in corners[j, i])
        falling, rising = {(i + 1, j), (i, j + 1)}, {(i, j), (i + 1, j + 1)}
        assert lower & upper == (falling if (i + j) % 2 == 0 else rising)


@pytest.mark.parametrize(
    ("heights", "spacing", "sentence"),
    [
        (np.zeros((1, 9)), (1, 1), r"shape \(1, 9\): expected a map \(ny, nx\) of at least 2 x 2 nodes"),
        (np.zeros((9, 1)), (1, 1), r"shape \(9, 1\)"),
        (np.zeros((1, 1)), (1, 1), r"shape \(1, 1\)"),
        (np.zeros((0, 0)), (1, 1), r"shape \(0, 0\)"),
        (np.zeros((4, 4, 3)), (1, 1), r"shape \(4, 4, 3\)"),
        (np.array([[0, np.nan], [np.inf, 1]]), (1, 1), r"2 of 4 heights are NaN or infinite: fill the gaps"),
        (np.zeros((2, 2)), (1, 0), r"spacing is \(1\.0, 0\.0\): expected two positive lengths"),
        (np.zeros((2, 2)), (np.inf, 1), r"expected two positive lengths"),
    ],
)
def test_what_is_no_height_field_is_refused_in_words(heights, spacing, sentence):
    with pytest.raises(ValueError, match=sentence):
        HeightField(heights, spacing)


def test_a_flat_field_has_no_shape_and_no_correlation():
    flat = Flat().build(0)
    s = flat.statistics()
    assert (s.Sa, s.Sq, s.Sdq, s.beckmann_alpha) == (0, 0, 0, 0)
    assert s.Ssk is s.Sku is s.correlation_length is None
    with pytest.raises(ValueError, match="flat"):
        flat.acf()


def test_a_mesh_of_2048_squared_is_built_within_half_a_gigabyte():
    field = HeightField(np.zeros((2048, 2048)), (1.0, 1.0))
    tracemalloc.start()
    try:
        field.mesh()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 512 * 2**20
