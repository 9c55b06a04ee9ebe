"""Closed-form BRDF models. `Model` is every one of them; a new model is a new file and a new member of the union.

A model is a recipe with `eval(wi, wo, wavelengths)` (..., W), values in 1/sr without the cosine, and
`average(wi, detector, wavelengths)` (bins, W), the cos-weighted averages that a detector's bins would measure.
"""

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from gonio.models.cook_torrance import CookTorrance
from gonio.models.distributions import Beckmann, Distribution
from gonio.models.lambert import Lambert
from gonio.models.masking import Masking, SmithCorrelated
from gonio.models.microfacet import Microfacet
from gonio.optics import Lambertian, Material

Model = Annotated[Lambert | CookTorrance | Microfacet, Field(discriminator="kind")]
"""Every model there is."""

__all__ = [
    "Beckmann",
    "CookTorrance",
    "Distribution",
    "Lambert",
    "Masking",
    "Microfacet",
    "Model",
    "SmithCorrelated",
    "matching",
]


def matching(statistics: Mapping[str, float | None], material: Material) -> tuple[Model, ...]:
    """The models that claim to describe a specimen of these surface statistics and material; none for a flat mirror."""
    if isinstance(material, Lambertian):
        return (Lambert.of(statistics, material),)
    if not statistics.get("beckmann_alpha"):
        return ()
    return CookTorrance.of(statistics, material), Microfacet.of(statistics, material)
