"""Spherical pits in a plane, of Lambertian material."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from gonio.optics import Lambertian
from gonio.validation.judging import Finding, t_test
from gonio.validation.measuring import specimen
from gonio.validation.meshes import sheet
from microsurfaces import Mesh


def lambertian(quick: bool) -> Iterator[Finding]:
    """Lambertian spherical pits: light spreads evenly over a sphere, so that every reflection loses the same share.

    With f the share of the plane that pits open in, rho the reflectance and kappa = (1 + cos Theta) / 2 that part of
    the whole sphere which a cap of half angle Theta lacks, k reflections return f rho^k (1 - kappa)^(k - 1) kappa from
    whatever direction the light comes, and the land rho (1 - f) after one (Koenderink et al. 1999,
    doi:10.1023/A:1008114305456).
    """
    rho, side = 0.8, 2.1
    for opening in (60.0, 90.0, 120.0):
        relief, f = _pits(opening, side)
        light = specimen(relief, Lambertian(rho), (0.0, 61.7), quick, "256 x 96 facets a pit", 4, (10.0,))
        kappa = (1.0 + math.cos(math.radians(opening))) / 2.0
        for (i, theta), k in itertools.product(enumerate((0.0, 61.7)), (1, 2, 3)):
            exact = f * rho**k * (1.0 - kappa) ** (k - 1) * kappa + (rho * (1.0 - f) if k == 1 else 0.0)
            words = f"Theta = {opening:g}, theta {theta:g}, order {k}, albedo"
            yield t_test(words, light.settings, light.shares[:, i, 0, k, -1], exact)


def _pits(opening: float, side: float, around: int = 256, down: int = 96) -> tuple[Mesh, float]:
    """Spherical pits of radius 1, caps with the half angle `opening` in degrees seen from the sphere's centre, in a
    square of `side`; and the share of the plane that they open in."""
    polar = np.radians(opening) * np.arange(down + 1) / down
    azimuth = -2 * np.pi * (np.arange(around + 1) % around) / around
    radius, depth = np.append(np.sin(polar), 0.0), np.append(np.cos(polar[-1]) - np.cos(polar), 0.0)
    points = np.empty((down + 2, around + 1, 3))
    points[..., 0], points[..., 1] = radius[:, None] * np.cos(azimuth), radius[:, None] * np.sin(azimuth)
    points[..., 2] = depth[:, None]
    reach = side / 2 / np.maximum(np.abs(np.cos(azimuth)), np.abs(np.sin(azimuth)))
    points[-1, :, 0], points[-1, :, 1] = reach * np.cos(azimuth), reach * np.sin(azimuth)
    share = around / 2 * math.sin(2 * math.pi / around) * radius[down] ** 2 / side**2
    return sheet(points, (side, side)), share
