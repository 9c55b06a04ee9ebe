"""Rough surfaces: recipes that build periodic height fields and meshes. Geometry only; knows nothing of light.

>>> relief = Gaussian(alpha=0.3, correlation_length=10.0, side=600.0, samples=256).build(seed=1)
>>> relief.statistics().beckmann_alpha
"""

from typing import Annotated

from pydantic import Field

from microsurfaces.files import HeightFieldFile, MeshFile, save_surface
from microsurfaces.height_field import HeightField
from microsurfaces.mesh import Facets, Mesh, Statistics
from microsurfaces.profiles import Cylinders, Flat, VGrooves
from microsurfaces.random_fields import Gaussian

Surface = Annotated[Flat | Gaussian | Cylinders | VGrooves | HeightFieldFile | MeshFile, Field(discriminator="kind")]
"""Any surface recipe; `kind`, the name of its class, says which."""

__all__ = [
    "Cylinders",
    "Facets",
    "Flat",
    "Gaussian",
    "HeightField",
    "HeightFieldFile",
    "Mesh",
    "MeshFile",
    "Statistics",
    "Surface",
    "VGrooves",
    "save_surface",
]
