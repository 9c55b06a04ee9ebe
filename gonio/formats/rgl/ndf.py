"""The distribution of normals D of a BRDF, and its projected area sigma, on the square."""

from __future__ import annotations

import numpy as np

from gonio.brdf import BRDF
from gonio.formats.rgl.parametrisation import bilinear, normal, solid_angle
from gonio.sphere import direction, reflect
from microsurfaces.arrays import Floats, Vectors

ESTIMATE = {True: (128, 49), False: (64, 49)}
"""Columns and rows of the square on which D is estimated, if isotropic and if not."""

NDF = 512, 385
"""Columns of D as it is written, and rows if not isotropic."""

LEAST_NDF = 1e-5
"""Least D, of its maximum: what is nowhere lit gets a finite ratio."""

QUADRATURE = 128
"""Midpoints along either side of the square, where D is integrated."""


def estimated_ndf(brdf: BRDF) -> Floats:
    """D on the square (v, u): the mean over incidences of 4 f cos(theta_i) cos(theta_o), the channels' mean.

    For light that facets reflect once it is D itself, but for their reflectance and masking.
    """
    from scipy.interpolate import CubicSpline

    columns, rows = (np.linspace(0.0, 1.0, count) for count in ESTIMATE[brdf.isotropic])
    total, weight = _summed(brdf, normal(*np.meshgrid(columns, rows)))
    if brdf.isotropic:
        total, weight = total.sum(axis=0, keepdims=True), weight.sum(axis=0, keepdims=True)
    mean = np.array([_filled(*row) for row in zip(total, weight, strict=True)])
    logarithm = np.log(np.maximum(mean, max(LEAST_NDF * float(mean.max()), 1e-300)))
    fine = CubicSpline(columns, logarithm, axis=1)(np.linspace(0.0, 1.0, NDF[0]))
    if brdf.isotropic:
        fine = np.repeat(fine, 2, axis=0)
    else:
        fine[-1] = fine[0]
        fine = CubicSpline(rows, fine, axis=0, bc_type="periodic")(np.linspace(0.0, 1.0, NDF[1]))
    ndf = np.exp(fine)
    return np.asarray(ndf / projected_area(ndf, direction(0.0)))


def _summed(brdf: BRDF, wm: Vectors) -> tuple[Floats, Floats]:
    """Sums over incidences of 4 f cos(theta_i) cos(theta_o) at normals `wm` (v, u, 3), weighted, and of the weights."""
    total, weight = np.zeros(wm.shape[:2]), np.zeros(wm.shape[:2])
    for theta in np.arange(1.5, 90.0, 3.0 if brdf.isotropic else 9.0):
        for phi in np.zeros(1) if brdf.isotropic else np.arange(0.0, 360.0, 30.0):
            wi = direction(theta, phi)
            wo, cosine = reflect(wi, wm), wm @ wi
            seen = (wo[..., 2] > 1e-3) & (cosine > 0)
            f = brdf.evaluate(np.broadcast_to(wi, wo[seen].shape), wo[seen]).mean(axis=1)
            known = np.isfinite(f)
            share = known * cosine[seen] * np.sin(np.radians(theta))
            total[seen] += share * 4 * wi[2] * wo[seen][:, 2] * np.where(known, f, 0.0)
            weight[seen] += share
    return total, weight


def _filled(total: Floats, weight: Floats) -> Floats:
    """total / weight where there is weight, the nearest of it elsewhere; 1 if there is none at all."""
    known = np.flatnonzero(weight)
    if not known.size:
        return np.ones(len(total))
    return np.interp(np.arange(len(total)), known, total[known] / weight[known])


def projected_area(ndf: Floats, w: Vectors) -> Floats:
    """Projected area (...) of the normals towards `w` (..., 3), by midpoints of the square."""
    middles = (np.arange(QUADRATURE) + 0.5) / QUADRATURE
    u, v = np.meshgrid(middles, middles)
    area = (bilinear(ndf, u, v) * solid_angle(u)).ravel() / QUADRATURE**2
    wm = normal(u, v).reshape(-1, 3)
    flat = w.reshape(-1, 3)
    parts = [np.maximum(flat[k : k + 64] @ wm.T, 0.0) @ area for k in range(0, len(flat), 64)]
    return np.asarray(np.concatenate(parts).reshape(w.shape[:-1]))
