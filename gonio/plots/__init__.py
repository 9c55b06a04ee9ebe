"""Figures of a measurement: lobes in three dimensions, slices in the plane of incidence, maps of the hemisphere.

The only importer of matplotlib and pyvista, both lazily. Every figure has the lamp on the left and the mirror direction
on the right, says what its units are and shows the noise where it can. matplotlib is used through `Figure` objects and
never through pyplot, so nothing global changes and no window opens. Files appear whole or not at all.
"""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gonio.sphere import direction
from microsurfaces.files import replacing

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from scipy.sparse import csr_array

    from gonio.compare import Verdict
    from gonio.detectors import Detector
    from gonio.measurement import Measurement
    from gonio.models import Model
    from microsurfaces import Mesh

Array = NDArray[np.float64]
PathLike = str | os.PathLike[str]

PANELS = 6
"""At most so many incidences share a figure."""
LAMP, MIRROR, INK, PAPER = "#d98200", "#0072b2", "#333333", "#e9e9e6"
"""The lamp, the mirror direction, lines and letters, the sample's plane: the same colours in every figure."""
COLOURS, ERRORS, DIFFERENCES = "viridis", "magma", "RdBu_r"
"""Colour maps of values, of their errors and of differences."""
PERCENT, SIGMAS = 50.0, 6.0
"""Largest differences that a map tells apart: in percent, and in standard errors."""
SPARSE = 10
"""Fewer hits than this say little; such bins are hatched where errors are shown."""


# --- What is shown ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Incidence:
    """One measured incidence: its angles in degrees and its part of the dataset."""

    theta: float
    phi: float
    data: xr.Dataset

    @property
    def words(self) -> str:
        return f"$\\theta_i$ = {self.theta:g}°, $\\phi_i$ = {self.phi:g}°"


def _incidences(measurement: Measurement) -> tuple[list[_Incidence], str]:
    """The measured incidences by azimuth and polar angle, evenly thinned to `PANELS`, and words that say so."""
    data = measurement.dataset
    measured = [(int(i), int(j)) for j, i in np.argwhere(measurement.measured.T)]
    if not measured:
        raise ValueError("no incidence of this measurement was measured: nothing to draw")
    chosen = np.unique(np.linspace(0, len(measured) - 1, min(PANELS, len(measured))).round().astype(int))
    incidences = [
        _Incidence(float(data["theta_i"][i]), float(data["phi_i"][j]), data.isel(theta_i=i, phi_i=j))
        for i, j in (measured[k] for k in chosen)
    ]
    return incidences, "" if len(chosen) == len(measured) else f"{len(chosen)} of {len(measured)} incidences"


def _wavelength(measurement: Measurement, wanted: float | None) -> float:
    """The measured wavelength nearest to `wanted`, or to the middle of the visible range, 550 nm."""
    wavelengths = np.asarray(measurement.wavelengths, float)
    return float(wavelengths[np.abs(wavelengths - (550.0 if wanted is None else wanted)).argmin()])


def _channel(measurement: Measurement, nm: float) -> str:
    """What the values at one of the measured wavelengths are called."""
    return measurement.channels[int(np.flatnonzero(measurement.wavelengths == nm)[0])]


def _channel_words(measurement: Measurement, nm: float) -> str:
    """The same for a title, where "R" alone would be a riddle."""
    name = _channel(measurement, nm)
    return name if name.endswith(" nm") else f"channel {name}"


def _counts(data: xr.Dataset) -> bool:
    """Whether hits were counted; they are not in a measurement that comes from elsewhere."""
    return "hits" in data


def _has_errors(measurement: Measurement) -> bool:
    """Whether any standard error is known."""
    return bool(np.isfinite(measurement.dataset["standard_error"].values).any())


def _has_hemisphere(measurement: Measurement) -> bool:
    return "dphi" in measurement.dataset.dims


def _shape(panels: int, incidences: Sequence[_Incidence]) -> tuple[int, int]:
    """(rows, columns) of the panels; one row an azimuth where that comes out even."""
    azimuths = len({incidence.phi for incidence in incidences})
    columns = panels // azimuths if azimuths > 1 and panels % azimuths == 0 else panels
    columns = columns if columns <= 3 else 2 if panels == 4 else 3
    return -(-panels // columns), columns


def _head(figure: Figure, measurement: Measurement, *parts: str) -> None:
    """The measurement's title above what this figure shows, in as many lines as the width asks for."""
    title = str(measurement.dataset.attrs.get("title", "")).strip()
    shown = ", ".join(part for part in parts if part)
    room = int(11 * figure.get_figwidth())
    lines = [line for text in (title, shown) for line in textwrap.wrap(text, room)]
    figure.suptitle("\n".join(lines).replace("$", r"\$"), fontsize=12, color=INK)


def _figure(width: float, height: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=150)
    FigureCanvasAgg(figure)
    figure.set_layout_engine("constrained", h_pad=0.07, w_pad=0.05)
    return figure


def _save(figure: Figure, path: PathLike) -> Path:
    path = Path(path)
    known = figure.canvas.get_supported_filetypes()
    if path.suffix.lower().removeprefix(".") not in known:
        raise ValueError(f"cannot draw into {str(path)!r}: the suffixes are {', '.join('.' + name for name in known)}")
    with replacing(path) as temporary:
        figure.savefig(temporary, facecolor="white")
    return path


# --- Lobes -----------------------------------------------------------------------------------------------------------

PATCH = 3.0
"""Degrees over which a lobe is averaged before it is drawn: bins near the pole are so small that they are all noise."""
VERTEX = 1.5
"""Degrees between the vertices of a lobe."""
CAMERA = direction(66.0, 112.0)
"""Toward the viewer, in the frame in which the lamp is at azimuth 0: the lamp is on the left."""
RIGHT = np.cross((0.0, 0.0, 1.0), CAMERA) / np.linalg.norm(np.cross((0.0, 0.0, 1.0), CAMERA))
UP = np.cross(CAMERA, RIGHT)
WINDOW = (-1.5, 1.5, -0.56, 1.5)
"""What the viewer sees: left, right, bottom, top in units of the outer arc."""


def lobes(measurement: Measurement, path: PathLike, wavelength: float | None = None) -> Path:
    """Draw the lobes, BRDF times cos(theta_o), as surfaces in space, one panel an incidence, and return the path.

    The radius in a direction is the light scattered into it: (1/sr), averaged over patches of about 3 degrees with
    the solid angle as weight. Radius and colour have one scale for all panels; it is logarithmic where a lobe is so
    narrow, or the panels so different, that a linear one would show a needle or nothing, and the figure says which.
    `wavelength` (nm; the nearest measured one) is 550 nm unless told. Rendered by VTK, or by matplotlib where no GL
    library is installed. Where nothing is known a lobe has a hole. Raises ValueError for a measurement without a
    hemisphere of bins.
    """
    if not _has_hemisphere(measurement):
        raise ValueError(
            "lobes need a hemisphere of bins, and this measurement was made with Apertures; "
            "draw slices, or measure with detector = HemisphereGrid"
        )
    incidences, choice = _incidences(measurement)
    nm = _wavelength(measurement, wavelength)
    shapes = [_Lobe.of(incidence.data, nm) for incidence in incidences]
    scale = _Scale.of(shapes)
    draw = _render if _can_render() else _paint
    rows, columns = _shape(len(shapes), incidences)
    figure = _figure(4.4 * columns + 0.9, 3.25 * rows + 0.95)
    panels = figure.subplots(rows, columns, squeeze=False)
    for panel, incidence, shape in zip(panels.flat, incidences, shapes, strict=False):
        draw(panel, incidence, shape, scale)
        _label(panel, incidence, scale)
    for panel in panels.flat:
        panel.set(xlim=WINDOW[:2], ylim=WINDOW[2:], aspect="equal")
        panel.set_axis_off()
    _head(
        figure,
        measurement,
        _channel_words(measurement, nm),
        scale.words,
        f"averaged over {_patch(measurement.dataset):.2g}° patches",
        "holes: nothing is known" if any(np.isnan(shape.value).any() for shape in shapes) else "",
        choice,
    )
    _colour_bar(figure, panels, scale.norm, r"BRDF $\cdot\,\cos\theta_o$  (sr⁻¹)")
    return _save(figure, path)


@dataclass(frozen=True, eq=False)
class _Lobe:
    """Scattered light per solid angle (1/sr) at the vertices of a closed surface over the hemisphere."""

    theta: Array
    """(rows,) degrees, from 0 to 90."""
    dphi: Array
    """(columns,) degrees."""
    value: Array
    """(rows, columns) BRDF times cosine, NaN where no bin around is known."""

    @classmethod
    def of(cls, data: xr.Dataset, nm: float) -> _Lobe:
        """Average the bins of one incidence around each vertex, weighted with the solid angle and a smooth patch."""
        from scipy.spatial import KDTree

        theta, dphi = np.arange(0.0, 90.01, VERTEX), np.arange(0.0, 360.0, VERTEX)
        light, solid, directions = _pieces(data, nm)
        known = np.isfinite(light)
        light, solid, directions = light[known], solid[known], directions[known]
        # The horizon gets no patch: the cosine leaves no light along it.
        vertices = direction(theta[:-1, None], dphi).reshape(-1, 3)
        reach = 2 * np.sin(np.radians(_patch(data)) / 2)
        pairs = KDTree(vertices).sparse_distance_matrix(KDTree(directions), reach, output_type="ndarray")
        weight = (1 - (pairs["v"] / reach) ** 2) ** 2
        sums = (np.bincount(pairs["i"], weight * x[pairs["j"]], minlength=len(vertices)) for x in (light, solid))
        with np.errstate(invalid="ignore"):
            value = np.divide(*sums).reshape(len(theta) - 1, len(dphi))
        return cls(theta, dphi, np.concatenate([value, np.zeros((1, len(dphi)))]))

    @property
    def solid_angle(self) -> float:
        """Albedo over peak: the solid angle (sr) that the lobe would fill at its peak value."""
        value = np.nan_to_num(self.value)
        weight = np.trapezoid(value.mean(axis=1) * np.sin(np.radians(self.theta)), np.radians(self.theta))
        return float(2 * np.pi * weight / max(self.peak, np.finfo(float).tiny))

    @property
    def peak(self) -> float:
        """The largest value."""
        return float(np.nanmax(self.value))

    def points(self, radius: Array) -> Array:
        """Vertices (rows, columns, 3) at `radius` (rows, columns) from the origin."""
        return radius[..., None] * direction(self.theta[:, None], self.dphi[None, :])


def _patch(data: xr.Dataset) -> float:
    """Degrees over which the bins are averaged: `PATCH`, or a bin where bins are larger."""
    return max(PATCH, 90 / data.sizes["theta_o"])


def _pieces(data: xr.Dataset, nm: float) -> tuple[Array, Array, Array]:
    """Light, solid angles (n,) and directions (n, 3) of the bins, cut into pieces of half a patch at most."""
    rings, sectors = (data[f"{name}_bounds"].values for name in ("theta_o", "dphi"))
    pieces = np.ceil(np.diff(rings, axis=1)[:, 0] / (PATCH / 2)).astype(int)
    edges = [np.linspace(low, high, n, endpoint=False) for (low, high), n in zip(rings, pieces, strict=True)]
    theta = np.radians(np.append(np.concatenate(edges), 90.0))
    cuts = int(np.ceil(360 / len(sectors) / (PATCH / 2)))
    dphi = np.linspace(sectors[0, 0], sectors[-1, 1], cuts * len(sectors), endpoint=False)
    step = np.radians(360 / len(dphi))
    brdf = data["brdf"].sel(order="all", wavelength=nm).transpose("theta_o", "dphi").values
    brdf = np.repeat(np.repeat(brdf, pieces, axis=0), cuts, axis=1)
    light = brdf * (np.diff(np.sin(theta) ** 2) / 2 * step)[:, None]
    solid = np.broadcast_to((-np.diff(np.cos(theta)) * step)[:, None], light.shape)
    middle = np.degrees(theta[1:] + theta[:-1]) / 2
    return light.ravel(), solid.ravel(), direction(middle[:, None], dphi + np.degrees(step) / 2).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class _Scale:
    """From a value (1/sr) to a radius in [0, 1] and a colour."""

    low: float
    high: float
    logarithmic: bool

    @classmethod
    def of(cls, shapes: Sequence[_Lobe]) -> _Scale:
        """One scale for all lobes: linear unless one of them is a needle or far smaller than another."""
        peaks = np.array([shape.peak for shape in shapes])
        high = float(peaks.max()) or 1.0
        needle = min(shape.solid_angle for shape in shapes) < 0.04
        logarithmic = bool(needle or peaks.min() < high / 8)
        return cls(high * 1e-3 if logarithmic else 0.0, high, logarithmic)

    def radius(self, value: Array) -> Array:
        if not self.logarithmic:
            return np.asarray(np.maximum(value, 0.0) / self.high)
        return np.asarray(1 + np.log10(np.maximum(value, self.low) / self.high) / 3)

    @property
    def norm(self) -> Normalize:
        from matplotlib.colors import LogNorm, Normalize

        return LogNorm(self.low, self.high) if self.logarithmic else Normalize(0.0, self.high)

    @property
    def words(self) -> str:
        if self.logarithmic:
            return f"logarithmic radius from {self.low:.2g} (centre) to {self.high:.2g} sr⁻¹ (arc)"
        return f"linear radius, arc at {self.high:.2g} sr⁻¹"

    def colours(self, value: Array) -> Array:
        """RGB in [0, 1], shape (..., 3)."""
        from matplotlib import colormaps

        clipped = np.clip(value, self.low, self.high)
        return np.asarray(colormaps[COLOURS](np.ma.filled(self.norm(clipped), 0.0))[..., :3])


def _on_screen(points: Array) -> Array:
    """Orthographic projection (..., 2) of points (..., 3) in the lamp's frame."""
    return np.stack([points @ RIGHT, points @ UP], axis=-1)


def _arrows(incidence: _Incidence) -> list[tuple[Array, Array, str]]:
    """(tail, head, colour) of the lamp's and the mirror's arrow outside the lobe."""
    lamp, mirror = direction(incidence.theta, 0.0), direction(incidence.theta, 180.0)
    # At normal incidence the two would hide each other.
    aside = np.array([0.05, 0.0, 0.0]) if incidence.theta < 4 else np.zeros(3)
    return [(1.36 * lamp + aside, 1.06 * lamp + aside, LAMP), (1.06 * mirror - aside, 1.36 * mirror - aside, MIRROR)]


def _guides(incidence: _Incidence) -> list[tuple[Array, str]]:
    """Polylines (n, 3) and colours: rings of theta_o on the plane, the arc of directions, rays, axes x and y."""
    around = np.linspace(0.0, 360.0, 181)
    rings = [(direction(90.0, around) * np.sin(np.radians(t)), "#b9b9b4") for t in (30, 60, 90)]
    arc = [(direction(np.linspace(-90.0, 90.0, 121), 0.0), "#8a8a86")]
    ticks = [(np.outer((0.975, 1.025), direction(t, 0.0)), "#8a8a86") for t in range(-60, 61, 30)]
    rays = [(np.outer((0.0, 1.0), direction(incidence.theta, phi)), c) for phi, c in ((0.0, LAMP), (180.0, MIRROR))]
    axes = [(np.outer((0.0, 1.0), direction(90.0, phi - incidence.phi)), "#b9b9b4") for phi in (0, 90, 180, 270)]
    return rings + axes + arc + ticks + rays


def _label(panel: Axes, incidence: _Incidence, scale: _Scale) -> None:
    """Words beside the arrows, the ticks of the arc, the axes, and the panel's title."""
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=2.5, foreground="white")]

    def write(point: Array, text: str, colour: str, size: float, align: str = "center") -> None:
        x, y = _on_screen(point)
        panel.text(x, y, text, color=colour, fontsize=size, ha=align, va="center", path_effects=halo)

    panel.set_title(incidence.words, fontsize=11, color=INK, y=0.97)
    lamp, mirror = direction(incidence.theta, 0.0), direction(incidence.theta, 180.0)
    apart = np.array([0.14, 0.0, 0.06]) if incidence.theta < 20 else np.array([0.0, 0.0, 0.1])
    write(1.40 * lamp + apart, "lamp", LAMP, 10, "right" if incidence.theta < 20 else "center")
    write(1.40 * mirror + apart * (-1, 1, 1), "mirror", MIRROR, 10, "left" if incidence.theta < 20 else "center")
    for theta in (-60, -30, 30, 60):
        if abs(abs(theta) - incidence.theta) > 7:
            before, at, after = _on_screen(direction(np.array([theta - 1.0, theta, theta + 1.0]), 180.0))
            across = (after - before)[::-1] * (-1, 1) / np.linalg.norm(after - before)
            x, y = at + 0.11 * across
            panel.text(x, y, f"{abs(theta)}°", color="#6b6b68", fontsize=8, ha="center", va="center")
    for phi, name in ((0.0, "x"), (90.0, "y")):
        azimuth = (phi - incidence.phi) % 360
        # Behind the lobe the axis would carry its name in front of it.
        azimuth, name = (azimuth - 180, f"$-${name}") if 225 < azimuth < 340 else (azimuth, name)
        write(1.12 * direction(90.0, azimuth), name, INK, 9)


def _colour_bar(figure: Figure, panels: Any, norm: Normalize, words: str, colours: str = COLOURS) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    bar = figure.colorbar(ScalarMappable(norm, colours), ax=list(np.ravel(panels)), shrink=0.85, aspect=28, pad=0.015)
    bar.set_label(words, fontsize=10, color=INK)
    low, high = float(norm.vmin or 0.0), float(norm.vmax or 1.0)
    if isinstance(norm, LogNorm) and high < 300 * low:
        rounds = np.outer(10.0 ** np.arange(-12, 12), (1, 2, 5)).ravel()
        ticks = rounds[(rounds >= low) & (rounds <= high)]
        bar.set_ticks(list(ticks), labels=[f"{tick:g}" for tick in ticks])
        bar.minorticks_off()
    bar.ax.tick_params(labelsize=9)


def _render(panel: Axes, incidence: _Incidence, shape: _Lobe, scale: _Scale) -> None:
    """Put the lobe, the plane, the guides and the arrows on `panel` as a picture rendered by VTK."""
    import pyvista as pv
    from vtkmodules.vtkCommonCore import vtkLogger

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    left, right, bottom, top = WINDOW
    width = 1400
    scene = pv.Plotter(
        off_screen=True, window_size=[width, round(width * (top - bottom) / (right - left))], lighting="light kit"
    )
    scene.add_mesh(
        pv.Disc(inner=0.0, outer=1.0, r_res=1, c_res=180).translate((0, 0, -0.012)), color=PAPER, lighting=False
    )
    for line, colour in _guides(incidence):
        scene.add_mesh(pv.lines_from_points(line).tube(radius=0.006), color=colour, lighting=False)
    for tail, head, colour in _arrows(incidence):
        length = float(np.linalg.norm(head - tail))
        arrow = pv.Arrow(
            start=tail, direction=head - tail, tip_length=0.35, tip_radius=0.13, shaft_radius=0.045, scale=length
        )
        scene.add_mesh(arrow, color=colour, ambient=0.3)
    scene.add_mesh(_surface(shape, scale), scalars="colour", rgb=True, smooth_shading=True, specular=0.12, ambient=0.22)
    focus = UP * (bottom + top) / 2
    scene.camera.position, scene.camera.focal_point, scene.camera.up = focus + 10 * CAMERA, focus, (0.0, 0.0, 1.0)
    scene.camera.parallel_projection = True
    scene.camera.parallel_scale = (top - bottom) / 2
    scene.enable_anti_aliasing("ssaa")
    picture = np.asarray(scene.screenshot(return_img=True))
    scene.close()
    panel.imshow(picture, extent=WINDOW, interpolation="antialiased")


def _surface(shape: _Lobe, scale: _Scale) -> Any:
    """The lobe as a pyvista PolyData with the colours of its vertices in `colour`."""
    import pyvista as pv

    points = shape.points(scale.radius(shape.value)).reshape(-1, 3)
    number = np.arange(len(points)).reshape(shape.value.shape)
    # One vertex is the pole, so that it has one normal.
    number[0] = 0
    after = np.roll(number, -1, axis=1)
    corners = np.stack([number[:-1], number[1:], after[1:], after[:-1]], axis=-1).reshape(-1, 4)
    known = np.isfinite(shape.value).ravel()
    corners = corners[known[corners].all(axis=1)]
    mesh = pv.PolyData(np.where(known[:, None], points, 0.0), np.insert(corners, 0, 4, axis=1))
    mesh["colour"] = np.rint(255 * scale.colours(np.nan_to_num(shape.value))).astype(np.uint8).reshape(-1, 3)
    # The facets that meet at the origin would mislead a search for a consistent orientation.
    return mesh.compute_normals(cell_normals=False, consistent_normals=False, split_vertices=False)


def _paint(panel: Axes, incidence: _Incidence, shape: _Lobe, scale: _Scale) -> None:
    """The same picture as `_render`'s, painted by matplotlib from back to front."""
    from matplotlib.collections import PolyCollection

    plane = _on_screen(direction(90.0, np.linspace(0.0, 360.0, 181)))
    panel.fill(*plane.T, color=PAPER, lw=0)
    for line, colour in _guides(incidence):
        panel.plot(*_on_screen(line).T, color=colour, lw=1.1, solid_capstyle="round")
    corners, colours = _facets(shape, scale)
    depth = np.argsort(corners.mean(axis=1) @ CAMERA)
    corners, colours = _on_screen(corners[depth]), colours[depth]
    panel.add_collection(PolyCollection(list(corners), facecolors=colours, edgecolors=colours, lw=0.4, zorder=3))
    for tail, head, colour in _arrows(incidence):
        style = {"arrowstyle": "-|>", "color": colour, "lw": 2.5, "mutation_scale": 16, "shrinkA": 0, "shrinkB": 0}
        panel.annotate("", tuple(_on_screen(head)), tuple(_on_screen(tail)), arrowprops=style, zorder=4)


def _facets(shape: _Lobe, scale: _Scale) -> tuple[Array, Array]:
    """Corners (n, 4, 3) and shaded colours (n, 3) of the lobe's facets, thinned to about 4 degrees in azimuth."""
    every = max(1, len(shape.dphi) // 90)
    points = shape.points(scale.radius(shape.value))[:, ::every]
    value = shape.value[:, ::every]
    p, v = np.concatenate([points, points[:, :1]], axis=1), np.concatenate([value, value[:, :1]], axis=1)
    corners = np.stack([p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    known = np.isfinite(corners).reshape(-1, 12).all(axis=1)
    corners = corners[known]
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    length = np.linalg.norm(normals, axis=1)
    # Lit from the upper left behind the viewer, as VTK's key light is.
    key = (CAMERA - 0.5 * RIGHT + 0.6 * UP) / np.linalg.norm(CAMERA - 0.5 * RIGHT + 0.6 * UP)
    light = 0.45 + 0.55 * np.maximum(normals @ key / np.where(length > 0, length, 1.0), 0.0)
    middle = (v[:-1, :-1] + v[1:, :-1] + v[1:, 1:] + v[:-1, 1:]).ravel()[known] / 4
    return corners, scale.colours(middle) * light[:, None]


@cache
def _can_render() -> bool:
    """Whether VTK can draw off screen; tried in a process of its own, which without a GL library is killed."""
    trial = "import pyvista; pyvista.Plotter(off_screen=True, window_size=(8, 8)).screenshot(return_img=True)"
    try:
        return subprocess.run([sys.executable, "-c", trial], capture_output=True, timeout=120).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


# --- Slices in the plane of incidence --------------------------------------------------------------------------------

BAND = 1.0
"""Degrees of arc on either side of the plane of incidence that a slice averages over."""
DECADES = 4
"""A slice shows at most so many decades."""
CURVES = 5
"""At most so many wavelengths share a panel."""
STYLES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1.2, 1.4)), (0, (6, 2, 1.2, 2)))
"""Lines of all orders together and of the first few numbers of hits."""
MARKERS = "osD^vP"


def slices(measurement: Measurement, path: PathLike, models: Sequence[Model] = ()) -> Path:
    """Draw the BRDF in the plane of incidence against the signed angle theta_o and return the path.

    The mirror's side is positive. Every value is the average over the bins within about 1 degree of arc from the plane,
    with a band of two standard errors: Monte-Carlo noise of the bins is taken as independent, realisation noise as
    common to all of them. Wavelengths have their colours, orders of scattering their line styles; `models`, averaged
    over the same bins, are markers, to be held against order 1. Apertures within their own half angle of the plane are
    points with error bars of two standard errors. A measurement that comes from elsewhere has no orders, and bands only
    if its errors are known.
    """
    incidences, choice = _incidences(measurement)
    wavelengths, fewer = _some_wavelengths(measurement)
    cuts = [_Cut.of(measurement, incidence) for incidence in incidences]
    rows, columns = _shape(len(incidences), incidences)
    figure = _figure(4.2 * columns + 2.0, 3.2 * rows + 0.9)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    draw = _curves if _has_hemisphere(measurement) else _points
    for panel, incidence, cut in zip(panels.flat, incidences, cuts, strict=False):
        draw(panel, incidence, cut, wavelengths)
        for k, model in enumerate(models[: len(MARKERS)]):
            values = model.average(direction(incidence.theta, incidence.phi), measurement.detector, wavelengths)
            _model_points(panel, cut, values, wavelengths, MARKERS[k], k / len(models))
        _mark_slice(panel, incidence)
    _slice_axes(panels, incidences, cuts)
    handles = _slice_legend(measurement, wavelengths, models)
    figure.legend(handles=handles, loc="outside right center", fontsize=9, frameon=False, handlelength=2.8)
    told = _has_hemisphere(measurement) and _counts(measurement.dataset)
    sparse = f"drawn where there are at least {SPARSE} hits" if told else ""
    _head(figure, measurement, "BRDF in the plane of incidence", sparse, choice, fewer)
    return _save(figure, path)


def _some_wavelengths(measurement: Measurement) -> tuple[list[float], str]:
    """At most `CURVES` of the measured wavelengths, evenly thinned, and words that say so."""
    wavelengths = [float(nm) for nm in measurement.wavelengths]
    chosen = np.unique(np.linspace(0, len(wavelengths) - 1, min(CURVES, len(wavelengths))).round().astype(int))
    words = "" if len(chosen) == len(wavelengths) else f"{len(chosen)} of {len(wavelengths)} wavelengths"
    return [wavelengths[k] for k in chosen], words


@dataclass(frozen=True, eq=False)
class _Cut:
    """The bins that lie in a plane of incidence."""

    angle: Array
    """(n,) signed theta_o in degrees, increasing; the mirror's side is positive."""
    weights: csr_array
    """(n, bins) share of each bin in the average at an angle."""

    @classmethod
    def of(cls, measurement: Measurement, incidence: _Incidence) -> _Cut:
        from scipy.sparse import csr_array

        select = _sectors_in_plane if _has_hemisphere(measurement) else _apertures_in_plane
        points = sorted(select(incidence, measurement.detector), key=lambda point: point[0])
        area = incidence.data["projected_solid_angle"].values.ravel()
        counts = [len(bins) for _, bins in points]
        bins = np.concatenate([bins for _, bins in points]) if points else np.zeros(0, int)
        share = np.concatenate([area[bins] / area[bins].sum() for _, bins in points]) if points else np.zeros(0)
        weights = csr_array((share, bins, np.cumsum([0, *counts])), shape=(len(points), len(area)))
        return cls(np.array([angle for angle, _ in points]), weights)

    def read(self, data: xr.Dataset, order: str, nm: float) -> tuple[Array, Array]:
        """Averages (n,) and their standard errors."""
        chosen = data.sel(order=order, wavelength=nm)
        value, whole, mc = (chosen[name].values.ravel() for name in ("brdf", "standard_error", "standard_error_mc"))
        realisation = np.sqrt(np.maximum(whole**2 - mc**2, 0.0))
        known = np.isfinite(value)
        weights = self.weights if known.all() else self._among(known)
        value, mc, realisation = (np.where(known, x, 0.0) for x in (value, mc, realisation))
        error = np.hypot(np.sqrt(weights.power(2) @ mc**2), weights @ realisation)
        return np.asarray(weights @ value), np.asarray(error)

    def _among(self, known: NDArray[np.bool_]) -> csr_array:
        """The weights of averages over the bins that are known, NaN where none is."""
        from scipy.sparse import csr_array

        share = self.weights @ known.astype(np.float64)
        scale = np.divide(1.0, share, out=np.full(share.shape, np.nan), where=share > 0.0)
        kept = self.weights.multiply(known).multiply(scale[:, None])
        return csr_array(kept)

    def enough(self, data: xr.Dataset, order: str) -> NDArray[np.bool_]:
        """Whether each average (n,) rests on `SPARSE` hits at least; all do where nobody counted."""
        if not _counts(data):
            return np.ones(len(self.angle), bool)
        return np.asarray(self.weights.sign() @ data["hits"].sel(order=order).values.ravel() >= SPARSE)


def _sectors_in_plane(incidence: _Incidence, _: Detector) -> Iterator[tuple[float, NDArray[np.intp]]]:
    """Signed angle and bins of every ring on the lamp's and on the mirror's side."""
    theta, dphi = incidence.data["theta_o"].values, incidence.data["dphi"].values
    sectors = len(dphi)
    for ring, t in enumerate(theta):
        arc = np.sin(np.radians(t))
        reach = max(BAND - 180 / sectors * arc, 0.0) + 1e-9
        for sign, azimuth in ((-1, 0.0), (1, 180.0)):
            away = np.abs((dphi - azimuth + 180) % 360 - 180)
            # The polar cap lies on both sides: all of it makes one point.
            if t > 0 or sign > 0:
                yield sign * t, ring * sectors + np.flatnonzero(away * arc <= reach)


def _apertures_in_plane(incidence: _Incidence, detector: Detector) -> Iterator[tuple[float, NDArray[np.intp]]]:
    """Signed angle and number of every aperture whose axis is within its half angle of the plane."""
    theta = incidence.data["theta_o"].values
    wo = direction(theta, incidence.data["phi_o"].values - incidence.phi)
    for k in np.flatnonzero(np.abs(wo[:, 1]) <= np.sin(np.radians(getattr(detector, "half_angle", 0.0))) + 1e-12):
        yield (-theta[k] if wo[k, 0] > 1e-12 else theta[k]), np.array([k])


def _curves(panel: Axes, incidence: _Incidence, cut: _Cut, wavelengths: Sequence[float]) -> None:
    for order, style in _styled(incidence.data).items():
        whole, enough = order == "all", cut.enough(incidence.data, order)
        for nm in wavelengths:
            value, error = cut.read(incidence.data, order, nm)
            value = np.where(enough & (value > 0), value, np.nan)
            panel.plot(cut.angle, value, ls=style, color=_hue(nm), lw=1.6 if whole else 1.0)
            panel.plot(cut.angle, _alone(value), ".", color=_hue(nm), ms=7 if whole else 4)
            low, high = np.maximum(value - 2 * error, np.finfo(float).tiny), value + 2 * error
            panel.fill_between(cut.angle, low, high, color=_hue(nm), alpha=0.3 if whole else 0.15, lw=0)


def _alone(value: Array) -> Array:
    """`value` where it has no neighbour to draw a line to, else NaN: the one bin of a mirror."""
    known = np.pad(np.isfinite(value), 1)
    return np.where(known[:-2] | known[2:], np.nan, value)


def _points(panel: Axes, incidence: _Incidence, cut: _Cut, wavelengths: Sequence[float]) -> None:
    if not len(cut.angle):
        panel.text(0.5, 0.5, "no aperture in this plane", transform=panel.transAxes, ha="center", color=INK)
    for nm in wavelengths:
        value, error = cut.read(incidence.data, "all", nm)
        value = np.where(value > 0, value, np.nan)
        panel.errorbar(cut.angle, value, 2 * error, fmt=".", color=_hue(nm), ms=6, capsize=2, lw=1)


def _model_points(
    panel: Axes, cut: _Cut, values: Array, wavelengths: Sequence[float], marker: str, shift: float
) -> None:
    """Markers on every few bins, `shift` of the way to the next, so that those of several models interleave."""
    every = max(1, len(cut.angle) // 20)
    shown = slice(round(shift * every), None, every)
    for nm, value in zip(wavelengths, (cut.weights @ values).T, strict=True):
        value = np.where(value > 0, value, np.nan)
        panel.plot(cut.angle[shown], value[shown], marker, ms=3.6, mfc="white", mec=_hue(nm), mew=0.9, zorder=3)


def _mark_slice(panel: Axes, incidence: _Incidence) -> None:
    """The lamp on the upper edge, the mirror direction on the lower, and the panel's title."""
    edge = panel.get_xaxis_transform()
    for angle, at, marker, colour in ((-incidence.theta, 1.0, "v", LAMP), (incidence.theta, 0.0, "^", MIRROR)):
        panel.axvline(angle, color=colour, lw=0.8, alpha=0.6, zorder=0)
        panel.plot(angle, at, marker=marker, color=colour, transform=edge, clip_on=False, ms=8, zorder=5)
    panel.set_title(incidence.words, fontsize=11, color=INK, pad=9)


def _slice_axes(panels: Any, incidences: Sequence[_Incidence], cuts: Sequence[_Cut]) -> None:
    """Limits from the data, labels on the outer panels, nothing on the empty ones."""
    columns, used = panels.shape[1], len(incidences)
    low, high = _value_limits(incidences, cuts)
    for k, panel in enumerate(panels.flat):
        if k >= used:
            panel.set_axis_off()
            continue
        panel.set(yscale="log", xlim=(-90, 90), xticks=range(-90, 91, 30), ylim=(low, high))
        panel.grid(color="#dddddd", lw=0.6)
        panel.tick_params(labelsize=9, labelbottom=k + columns >= used)
        if k + columns >= used:
            panel.set_xlabel("$\\theta_o$ (degrees), lamp's side < 0 < mirror's", fontsize=10)
        if k % columns == 0:
            panel.set_ylabel("BRDF (sr⁻¹)", fontsize=10)


def _value_limits(incidences: Sequence[_Incidence], cuts: Sequence[_Cut]) -> tuple[float, float]:
    """From half the smallest value with enough hits, but `DECADES` down at most, to twice the largest."""
    shown = []
    for incidence, cut in zip(incidences, cuts, strict=True):
        for order in _styled(incidence.data):
            enough = cut.enough(incidence.data, order)
            wavelengths = incidence.data["wavelength"].values
            shown += [cut.read(incidence.data, order, nm)[0][enough] for nm in wavelengths]
    positive = np.concatenate(shown)
    positive = positive[positive > 0]
    high = 2 * float(positive.max(initial=0.0)) or 1.0
    return min(max(float(positive.min(initial=high)) / 2, high / 10**DECADES), high / 10), high


def _styled(data: xr.Dataset) -> dict[str, Any]:
    """The orders that are drawn, with their lines."""
    return dict(zip(map(str, data["order"].values), STYLES, strict=False))


def _hits(order: str) -> str:
    """An order of scattering in words."""
    words = {"all": "all orders", "1": "1 hit"}
    return words.get(order, f"{order[:-1]} and more hits" if order.endswith("+") else f"{order} hits")


def _slice_legend(measurement: Measurement, wavelengths: Sequence[float], models: Sequence[Model]) -> list[Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Artist] = [
        Line2D([], [], color=_hue(nm), lw=2.5, label=_channel(measurement, nm)) for nm in wavelengths
    ]
    if _has_hemisphere(measurement) and _counts(measurement.dataset):
        styles = _styled(measurement.dataset).items()
        handles += [Line2D([], [], color=INK, ls=style, lw=1.3, label=_hits(order)) for order, style in styles]
    if _has_errors(measurement):
        handles.append(Patch(color=INK, alpha=0.25, lw=0, label="± 2 standard errors"))
    point: dict[str, Any] = {"color": INK, "mfc": "white", "ls": "none", "ms": 5}
    for model, marker in zip(models, MARKERS, strict=False):
        handles.append(Line2D([], [], marker=marker, label=f"{type(model).__name__} ({_hits(model.order)})", **point))
    handles.append(Line2D([], [], marker="v", color=LAMP, ls="none", ms=8, label="lamp"))
    handles.append(Line2D([], [], marker="^", color=MIRROR, ls="none", ms=8, label="mirror direction"))
    return handles


def _hue(nm: float) -> tuple[float, float, float]:
    """The spectral hue of a wavelength, dark enough for a white page; greys outside the visible range."""
    if not 380 <= nm <= 780:
        return (0.45, 0.45, 0.5) if nm < 380 else (0.3, 0.25, 0.25)
    nodes = (380, 420, 450, 480, 500, 530, 555, 580, 600, 620, 660, 780)
    red = (0.42, 0.40, 0.13, 0.00, 0.00, 0.05, 0.25, 0.75, 0.88, 0.86, 0.78, 0.45)
    green = (0.10, 0.12, 0.30, 0.55, 0.60, 0.60, 0.58, 0.55, 0.42, 0.20, 0.05, 0.00)
    blue = (0.60, 0.75, 0.85, 0.80, 0.55, 0.25, 0.05, 0.00, 0.00, 0.10, 0.12, 0.05)
    r, g, b = (float(np.interp(nm, nodes, channel)) for channel in (red, green, blue))
    return r, g, b


# --- Maps of the hemisphere ------------------------------------------------------------------------------------------


def hemisphere(measurement: Measurement, path: PathLike, wavelength: float | None = None) -> Path:
    """Draw the BRDF over the hemisphere and below it its relative standard error, and return the path.

    One column an incidence. The hemisphere is seen from above, the radius is theta_o, the lamp's side is on the left
    and dphi runs counter-clockwise. Colours are logarithmic. Bins that no light reached, and in the lower row bins with
    fewer than 10 hits, are hatched. `wavelength` (nm; the nearest measured one) is 550 nm unless told. Apertures are
    drawn as discs. A measurement that comes from elsewhere has the lower row only if its errors are known.
    """
    incidences, choice = _incidences(measurement)
    nm = _wavelength(measurement, wavelength)
    maps = [_Map.of(incidence.data, nm) for incidence in incidences]
    rows = 2 if _has_errors(measurement) else 1
    kinds = list(zip(_map_norms(maps), (COLOURS, ERRORS), ("BRDF (sr⁻¹)", "relative standard error (%)"), strict=True))
    figure, panels = _maps(rows, len(maps))
    draw = _draw_bins if _has_hemisphere(measurement) else _draw_apertures
    for column, incidence, shown in zip(panels.T, incidences, maps, strict=True):
        for panel, values, (norm, colours, _) in zip(column, (shown.value, shown.error), kinds, strict=False):
            draw(panel, incidence, measurement.detector, values, norm, colours)
            _mark_map(panel, incidence)
        column[0].set_title(incidence.words, fontsize=11, color=INK, pad=12)
    for row, (norm, colours, words) in zip(panels, kinds, strict=False):
        _colour_bar(figure, row, norm, words, colours)
    blank = "hatched" if _has_hemisphere(measurement) else "white"
    if _counts(measurement.dataset):
        order, blanks = ", all orders", f"{blank} above: no hits, below: fewer than {SPARSE}"
    else:
        order, blanks = "", f"{blank}: nothing is known, or no light"
    _head(figure, measurement, f"{_channel_words(measurement, nm)}{order}", blanks, choice)
    figure.legend(handles=_map_legend(), loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return _save(figure, path)


def _maps(rows: int, columns: int) -> tuple[Figure, Any]:
    """A figure and its panels (rows, columns), hemispheres seen from above."""
    figure = _figure(2.75 * columns + 1.6, 6.6 if rows > 1 else 3.9)
    return figure, figure.subplots(rows, columns, squeeze=False, subplot_kw={"projection": "polar"})


@dataclass(frozen=True, eq=False)
class _Map:
    """What is drawn for one incidence; NaN where it is hatched."""

    value: Array
    error: Array
    """Relative standard error in percent."""

    @classmethod
    def of(cls, data: xr.Dataset, nm: float) -> _Map:
        chosen = data.sel(order="all", wavelength=nm)
        brdf, error = (chosen[name].values for name in ("brdf", "standard_error"))
        value = np.where(brdf > 0, brdf, np.nan)
        sure = chosen["hits"].values >= SPARSE if _counts(data) else True
        return cls(value, np.where(sure, 100 * error / value, np.nan))


def _map_norms(maps: Sequence[_Map]) -> tuple[Normalize, Normalize]:
    """Logarithmic colour scales of the values and of their errors."""
    values, errors = (np.concatenate([getattr(m, name).ravel() for m in maps]) for name in ("value", "error"))
    return _log_norm(values), _log_norm(np.minimum(errors, 100.0))


def _log_norm(values: Array) -> Normalize:
    """From the lowest values, a few noisy ones left out, to the highest: half a decade to `DECADES`."""
    from matplotlib.colors import LogNorm

    values = values[values > 0]
    high = float(values.max(initial=0.0)) or 1.0
    low = float(np.quantile(values, 0.02)) if values.size else high
    return LogNorm(min(max(low, high / 10**DECADES), high / 3), high, clip=True)


def _draw_bins(panel: Axes, incidence: _Incidence, _: Detector, shown: Array, norm: Normalize, colours: str) -> None:
    theta, dphi = (incidence.data[name].values for name in ("theta_o_bounds", "dphi_bounds"))
    # matplotlib joins corners by straight lines: wide sectors are cut into pieces that look round.
    pieces = -(-120 // len(dphi))
    around = np.linspace(dphi[0, 0], dphi[-1, 1], pieces * len(dphi) + 1)
    masked = np.ma.masked_invalid(np.repeat(shown, pieces, axis=1))
    edges = np.append(theta[:, 0], theta[-1, 1])
    panel.pcolormesh(np.radians(around), edges, masked, norm=norm, cmap=colours, rasterized=True)


def _draw_apertures(
    panel: Axes, incidence: _Incidence, detector: Detector, shown: Array, norm: Normalize, colours: str
) -> None:
    from matplotlib import colormaps

    around = np.linspace(0, 2 * np.pi, 25)
    radius = getattr(detector, "half_angle", 1.0)
    theta, phi = incidence.data["theta_o"].values, incidence.data["phi_o"].values - incidence.phi
    for t, p, value in zip(theta, np.radians(phi), shown, strict=True):
        x, y = t * np.cos(p) + radius * np.cos(around), t * np.sin(p) + radius * np.sin(around)
        colour = colormaps[colours](norm(value)) if np.isfinite(value) else "white"
        panel.fill(np.arctan2(y, x), np.hypot(x, y), facecolor=colour, edgecolor=INK, lw=0.4)


def _mark_map(panel: Any, incidence: _Incidence) -> None:
    """Orientation, rings, the hatching of the ground, the lamp and the mirror direction."""
    from matplotlib.patheffects import withStroke

    panel.set_theta_zero_location("W")
    panel.set_ylim(0, 90)
    panel.set_yticks([30, 60, 90], labels=["30°", "60°", ""], fontsize=8, color=INK)
    for label in panel.get_yticklabels():
        label.set_path_effects([withStroke(linewidth=2, foreground="white", alpha=0.8)])
    panel.set_rlabel_position(70)
    panel.set_xticks(np.radians([0, 90, 180, 270]), labels=["0°", "90°", "180°", ""], fontsize=8)
    panel.tick_params(axis="x", pad=0)
    panel.grid(color="black", lw=0.4, alpha=0.35)
    panel.patch.set(facecolor="#e6e6e6", hatch="////", edgecolor="#b0b0b0")
    # Hollow, so that the one bin of a mirror shows.
    style = {"mfc": "none", "mew": 1.6, "clip_on": False, "zorder": 6}
    halo = [withStroke(linewidth=3.2, foreground="white")]
    panel.plot(0.0, incidence.theta, "v", mec=LAMP, ms=10, path_effects=halo, **style)
    panel.plot(np.pi, incidence.theta, "^", mec=MIRROR, ms=10, path_effects=halo, **style)


def _map_legend() -> list[Artist]:
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], marker="v", mec=LAMP, mfc="none", mew=1.6, ls="none", ms=9, label="lamp (dphi = 0°)"),
        Line2D(
            [], [], marker="^", mec=MIRROR, mfc="none", mew=1.6, ls="none", ms=9, label="mirror direction (dphi = 180°)"
        ),
    ]


def difference(measurement: Measurement, verdict: Verdict, path: PathLike, wavelength: float | None = None) -> Path:
    """Draw where a model is above or below what was measured, and below it how sure that is; return the path.

    Laid out as `hemisphere`. Above, model / measured - 1 in percent; below, model - measured in standard errors of the
    pool of bins that is judged together: up to 3 may be chance. Red is too much, blue too little; bins that no light
    reached are hatched. `verdict` is what `compare` found for `measurement`; without errors there is nothing below.
    """
    from matplotlib.colors import Normalize

    incidences, choice = _incidences(measurement)
    nm = _wavelength(measurement, wavelength)
    figure, panels = _maps(2 if _has_errors(measurement) else 1, len(incidences))
    draw = _draw_bins if _has_hemisphere(measurement) else _draw_apertures
    norms = Normalize(-PERCENT, PERCENT, clip=True), Normalize(-SIGMAS, SIGMAS, clip=True)
    for column, incidence in zip(panels.T, incidences, strict=True):
        here = verdict.lobes.sel(theta_i=incidence.theta, phi_i=incidence.phi, wavelength=nm)
        measured, model = here["measured"].values, here["model"].values
        there = measured > 0
        relative = 100 * (model / np.where(there, measured, np.nan) - 1)
        significance = np.where(there | (model > 0), -here["significance"].values, np.nan)
        for panel, shown, norm in zip(column, (relative, significance), norms, strict=False):
            draw(panel, incidence, measurement.detector, shown, norm, DIFFERENCES)
            _mark_map(panel, incidence)
        column[0].set_title(incidence.words, fontsize=11, color=INK, pad=12)
    words = "model / measured - 1 (%)", "model - measured (standard errors)"
    for row, norm, what in zip(panels, norms, words, strict=False):
        _colour_bar(figure, row, norm, what, DIFFERENCES)
    counted = _counts(measurement.dataset)
    order = f", {_hits(verdict.order)}" if counted else ""
    blank = "hatched: no hits" if counted else "hatched: nothing is known, or no light"
    _head(figure, measurement, type(verdict.model).__name__, f"{_channel_words(measurement, nm)}{order}", blank, choice)
    figure.legend(handles=_map_legend(), loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return _save(figure, path)


# --- The surface itself ----------------------------------------------------------------------------------------------


def show(mesh: Mesh) -> None:
    """Open a window with one period of a surface, true to scale and coloured by height; return when it is closed.

    Raises RuntimeError where there is no screen, or no GL library to draw with.
    """
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise RuntimeError("there is no screen to open a window on (DISPLAY is not set): save the surface to a file")
    if not _can_render():
        raise RuntimeError("there is no GL library to draw with: install libegl1 and libgl1-mesa-dri (names in Debian)")
    import pyvista

    faces: Any = mesh.faces.astype(np.int64)
    surface = pyvista.PolyData.from_regular_faces(mesh.vertices, faces)
    surface["height (µm)"] = mesh.vertices[:, 2]
    plotter: Any = pyvista.Plotter()
    plotter.add_mesh(surface, cmap=COLOURS)
    plotter.add_axes()
    plotter.show()
