"""A file's BRDF between its numbers, as Mitsuba evaluates it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gonio.formats.rgl.parametrisation import Warp, bilinear, cell, slices_around, square
from gonio.formats.rgl.slices import Singles
from gonio.sphere import angles, half_vector
from microsurfaces.arrays import Floats, Vectors

CHUNK = 1 << 16
"""Pairs of directions evaluated at a time."""


@dataclass(frozen=True, eq=False)
class Interpolant:
    """A BRDF on the warped square, linear between incidences, azimuths and nodes."""

    theta_i: Floats
    phi_i: Floats
    """Radians, ascending."""
    ndf: Floats
    sigma: Floats
    """On the square (v, u)."""
    warp: Warp
    values: Singles
    """(slice, y, x, channel)."""
    jacobian: bool
    """Whether the values are to be multiplied by D / (4 sigma)."""

    @property
    def isotropic(self) -> bool:
        """Whether azimuths count from that of the light."""
        return len(self.phi_i) <= 2

    @property
    def reduction(self) -> int:
        """How many times the azimuths go into a full circle."""
        return 1 if self.isotropic else round(2 * math.pi / float(self.phi_i[-1] - self.phi_i[0]))

    def evaluate(self, wi: Vectors, wo: Vectors) -> Floats:
        """The BRDF (n, channels) in 1/sr for `wi`, `wo` (n, 3) above the horizon."""
        parts = [self._evaluated(wi[k : k + CHUNK], wo[k : k + CHUNK]) for k in range(0, len(wi), CHUNK)]
        return np.concatenate(parts) if parts else np.zeros((0, self.values.shape[-1]))

    def _evaluated(self, wi: Vectors, wo: Vectors) -> Floats:
        wi, wo = self._folded(wi, wo)
        theta, phi = angles(wi)
        phi = (phi + 180) % 360 - 180
        u, v = square(half_vector(wi, wo))
        if self.isotropic:
            v = (v - phi / 360) % 1
        blend = slices_around((self.phi_i, np.radians(phi)), (self.theta_i, np.radians(theta)))
        x, y = self.warp.invert(u, v, blend)
        (i, s), (j, t) = (cell(axis, self.values.shape[1]) for axis in (x, y))
        result = np.zeros((len(wi), self.values.shape[-1]))
        for k, weight in blend:
            corners = (j, i, (1 - t) * (1 - s)), (j, i + 1, (1 - t) * s), (j + 1, i, t * (1 - s)), (j + 1, i + 1, t * s)
            for row, column, share in corners:
                result += (weight * share)[:, None] * self.values[k, row, column]
        if self.jacobian:
            result *= (bilinear(self.ndf, u, v) / (4 * bilinear(self.sigma, *square(wi))))[:, None]
        return result / wo[:, 2:]

    def _folded(self, wi: Vectors, wo: Vectors) -> tuple[Vectors, Vectors]:
        """Both directions turned (r = 2) or mirrored (r = 4) so that wi comes from the azimuths that the file has."""
        if self.reduction == 1:
            return wi, wo
        turn = np.ones(wi.shape)
        turn[:, 1] = np.where(np.signbit(wi[:, 1]), 1.0, -1.0)
        turn[:, 0] = np.where(np.signbit(wi[:, 0]), 1.0, -1.0) if self.reduction == 4 else turn[:, 1]
        return wi * turn, wo * turn

    def azimuths(self) -> Floats:
        """The light's known azimuths all around, degrees, 0 <= phi_i < 360; 0 alone if isotropic."""
        if self.isotropic:
            return np.zeros(1)
        phi = np.round(np.degrees(self.phi_i), 4)
        images = {1: (phi,), 2: (phi, phi + 180), 4: (phi, phi + 180, -phi, 180 - phi)}[self.reduction]
        return np.unique(np.concatenate(images) % 360)
