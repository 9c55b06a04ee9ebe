"""x3p, the exchange format of surface metrology: heights, their spacing and their gaps in one zip archive.

Opened by MountainsMap, Gwyddion, SPIP, x3ptools (R), SurfaceTopography, surfalize and the software of most makers of
profilometers.

    main.xml            Record1: axes; Record3: number of points, and the heights or where they are; all in metres
    bindata/data.bin    heights, little-endian int16, int32, float32 or float64, x fastest
    bindata/valid.bin   one bit a point, lowest bit first, 1 where an integer is a height; floats mark gaps by NaN
    md5checksum.hex     MD5 of main.xml

Coordinates are right-handed and start at the first point: row v of the data lies at y = v dy, as in `HeightField`.
Programs that draw the rows from the top down show the surface mirrored, and write it so from images. We write float64
in metres without `Record2`, the optional account of an instrument, because there is none; and the revision
"ISO5436 - 2000", which all readers know. Of the checksums nothing is asked on reading: the archive has its own.

Sources: ISO 25178-72:2017 and its Amendment 1 (2020); the openGPS consortium's schema ISO5436_2.xsd.
"""

from __future__ import annotations

import hashlib
import math
import zipfile
from array import array
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from microsurfaces.files.stored import Check, Stored, reading
from microsurfaces.height_field import HeightField

_TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}

_LARGEST_XML = 1 << 26  # bytes; two million heights as text
_DEEPEST = 16

_MAIN = """<?xml version="1.0" encoding="UTF-8"?>
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:schemaLocation="http://www.opengps.eu/2008/ISO5436_2 http://www.opengps.eu/2008/ISO5436_2/ISO5436_2.xsd">
  <Record1>
    <Revision>ISO5436 - 2000</Revision>
    <FeatureType>SUR</FeatureType>
    <Axes>
      <CX><AxisType>I</AxisType><DataType>D</DataType><Increment>{dx!r}</Increment><Offset>0</Offset></CX>
      <CY><AxisType>I</AxisType><DataType>D</DataType><Increment>{dy!r}</Increment><Offset>0</Offset></CY>
      <CZ><AxisType>A</AxisType><DataType>D</DataType><Increment>1</Increment><Offset>0</Offset></CZ>
    </Axes>
  </Record1>
  <Record3>
    <MatrixDimension><SizeX>{nx}</SizeX><SizeY>{ny}</SizeY><SizeZ>1</SizeZ></MatrixDimension>
    <DataLink>
      <PointDataLink>bindata/data.bin</PointDataLink>
      <MD5ChecksumPointData>{md5}</MD5ChecksumPointData>
    </DataLink>
  </Record3>
  <Record4>
    <ChecksumFile>md5checksum.hex</ChecksumFile>
  </Record4>
</p:ISO5436_2>
"""


def write(relief: HeightField, path: Path) -> None:
    """Write heights and spacing; the same relief gives the same bytes."""
    ny, nx = relief.heights.shape
    dx, dy = (length * 1e-6 for length in relief.spacing)
    data = (relief.heights * 1e-6).astype("<f8").tobytes()
    main = _MAIN.format(dx=dx, dy=dy, nx=nx, ny=ny, md5=_md5(data).upper()).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in (
            ("main.xml", main),
            ("bindata/data.bin", data),
            ("md5checksum.hex", f"{_md5(main)} *main.xml\n".encode()),
        ):
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)


def _md5(content: bytes) -> str:
    return hashlib.md5(content, usedforsecurity=False).hexdigest()


def read(path: Path, check: Check) -> Stored:
    """A surface on a regular grid, in one layer; ValueError for profiles and clouds of points."""
    with reading(path), zipfile.ZipFile(path) as archive:
        header = _header(archive)
    check(header.shape, header.dtype)
    with reading(path), zipfile.ZipFile(path) as archive:
        numbers = _numbers(archive, header)
    return Stored(numbers, header.pixel_size, "m", header.step, header.offset)


@dataclass(frozen=True, eq=False)
class _Header:
    """What main.xml says."""

    shape: tuple[int, int]
    """(ny, nx)."""
    dtype: np.dtype[Any]
    pixel_size: tuple[float, float]
    """(dx, dy), µm."""
    step: float
    """Height of a stored 1, m."""
    offset: float
    """Height of a stored 0, m."""
    points: str | None
    """Name of the file of heights; None if main.xml lists them."""
    valid: str | None
    """Name of the file that says which are heights."""
    listed: array[float]


def _header(archive: zipfile.ZipFile) -> _Header:
    main = _Main()
    parser = ElementTree.XMLParser(target=main)
    parser.feed(_member(archive, "main.xml", _LARGEST_XML))
    parser.close()
    found = (
        main("Record1/FeatureType"),
        *(main(f"Record1/Axes/{axis}/AxisType") for axis in ("CX", "CY", "CZ")),
        main("Record3/MatrixDimension/SizeZ"),
    )
    if found != ("SUR", "I", "I", "A", "1"):
        raise ValueError(f"it holds {' '.join(found)}, not a surface on a regular grid in one layer, SUR I I A 1")
    dx, dy, step = (float(main(f"Record1/Axes/{axis}/Increment", "1")) for axis in ("CX", "CY", "CZ"))
    offset = float(main("Record1/Axes/CZ/Offset", "0"))
    if not (0 < dx < math.inf and 0 < dy < math.inf and 0 < abs(step) < math.inf and abs(offset) < math.inf):
        raise ValueError(f"its increments are {dx:g}, {dy:g} and {step:g} m and its offset {offset:g} m")
    points = main("Record3/DataLink/PointDataLink", "") or None
    return _Header(
        (int(main("Record3/MatrixDimension/SizeY")), int(main("Record3/MatrixDimension/SizeX"))),
        np.dtype(_TYPES[main("Record1/Axes/CZ/DataType")] if points else np.float64),
        (dx * 1e6, dy * 1e6),
        step,
        offset,
        points,
        main("Record3/DataLink/ValidPointsLink", "") or None,
        main.listed,
    )


class _Main:
    """Parser's target for main.xml: keeps texts by their path, and heights as numbers, and builds no tree."""

    def __init__(self) -> None:
        self.listed: array[float] = array("d")
        self._texts: dict[str, str] = {}
        self._path: list[str] = []
        self._text: list[str] = []

    def __call__(self, key: str, default: str | None = None) -> str:
        """The text at a path below the root."""
        text = self._texts.get(key, default)
        if text is None:
            raise ValueError(f"its main.xml has no {key}")
        return text

    def doctype(self, *_: object) -> None:
        """Refuse what could define entities, which unpack without limit."""
        raise ValueError("its main.xml defines a document type")

    def start(self, tag: str, _: dict[str, str]) -> None:
        """An element begins."""
        self._path.append(tag.rpartition("}")[2])
        self._text.clear()
        if len(self._path) > _DEEPEST:
            raise ValueError("its main.xml is nested too deeply")

    def data(self, text: str) -> None:
        """A piece of an element's text."""
        self._text.append(text)

    def end(self, _: str) -> None:
        """An element ends."""
        text = "".join(self._text).strip()
        if self._path[1:] == ["Record3", "DataList", "Datum"]:
            self.listed.append(float(text) if text else math.nan)
        else:
            self._texts.setdefault("/".join(self._path[1:]), text)
        self._path.pop()
        self._text.clear()


def _numbers(archive: zipfile.ZipFile, header: _Header) -> NDArray[Any]:
    """The stored heights (ny, nx), NaN at gaps."""
    count = math.prod(header.shape)
    if header.points is None:
        numbers = np.array(header.listed)
    else:
        size = count * header.dtype.itemsize
        numbers = np.frombuffer(_member(archive, header.points, size), header.dtype)
    if numbers.size != count:
        raise ValueError(f"it holds {numbers.size} of {count} heights")
    if header.valid is not None:
        bits = np.frombuffer(_member(archive, header.valid, (count + 7) // 8), np.uint8)
        if bits.size < (count + 7) // 8:
            raise ValueError(f"it holds {8 * bits.size} bits of validity for {count} heights")
        numbers = np.where(np.unpackbits(bits, count=count, bitorder="little"), numbers, np.nan)
    return numbers.reshape(header.shape)


def _member(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """The content of a member that may unpack to `most` bytes."""
    info = archive.getinfo(name)
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"its {name} is packed neither plain nor by deflate")
    if info.file_size > most:
        raise ValueError(f"its {name} unpacks to {info.file_size} bytes, more than {most}")
    with archive.open(info) as file:
        return file.read(most)
