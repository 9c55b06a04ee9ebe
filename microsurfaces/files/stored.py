"""What a file of heights holds, and what is checked before its pixels are read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Unit = Literal["nm", "um", "mm", "m"]
MICROMETRES = {"nm": 1e-3, "um": 1.0, "mm": 1e3, "m": 1e6}

MOST_NODES = 8192**2  # 134 million triangles: above 10 GB of memory once light is traced

Check = Callable[[tuple[int, ...], Any], None]
"""Called with the shape and the type of a file's pixels before they are read; raises ValueError to refuse them."""


@dataclass(frozen=True, eq=False)
class Stored:
    """The numbers of a file, and what the file itself says of them: a height is number * step + offset."""

    numbers: NDArray[Any]
    """(ny, nx), row 0 at the lowest y; NaN where there is no height."""
    pixel_size: tuple[float, float] | None = None
    """(dx, dy), µm."""
    unit: Unit | None = None
    """Unit of the heights, of `step` and of `offset`."""
    step: float | None = None
    offset: float = 0.0


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Tell whatever goes wrong in reading `path` as a ValueError of one sentence."""
    try:
        yield
    except Exception as error:  # damaged files make their libraries raise whatever comes
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            f"{path} cannot be read as a {path.suffix.lower()} file ({reason[:200]}): it is damaged or of another "
            "type; export it again"
        ) from error


def check_exists(path: Path) -> None:
    """Refuse what is not a file."""
    if not path.is_file():
        found = "is a folder" if path.is_dir() else "does not exist"
        raise ValueError(f"{path} {found}: give the path of a file, relative to {Path.cwd()} or absolute")


def check_map(path: Path, shape: tuple[int, ...], dtype: np.dtype[Any], factor: int) -> None:
    """Refuse what cannot be a height map whose sides will grow by `factor`."""
    if len(shape) != 2:
        raise ValueError(f"{path} has shape {shape}: expected one map (ny, nx), a single grey channel on a single page")
    if min(shape) < 2:
        raise ValueError(f"{path} has {shape[1]} x {shape[0]} pixels: expected at least 2 x 2")
    if math.prod(shape) * factor**2 > MOST_NODES:
        grown = " once mirrored" if factor > 1 else ""
        raise ValueError(
            f"{path} has {shape[1]} x {shape[0]} pixels: more than {MOST_NODES} nodes{grown}; crop or thin out the map"
        )
    if dtype.kind not in "iuf":
        raise ValueError(f"{path} holds values of type {dtype}: expected real heights, floats or 16-bit integers")
    if dtype.itemsize < 2:
        raise ValueError(
            f"{path} has 8 bits a pixel: 256 levels make steps instead of slopes; expected 16-bit integers or floats"
        )
