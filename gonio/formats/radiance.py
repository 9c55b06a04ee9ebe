"""Radiance and WINDOW: BSDFs as XML, Klems matrices or tensor trees.

Opens in Radiance (rtrace, rpict, rcontrib ...), pyradiance, Ladybug and Honeybee, accelerad; matrices in WINDOW too.

A `WindowElement` holds one `Layer`; its `WavelengthData` elements hold the numbers, f_r in 1/sr without cosine, as
text. `Visible` is the luminance Y under D65. Colours are two more: `CIE-X` and `CIE-Z` of a matrix, the chromaticities
`CIE-u` and `CIE-v` (u' and v' of 1976) of a tree. White is that of equal energy, as everywhere in Radiance: X, Y and Z
of a neutral surface are equal, ours are scaled to that. Light from above, on the side that the normal +z points to, is
`Reflection Back` in these files and Radiance's front; `Reflection Front` is the other side. `klems` and `tensor_tree`
say how the numbers are ordered and which way their azimuths run. Radiance's rings of the half and quarter bases have
changed over the years: a file defines those that it means, and read here are those, but Radiance goes by the name.

What is lost: a matrix holds means over patches of 10 to 15 degrees (up to 45 in the quarter basis), a tree as written
here means over 64 (rank 3) or 32 (rank 4) cells across the hemisphere, and both are constant within them. Radiance adds
a ripple of 3e-4 to values that it reads and takes their minimum for a Lambertian part, which is left out here. Its
`rttree_reduce` prunes such trees; any tree can be read.

G. Ward, M. Kurt, N. Bonneel, "A Practical Framework for Sharing and Rendering Real-World Bidirectional Scattering
Distribution Functions", LBNL-5954E (2012); J. H. Klems, "A New Method for Predicting the Solar Heat Gain of Complex
Fenestration Systems", ASHRAE Transactions 100(1), 1065-1072 (1994).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import escape

import numpy as np

from gonio.brdf import BRDF, NOMINAL, Basis
from gonio.colour import xyz_of_rgb
from gonio.detectors import HemisphereGrid
from gonio.formats import klems, tensor_tree
from gonio.formats.text import numbers
from microsurfaces.arrays import Floats, Vectors
from microsurfaces.atomic_write import atomic_write

Variant = Literal["klems-full", "klems-half", "klems-quarter", "tensor3", "tensor4"]
"""A matrix over 145, 77 or 41 patches, or a tensor tree for isotropic or for any BRDFs."""

LARGEST = 100_000_000
"""Bytes of a file that is read; it takes up to ten times as many of memory."""

_MARKUP = 50_000
"""Most tags and attributes: real files have some hundred around their numbers."""

WHITE = xyz_of_rgb().sum(axis=1)
"""X, Y and Z of a neutral surface with Y = 1 here; all 1 in the files of Radiance."""


def write(lobes: BRDF, path: Path, basis: Variant = "klems-full") -> Sequence[str]:
    """Write `lobes` as `Reflection Back`, in colour if they have more than one channel.

    Values are means over incident and exiting patch or cell. Raises ValueError for a rank 3 tree if the azimuth of the
    light matters.
    """
    lobes = lobes.in_basis("Y" if len(lobes.wavelengths) == 1 else "XYZ")
    if basis in klems.BASES:
        frame, values = _matrix_frame(klems.BASES[basis]), klems.matrix(lobes, klems.BASES[basis])
    else:
        frame, values = _tree_frame(basis), tensor_tree.grid(lobes, _rank(lobes, basis))
    notes = _notes(lobes, values)
    values = np.maximum(np.nan_to_num(values), 0.0)
    if basis == "tensor3" and values.shape[-1] == 3 and _has_floor(values[..., 1]):
        values = values[..., 1:2]
        notes.append(
            "only the luminance was written: Radiance loses the colours of rank 3 trees that are nowhere black; write "
            'rank 4 ("tensor4") or a matrix to keep them'
        )
    components = _components(values, chromaticities=basis not in klems.BASES)
    with atomic_write(path) as scratch:
        scratch.write_text(_document(lobes.title, frame, components), encoding="utf-8")
    return notes


def _has_floor(luminance: Floats) -> bool:
    """Whether Radiance splits off a Lambertian part of a rank 3 tree, whose colours it then takes from empty cells."""
    used = luminance[: len(luminance) // 2]
    return bool(used.min() > 0.01 / np.pi)


def _rank(lobes: BRDF, basis: Variant) -> int:
    """Dimensions of the tree."""
    if basis == "tensor3" and not lobes.isotropic:
        raise ValueError(
            "a tensor tree of rank 3 holds isotropic BRDFs only, and this one depends on the azimuth of the light: "
            'write rank 4 ("tensor4") or a matrix ("klems-full")'
        )
    return 3 if basis == "tensor3" else 4


def _components(values: Floats, chromaticities: bool) -> dict[str, Floats]:
    """What the file holds of Y or XYZ values (..., channels), by the names of its wavelengths."""
    if values.shape[-1] == 1:
        return {"Visible": values[..., 0]}
    x, y, z = np.moveaxis(values / WHITE, -1, 0)
    if not chromaticities:
        return {"Visible": y, "CIE-X": x, "CIE-Z": z}
    total = x + 15 * y + 3 * z
    lit = total > 0
    total = np.where(lit, total, 1.0)
    return {"Visible": y, "CIE-u": np.where(lit, 4 * x / total, 4 / 19), "CIE-v": np.where(lit, 9 * y / total, 9 / 19)}


def _matrix_frame(basis: klems.AngleBasis) -> tuple[str, str, str]:
    """Data structure, definition of the angle basis, and what each block says of it."""
    rings = "".join(
        f"""
<AngleBasisBlock><Theta>{theta:g}</Theta><nPhis>{count}</nPhis>
<ThetaBounds><LowerTheta>{low:g}</LowerTheta><UpperTheta>{high:g}</UpperTheta></ThetaBounds></AngleBasisBlock>"""
        for theta, count, low, high in zip(basis.theta, basis.counts, basis.edges[:-1], basis.edges[1:], strict=True)
    )
    definition = f"\n<AngleBasis><AngleBasisName>{basis.name}</AngleBasisName>{rings}\n</AngleBasis>"
    named = f"<ColumnAngleBasis>{basis.name}</ColumnAngleBasis><RowAngleBasis>{basis.name}</RowAngleBasis>"
    return "Columns", definition, named


def _tree_frame(basis: Variant) -> tuple[str, str, str]:
    """As `_matrix_frame`."""
    return f"TensorTree{basis[-1]}", "", "<AngleBasis>LBNL/Shirley-Chiu</AngleBasis>"


def _document(title: str, frame: tuple[str, str, str], components: Mapping[str, Floats]) -> str:
    """The whole file."""
    structure, definition, basis = frame
    name = escape("".join(letter for letter in title if letter.isprintable()))
    data = "".join(
        f"""
<WavelengthData><LayerNumber>System</LayerNumber><Wavelength unit="Integral">{wavelength}</Wavelength>
<SourceSpectrum>CIE Illuminant D65 1nm.ssp</SourceSpectrum><DetectorSpectrum>ASTM E308 1931 Y.dsp</DetectorSpectrum>
<WavelengthDataBlock><WavelengthDataDirection>Reflection Back</WavelengthDataDirection>
{basis}<ScatteringDataType>BRDF</ScatteringDataType><ScatteringData>
{_text(values, tree=structure.startswith("Tensor"))}
</ScatteringData></WavelengthDataBlock></WavelengthData>"""
        for wavelength, values in components.items()
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<WindowElement xmlns="http://windows.lbl.gov" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:schemaLocation="http://windows.lbl.gov/BSDF-v1.4.xsd">
<WindowElementType>System</WindowElementType><FileType>BSDF</FileType><Optical><Layer>
<Material><Name>{name}</Name><Manufacturer>gonio</Manufacturer><DeviceType>Other</DeviceType>
<Thickness unit="meter">0.001</Thickness></Material>
<DataDefinition><IncidentDataStructure>{structure}</IncidentDataStructure>{definition}</DataDefinition>{data}
</Layer></Optical></WindowElement>
"""


def _text(values: Floats, tree: bool) -> str:
    """The numbers, a row of the last dimension in a line; for a tree one grid, which is its root."""
    rows = values.reshape(-1, values.shape[-1])
    line = " ".join(["%.5g" if tree else "%.6g"] * rows.shape[1])
    text = "\n".join(line % tuple(row) for row in rows.tolist())
    return f"{{\n{text}\n}}" if tree else text


def _notes(lobes: BRDF, values: Floats) -> list[str]:
    """What had to be bent; `values` (..., channels) are NaN where nothing is known."""
    notes = []
    if lobes.theta_i[-1] < 80:
        notes.append(
            f"incidences beyond {lobes.theta_i[-1]:g} degrees are not known: the nearest known incidence stands"
        )
    unknown = np.isnan(values).any(axis=-1).mean()
    if unknown:
        notes.append(f"of {unknown:.2%} of the pairs of directions nothing is known: they are 0")
    return notes


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
            lobes = _matrix(blocks, _bases(layer), by_exiting=structure == "columns")
        elif structure in ("tensortree3", "tensortree4"):
            lobes = _tree(blocks, int(structure[-1]))
        else:
            raise ValueError(
                f"its data structure is {structure!r} instead of Columns, Rows, TensorTree3 or TensorTree4"
            )
    except ValueError as error:
        raise ValueError(f"{path}: not a BSDF file of Radiance or WINDOW, or damaged: {error}") from None
    title = layer.findtext("{*}Material/{*}Name", "").strip() or path.stem
    known = {"title": title, "origin": f"Radiance BSDF file {path.name}, {side}", "basis": lobes.basis}
    evaluate = lobes.evaluate
    mirror = np.array([1, 1, 1] if side == "reflection back" else [-1, 1, 1])
    return replace(
        lobes,
        evaluate=lambda wi, wo: evaluate(wi * mirror, wo * mirror),
        attributes={**known, "isotropic": int(lobes.isotropic)},
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
        return _xyz(*found) if basis == "XYZ" else found[0][:, None]

    return BRDF(
        evaluate=evaluate,
        theta_i=np.arange(0.0, 90.0, 5.0),
        phi_i=np.arange(0.0, 360.0, 15.0) if rank == 4 else np.zeros(1),
        isotropic=rank == 3,
        wavelengths=np.array(NOMINAL[basis]),
        basis=basis,
        detector=HemisphereGrid(theta_step=3.0, phi_step=5.0),
    )


def _xyz(y: Floats, u: Floats, v: Floats) -> Floats:
    """X, Y and Z (n, 3) of a luminance and chromaticities."""
    # A tree that is damaged, or that Radiance has left empty, has chromaticities that are none.
    v, u = np.where(v > 1e-3, v, 9 / 19), np.minimum(u, 1.0)
    x, z = 9 * u / (4 * v), (12 - 3 * u - 20 * v) / (4 * v)
    return np.asarray(y[:, None] * np.stack([x, np.ones_like(x), np.maximum(z, 0.0)], axis=-1) * WHITE)
