"""The container: named tensors of numbers, one after another."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

MAGIC = b"tensor_file\0\x01\x00"

TYPES = ["u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"]
"""Types of a field's numbers; their codes count from 1."""

ALIGNED = 8

LARGEST, FIELDS = 1 << 31, 256
"""Bytes of the largest file that is read, and how many fields it may have."""


def store(file: BinaryIO, fields: Mapping[str, NDArray[Any]]) -> None:
    """Write the container."""
    heads = [
        struct.pack(f"<H{len(name)}sHB", len(name), name.encode(), table.ndim, TYPES.index(_type(table)) + 1)
        for name, table in fields.items()
    ]
    file.write(MAGIC + struct.pack("<I", len(fields)))
    at = file.tell() + sum(map(len, heads)) + sum(8 * (1 + table.ndim) for table in fields.values())
    offsets = []
    for head, table in zip(heads, fields.values(), strict=True):
        at += -at % ALIGNED
        offsets.append(at)
        file.write(head + struct.pack(f"<{1 + table.ndim}Q", at, *table.shape))
        at += table.nbytes
    for offset, table in zip(offsets, fields.values(), strict=True):
        file.write(bytes(offset - file.tell()))
        file.write(np.ascontiguousarray(table, _type(table)).data)


def _type(table: NDArray[Any]) -> str:
    return table.dtype.newbyteorder("<").str.lstrip("|")


def load(path: Path) -> dict[str, NDArray[Any]]:
    """The fields of a container by name. Raises ValueError for what is none, before anything large is allocated."""
    size = path.stat().st_size
    if size > LARGEST:
        raise ValueError(f"it has {size} bytes, more than {LARGEST}")
    with path.open("rb") as file:

        def unpack(form: str) -> tuple[Any, ...]:
            return struct.unpack(form, file.read(struct.calcsize(form)))

        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError("it does not begin as one of version 1.0")
        (count,) = unpack("<I")
        if count > FIELDS:
            raise ValueError(f"it announces {count} fields, more than {FIELDS}")
        heads = {}
        for _ in range(count):
            name = file.read(unpack("<H")[0]).decode("utf-8", errors="replace")
            sides, code, offset = unpack("<HBQ")
            if sides > 8 or not 1 <= code <= len(TYPES):
                raise ValueError(f"its field {name[:20]!r} has {sides} dimensions and the type {code}")
            heads[name] = np.dtype(TYPES[code - 1]), offset, unpack(f"<{sides}Q")
            if max(heads[name][2], default=0) > size:
                raise ValueError(f"its field {name[:20]!r} has more rows than it has bytes")
        if sum(math.prod(shape) * kind.itemsize for kind, _, shape in heads.values()) > size:
            raise ValueError("it announces more numbers than it has")
        fields = {}
        for name, (kind, offset, shape) in heads.items():
            if offset + math.prod(shape) * kind.itemsize > size:
                raise ValueError(f"it ends before its field {name[:20]!r} does")
            file.seek(offset)
            fields[name] = np.fromfile(file, kind, math.prod(shape)).reshape(shape)
    return fields
