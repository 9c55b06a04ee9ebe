"""Oren and Nayar's model: diffuse facets paired into V-grooves of every direction."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from gonio.detectors import Detector
from gonio.models.averages import bin_average
from gonio.models.facets import above
from gonio.optics import Lambertian, Material
from gonio.sphere import as_directions
from microsurfaces.arrays import Floats, Vectors
from microsurfaces.recipe import Fraction, recipe


@recipe
class OrenNayar:
    """Oren and Nayar's model of rough diffusers (1994): plaster, clay, sand, the moon.

    Physics. The surface is made of V-grooves in every direction whose facets are ideal diffusers. Facets that face the
    source are bright, and towards the source one sees more of them and fewer of those they shade: the surface is
    brighter there than Lambert's law says, and darker on the far side. Each groove's upper edges lie in one plane, its
    facets hide each other as in Torrance and Sparrow's model, and light goes from facet to facet in the same groove.

    Equation, with a the larger and b the smaller of the angles theta_i and theta_o, c the cosine of the difference of
    their azimuths, s = sigma^2 in radians and r the reflectance:

        f = f1 + f2
        f1 = r / pi (C1 + c C2 tan b + (1 - |c|) C3 tan((a + b) / 2))
        f2 = 0.17 r^2 / pi s / (s + 0.13) (1 - c (2 b / pi)^2)
        C1 = 1 - 0.5 s / (s + 0.33)
        C2 = 0.45 s / (s + 0.09) sin a, but (sin a - (2 b / pi)^3) in place of sin a where c < 0
        C3 = 0.125 s / (s + 0.09) (4 a b / pi^2)^2

    f1 is light that was reflected once, f2 the second reflection in the same groove. `form` takes

        "full"         f1 + f2, to be compared with all light
        "single"       f1, to be compared with light that was reflected once
        "qualitative"  r / pi (C1 + 0.45 s / (s + 0.09) max(0, c) sin a tan b), a sketch of f1 that most renderers use

    Where grazing light leaves forward and sigma exceeds 38 degrees, f1 would be below 0; here it is 0 there.

    Validity. Simple functions fitted to integrals over grooves of normally distributed tilts. Up to 75 degrees f1 is
    within 0.04 r / pi of those integrals, root mean square, at any sigma to 60 degrees, and 0.19 r / pi at worst, the
    qualitative form 0.55 r / pi; closer to grazing both are sketches. Energy is created at grazing incidence: 5 % at
    most by the full form (r = 1, sigma = 17 degrees), nothing for r below 0.95. What is reflected three times is
    missing. A traced Gaussian surface of alpha = 0.7 and r = 0.8 (sigma = 26 degrees) returns, at 0, 40, 75 degrees of
    incidence, 0.673, 0.673, 0.680 after one reflection and 0.769, 0.769, 0.771 in all; the model has 0.646, 0.652,
    0.694 and 0.713, 0.719, 0.761. Its lobes of light reflected once differ by 4 to 8 %, Lambert's by 16 to 31 %.

    A feel for the numbers: straight above, f1 is 0.87, 0.77, 0.65 r / pi for sigma = 20, 30, 50 degrees. Sand-blasted
    plaster is near 20, sand and the moon 30 to 40 degrees.

    Source: M. Oren, S. K. Nayar, Generalization of Lambert's Reflectance Model, SIGGRAPH 1994,
    doi:10.1145/192161.192213; M. Oren, S. K. Nayar, Generalization of the Lambertian Model and Implications for Machine
    Vision, International Journal of Computer Vision 14, 1995, doi:10.1007/BF01679684.
    """

    sigma: Annotated[float, Field(ge=0, le=90)]
    """Roughness: standard deviation of the facets' tilt along one axis, degrees, 0 (Lambert's law) to 60 as a rule."""
    reflectance: Fraction = 0.8
    """Albedo of the facets, 0 to 1, the same at every wavelength."""
    form: Literal["full", "single", "qualitative"] = "full"
    """Both terms, the first alone, or the rough sketch of the first."""

    free: ClassVar[dict[str, tuple[float, float]]] = {"sigma": (0.0, 60.0), "reflectance": (0.0, 1.0)}
    """What a fit adjusts, and its bounds."""

    @property
    def order(self) -> str:
        """All light if the second reflection is included, else light that was reflected once."""
        return "all" if self.form == "full" else "1"

    @classmethod
    def of(cls, statistics: Mapping[str, float | None], material: Material, surface: object = None) -> Self:
        """The model of a rough Lambertian specimen, taken as isotropic; sigma is the tilt of the rms slope of an axis.

        Slopes that are normal deviates are no normal tilts, but close: with this sigma, f1 misses the integrals over
        Gaussian slopes by at most 0.02 r / pi, root mean square (alpha up to 1), more than with the best one.
        """
        if not isinstance(material, Lambertian):
            raise ValueError(f"OrenNayar describes Lambertian specimens, and this one is {material!r}.")
        alpha = statistics.get("beckmann_alpha")
        if not alpha:
            raise ValueError(
                f"beckmann_alpha = {alpha} must be above 0 for OrenNayar: this surface is flat (use Lambert), or its "
                "statistics were not measured."
            )
        return cls(sigma=math.degrees(math.atan(alpha / math.sqrt(2.0))), reflectance=material.reflectance)

    def eval(self, wi: ArrayLike, wo: ArrayLike, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """BRDF (..., W) in 1/sr, no cosine, of `wi` and `wo` (..., 3); 0 where a direction is not above the horizon."""
        wi, wo = as_directions(wi, "wi"), as_directions(wo, "wo")
        theta_i, theta_o = _theta(wi), _theta(wo)
        a, b = np.maximum(theta_i, theta_o), np.minimum(theta_i, theta_o)
        value = self._values(a, b, _cosine_of_azimuths(wi, wo))
        return np.repeat(np.where(above(wi, wo), value, 0.0)[..., None], np.size(wavelengths), axis=-1)

    def average(self, wi: ArrayLike, detector: Detector, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """Bin averages (bins, W) in 1/sr for light from `wi` (3,), to about 1e-5 of a bin or of the mean."""
        return bin_average(self, _nothing_but_kinks, wi, detector, wavelengths)

    def _values(self, a: Floats, b: Floats, c: Floats) -> Floats:
        """BRDF (...) of the larger and the smaller polar angle, radians, and the cosine between the azimuths."""
        s, r = math.radians(self.sigma) ** 2, self.reflectance
        c1, steep = 1.0 - 0.5 * s / (s + 0.33), s / (s + 0.09)
        if self.form == "qualitative":
            return np.asarray(r / np.pi * (c1 + 0.45 * steep * np.maximum(c, 0.0) * np.sin(a) * np.tan(b)))
        c2 = 0.45 * steep * (np.sin(a) - np.where(c < 0.0, (2.0 * b / np.pi) ** 3, 0.0))
        c3 = 0.125 * steep * (4.0 * a * b / np.pi**2) ** 2
        first = c1 + c * c2 * np.tan(b) + (1.0 - np.abs(c)) * c3 * np.tan((a + b) / 2.0)
        value = r / np.pi * np.maximum(first, 0.0)
        if self.form == "full":
            value += 0.17 * r * r / np.pi * s / (s + 0.13) * (1.0 - c * (2.0 * b / np.pi) ** 2)
        return np.asarray(value)


def _theta(w: Vectors) -> Floats:
    """Polar angles (...) in radians, accurate near the normal."""
    return np.asarray(np.arctan2(np.hypot(w[..., 0], w[..., 1]), w[..., 2]))


def _cosine_of_azimuths(wi: Vectors, wo: Vectors) -> Floats:
    """Cosine of phi_o - phi_i (...); 0 where one direction is the normal, and it does not matter."""
    product = np.hypot(wi[..., 0], wi[..., 1]) * np.hypot(wo[..., 0], wo[..., 1])
    inner = wi[..., 0] * wo[..., 0] + wi[..., 1] * wo[..., 1]
    cosine = np.divide(inner, product, out=np.zeros(np.shape(product)), where=product > 0.0)
    return np.asarray(np.clip(cosine, -1.0, 1.0))


def _nothing_but_kinks(wi: Vectors, wo: Vectors, radius: Floats) -> Floats:
    """The finest detail of the model: none, where light comes back straight or sideways it has kinks."""
    return np.full(len(wo), np.inf)
