"""What must hold for the paths over any height field: every shortcut is a proof, and Embree finds the same hits."""

import math

import numpy as np
import pytest
from reliefs import RELIEFS, clearance, on_facets, without_shortcuts
from specimens import COARSE_GRID

import microsurfaces as ms
from gonio import optics
from gonio.detectors import HemisphereGrid
from gonio.goniometer import Goniometer
from gonio.transport import height_field, scoring
from gonio.transport.accelerator import BLOCK, Accelerator, horizon_sector
from gonio.transport.height_field import PathState
from gonio.transport.scene import EmbreeMesh, Scene
from gonio.transport.scoring import Scores
from gonio.transport.source import Source
from gonio.transport.termination import ESCAPED, IN_FLIGHT

FROM_ALL_SIDES = {"theta_i": (0, 45, 75, 88), "phi_i": (0, 37, 45, 90, 180, 211)}

INSTRUMENTS = (
    (optics.Mirror(), FROM_ALL_SIDES),
    (optics.Conductor("Cr"), FROM_ALL_SIDES),
    (optics.Lambertian(0.9), FROM_ALL_SIDES),
    (optics.Conductor("Cr"), {"theta_i": (0, 45, 88), "phi_i": (0, 211), "azimuth": "average"}),
    (optics.Lambertian(0.9), {"theta_i": (0, 45, 80), "phi_i": (37,), "beam_half_angle": 5, "azimuth": "average"}),
)


def every_shortcut_is_a_proof(relief, material, setting):
    """Guesses everywhere, and bundles only, against a look at every cell on the way: the same integers."""
    scene = Scene(relief, material)
    goniometer = Goniometer(paths=1200, replicates=12, wavelengths=(550,), detector=COARSE_GRID, **setting)
    proven = []
    for worth in (-1.0, 2.0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(height_field, "WORTH", worth)
            proven.append(goniometer.measure(scene, seed=1, threads=1).sums)
    scene.geometry.traced = without_shortcuts(scene.geometry.traced)
    searched = goniometer.measure(scene, seed=1, threads=1).sums
    assert proven[0].identical(searched), "a guess has been accepted that is not the first hit"
    assert proven[1].identical(searched)


def no_node_is_lower_than_what_it_stands_for(relief):
    """In float64: plain ones over all their cells, dilated ones over all that a bundle about a node may reach."""
    accelerator = Accelerator.of(relief)
    ny, nx = accelerator.shape
    corners = [accelerator.heights[j : j + ny, i : i + nx] for j in (0, 1) for i in (0, 1)]
    cells = np.maximum.reduce(corners)
    for level in range(len(accelerator.widths)):
        size, first = 1 << level, accelerator.offsets[level]
        max_mipmap = accelerator.max_mipmap[first : accelerator.offsets[level + 1]].reshape(
            -1, accelerator.widths[level]
        )
        wide = np.repeat(np.repeat(max_mipmap, size, axis=0), size, axis=1)[:ny, :nx]
        assert (wide > cells).all() or ((wide == cells).all() and not np.ptp(cells))
        if level == 0:
            continue
        dilated_mipmap = accelerator.dilated_mipmap[first - accelerator.offsets[1] :][: max_mipmap.size].reshape(
            max_mipmap.shape
        )
        # Half a bundle about any place of a node: whole cells of what lies that far from its sides.
        reach = np.arange(-(size // 2), size // 2 + 1)
        for j, i in np.ndindex(max_mipmap.shape):
            rows = np.arange(j * size, min((j + 1) * size, ny))
            columns = np.arange(i * size, min((i + 1) * size, nx))
            near = np.ix_(*(np.unique(np.add.outer(k, reach) % n) for k, n in ((rows, ny), (columns, nx))))
            assert dilated_mipmap[j, i] >= cells[near].max()


def certified(accelerator, i, j, dx, dy, dz):
    """Whether rays that leave cells (i, j) are certain to escape, as the transport asks; directions per cell."""
    sectors = np.array([horizon_sector(*xy) for xy in zip(dx, dy, strict=True)])
    horizon_code = accelerator.horizon_code[j >> BLOCK, i >> BLOCK, sectors]
    return dz**2 > accelerator.horizon_slope2[horizon_code] * (dx**2 + dy**2), accelerator.horizon_slope2[horizon_code]


def what_is_certain_to_escape_hits_nothing(relief):
    """Exactly, in any direction, and as close to the certified slope as it goes."""
    accelerator, rng = Accelerator.of(relief), np.random.default_rng(1)
    heights = accelerator.heights[:-1, :-1]
    i, j, x, y, z = on_facets(heights, 4000, rng)
    phi = rng.uniform(0, 2 * math.pi, i.size)
    phi[::4] = np.round(phi[::4] * (8 / math.pi)) * (math.pi / 8) + 1e-9  # where sectors meet
    dx, dy = np.cos(phi), np.sin(phi)
    _, limit = certified(accelerator, i, j, dx, dy, np.ones(i.size))
    rises = np.sqrt(limit) * (1 + 1e-12)
    dz = np.where(np.isfinite(rises), rises, 1e3 * np.ptp(heights) + 1)
    dz[1::2] *= rng.uniform(1, 3, dz[1::2].size)
    certain, _ = certified(accelerator, i, j, dx, dy, dz)
    assert (certain == np.isfinite(rises)).all()
    x, y, z, dx, dy, dz = (a[certain] for a in (x, y, z, dx, dy, dz))
    least = clearance(heights, x, y, z, dx, dy, dz)
    assert (least >= -1e-12 * np.abs(heights).max()).all()


def tiled(relief):
    """The mesh of 3 x 3 periods; its faces are those of one period, again and again."""
    mesh = relief.mesh()
    shifts = [(i * mesh.period[0], j * mesh.period[1], 0.0) for j in range(3) for i in range(3)]
    vertices = np.concatenate([mesh.vertices + shift for shift in shifts])
    faces = np.concatenate([mesh.faces + k * len(mesh.vertices) for k in range(9)])
    return ms.Mesh(vertices, faces, (3 * mesh.period[0], 3 * mesh.period[1]))


def falling_rays(relief, count, rng):
    """Rays from the highest point's height over the tile, downward, that reach the lowest within a period: positions in
    cells, directions of length 1."""
    ny, nx = relief.heights.shape
    x, y, phi = rng.uniform(0, nx, count), rng.uniform(0, ny, count), rng.uniform(0, 2 * math.pi, count)
    widest = min(relief.period) / max(np.ptp(relief.heights), 0.1)
    tangent = widest * rng.uniform(0, 1, count)
    cosine = 1 / np.hypot(1, tangent)
    return x, y, np.stack([tangent * cosine * np.cos(phi), tangent * cosine * np.sin(phi), -cosine], axis=-1)


def first_hits_are_those_of_embree(relief):
    """Facet for facet, but where float32 cannot tell on which side of an edge a ray passes."""
    count, rng = 20_000, np.random.default_rng(4)
    ny, nx = relief.heights.shape
    accelerator, mesh = Accelerator.of(relief), EmbreeMesh(tiled(relief))
    x, y, directions = falling_rays(relief, count, rng)
    middle, scale = np.array([nx / 2, ny / 2, 0.0]), np.array([*relief.spacing, 1.0])
    start = (np.stack([x, y, np.full(count, accelerator.top)], axis=-1) - middle) * scale
    found = mesh.intersect(start.astype(np.float32), directions.astype(np.float32), np.full(count, 1e9, np.float32))
    assert (found["primID"] >= 0).all()
    u, v = found["u"].astype(float), found["v"].astype(float)
    theirs = np.minimum(np.minimum(u, v), 1 - u - v)
    largest = 1.5 * max(*relief.period, np.ptp(relief.heights))
    for near in (True, False):
        flight = in_flight(accelerator, x, y, directions)
        assert height_field._walk(flight, count, 0, accelerator, near) == count, "a ray has fallen through the surface"
        facets = 2 * (flight.j * nx + flight.i)[:count] + flight.triangle[:count]
        same = facets == found["primID"] % (2 * nx * ny)
        u, v = flight.x - flight.i[:count], flight.y - flight.j[:count]
        diagonal = np.where((flight.i + flight.j)[:count] % 2 == 0, np.abs(u + v - 1), np.abs(u - v))
        ours = np.minimum.reduce([u, v, 1 - u, 1 - v, diagonal])
        # A ray that grazes an edge for one of them goes far on for the other.
        assert (np.minimum(ours, theirs)[~same] < 2.0**-20 * largest / min(relief.spacing)).all()
        assert same.mean() > 1 - 1e-3
        # Positions, but for whole periods; oblique to a facet float32 is less exact along the ray.
        places = (np.stack([flight.x, flight.y, flight.z], axis=-1) - middle) * scale
        miss = places - start - found["tfar"][:, None].astype(float) * directions
        miss[:, :2] -= np.round(miss[:, :2] / relief.period) * relief.period
        cosines = -(relief.normals()[facets] * directions).sum(axis=1)
        assert (cosines > 0).all()
        assert (np.abs(miss).max(axis=1) * cosines)[same].max() < 1e-6 * largest
        assert np.abs(miss[same & (cosines > 0.1)]).max() < 1e-5 * largest


def in_flight(accelerator, x, y, directions):
    """Rays from the highest point's height, of which nothing is known."""
    count = x.size
    flight = PathState.of(count, 1)
    flight.x[:], flight.y[:], flight.z[:] = x, y, accelerator.top
    flight.dx[:], flight.dy[:], flight.dz[:] = directions.T
    flight.i[:count], flight.j[:count], flight.triangle[:] = x, y, -1
    flight.active[:count], flight.terminations[:] = np.arange(count), IN_FLIGHT
    return flight


def embree_measures_the_same(name, material):
    """Paths start alike and only float32 leads them astray: what differs is a small part of the noise."""
    relief = RELIEFS[name]()
    goniometer = Goniometer(theta_i=(0, 45, 80), phi_i=(0, 211), paths=32_000, wavelengths=(550,), detector=COARSE_GRID)
    ours, theirs = (goniometer.measure(Scene(r, material), seed=5) for r in (relief, relief.mesh()))
    one, other = (measurement.dataset for measurement in (ours, theirs))
    np.testing.assert_allclose(one["albedo"], other["albedo"], atol=5e-4)
    full = ((one["count"] > 400) & (other["count"] > 400)).values
    assert full.sum() > 100
    difference = np.abs(one["brdf"] - other["brdf"]).values[full]
    assert (difference < 0.5 * one["brdf_standard_error_mc"].values[full]).all()
    assert (ours.sums["energy_budget"].sel(termination="lost") == 0).all()
    assert (ours.sums["energy_budget"].sel(termination="truncated") == 0).all()


def directions_are_put_into_the_bins_that_their_angles_lie_in(theta_step, phi_step, phi_i):
    count, rng = 30_000, np.random.default_rng(6)
    detector = HemisphereGrid(theta_step=theta_step, phi_step=phi_step)
    theta, phi = np.arccos(rng.uniform(0, 1, count)), rng.uniform(-math.pi, math.pi, count)
    theta[:4], phi[:4] = (0.0, math.pi / 2 - 1e-9, 1e-9, 1e-4), np.radians(phi_i)
    directions = (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
    scores = Scores.empty(1, 1, detector.bins + 1, 1)
    records = np.zeros((count + 1, 2), np.int64)
    source = Source(0.5, math.radians(phi_i), 0.0, (0.0, 0.0, 0.0), False, (1, 2))
    escaped, nothing = np.full(count, ESCAPED, np.int8), np.zeros(count, np.int32)
    arrivals = scoring.Arrivals(
        directions, escaped, np.ones((count, 1)), nothing.astype(np.int64), nothing, nothing + 1
    )
    bins = scoring.bins_of(detector, phi_i)
    scoring.score(count, arrivals, bins, source, np.zeros(1), scores.bins, records)
    ring = np.searchsorted(detector.theta_edges, np.degrees(theta), side="right") - 1
    along = (np.degrees(phi) - phi_i) / phi_step + 0.5
    sector_ = np.floor(along).astype(int) % detector.shape[1]
    clear = np.abs(along - np.round(along)) > 1e-9
    clear &= np.abs(np.subtract.outer(np.degrees(theta), detector.theta_edges[1:-1])).min(axis=1) > 1e-9
    np.testing.assert_array_equal(records[:count, 0], np.arange(count))
    np.testing.assert_array_equal(records[:count, 1][clear], (ring * detector.shape[1] + sector_)[clear])
    assert clear.mean() > 0.999
