"""The microfacet model of today: a distribution of normals, a masking and a material, each to be chosen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

from numpy.typing import ArrayLike

from gonio.detectors import Detector
from gonio.models.averages import bin_average
from gonio.models.distributions import Beckmann, Distribution
from gonio.models.facets import lobe_detail, specular
from gonio.models.masking import Masking, SmithCorrelated
from gonio.optics import Lambertian, Material, Specular
from microsurfaces.arrays import Floats
from microsurfaces.recipe import recipe


@recipe
class Microfacet:
    """Single scattering by mirror facets, composed of a distribution of normals, a masking and a material.

    Physics. Only facets whose normal is the half vector H reflect light from L = wi to V = wo. The distribution says
    how much area they have, the masking which share of it is both lit and visible, the material how much they reflect
    at the LOCAL angle of incidence. Light reflected twice or more is not in the model.

    Equation, with N the macroscopic normal:

        f = F(L.H) D(H) G2(L, V, H) / (4 (N.L) (N.V))

    With Beckmann's distribution and Smith's height-correlated masking it is the reference for Gaussian random height
    fields: with alpha measured from the facets, its albedo is within 2 % of a traced surface (0 to 60 degrees), most 5
    x 15 degree bins within 2 to 3 %. What remains is real: correlated heights hide less, a traced surface is brighter
    towards the source (by up to 70 % at 85 degrees), and darker in the forward grazing lobe by 5 to 20 %. Only for
    geometric optics: facets many wavelengths wide.

    A feel for the numbers: straight above, L = V = N, with F = 1 it is 1 / (4 pi alpha^2): 0.884 / sr at alpha = 0.3.
    With F = 1 the albedo at 0, 45, 75 degrees is 1.000, 0.967, 0.903 for alpha = 0.3 and 0.856, 0.833, 0.906 for 0.6;
    the rest is multiple scattering.

    Source: B. Walter, S. R. Marschner, H. Li, K. E. Torrance, Microfacet Models for Refraction through Rough Surfaces,
    EGSR 2007, doi:10.2312/EGWR/EGSR07/195-206, eq. 20; masking: E. Heitz, Understanding the Masking-Shadowing Function
    in Microfacet-Based BRDFs, Journal of Computer Graphics Techniques 3(2), 2014,
    http://jcgt.org/published/0003/02/03/.
    """

    distribution: Distribution
    """Distribution of the facets' normals: Beckmann, GGX or a Mixture of them."""
    masking: Masking
    """How facets hide one another: SmithCorrelated, SmithSeparable, VCavity or Unmasked."""
    material: Specular
    """What the facets are made of: Mirror, Conductor or Dielectric."""

    order: ClassVar[str] = "1"
    """It speaks of light that was reflected once."""
    free: ClassVar[dict[str, tuple[float, float]]] = {"distribution.alpha": (0.005, 3.0)}
    """What a fit adjusts, and its bounds."""

    @classmethod
    def of(cls, statistics: Mapping[str, float | None], material: Material, surface: object = None) -> Self:
        """Smith and Beckmann for a specimen: roughness that its `statistics` measured from the facets."""
        if isinstance(material, Lambertian):
            raise ValueError(f"Microfacet describes specimens of mirror facets, and this one is {material!r}.")
        return cls(distribution=Beckmann.of(statistics, surface), masking=SmithCorrelated(), material=material)

    def eval(self, wi: ArrayLike, wo: ArrayLike, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """BRDF (..., W) in 1/sr, no cosine, of `wi` and `wo` (..., 3); 0 where a direction is not above the horizon."""
        return specular(self.distribution, self.masking, self.material, wi, wo, wavelengths)

    def average(self, wi: ArrayLike, detector: Detector, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """Bin averages (bins, W) in 1/sr for light from `wi` (3,), to about 1e-5 of a bin or of the mean."""
        return bin_average(self, lobe_detail(self.distribution), wi, detector, wavelengths)
