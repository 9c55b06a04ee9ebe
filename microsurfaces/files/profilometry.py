"""Files of profilometers and scanning probes, read by SurfaceTopography: the extra `profilometry`.

Heights, spacing and units come from the file. SurfaceTopography's arrays are [x, y] with the row that the instrument
shows at the top first, so y is turned up; in .sdf (ISO 25178-71) and .xyz the file itself gives coordinates, and rows
ascend in y. Of several channels the default one is taken if it holds heights, else the first that does.

Source: L. Pastewka and co-workers, https://contactengineering.github.io/SurfaceTopography.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from microsurfaces.files.stored import Check, Stored, Unit, reading

# fmt: off
SUFFIXES = (
    ".al3d", ".apx", ".asc", ".bcr", ".bcrf", ".cur", ".dat", ".datx", ".ezd", ".frt", ".gwy", ".h5", ".ibw", ".jpk",
    ".lext", ".mdt", ".mi", ".mnt", ".nc", ".nid", ".nms", ".oir", ".opd", ".opdx", ".os3d", ".plu", ".plux", ".poir",
    ".qep", ".sdf", ".spm", ".stp", ".sur", ".tmd", ".tom", ".top", ".txt", ".vk3", ".vk4", ".vk6", ".vk7", ".xyz",
    ".zmg", ".zon", ".001", ".002", ".003", ".004", ".005",
)
# fmt: on
"""Names of height maps that SurfaceTopography reads and we do not."""

_ASCENDING = ("sdf", "xyz")

_FARTHEST = 1e9  # µm; numbers beyond a kilometre are marks of gaps that were taken for heights, as in float .sdf

_UNITS: dict[str, Unit] = {"nm": "nm", "µm": "um", "um": "um", "mm": "mm", "m": "m"}


def read(path: Path, check: Check) -> Stored:
    """A height map, NaN where the instrument saw nothing. ValueError where SurfaceTopography is not installed."""
    try:
        import SurfaceTopography  # noqa: F401  (asked for here, so that no other failure is taken for its absence)
    except ImportError:
        raise ValueError(
            f"{path} is read by SurfaceTopography, which is not installed: pip install gonio[profilometry]"
        ) from None
    with reading(path):
        reader = _opened(path)
    with reader:
        with reading(path):
            channel = _height_map(reader)
            nx, ny = channel.nb_grid_pts
        check((ny, nx), np.float64)
        with reading(path):
            return _stored(channel, reader.format())


def _opened(path: Path) -> Any:
    """The first reader for files of this suffix that knows the file."""
    from SurfaceTopography.IO import open_topography, readers

    problems = []
    for kind in (reader.format() for reader in readers if path.suffix.lower()[1:] in reader.file_extensions()):
        try:
            return open_topography(str(path), format=kind)
        except Exception as error:  # as damaged files go
            problems.append(str(error) or type(error).__name__)
    raise ValueError("; ".join(problems))


def _height_map(reader: Any) -> Any:
    """The channel to take."""
    for channel in (reader.default_channel, *reader.channels):
        if channel.data_kind.value == "height" and channel.dim == 2 and channel.is_uniform:
            return channel
    raise ValueError(f"it holds no map of heights, only {', '.join(channel.name for channel in reader.channels)}")


def _stored(channel: Any, kind: str) -> Stored:
    """The heights of a channel, and what its file says of them."""
    from SurfaceTopography.Support.UnitConversion import get_unit_conversion_factor

    nx, ny = channel.nb_grid_pts
    stated = channel.physical_sizes
    topography = channel.topography(**({} if stated else {"physical_sizes": (nx, ny)}))
    numbers = np.ma.filled(np.ma.asarray(topography.heights(), np.float64), np.nan).T
    if kind not in _ASCENDING:
        numbers = np.flipud(numbers)
    if topography.unit is None:
        return Stored(numbers)
    micrometres = get_unit_conversion_factor(topography.unit, "µm")
    numbers = np.where(np.abs(numbers) * micrometres < _FARTHEST, numbers, np.nan)
    size_x, size_y = (float(size) * micrometres for size in topography.physical_sizes)
    pixel_size = (size_x / nx, size_y / ny) if stated else None
    if topography.unit in _UNITS:
        return Stored(numbers, pixel_size, _UNITS[topography.unit], 1.0)
    return Stored(numbers, pixel_size, "um", micrometres)
