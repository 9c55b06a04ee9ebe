"""Cook and Torrance's model: mirror facets paired into V-grooves, over a diffuse floor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from gonio.detectors import Detector
from gonio.models.averages import bin_average
from gonio.models.distributions import Beckmann, Mixture
from gonio.models.facets import lobe_detail, specular
from gonio.models.lambert import Lambert
from gonio.models.masking import VCavity
from gonio.optics import Lambertian, Material, Specular
from microsurfaces.arrays import Floats
from microsurfaces.recipe import Fraction, Positive, recipe

Normalisation = Literal["microsurface", "textbook", "half", "printed_1982", "pi_for_four", "four_for_pi"]

NORMALISATIONS: dict[Normalisation, float] = {
    "microsurface": 1.0,
    "textbook": 1.0,
    "half": 0.5,
    "printed_1982": 4.0,
    "pi_for_four": 4.0 / math.pi,
    "four_for_pi": math.pi,
}
"""The prefactors and distributions in circulation, as factors of the one that agrees with a traced surface."""


@recipe
class CookTorrance:
    """Cook and Torrance's reflection model (1982): mirror facets paired into V-grooves, and a diffuse part.

    Physics. The surface is made of V-grooves whose facets are mirrors. Light is reflected towards `wo` only by facets
    whose normal is the half vector H; Beckmann's distribution says how many there are, Fresnel's equations at the
    LOCAL angle (wi . H) how much each reflects, and the V-groove's geometry which share of them is lit and visible.
    Light that is reflected twice is not in the model, and what the grooves' facets do not reflect is lost, but for the
    diffuse part.

    Equation, with N the macroscopic normal, L = wi, V = wo:

        f = k_d reflectance / pi  +  k_s F(L.H) D(H) G / (4 (N.L) (N.V))
        D = exp(-tan^2 a / m^2) / (pi m^2 cos^4 a),   a the angle between N and H
        G = min(1, 2 (N.H)(N.V) / (V.H), 2 (N.H)(N.L) / (V.H))

    With m_x and m_y, tan^2 a / m^2 becomes tan^2 a (cos^2 b / m_x^2 + sin^2 b / m_y^2), b the azimuth of H from the
    model's own x axis, and m^2 in front becomes m_x m_y. Several `scales` of roughness add up: D = sum of weight D(m).

    Normalisation. Six pairs of prefactor and distribution are in circulation; with E = exp(-tan^2 a / m^2) / cos^4 a
    they are, as `normalisation` and as a factor of the first:

        "microsurface"   1/4       with E / (pi m^2)   1       the one whose D cos integrates to 1
        "textbook"       1/pi      with E / (4 m^2)    1       the same numbers, written as many textbooks do
        "half"           1/(2 pi)  with E / (4 m^2)    1/2
        "printed_1982"   1/pi      with E / m^2        4       usually attributed to the printed paper
        "pi_for_four"    1/pi      with E / (pi m^2)   4/pi    a common mix-up
        "four_for_pi"    1/4       with E / m^2        pi      the other mix-up

    Only the first two agree with a traced surface: the 4 is the Jacobian of a mirror. The others are there to show it.

    Validity. Exact for single scattering by an ensemble of long symmetric V-grooves of equal width and coplanar upper
    edges, at every azimuth. For Gaussian height fields `Microfacet` with Smith's masking is better: there G = min
    leaves the albedo 6 to 8 % too low near normal incidence (m = 0.5 to 0.8) and misplaces the lobe at grazing
    incidence. Only for geometric optics: facets many wavelengths wide.

    A feel for the numbers: straight above, L = V = N, with F = 1 it is 1 / (4 pi m^2): 0.884 / sr at m = 0.3. The lobe
    of a specular direction is about 2 m radians wide. With F = 1 the albedo at 0, 45, 75 degrees is 0.996, 0.957, 0.927
    for m = 0.3 and 0.798, 0.826, 0.933 for m = 0.6; the rest would be multiple scattering.

    Source: R. L. Cook, K. E. Torrance, A Reflectance Model for Computer Graphics, ACM Transactions on Graphics 1(1),
    1982, doi:10.1145/357290.357293.
    """

    material: Specular
    """What the facets are made of: Mirror, Conductor or Dielectric."""
    m: Positive | None = None
    """Roughness: root mean square of the length of the facets' slope (Beckmann's alpha), 0.01 to 1 as a rule."""
    m_x: Positive | None = None
    """Roughness along the model's own x axis, sqrt(2) times the rms slope; give m_y with it, and no m."""
    m_y: Positive | None = None
    """Roughness along its own y axis."""
    scales: Annotated[tuple[tuple[Positive, Fraction], ...], Field(min_length=1)] | None = None
    """(m, weight) of several scales of roughness, in place of m; the weights sum to 1."""
    rotation: float = 0.0
    """Angle from x to the model's own x axis, degrees, counter-clockwise."""
    k_d: Fraction = 0.0
    """Weight of the diffuse part; k_d + k_s <= 1."""
    k_s: Fraction = 1.0
    """Weight of the specular part; k_d + k_s <= 1."""
    reflectance: Fraction = 1.0
    """Albedo of the diffuse part."""
    normalisation: Normalisation = "microsurface"
    """Which of the forms in circulation; only the first two, the same numbers, agree with a traced surface."""

    order: ClassVar[str] = "1"
    """It speaks of light that was reflected once."""
    free: ClassVar[dict[str, tuple[float, float]]] = {"m": (0.005, 3.0)}
    """What a fit adjusts, and its bounds."""

    @model_validator(mode="after")
    def _weights(self) -> Self:
        # The rounding of 0.9 + 0.1 must not be an error.
        if self.k_d + self.k_s > 1.0 + 1e-12:
            raise ValueError(
                f"k_d + k_s = {self.k_d:g} + {self.k_s:g} must not exceed 1: lower one of them, or energy is created."
            )
        return self

    @model_validator(mode="after")
    def _one_roughness(self) -> Self:
        given = [name for name in ("m", "m_x", "m_y", "scales") if getattr(self, name) is not None]
        if given not in (["m"], ["m_x", "m_y"], ["scales"]):
            found = " and ".join(given) or "none of them"
            raise ValueError(f"roughness: give m, or m_x and m_y together, or scales; {found} was given.")
        total = math.fsum(weight for _, weight in self.scales or ((1.0, 1.0),))
        if abs(total - 1.0) > 1e-9:
            raise ValueError(f"the weights of scales sum to {total:g}: they must sum to 1")
        return self

    @classmethod
    def of(cls, statistics: Mapping[str, float | None], material: Material, surface: object = None) -> Self:
        """The model of a specimen: roughness that its `statistics` measured from the facets, and its material."""
        if isinstance(material, Lambertian):
            raise ValueError(f"CookTorrance describes specimens of mirror facets, and this one is {material!r}.")
        measured = Beckmann.of(statistics, surface)
        return cls(
            material=material,
            m=measured.alpha,
            m_x=measured.alpha_x,
            m_y=measured.alpha_y,
            rotation=measured.rotation,
        )

    @property
    def distribution(self) -> Beckmann | Mixture:
        """The distribution of its facets' normals."""
        if self.scales is not None:
            return Mixture(components=tuple((weight, Beckmann(alpha=m)) for m, weight in self.scales))
        return Beckmann(alpha=self.m, alpha_x=self.m_x, alpha_y=self.m_y, rotation=self.rotation)

    def eval(self, wi: ArrayLike, wo: ArrayLike, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """BRDF (..., W) in 1/sr, no cosine, of `wi` and `wo` (..., 3); 0 where a direction is not above the horizon."""
        value = specular(self.distribution, VCavity(), self.material, wi, wo, wavelengths)
        value *= self.k_s * NORMALISATIONS[self.normalisation]
        if self.k_d:
            value += self.k_d * Lambert(self.reflectance).eval(wi, wo, wavelengths)
        return value

    def average(self, wi: ArrayLike, detector: Detector, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """Bin averages (bins, W) in 1/sr for light from `wi` (3,), to about 1e-5 of a bin or of the mean."""
        return bin_average(self, lobe_detail(self.distribution), wi, detector, wavelengths)
