"""Maps of the hemisphere, seen from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from gonio.detectors import Klems
from gonio.plots import patches
from gonio.plots.style import (
    COLOURS,
    ERRORS,
    INK,
    SOURCE,
    SPARSE,
    SPECULAR,
    Incidence,
    PathLike,
    channel_words,
    choose_incidences,
    colour_bar,
    counts,
    figure_of,
    finished,
    has_errors,
    has_hemisphere,
    headline,
    log_norm,
    nearest_wavelength,
    new_figure,
    the_incidence,
)
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    from gonio.detectors import Detector
    from gonio.measurement import Measurement

LINES = 6
"""At most so many contours."""
DEEPEST = 100.0
"""No contour is at less than the highest value over this: there is little but noise."""


def hemisphere(
    measurement: Measurement,
    path: PathLike | None = None,
    *,
    wavelength: float | None = None,
    theta_i: float | None = None,
    phi_i: float | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw the BRDF over the hemisphere and below it its relative standard error; a figure, also written into `path`.

    A column an incidence, of all measured ones or of those at `theta_i` and `phi_i`, degrees; the BRDF of a single one
    into `ax`, which must be polar. The hemisphere is seen from above as a disc of equal areas, in which equal solid
    angles are equally large; the incident direction, a triangle that points down, is on the left, the specular one, a
    triangle that points up, on the right, and dphi runs counter-clockwise. Colours are logarithmic; contours,
    of averages over patches of about 3 degrees, are marked on the colour bar. Bins with a count of 0, and in
    the lower row of less than 10, are hatched. `wavelength` (nm; the nearest measured one) is 550 nm unless
    told. Apertures are drawn as discs, Klems's patches as they are; of many azimuths phi_i the first is shown. An
    external measurement has the lower row only if its errors are known. Raises ValueError where nothing was measured.
    """
    incidences, choice = map_incidences(measurement, theta_i, phi_i, ax)
    nm = nearest_wavelength(measurement, wavelength)
    maps = [_Map.of(incidence.data, nm) for incidence in incidences]
    kinds = list(zip(_map_norms(maps), (COLOURS, ERRORS), ("BRDF (sr⁻¹)", "relative standard error (%)"), strict=True))
    figure, panels = map_panels(measurement, len(maps), ax)
    for column, incidence, shown in zip(panels.T, incidences, maps, strict=True):
        for panel, values, (norm, colours, _) in zip(column, (shown.value, shown.error), kinds, strict=False):
            draw_bins(panel, incidence, measurement.detector, values, norm, colours)
            mark_map(panel, incidence)
        column[0].set_title(incidence.words, fontsize=11, color=INK, pad=12)
    bars = [
        colour_bar(figure, row, norm, words, colours)
        for row, (norm, colours, words) in zip(panels, kinds, strict=False)
    ]
    if has_hemisphere(measurement):
        _contours(panels[0], incidences, nm, kinds[0][0], bars[0])
    if ax is not None:
        return finished(figure, path)
    headline(
        figure, measurement, f"{channel_words(measurement, nm)}{_order(measurement)}", _blanks(measurement), choice
    )
    figure.legend(handles=map_legend(), loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return finished(figure, path)


def _order(measurement: Measurement) -> str:
    return ", all orders" if counts(measurement.dataset) else ""


def _blanks(measurement: Measurement) -> str:
    """What bins without a colour mean."""
    blank = "hatched" if has_hemisphere(measurement) or isinstance(measurement.detector, Klems) else "white"
    if counts(measurement.dataset):
        return f"{blank} above: count 0, below: count under {SPARSE}"
    return f"{blank}: nothing is known, or no light"


def map_incidences(
    measurement: Measurement, theta_i: float | None, phi_i: float | None, ax: Axes | None
) -> tuple[list[Incidence], str]:
    """What maps show and words about the choice; a single incidence if it is for polar axes of the caller's."""
    if ax is None:
        return choose_incidences(measurement, theta_i=theta_i, phi_i=phi_i)
    if ax.name != "polar":
        raise ValueError(f'ax has the projection "{ax.name}": make it with subplot_kw={{"projection": "polar"}}')
    return [the_incidence(measurement, theta_i, phi_i)], ""


def on_disc(theta: ArrayLike) -> Floats:
    """Radius on the disc of equal areas, 1 at the horizon, for polar angles in degrees."""
    return np.asarray(np.sqrt(2.0) * np.sin(np.radians(theta) / 2))


def map_panels(measurement: Measurement, columns: int, ax: Axes | None) -> tuple[Figure, Any]:
    """A figure and its panels (rows, columns), hemispheres seen from above; a lower row only where errors are known.

    Of a given `ax`, its figure and itself alone.
    """
    if ax is not None:
        return figure_of(ax), np.array([[ax]])
    rows = 2 if has_errors(measurement) else 1
    figure = new_figure(2.75 * columns + 1.6, 6.6 if rows > 1 else 3.9)
    return figure, figure.subplots(rows, columns, squeeze=False, subplot_kw={"projection": "polar"})


@dataclass(frozen=True, eq=False)
class _Map:
    """What is drawn for one incidence; NaN where it is hatched."""

    value: Floats
    error: Floats
    """Relative standard error in percent."""

    @classmethod
    def of(cls, data: xr.Dataset, nm: float) -> _Map:
        chosen = data.sel(order="all", wavelength=nm)
        brdf, error = (chosen[name].values for name in ("brdf", "brdf_standard_error"))
        value = np.where(brdf > 0, brdf, np.nan)
        sure = chosen["count"].values >= SPARSE if counts(data) else True
        return cls(value, np.where(sure, 100 * error / value, np.nan))


def _map_norms(maps: Sequence[_Map]) -> tuple[Normalize, Normalize]:
    """Logarithmic colour scales of the values and of their errors."""
    values, errors = (np.concatenate([getattr(m, name).ravel() for m in maps]) for name in ("value", "error"))
    return log_norm(values), log_norm(np.minimum(errors, 100.0))


def _contours(panels: Sequence[Axes], incidences: Sequence[Incidence], nm: float, norm: Normalize, bar: Any) -> None:
    """Lines of constant BRDF on the maps of one row, and their values on the colour bar."""
    high = float(norm.vmax or 1.0)
    levels = contour_levels(max(float(norm.vmin or 0.0), high / DEEPEST), high)
    radius, around = on_disc(patches.THETA[:-1]), np.radians(np.append(patches.DPHI, 360.0))
    for panel, incidence in zip(panels, incidences, strict=True):
        chosen = incidence.data["brdf"].sel(order="all", wavelength=[nm]).transpose("theta_o", "dphi", "wavelength")
        smooth = patches.averaged(incidence.data, chosen.values)[..., 0]
        closed = np.ma.masked_invalid(np.concatenate([smooth, smooth[:, :1]], axis=1))
        within = [level for level in levels if closed.min() < level < closed.max()]
        if within:
            panel.contour(around, radius, closed, levels=within, colors="white", linewidths=0.8, alpha=0.9)
    for level in levels:
        bar.ax.axhline(level, color="white", lw=0.9)


def contour_levels(low: float, high: float) -> list[float]:
    """Round values between `low` and `high`: 1, 2 and 5 times powers of ten, or fewer of them."""
    decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    for steps in ((1, 2, 5), (1, 3), (1,)):
        levels = [float(level) for level in np.outer(decades, steps).ravel() if low < level < high]
        if len(levels) <= LINES:
            break
    return levels


def draw_bins(
    panel: Axes, incidence: Incidence, detector: Detector, shown: Floats, norm: Normalize, colours: str
) -> None:
    """Fill bins, patches or apertures with the colours of `shown`; NaN stays blank, an aperture white."""
    if "dphi" in incidence.data.dims:
        _draw_grid(panel, incidence, shown, norm, colours)
    elif isinstance(detector, Klems):
        _draw_patches(panel, incidence, detector, shown, norm, colours)
    else:
        _draw_apertures(panel, incidence, detector, shown, norm, colours)


def _draw_grid(panel: Axes, incidence: Incidence, shown: Floats, norm: Normalize, colours: str) -> None:
    theta, dphi = (incidence.data[name].values for name in ("theta_o_bounds", "dphi_bounds"))
    # matplotlib joins corners by straight lines: wide sectors are cut into pieces that look round.
    pieces = -(-120 // len(dphi))
    around = np.linspace(dphi[0, 0], dphi[-1, 1], pieces * len(dphi) + 1)
    masked = np.ma.masked_invalid(np.repeat(shown, pieces, axis=1))
    edges = on_disc(np.append(theta[:, 0], theta[-1, 1]))
    panel.pcolormesh(np.radians(around), edges, masked, norm=norm, cmap=colours, rasterized=True)


def _draw_patches(
    panel: Axes, incidence: Incidence, detector: Klems, shown: Floats, norm: Normalize, colours: str
) -> None:
    from matplotlib import colormaps

    for (low, high), (phi, half), value in zip(*detector.limits(), shown, strict=True):
        if not np.isfinite(value):
            continue
        around = np.radians(phi - incidence.phi + np.linspace(-half, half, 2 + int(half / 2)))
        azimuths = np.concatenate([around, around[::-1]])
        radius = np.repeat(on_disc([low, high]), len(around))
        panel.fill(azimuths, radius, facecolor=colormaps[colours](norm(value)), edgecolor="white", lw=0.4)


def _draw_apertures(
    panel: Axes, incidence: Incidence, detector: Detector, shown: Floats, norm: Normalize, colours: str
) -> None:
    from matplotlib import colormaps

    around = np.linspace(0, 2 * np.pi, 25)
    radius = getattr(detector, "half_angle", 1.0)
    theta, phi = incidence.data["theta_o"].values, incidence.data["phi_o"].values - incidence.phi
    for t, p, value in zip(theta, np.radians(phi), shown, strict=True):
        x, y = t * np.cos(p) + radius * np.cos(around), t * np.sin(p) + radius * np.sin(around)
        colour = colormaps[colours](norm(value)) if np.isfinite(value) else "white"
        panel.fill(np.arctan2(y, x), on_disc(np.hypot(x, y)), facecolor=colour, edgecolor=INK, lw=0.4)


def mark_map(panel: Any, incidence: Incidence) -> None:
    """Orientation, rings, the hatching of the ground, the incident and the specular direction."""
    from matplotlib.patheffects import withStroke

    panel.set_theta_zero_location("W")
    panel.set_ylim(0, 1)
    panel.set_yticks(on_disc([30, 60, 90]), labels=["30°", "60°", ""], fontsize=8, color=INK)
    for label in panel.get_yticklabels():
        label.set_path_effects([withStroke(linewidth=2, foreground="white", alpha=0.8)])
    panel.set_rlabel_position(70)
    panel.set_xticks(np.radians([0, 90, 180, 270]), labels=["0°", "90°", "180°", ""], fontsize=8)
    panel.tick_params(axis="x", pad=0)
    panel.grid(color="black", lw=0.4, alpha=0.35)
    panel.patch.set(facecolor="#e6e6e6", hatch="////", edgecolor="#b0b0b0")
    # Hollow, so that the one bin of a smooth surface shows.
    marker = {"mfc": "none", "mew": 1.6, "clip_on": False, "zorder": 6}
    halo = [withStroke(linewidth=3.2, foreground="white")]
    radius = float(on_disc(incidence.theta))
    panel.plot(0.0, radius, "v", mec=SOURCE, ms=10, path_effects=halo, **marker)
    panel.plot(np.pi, radius, "^", mec=SPECULAR, ms=10, path_effects=halo, **marker)


def map_legend() -> list[Artist]:
    """What the markers of `mark_map` mean."""
    from matplotlib.lines import Line2D

    hollow: dict[str, Any] = {"mfc": "none", "mew": 1.6, "ls": "none", "ms": 9}
    return [
        Line2D([], [], marker="v", mec=SOURCE, label="incident direction (dphi = 0°)", **hollow),
        Line2D([], [], marker="^", mec=SPECULAR, label="specular direction (dphi = 180°)", **hollow),
    ]
