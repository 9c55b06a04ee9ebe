"""Cook and Torrance's model: mirror facets paired into V-grooves, over a diffuse floor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import model_validator

from gonio.detectors import Detector
from gonio.models.averages import bin_average
from gonio.models.distributions import Beckmann
from gonio.models.facets import lobe_detail, specular
from gonio.models.lambert import Lambert
from gonio.models.masking import v_cavity
from gonio.optics import Specular
from microsurfaces.recipe import Fraction, Positive, recipe

Array = NDArray[np.float64]


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

    Normalisation. This is the one form that agrees with a traced surface: D (N.m) integrates to 1, and the 4 is the
    Jacobian of a mirror. Written as 1/pi F E G / ((N.L)(N.V)) with E = exp(-tan^2 a / m^2) / (4 m^2 cos^4 a), as in
    many textbooks, it is the same number; other pairs of prefactor and D in circulation are off by factors of 1/2 to
    4.

    Validity. Exact for single scattering by an ensemble of long symmetric V-grooves of equal width and coplanar upper
    edges, at every azimuth. For Gaussian height fields `Microfacet` with Smith's masking is better: there G = min
    leaves the albedo 6 to 8 % too low near normal incidence (m = 0.5 to 0.8) and misplaces the lobe at grazing
    incidence. Only for geometric optics: facets many wavelengths wide.

    A feel for the numbers: straight above, L = V = N, with F = 1 it is 1 / (4 pi m^2): 0.884 / sr at m = 0.3. The lobe
    of a mirror direction is about 2 m radians wide. With F = 1 the albedo at 0, 45, 75 degrees is 0.996, 0.957, 0.927
    for m = 0.3 and 0.798, 0.826, 0.933 for m = 0.6; the rest would be multiple scattering.

    Source: R. L. Cook, K. E. Torrance, A Reflectance Model for Computer Graphics, ACM Transactions on Graphics 1(1),
    1982, doi:10.1145/357290.357293.
    """

    m: Positive
    """Roughness: root mean square of the length of the facets' slope (Beckmann's alpha), 0.01 to 1 as a rule."""
    material: Specular
    """What the facets are made of: Mirror, Conductor or Dielectric."""
    k_d: Fraction = 0.0
    """Weight of the diffuse part; k_d + k_s <= 1."""
    k_s: Fraction = 1.0
    """Weight of the specular part; k_d + k_s <= 1."""
    reflectance: Fraction = 1.0
    """Albedo of the diffuse part."""

    @model_validator(mode="after")
    def _weights(self) -> Self:
        # The rounding of 0.9 + 0.1 must not be an error.
        if self.k_d + self.k_s > 1.0 + 1e-12:
            raise ValueError(
                f"k_d + k_s = {self.k_d:g} + {self.k_s:g} must not exceed 1: lower one of them, or energy is created."
            )
        return self

    @classmethod
    def of(cls, statistics: Mapping[str, float | None], material: Specular) -> Self:
        """The model of a specimen: m is the Beckmann alpha that its `statistics` measured from the facets."""
        return cls(m=Beckmann.of(statistics).alpha, material=material)

    def eval(self, wi: ArrayLike, wo: ArrayLike, wavelengths: ArrayLike = (550.0,)) -> Array:
        """BRDF (..., W) in 1/sr, no cosine, of `wi` and `wo` (..., 3); 0 where a direction is not above the horizon."""
        lobe = specular(Beckmann(self.m), v_cavity, self.material, wi, wo, wavelengths)
        return self.k_d * Lambert(self.reflectance).eval(wi, wo, wavelengths) + self.k_s * lobe

    def average(self, wi: ArrayLike, detector: Detector, wavelengths: ArrayLike = (550.0,)) -> Array:
        """Bin averages (bins, W) in 1/sr for light from `wi` (3,), to about 1e-5 of a bin or of the mean."""
        return bin_average(self, lobe_detail(self.m), wi, detector, wavelengths)
