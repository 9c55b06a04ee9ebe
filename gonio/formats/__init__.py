"""Foreign file formats, one a file: `WRITERS` maps a suffix to the function that writes it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gonio.measurement import Measurement

Writer = Callable[["Measurement", Path], Path]
"""Writes a measurement to a path and returns it."""


def _write_exr(measurement: Measurement, path: Path) -> Path:
    from gonio.formats import exr

    return exr.write(measurement, path)


WRITERS: Mapping[str, Writer] = {".exr": _write_exr}
"""Every format there is, by suffix."""


def export(measurement: Measurement, path: str | os.PathLike[str], format: str | None = None) -> Path:
    """Write `measurement` in a foreign format and return the path.

    The suffix of `path` decides, or `format`, a suffix with or without its dot. Nothing is left behind if the writing
    fails. Raises ValueError for a format that is not in `WRITERS` or cannot hold this measurement.

    >>> gonio.export(measurement, "gold.exr")  # doctest: +SKIP
    """
    path = Path(path)
    suffix = path.suffix.lower() if format is None else "." + format.lower().removeprefix(".")
    if suffix not in WRITERS:
        raise ValueError(f"cannot export to {str(path)!r} as {suffix or 'a file without a suffix'!r}: {_choices()}")
    return WRITERS[suffix](measurement, path)


def _choices() -> str:
    return f"the formats are {', '.join(sorted(WRITERS))}; choose one by the suffix of the path or by format="
