"""Laws of every surface: each member of the union is built by the same tests the minute it is named."""

import dataclasses
import json
import typing

import numpy as np
import pytest
from pydantic import TypeAdapter

import microsurfaces as ms
from microsurfaces import HeightField, Surface

MEMBERS = typing.get_args(typing.get_args(Surface)[0])
RANDOM = {ms.Gaussian, ms.VGrooves}


@pytest.fixture(scope="session")
def stored(tmp_path_factory):
    """A height map and an overhanging mesh on disk."""
    folder = tmp_path_factory.mktemp("surfaces")
    np.save(folder / "map.npy", np.random.default_rng(8).normal(size=(11, 14)))
    ms.save_surface(ms.Cylinders(distance=3.0, floor_height=0.4, chords=32).build(0), folder / "ridges.ply")
    return folder


def examples(folder):
    map_file = str(folder / "map.npy") if folder else "map.npy"
    mesh_file = str(folder / "ridges.ply") if folder else "ridges.ply"
    return {
        "flat": ms.Flat(side=3.0),
        "gaussian": ms.Gaussian(alpha=0.3, side=200.0, samples=128),
        "gaussian odd": ms.Gaussian(alpha=0.5, side=97.0, samples=63),
        "gaussian rotated": ms.Gaussian(alpha_x=0.1, alpha_y=0.4, rotation=30.0, side=200.0, samples=100),
        "ridges": ms.Cylinders(profile="ridges", distance=2.0),
        "ridges on a floor": ms.Cylinders(profile="ridges", distance=3.0, floor_height=0.3),
        "ridges with walls": ms.Cylinders(profile="ridges", distance=3.0, floor_height=0.0),
        "grooves": ms.Cylinders(profile="grooves", distance=2.0, radius=0.5),
        "grooves between lands": ms.Cylinders(profile="grooves", distance=2.5, protrusion=0.8),
        "cusps": ms.Cylinders(profile="grooves", distance=1.0),
        "v-grooves": ms.VGrooves(m=0.5),
        "v-grooves of one angle": ms.VGrooves(angle=45.0, grooves=3),
        "map mirrored": ms.HeightFieldFile(path=map_file, pixel_size=1.5, unit="nm", periodic="mirror"),
        "map tapered": ms.HeightFieldFile(path=map_file, pixel_size=(1.0, 2.0), unit="um", periodic="taper"),
        "map as is": ms.HeightFieldFile(path=map_file, pixel_size=1.0, unit="um", periodic="as is", scale=0.5),
        "mesh": ms.MeshFile(path=mesh_file, period=(30.0, 30.0), unit="um"),
    }


NAMES = list(examples(None))


@pytest.fixture(params=NAMES)
def surface(request, stored):
    return examples(stored)[request.param]


def mesh_of(relief):
    return relief.mesh() if isinstance(relief, HeightField) else relief


def points(mesh):
    """For each vertex the number of the point of the periodic surface it lies on."""
    grain = 1e-6 * max(mesh.period)
    keys = np.rint(mesh.vertices / grain).astype(np.int64)
    keys[:, :2] %= np.rint(np.array(mesh.period) / grain).astype(np.int64)
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()


def contents(relief):
    """All arrays of a product as bytes."""
    values = (getattr(relief, field.name) for field in dataclasses.fields(relief))
    return [value.tobytes() if isinstance(value, np.ndarray) else value for value in values]


def test_every_member_of_the_union_has_an_example():
    assert {type(example) for example in examples(None).values()} == set(MEMBERS)


def test_the_same_seed_gives_the_same_bytes_and_another_one_another_surface(surface):
    first = contents(surface.build(seed=11))
    assert contents(surface.build(seed=11)) == first
    fixed = type(surface) not in RANDOM or getattr(surface, "angle", None)
    assert (contents(surface.build(seed=12)) == first) == bool(fixed)


def test_realisations_of_one_seed_are_other_specimens_of_the_same_surface(surface):
    first, second = (contents(surface.build(11, k, 3)) for k in (0, 1))
    assert contents(surface.build(11, 1, 3)) == second
    fixed = type(surface) not in RANDOM or getattr(surface, "angle", None)
    assert (first == second) == bool(fixed)
    if not getattr(surface, "stratified", False):
        assert contents(surface.build(11, 1, 8)) == second, "a longer series begins as a shorter one"


def test_the_mesh_is_one_sound_period(surface):
    mesh = mesh_of(surface.build(seed=1))
    mesh.check()
    covered = mesh.area_vectors()[:, 2].sum()
    assert covered == pytest.approx(
        mesh.period[0] * mesh.period[1], rel=1e-6 if isinstance(surface, ms.MeshFile) else 1e-12
    )
    assert np.ptp(mesh.vertices[:, :2], axis=0) == pytest.approx(mesh.period, rel=1e-6)


def test_the_periodic_surface_is_closed_and_oriented(surface):
    """On the torus every edge is walked once each way: no gap at a seam, no face turned over."""
    mesh = mesh_of(surface.build(seed=1))
    corners = points(mesh)[mesh.faces]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    # A tile of few cells joins two points by more than one edge, so walks are counted.
    there, there_count = np.unique(edges, axis=0, return_counts=True)
    back, back_count = np.unique(edges[:, ::-1], axis=0, return_counts=True)
    assert np.array_equal(there, back)
    assert np.array_equal(there_count, back_count)


def test_normals_point_up_and_agree_with_the_exact_ones(surface):
    mesh = mesh_of(surface.build(seed=1))
    normals = mesh.normals()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-14)
    assert normals[:, 2].min() > 0
    if mesh.vertex_normals is not None:
        np.testing.assert_allclose(np.linalg.norm(mesh.vertex_normals, axis=1), 1, atol=1e-14)
        agreement = np.einsum("fci,fi->fc", mesh.vertex_normals[mesh.faces], normals)
        assert agreement.min() > np.cos(np.pi / 256)  # half a chord


def test_a_product_from_a_height_field_and_no_other_is_single_valued(surface):
    relief = surface.build(seed=1)
    assert mesh_of(relief).single_valued == isinstance(relief, HeightField)


def test_statistics_are_plain_finite_numbers_or_none(surface):
    values = surface.build(seed=1).statistics().as_dict()
    assert json.loads(json.dumps(values, allow_nan=False)) == values
    assert all(value is None or type(value) is float for value in values.values())
    assert values["Sq"] >= values["Sa"] >= 0
    if values["Sdq"] is not None:
        assert values["beckmann_alpha"] ** 2 == pytest.approx(values["rms_slope_x"] ** 2 + values["rms_slope_y"] ** 2)


def test_the_normal_distribution_weighs_one_over_the_plane(surface):
    """∫ D cosθ dω = 1, the facets projected onto the plane; in a bin of 0.1° the cosine varies by less than that."""
    D, theta, phi = surface.build(seed=1).normal_distribution(theta_bins=900, phi_bins=8)
    low, high = np.radians(theta[:-1]), np.radians(theta[1:])
    projected = (np.sin(high) ** 2 - np.sin(low) ** 2) / 2 * np.radians(360 / (len(phi) - 1))
    assert (D * projected[:, None]).sum() == pytest.approx(1, abs=np.radians(0.1))


def test_the_slope_distribution_weighs_one(surface):
    density, p, q = surface.build(seed=1).slope_distribution(bins=21)
    assert density.sum() * (p[1] - p[0]) * (q[1] - q[0]) == pytest.approx(1, rel=1e-6)


def test_displacement_does_not_tear_the_surface(surface):
    mesh = mesh_of(surface.build(seed=1))
    size = 1e-3 * np.sqrt(mesh.areas().min())
    moved = mesh.displaced(np.random.default_rng(1).normal(size=len(mesh.vertices)) * size)
    steps, point = moved.vertices - mesh.vertices, points(mesh)
    first = np.unique(point, return_index=True)[1]
    assert len(first) < len(point)
    np.testing.assert_allclose(steps, steps[first][point], atol=1e-13 * max(mesh.period))
    moved.check()


def test_recipes_hash_print_as_python_and_pass_through_tables(surface):
    assert eval(repr(surface), vars(ms)) == surface
    assert hash(eval(repr(surface), vars(ms))) == hash(surface)
    adapter = TypeAdapter(Surface)
    table = json.loads(adapter.dump_json(surface, exclude_none=True))
    assert table["kind"] == type(surface).__name__
    assert adapter.validate_json(json.dumps(table)) == surface


@pytest.mark.parametrize("member", MEMBERS, ids=lambda member: member.__name__)
def test_every_recipe_and_parameter_is_documented(member):
    assert len(member.__doc__) > 100
    fields = member.__pydantic_fields__
    assert all(field.description for name, field in fields.items() if name != "kind")
