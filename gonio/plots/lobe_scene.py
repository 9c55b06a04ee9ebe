"""The scene in which lobes stand: plane, guides, arrows and words around them, drawn by VTK or by matplotlib.

The viewer looks from the side with the incident direction on the left; coordinates are those in which that direction is
at azimuth 0, in units of the outer arc.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from gonio.plots import style
from gonio.plots.patches import DPHI, THETA
from gonio.plots.style import COLOURS, INK, PAPER, SOURCE, SPECULAR, Incidence
from gonio.plots.surface_view import require_screen
from gonio.sphere import direction, rotate_z
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize

    from microsurfaces import HeightField

CAMERA = direction(66.0, 112.0)
"""Toward the viewer: the incident direction is on the left."""
RIGHT = np.cross((0.0, 0.0, 1.0), CAMERA) / np.linalg.norm(np.cross((0.0, 0.0, 1.0), CAMERA))
UP = np.cross(CAMERA, RIGHT)
WINDOW = (-1.5, 1.5, -0.56, 1.5)
"""What the viewer sees: left, right, bottom, top."""
LOG_DECADES = 3
"""From the centre of a logarithmic lobe to the arc."""
GROUND = "#b4bac0"
"""A relief under a lobe."""


@dataclass(frozen=True, eq=False)
class Shell:
    """One lobe: scattered light per solid angle at the vertices of `patches`, and how it is painted."""

    value: Floats
    """(rows, columns) BRDF times cosine in 1/sr, NaN where no bin around is known."""
    paint: Floats | str | None = None
    """Colours of the vertices (rows, columns, 3), one colour for all, or those of the value."""
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class View:
    """What one panel shows."""

    title: str
    incidences: Sequence[Incidence]
    """Of one azimuth; each has its arrows."""
    shells: Sequence[Shell]
    legend: Mapping[str, str] = field(default_factory=dict)
    """What colours mean that are not those of a colour bar."""
    differs: bool = False
    """Whether the colours are those of a difference."""


@dataclass(frozen=True, eq=False)
class Scale:
    """From a value (1/sr) to a radius in [0, 1] and a colour."""

    low: float
    high: float
    logarithmic: bool

    @classmethod
    def of(cls, values: Sequence[Floats], radius: Literal["linear", "log"] | None = None) -> Scale:
        """One scale for all lobes: linear unless told, or one of them is a needle or far smaller than another."""
        peaks = np.array([np.nanmax(value) for value in values])
        high = float(peaks.max())
        high = high if high > 0 else 1.0
        if radius is None:
            needle = min(solid_angle(value) for value in values) < 0.04
            radius = "log" if needle or peaks.min() < high / 8 else "linear"
        logarithmic = radius == "log"
        return cls(high / 10**LOG_DECADES if logarithmic else 0.0, high, logarithmic)

    def radius(self, value: Floats) -> Floats:
        """Distance from the origin at which a value is drawn."""
        if not self.logarithmic:
            return np.asarray(np.maximum(value, 0.0) / self.high)
        return np.asarray(1 + np.log10(np.maximum(value, self.low) / self.high) / LOG_DECADES)

    @property
    def norm(self) -> Normalize:
        """The same for matplotlib's colours."""
        from matplotlib.colors import LogNorm, Normalize

        return LogNorm(self.low, self.high) if self.logarithmic else Normalize(0.0, self.high)

    @property
    def words(self) -> str:
        """What a caption says."""
        if self.logarithmic:
            return f"logarithmic radius from {self.low:.2g} (centre) to {self.high:.2g} sr⁻¹ (arc)"
        return f"linear radius, arc at {self.high:.2g} sr⁻¹"

    def colours(self, value: Floats) -> Floats:
        """RGB in [0, 1], shape (..., 3)."""
        from matplotlib import colormaps

        clipped = np.clip(value, self.low, self.high)
        return np.asarray(colormaps[COLOURS](np.ma.filled(self.norm(clipped), 0.0))[..., :3])


def solid_angle(value: Floats) -> float:
    """Albedo over peak: the solid angle (sr) that a lobe would fill at its peak value."""
    theta, known = np.radians(THETA), np.nan_to_num(value)
    weight = np.trapezoid(known.mean(axis=1) * np.sin(theta), theta)
    return float(2 * np.pi * weight / max(float(np.nanmax(value)), np.finfo(float).tiny))


@dataclass(frozen=True, eq=False)
class Ground:
    """A piece of relief under the lobe, true to scale and hugely enlarged."""

    points: Floats
    """(ny, nx, 3), highest just below the plane, x along azimuth 0 of the specimen."""
    words: str

    NODES = 97
    """Along either side of the piece."""
    SIDE = 1.36
    """Its width in the scene: its corners lie on the ring of the horizon."""

    @classmethod
    def of(cls, relief: HeightField) -> Ground:
        """The middle of a tile."""
        ny, nx = (min(n, cls.NODES) for n in relief.heights.shape)
        rows, columns = ((whole - n) // 2 for whole, n in zip(relief.heights.shape, (ny, nx), strict=True))
        z = relief.heights[rows : rows + ny, columns : columns + nx]
        x, y = np.arange(nx) * relief.spacing[0], np.arange(ny) * relief.spacing[1]
        width = max(x[-1], y[-1])
        x, y = np.meshgrid(x - x[-1] / 2, y - y[-1] / 2)
        points = np.stack([x, y, z - z.max()], axis=-1) * (cls.SIDE / width) - (0.0, 0.0, 0.015)
        return cls(points, f"relief under the lobe {width:.3g} µm wide, true to scale")

    def turned(self, phi: float) -> Floats:
        """The points where the azimuth `phi` of the incident direction is 0."""
        return rotate_z(self.points, -phi)


# --- Shapes ----------------------------------------------------------------------------------------------------------


def colours_of(shell: Shell, scale: Scale) -> Floats:
    """RGB in [0, 1] of the vertices (rows, columns, 3)."""
    from matplotlib.colors import to_rgb

    if shell.paint is None:
        return scale.colours(np.nan_to_num(shell.value))
    if isinstance(shell.paint, str):
        return np.broadcast_to(to_rgb(shell.paint), (*shell.value.shape, 3))
    return shell.paint


def vertices(shell: Shell, scale: Scale) -> Floats:
    """Points (rows, columns, 3) of a lobe."""
    return np.asarray(scale.radius(shell.value)[..., None] * direction(THETA[:, None], DPHI))


def surface(shell: Shell, scale: Scale) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Points (n, 3), quadrangles (m, 4) and the points' colours (n, 3) of a lobe, holes left out."""
    points = vertices(shell, scale).reshape(-1, 3)
    number = np.arange(len(points)).reshape(shell.value.shape)
    # One vertex is the pole, so that it has one normal.
    number[0] = 0
    after = np.roll(number, -1, axis=1)
    corners = np.stack([number[:-1], number[1:], after[1:], after[:-1]], axis=-1).reshape(-1, 4)
    known = np.isfinite(shell.value).ravel()
    corners = corners[known[corners].all(axis=1)]
    return np.where(known[:, None], points, 0.0), corners, colours_of(shell, scale).reshape(-1, 3)


def arrows(incidence: Incidence) -> list[tuple[Floats, Floats, str]]:
    """(tail, head, colour) of the arrows of the incident and the specular direction, outside the lobe."""
    wi, specular = direction(incidence.theta, 0.0), direction(incidence.theta, 180.0)
    # At normal incidence the two would hide each other.
    aside = np.array([0.05, 0.0, 0.0]) if incidence.theta < 4 else np.zeros(3)
    return [
        (1.36 * wi + aside, 1.06 * wi + aside, SOURCE),
        (1.06 * specular - aside, 1.36 * specular - aside, SPECULAR),
    ]


def _guides(view: View) -> list[tuple[Floats, str]]:
    """Polylines (n, 3) and colours: rings of theta_o on the plane, the arc of directions, rays, axes x and y."""
    around = np.linspace(0.0, 360.0, 181)
    rings = [(direction(90.0, around) * np.sin(np.radians(t)), "#b9b9b4") for t in (30, 60, 90)]
    arc = [(direction(np.linspace(-90.0, 90.0, 121), 0.0), "#8a8a86")]
    ticks = [(np.outer((0.975, 1.025), direction(t, 0.0)), "#8a8a86") for t in range(-60, 61, 30)]
    rays = [
        (np.outer((0.0, 1.0), direction(incidence.theta, phi)), colour)
        for incidence in view.incidences
        for phi, colour in ((0.0, SOURCE), (180.0, SPECULAR))
    ]
    azimuth = view.incidences[0].phi
    axes = [(np.outer((0.0, 1.0), direction(90.0, phi - azimuth)), "#b9b9b4") for phi in (0, 90, 180, 270)]
    return rings + axes + arc + ticks + rays


# --- Drawing ---------------------------------------------------------------------------------------------------------


def draw(panel: Axes, view: View, scale: Scale, ground: Ground | None, vector: bool = False) -> None:
    """Put a view and its words on `panel`: rendered by VTK, or painted by matplotlib if it cannot be or as vectors."""
    if not vector and style.can_render():
        _render(panel, view, scale, ground)
    else:
        _paint(panel, view, scale, ground)
    _label(panel, view)


def window_axes(panel: Axes) -> None:
    """Nothing but what the viewer sees."""
    panel.set(xlim=WINDOW[:2], ylim=WINDOW[2:], aspect="equal")
    panel.set_axis_off()


def open_window(views: Sequence[View], scale: Scale, ground: Ground | None) -> None:
    """Show the views in a window side by side until it is closed; RuntimeError where there is none to open."""
    require_screen()
    import pyvista

    left, right, bottom, top = WINDOW
    wide = max(420, 1260 // len(views))
    size = [wide * len(views), round(wide * (top - bottom) / (right - left))]
    shape = (1, len(views))
    plotter: Any = pyvista.Plotter(shape=shape, lighting="light kit", window_size=size, title="gonio: lobes")
    for k, view in enumerate(views):
        plotter.subplot(0, k)
        _populate(plotter, view, scale, ground)
        _name(plotter, view.incidences[-1])
        plotter.add_text(view.title.replace("$", "").replace("\\", ""), font_size=9, color=INK)
    plotter.link_views()
    plotter.show()


def _name(plotter: Any, incidence: Incidence) -> None:
    """Words at the ends of the arrows, which turn with them."""
    apart = np.array([0.2, 0.0, 0.0]) if incidence.theta < 20 else np.zeros(3)
    look: Any = {"shape": None, "show_points": False, "always_visible": True, "font_size": 14, "bold": False}
    for phi, side, name, colour in ((0.0, 1, "incident", SOURCE), (180.0, -1, "specular", SPECULAR)):
        place = 1.45 * direction(incidence.theta, phi) + side * apart
        plotter.add_point_labels(place[None], [name], text_color=colour, justification_horizontal="center", **look)


def _on_screen(points: Floats) -> Floats:
    """Orthographic projection (..., 2) of points (..., 3)."""
    return np.stack([points @ RIGHT, points @ UP], axis=-1)


def _label(panel: Axes, view: View) -> None:
    """Words beside the arrows, the ticks of the arc, the axes, and the panel's title."""
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=2.5, foreground="white")]

    def write(point: Floats, text: str, colour: str, size: float, align: str = "center") -> None:
        x, y = _on_screen(point)
        panel.text(x, y, text, color=colour, fontsize=size, ha=align, va="center", path_effects=halo)

    panel.set_title(view.title, fontsize=11, color=INK, y=0.97)
    # Of several incidences the last one's arrows have the names: they are farthest apart.
    incidence = view.incidences[-1]
    wi, specular = direction(incidence.theta, 0.0), direction(incidence.theta, 180.0)
    apart = np.array([0.14, 0.0, 0.06]) if incidence.theta < 20 else np.array([0.0, 0.0, 0.1])
    write(1.40 * wi + apart, "incident", SOURCE, 10, "right" if incidence.theta < 20 else "center")
    write(1.40 * specular + apart * (-1, 1, 1), "specular", SPECULAR, 10, "left" if incidence.theta < 20 else "center")
    for theta in (-60, -30, 30, 60):
        if all(abs(abs(theta) - each.theta) > 7 for each in view.incidences):
            before, at, after = _on_screen(direction(np.array([theta - 1.0, theta, theta + 1.0]), 180.0))
            across = (after - before)[::-1] * (-1, 1) / np.linalg.norm(after - before)
            x, y = at + 0.11 * across
            panel.text(x, y, f"{abs(theta)}°", color="#6b6b68", fontsize=8, ha="center", va="center")
    for phi, name in ((0.0, "x"), (90.0, "y")):
        azimuth = (phi - incidence.phi) % 360
        # Behind the lobe the axis would carry its name in front of it.
        azimuth, name = (azimuth - 180, f"$-${name}") if 225 < azimuth < 340 else (azimuth, name)
        write(1.12 * direction(90.0, azimuth), name, INK, 9)


def _render(panel: Axes, view: View, scale: Scale, ground: Ground | None) -> None:
    """The view as a picture rendered by VTK."""
    import pyvista as pv
    from vtkmodules.vtkCommonCore import vtkLogger

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    left, right, bottom, top = WINDOW
    size = [1400, round(1400 * (top - bottom) / (right - left))]
    scene = pv.Plotter(off_screen=True, window_size=size, lighting="light kit")
    _populate(scene, view, scale, ground)
    scene.enable_anti_aliasing("ssaa")
    picture = np.asarray(scene.screenshot(return_img=True))
    scene.close()
    panel.imshow(picture, extent=WINDOW, interpolation="antialiased")


def _populate(scene: Any, view: View, scale: Scale, ground: Ground | None) -> None:
    """Add everything to a pyvista plotter and look at it."""
    import pyvista as pv

    if ground is None:
        disc = pv.Disc(inner=0.0, outer=1.0, r_res=1, c_res=180).translate((0, 0, -0.012))
        scene.add_mesh(disc, color=PAPER, lighting=False)
    else:
        relief = pv.StructuredGrid(*np.moveaxis(ground.turned(view.incidences[0].phi), -1, 0))
        scene.add_mesh(relief, color=GROUND, ambient=0.2, diffuse=0.9)
    for line, colour in _guides(view):
        scene.add_mesh(pv.lines_from_points(line).tube(radius=0.006), color=colour, lighting=False)
    for tail, head, colour in (arrow for incidence in view.incidences for arrow in arrows(incidence)):
        length = float(np.linalg.norm(head - tail))
        shape: Any = {"tip_length": 0.35, "tip_radius": 0.13, "shaft_radius": 0.045, "scale": length}
        scene.add_mesh(pv.Arrow(start=tail, direction=head - tail, **shape), color=colour, ambient=0.3)
    look = {"smooth_shading": True, "specular": 0.12, "ambient": 0.22}
    for shell in view.shells:
        scene.add_mesh(polydata(shell, scale), scalars="colour", rgb=True, opacity=shell.opacity, **look)
    if any(shell.opacity < 1 for shell in view.shells):
        scene.enable_depth_peeling(12)
    _, _, bottom, top = WINDOW
    focus = UP * (bottom + top) / 2
    scene.camera.position, scene.camera.focal_point, scene.camera.up = focus + 10 * CAMERA, focus, (0.0, 0.0, 1.0)
    scene.camera.parallel_projection = True
    scene.camera.parallel_scale = (top - bottom) / 2


def polydata(shell: Shell, scale: Scale) -> Any:
    """The lobe as a pyvista PolyData, its values in `brdf_cos` (1/sr) and its vertices' colours in `colour`."""
    import pyvista as pv

    points, corners, colours = surface(shell, scale)
    mesh = pv.PolyData(points, np.insert(corners, 0, 4, axis=1))
    mesh["brdf_cos"] = shell.value.ravel()
    mesh["colour"] = np.rint(255 * colours).astype(np.uint8)
    # The facets that meet at the origin would mislead a search for a consistent orientation.
    return mesh.compute_normals(cell_normals=False, consistent_normals=False, split_vertices=False)


def _paint(panel: Axes, view: View, scale: Scale, ground: Ground | None) -> None:
    """The same picture as `_render`'s, painted by matplotlib from back to front."""
    from matplotlib.colors import to_rgb

    if ground is None:
        plane = _on_screen(direction(90.0, np.linspace(0.0, 360.0, 181)))
        panel.fill(*plane.T, color=PAPER, lw=0)
    else:
        points = ground.turned(view.incidences[0].phi)[::2, ::2]
        _paint_facets(panel, *_facets(points, np.broadcast_to(to_rgb(GROUND), points.shape)), 1.0, 1)
    for line, colour in _guides(view):
        panel.plot(*_on_screen(line).T, color=colour, lw=1.1, solid_capstyle="round")
    for shell in view.shells:
        every = max(1, len(DPHI) // 90)
        points, colours = (
            np.concatenate([x[:, ::every], x[:, :1]], axis=1)
            for x in (vertices(shell, scale), colours_of(shell, scale))
        )
        _paint_facets(panel, *_facets(points, colours), shell.opacity, 3)
    for tail, head, colour in (arrow for incidence in view.incidences for arrow in arrows(incidence)):
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 2.5, "mutation_scale": 16, "shrinkA": 0, "shrinkB": 0}
        panel.annotate("", tuple(_on_screen(head)), tuple(_on_screen(tail)), arrowprops=arrow, zorder=4)


def _paint_facets(panel: Axes, corners: Floats, colours: Floats, opacity: float, zorder: int) -> None:
    """Fill facets (n, 4, 3) from back to front; opaque ones have edges of their own colour, which hide the seams."""
    from matplotlib.collections import PolyCollection

    depth = np.argsort(corners.mean(axis=1) @ CAMERA)
    corners, colours = _on_screen(corners[depth]), colours[depth]
    edges: Any = {"edgecolors": colours, "lw": 0.4} if opacity == 1 else {"edgecolors": "none", "antialiaseds": False}
    facets = PolyCollection(list(corners), facecolors=colours, alpha=opacity, zorder=zorder, **edges)
    panel.add_collection(facets)


def _facets(points: Floats, colours: Floats) -> tuple[Floats, Floats]:
    """Corners (n, 4, 3) and shaded colours (n, 3) of the facets between points (rows, columns, 3); holes left out."""
    corners, four = (
        np.stack([x[:-1, :-1], x[1:, :-1], x[1:, 1:], x[:-1, 1:]], axis=2).reshape(-1, 4, 3) for x in (points, colours)
    )
    known = np.isfinite(corners).reshape(-1, 12).all(axis=1)
    corners, middle = corners[known], four[known].mean(axis=1)
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    length = np.linalg.norm(normals, axis=1)
    # Lit from the upper left behind the viewer, as VTK's key light is.
    key = (CAMERA - 0.5 * RIGHT + 0.6 * UP) / np.linalg.norm(CAMERA - 0.5 * RIGHT + 0.6 * UP)
    light = 0.45 + 0.55 * np.abs(normals @ key / np.where(length > 0, length, 1.0))
    return corners, middle * light[:, None]
