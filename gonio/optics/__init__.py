"""Optics of smooth interfaces: Fresnel's equations, refractive indices, and the materials a surface is made of.

Refractive indices are `eta + i k` with k >= 0, relative to the medium the light is in. Reflectances are power ratios of
s- and p-polarised light; what has no polarisation in its name is their mean, the reflectance for unpolarised light.
"""

from gonio.optics.fresnel import (
    fresnel,
    fresnel_conductor,
    fresnel_dielectric,
    fresnel_table,
    fresnel_transmittance,
)
from gonio.optics.materials import Conductor, Dielectric, Lambertian, Material, Mirror, Specular
from gonio.optics.refractive_index import CONDUCTORS, DIELECTRICS, citation, index_table, tabulated_materials

__all__ = [
    "CONDUCTORS",
    "DIELECTRICS",
    "Conductor",
    "Dielectric",
    "Lambertian",
    "Material",
    "Mirror",
    "Specular",
    "citation",
    "fresnel",
    "fresnel_conductor",
    "fresnel_dielectric",
    "fresnel_table",
    "fresnel_transmittance",
    "index_table",
    "tabulated_materials",
]
