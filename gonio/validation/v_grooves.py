"""Ensembles of V-grooves: the surface that Cook and Torrance's model is exact for."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from gonio.models import GGX, CookTorrance, Microfacet, VCavity
from gonio.models.cook_torrance import NORMALISATIONS
from gonio.optics import Mirror
from gonio.sphere import direction
from gonio.transport.scene import Scene
from gonio.validation.judging import Finding, pooled, reduced_chi2, t_test
from gonio.validation.measuring import BLOCKS, GRID, Light, instrument, measured, predicted
from gonio.validation.meshes import extruded
from microsurfaces import Mesh, VGrooves
from microsurfaces.arrays import Floats

GROOVES = 64
"""In one tile: rays start again 1e-6 of half the tile's side off their facet, so that small tiles are more exact."""

INCIDENCES = (0.0, 30.0, 60.0, 80.0)
"""Polar angles of the light, degrees."""

UNCUT = 2.9
"""`VGrooves` cuts its slopes at 3.03 m: bins that slopes beyond this many m reach are left out."""

ENSEMBLE_ERROR = 2e-5 + 0.5e-6 * GROOVES
"""What an albedo of single reflection may be off by: the slopes are cut, and the restart offset lifts rays over edges.

Tiles of 128 and 512 grooves are too bright by half of that offset, in units of a groove's half width.
"""

Strips = Callable[[int, int], Iterable[Mesh]]
"""The tiles of one block: called with its number and how many they are."""


def beckmann_slopes(quick: bool) -> Iterator[Finding]:
    """V-grooves of one width whose slopes follow Beckmann's distribution are Cook and Torrance's model, G = min."""
    for m in (0.2, 0.5, 1.0):
        light, model = beckmann(m, 8 if quick else 64), CookTorrance(m=m, material=Mirror())
        yield from _lobe(light, model, f"m = {m:g}", UNCUT * m)
        yield from _albedos(light, model, f"m = {m:g}")


def ggx_slopes(quick: bool) -> Iterator[Finding]:
    """So they are with any other distribution of slopes: here GGX, cut at 100 alpha, beyond which 1e-4 of it lies."""
    for alpha in (0.5,) if quick else (0.2, 0.5, 1.0):
        light = _ensemble(_equal_widths(functools.partial(_ggx, alpha)), 8 if quick else 64)
        model = Microfacet(distribution=GGX(alpha=alpha), masking=VCavity(), material=Mirror())
        yield from _lobe(light, model, f"alpha = {alpha:g}")
        yield from _albedos(light, model, f"alpha = {alpha:g}")


def other_forms(quick: bool) -> Iterator[Finding]:
    """Grooves in other proportions, and Cook and Torrance's model in its other normalisations, are something else."""
    m, tiles = 0.5, 2 if quick else 16
    model, right = CookTorrance(m=m, material=Mirror()), beckmann(m, 8 if quick else 64)
    by_area = _ensemble(_equal_widths(functools.partial(_area_weighted, m)), tiles)
    yield from _lobe(by_area, model, "slopes drawn by true facet area", holds=False)
    yield from _lobe(_ensemble(_equal_depths(m), tiles), model, "grooves of equal depth", holds=False)
    for name, factor in NORMALISATIONS.items():
        if factor != 1.0:
            other = CookTorrance(m=m, material=Mirror(), normalisation=name)
            words = f'normalisation "{name}"'
            yield from _lobe(right, other, words, UNCUT * m, holds=False, incidences=(30.0,))
            ratio = predicted(other, 30.0).total / right.shares[:, INCIDENCES.index(30.0), 0, 1, -1]
            where, error = f"{words}, theta 30, its albedo over the traced one", ENSEMBLE_ERROR * factor
            yield t_test(where, right.settings, ratio, factor, error)


def _ensemble(strips: Strips, tiles: int, theta_i: tuple[float, ...] = INCIDENCES) -> Light:
    """Grooves of every azimuth, one for 100 paths; every block has `tiles` of its own."""
    goniometer = instrument(theta_i, 100 * GROOVES, azimuth="average")
    words = f"{BLOCKS * tiles * GROOVES} grooves in tiles of {GROOVES}"
    return measured(lambda n: (Scene(mesh, Mirror()) for mesh in strips(n, tiles)), goniometer, BLOCKS, words)


@functools.cache
def beckmann(m: float, tiles: int, theta_i: tuple[float, ...] = INCIDENCES) -> Light:
    """The ensemble of `VGrooves`."""
    grooves = VGrooves(m=m, grooves=GROOVES)
    return _ensemble(lambda seed, count: (grooves.build(seed, k, count) for k in range(count)), tiles, theta_i)


def _lobe(
    light: Light,
    model: CookTorrance | Microfacet,
    words: str,
    steepest: float = math.inf,
    holds: bool = True,
    incidences: Iterable[float] = INCIDENCES,
) -> Iterator[Finding]:
    """Lobes of an ensemble, where slopes up to `steepest` reach."""
    for theta in incidences:
        chosen = _gentle(theta, steepest)
        lobe = _folded(light.shares[:, INCIDENCES.index(theta), 0, 1, :-1])[:, chosen]
        exact = _folded(predicted(model, theta).bins)[chosen]
        yield reduced_chi2(f"{words}, theta {theta:g}", light.settings, *pooled(lobe, exact, light.paths), holds)


def _albedos(light: Light, model: CookTorrance | Microfacet, words: str) -> Iterator[Finding]:
    for i, theta in enumerate(INCIDENCES):
        where, blocks = f"{words}, theta {theta:g}, albedo", light.shares[:, i, 0, 1, -1]
        yield t_test(where, light.settings, blocks, predicted(model, theta).total, ENSEMBLE_ERROR)


def _folded(bins: Floats) -> Floats:
    """Bins (..., bins) of an isotropic surface with both signs of the relative azimuth together."""
    rings, sectors = GRID.shape
    table = bins.reshape(*bins.shape[:-1], rings, sectors)
    half = table[..., : sectors // 2 + 1].copy()
    half[..., 1:-1] += table[..., : sectors // 2 : -1]
    return half.reshape(*bins.shape[:-1], -1)


def _gentle(theta: float, slope: float) -> NDArray[np.bool_]:
    """Which folded bins only facets with slopes below this one send light to."""
    wi = direction(theta)
    wh = GRID.quadrature(wi, 8)[0] + wi
    steepest = (np.hypot(wh[..., 0], wh[..., 1]) / wh[..., 2]).max(axis=1)
    return np.asarray(_folded(np.where(steepest < slope, 0.0, 1.0)) == 0.0)


def _equal_widths(slopes: Callable[[Floats], Floats]) -> Strips:
    """Tiles of grooves of one width whose tan is a function of a uniform number."""
    return lambda seed, tiles: (_grooved(slopes(u), np.full(u.shape, 2.0)) for u in _stratified(seed, tiles))


def _equal_depths(m: float) -> Strips:
    """Tiles of grooves of one depth, the steep ones narrow, with Beckmann's slopes."""

    def strips(seed: int, tiles: int) -> Iterator[Mesh]:
        slopes = m * np.sqrt(-np.log1p(-_stratified(seed, tiles)))
        return (_grooved(tangents, 2.0 * m / tangents) for tangents in slopes)

    return strips


def _ggx(alpha: float, u: Floats) -> Floats:
    """Slopes of the GGX distribution by inversion."""
    return alpha * np.sqrt(u / (1.0 - u))


def _area_weighted(m: float, u: Floats) -> Floats:
    """Slopes of Beckmann's distribution with the weight of the true facet area, sqrt(1 + tan^2), by inversion."""
    t = np.linspace(0.0, 6.0 * m, 20_001)
    density = t * np.sqrt(1.0 + t**2) * np.exp(-((t / m) ** 2))
    cumulative = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
    return np.interp(u, cumulative / cumulative[-1], t)


def _stratified(seed: int, tiles: int) -> Floats:
    """Uniform numbers (tiles, GROOVES), one in each equal share of (0, 1), in random order, none above 1 - 1e-4."""
    random = np.random.Generator(np.random.Philox(seed))
    ranks = random.permuted(np.arange(GROOVES * tiles).reshape(GROOVES, tiles), axis=1).T
    u = np.minimum((ranks + random.random(ranks.shape)) / ranks.size, 1.0 - 1e-4)
    return np.asarray(random.permuted(u, axis=1))


def _grooved(tangents: Floats, widths: Floats) -> Mesh:
    """Symmetric grooves along y with coplanar upper edges, in a square tile."""
    edges = np.concatenate([[0.0], np.cumsum(widths)])
    x, z = np.empty(2 * widths.size + 1), np.zeros(2 * widths.size + 1)
    x[::2], x[1::2], z[1::2] = edges, (edges[1:] + edges[:-1]) / 2, -tangents * widths / 2
    return extruded(x, z, edges[[0, -1]])
