"""Writing: matrices and trees as XML text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import escape

import numpy as np

from gonio.brdf import BRDF
from gonio.formats.radiance import klems, tensor_tree
from gonio.formats.radiance.colours import components
from microsurfaces.arrays import Floats
from microsurfaces.atomic_write import atomic_write

Variant = Literal["klems-full", "klems-half", "klems-quarter", "tensor3", "tensor4"]
"""A matrix over 145, 77 or 41 patches, or a tensor tree for isotropic or for any BRDFs."""


def write(brdf: BRDF, path: Path, basis: Variant = "klems-full") -> Sequence[str]:
    """Write `brdf` as `Reflection Back`, in colour if it has more than one channel.

    Values are means over incident and exiting patch or cell. Raises ValueError for a rank 3 tree if the azimuth of the
    light matters.
    """
    brdf = brdf.in_basis("Y" if len(brdf.wavelengths) == 1 else "XYZ")
    if basis in klems.BASES:
        frame, values = _matrix_frame(klems.BASES[basis]), klems.matrix(brdf, klems.BASES[basis])
    else:
        frame, values = _tree_frame(basis), tensor_tree.grid(brdf, _rank(brdf, basis))
    notes = _notes(brdf, values)
    values = np.maximum(np.nan_to_num(values), 0.0)
    if basis == "tensor3" and values.shape[-1] == 3 and _is_nowhere_black(values[..., 1]):
        values = values[..., 1:2]
        notes.append(
            "only the luminance was written: Radiance loses the colours of rank 3 trees that are nowhere black; write "
            'rank 4 ("tensor4") or a matrix to keep them'
        )
    parts = components(values, chromaticities=basis not in klems.BASES)
    with atomic_write(path) as scratch:
        scratch.write_text(_document(brdf.title, frame, parts), encoding="utf-8")
    return notes


def _is_nowhere_black(luminance: Floats) -> bool:
    """Whether Radiance splits off a Lambertian part of a rank 3 tree, whose colours it then takes from empty cells."""
    used = luminance[: len(luminance) // 2]
    return bool(used.min() > 0.01 / np.pi)


def _rank(brdf: BRDF, basis: Variant) -> int:
    """Dimensions of the tree."""
    if basis == "tensor3" and not brdf.isotropic:
        raise ValueError(
            "a tensor tree of rank 3 holds isotropic BRDFs only, and this one depends on the azimuth of the light: "
            'write rank 4 ("tensor4") or a matrix ("klems-full")'
        )
    return 3 if basis == "tensor3" else 4


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


def _document(title: str, frame: tuple[str, str, str], parts: Mapping[str, Floats]) -> str:
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
        for wavelength, values in parts.items()
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


def _notes(brdf: BRDF, values: Floats) -> list[str]:
    """What had to be bent; `values` (..., channels) are NaN where nothing is known."""
    notes = []
    if brdf.theta_i[-1] < 80:
        notes.append(
            f"incidences beyond {brdf.theta_i[-1]:g} degrees are not known: the nearest known incidence stands"
        )
    unknown = np.isnan(values).any(axis=-1).mean()
    if unknown:
        notes.append(f"of {unknown:.2%} of the pairs of directions nothing is known: they are 0")
    return notes
