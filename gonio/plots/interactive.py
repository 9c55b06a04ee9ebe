"""Lobes that turn with the mouse, as a plotly figure: in a notebook it shows itself, and it writes HTML."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.plots.lobe_scene import CAMERA, Scale, Shell, arrows, vertices
from gonio.plots.patches import DPHI, THETA, scattered, width
from gonio.plots.style import (
    COLOURS,
    INK,
    PAPER,
    Incidence,
    channel_words,
    choose_incidences,
    has_hemisphere,
    nearest_wavelength,
)
from gonio.sphere import direction
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    from gonio.measurement import Measurement

EVERY = 2
"""Of the vertices along either angle, one in so many is drawn: a page stays small."""

ZOOM = 2.3
"""How large the scene is in its frame."""


def interactive(measurement: Measurement, wavelength: float | None = None) -> Any:
    """The lobes, BRDF times cos(theta_o) in 1/sr, as a `plotly.graph_objects.Figure` with a slider for the incidence.

    Lobes are averaged over patches of about 3 degrees, as those of `lobes` are. Each incidence has a scale of its own
    for radius and colour, which the title tells. `wavelength` (nm; the nearest measured one) is 550 nm unless told.
    Raises ValueError for a measurement without a hemisphere of bins, RuntimeError where plotly is not installed.

    >>> gonio.plots.interactive(measurement)  # doctest: +SKIP
    """
    if not has_hemisphere(measurement):
        raise ValueError(
            "lobes need a hemisphere of bins, and this measurement was made with Apertures; "
            "draw slices, or measure with detector = HemisphereGrid"
        )
    try:
        import plotly.graph_objects as go
    except ImportError:
        raise RuntimeError("lobes that turn need plotly, which is not installed: pip install plotly") from None
    incidences, choice = choose_incidences(measurement)
    nm = nearest_wavelength(measurement, wavelength)
    shells = [_shell(incidence, nm) for incidence in incidences]
    figure = go.Figure(_surroundings(go))
    heads = []
    for number, (incidence, shell) in enumerate(zip(incidences, shells, strict=True)):
        scale = Scale.of([shell.value])
        patches = f"averaged over {width(measurement.dataset):.2g}° patches"
        heads.append(_head(measurement, channel_words(measurement, nm), scale.words, patches, choice))
        for trace in (_lobe(go, shell, scale), *_arrows(go, incidence)):
            figure.add_trace(trace.update(visible=number == len(incidences) // 2, meta=number))
    steps = [
        {
            "method": "update",
            "args": [{"visible": [trace.meta in (None, number) for trace in figure.data]}, {"title.text": head}],
            "label": f"{incidence.theta:g}°, {incidence.phi:g}°",
        }
        for number, (incidence, head) in enumerate(zip(incidences, heads, strict=True))
    ]
    return figure.update_layout(**_layout(heads, steps))


def _shell(incidence: Incidence, nm: float) -> Shell:
    """Scattered light around every vertex."""
    data = incidence.data.sel(order="all", wavelength=[nm])
    brdf = data["brdf"].transpose("theta_o", "dphi", "wavelength").values
    return Shell(scattered(incidence.data, brdf)[..., 0])


def _lobe(go: Any, shell: Shell, scale: Scale) -> Any:
    """A closed surface whose radius and colour are the light sent into a direction; holes where nothing is known."""
    thin = np.ix_(range(0, len(THETA), EVERY), [*range(0, len(DPHI), EVERY), 0])
    points, value = np.round(vertices(shell, scale)[thin], 4), shell.value[thin]
    colour = np.log10(np.maximum(value, scale.low)) if scale.logarithmic else value
    low, high = (float(np.log10(x)) if scale.logarithmic else x for x in (scale.low, scale.high))
    theta, dphi = np.meshgrid(THETA[thin[0].ravel()], DPHI[thin[1].ravel()], indexing="ij")
    bar: dict[str, Any] = {"title": {"text": "BRDF · cos θ<sub>o</sub> (sr⁻¹)"}, "thickness": 14, "len": 0.7}
    if scale.logarithmic:
        ticks = np.arange(np.ceil(low), high + 1e-9)
        bar |= {"tickvals": ticks, "ticktext": [f"{10**tick:g}" for tick in ticks]}
    return go.Surface(
        x=points[..., 0],
        y=points[..., 1],
        z=points[..., 2],
        surfacecolor=np.round(colour, 5),
        cmin=low,
        cmax=high,
        colorscale=COLOURS.capitalize(),
        colorbar=bar,
        customdata=np.stack([theta, dphi, np.round(value, 6)], axis=-1),
        hovertemplate="θ<sub>o</sub> %{customdata[0]:g}°, dphi %{customdata[1]:g}°: %{customdata[2]:.3g} sr⁻¹"
        "<extra></extra>",
        lighting={"ambient": 0.55, "diffuse": 0.6, "specular": 0.1},
        contours={axis: {"highlight": False} for axis in "xyz"},
    )


def _line(go: Any, points: Floats, colour: str, thick: float, **more: Any) -> Any:
    x, y, z = np.round(points.T, 4)
    style = {"mode": "lines", "hoverinfo": "skip", "showlegend": False, "line": {"color": colour, "width": thick}}
    return go.Scatter3d(x=x, y=y, z=z, **(style | more))


def _arrows(go: Any, incidence: Incidence) -> list[Any]:
    """The incident and the specular direction, with their names."""
    lines = []
    for (tail, head, colour), name in zip(arrows(incidence), ("incident", "specular"), strict=True):
        ends = np.stack([tail, head] if name == "specular" else [head, tail])
        side = "middle left" if name == "incident" else "middle right"
        words = {
            "mode": "lines+text",
            "text": ["", name],
            "textposition": side,
            "textfont": {"color": colour, "size": 13},
        }
        lines.append(_line(go, ends, colour, 8, **words))
    return lines


def _surroundings(go: Any) -> list[Any]:
    """The sample's plane, its rim and the arc of directions in the plane of incidence."""
    around = np.linspace(0.0, 360.0, 91)
    rim = direction(90.0, around)
    disc = np.stack([0.0 * rim, rim])
    plane = go.Surface(
        x=disc[..., 0],
        y=disc[..., 1],
        z=disc[..., 2] * 0 - 0.012,
        surfacecolor=np.zeros(disc.shape[:2]),
        colorscale=[[0, PAPER], [1, PAPER]],
        showscale=False,
        hoverinfo="skip",
        opacity=0.8,
    )
    arc = direction(np.linspace(-90.0, 90.0, 91), 0.0)
    return [plane, _line(go, rim, "#b9b9b4", 3), _line(go, arc, "#8a8a86", 3)]


def _head(measurement: Measurement, *parts: str) -> str:
    """The measurement's title above what is shown; plotly reads some HTML in it."""
    title = str(measurement.attributes.get("title", "")).strip()
    return "<br>".join(html.escape(line, quote=False) for line in (title, ", ".join(filter(None, parts))) if line)


def _layout(heads: Sequence[str], steps: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Head, camera with the incident direction on the left, slider; it begins with the incidence in the middle."""
    middle = len(heads) // 2
    hidden = {"visible": False, "range": [-1.45, 1.45]}
    slider = {"steps": steps, "active": middle, "pad": {"t": 10}}
    return {
        "title": {"text": heads[middle], "font": {"size": 14, "color": INK}},
        "scene": {
            "xaxis": hidden,
            "yaxis": hidden,
            "zaxis": hidden | {"range": [-0.2, 1.45]},
            "aspectmode": "manual",
            "aspectratio": {"x": ZOOM, "y": ZOOM, "z": ZOOM * 1.65 / 2.9},
            "camera": {
                "eye": dict(zip("xyz", CAMERA.tolist(), strict=True)),
                "projection": {"type": "orthographic"},
            },
        },
        "sliders": [slider | {"currentvalue": {"prefix": "θ<sub>i</sub>, φ<sub>i</sub> = "}}],
        "width": 820,
        "height": 620,
        "margin": {"l": 10, "r": 10, "t": 70, "b": 10},
        "paper_bgcolor": "white",
    }
