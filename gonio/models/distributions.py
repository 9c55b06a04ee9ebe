"""Distributions of facet normals: how much facet area, per area of the macroscopic plane, faces each direction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microsurfaces.recipe import Positive, recipe

Array = NDArray[np.float64]


@recipe
class Beckmann:
    """Facets of a surface whose slopes are Gaussian, as those of any Gaussian random height field are.

    D(m) = exp(-tan^2 / alpha^2) / (pi alpha^2 cos^4) per steradian, with the angle between m and the macroscopic
    normal. D cos integrates to 1: it is an area of facets, not a probability of directions. Along each axis the slope
    has the variance alpha^2 / 2, so that alpha is the rms of the slope's length and sqrt(2) times its rms along one
    axis.

    A feel for the numbers: alpha 0.05 is a satin polish (lobe about 6 degrees wide), 0.2 sand-blasted metal, 0.5 a
    rough casting whose facets reach 45 degrees, 1 a surface on which most light is reflected more than once.

    Source: P. Beckmann and A. Spizzichino, The Scattering of Electromagnetic Waves from Rough Surfaces (1963); in this
    normalisation B. Walter, S. R. Marschner, H. Li, K. E. Torrance, Microfacet Models for Refraction through Rough
    Surfaces, EGSR 2007, doi:10.2312/EGWR/EGSR07/195-206, eq. 25.
    """

    alpha: Positive
    """Roughness: root mean square of the length of the facets' slope."""

    @classmethod
    def of(cls, statistics: Mapping[str, float | None]) -> Self:
        """The distribution of a specimen, from the `beckmann_alpha` that its statistics measured from the facets."""
        alpha = statistics.get("beckmann_alpha")
        if not alpha:
            raise ValueError(
                f"beckmann_alpha = {alpha} must be above 0 for a microfacet model: this surface is flat, or its "
                "statistics were not measured."
            )
        return cls(alpha=float(alpha))

    def density(self, wm: ArrayLike) -> Array:
        """D (...) in 1/sr at facet normals `wm` (..., 3), unit vectors; 0 for facets that face down."""
        x, y, z = np.moveaxis(np.asarray(wm, np.float64), -1, 0)
        upward = z > 0.0
        cos2 = np.where(upward, z, 1.0) ** 2
        # sin^2 from x and y: 1 - cos^2 would lose the lobe of an almost smooth surface to rounding.
        exponent = (x * x + y * y) / (cos2 * self.alpha**2)
        # Beyond 700 the exponential is below 1e-304, and 1 / cos^4 may overflow.
        near = upward & (exponent < 700.0)
        shape = np.exp(-np.where(near, exponent, 700.0)) / np.where(near, cos2, 1.0) ** 2
        density: Array = np.where(near, shape / (np.pi * self.alpha**2), 0.0)
        return density

    def smith_lambda(self, w: ArrayLike) -> Array:
        """Smith's Lambda (...) for directions `w` (..., 3) above the horizon: hidden area per visible area of facets.

        With a = cos / (alpha sin): (exp(-a^2) / (a sqrt(pi)) - erfc(a)) / 2 (Walter et al. 2007, eq. 26, where G1 = 1
        / (1 + Lambda)).
        """
        from scipy.special import erfcx

        x, y, z = np.moveaxis(np.asarray(w, np.float64), -1, 0)
        tangent = np.hypot(x, y)
        # Lambda is below 1e-300 past 26, where both terms would be 0 anyway; so is it straight above.
        a = np.minimum(z / (self.alpha * np.where(tangent > 0.0, tangent, 1.0)), 26.0)
        a = np.where(tangent > 0.0, a, 26.0)
        value: Array = 0.5 * np.exp(-a * a) * (1.0 / (a * np.sqrt(np.pi)) - erfcx(a))
        return value


Distribution = Beckmann
"""What the facets' normals may be distributed as."""
