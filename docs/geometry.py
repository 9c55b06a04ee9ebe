"""Draw docs/geometry.svg, the directions and angles of gonio. Run it as `python docs/geometry.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gonio.plots.style import INK, PAPER, SOURCE, SPECULAR
from gonio.sphere import direction, half_vector

Array = NDArray[np.float64]
LineStyle = str | tuple[float, tuple[float, ...]]

THETA_I, PHI_I, THETA_O, DPHI = 48.0, 42.0, 58.0, 112.0
GREEN, GREY = "#00795c", "#8a8a86"
VIEW = direction(64.0, 98.0)
RIGHT = direction(90.0, 188.0)
UP = np.cross(VIEW, RIGHT)


def on_screen(points: Array) -> Array:
    """Orthographic projection (2, ...) of points (..., 3)."""
    return np.stack([points @ RIGHT, points @ UP])


def line(axes: Axes, points: Array, colour: str = GREY, style: LineStyle = "-", width: float = 1.0) -> None:
    """A polyline through points (n, 3)."""
    axes.plot(*on_screen(points), color=colour, ls=style, lw=width, solid_capstyle="round")


def arrow(axes: Axes, tail: Array, head: Array, colour: str = INK, width: float = 2.2) -> None:
    """An arrow in space."""
    style = {"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 15}
    axes.annotate("", tuple(on_screen(head)), tuple(on_screen(tail)), arrowprops=style)


def word(
    axes: Axes, point: Array, text: str, colour: str = INK, size: float = 13, by: tuple[float, float] = (0, 0)
) -> None:
    """Words near a point in space."""
    x, y = on_screen(point)
    axes.text(x + by[0], y + by[1], text, color=colour, fontsize=size, ha="center", va="center")


def arc(axes: Axes, points: Array, colour: str) -> None:
    """An angle's arc with an arrow head at its end."""
    line(axes, points[:-1], colour, width=1.4)
    arrow(axes, points[-3], points[-1], colour, 1.4)


def draw(axes: Axes) -> None:
    """Plane, axes, directions, then the angles between them."""
    origin = np.zeros(3)
    axes.fill(*on_screen(direction(90.0, np.linspace(0, 360, 181))), color=PAPER, lw=0)
    for phi, name in ((0.0, "x"), (90.0, "y")):
        arrow(axes, origin, 1.18 * direction(90.0, phi), GREY, 1.2)
        word(axes, 1.26 * direction(90.0, phi), name, GREY)
    arrow(axes, origin, np.array([0.0, 0.0, 1.1]), GREY, 1.2)
    word(axes, np.array([0.0, 0.0, 1.17]), "z, the macroscopic normal", GREY, 11)
    # The plane of incidence meets the sample in this line.
    line(axes, np.outer((-1.0, 1.0), direction(90.0, PHI_I)), INK, (0, (4, 3)))
    word(axes, direction(90.0, PHI_I), "dphi = 0\nincident side", INK, 10, (-0.2, -0.09))
    word(axes, direction(90.0, PHI_I + 180), "dphi = 180\nspecular side", INK, 10, (0.28, -0.1))
    wi, wo = direction(THETA_I, PHI_I), direction(THETA_O, PHI_I + DPHI)
    wh = half_vector(wi, wo)
    for w, name, colour, by in (
        (wi, r"$\omega_i$ to the source", SOURCE, (-0.12, 0.09)),
        (wo, r"$\omega_o$ to the detector", SPECULAR, (0.02, 0.1)),
        (wh, r"$\omega_h$ half way", GREEN, (0.27, 0.07)),
    ):
        arrow(axes, origin, 1.05 * w, colour)
        word(axes, 1.05 * w, name, colour, 13, by)
    for w, colour in ((wi, SOURCE), (wo, SPECULAR)):
        foot = w * (1, 1, 0)
        line(axes, np.stack([1.05 * w, 1.05 * foot]), colour, ":")
        line(axes, np.stack([origin, 1.05 * foot]), colour, ":")
    steps = np.linspace(0.0, 1.0, 60)
    arc(axes, 0.52 * direction(THETA_I * steps, PHI_I), SOURCE)
    word(axes, 0.61 * direction(THETA_I / 2, PHI_I), r"$\theta_i$", SOURCE)
    arc(axes, 0.42 * direction(THETA_O * steps, PHI_I + DPHI), SPECULAR)
    word(axes, 0.35 * direction(THETA_O * 0.62, PHI_I + DPHI), r"$\theta_o$", SPECULAR)
    arc(axes, 0.62 * direction(90.0, PHI_I * steps), SOURCE)
    word(axes, 0.72 * direction(90.0, PHI_I * 0.5), r"$\phi_i$", SOURCE)
    arc(axes, 0.48 * direction(90.0, PHI_I + DPHI * steps), INK)
    word(axes, 0.6 * direction(90.0, PHI_I + DPHI * 0.62), r"$\mathrm{dphi} = \phi_o - \phi_i$", INK, 12, (0.06, -0.03))


def save(path: Path) -> None:
    """Write the figure without a date, so that it changes only when the drawing does."""
    figure = Figure(figsize=(7.6, 4.4), layout="constrained")
    axes = figure.subplots()
    draw(axes)
    axes.set(xlim=(-1.5, 1.5), ylim=(-0.62, 1.16), aspect="equal")
    axes.set_axis_off()
    with mpl.rc_context({"svg.hashsalt": "gonio"}):
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None, facecolor="white")


if __name__ == "__main__":
    save(Path(__file__).parent / "geometry.svg")
