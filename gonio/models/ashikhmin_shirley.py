"""Ashikhmin and Shirley's model: an anisotropic Phong lobe on a diffuser that yields to it at grazing incidence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from gonio.detectors import Detector
from gonio.models.averages import bin_average
from gonio.models.distributions import Beckmann
from gonio.models.facets import above, lobe_detail
from gonio.optics import Material
from gonio.sphere import rotate_z
from microsurfaces.arrays import Floats, Vectors
from microsurfaces.recipe import Fraction, NonNegative, recipe


@recipe
class AshikhminShirley:
    """Ashikhmin and Shirley's empirical model (2000): a Phong lobe of two exponents, Schlick's Fresnel, a diffuser.

    Physics. None is claimed but what every surface must do: the model is reciprocal, reflects no more than there is,
    shines more the more the light grazes, and lets the diffuse part, light that went into the material and came out
    again, fade as the specular part takes the light away.

    Equation, with h the half vector, in the model's own axes, and H = wi . h:

        f = 28 reflectance (1 - specular) / (23 pi) (1 - (1 - cos theta_i / 2)^5) (1 - (1 - cos theta_o / 2)^5)
          + sqrt((n_u + 1) (n_v + 1)) / (8 pi) h_z^e F / (H max(cos theta_i, cos theta_o))
        e = (n_u h_x^2 + n_v h_y^2) / (1 - h_z^2),   F = specular + (1 - specular) (1 - H)^5

    Validity. An empirical description of everything that is reflected, to be fitted. The diffuse part's albedo is
    reflectance (1 - specular) (1 - (1 - cos theta_i / 2)^5), 0.97 of what the name says under normal light. The lobe
    of an ideal mirror (specular = 1) keeps all light only in the limit of large exponents: its albedo under normal
    light is 0.96, 0.70, 0.25 for n = 100, 10, 1, and 0.5 for every n where the light grazes.

    A feel for the numbers: n = 10 is satin, 100 glossy, 10,000 nearly a mirror; the lobe is as wide as Beckmann's of
    alpha = sqrt(2 / (n + 2)). specular is 0.04 for glass and plastics, 0.5 to 0.98 for metals.

    Source: M. Ashikhmin, P. Shirley, An Anisotropic Phong BRDF Model, Journal of Graphics Tools 5(2), 2000,
    doi:10.1080/10867651.2000.10487522.
    """

    n: NonNegative | None = None
    """Exponent of an isotropic lobe, 1 to 100,000 as a rule."""
    n_u: NonNegative | None = None
    """Exponent along the model's own x axis; goes with n_v, and without n."""
    n_v: NonNegative | None = None
    """Exponent along its own y axis."""
    rotation: float = 0.0
    """Angle from x to the model's own x axis, degrees, counter-clockwise."""
    specular: Fraction = 0.04
    """Fresnel reflectance of the lobe at normal incidence."""
    reflectance: Fraction = 0.0
    """Albedo of the diffuse part, before the specular part takes its share."""

    order: ClassVar[str] = "all"
    """It speaks of all the light: what is fitted to a measurement knows no number of reflections."""
    free: ClassVar[dict[str, tuple[float, float]]] = {
        "n": (1.0, 1e5),
        "specular": (0.0, 1.0),
        "reflectance": (0.0, 1.0),
    }
    """What a fit adjusts, and its bounds."""

    @model_validator(mode="after")
    def _one_width(self) -> Self:
        given = [name for name in ("n", "n_u", "n_v") if getattr(self, name) is not None]
        if given not in (["n"], ["n_u", "n_v"]):
            found = " and ".join(given) or "none of them"
            raise ValueError(f"exponents: give n, or n_u and n_v together; {found} was given.")
        return self

    @classmethod
    def of(cls, statistics: Mapping[str, float | None], material: Material, surface: object = None) -> Self:
        """Always a ValueError: no specimen determines an empirical model."""
        raise ValueError("AshikhminShirley is empirical: its parameters do not follow from the surface; fit it.")

    def eval(self, wi: ArrayLike, wo: ArrayLike, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """BRDF (..., W) in 1/sr, no cosine, of `wi` and `wo` (..., 3); 0 where a direction is not above the horizon."""
        lit = above(wi, wo)
        # Straight above stands in for directions that do not count, so that nothing divides by 0.
        wi, wo = (np.where(lit[..., None], np.asarray(w, np.float64), [0.0, 0.0, 1.0]) for w in (wi, wo))
        value = self._lobe(wi, wo) + self._diffuse(wi[..., 2]) * self._diffuse(wo[..., 2])
        return np.repeat(np.where(lit, value, 0.0)[..., None], np.size(wavelengths), axis=-1)

    def average(self, wi: ArrayLike, detector: Detector, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """Bin averages (bins, W) in 1/sr for light from `wi` (3,), to about 1e-5 of a bin or of the mean."""
        n_u, n_v = self._exponents()
        as_wide = Beckmann(
            alpha_x=math.sqrt(2.0 / (n_u + 2.0)), alpha_y=math.sqrt(2.0 / (n_v + 2.0)), rotation=self.rotation
        )
        return bin_average(self, lobe_detail(as_wide), wi, detector, wavelengths)

    def _exponents(self) -> tuple[float, float]:
        """Exponents along both of the model's own axes."""
        n_u, n_v = (self.n if value is None else value for value in (self.n_u, self.n_v))
        return n_u or 0.0, n_v or 0.0

    def _lobe(self, wi: Vectors, wo: Vectors) -> Floats:
        """The specular part (...)."""
        n_u, n_v = self._exponents()
        h = rotate_z(wi + wo, -self.rotation)
        # |wi + wo| = 2 wi . h: no cancellation at grazing, where the scalar product has some.
        cosine = np.minimum(np.linalg.norm(h, axis=-1) / 2.0, 1.0)
        x2, y2 = (h[..., 0] / h[..., 2]) ** 2, (h[..., 1] / h[..., 2]) ** 2
        t = x2 + y2
        # ln cos = -ln(1 + tan^2) / 2, and its share of the exponents, without losing narrow lobes to rounding.
        falloff = np.divide(np.log1p(t), t, out=np.ones_like(t), where=t > 0.0)
        power = np.exp(-0.5 * (n_u * x2 + n_v * y2) * falloff)
        fresnel = self.specular + (1.0 - self.specular) * (1.0 - cosine) ** 5
        height = math.sqrt((n_u + 1.0) * (n_v + 1.0)) / (8.0 * np.pi)
        return np.asarray(height * power * fresnel / (cosine * np.maximum(wi[..., 2], wo[..., 2])))

    def _diffuse(self, cosine: Floats) -> Floats:
        """The root of the diffuse part (...) at one direction's cosine; that of the other is the second factor."""
        scale = 28.0 * self.reflectance * (1.0 - self.specular) / (23.0 * np.pi)
        return np.asarray(math.sqrt(scale) * (1.0 - (1.0 - cosine / 2.0) ** 5))
