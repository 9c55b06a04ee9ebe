"""Klems matrices: BRDFs averaged over the patches of an angle basis, incident times exiting.

A basis divides the hemisphere into rings of patches; patch k of a ring of n is centred on azimuth 360 k/n. Exiting
light is counted by the azimuth that it travels to, and incident light by the azimuth that it TRAVELS to as well: light
from `wi` belongs to the patch around the azimuth of `-wi`, so the diagonal of a matrix is the specular direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.brdf import BRDF
from gonio.detectors import Klems, ringed
from gonio.sphere import direction
from microsurfaces.arrays import Floats, Vectors


@dataclass(frozen=True)
class AngleBasis:
    """Rings of patches that fill the hemisphere."""

    name: str
    """As Radiance and WINDOW know it."""
    edges: tuple[float, ...]
    """Of the rings in degrees, from 0 to 90."""
    counts: tuple[int, ...]
    """Patches of each ring: 1 around the pole, multiples of 4 elsewhere."""

    @property
    def patches(self) -> int:
        """How many there are."""
        return sum(self.counts)

    @property
    def starts(self) -> NDArray[np.intp]:
        """Number of the first patch of each ring."""
        return np.cumsum((0, *self.counts[:-1]))

    @property
    def theta(self) -> Floats:
        """Polar angles of the middle of the rings in degrees; 0 for the cap."""
        centres = np.add(self.edges[1:], self.edges[:-1]) / 2
        return np.asarray(np.where(np.arange(len(centres)), centres, 0.0))

    def index(self, w: Vectors) -> NDArray[np.intp]:
        """The patch around each of the directions `w` (n, 3), which count as exiting."""
        return ringed(self.edges, self.counts, w)

    def directions(self, x: Floats, y: Floats) -> Vectors:
        """Exiting directions (patches, n, 3) at shares `x` of the projected area and `y` of the azimuths (n,)."""
        low, high = (
            np.repeat(np.sin(np.radians(e)) ** 2, self.counts)[:, None] for e in (self.edges[:-1], self.edges[1:])
        )
        count = np.repeat(self.counts, self.counts)[:, None]
        number = np.arange(self.patches)[:, None] - np.repeat(self.starts, self.counts)[:, None]
        theta = np.degrees(np.arcsin(np.sqrt(low + (high - low) * x)))
        return direction(theta, (number + y - 0.5) * (360 / count))

    def turned(self, quarters: int) -> NDArray[np.intp]:
        """Where every patch comes to lie when the basis is turned by so many right angles."""
        count = np.repeat(self.counts, self.counts)
        start = np.repeat(self.starts, self.counts)
        return np.asarray(start + (np.arange(self.patches) - start + quarters * count // 4) % count)


BASES = {
    f"klems-{basis.basis}": AngleBasis(
        f"LBNL/Klems {basis.basis.title()}", tuple(basis.theta_edges.tolist()), tuple(basis.sectors.tolist())
    )
    for basis in (Klems(basis="full"), Klems(basis="half"), Klems(basis="quarter"))
}
"""The three bases that Radiance knows by name."""


def matrix(brdf: BRDF, basis: AngleBasis) -> Floats:
    """Averages over pairs of patches with the weight cosθ dω on either side, (exiting, incident, channels).

    NaN where nothing is known.
    """
    # Four times as many entries of an anisotropic matrix have to be computed.
    nodes = _nodes(128 if brdf.isotropic else 64)
    wi, wo = basis.directions(*nodes[:2]) * (-1, -1, 1), basis.directions(*nodes[2:])
    result = np.empty((basis.patches, basis.patches, len(brdf.wavelengths)))
    # A quarter turn maps every basis onto itself.
    turns = [basis.turned(quarters) for quarters in range(4 if brdf.isotropic else 1)]
    for i in np.flatnonzero(np.arange(basis.patches) == np.min(turns, axis=0)):
        values = brdf.evaluate(np.broadcast_to(wi[i], wo.shape).reshape(-1, 3), wo.reshape(-1, 3))
        column = mean_of_known(values.reshape(*wo.shape[:2], -1))
        for turn in turns:
            result[turn, turn[i]] = column
    return result


def _nodes(count: int) -> Floats:
    """Places (4, 2 count) in an incident and an exiting patch: a Sobol net, and the same with the two exchanged.

    No two differences of places are the same, as those of a product of rules are, and narrow lobes depend on the
    difference. Together with the exchange a reciprocal BRDF stays reciprocal.
    """
    from scipy.stats import qmc

    net = qmc.Sobol(4, scramble=False).random(count).T + 0.5 / count
    return np.concatenate([net, net[[2, 3, 0, 1]]], axis=1)


def mean_of_known(values: Floats) -> Floats:
    """Means (patches, channels) of values (patches, nodes, channels) that are not NaN; NaN where all are."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(known, values, 0.0).sum(axis=1) / known.sum(axis=1))


def value(table: Floats, incident: AngleBasis, exiting: AngleBasis, wi: Vectors, wo: Vectors) -> Floats:
    """Entries (n, channels) of a matrix (exiting, incident, channels) for directions (n, 3)."""
    return np.asarray(table[exiting.index(wo), incident.index(wi * (-1, -1, 1))])
