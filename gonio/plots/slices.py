"""Slices: the BRDF in the plane of incidence."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gonio.comparison import predicted
from gonio.plots.style import (
    DECADES,
    INK,
    MARKERS,
    SOURCE,
    SPARSE,
    SPECULAR,
    Incidence,
    PathLike,
    channel,
    choose_incidences,
    counts,
    figure_of,
    finished,
    has_errors,
    has_hemisphere,
    headline,
    hits,
    hue,
    layout,
    names_of,
    new_figure,
    order_lines,
    some_wavelengths,
    the_incidence,
)
from gonio.sphere import direction
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from scipy.sparse import csr_array

    from gonio.brdf import BRDF
    from gonio.detectors import Detector
    from gonio.measurement import Measurement
    from gonio.models import Model

BAND = 1.0
"""Degrees of arc on either side of the plane of incidence that a slice averages over."""
ANGLE = "$\\theta_o$ (degrees), incident side < 0 < specular side"
"""Words of the axis of a slice."""


def slices(
    measurement: Measurement,
    path: PathLike | None = None,
    *,
    models: Sequence[Model | BRDF] = (),
    theta_i: float | None = None,
    phi_i: float | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw the BRDF in the plane of incidence against the signed angle theta_o; a figure, also written into `path`.

    A panel an incidence, of all measured ones or of those at `theta_i` and `phi_i`, degrees; of a single one into `ax`.
    The side of the specular direction is positive. Every value is the average over the bins within about 1 degree of
    arc from the plane, with a band of two standard errors: Monte-Carlo noise of the bins is taken as independent,
    realisation noise as common to all of them. Wavelengths have their colours, orders of scattering their line styles;
    `models`, averaged over the same bins, are markers, to be held against order 1. Apertures within their own half
    angle of the plane are points with error bars of two standard errors. An external measurement has no orders, and
    bands only if its errors are known. Raises ValueError where nothing was measured.
    """
    if ax is None:
        incidences, choice = choose_incidences(measurement, theta_i=theta_i, phi_i=phi_i)
    else:
        incidences, choice = [the_incidence(measurement, theta_i, phi_i)], ""
    wavelengths, fewer = some_wavelengths(measurement)
    cuts = [Cut.of(measurement, incidence) for incidence in incidences]
    figure, panels = _new_panels(incidences) if ax is None else (figure_of(ax), np.array([[ax]]))
    draw = _curves if has_hemisphere(measurement) else _points
    for panel, incidence, cut in zip(panels.flat, incidences, cuts, strict=False):
        draw(panel, incidence, cut, wavelengths)
        for k, model in enumerate(models[: len(MARKERS)]):
            wi = direction(incidence.theta, incidence.phi)
            values = predicted(model, wi, measurement.detector, np.asarray(wavelengths)).value
            _model_points(panel, cut, values, wavelengths, MARKERS[k], k / len(models))
        mark_slice(panel, incidence)
    _slice_axes(panels, incidences, cuts)
    handles = _slice_legend(measurement, wavelengths, models)
    if ax is not None:
        ax.legend(handles=handles, fontsize=7, framealpha=0.85, handlelength=2.8)
        return finished(figure, path)
    figure.legend(handles=handles, loc="outside right center", fontsize=9, frameon=False, handlelength=2.8)
    told = has_hemisphere(measurement) and counts(measurement.dataset)
    sparse = f"drawn where the count is {SPARSE} or more" if told else ""
    headline(figure, measurement, "BRDF in the plane of incidence", sparse, choice, fewer)
    return finished(figure, path)


def _new_panels(incidences: Sequence[Incidence]) -> tuple[Figure, Any]:
    """A figure, and its panels (rows, columns)."""
    rows, columns = layout(len(incidences), incidences)
    figure = new_figure(4.2 * columns + 2.0, 3.2 * rows + 0.9)
    return figure, figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)


@dataclass(frozen=True, eq=False)
class Cut:
    """The bins that lie in a plane of incidence."""

    angle: Floats
    """(n,) signed theta_o in degrees, increasing; positive on the specular side."""
    weights: csr_array
    """(n, bins) share of each bin in the average at an angle."""

    @classmethod
    def of(cls, measurement: Measurement, incidence: Incidence) -> Cut:
        """The bins of this incidence that lie in its plane."""
        from scipy.sparse import csr_array

        select = _sectors_in_plane if has_hemisphere(measurement) else _apertures_in_plane
        points = sorted(select(incidence, measurement.detector), key=lambda point: point[0])
        area = incidence.data["projected_solid_angle"].values.ravel()
        counts = [len(bins) for _, bins in points]
        bins = np.concatenate([bins for _, bins in points]) if points else np.zeros(0, int)
        share = np.concatenate([area[bins] / area[bins].sum() for _, bins in points]) if points else np.zeros(0)
        weights = csr_array((share, bins, np.cumsum([0, *counts])), shape=(len(points), len(area)))
        return cls(np.array([angle for angle, _ in points]), weights)

    def read(self, data: xr.Dataset, order: str, nm: float) -> tuple[Floats, Floats]:
        """Averages (n,) and their standard errors."""
        chosen = data.sel(order=order, wavelength=nm)
        value, whole, mc = (
            chosen[name].values.ravel() for name in ("brdf", "brdf_standard_error", "brdf_standard_error_mc")
        )
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
        """Whether the count of each average (n,) is `SPARSE` at least; all are taken where nobody counted."""
        if not counts(data):
            return np.ones(len(self.angle), bool)
        return np.asarray(self.weights.sign() @ data["count"].sel(order=order).values.ravel() >= SPARSE)


def _sectors_in_plane(incidence: Incidence, _: Detector) -> Iterator[tuple[float, NDArray[np.intp]]]:
    """Signed angle and bins of every ring on the incident and on the specular side."""
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


def _apertures_in_plane(incidence: Incidence, detector: Detector) -> Iterator[tuple[float, NDArray[np.intp]]]:
    """Signed angle and number of every aperture whose axis is within its half angle of the plane."""
    theta = incidence.data["theta_o"].values
    wo = direction(theta, incidence.data["phi_o"].values - incidence.phi)
    for k in np.flatnonzero(np.abs(wo[:, 1]) <= np.sin(np.radians(getattr(detector, "half_angle", 0.0))) + 1e-12):
        yield (-theta[k] if wo[k, 0] > 1e-12 else theta[k]), np.array([k])


def _curves(panel: Axes, incidence: Incidence, cut: Cut, wavelengths: Sequence[float]) -> None:
    for order, line in order_lines(incidence.data).items():
        whole, enough = order == "all", cut.enough(incidence.data, order)
        for nm in wavelengths:
            value, error = cut.read(incidence.data, order, nm)
            value = np.where(enough & (value > 0), value, np.nan)
            panel.plot(cut.angle, value, ls=line, color=hue(nm), lw=1.6 if whole else 1.0)
            panel.plot(cut.angle, _alone(value), ".", color=hue(nm), ms=7 if whole else 4)
            low, high = np.maximum(value - 2 * error, np.finfo(float).tiny), value + 2 * error
            panel.fill_between(cut.angle, low, high, color=hue(nm), alpha=0.3 if whole else 0.15, lw=0)


def _alone(value: Floats) -> Floats:
    """`value` where it has no neighbour to draw a line to, else NaN: the one bin of a smooth surface."""
    known = np.pad(np.isfinite(value), 1)
    return np.where(known[:-2] | known[2:], np.nan, value)


def _points(panel: Axes, incidence: Incidence, cut: Cut, wavelengths: Sequence[float]) -> None:
    if not len(cut.angle):
        panel.text(0.5, 0.5, "no aperture in this plane", transform=panel.transAxes, ha="center", color=INK)
    for nm in wavelengths:
        value, error = cut.read(incidence.data, "all", nm)
        value = np.where(value > 0, value, np.nan)
        panel.errorbar(cut.angle, value, 2 * error, fmt=".", color=hue(nm), ms=6, capsize=2, lw=1)


def _model_points(
    panel: Axes, cut: Cut, values: Floats, wavelengths: Sequence[float], marker: str, shift: float
) -> None:
    """Markers on every few bins, `shift` of the way to the next, so that those of several models interleave."""
    every = max(1, len(cut.angle) // 20)
    shown = slice(round(shift * every), None, every)
    for nm, value in zip(wavelengths, (cut.weights @ values).T, strict=True):
        value = np.where(value > 0, value, np.nan)
        panel.plot(cut.angle[shown], value[shown], marker, ms=3.6, mfc="white", mec=hue(nm), mew=0.9, zorder=3)


def mark_slice(panel: Axes, incidence: Incidence) -> None:
    """The incident direction on the upper edge, the specular one on the lower, and the panel's title."""
    edge = panel.get_xaxis_transform()
    for angle, at, marker, colour in ((-incidence.theta, 1.0, "v", SOURCE), (incidence.theta, 0.0, "^", SPECULAR)):
        panel.axvline(angle, color=colour, lw=0.8, alpha=0.6, zorder=0)
        panel.plot(angle, at, marker=marker, color=colour, transform=edge, clip_on=False, ms=8, zorder=5)
    panel.set_title(incidence.words, fontsize=11, color=INK, pad=9)


def _slice_axes(panels: Any, incidences: Sequence[Incidence], cuts: Sequence[Cut]) -> None:
    """Limits from the data, labels on the outer panels, nothing on the empty ones."""
    columns, used = panels.shape[1], len(incidences)
    limits = value_limits(_values(incidences, cuts))
    for k, panel in enumerate(panels.flat):
        if k >= used:
            panel.set_axis_off()
            continue
        angle_axis(panel)
        panel.set(yscale="log", ylim=limits)
        panel.tick_params(labelbottom=k + columns >= used)
        if k + columns >= used:
            panel.set_xlabel(ANGLE, fontsize=10)
        if k % columns == 0:
            panel.set_ylabel("BRDF (sr⁻¹)", fontsize=10)


def angle_axis(panel: Axes) -> None:
    """The signed angle theta_o from horizon to horizon."""
    panel.set(xlim=(-90, 90), xticks=range(-90, 91, 30))
    panel.grid(color="#dddddd", lw=0.6)
    panel.tick_params(labelsize=9)


def _values(incidences: Sequence[Incidence], cuts: Sequence[Cut]) -> Iterator[Floats]:
    """What is drawn: values with enough hits."""
    for incidence, cut in zip(incidences, cuts, strict=True):
        for order in order_lines(incidence.data):
            enough = cut.enough(incidence.data, order)
            for nm in incidence.data["wavelength"].values:
                yield cut.read(incidence.data, order, nm)[0][enough]


def value_limits(values: Iterable[Floats]) -> tuple[float, float]:
    """From half the smallest positive value, but `DECADES` down at most, to twice the largest."""
    positive = np.concatenate(list(values))
    positive = positive[positive > 0]
    high = 2 * float(positive.max(initial=0.0)) or 1.0
    return min(max(float(positive.min(initial=high)) / 2, high / 10**DECADES), high / 10), high


def _slice_legend(
    measurement: Measurement, wavelengths: Sequence[float], models: Sequence[Model | BRDF]
) -> list[Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Artist] = [
        Line2D([], [], color=hue(nm), lw=2.5, label=channel(measurement, nm)) for nm in wavelengths
    ]
    if has_hemisphere(measurement) and counts(measurement.dataset):
        styles = order_lines(measurement.dataset).items()
        handles += [Line2D([], [], color=INK, ls=line, lw=1.3, label=hits(order)) for order, line in styles]
    if has_errors(measurement):
        handles.append(Patch(color=INK, alpha=0.25, lw=0, label="± 2 standard errors"))
    point: dict[str, Any] = {"color": INK, "mfc": "white", "ls": "none", "ms": 5}
    for model, name, marker in zip(models, names_of(models), MARKERS, strict=False):
        handles.append(Line2D([], [], marker=marker, label=f"{name} ({hits(model.order)})", **point))
    handles.append(Line2D([], [], marker="v", color=SOURCE, ls="none", ms=8, label="incident direction"))
    handles.append(Line2D([], [], marker="^", color=SPECULAR, ls="none", ms=8, label="specular direction"))
    return handles
