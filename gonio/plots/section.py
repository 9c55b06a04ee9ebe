"""What pictures of a section through a surface share: its body, how much of it is shown, a scale bar, its name."""

from __future__ import annotations

import textwrap
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.transport.profile import Profile
from microsurfaces import HeightField, Mesh
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.path import Path as Outline

UNITS = {
    **dict.fromkeys(("angle", "rotation"), "°"),
    **dict.fromkeys(("distance", "floor_height", "protrusion"), " radii"),
    **dict.fromkeys(("correlation_length", "side", "radius", "width", "pixel_size"), " µm"),
}
"""Of the recipes' parameters; the others are numbers."""
LINE = 120
"""At most so many letters in a line of a title."""
UNTOLD = ("kind", "unit", "scale")
"""What a title says nothing of."""


def stretch(relief: HeightField | Mesh, profile: Profile, ratio: float) -> float:
    """The width, µm, that shows a few bumps and, in a picture `ratio` times as high, leaves room above them."""
    tall = float(np.ptp(profile.ends[..., 1]))
    if isinstance(relief, HeightField):
        length = relief.statistics().correlation_length_x
        return max(profile.period if length is None else min(5 * length, profile.period), tall / (0.6 * ratio))
    start, end = profile.ends[profile.ends[:, 0, 0].argsort()].swapaxes(0, 1)
    rises = np.sign(np.round(end[:, 1] - start[:, 1], 12))
    rises = rises[rises != 0]
    bumps = int(((rises > 0) & (np.roll(rises, -1) < 0)).sum())
    return max(3 * profile.period / max(bumps, 1), tall / (0.6 * ratio))


def body(ends: Floats, floor: float) -> Outline:
    """What lies below the segments: the sum of the strips below them, those under overhangs counted negative."""
    from matplotlib.path import Path as Outline

    below = ends[:, ::-1].copy()
    below[..., 1] = floor
    corners = np.concatenate([ends, below, ends[:, :1]], axis=1).reshape(-1, 2)
    codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY]
    return Outline(corners, np.tile(np.array(codes, np.uint8), len(ends)))


def round_length(width: float) -> float:
    """The longest round length, µm, that is at most a fifth of `width`."""
    rounds = np.outer(10.0 ** np.arange(-6, 8), (1, 2, 5)).ravel()
    return float(rounds[rounds <= width / 5].max())


def name(surface: Any) -> str:
    """A recipe with what differs from its defaults; of what has been built, what it is."""
    if isinstance(surface, HeightField | Mesh):
        return {HeightField: "height field", Mesh: "mesh"}[type(surface)]
    told = []
    for field in fields(surface):
        value = getattr(surface, field.name)
        if field.name not in UNTOLD and value is not None and value != getattr(field.default, "default", field.default):
            words = Path(value).name if field.name == "path" else f"{value:g}" if isinstance(value, float) else value
            told.append(f"{field.name} = {words}{UNITS.get(field.name, '')}")
    words = f"{type(surface).__name__}: {', '.join(told)}" if told else type(surface).__name__
    return textwrap.fill(words.replace("$", r"\$"), LINE)
