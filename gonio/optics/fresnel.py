"""Fresnel's equations: reflectances of interfaces for s and p, and their mean as kernels evaluate it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from gonio.randomness import kernel
from microsurfaces.arrays import Floats


def fresnel_dielectric(cos_i: ArrayLike, eta: ArrayLike) -> tuple[Floats, Floats]:
    """Reflectances (R_s, R_p) of an interface between transparent media (Born & Wolf, Principles of Optics, 1.5.2).

    `cos_i` in [0, 1] is the cosine of the angle of incidence, `eta` > 0 the refractive index of the far medium over
    that of the near one; they broadcast. Below 1 (light from inside) the reflection is total beyond the critical angle.
    """
    c, eta = np.broadcast_arrays(np.asarray(cos_i, np.float64), np.asarray(eta, np.float64))
    q = _refracted(c, eta)
    r_s, r_p = _ratio(c - q, c + q), _ratio(eta**2 * c - q, eta**2 * c + q)
    total = (q == 0.0) & (eta < 1.0)
    return np.where(total, 1.0, r_s**2), np.where(total, 1.0, r_p**2)


def fresnel_transmittance(cos_i: ArrayLike, eta: ArrayLike) -> tuple[Floats, Floats]:
    """Transmittances (T_s, T_p): the transmitted share of the incident power; arguments as for `fresnel_dielectric`.

    T = eta cos_t / cos_i |t|^2 with Fresnel's amplitudes t, so that R + T = 1 is a law and not a definition.
    """
    c, eta = np.broadcast_arrays(np.asarray(cos_i, np.float64), np.asarray(eta, np.float64))
    q = _refracted(c, eta)
    t_s, t_p = _ratio(4.0 * c * q, (c + q) ** 2), _ratio(4.0 * eta**2 * c * q, (eta**2 * c + q) ** 2)
    return np.where(eta == 1.0, 1.0, t_s), np.where(eta == 1.0, 1.0, t_p)


def fresnel_conductor(cos_i: ArrayLike, eta: ArrayLike, k: ArrayLike) -> tuple[Floats, Floats]:
    """Reflectances (R_s, R_p) of a medium of complex index `eta` + i `k` (Born & Wolf, Principles of Optics, 14.2).

    `cos_i` in [0, 1], `eta` > 0, `k` >= 0, broadcast against each other. With k = 0 it is the dielectric's.
    """
    c, eta, k = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (cos_i, eta, k)))
    c2, s2 = c * c, 1.0 - c * c
    # (a + i b)^2 = (eta + i k)^2 - sin^2; the smaller of a and b comes from their product eta k, not from a difference.
    real = (eta - 1.0) * (eta + 1.0) + c2 - k * k
    modulus = np.hypot(real, 2.0 * eta * k)
    larger = (modulus + np.abs(real)) / 2.0
    a = np.sqrt(np.where(real >= 0.0, larger, _ratio((eta * k) ** 2, larger)))
    across, along = c2 + modulus, c2 * modulus + s2 * s2
    r_s = _ratio(across - 2.0 * a * c, across + 2.0 * a * c)
    return r_s, r_s * _ratio(along - 2.0 * a * c * s2, along + 2.0 * a * c * s2)


@kernel
def fresnel(cosine, eta, k):
    """Unpolarised reflectance of an interface of index eta + ik, total reflection included.

    `fresnel_conductor` with R_s (1 + R_p / R_s) / 2 drawn together, so that one division is left.
    """
    cos2 = cosine * cosine
    sin2 = 1.0 - cos2
    t0 = eta * eta - k * k - sin2
    modulus = math.sqrt(t0 * t0 + 4.0 * eta * eta * k * k)
    twice = 2.0 * math.sqrt(max(0.0, 0.5 * (modulus + t0))) * cosine
    p = cos2 * modulus + sin2 * sin2
    return (modulus + cos2 - twice) * p / ((modulus + cos2 + twice) * (p + twice * sin2))


def fresnel_table(eta: Floats, k: Floats) -> Floats:
    """Unpolarised reflectances of indices `eta` + i `k`, (W,) each, over the cosine: (intervals, 6, W).

    In each of equal intervals of the cosine from 0 to 1 it is a polynomial of degree 5 in the place within the
    interval, 0 to 1, lowest coefficient first, and exact to 2⁻³⁴. There are no intervals where that needs too many of
    them, as next to an angle of total reflection: then use `fresnel`.
    """
    nodes = (1.0 + np.cos(np.pi * (np.arange(6) + 0.5) / 6)) / 2
    probes = np.linspace(0.0, 1.0, 11)
    for intervals in (64, 256, 1024):
        starts = np.arange(intervals)[:, None]
        values, exact = (
            np.mean(fresnel_conductor((starts + x)[..., None] / intervals, eta, k), axis=0) for x in (nodes, probes)
        )
        table: Floats = np.linalg.solve(np.vander(nodes, increasing=True), values)
        if np.abs(np.vander(probes, 6, increasing=True) @ table - exact).max() < 2.0**-34:
            return table
    return np.zeros((0, 6, len(eta)))


def _refracted(c: Floats, eta: Floats) -> Floats:
    """eta times the cosine of the angle of refraction, 0 where the reflection is total; exact for eta close to 1."""
    return np.sqrt(np.maximum((eta - 1.0) * (eta + 1.0) + c * c, 0.0))


def _ratio(numerator: Floats, denominator: Floats) -> Floats:
    """The quotient, 0 where both are 0 (grazing light on an interface without contrast)."""
    zero = denominator == 0.0
    quotient: Floats = np.where(zero, 0.0, numerator) / np.where(zero, 1.0, denominator)
    return quotient
