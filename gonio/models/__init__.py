"""Closed-form BRDF models. `Model` is every one of them; a new model is a new file and a new member of the union.

A model is a recipe with `eval(wi, wo, wavelengths)` (..., W), values in 1/sr without the cosine, and
`average(wi, detector, wavelengths)` (bins, W), the cos-weighted averages that a detector's bins would measure.
"""

import contextlib
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from gonio.models.ashikhmin_shirley import AshikhminShirley
from gonio.models.cook_torrance import CookTorrance
from gonio.models.distributions import GGX, Beckmann, Distribution, Mixture
from gonio.models.lambert import Lambert
from gonio.models.masking import Masking, SmithCorrelated, SmithSeparable, Unmasked, VCavity
from gonio.models.microfacet import Microfacet
from gonio.models.oren_nayar import OrenNayar
from gonio.models.poulin_fournier import PoulinFournier
from gonio.models.smith_multiple_scattering import SmithMultipleScattering
from gonio.models.ward import Ward
from gonio.optics import Material

Model = Annotated[
    Lambert
    | OrenNayar
    | CookTorrance
    | Microfacet
    | SmithMultipleScattering
    | PoulinFournier
    | Ward
    | AshikhminShirley,
    Field(discriminator="kind"),
]
"""Every model there is."""

__all__ = [
    "GGX",
    "AshikhminShirley",
    "Beckmann",
    "CookTorrance",
    "Distribution",
    "Lambert",
    "Masking",
    "Microfacet",
    "Mixture",
    "Model",
    "OrenNayar",
    "PoulinFournier",
    "SmithCorrelated",
    "SmithMultipleScattering",
    "SmithSeparable",
    "Unmasked",
    "VCavity",
    "Ward",
    "matching",
]

_FITTING = (Lambert, OrenNayar, PoulinFournier, CookTorrance, Microfacet)
"""The models that follow from a specimen's statistics, material and recipe, in the order they are shown."""


def matching(statistics: Mapping[str, float | None], material: Material, surface: object = None) -> tuple[Model, ...]:
    """The models that claim to describe a specimen of these statistics, material and (if known) surface recipe."""
    models: list[Model] = []
    for candidate in _FITTING:
        with contextlib.suppress(ValueError):
            models.append(candidate.of(statistics, material, surface))
    return tuple(models)
