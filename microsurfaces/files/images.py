"""Height maps as arrays and images: .npy, .png, .tif and .exr.

Images have row 0 at the top and y upwards: the last row is the first of `HeightField.heights`. Arrays in .npy files are
heights[j, i] at (i dx, j dy), as in `HeightField`: row 0 is the lowest y.

What we write says in a text named `gonio.json`, an attribute of .exr and a text chunk of .png, how far apart its pixels
are (`pixel_size`, µm) and the `unit` of its heights; in .png also the heights (`minimum`, `maximum`) of grey levels 0
and 65535. An .npy file has no place for them.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from microsurfaces.files.stored import MICROMETRES, MOST_NODES, Check, Stored, reading
from microsurfaces.height_field import HeightField

_LEVELS = 65535
_ABOUT = "gonio.json"

_MOST_VALUES = 4 * MOST_NODES  # in all channels of an .exr, which are read together

_INFLATED = (8, 32946)
_TIFF_COMPRESSIONS = {1: "none", 5: "LZW", 32773: "PackBits"} | dict.fromkeys(_INFLATED, "deflate")
"""Those that cannot unpack to more than the image holds, deflate once it has been checked."""


def read_npy(path: Path, check: Check) -> Stored:
    """An array of floats or integers."""
    with reading(path):
        mapped = np.lib.format.open_memmap(path, mode="r")
    check(mapped.shape, mapped.dtype)
    return Stored(np.array(mapped))


def read_png(path: Path, check: Check) -> Stored:
    """An image of 16-bit grey levels."""
    from PIL import Image

    types = {"I;16": np.uint16, "I;16B": np.uint16, "I": np.int32, "F": np.float32}
    with path.open("rb") as file:
        head = file.read(24)  # signature and size: Pillow would warn of a large image before it could be refused
        if head.startswith(b"\x89PNG") and len(head) == 24:
            check(struct.unpack(">II", head[16:])[::-1], np.uint16)
        with reading(path):
            image = Image.open(file, formats=["PNG"])
            bands = len(image.getbands())
        check((image.height, image.width) + ((bands,) if bands > 1 else ()), types.get(image.mode, np.uint8))
        with reading(path):
            pixels = np.asarray(image)
            return _described(np.flipud(pixels), image.info.get(_ABOUT))


def read_tiff(path: Path, check: Check) -> Stored:
    """An image of one page, 16-bit or float."""
    import tifffile

    with reading(path):
        tiff = tifffile.TiffFile(path)
    with tiff:
        with reading(path):
            page, pages = tiff.pages.first, len(tiff.pages)
            shape, dtype = tuple(int(n) for n in page.shape), np.dtype(page.dtype or np.void)
        check(shape if pages == 1 else (pages, *shape), dtype)
        with reading(path):
            _check_packed(page)
            return Stored(np.flipud(page.asarray()))


def _check_packed(page: Any) -> None:
    """Refuse a page that would unpack to more than the image that it announces."""
    if page.compression not in _TIFF_COMPRESSIONS:
        known = ", ".join(dict.fromkeys(_TIFF_COMPRESSIONS.values()))
        raise ValueError(f"its compression is number {int(page.compression)}, not one of {known}")
    if page.is_tiled and math.prod(page.chunks) > MOST_NODES:
        raise ValueError(f"its tiles have {page.chunks} pixels")
    if page.compression not in _INFLATED:
        return
    most = max(math.prod(page.shape), math.prod(page.chunks)) * np.dtype(page.dtype).itemsize
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        page.parent.filehandle.seek(offset)
        # Tifffile inflates a strip or tile whole, however much comes out of it.
        if len(zlib.decompressobj().decompress(page.parent.filehandle.read(count), most + 1)) > most:
            raise ValueError("a strip of it unpacks to more than the whole image")


def read_exr(path: Path, check: Check) -> Stored:
    """Channel Z of an image."""
    import OpenEXR

    with reading(path):
        with OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
            headers = [dict(part.header) for part in file.parts]  # closing empties them
        shapes = [_exr_shape(header) for header in headers]
        names = [channel.name for channel in headers[0]["channels"]]
    if "Z" not in names:
        raise ValueError(f"{path} has the channels {', '.join(names)}: expected heights in channel Z")
    check(shapes[0], np.float32)
    with reading(path):
        values = sum(math.prod(shape) * len(header["channels"]) for shape, header in zip(shapes, headers, strict=True))
        if values > _MOST_VALUES:
            raise ValueError(f"its channels hold {values} values, more than {_MOST_VALUES}")
        with OpenEXR.File(str(path), separate_channels=True) as file:
            pixels = np.flipud(file.channels()["Z"].pixels)
    check(pixels.shape, pixels.dtype)
    with reading(path):
        return _described(pixels, headers[0].get(_ABOUT))


def _exr_shape(header: dict[str, Any]) -> tuple[int, int]:
    """(rows, columns) of the data window."""
    (left, top), (right, bottom) = ((int(x), int(y)) for x, y in header["dataWindow"])
    return bottom - top + 1, right - left + 1


def _described(numbers: NDArray[Any], text: str | None) -> Stored:
    """The numbers with what the `gonio.json` beside them says, if there is one."""
    if text is None:
        return Stored(numbers)
    about = json.loads(text)
    dx, dy = (float(length) for length in about["pixel_size"])
    unit = about["unit"]
    low, high = (float(about.get(name, 0)) for name in ("minimum", "maximum"))
    if not (0 < dx < math.inf and 0 < dy < math.inf and unit in MICROMETRES and -math.inf < low <= high < math.inf):
        raise ValueError(f"its {_ABOUT} says {text}")
    scaled = "minimum" in about and "maximum" in about
    return Stored(numbers, (dx, dy), unit, (high - low) / _LEVELS if scaled else None, low)


def write_npy(relief: HeightField, path: Path) -> None:
    """The heights (ny, nx) in µm, exactly."""
    np.save(path, relief.heights)


def write_png(relief: HeightField, path: Path) -> None:
    """The heights in 65536 levels of grey from the lowest to the highest, which `gonio.json` tells in µm."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    low, high = float(relief.heights.min()), float(relief.heights.max())
    levels = np.rint((relief.heights - low) * (_LEVELS / (high - low) if high > low else 0.0)).astype(np.uint16)
    text = PngInfo()
    text.add_text(_ABOUT, json.dumps({"pixel_size": relief.spacing, "unit": "um", "minimum": low, "maximum": high}))
    Image.fromarray(np.flipud(levels)).save(path, pnginfo=text)


def write_exr(relief: HeightField, path: Path) -> None:
    """The heights in metres, float32, in channel Z."""
    import OpenEXR

    metres = np.ascontiguousarray(np.flipud(relief.heights * 1e-6), dtype=np.float32)
    header = {
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        _ABOUT: json.dumps({"pixel_size": relief.spacing, "unit": "m"}),
    }
    OpenEXR.File(header, {"Z": metres}).write(str(path))
