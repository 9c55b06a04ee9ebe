"""Whether the facets are the surface that was asked for, and fine enough for it."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from gonio.measurement import Measurement
from gonio.self_check.report import Check, not_applicable, outcome
from gonio.self_check.significance import sidak_level
from gonio.self_check.sums import ExactSums
from microsurfaces.arrays import Floats
from microsurfaces.mesh import SLOPE_AZIMUTHS, SLOPES, SlopeLaw

INDEPENDENT_TAIL = 25.0
"""Independent areas that must be expected on either side of a slope before the share there counts as normally
distributed; in 10,000 simulated tiles of 5 to 60 correlation lengths none then failed at the level of 1e-3."""

FACETS_PER_LENGTH = 8.0
"""Facets per correlation length or radius of curvature. With 8 the facets of a Gaussian surface have 0.8 % less mean
square slope than the smooth surface; with 4, 3 % less."""


@runtime_checkable
class Sloped(Protocol):
    """A recipe that asks for a distribution of slopes."""

    def expected_slopes(self, azimuth: float, slopes: Floats) -> SlopeLaw:
        """Along an azimuth in degrees."""
        ...


def normals(measurement: Measurement, sums: ExactSums) -> Check:
    """The facets are tilted as the recipe asks: shares of the plane below given slopes, along four azimuths.

    Neighbouring facets are correlated, so a distance is judged by how much the share spreads from tile to tile, which
    the recipe predicts.
    """
    from scipy.special import ndtri

    surface, facets = measurement.surface, measurement.facets
    if facets is None or not isinstance(surface, Sloped):
        why = (
            "the measurement does not say which surface was asked for: only `run` of an experiment notes it."
            if surface is None or facets is None
            else f"{type(surface).__name__} asks for no distribution of slopes."
        )
        return not_applicable("normals", why)
    laws = [surface.expected_slopes(azimuth, SLOPES) for azimuth in SLOPE_AZIMUTHS]
    expected = np.stack([law.cdf for law in laws])
    spread = np.stack([law.spread for law in laws]) / np.sqrt(sums.realisations.max())
    judged = _judged(expected, spread)
    if not judged.any():
        return not_applicable("normals", "the tiles are too small to judge the slopes of their facets by.")
    scores = -float(ndtri(sidak_level(int(np.count_nonzero(judged))) / 2))
    limit = scores * spread + np.array([[law.rounding] for law in laws]) + 1e-8  # shares are stored to nine decimals
    distance = _distances(surface, facets.slope_cdf)
    worst = np.unravel_index(np.where(judged, distance / limit, -1.0).argmax(), limit.shape)
    azimuth, slope, share = SLOPE_AZIMUTHS[worst[0]], SLOPES[worst[1]], facets.slope_cdf[worst]
    found = (
        f"along azimuth {azimuth:g} a share of {share:.5f} of the plane has slopes up to {slope:.3g}, "
        f"{type(surface).__name__} asks for {expected[worst]:.5f}: off by {distance[worst]:.2g}, limit "
        f"{limit[worst]:.2g} (the worst of {np.count_nonzero(judged)} slopes)"
    )
    advice = "the mesh is not the surface that the file names; build and measure it again"
    numbers = {"azimuth": azimuth, "slope": slope, "share": share, "expected": expected[worst]}
    numbers |= {"distance": distance[worst], "limit": limit[worst]}
    sound = bool(distance[worst] <= limit[worst])
    return outcome("normals", sound, found, advice, {name: float(value) for name, value in numbers.items()})


def _judged(cdf: Floats, spread: Floats) -> NDArray[np.bool_]:
    """Slopes at which a share is as good as normally distributed."""
    tail = np.minimum(cdf, 1 - cdf)
    independent = cdf * (1 - cdf) / np.where(spread > 0, spread, 1.0) ** 2
    return np.asarray((spread == 0) | (independent * tail > INDEPENDENT_TAIL))


def _distances(surface: Sloped, found: Floats) -> Floats:
    """Distance of shares (azimuths, slopes) from the recipe's, whose steps may be rounded to either side."""
    hair = 1e-6 * np.abs(SLOPES)
    below, above = (
        np.stack([surface.expected_slopes(azimuth, slopes).cdf for azimuth in SLOPE_AZIMUTHS])
        for slopes in (SLOPES - hair, SLOPES + hair)
    )
    return np.asarray(np.maximum(np.maximum(below - found, found - above), 0.0))


def resolution(measurement: Measurement) -> Check:
    """Facets are small beside what the surface is made of."""
    statistics, facets = measurement.surface_statistics, measurement.facets
    x, y = statistics["correlation_length_x"], statistics["correlation_length_y"]
    if facets is None:
        return not_applicable("resolution", "the measurement does not say how fine its facets are.")
    if facets.single_valued and x is not None and y is not None:
        name, count = "correlation length", min(x / facets.spacing[0], y / facets.spacing[1])
    elif not facets.single_valued and facets.radius_of_curvature is not None:
        name, count = "radius of curvature", facets.radius_of_curvature / max(facets.spacing)
    else:
        return not_applicable("resolution", "facets are the surface itself, or its correlation length is not known.")
    found = f"{count:.3g} facets per {name} ({facets.triangles} triangles in all), limit {FACETS_PER_LENGTH:g}"
    advice = "facets are flatter than the surface they stand for; give it more samples or chords, or a smaller side"
    numbers = {"facets_per_length": count, "triangles": float(facets.triangles), "limit": FACETS_PER_LENGTH}
    return outcome("resolution", count >= FACETS_PER_LENGTH, found, advice, numbers, "warning")
