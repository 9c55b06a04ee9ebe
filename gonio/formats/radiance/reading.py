"""Reading: the XML text, and the matrix or the tree in it as a function."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from gonio.brdf import BRDF, NOMINAL, Basis
from gonio.detectors import HemisphereGrid
from gonio.formats.radiance import klems, tensor_tree
from gonio.formats.radiance.colours import WHITE, xyz
from gonio.formats.text import numbers
from microsurfaces.arrays import Floats, Vectors

LARGEST = 100_000_000
"""Bytes of a file that is read; it takes up to ten times as many of memory."""

_MARKUP = 50_000
"""Most tags and attributes: real files have some hundred around their numbers."""


def read(path: Path) -> BRDF:
    """The reflection of a BSDF file: Y, or XYZ if the file has colours.

    Of the two sides it is the one that the normal points to (`Reflection Back`), or the other one if that is all there
    is, seen with the y axis up as before: turned about it by 180 degrees. Raises ValueError for anything else.
    """
    try:
        layer = _layer(path)
        structure = layer.findtext("{*}DataDefinition/{*}IncidentDataStructure", "").strip().lower()
        side, blocks = _reflection(layer)
        if structure in ("columns", "rows"):
            brdf = _matrix(blocks, _bases(layer), by_exiting=structure == "columns")
        elif structure in ("tensortree3", "tensortree4"):
            brdf = _tree(blocks, int(structure[-1]))
        else:
            raise ValueError(
                f"its data structure is {structure!r} instead of Columns, Rows, TensorTree3 or TensorTree4"
            )
    except ValueError as error:
        raise ValueError(f"{path}: not a BSDF file of Radiance or WINDOW, or damaged: {error}") from None
    title = layer.findtext("{*}Material/{*}Name", "").strip() or path.stem
    known = {"title": title, "origin": f"Radiance BSDF file {path.name}, {side}", "basis": brdf.basis}
    evaluate = brdf.evaluate
    mirror = np.array([1, 1, 1] if side == "reflection back" else [-1, 1, 1])
    return replace(
        brdf,
        evaluate=lambda wi, wo: evaluate(wi * mirror, wo * mirror),
        attributes={**known, "isotropic": int(brdf.isotropic)},
    )


def _layer(path: Path) -> ET.Element:
    """The layer of the file, which cannot be larger in memory than on the disc by more than a small factor."""
    if path.stat().st_size > LARGEST:
        raise ValueError(f"it has more than {LARGEST / 1e6:g} million bytes; prune it with rttree_reduce")
    content = path.read_bytes()
    if b"\0" in content or b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise ValueError("it has zero bytes or defines entities, which such files never do")
    if content.count(b"<") + content.count(b"=") > _MARKUP:
        raise ValueError(f"it has more than {_MARKUP} tags, too many for such a file")
    try:
        root = ET.fromstring(content)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise ValueError(f"no well-formed XML ({error})") from None
    layer = root.find("{*}Optical/{*}Layer")
    if layer is None:
        raise ValueError("it has no WindowElement/Optical/Layer")
    return layer


def _reflection(layer: ET.Element) -> tuple[str, dict[str, ET.Element]]:
    """Which side is read, and its data blocks by the lower-case name of the wavelength."""
    found: dict[str, dict[str, ET.Element]] = {}
    for data in layer.findall("{*}WavelengthData"):
        for block in data.findall("{*}WavelengthDataBlock"):
            side = block.findtext("{*}WavelengthDataDirection", "").strip().lower()
            found.setdefault(side, {})[data.findtext("{*}Wavelength", "").strip().lower()] = block
    for side in ("reflection back", "reflection front"):
        if "visible" in found.get(side, {}):
            return side, found[side]
    raise ValueError("it has no visible reflection")


def _bases(layer: ET.Element) -> dict[str, klems.AngleBasis]:
    """Angle bases by lower-case name: those that the file defines, and the known ones."""
    bases = {basis.name.lower(): basis for basis in klems.BASES.values()}
    for definition in layer.findall("{*}DataDefinition/{*}AngleBasis"):
        name = definition.findtext("{*}AngleBasisName", "").strip()
        rings = definition.findall("{*}AngleBasisBlock")
        try:
            counts = tuple(int(ring.findtext("{*}nPhis", "")) for ring in rings)
            upper = tuple(float(ring.findtext("{*}ThetaBounds/{*}UpperTheta", "")) for ring in rings)
        except ValueError:
            counts = upper = ()
        if not counts or not all(0 < n < 1000 for n in counts) or not (np.diff((0.0, *upper, 90.001)) > 0).all():
            raise ValueError(f"its angle basis {name!r} does not consist of ascending rings up to 90 degrees")
        bases[name.lower()] = klems.AngleBasis(name, (0.0, *upper), counts)
    return bases


def _matrix(blocks: Mapping[str, ET.Element], bases: Mapping[str, klems.AngleBasis], by_exiting: bool) -> BRDF:
    """A matrix as a function: constant in pairs of patches."""
    names = [name for name in ("cie-x", "visible", "cie-z") if name in blocks]
    parts = {name: _one_matrix(blocks[name], bases, by_exiting) for name in names}
    table, incident, exiting = parts["visible"]
    basis: Basis = "Y"
    if len(parts) == 3 and all(part[1:] == (incident, exiting) for part in parts.values()):
        table, basis = np.concatenate([part[0] for part in parts.values()], axis=-1) * WHITE, "XYZ"
    return BRDF(
        evaluate=lambda wi, wo: klems.value(table, incident, exiting, wi, wo),
        wavelengths=np.array(NOMINAL[basis]),
        theta_i=incident.theta,
        phi_i=np.arange(0.0, 360.0, 15.0),
        isotropic=False,
        basis=basis,
        detector=HemisphereGrid(theta_step=5.0, phi_step=15.0),
    )


def _one_matrix(
    block: ET.Element, bases: Mapping[str, klems.AngleBasis], by_exiting: bool
) -> tuple[Floats, klems.AngleBasis, klems.AngleBasis]:
    """Numbers (exiting, incident, 1), and the bases of incident and exiting light."""
    names = [block.findtext(f"{{*}}{axis}AngleBasis", "").strip() for axis in ("Column", "Row")]
    for name in names:
        if name.lower() not in bases:
            raise ValueError(f"its angle basis {name!r} is not one of {', '.join(b.name for b in bases.values())}")
    incident, exiting = (bases[name.lower()] for name in names)
    values = np.maximum(numbers(block.findtext("{*}ScatteringData", "")), 0.0)
    if values.size != incident.patches * exiting.patches:
        raise ValueError(f"a matrix has {values.size} numbers instead of {exiting.patches} times {incident.patches}")
    shape = (exiting.patches, incident.patches) if by_exiting else (incident.patches, exiting.patches)
    table = values.reshape(shape)
    return (table if by_exiting else table.T)[..., None], incident, exiting


def _tree(blocks: Mapping[str, ET.Element], rank: int) -> BRDF:
    """A tensor tree as a function: constant in its cells."""
    trees = {
        name: tensor_tree.parse(blocks[name].findtext("{*}ScatteringData", ""), rank)
        for name in ("visible", "cie-u", "cie-v")
        if name in blocks
    }
    basis: Basis = "XYZ" if len(trees) == 3 else "Y"

    def evaluate(wi: Vectors, wo: Vectors) -> Floats:
        place = tensor_tree.place(rank, wi, wo)
        found = [tree(place) for tree in trees.values()]
        return xyz(*found) if basis == "XYZ" else found[0][:, None]

    return BRDF(
        evaluate=evaluate,
        theta_i=np.arange(0.0, 90.0, 5.0),
        phi_i=np.arange(0.0, 360.0, 15.0) if rank == 4 else np.zeros(1),
        isotropic=rank == 3,
        wavelengths=np.array(NOMINAL[basis]),
        basis=basis,
        detector=HemisphereGrid(theta_step=3.0, phi_step=5.0),
    )
