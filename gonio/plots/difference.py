"""Maps of how a model differs from what was measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gonio.plots import style
from gonio.plots.hemisphere import draw_bins, map_legend, mark_map, new_maps
from gonio.plots.style import (
    DIFFERENCES,
    INK,
    PERCENT,
    SIGMAS,
    PathLike,
    channel_words,
    choose_incidences,
    colour_bar,
    counts,
    has_errors,
    headline,
    hits,
    nearest_wavelength,
)

if TYPE_CHECKING:
    from pathlib import Path

    from gonio.comparison import Comparison
    from gonio.measurement import Measurement


def difference(
    measurement: Measurement, comparison: Comparison, path: PathLike, wavelength: float | None = None
) -> Path:
    """Draw where a model is above or below what was measured, and below it how sure that is; return the path.

    Laid out as `hemisphere`. Above, model / measured - 1 in percent; below, model - measured in standard errors of the
    pool of bins that is judged together: up to 3 may be chance. Red is too much, blue too little; bins that no light
    reached are hatched. `comparison` is what `compare` found for `measurement`; without errors there is nothing below.
    """
    from matplotlib.colors import Normalize

    incidences, choice = choose_incidences(measurement)
    nm = nearest_wavelength(measurement, wavelength)
    figure, panels = new_maps(2 if has_errors(measurement) else 1, len(incidences))
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
    counted = counts(measurement.dataset)
    order = f", {hits(comparison.order)}" if counted else ""
    blank = "hatched: no hits" if counted else "hatched: nothing is known, or no light"
    headline(
        figure, measurement, type(comparison.model).__name__, f"{channel_words(measurement, nm)}{order}", blank, choice
    )
    figure.legend(handles=map_legend(), loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return style.save(figure, path)
