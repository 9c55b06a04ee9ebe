"""JSON with long arrays of numbers: a hundred megabytes in seconds, and in no more memory than the numbers need."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from gonio.formats.text import frame
from microsurfaces.arrays import Floats

LARGEST = 1 << 29
"""Bytes that a file may have."""

LARGEST_REST = 1 << 25
"""Bytes that it may have without its arrays: Python needs twenty times as many for what JSON can hold."""

SHORT = 1000
"""Bytes of an array that is left to the standard library."""

_MARK = "gonio.numbers"


def load(path: Path, key: str) -> Any:
    """The content of a JSON file whose long arrays under `key` are numpy arrays.

    Rows of numbers become the rows of one array, null becomes NaN. Raises ValueError if the file is too large or no
    JSON, OSError where it cannot be read.
    """
    if path.stat().st_size > LARGEST:
        raise ValueError(f"it is larger than {LARGEST >> 20} MiB")
    arrays: list[Floats] = []

    def replaced(match: re.Match[bytes]) -> bytes:
        if len(match[1]) < SHORT:
            return match[0]
        arrays.append(_numbers(match[1]))
        return b'"%s":{"%s":%d}' % (key.encode(), _MARK.encode(), len(arrays) - 1)

    def restored(found: dict[str, Any]) -> Any:
        return arrays[found[_MARK]] if _MARK in found else found

    # What follows a key ends at the next quote or brace, so that no byte is looked at twice.
    rest = re.sub(rb'"%s"\s*:\s*(\[[^"{}]*\])' % key.encode(), replaced, path.read_bytes())
    if len(rest) > LARGEST_REST:
        raise ValueError(f"more than {LARGEST_REST >> 20} MiB of it are not the numbers that it should hold")
    try:
        return json.loads(rest, object_hook=restored)
    except (RecursionError, IndexError, TypeError):
        raise ValueError("it is no JSON text of this kind") from None


def _numbers(text: bytes) -> Floats:
    """An array of numbers, or of rows of them."""
    # White space is looked for first, of which there is little; then whether a number ends before it.
    if re.search(rb"\s(?<=[^][,\s]\s)\s*[^][,\s]", text):
        raise ValueError("an array has white space between numbers")
    inner = text.translate(None, b" \t\r\n")[1:-1]
    nested = inner.startswith(b"[") and inner.endswith(b"]")
    lines = inner[1:-1].replace(b"],[", b"\n") if nested else inner.replace(b",", b"\n")
    if b"[" in lines or b"]" in lines:
        raise ValueError("an array of numbers is damaged")
    values = np.asarray(frame(lines, header=None, skip_blank_lines=False).to_numpy())
    return values if nested else values[:, 0]
