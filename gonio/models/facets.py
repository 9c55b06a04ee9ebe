"""Mirror facets: the steps that every microfacet model shares."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.models.averages import Detail
from gonio.models.distributions import Distribution
from gonio.optics import Specular
from gonio.sphere import Vectors

Array = NDArray[np.float64]

_REACH = 6.0
"""A distribution is followed to facet slopes of this many alpha: beyond, Beckmann's D is 2e-16 of its maximum."""


def above(wi: ArrayLike, wo: ArrayLike) -> NDArray[np.bool_]:
    """Where both directions (..., 3) are above the horizon, shape (...)."""
    return (np.asarray(wi)[..., 2] > 0.0) & (np.asarray(wo)[..., 2] > 0.0)


def specular(
    distribution: Distribution,
    masking: Callable[[Vectors, Vectors, Vectors], Array],
    material: Specular,
    wi: ArrayLike,
    wo: ArrayLike,
    wavelengths: ArrayLike,
) -> Array:
    """F D G / (4 NL NV), the BRDF (..., W) in 1/sr of one reflection by facets; 0 where a direction is not above.

    Facets of normals within dwm turn (wi . wm) D dwm of the light per area of the plane into the solid angle
    dwo = 4 (wo . wm) dwm; dividing by the irradiance's and the radiance's cosine leaves the formula, and its 4.
    """
    up = np.array([0.0, 0.0, 1.0])
    seen = above(wi, wo)[..., None]
    wi, wo = np.where(seen, wi, up), np.where(seen, wo, up)
    wh = wi + wo
    length = np.sqrt(np.einsum("...k,...k->...", wh, wh))
    wh /= length[..., None]
    geometry = distribution.density(wh) * masking(wi, wo, wh) / (4.0 * wi[..., 2]) / wo[..., 2]
    # |wi + wo| = 2 wi . wh: no cancellation at grazing, where the scalar product has some.
    fresnel = material.reflectance(np.minimum(length / 2.0, 1.0), wavelengths)
    return np.where(seen, geometry[..., None] * fresnel, 0.0)


def lobe_detail(alpha: float) -> Detail:
    """The finest detail of a lobe of roughness `alpha`: turning wm by an angle turns wo by |wi + wo| times that."""

    def detail(wi: Vectors, wo: Vectors, radius: Array) -> Array:
        wh = wi + wo
        length = np.linalg.norm(wh, axis=-1)
        tilt = np.arctan2(np.hypot(wh[..., 0], wh[..., 1]), wh[..., 2])
        reached = tilt - radius[:, None] / length < np.arctan(_REACH * alpha)
        finest: Array = np.where(reached, min(alpha, 1.0) * length, np.inf).min(axis=1)
        return finest

    return detail
