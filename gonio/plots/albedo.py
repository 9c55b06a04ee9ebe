"""Albedo: the share of the light that a surface sends back, against the angle from which it comes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.comparison import predicted
from gonio.detectors import HemisphereGrid
from gonio.plots.style import (
    INK,
    MARKERS,
    PathLike,
    asked_for,
    channel,
    figure_of,
    finished,
    has_errors,
    headline,
    hits,
    hue,
    names_of,
    new_figure,
    order_lines,
    some_wavelengths,
    thinned,
)
from gonio.sphere import direction
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gonio.brdf import BRDF
    from gonio.measurement import Measurement
    from gonio.models import Model

AZIMUTHS = 3
"""At most so many azimuths phi_i, a panel each."""
GRID = HemisphereGrid(theta_step=5.0, phi_step=15.0)
"""Bins over which models are averaged and summed; each bin is integrated as finely as the lobe asks for."""


def albedo(
    measurement: Measurement,
    path: PathLike | None = None,
    *,
    models: Sequence[Model | BRDF] = (),
    phi_i: float | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw the directional-hemispherical reflectance against theta_i; a figure, also written into `path`.

    A panel an azimuth, of all measured ones or of `phi_i`, degrees, alone; of a single one into `ax`. Wavelengths have
    their colours, orders of scattering their line styles, and error bars are two standard errors; the line at 1 is all
    the light there is. `models`, integrated over the hemisphere, are markers, to be held against the order that they
    describe. An external measurement has no orders, and error bars only if its errors are known; where it knows a part
    of the hemisphere only, so does its albedo. Raises ValueError where nothing was measured.
    """
    measured = asked_for(measurement, None, phi_i)
    wavelengths, fewer = some_wavelengths(measurement)
    every = np.flatnonzero(measured.any(axis=0))
    # Klems's rings have azimuths of their own; the first one has them all.
    columns = every[:1] if len(every) > 2 * AZIMUTHS else thinned(every, AZIMUTHS)
    if ax is None:
        figure = new_figure(4.2 * len(columns) + 2.2, 4.2)
        panels = figure.subplots(1, len(columns), squeeze=False, sharey=True)[0]
    elif len(columns) == 1:
        figure, panels = figure_of(ax), np.array([ax])
    else:
        raise ValueError(f"ax shows one azimuth, and {len(every)} were measured: choose by phi_i, degrees")
    for panel, column in zip(panels, columns, strict=True):
        _curves(panel, measurement, int(column), wavelengths)
        _models(panel, measurement, int(column), wavelengths, models)
        _axes(panel, float(measurement.dataset["phi_i"][column]))
    panels[0].set_ylabel("directional albedo", fontsize=10)
    panels[0].set_ylim(0.0, max(1.05, panels[0].get_ylim()[1]))
    handles = _legend(measurement, wavelengths, models)
    if ax is not None:
        ax.legend(handles=handles, fontsize=7, framealpha=0.85, handlelength=2.8)
        return finished(figure, path)
    figure.legend(handles=handles, loc="outside right center", fontsize=9, frameon=False, handlelength=2.8)
    choice = "" if len(columns) == len(every) else f"{len(columns)} of {len(every)} azimuths"
    headline(figure, measurement, "share of the light that is sent back", choice, fewer)
    return finished(figure, path)


def _curves(panel: Axes, measurement: Measurement, column: int, wavelengths: Sequence[float]) -> None:
    data = measurement.dataset.isel(phi_i=column)
    theta = data["theta_i"].values
    for order, line in order_lines(data).items():
        for nm in wavelengths:
            chosen = data.sel(order=order, wavelength=nm)
            value, error = chosen["albedo"].values, chosen["albedo_standard_error"].values
            known, whole = np.isfinite(value), order == "all"
            look: dict[str, Any] = {"color": hue(nm), "ls": line, "lw": 1.8 if whole else 1.1, "marker": "."}
            bars = 2 * np.nan_to_num(error[known])
            panel.errorbar(theta[known], value[known], bars, ms=6 if whole else 4, capsize=2, elinewidth=1.0, **look)


def _models(
    panel: Axes, measurement: Measurement, column: int, wavelengths: Sequence[float], models: Sequence[Model | BRDF]
) -> None:
    theta = measurement.dataset["theta_i"].values[measurement.measured[:, column]]
    phi = float(measurement.dataset["phi_i"][column])
    for model, marker in zip(models, MARKERS, strict=False):
        values = np.array([_of_model(model, t, phi, wavelengths) for t in theta])
        for nm, curve in zip(wavelengths, values.T, strict=True):
            panel.plot(theta, curve, marker, ms=5.5, mfc="none", mec=hue(nm), mew=1.1, zorder=3)


def _of_model(model: Model | BRDF, theta: float, phi: float, wavelengths: Sequence[float]) -> Floats:
    """The albedo of a model (W,)."""
    area = GRID.projected_solid_angles()
    return np.asarray(area @ predicted(model, direction(theta, phi), GRID, np.asarray(wavelengths)).value)


def _axes(panel: Axes, phi: float) -> None:
    panel.axhline(1.0, color=INK, lw=1.0, zorder=0)
    panel.annotate(
        "all the light", (0.99, 1.0), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8
    )
    panel.set(xlim=(-2, 90), xticks=range(0, 91, 15), xlabel="$\\theta_i$ (degrees)")
    panel.set_title(f"$\\phi_i$ = {phi:g}°", fontsize=11, color=INK)
    panel.grid(color="#dddddd", lw=0.6)
    panel.tick_params(labelsize=9)


def _legend(measurement: Measurement, wavelengths: Sequence[float], models: Sequence[Model | BRDF]) -> list[Artist]:
    from matplotlib.lines import Line2D

    handles: list[Artist] = [
        Line2D([], [], color=hue(nm), lw=2.5, label=channel(measurement, nm)) for nm in wavelengths
    ]
    orders = order_lines(measurement.dataset)
    if len(orders) > 1:
        handles += [Line2D([], [], color=INK, ls=line, lw=1.3, label=hits(order)) for order, line in orders.items()]
    if has_errors(measurement):
        bar: dict[str, Any] = {"color": INK, "marker": "|", "ms": 11, "ls": "none", "mew": 1.2}
        handles.append(Line2D([], [], label="± 2 standard errors", **bar))
    point: dict[str, Any] = {"color": INK, "mfc": "none", "ls": "none", "ms": 6}
    for model, name, marker in zip(models, names_of(models), MARKERS, strict=False):
        handles.append(Line2D([], [], marker=marker, label=f"{name} ({hits(model.order)})", **point))
    return handles
