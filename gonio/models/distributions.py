"""Distributions of facet normals: how much facet area, per area of the macroscopic plane, faces each direction.

Every distribution is a sum of elliptical lobes, one row of `lobes()` each; the kernels work on those rows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from gonio.randomness import kernel
from microsurfaces import Gaussian
from microsurfaces.arrays import Floats
from microsurfaces.recipe import Fraction, Positive, recipe

BECKMANN, GGX_ = 0.0, 1.0
"""First column of a lobe: its shape; then weight, alpha_x, alpha_y, cosine and sine of the rotation."""

REACH = 6.0
"""Beckmann's lobe is followed to slopes of this many alpha: beyond, D is 2e-16 of its maximum."""

_ANISOTROPIC = 0.1
"""Relative difference of the rms slopes along x and y from which a specimen counts as anisotropic: specimens of an
isotropic surface of 60 correlation lengths differ by 0.03."""


@kernel
def density(lobes, x, y, z):
    """D at a facet normal (x, y, z): the sum over lobes."""
    if z <= 0.0:
        return 0.0
    cos2 = z * z
    total = 0.0
    for j in range(lobes.shape[0]):
        ax, ay, c, s = lobes[j, 2], lobes[j, 3], lobes[j, 4], lobes[j, 5]
        # Slopes from x and y: 1 - cos^2 would lose the lobe of an almost smooth surface to rounding.
        p, q = (c * x + s * y) / ax, (c * y - s * x) / ay
        square = p * p + q * q
        if lobes[j, 0] == BECKMANN:
            exponent = square / cos2
            # Beyond 700 the exponential is below 1e-304, and 1 / cos^4 may overflow.
            value = math.exp(-exponent) / (cos2 * cos2) if exponent < 700.0 else 0.0
        else:
            value = 1.0 / (square + cos2) ** 2
        total += lobes[j, 1] * value / (math.pi * ax * ay)
    return total


@kernel
def smith_lambda(lobes, x, y, z):
    """Smith's Lambda for a direction above the horizon; linear in the lobes, as the slopes' density is."""
    total = 0.0
    for j in range(lobes.shape[0]):
        c, s = lobes[j, 4], lobes[j, 5]
        tangent = math.hypot(lobes[j, 2] * (c * x + s * y), lobes[j, 3] * (c * y - s * x))
        if lobes[j, 0] == BECKMANN:
            # Lambda is below 1e-300 past a = 26, where both terms would be 0 anyway; so is it straight above.
            if tangent * 26.0 > z:
                a = z / tangent
                total += lobes[j, 1] * 0.5 * (math.exp(-a * a) / (a * math.sqrt(math.pi)) - math.erfc(a))
        else:
            total += lobes[j, 1] * 0.5 * tangent * tangent / (z * (z + math.hypot(z, tangent)))
    return total


@kernel
def _densities(lobes, wm, result):
    for i in range(wm.shape[0]):
        result[i] = density(lobes, wm[i, 0], wm[i, 1], wm[i, 2])


@kernel
def _lambdas(lobes, w, result):
    for i in range(w.shape[0]):
        result[i] = smith_lambda(lobes, w[i, 0], w[i, 1], w[i, 2])


def _each(function: Any, lobes: Floats, w: ArrayLike) -> Floats:
    """A kernel's values (...) at vectors (..., 3)."""
    flat = np.ascontiguousarray(np.asarray(w, np.float64).reshape(-1, 3))
    result = np.empty(len(flat))
    function(lobes, flat, result)
    return result.reshape(np.shape(w)[:-1])


def _lobe(kind: float, alpha_x: float, alpha_y: float, rotation: float) -> Floats:
    turn = math.radians(rotation)
    return np.array([[kind, 1.0, alpha_x, alpha_y, math.cos(turn), math.sin(turn)]])


def _axes(distribution: Beckmann | GGX) -> tuple[float, float]:
    """alpha along both axes of the distribution's own frame."""
    return distribution.alpha or distribution.alpha_x or 0.0, distribution.alpha or distribution.alpha_y or 0.0


def _check_axes(distribution: Beckmann | GGX) -> None:
    values = {name: getattr(distribution, name) for name in ("alpha", "alpha_x", "alpha_y")}
    given = {name: value for name, value in values.items() if value is not None}
    if list(given) not in (["alpha"], ["alpha_x", "alpha_y"]):
        found = " and ".join(f"{name} = {value:g}" for name, value in given.items()) or "alpha is missing"
        raise ValueError(f"{found}: give either alpha alone, or alpha_x and alpha_y together")


def _measured_axes(statistics: Mapping[str, float | None], surface: object) -> dict[str, Any]:
    """The roughness parameters of a specimen: alpha, or alpha_x, alpha_y and rotation."""
    alpha, x, y = (statistics.get(f"beckmann_alpha{axis}") for axis in ("", "_x", "_y"))
    if not alpha:
        raise ValueError(
            f"beckmann_alpha = {alpha} must be above 0 for a microfacet model: this surface is flat, or its "
            "statistics were not measured."
        )
    if isinstance(surface, Gaussian) and surface.alpha_x is not None and surface.alpha_y is not None:
        # Facets along x and y do not show a rotated surface's own axes: its recipe does, they give the size.
        scale = alpha / math.sqrt((surface.alpha_x**2 + surface.alpha_y**2) / 2)
        return {
            "alpha_x": scale * surface.alpha_x,
            "alpha_y": scale * surface.alpha_y,
            "rotation": surface.rotation,
        }
    if isinstance(surface, Gaussian) or not x or not y or abs(x / y - 1.0) <= _ANISOTROPIC:
        return {"alpha": alpha}
    return {"alpha_x": x, "alpha_y": y}


@recipe
class Beckmann:
    """Facets of a surface whose slopes are Gaussian, as those of any Gaussian random height field are.

    D(m) = exp(-tan^2 / alpha^2) / (pi alpha^2 cos^4) per steradian, with the angle between m and the macroscopic
    normal; anisotropic with (cos^2 / alpha_x^2 + sin^2 / alpha_y^2) of the azimuth in place of 1 / alpha^2. D cos
    integrates to 1: it is an area of facets, not a probability of directions. Along an axis the slope has the variance
    alpha^2 / 2, so that alpha is sqrt(2) times its rms along one axis and, if isotropic, the rms of the slope's length.

    A feel for the numbers: alpha 0.05 is a satin polish (lobe about 6 degrees wide), 0.2 sand-blasted metal, 0.5 a
    rough casting whose facets reach 45 degrees, 1 a surface on which most light is reflected more than once.

    Source: P. Beckmann and A. Spizzichino, The Scattering of Electromagnetic Waves from Rough Surfaces (1963); in this
    normalisation B. Walter, S. R. Marschner, H. Li, K. E. Torrance, Microfacet Models for Refraction through Rough
    Surfaces, EGSR 2007, doi:10.2312/EGWR/EGSR07/195-206, eq. 25; Smith's Lambda eq. 26 (G1 = 1 / (1 + Lambda)).
    """

    alpha: Positive | None = None
    """Roughness of an isotropic surface: root mean square of the length of the facets' slope."""
    alpha_x: Positive | None = None
    """Roughness along the distribution's own x axis, sqrt(2) times the rms slope; goes with alpha_y."""
    alpha_y: Positive | None = None
    """Roughness along its own y axis."""
    rotation: float = 0.0
    """Angle from x to the distribution's own x axis, degrees, counter-clockwise."""

    @model_validator(mode="after")
    def _one_roughness(self) -> Self:
        _check_axes(self)
        return self

    @classmethod
    def of(cls, statistics: Mapping[str, float | None], surface: object = None) -> Self:
        """The distribution of a specimen, from what its `statistics` measured on the facets.

        Isotropic unless the slopes along x and y differ by more than 10 %; of an anisotropic Gaussian `surface` the
        axes and their ratio are the recipe's.
        """
        return cls(**_measured_axes(statistics, surface))

    def lobes(self) -> Floats:
        """One lobe, (1, 6)."""
        return _lobe(BECKMANN, *_axes(self), self.rotation)

    def density(self, wm: ArrayLike) -> Floats:
        """D (...) in 1/sr at facet normals `wm` (..., 3), unit vectors; 0 for facets that face down."""
        return _each(_densities, self.lobes(), wm)

    def smith_lambda(self, w: ArrayLike) -> Floats:
        """Smith's Lambda (...) for directions `w` (..., 3) above the horizon: hidden area per visible area of facets.

        With a = cos / (alpha sin): (exp(-a^2) / (a sqrt(pi)) - erfc(a)) / 2.
        """
        return _each(_lambdas, self.lobes(), w)


@recipe
class GGX:
    """Facets with the long tails of ground glass and of many polished surfaces (Trowbridge and Reitz 1975).

    D(m) = 1 / (pi alpha_x alpha_y ((m_x / alpha_x)^2 + (m_y / alpha_y)^2 + m_z^2)^2) per steradian; isotropic
    alpha^2 / (pi ((alpha^2 - 1) cos^2 + 1)^2). The distribution of the facets of an ellipsoid. D cos integrates to 1,
    but the mean square slope is infinite: alpha cannot be had from an rms slope. Half of the facets, by area in the
    plane, are steeper than alpha.

    A feel for the numbers: at equal alpha the peak is Beckmann's, the tail is not: at tan = 3 alpha there is 0.01 of
    the peak left, with Beckmann 1e-4.

    Source: B. Walter, S. R. Marschner, H. Li, K. E. Torrance, Microfacet Models for Refraction through Rough Surfaces,
    EGSR 2007, doi:10.2312/EGWR/EGSR07/195-206, eq. 33, Smith's Lambda eq. 34; anisotropic: E. Heitz, JCGT 3(2), 2014,
    eq. 85, 87.
    """

    alpha: Positive | None = None
    """Roughness of an isotropic surface: the median slope."""
    alpha_x: Positive | None = None
    """Roughness along the distribution's own x axis; goes with alpha_y."""
    alpha_y: Positive | None = None
    """Roughness along its own y axis."""
    rotation: float = 0.0
    """Angle from x to the distribution's own x axis, degrees, counter-clockwise."""

    @model_validator(mode="after")
    def _one_roughness(self) -> Self:
        _check_axes(self)
        return self

    @classmethod
    def of(cls, statistics: Mapping[str, float | None], surface: object = None) -> Self:
        """Always a ValueError: the slopes' moments, all that `statistics` has, do not determine a GGX distribution."""
        raise ValueError(
            "GGX has no mean square slope, so that a specimen's statistics do not give its alpha: fit it to the "
            "measurement, or give distribution.alpha."
        )

    def lobes(self) -> Floats:
        """One lobe, (1, 6)."""
        return _lobe(GGX_, *_axes(self), self.rotation)

    def density(self, wm: ArrayLike) -> Floats:
        """D (...) in 1/sr at facet normals `wm` (..., 3), unit vectors; 0 for facets that face down."""
        return _each(_densities, self.lobes(), wm)

    def smith_lambda(self, w: ArrayLike) -> Floats:
        """Smith's Lambda (...) for directions `w` (..., 3) above the horizon: (sqrt(1 + alpha^2 tan^2) - 1) / 2."""
        return _each(_lambdas, self.lobes(), w)


@recipe
class Mixture:
    """Facets of several scales of roughness side by side, each with its share of the macroscopic plane.

    D = sum w_j D_j, with weights that sum to 1; the mean square slopes add in the same way. Smith's Lambda is linear in
    the density of slopes, hence Lambda = sum w_j Lambda_j (and not the mean of G).

    Source: R. L. Cook and K. E. Torrance, A Reflectance Model for Computer Graphics, 1982,
    doi:10.1145/357290.357293, section 3 (several scales of roughness).
    """

    components: Annotated[
        tuple[tuple[Fraction, Annotated[Beckmann | GGX, Field(discriminator="kind")]], ...], Field(min_length=1)
    ]
    """(weight, distribution) of each scale."""

    @model_validator(mode="after")
    def _weights(self) -> Self:
        total = math.fsum(weight for weight, _ in self.components)
        if abs(total - 1.0) > 1e-9:
            raise ValueError(f"the weights of components sum to {total:g}: they must sum to 1")
        return self

    @classmethod
    def of(cls, statistics: Mapping[str, float | None], surface: object = None) -> Self:
        """The one Beckmann distribution of a specimen: statistics do not tell scales apart."""
        return cls(components=((1.0, Beckmann.of(statistics, surface)),))

    def lobes(self) -> Floats:
        """The lobes of all components, (n, 6)."""
        parts = [distribution.lobes() * [1, weight, 1, 1, 1, 1] for weight, distribution in self.components]
        return np.concatenate(parts)

    def density(self, wm: ArrayLike) -> Floats:
        """D (...) in 1/sr at facet normals `wm` (..., 3), unit vectors; 0 for facets that face down."""
        return _each(_densities, self.lobes(), wm)

    def smith_lambda(self, w: ArrayLike) -> Floats:
        """Smith's Lambda (...) for directions `w` (..., 3) above the horizon."""
        return _each(_lambdas, self.lobes(), w)


Distribution = Annotated[Beckmann | GGX | Mixture, Field(discriminator="kind")]
"""What the facets' normals may be distributed as."""
