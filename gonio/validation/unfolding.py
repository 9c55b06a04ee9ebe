"""One V-groove of mirrors: light of every number of hits, by unfolding."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from gonio.optics import Mirror
from gonio.validation.judging import Finding, t_test
from gonio.validation.measuring import PHI_I, THETA_I, specimen
from microsurfaces import VGrooves
from microsurfaces.arrays import Floats


def unfolded(slope: ArrayLike, psi: ArrayLike, hits: int) -> Floats:
    """Share (...) of the light that leaves a groove with mirror walls after exactly so many hits.

    `slope` is the tan of its facets, `psi` the projected angle of the light in the plane across, radians. Zipin's
    unfolding: mirrored in its walls, the groove becomes a fan of wedges around its bottom line, with rims at the angles
    +-gamma (1 + 2 j) from z and the distance 1 from the bottom, gamma = pi/2 - atan(slope); light goes straight on.
    What enters at x has its closest approach p = x cos(psi) - cos(gamma) sin(psi) at the angle pi/2 + psi to the right
    of z if p > 0, else pi/2 - psi to the left, and leaves the fan acos|p| beyond: it has hit as many walls as there are
    rims before that. No more than k hits are therefore |p| >= cos(gamma (2 k + 1) - pi/2 -+ psi), a range of x.

    Source: R. B. Zipin, The apparent thermal radiation properties of an isothermal V-groove with specularly reflecting
    walls, Journal of Research of the NBS 70C, 1966.
    """
    gamma, psi = np.pi / 2 - np.arctan(slope), np.asarray(psi, np.float64)

    def at_most(k: int) -> Floats:
        share = np.zeros(np.broadcast_shapes(gamma.shape, psi.shape))
        for side in (1.0, -1.0):
            least = np.cos(np.clip(gamma * (2 * k + 1) - np.pi / 2 - side * psi, 0.0, np.pi / 2))
            # With light from beyond the rim all rays pass on the other side of the bottom, none closer than this.
            least = np.maximum(least, -np.sin(gamma + side * psi))
            share += np.maximum(np.sin(gamma - side * psi) - least, 0.0)
        return np.asarray(share / (2.0 * np.sin(gamma) * np.cos(psi)))

    share: Floats = at_most(hits) - at_most(hits - 1) if hits > 1 else at_most(1)
    return share


def unfolded_albedo(m: float, theta: float, cut: float = 1.0) -> float:
    """What Beckmann's ensemble of grooves of all azimuths returns after one hit, groove by groove, by midpoints.

    Slopes beyond the share `cut` of the distribution are replaced by that one.
    """
    u = np.minimum((np.arange(2000) + 0.5) / 2000, cut)
    azimuth = (np.arange(500) + 0.5) / 500 * (np.pi / 2)
    psi = np.arctan(math.tan(math.radians(theta)) * np.cos(azimuth))
    return float(unfolded((m * np.sqrt(-np.log1p(-u)))[:, None], psi, 1).mean())


def one_groove(quick: bool) -> Iterator[Finding]:
    """In grooves of one slope, light of every number of hits is known by unfolding (Zipin 1966)."""
    for angle in (30.0, 50.0, 70.0):
        most, gamma = math.ceil(180.0 / (180.0 - 2.0 * angle)), math.tan(math.radians(angle))
        relief = VGrooves(angle=angle).build(0)
        light = specimen(relief, Mirror(), THETA_I, quick, "one groove", most + 1, PHI_I)
        for (i, theta), (j, phi) in itertools.product(enumerate(THETA_I), enumerate(PHI_I)):
            psi = math.atan(math.tan(math.radians(theta)) * math.cos(math.radians(phi)))
            for hits in range(1, most + 1):
                exact = float(unfolded(gamma, psi, hits))
                if exact > 0.0:
                    words = f"{angle:g} degrees, theta {theta:g}, phi {phi:g}, {hits} hits"
                    yield t_test(words, light.settings, light.shares[:, i, j, hits, -1], exact)
