"""The ideal diffuser."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from gonio.detectors import Detector
from gonio.models.facets import above
from gonio.optics import Lambertian, Material
from microsurfaces.arrays import Floats
from microsurfaces.recipe import Fraction, recipe


@recipe
class Lambert:
    """The ideal diffuser: equally bright from everywhere.

    f = reflectance / pi in 1/sr, for every pair of directions above the horizon; its albedo is `reflectance` at any
    incidence. A FLAT Lambertian surface follows it exactly. A rough one does not: its facets shade each other, single
    scattering falls short of it, most of all at grazing angles, and what remains leans back towards the source (Oren
    and Nayar 1994, doi:10.1145/192161.192213).

    A feel for the numbers: matt white paint 0.9 (f = 0.29 / sr), grey card 0.18 (0.057 / sr), asphalt 0.07.

    Source: J. H. Lambert, Photometria (1760).
    """

    reflectance: Fraction = 0.8
    """Reflected share of the incident power (albedo), 0 to 1, the same at every wavelength."""

    order: ClassVar[str] = "1"
    """It speaks of light that was reflected once."""
    free: ClassVar[dict[str, tuple[float, float]]] = {"reflectance": (0.0, 1.0)}
    """What a fit adjusts, and its bounds."""

    @classmethod
    def of(cls, statistics: Mapping[str, float | None], material: Material, surface: object = None) -> Lambert:
        """The diffuser of a specimen's Lambertian `material`; any other material is a ValueError. Relief is ignored."""
        if not isinstance(material, Lambertian):
            raise ValueError(
                f"Lambert describes Lambertian specimens, and this one is {material!r}: use a microfacet model."
            )
        return cls(reflectance=material.reflectance)

    def eval(self, wi: ArrayLike, wo: ArrayLike, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """BRDF (..., W) in 1/sr, no cosine, of `wi` and `wo` (..., 3); 0 where a direction is not above the horizon."""
        value = np.where(above(wi, wo), self.reflectance / np.pi, 0.0)
        return np.repeat(value[..., None], np.size(wavelengths), axis=-1)

    def average(self, wi: ArrayLike, detector: Detector, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """Bin averages (bins, W) in 1/sr for light from `wi` (3,): exact."""
        value = self.reflectance / np.pi if np.asarray(wi)[2] > 0.0 else 0.0
        return np.full((detector.bins, np.size(wavelengths)), value)
