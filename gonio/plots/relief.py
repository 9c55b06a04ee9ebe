"""A figure about a microsurface: what it looks like, its slopes, its correlation and spectrum, a section to scale.

Every number is one that `HeightField` or `Mesh` reports; beside it stands what the recipe asks for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.plots.section import body, name, round_length, stretch
from gonio.plots.style import COLOURS, INK, PAPER, SPECULAR, finished, new_figure
from gonio.transport.profile import Profile
from microsurfaces import Cylinders, Gaussian, HeightField, Mesh, VGrooves
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gonio.plots.style import PathLike
    from microsurfaces import Statistics, Surface

ALONG = (SPECULAR, "#cc6677")
"""Colours of what is measured along x and along y."""
SHOWN = 24.0
"""Correlation lengths along a side of the shaded relief."""
STEEPEST = 4.0
"""Slopes that a mesh's distribution is drawn to; walls know no end."""
SMALLEST = 1e-4
"""Densities below this share of the largest are not drawn."""
BANDS = 40
"""Rings of wave numbers over which the spectrum is averaged."""


def relief(surface: Surface | HeightField | Mesh, path: PathLike | None = None, *, seed: int = 0) -> Figure:
    """Draw what a microsurface is like; a figure, also written into `path`.

    `surface` is a recipe, built with `seed`, or what one has built. A height field is shown as a shaded relief with its
    heights in colour, the densities of its facets' slopes along x and y, its autocorrelation, its power spectral
    density averaged over all directions, and a section to scale; a mesh by a section to scale and the distributions of
    its facets' slopes and inclinations. Dashed lines are what the recipe asks for; where it asks for nothing, as a
    height map does, the Gaussian of the same rms slope.
    """
    built = surface if isinstance(surface, HeightField | Mesh) else surface.build(seed)
    figure = new_figure(12.8, 7.2)
    draw: Callable[[Figure, Any, Any], None] = _draw_mesh if isinstance(built, Mesh) else _draw_field
    draw(figure, surface, built)
    figure.suptitle(f"{name(surface)}\n{summary(built.statistics())}", fontsize=13, color=INK)
    return finished(figure, path)


def summary(statistics: Statistics) -> str:
    """The numbers that matter, with their units, as far as they have a meaning."""
    s = statistics
    parts = ["the surface overhangs" if s.Sq is None else f"rms height {s.Sq:.3g} µm"]
    if s.rms_slope_x is not None:
        parts.append(f"rms slopes {s.rms_slope_x:.3g} (x), {s.rms_slope_y:.3g} (y)")
    elif s.Sq is not None:
        parts.append("vertical walls: slopes have no rms")
    if s.correlation_length is not None:
        parts.append(f"Beckmann alpha {s.beckmann_alpha_x:.3g} (x), {s.beckmann_alpha_y:.3g} (y)")
        parts.append(f"correlation lengths {s.correlation_length_x:.3g} (x), {s.correlation_length_y:.3g} (y) µm")
    return "; ".join(parts)


def _draw_field(figure: Figure, surface: Any, field: HeightField) -> None:
    """Six panels about a height field."""
    grid = figure.add_gridspec(3, 3, width_ratios=(1.62, 1.0, 1.0), height_ratios=(1.0, 1.0, 0.42))
    _draw_relief(figure.add_subplot(grid[:2, 0]), field)
    slopes = Slopes.of(surface, field)
    for axis in (0, 1):
        _draw_slopes(figure.add_subplot(grid[0, 1 + axis]), slopes, axis, True)
    if np.ptp(field.heights):
        _draw_correlation(figure.add_subplot(grid[1, 1]), surface, field)
        _draw_spectrum(figure.add_subplot(grid[1, 2]), surface, field)
    _draw_section(figure.add_subplot(grid[2, :]), field, 0.055)


def _draw_mesh(figure: Figure, surface: Any, mesh: Mesh) -> None:
    """A section, slopes along x, inclinations; slopes along y too where there are any."""
    slopes = Slopes.of(surface, mesh)
    axes = [axis for axis in (0, 1) if axis == 0 or slopes.largest(axis) > 1e-6]
    grid = figure.add_gridspec(2, len(axes) + 1, height_ratios=(1.0, 1.1))
    _draw_section(figure.add_subplot(grid[0, :]), mesh, 0.2)
    for axis in axes:
        _draw_slopes(figure.add_subplot(grid[1, axis]), slopes, axis, False)
    _draw_inclinations(figure.add_subplot(grid[1, -1]), surface, mesh)


# --- The relief ------------------------------------------------------------------------------------------------------


def _side(field: HeightField) -> float:
    """The side of the part that is shown, µm."""
    length = field.statistics().correlation_length
    return float(min(*field.period, SHOWN * length if length else np.inf))


def _draw_relief(panel: Axes, field: HeightField) -> None:
    """A square part of the tile, lit from the upper left, coloured by height, with a scale bar."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.patches import Rectangle

    side, (dx, dy) = _side(field), field.spacing
    heights = (field.heights - field.heights.mean())[: max(2, round(side / dy)), : max(2, round(side / dx))]
    extent = (0.0, heights.shape[1] * dx, 0.0, heights.shape[0] * dy)
    norm = Normalize(*_limits(heights))
    shaded = shade(colormaps[COLOURS](norm(heights))[..., :3], heights, field)
    panel.imshow(shaded, origin="lower", extent=extent, interpolation="antialiased")
    panel.set(xticks=[], yticks=[])
    width, height = extent[1], extent[3]
    length = round_length(1.5 * width)
    panel.set_xlabel("x", fontsize=11, color=INK)
    panel.set_ylabel("y", fontsize=11, color=INK, rotation=0)
    x, y = 0.05 * width, 0.05 * height
    box = (x - 0.02 * width, y - 0.025 * height), length + 0.04 * width, 0.1 * height
    panel.add_patch(Rectangle(*box, facecolor="white", alpha=0.85))
    panel.plot([x, x + length], [y, y], color=INK, lw=4, solid_capstyle="butt")
    panel.text(x + length / 2, y + 0.018 * height, f"{length:g} µm", ha="center", fontsize=12, color=INK)
    part = (
        "one period"
        if np.allclose((width, height), field.period)
        else f"part of {field.period[0]:.4g} x {field.period[1]:.4g} µm"
    )
    panel.set_title(f"{width:.3g} x {height:.3g} µm, {part}", fontsize=12, color=INK)
    bar = panel.figure.colorbar(
        ScalarMappable(norm, COLOURS), ax=panel, location="left", shrink=0.85, aspect=30, pad=0.02
    )
    bar.set_label("height above the mean (µm)", fontsize=11, color=INK)
    bar.ax.tick_params(labelsize=10)


def shade(colours: Floats, heights: Floats, field: HeightField) -> Floats:
    """`colours` (ny, nx, 3) lit from the upper left; level parts keep theirs, which the colour bar shows.

    Slopes are brought to an rms of 0.6, whatever the roughness, so that the bumps always show.
    """
    (dx, dy), slope = field.spacing, field.statistics().Sdq or 1.0
    q, p = np.gradient(0.6 * heights / slope, dy, dx)
    light = np.maximum(1 + p - q, 0.0) / np.sqrt(1 + p * p + q * q)
    dark, bright = np.minimum(light, 1.0)[..., None], np.maximum(light - 1.0, 0.0)[..., None]
    return np.asarray(1 - (1 - colours * (0.45 + 0.55 * dark)) * (1 - 0.7 * bright))


def _limits(heights: Floats) -> tuple[float, float]:
    """Ends of the colour scale, µm, from which the few highest and lowest are left out."""
    low, high = (float(q) for q in np.quantile(heights, (0.001, 0.999)))
    return (low, high) if high > low else (low - 1.0, high + 1.0)


# --- Distributions of slopes and inclinations ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Slopes:
    """Densities of the facets' slopes along x and along y, and what is asked for; 1 per unit of slope."""

    edges: Floats
    """(n + 1,) slopes."""
    density: tuple[Floats, Floats]
    """Along x, along y, (n,)."""
    target: tuple[Floats, Floats] | None
    words: str
    """What the target is."""
    beyond: float
    """Share of the plane that is steeper than the largest edge."""

    @classmethod
    def of(cls, surface: Any, built: HeightField | Mesh) -> Slopes:
        """From the joint density of the facets, and from the recipe's own law where it has one."""
        limit, bins = _range(built)
        joint, edges, _ = built.slope_distribution(bins, limit)
        step = edges[1] - edges[0]
        density = joint.sum(axis=1) * step, joint.sum(axis=0) * step
        beyond = 1 - float(density[0].sum() * step)
        law = getattr(surface, "expected_slopes", None)
        if law is not None:
            x, y = (np.diff(law(azimuth, edges).cdf) / step for azimuth in (0.0, 90.0))
            return cls(edges, density, (x, y), "asked for", beyond)
        rms = built.statistics().rms_slope_x, built.statistics().rms_slope_y
        if isinstance(built, Mesh) or not all(rms):
            return cls(edges, density, None, "", beyond)
        x, y = (_gaussian(edges, float(sigma or 0.0)) for sigma in rms)
        return cls(edges, density, (x, y), "Gaussian, same rms", beyond)

    def largest(self, axis: int) -> float:
        """The largest slope that there is, up to a bin."""
        used = np.flatnonzero(self.density[axis] > 0)
        if len(used) == 0:
            return 0.0
        low, high = self.edges[used[0] + 1], self.edges[used[-1]]
        return float(max(-low, high, 0.0))


def _range(built: HeightField | Mesh) -> tuple[float, int]:
    """Largest slope and number of bins of the distributions; an odd number, so that level facets have a bin."""
    if isinstance(built, Mesh):
        steepest = float(built.slope_distribution(1)[1][-1])
        return min(1.2 * steepest, STEEPEST), 41
    statistics = built.statistics()
    x, y = statistics.rms_slope_x or 0.0, statistics.rms_slope_y or 0.0
    if not max(x, y):
        return 0.1, 45
    # Ten bins a standard deviation of the narrower distribution.
    return 4.5 * max(x, y), 2 * int(np.clip(22 * max(x, y) / max(min(x, y), 1e-9), 22, 200)) + 1


def _gaussian(edges: Floats, sigma: float) -> Floats:
    """Mean over each bin of the Gaussian density."""
    from scipy.special import ndtr

    return np.asarray(np.diff(ndtr(edges / sigma)) / np.diff(edges))


def _draw_slopes(panel: Axes, slopes: Slopes, axis: int, logarithmic: bool) -> None:
    """Densities along x or y; a Gaussian is a parabola if they are `logarithmic`."""
    letter = "xy"[axis]
    panel.stairs(slopes.density[axis], slopes.edges, fill=True, color=ALONG[axis], alpha=0.35, baseline=1e-12)
    panel.stairs(slopes.density[axis], slopes.edges, color=ALONG[axis], lw=1.6, baseline=1e-12, label="facets")
    if slopes.target is not None:
        drawn: dict[str, Any] = {"color": INK, "lw": 1.6, "ls": (0, (4, 2)), "label": slopes.words}
        if logarithmic:
            panel.plot((slopes.edges[1:] + slopes.edges[:-1]) / 2, slopes.target[axis], **drawn)
        else:
            panel.stairs(slopes.target[axis], slopes.edges, **drawn)
    shown = [slopes.density[axis], *([] if slopes.target is None else [slopes.target[axis]])]
    high = max(float(density.max()) for density in shown)
    panel.set(xlim=(slopes.edges[0], slopes.edges[-1]), ylim=(0, 1.25 * high))
    if logarithmic:
        panel.set(yscale="log", ylim=(high * SMALLEST, 40 * high))
    derivative = f"$\\partial z / \\partial {letter}$"
    told = f", {100 * slopes.beyond:.2g} % of the plane is steeper" if slopes.beyond > 5e-4 else ""
    _axes(panel, f"slopes along {letter}{told}", f"{derivative} (µm/µm)", "probability density")
    _legend(panel, "upper center", 2)


def inclinations(mesh: Mesh) -> tuple[Floats, Floats]:
    """Angles from the horizontal, degrees, and the share of the plane whose facets are at most that steep."""
    density, edges, _ = mesh.normal_distribution(900)
    sines = np.sin(np.radians(edges)) ** 2
    return edges, np.append(0.0, np.cumsum(density[:, 0] * np.pi * np.diff(sines)))


def _draw_inclinations(panel: Axes, surface: Any, mesh: Mesh) -> None:
    """How steep the facets are, all azimuths together; a sum, because a mesh may have few angles."""
    angles, share = inclinations(mesh)
    panel.fill_between(angles, 100 * share, color=ALONG[0], alpha=0.35, lw=0)
    panel.plot(angles, 100 * share, color=ALONG[0], lw=1.8, label="facets")
    if isinstance(surface, Cylinders | VGrooves):
        slope = np.tan(np.radians(angles[:-1]))
        law = surface.expected_slopes(0.0, slope).cdf - surface.expected_slopes(0.0, -slope).cdf
        panel.plot(angles[:-1], 100 * law, color=INK, lw=1.6, ls=(0, (4, 2)), label="asked for")
    panel.set(xlim=(0, 90), xticks=range(0, 91, 15), ylim=(0, 108))
    _axes(
        panel, "inclination of the facets", "angle from the horizontal (degrees)", "of the plane at most that steep (%)"
    )
    _legend(panel, "lower right", 1)


def _legend(panel: Axes, place: Any, columns: int) -> None:
    panel.legend(
        loc=place,
        ncols=columns,
        fontsize=10,
        frameon=False,
        labelcolor=INK,
        handlelength=1.4,
        handletextpad=0.5,
        columnspacing=0.8,
    )


def _axes(panel: Axes, title: str, x: str, y: str) -> None:
    panel.set_title(title, fontsize=12, color=INK)
    panel.set_xlabel(x, fontsize=11, color=INK)
    panel.set_ylabel(y, fontsize=11, color=INK)
    panel.tick_params(labelsize=10)
    panel.grid(color="#dddddd", lw=0.6)


# --- Correlation and spectrum ----------------------------------------------------------------------------------------


def correlations(field: HeightField, values: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """Lags (µm) and values along x, and along y, of a periodic map (ny, nx), up to half a period."""
    lines = (values[0, : values.shape[1] // 2 + 1], values[: values.shape[0] // 2 + 1, 0])
    x, y = (
        (np.arange(len(line), dtype=np.float64) * step, line) for step, line in zip(field.spacing, lines, strict=True)
    )
    return x, y


def _draw_correlation(panel: Axes, surface: Any, field: HeightField) -> None:
    asked = isinstance(surface, Gaussian)
    lengths = field.statistics()
    longest = max((x for x in (lengths.correlation_length_x, lengths.correlation_length_y) if x), default=None)
    for line, colour, letter in zip(correlations(field, field.acf()), ALONG, "xy", strict=True):
        panel.plot(*line, color=colour, lw=2.2, label=f"along {letter}")
    if asked:
        covariance = surface.covariance()
        for line, letter in zip(correlations(field, covariance / covariance[0, 0]), "xy", strict=True):
            words = "asked for: exp(-r²/τ²)" if letter == "x" else None
            panel.plot(*line, color=INK, lw=1.4, ls=(0, (4, 2)), label=words)
    panel.axhline(np.exp(-1), color="#8a8a86", lw=0.9)
    panel.text(
        0.99, np.exp(-1) + 0.02, "1/e", transform=panel.get_yaxis_transform(), fontsize=10, color=INK, ha="right"
    )
    panel.set(xlim=(0, min(max(field.period) / 2, 4 * longest if longest else np.inf)))
    _axes(panel, "autocorrelation of the heights", "lag (µm)", "correlation coefficient")
    _legend(panel, "upper right", 1)


def radial(psd: Floats, kx: Floats, ky: Floats) -> tuple[Floats, Floats]:
    """Wave numbers (rad/µm) and means of a spectrum over rings, equally wide in the logarithm; empty ones left out."""
    k = np.hypot(kx, ky[:, None])
    least = float(min(kx[kx > 0].min(), ky[ky > 0].min()))
    edges = np.geomspace(least * (1 - 1e-9), float(min(kx.max(), ky.max())), BANDS + 1)
    ring = np.digitize(k.ravel(), edges)
    number, power, total = (np.bincount(ring, weights, BANDS + 2)[1:-1] for weights in (None, psd.ravel(), k.ravel()))
    used = number > 0
    return np.asarray(total[used] / number[used]), np.asarray(power[used] / number[used])


def _draw_spectrum(panel: Axes, surface: Any, field: HeightField) -> None:
    psd, kx, ky = field.psd()
    k, mean = radial(psd, kx, ky)
    panel.loglog(k, mean, color=ALONG[0], lw=2.2, label="this tile")
    if isinstance(surface, Gaussian):
        target = np.fft.fft2(surface.covariance()).real * np.prod(field.spacing)
        panel.loglog(*radial(target, kx, ky), color=INK, lw=1.4, ls=(0, (4, 2)), label="asked for")
    high = float(mean.max())
    panel.set(ylim=(max(float(mean[mean > 0].min()), high * 1e-9) / 2, high * 3), xlim=(k[0], k[-1]))
    _axes(panel, "spectrum, radial mean", "wave number (rad/µm)", "PSD (µm⁴)")
    _legend(panel, "upper right", 1)


# --- The section -----------------------------------------------------------------------------------------------------


def _draw_section(panel: Axes, built: HeightField | Mesh, ratio: float) -> None:
    """A stretch of the profile, as tall as `ratio` times its width, both axes in the same scale."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import PathPatch

    profile = Profile.of(built)
    width = stretch(built, profile, ratio)
    shown = profile.between(profile.left, profile.left + width).ends
    middle = float(shown[..., 1].min() + shown[..., 1].max()) / 2
    bottom, top = middle - ratio * width / 2, middle + ratio * width / 2
    panel.add_patch(PathPatch(body(shown, bottom - width), facecolor=PAPER, edgecolor="none"))
    panel.add_collection(LineCollection(list(shown), colors=INK, lw=1.4, capstyle="round"))
    panel.set(xlim=(profile.left, profile.left + width), ylim=(bottom, top), aspect="equal")
    panel.set_title(f"section y = {profile.y:.4g} µm, drawn to scale", fontsize=12, color=INK)
    panel.set_xlabel("x (µm)", fontsize=11, color=INK)
    panel.set_ylabel("z (µm)", fontsize=11, color=INK)
    panel.tick_params(labelsize=10)
    panel.locator_params(axis="y", nbins=3)
