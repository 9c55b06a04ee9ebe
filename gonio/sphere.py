"""Directions and frames: every angle convention of gonio lives here.

z is up, the macroscopic normal. `wi` points to the light, `wo` to the detector: unit vectors, both AWAY from the
surface; `wm` is a facet normal and `wh` the half vector. theta is counted from z, phi from +x counter-clockwise, both
in degrees and only at the edges of the program. Light from `phi_i` has its specular direction at `phi_i + 180`; the
relative azimuth `dphi = phi_o - phi_i` is 0 on the source's side and 180 on the specular one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microsurfaces.arrays import Vectors


def direction(theta: ArrayLike, phi: ArrayLike = 0.0) -> Vectors:
    """Unit vectors (..., 3) of polar angle `theta` and azimuth `phi`, degrees, broadcast against each other.

    The pole itself is left by 1e-100, so that a direction keeps the azimuth from which `dphi` is counted.
    """
    t, p = np.broadcast_arrays(np.radians(theta), np.radians(phi))
    t = np.where(t == 0.0, 1e-100, t)
    return np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)


def as_directions(w: ArrayLike, name: str) -> Vectors:
    """`w` (..., 3) as float64 unit vectors; ValueError, with the `name` of the argument, if its last axis is not 3."""
    w = np.asarray(w, np.float64)
    if w.shape[-1:] != (3,):
        raise ValueError(
            f"{name} has shape {w.shape}: the last axis of directions must be 3, as in gonio.direction(theta, phi)"
        )
    return w


def angles(w: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Polar angle in [0, 180] and azimuth in [0, 360), degrees, of unit vectors `w` (..., 3); phi is 0 at a pole."""
    x, y, z = np.moveaxis(np.asarray(w, np.float64), -1, 0)
    theta = np.degrees(np.arctan2(np.hypot(x, y), z))
    phi = np.degrees(np.arctan2(y, x)) % 360.0
    # A negative azimuth below half an ulp of 360 rounds up to 360 itself.
    return theta, np.where(phi == 360.0, 0.0, phi)


def half_vector(wi: ArrayLike, wo: ArrayLike) -> Vectors:
    """Unit vectors half way between `wi` and `wo` (..., 3); undefined (NaN) for opposite directions."""
    total = np.asarray(wi, np.float64) + np.asarray(wo, np.float64)
    with np.errstate(invalid="ignore"):
        return np.asarray(total / np.linalg.norm(total, axis=-1, keepdims=True))


def reflect(w: ArrayLike, wm: ArrayLike) -> Vectors:
    """Mirror image of `w` (..., 3) about the normals `wm` (..., 3); all point away from the surface."""
    w, wm = np.asarray(w, np.float64), np.asarray(wm, np.float64)
    return np.asarray(2.0 * (w * wm).sum(axis=-1, keepdims=True) * wm - w)


def rotate_z(w: ArrayLike, degrees: ArrayLike) -> Vectors:
    """`w` (..., 3) turned about z by `degrees`, counter-clockwise."""
    w, a = np.asarray(w, np.float64), np.radians(degrees)
    c, s = np.cos(a), np.sin(a)
    x, y, z = np.moveaxis(w, -1, 0)
    return np.stack(np.broadcast_arrays(c * x - s * y, s * x + c * y, z), axis=-1)
