"""Where a file's numbers stand: the nodes of each incidence, close where the lobe is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gonio.formats.rgl.ndf import projected_area
from gonio.formats.rgl.parametrisation import Warp, bilinear, normal, solid_angle, square
from gonio.sphere import direction, reflect
from microsurfaces.arrays import Floats, Vectors

Singles = NDArray[np.float32]

COLUMNS = 48
"""Columns and rows of the density of the nodes."""

SIGMA = 64, 49
"""Columns of sigma, and rows if not isotropic."""

EVEN = 0.5
"""Share of the nodes that are spread evenly over the square, in u as in v."""

FLATTENED = 0.35
"""Power of D that the others follow: tails are looked at, too."""

RAMP, BELOW = 0.3, 0.02
"""Below the horizon nodes become sparse, down to this share, over this cosine."""


@dataclass(frozen=True, eq=False)
class Slice:
    """What a file wants to know of one incidence."""

    wi: Vectors
    """(3,)."""
    wo: Vectors
    """(y, x, 3), of which some lie below the horizon."""
    stored: Floats
    """(y, x): what is stored per f cos(theta_o)."""
    sampled: Floats
    """(y, x): what the luminance is per f cos(theta_o)."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """The directions at which a file wants to know a BRDF, of which nothing but a distribution of normals is known."""

    theta_i: Singles
    """Incidences in radians, ascending."""
    phi_i: Singles
    """Their azimuths in radians from -pi to pi; a single 0 if the BRDF is isotropic."""
    ndf: Singles
    """D in 1/sr on the square (v, u)."""
    sigma: Singles
    """Projected area towards (v, u)."""
    warp: Warp
    """Where the nodes are, a slice for each phi_i and theta_i."""
    count: int
    """Nodes along x and along y."""

    @classmethod
    def around(cls, ndf: Floats, theta_i: Floats, phi_i: Floats, count: int) -> Self:
        """For D on the square (v, u) and incidences in degrees."""
        rows = SIGMA[1] if len(phi_i) > 1 else 2
        u, v = np.meshgrid(np.linspace(0.0, 1.0, SIGMA[0]), np.linspace(0.0, 1.0, rows))
        sigma = projected_area(ndf, normal(u, v))
        u, v = np.meshgrid(np.linspace(0.0, 1.0, COLUMNS), np.linspace(0.0, 1.0, COLUMNS))
        wm = normal(u, v)
        density = [_density(wm, direction(t, p), bilinear(ndf, u, v), solid_angle(u)) for p in phi_i for t in theta_i]
        return cls(
            theta_i=np.radians(theta_i).astype(np.float32),
            phi_i=np.radians(phi_i).astype(np.float32),
            ndf=ndf.astype(np.float32),
            sigma=sigma.astype(np.float32),
            warp=Warp.of(np.array(density, np.float32)),
            count=count,
        )

    def slice(self, p: int, t: int) -> Slice:
        """The nodes of light from `phi_i[p]` and `theta_i[t]`."""
        wi = direction(np.degrees(self.theta_i[t]), np.degrees(self.phi_i[p]))
        k = p * len(self.theta_i) + t
        u, v = self.warp.nodes(k, self.count)
        wm = normal(u, v)
        cosine = wm @ wi
        return Slice(
            wi=wi,
            wo=reflect(wi, wm),
            stored=4 * bilinear(self.sigma, *square(wi)) / bilinear(self.ndf, u, v),
            sampled=4 * cosine * solid_angle(u) / bilinear(self.warp.density[k], u, v),
        )


def _density(wm: Vectors, wi: Vectors, ndf: Floats, solid_angle: Floats) -> Floats:
    """Density of the nodes for light from `wi` on the square of normals `wm` (v, u, 3)."""
    horizon = np.clip(1 + reflect(wi, wm)[..., 2] / RAMP, BELOW, 1.0)
    lobe = ndf**FLATTENED * solid_angle * horizon
    return np.asarray((1 - EVEN) * lobe / lobe.mean() + EVEN * horizon / horizon.mean())
