"""Mirror facets: the steps that every microfacet model shares."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.models.averages import Detail
from gonio.models.distributions import BECKMANN, REACH, Distribution, density, smith_lambda
from gonio.models.masking import CODES, Masking
from gonio.optics import Mirror, Specular, fresnel
from gonio.randomness import kernel
from gonio.sphere import as_directions
from microsurfaces.arrays import Floats, Vectors


def above(wi: ArrayLike, wo: ArrayLike) -> NDArray[np.bool_]:
    """Where both directions (..., 3) are above the horizon, shape (...)."""
    return (as_directions(wi, "wi")[..., 2] > 0.0) & (as_directions(wo, "wo")[..., 2] > 0.0)


def specular(
    distribution: Distribution,
    masking: Masking,
    material: Specular,
    wi: ArrayLike,
    wo: ArrayLike,
    wavelengths: ArrayLike,
) -> Floats:
    """F D G / (4 NL NV), the BRDF (..., W) in 1/sr of one reflection by facets; 0 where a direction is not above.

    Facets of normals within dwm turn (wi . wm) D dwm of the light per area of the plane into the solid angle
    dwo = 4 (wo . wm) dwm; dividing by the irradiance's and the radiance's cosine leaves the formula, and its 4.
    """
    wi, wo = as_directions(wi, "wi"), as_directions(wo, "wo")
    shape = np.broadcast_shapes(wi.shape, wo.shape)[:-1]
    source, eye = (_rows(w, shape) for w in (wi, wo))
    value = np.empty((math.prod(shape), np.size(wavelengths)))
    index = np.zeros(0, complex) if isinstance(material, Mirror) else material.refractive_index(wavelengths)
    code = CODES[type(masking).__name__]
    _specular(distribution.lobes(), code, index.real.copy(), index.imag.copy(), source, eye, value)
    return value.reshape(*shape, -1)


def _rows(w: Vectors, shape: tuple[int, ...]) -> Floats:
    """Directions as rows for a kernel: one if it serves for all, else one for each of `shape`."""
    if w.ndim == 1:
        return np.ascontiguousarray(w[None])
    return np.ascontiguousarray(np.broadcast_to(w, (*shape, 3)).reshape(-1, 3))


@kernel
def masked(lobes, code, wix, wiy, wiz, wox, woy, woz, hz, cosine):
    """G2 of the masking with this code; `cosine` is that of the angle between wi and the half vector."""
    if code == 1:
        return min(1.0, 2.0 * hz * min(wiz, woz) / cosine)
    if code == 0:
        return 1.0
    lambda_i, lambda_o = smith_lambda(lobes, wix, wiy, wiz), smith_lambda(lobes, wox, woy, woz)
    return 1.0 / ((1.0 + lambda_i) * (1.0 + lambda_o)) if code == 2 else 1.0 / (1.0 + lambda_i + lambda_o)


@kernel
def _specular(lobes, code, eta, k, wi, wo, value):
    """Fill `value` (n, W) for rows of directions, of which a single one serves for all."""
    many_wi, many_wo = wi.shape[0] > 1, wo.shape[0] > 1
    for i in range(value.shape[0]):
        wix, wiy, wiz = wi[i * many_wi, 0], wi[i * many_wi, 1], wi[i * many_wi, 2]
        wox, woy, woz = wo[i * many_wo, 0], wo[i * many_wo, 1], wo[i * many_wo, 2]
        geometry, cosine = 0.0, 1.0
        if wiz > 0.0 and woz > 0.0:
            x, y, z = wix + wox, wiy + woy, wiz + woz
            length = math.sqrt(x * x + y * y + z * z)
            x, y, z = x / length, y / length, z / length
            # |wi + wo| = 2 wi . wh: no cancellation at grazing, where the scalar product has some.
            cosine = min(0.5 * length, 1.0)
            geometry = density(lobes, x, y, z)
            if geometry > 0.0:
                geometry *= masked(lobes, code, wix, wiy, wiz, wox, woy, woz, z, cosine) / (4.0 * wiz) / woz
        for w in range(value.shape[1]):
            value[i, w] = geometry
            if geometry > 0.0 and eta.size:
                value[i, w] *= fresnel(cosine, eta[w], k[w])


def lobe_detail(distribution: Distribution) -> Detail:
    """The finest detail of a lobe: turning wm by an angle turns wo by |wi + wo| times that.

    Beckmann's lobe ends; that of GGX goes on for ever, and widens with the slope t as sqrt(1 + (t / alpha)^2).
    """
    lobes = distribution.lobes()

    def detail(wi: Vectors, wo: Vectors, radius: Floats) -> Floats:
        wh = wi + wo
        length = np.linalg.norm(wh, axis=-1)
        tilt = np.arctan2(np.hypot(wh[..., 0], wh[..., 1]), wh[..., 2])
        nearest = np.maximum(tilt - radius[:, None] / length, 0.0)
        finest = np.full(length.shape, np.inf)
        for kind, _, alpha_x, alpha_y, _, _ in lobes:
            narrow, wide = min(alpha_x, alpha_y), max(alpha_x, alpha_y)
            if kind == BECKMANN:
                width = np.where(nearest < np.arctan(REACH * wide), min(narrow, 1.0), np.inf)
            else:
                slope = np.tan(np.minimum(nearest, 1.5))
                width = np.minimum(narrow * np.hypot(1.0, slope / wide), 1.0)
            finest = np.minimum(finest, width * length)
        smallest: Floats = finest.min(axis=1)
        return smallest

    return detail
