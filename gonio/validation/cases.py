"""The cases: laws of light on rough surfaces, by the surfaces that they are tested on."""

from __future__ import annotations

from gonio.validation import (
    albedos,
    cylinders,
    gaussian,
    multiple_hits,
    spherical_pits,
    unfolding,
    v_grooves,
)
from gonio.validation.judging import Case

CASES = (
    Case("V-grooves are Cook and Torrance's", v_grooves.beckmann_slopes),
    Case("other proportions and normalisations are not", v_grooves.other_forms),
    Case("V-grooves with GGX slopes", v_grooves.ggx_slopes),
    Case("one V-groove by unfolding", unfolding.one_groove),
    Case("mirror cylinders are Poulin and Fournier's", cylinders.mirrors),
    Case("diffuse cylinders are Poulin and Fournier's", cylinders.diffusers),
    Case("rough cylinders are Poulin and Fournier's", gaussian.rough_cylinders),
    Case("Gaussian height fields are Smith's", gaussian.height_fields),
    Case("albedos", albedos.single_scattering),
    Case("numbers of hits", multiple_hits.by_geometry),
    Case("spherical pits", spherical_pits.lambertian),
)
"""All cases, in the order they are run."""
