"""Albedos of single scattering that are known numbers: from tables and one-dimensional integrals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from gonio.models import GGX, Beckmann, CookTorrance, Masking, Microfacet, SmithCorrelated, SmithSeparable, VCavity
from gonio.models.averages import TOLERANCE
from gonio.optics import Mirror
from gonio.sphere import direction
from gonio.validation.judging import Finding, bounded, t_test
from gonio.validation.measuring import predicted
from gonio.validation.unfolding import unfolded_albedo
from gonio.validation.v_grooves import ENSEMBLE_ERROR, beckmann

# Albedos of single scattering by mirror facets to about 4 digits: roughness, theta, V-cavity, Smith separable and
# height-correlated.
ALBEDOS = (
    (0.1, 75.0, 0.9699, 0.9751, 0.9751),
    (0.3, 0.0, 0.9955, 0.9997, 0.9997),
    (0.3, 45.0, 0.9567, 0.9671, 0.9671),
    (0.3, 75.0, 0.9273, 0.9015, 0.9025),
    (0.6, 0.0, 0.7975, 0.8562, 0.8562),
    (0.6, 45.0, 0.8263, 0.8330, 0.8331),
    (0.6, 75.0, 0.9333, 0.8973, 0.9055),
)


def single_scattering(quick: bool) -> Iterator[Finding]:
    """Albedos of single scattering: of models against tables and one-dimensional integrals, of grooves by unfolding."""
    quadrature = "quadrature of the model over 5 x 15 degrees"
    for m, theta, *values in ALBEDOS:
        maskings: tuple[Masking, ...] = (VCavity(), SmithSeparable(), SmithCorrelated())
        for masking, value in zip(maskings, values, strict=True):
            yield _of_model(Beckmann(alpha=m), masking, theta, value, 5e-4)
        where = f"Beckmann {m:g}, VCavity, theta {theta:g}, albedo by unfolding"
        total = predicted(CookTorrance(m=m, material=Mirror()), theta).total
        yield bounded(where, quadrature, total, unfolded_albedo(m, theta), 3 * TOLERANCE)
    for alpha, theta in itertools.product((0.1, 0.2, 0.4, 0.7), (0.0, 60.0, 85.0)):
        yield _of_model(GGX(alpha=alpha), SmithCorrelated(), theta, _over_visible_normals(alpha, theta), 1e-4)
    for distribution in (Beckmann(alpha=0.3), Beckmann(alpha=0.6), GGX(alpha=0.3), GGX(alpha=0.6)):
        yield _of_model(distribution, SmithCorrelated(), 0.0, _from_above(distribution), 3 * TOLERANCE)
    for m in (0.1, 0.3, 0.6):
        theta_i = tuple(theta for other, theta, *_ in ALBEDOS if other == m)
        light = beckmann(m, 2 if quick else 32, theta_i)
        for i, theta in enumerate(theta_i):
            where, blocks = f"V-grooves m = {m:g}, theta {theta:g}, albedo", light.shares[:, i, 0, 1, -1]
            yield t_test(where, light.settings, blocks, unfolded_albedo(m, theta), ENSEMBLE_ERROR)


def _of_model(distribution: Beckmann | GGX, masking: Masking, theta: float, exact: float, bound: float) -> Finding:
    model = Microfacet(distribution=distribution, masking=masking, material=Mirror())
    name = f"{type(distribution).__name__} {distribution.alpha:g}, {type(masking).__name__}, theta {theta:g}, albedo"
    return bounded(name, "quadrature of the model over 5 x 15 degrees", predicted(model, theta).total, exact, bound)


def _over_visible_normals(alpha: float, theta: float) -> float:
    """Albedo of single scattering by GGX mirrors with Smith's masking: the mean of G2 / G1 over the visible facets.

    The specular directions of the visible facets of a hemisphere, into which a GGX surface is stretched, fill a
    spherical cap evenly (Dupuy and Benyoub 2023, doi:10.1111/cgf.14867).
    """
    u, v = np.meshgrid(*2 * [(np.arange(2000) + 0.5) / 2000])
    wi, stretch = direction(theta), np.array([alpha, alpha, 1.0])
    seen = wi * stretch / np.linalg.norm(wi * stretch)
    z = (1.0 - u) * (1.0 + seen[2]) - seen[2]
    radius = np.sqrt(1.0 - z * z)
    cap = np.stack([radius * np.cos(2 * np.pi * v), radius * np.sin(2 * np.pi * v), z], axis=-1) + seen
    wm = cap * stretch
    wm /= np.linalg.norm(wm, axis=-1, keepdims=True)
    wo = 2.0 * (wm @ wi)[..., None] * wm - wi
    wo = wo[wo[..., 2] > 0.0]
    masked = GGX(alpha=alpha).smith_lambda
    return float(((1.0 + masked(wi)) / (1.0 + masked(wi) + masked(wo))).sum() / u.size)


def _from_above(distribution: Beckmann | GGX) -> float:
    """Albedo of single scattering with Smith's masking under normal light, an integral over the share of slopes."""
    from scipy.integrate import quad

    alpha = distribution.alpha or 0.0

    def share(u: float) -> float:
        """What facets at the share u of the distribution, which send light to twice their angle, return."""
        slope = math.sqrt(-math.log1p(-u) if isinstance(distribution, Beckmann) else u / (1.0 - u)) * alpha
        return float(1.0 / (1.0 + distribution.smith_lambda(direction(2.0 * math.degrees(math.atan(slope))))))

    steepest = -math.expm1(-(alpha**-2)) if isinstance(distribution, Beckmann) else 1.0 / (1.0 + alpha**2)
    return float(quad(share, 0.0, steepest * (1.0 - 1e-12), epsabs=1e-9)[0])
