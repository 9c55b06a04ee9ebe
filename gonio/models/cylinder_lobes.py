"""Reflection by cylinders whose points are diffusers or rough mirrors: integrals over the lit and visible arc."""

from __future__ import annotations

import math

import numpy as np

from gonio.models.cylinders import shared
from gonio.models.distributions import BECKMANN
from gonio.randomness import kernel
from microsurfaces.arrays import Floats

COLUMNS = (0, 1, 2)
"""Of a distribution's lobes: kind, weight, alpha."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)

_CLIP = 7.0
"""Beckmann's lobe is integrated to slopes of so many mu: erfc(7) is 4e-23."""


def lambertian(profile: tuple[bool, float, float, float], wi: Floats, wo: Floats) -> Floats:
    """f (n,) in 1/sr of ideal diffusers of reflectance 1, for rows of directions."""
    value = np.empty(len(wi))
    _lambertian(*profile, wi, wo, value)
    return value


def rough(profile: tuple[bool, float, float, float], lobes: Floats, masking: int, wi: Floats, wo: Floats) -> Floats:
    """f / F (n,) in 1/sr of rough mirrors of isotropic `lobes` (m, 3) and a masking of this code."""
    value = np.empty(len(wi))
    _rough(*profile, lobes, masking, wi, wo, _NODES, _WEIGHTS, value)
    return value


@kernel
def _lambertian(ridges, d, edge, w, wi, wo, value):
    for i in range(value.size):
        value[i] = 0.0
        if wi[i, 2] <= 0.0 or wo[i, 2] <= 0.0:
            continue
        a, b = math.atan2(wi[i, 0], wi[i, 2]), math.atan2(wo[i, 0], wo[i, 2])
        p1, p2, strip = shared(ridges, d, edge, w, a, b)
        cosines = math.cos(a) * math.cos(b)
        arc = 0.0
        if p2 > p1:
            # sin(2 p2 - a - b) - sin(2 p1 - a - b) as a product: no cancellation on short arcs.
            arc = 0.5 * ((p2 - p1) * math.cos(a - b) + math.sin(p2 - p1) * math.cos(p1 + p2 - a - b))
        value[i] = (arc / cosines + strip) / (math.pi * d)


@kernel
def _rough(ridges, d, edge, w, lobes, masking, wi, wo, nodes, weights, value):
    breaks = np.empty(20)
    for i in range(value.size):
        value[i] = 0.0
        if wi[i, 2] <= 0.0 or wo[i, 2] <= 0.0:
            continue
        psi_i, psi_o = math.atan2(wi[i, 0], wi[i, 2]), math.atan2(wo[i, 0], wo[i, 2])
        p1, p2, strip = shared(ridges, d, edge, w, psi_i, psi_o)
        hx, hy, hz = wi[i, 0] + wo[i, 0], wi[i, 1] + wo[i, 1], wi[i, 2] + wo[i, 2]
        length = math.sqrt(hx * hx + hy * hy + hz * hz)
        hx, hy, hz = hx / length, hy / length, hz / length
        cosine = min(0.5 * length, 1.0)
        psi_h = math.atan2(hx, hz)
        cos_h = math.hypot(hx, hz)
        cos_i, cos_o = math.hypot(wi[i, 0], wi[i, 2]), math.hypot(wo[i, 0], wo[i, 2])
        total = 0.0
        if p2 > p1:
            total = _arc(
                lobes, masking, p1 - psi_h, p2 - psi_h, hy, cos_h, cosine, psi_h - psi_i, cos_i, wi[i, 1],
                psi_h - psi_o, cos_o, wo[i, 1], nodes, weights, breaks,
            )  # fmt: skip
        if strip > 0.0:
            total += strip * _facet(lobes, masking, hz, cosine, wi[i, 2], wo[i, 2])
        value[i] = total / (4.0 * d * wi[i, 2] * wo[i, 2])


@kernel
def _facet(lobes, masking, nh, cosine, ni, no):
    """D G of a surface element, from the cosines of the half vector and both directions to its normal."""
    if ni <= 0.0 or no <= 0.0:
        return 0.0
    density, cos2 = 0.0, nh * nh
    sin2 = max(0.0, 1.0 - cos2)
    for j in range(lobes.shape[0]):
        alpha2 = lobes[j, 2] ** 2
        if lobes[j, 0] == BECKMANN:
            exponent = sin2 / (cos2 * alpha2)
            shape = math.exp(-exponent) / (cos2 * cos2) if exponent < 700.0 else 0.0
        else:
            shape = 1.0 / (sin2 / alpha2 + cos2) ** 2
        density += lobes[j, 1] * shape / (math.pi * alpha2)
    if masking == 0:
        return density
    if masking == 1:
        return density * min(1.0, 2.0 * nh * min(ni, no) / cosine)
    lambda_i, lambda_o = _lambda(lobes, ni), _lambda(lobes, no)
    return density / ((1.0 + lambda_i) * (1.0 + lambda_o)) if masking == 2 else density / (1.0 + lambda_i + lambda_o)


@kernel
def _lambda(lobes, cosine):
    """Smith's Lambda of isotropic lobes for a direction of this cosine."""
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    total = 0.0
    for j in range(lobes.shape[0]):
        tangent = lobes[j, 2] * sine
        if lobes[j, 0] == BECKMANN:
            if tangent * 26.0 > cosine:
                a = cosine / tangent
                total += lobes[j, 1] * 0.5 * (math.exp(-a * a) / (a * math.sqrt(math.pi)) - math.erfc(a))
        else:
            total += lobes[j, 1] * 0.5 * tangent * tangent / (cosine * (cosine + math.hypot(cosine, tangent)))
    return total


@kernel
def _arc(lobes, masking, u1, u2, hy, cos_h, cosine, d_i, cos_i, y_i, d_o, cos_o, y_o, nodes, weights, breaks):
    """Integral of D G over normals at angles u1 to u2 from the half vector's projection.

    n.H = cos_h cos u and n.X = cos_X cos(u + d_X). Smooth between the breaks; within them closed forms where there are.
    """
    total = 0.0
    for j in range(lobes.shape[0]):
        if masking == 0:
            if lobes[j, 0] == BECKMANN:
                total += lobes[j, 1] * _beckmann_plain(lobes[j, 2], math.tan(u1), math.tan(u2), hy, cos_h)
            else:
                total += lobes[j, 1] * _ggx_plain(lobes[j, 2], math.tan(u1), math.tan(u2), hy, cos_h)
    if masking == 0:
        return total
    count = _breaks(masking, u1, u2, hy / cos_h, d_i, cos_i, y_i, d_o, cos_o, y_o, breaks)
    for b in range(count - 1):
        a, c = breaks[b], breaks[b + 1]
        if c <= a:
            continue
        for j in range(lobes.shape[0]):
            if masking == 1 and lobes[j, 0] == BECKMANN:
                part = _beckmann_cavity(lobes[j, 2], a, c, hy, cos_h, cosine, d_i, cos_i, d_o, cos_o)
            else:
                part = _quadrature(lobes, j, masking, a, c, hy, cos_h, cosine, d_i, cos_i, d_o, cos_o, nodes, weights)
            total += lobes[j, 1] * part
    return total


@kernel
def _erf_difference(a, b):
    """erf(b) - erf(a) without cancellation in the tails."""
    if a > 0.0 and b > 0.0:
        return math.erfc(a) - math.erfc(b)
    if a < 0.0 and b < 0.0:
        return math.erfc(-b) - math.erfc(-a)
    return math.erf(b) - math.erf(a)


@kernel
def _beckmann_front(m, hy, cos_h):
    """D = front (1 + t^2)^2 exp(-t^2 / mu^2) with t = tan u."""
    return math.exp(-((hy / (cos_h * m)) ** 2)) / (math.pi * m * m * cos_h**4)


@kernel
def _gauss(t, mu):
    return math.exp(-((t / mu) ** 2)) if abs(t) < 30.0 * mu else 0.0


@kernel
def _beckmann_plain(m, t1, t2, hy, cos_h):
    mu = m * cos_h
    errors = 0.5 * math.sqrt(math.pi) * mu * (1.0 + 0.5 * mu * mu) * _erf_difference(t1 / mu, t2 / mu)
    edges = _tail(t2, mu) - _tail(t1, mu)
    return _beckmann_front(m, hy, cos_h) * (errors - 0.5 * mu * mu * edges)


@kernel
def _tail(t, mu):
    return t * math.exp(-((t / mu) ** 2)) if abs(t) < 30.0 * mu else 0.0


@kernel
def _ggx_plain(alpha, t1, t2, hy, cos_h):
    square = hy * hy + (alpha * cos_h) ** 2
    a = math.sqrt(square)
    angle = math.atan(t2 / a) - math.atan(t1 / a)
    ends = t2 / (t2 * t2 + square) - t1 / (t1 * t1 + square)
    return alpha * alpha / math.pi * (angle / a + (1.0 - square) * (ends / (2.0 * square) + angle / (2.0 * a * square)))


@kernel
def _beckmann_cavity(m, u1, u2, hy, cos_h, cosine, d_i, cos_i, d_o, cos_o):
    """With G the smallest of 1, G_i and G_o, the same one all the way from u1 to u2."""
    u = 0.5 * (u1 + u2)
    t1, t2 = math.tan(u1), math.tan(u2)
    twice = 2.0 * cos_h * math.cos(u) / cosine
    g_i, g_o = twice * cos_i * math.cos(u + d_i), twice * cos_o * math.cos(u + d_o)
    if min(g_i, g_o) >= 1.0:
        return _beckmann_plain(m, t1, t2, hy, cos_h)
    delta, cos_x = (d_i, cos_i) if g_i < g_o else (d_o, cos_o)
    mu = m * cos_h
    errors = math.cos(delta) * 0.5 * math.sqrt(math.pi) * mu * _erf_difference(t1 / mu, t2 / mu)
    edges = math.sin(delta) * 0.5 * mu * mu * (_gauss(t2, mu) - _gauss(t1, mu))
    return _beckmann_front(m, hy, cos_h) * 2.0 * cos_h * cos_x / cosine * (errors + edges)


@kernel
def _quadrature(lobes, j, masking, u1, u2, hy, cos_h, cosine, d_i, cos_i, d_o, cos_o, nodes, weights):
    """Gauss-Legendre in tan u, clipped to Beckmann's lobe, or in atan(tan u / A), in which GGX is smooth."""
    gaussian = lobes[j, 0] == BECKMANN
    if gaussian:
        reach = _CLIP * lobes[j, 2] * cos_h
        a, b = max(math.tan(u1), -reach), min(math.tan(u2), reach)
        width = 1.0
    else:
        width = math.sqrt(hy * hy + (lobes[j, 2] * cos_h) ** 2)
        a, b = math.atan(math.tan(u1) / width), math.atan(math.tan(u2) / width)
    if b <= a:
        return 0.0
    total, alone = 0.0, lobes[j : j + 1]
    for k in range(nodes.size):
        v = 0.5 * (a + b) + 0.5 * (b - a) * nodes[k]
        t = v if gaussian else width * math.tan(v)
        jacobian = 1.0 if gaussian else width * (1.0 + math.tan(v) ** 2)
        u = math.atan(t)
        nh = cos_h * math.cos(u)
        ni, no = cos_i * math.cos(u + d_i), cos_o * math.cos(u + d_o)
        density = _facet(alone, 0, nh, cosine, ni, no) / lobes[j, 1]
        whole = _facet(lobes, 0, nh, cosine, ni, no)
        if whole > 0.0:
            # The masking belongs to all lobes together, and the density to this one.
            share = _facet(lobes, masking, nh, cosine, ni, no) / whole
            total += weights[k] * jacobian / (1.0 + t * t) * density * share
    return total * 0.5 * (b - a)


@kernel
def _breaks(masking, u1, u2, tan_h, d_i, cos_i, y_i, d_o, cos_o, y_o, breaks):
    """Ends and kinks of the integrand, sorted; how many there are."""
    breaks[0], count = u1, 1
    if masking == 1:
        for which in range(2):
            delta, tan_x = (d_i, y_i / cos_i) if which == 0 else (d_o, y_o / cos_o)
            product = tan_h * tan_x
            if abs(product) <= 1.0:
                for branch in range(-1, 2):
                    for sign in (-1.0, 1.0):
                        u = 0.5 * (sign * math.acos(product) - delta) + branch * math.pi
                        if u1 < u < u2:
                            breaks[count], count = u, count + 1
        over = cos_o * math.cos(d_o) - cos_i * math.cos(d_i)
        under = cos_o * math.sin(d_o) - cos_i * math.sin(d_i)
        if over != 0.0 or under != 0.0:
            u = math.atan2(over, under)
            for branch in range(-1, 2):
                if u1 < u + branch * math.pi < u2:
                    breaks[count], count = u + branch * math.pi, count + 1
    breaks[count] = u2
    breaks[: count + 1].sort()
    return count + 1
