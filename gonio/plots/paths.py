"""A picture of light on a cross-section of a surface: shadowing, masking and multiple reflection, ray by ray.

The section is taken as a surface of its own, which goes on unchanged along y: so it is for cylinders and V-grooves, and
for a height field the picture is that of one of its lines. Light comes from the left; `gonio.transport.profile` traces
it in the plane of the section.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.plots.section import body, name, round_length, stretch
from gonio.plots.style import INK, PAPER, SOURCE, SPECULAR, finished, new_figure
from gonio.transport.profile import Flags, Paths, Profile, exposure, incident, shares, trace
from gonio.wording import percent
from microsurfaces import HeightField, Mesh
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gonio.plots.style import PathLike
    from microsurfaces import Surface


HITS = (SOURCE, SPECULAR, "#009e73", "#cc79a7")
"""Colours of light that has hit the surface 0, 1, 2, 3 and more times."""
SHADOWED, MASKED = "#111111", "#f0d000"
"""Stretches that no direct light reaches, and those whose reflection is blocked."""

RATIO = 0.64
"""Height over width of the stretch that is drawn."""


def paths(
    surface: Surface | HeightField | Mesh,
    path: PathLike | None = None,
    *,
    theta_i: float = 45.0,
    count: int = 15,
    seed: int = 0,
) -> Figure:
    """Draw what light does on a cross-section of a surface; a figure, also written into `path`.

    `surface` is a recipe, built with `seed`, or what one has built. The section, y = const through the middle of the
    tile, is drawn to scale, and so is light incident from the left at `theta_i` degrees: `count` parallel rays at
    equal distances, reflected in the plane of the section until they leave, in a colour for the number of hits so far.
    Bands below the line mark what no direct light reaches (shadowed) and what is lit but sends its reflection into the
    surface again (masked). The stretch that is shown is the one with the most multiple reflection; shares speak of the
    whole line and of a surface that absorbs nothing. Raises ValueError for an angle outside [0, 90) or no ray at all.
    """
    if not 0 <= theta_i < 90:
        raise ValueError(f"theta_i is {theta_i:g}: expected an angle from the normal in degrees, from 0 to below 90")
    if count < 1:
        raise ValueError(f"count is {count}: expected at least one ray to draw")
    relief = surface if isinstance(surface, HeightField | Mesh) else surface.build(seed)
    profile = Profile.of(relief)
    whole = trace(profile, _evenly(profile.left, profile.period, _enough(profile)), theta_i)
    window = _Window.of(profile, whole, stretch(relief, profile, RATIO))
    figure = new_figure(12.8, 7.2)
    panel, side = figure.subplots(1, 2, width_ratios=(4.0, 1.0))
    pieces, shadowed, masked = exposure(profile, window.width / 400, theta_i)
    _draw_solid(panel, window, profile, pieces, {SHADOWED: shadowed, MASKED: masked})
    _draw_rays(panel, window, profile, theta_i, count)
    _scale_bar(panel, window)
    extent = np.abs(np.ptp(pieces[..., 0], axis=1))
    _tell(side, theta_i, shares(whole), float(extent[shadowed].sum() / extent.sum()))
    _head(figure, surface, profile, window, theta_i)
    return finished(figure, path)


@dataclass(frozen=True)
class _Window:
    """The stretch that is drawn, µm."""

    left: float
    bottom: float
    width: float
    middle: float
    """Mean height of the line."""

    @classmethod
    def of(cls, profile: Profile, whole: Paths, width: float) -> _Window:
        """The stretch of that width whose middle part has the most hits of light that hits more than once."""
        left = profile.left - width / 2
        if width < profile.period:
            places = (whole.points[1:, whole.hits > 1, 0] - profile.left) % profile.period
            heights, edges = np.histogram(places[np.isfinite(places)], 200, (0.0, profile.period))
            part = max(1, round(200 * 0.7 * width / profile.period))
            sums = np.convolve(np.concatenate([heights, heights[:part]]), np.ones(part), mode="valid")[:200]
            left = profile.left + edges[int(sums.argmax())] + (edges[part] - width) / 2
        shown = profile.between(left, left + width).ends[..., 1]
        return cls(left, float(shown.min()) - 0.09 * width, width, float((shown.min() + shown.max()) / 2))

    @property
    def right(self) -> float:
        return self.left + self.width

    @property
    def top(self) -> float:
        return self.bottom + RATIO * self.width


def _evenly(left: float, width: float, count: int) -> Floats:
    """The middles of `count` equal parts."""
    return left + width * (np.arange(count) + 0.5) / count


def _enough(profile: Profile) -> int:
    """How many rays tell the shares to a percent or so, in a second or so."""
    return int(np.clip(1e7 / len(profile.ends), 1000, 20_000))


def _draw_solid(panel: Axes, window: _Window, profile: Profile, pieces: Floats, bands: dict[str, Flags]) -> None:
    """The body, its outline, and inside of it the bands."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import PathPatch

    shown = profile.between(window.left, window.right).ends
    solid = body(shown, window.bottom - window.width)
    panel.add_patch(PathPatch(solid, facecolor=PAPER, edgecolor="none"))
    for colour, flags in bands.items():
        runs = _runs(pieces[flags], profile.period)
        copies = [
            run + np.array([k * profile.period, 0.0]) for run in runs for k in profile.copies(window.left, window.right)
        ]
        band = LineCollection(copies, colors=colour, lw=11, capstyle="butt", joinstyle="round")
        panel.add_collection(band)
        band.set_clip_path(solid, panel.transData)
    panel.add_collection(LineCollection(list(shown), colors=INK, lw=1.6, capstyle="round"))
    panel.set(xlim=(window.left, window.right), ylim=(window.bottom, window.top), aspect="equal", xticks=[], yticks=[])
    for spine in panel.spines.values():
        spine.set(color="#b9b9b4")


def _runs(pieces: Floats, period: float) -> list[Floats]:
    """Polylines (m, 2) of the pieces that follow one another."""
    if not len(pieces):
        return []
    apart = np.abs(pieces[1:, 0] - pieces[:-1, 1]).max(axis=1) > 1e-9 * period
    groups = np.split(pieces, np.flatnonzero(apart) + 1)
    return [np.concatenate([group[:, 0], group[-1:, 1]]) for group in groups]


def _draw_rays(panel: Axes, window: _Window, profile: Profile, theta_i: float, count: int) -> None:
    """Rays that cross the middle of the relief at equal distances, leg by leg."""
    way = incident(theta_i)
    crossing = _evenly(window.left, window.width, count)
    traced = trace(profile, crossing + way[0] / way[1] * (profile.top - window.middle), theta_i)
    for number, (start, end) in _legs(traced, way, 4 * window.width):
        colour = HITS[min(number, 3)]
        panel.plot(
            *np.stack([start, end], axis=1), color=colour, lw=1.8, solid_capstyle="round", zorder=3 + number / 1e3
        )
        visible = _clipped(start, end, window)
        if visible is not None:
            _arrowhead(panel, *visible, colour, window)


def _legs(traced: Paths, way: Floats, far: float) -> Iterator[tuple[int, tuple[Floats, Floats]]]:
    """The number of hits so far and both ends of every straight piece of every path, `far` µm before and after."""
    for k, hits in enumerate(traced.hits):
        points = list(traced.points[: hits + 1, k])
        points[0] = points[0] - far * way
        if np.isfinite(traced.leaving[k]).all():
            points.append(points[-1] + far * traced.leaving[k])
        yield from enumerate(pairwise(points))


def _clipped(start: Floats, end: Floats, window: _Window) -> tuple[Floats, Floats] | None:
    """What of a leg is seen; None for nothing."""
    low, high = np.array([window.left, window.bottom]), np.array([window.right, window.top])
    along = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.stack([(low - start) / along, (high - start) / along])
    sides = np.where(along == 0, np.array([[-np.inf], [np.inf]]), sides)
    first, last = max(0.0, float(sides.min(axis=0).max())), min(1.0, float(sides.max(axis=0).min()))
    outside = ((along == 0) & ((start < low) | (start > high))).any()
    return None if outside or first >= last else (start + first * along, start + last * along)


def _arrowhead(panel: Axes, start: Floats, end: Floats, colour: str, window: _Window) -> None:
    """A head a bit behind the middle of a leg that is long enough to carry one."""
    length = float(np.hypot(*(end - start)))
    if length < 0.035 * window.width:
        return
    tip = start + (end - start) * min(0.6 + 0.01 * window.width / length, 0.9)
    tail = tip - (end - start) / length * 1e-3 * window.width
    style = {"arrowstyle": "-|>,head_length=0.5,head_width=0.22", "color": colour, "lw": 0, "mutation_scale": 16}
    panel.annotate("", tuple(tip), tuple(tail), arrowprops={**style, "shrinkA": 0, "shrinkB": 0}, zorder=5)


def _scale_bar(panel: Axes, window: _Window) -> None:
    length = round_length(window.width)
    x, y = window.left + 0.03 * window.width, window.bottom + 0.022 * window.width
    panel.plot([x, x + length], [y, y], color=INK, lw=4, solid_capstyle="butt", zorder=6)
    panel.text(
        x + length / 2, y + 0.008 * window.width, f"{length:g} µm", color=INK, fontsize=13, ha="center", zorder=6
    )


def _tell(panel: Axes, theta_i: float, share: Floats, shadowed: float) -> None:
    """Beside the picture: where light comes from, what the colours mean, and how much light they carry."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    panel.set(xlim=(-1.1, 1.1), ylim=(-5.4, 1.6), aspect="equal")
    panel.set_axis_off()
    _incident(panel, theta_i)
    words = ("leaves after 1 hit", "leaves after 2 hits", "leaves after 3 or more")
    handles: list[Artist] = [Line2D([], [], color=SOURCE, lw=3, label="incident")]
    for colour, text, part in zip(HITS[1:], words, share, strict=True):
        handles.append(Line2D([], [], color=colour, lw=3, label=f"{text}:\n{percent(part)} of the light"))
    handles.append(Patch(color=SHADOWED, lw=0, label=f"shadowed: no direct light,\n{percent(shadowed)} of the plane"))
    masked = percent(1 - share[0])
    handles.append(Patch(color=MASKED, lw=0, label=f"masked: its reflection is\nblocked, {masked} of the light"))
    panel.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.75),
        fontsize=12,
        labelcolor=INK,
        frameon=False,
        labelspacing=0.9,
    )


def _incident(panel: Axes, theta_i: float) -> None:
    """The direction of the light against the normal."""
    way = incident(theta_i)
    panel.plot([-1.0, 1.0], [0.0, 0.0], color=INK, lw=1.5)
    panel.plot([0.0, 0.0], [0.0, 1.3], color=INK, lw=1.2, ls="--")
    style = {"arrowstyle": "-|>", "color": SOURCE, "lw": 3, "mutation_scale": 20, "shrinkA": 0, "shrinkB": 0}
    panel.annotate("", (0.0, 0.0), tuple(-1.2 * way), arrowprops=style)
    arc = np.radians(np.linspace(0.0, theta_i, 40))
    panel.plot(-0.62 * np.sin(arc), 0.62 * np.cos(arc), color=INK, lw=1.2)
    panel.text(0.1, 0.95, f"$\\theta_i$ = {theta_i:g}°", fontsize=13, color=INK)
    panel.text(0.1, 0.6, "incident", fontsize=13, color=SOURCE)


def _head(figure: Figure, surface: Any, profile: Profile, window: _Window, theta_i: float) -> None:
    line = f"cross-section y = {profile.y:.4g} µm, drawn to scale and taken as unchanged along y; specular reflection"
    part = f"; {window.width:.3g} of {profile.period:.4g} µm" if window.width < profile.period else ""
    figure.suptitle(f"{name(surface)}\n{line}{part}", fontsize=13, color=INK)
