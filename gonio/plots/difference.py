"""Maps of how a model differs from what was measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gonio.plots.hemisphere import draw_bins, map_incidences, map_legend, map_panels, mark_map
from gonio.plots.style import (
    DIFFERENCES,
    INK,
    PERCENT,
    SIGMAS,
    PathLike,
    channel_words,
    colour_bar,
    counts,
    finished,
    headline,
    hits,
    nearest_wavelength,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gonio.comparison import Comparison
    from gonio.measurement import Measurement


def difference(
    measurement: Measurement,
    comparison: Comparison,
    path: PathLike | None = None,
    *,
    wavelength: float | None = None,
    theta_i: float | None = None,
    phi_i: float | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw where a model is above or below what was measured, and below it how sure that is; a figure.

    It is also written into `path`. Laid out as `hemisphere`, with the same choice of incidences; into `ax`, which must
    be polar, goes what is above, of a single one. Above, model / measured - 1 in percent; below, model - measured in
    standard errors of the pool of bins that is judged together: up to 3 may be chance. Red is too much, blue too
    little; bins with a count of 0 are hatched. `comparison` is what `compare` found for `measurement`; without errors
    there is nothing below.
    """
    from matplotlib.colors import Normalize

    incidences, choice = map_incidences(measurement, theta_i, phi_i, ax)
    nm = nearest_wavelength(measurement, wavelength)
    figure, panels = map_panels(measurement, len(incidences), ax)
    norms = Normalize(-PERCENT, PERCENT, clip=True), Normalize(-SIGMAS, SIGMAS, clip=True)
    for column, incidence in zip(panels.T, incidences, strict=True):
        here = comparison.lobes.sel(theta_i=incidence.theta, phi_i=incidence.phi, wavelength=nm)
        measured, model = here["measured"].values, here["model"].values
        there = measured > 0
        relative = 100 * (model / np.where(there, measured, np.nan) - 1)
        significance = np.where(there | (model > 0), -here["significance"].values, np.nan)
        for panel, shown, norm in zip(column, (relative, significance), norms, strict=False):
            draw_bins(panel, incidence, measurement.detector, shown, norm, DIFFERENCES)
            mark_map(panel, incidence)
        column[0].set_title(incidence.words, fontsize=11, color=INK, pad=12)
    words = "model / measured - 1 (%)", "model - measured (standard errors)"
    for row, norm, what in zip(panels, norms, words, strict=False):
        colour_bar(figure, row, norm, what, DIFFERENCES)
    if ax is not None:
        return finished(figure, path)
    counted = counts(measurement.dataset)
    order = f", {hits(comparison.order)}" if counted else ""
    blank = "hatched: count 0" if counted else "hatched: nothing is known, or no light"
    headline(
        figure, measurement, type(comparison.model).__name__, f"{channel_words(measurement, nm)}{order}", blank, choice
    )
    figure.legend(handles=map_legend(), loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return finished(figure, path)
