"""Fitted models: curves over what they were fitted to, their residuals, and how sure their parameters are."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from gonio.comparison import predicted
from gonio.plots.slices import ANGLE, Cut, angle_axis, mark_slice, value_limits
from gonio.plots.style import (
    FITTED,
    INK,
    MARKERS,
    ORDERS,
    PERCENT,
    SOURCE,
    SPECULAR,
    STYLES,
    Incidence,
    PathLike,
    channel_words,
    finished,
    has_errors,
    headline,
    hits,
    incidence_at,
    names_of,
    new_figure,
    thinned,
)
from gonio.sphere import direction
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

    from gonio.fitting import Fit, Parameter
    from gonio.measurement import Measurement

ACROSS = 3
"""At most so many incidences are shown."""
NARROWEST = 5.0
"""Percent: residuals are not magnified any further."""
FACETS = (0, (4, 2))
"""The line of the specimen's own roughness."""


def fits(measurement: Measurement, fits: Sequence[Fit], path: PathLike | None = None) -> Figure:
    """Draw fitted models over the measurement that they were fitted to, and their parameters; a figure.

    It is also written into `path`. On the left the BRDF in the plane of incidence as `slices` has it, with error bars
    of two standard errors, and the models, averaged over the same bins, as curves: up to three of the fitted
    incidences, at the fitted wavelength nearest to 550 nm, in the order of scattering that was fitted. Below, model /
    measured - 1. On the right every fitted parameter with its 95 % interval; roughness is held against that of the
    specimen's facets where it was measured on them, and the residual. Of more than four `fits` the first four are
    drawn; a ValueError if there are none.
    """
    if not fits:
        raise ValueError("there are no fits to draw")
    fewer = "" if len(fits) <= len(FITTED) else f"{len(FITTED)} of {len(fits)} fits"
    fits = fits[: len(FITTED)]
    nm = _wavelength(fits)
    incidences, choice = _incidences(measurement, fits)
    slices = [_Slice.of(measurement, incidence, fits, nm) for incidence in incidences]
    looks = [_Look(*look) for look in zip(_names(fits), FITTED, STYLES, MARKERS, strict=False)]
    width = 3.6 * max(len(slices), 2)
    figure = new_figure(width + 4.6, max(6.0, 1.6 + sum(_heights(_groups(fits), len(looks)))))
    halves: Any = figure.subfigures(1, 2, width_ratios=(width, 4.6))
    _draw_slices(halves[0], slices, looks)
    _draw_parameters(halves[1], fits, looks)
    handles = _legend(measurement, slices[0], looks, any(p.facets for fit in fits for p in fit.parameters))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=9, frameon=False, handlelength=2.8)
    headline(figure, measurement, _told(measurement, fits, nm), choice, fewer)
    return finished(figure, path)


class _Look(NamedTuple):
    """How a model is drawn."""

    name: str
    colour: str
    line: Any
    marker: str


# --- What was fitted --------------------------------------------------------------------------------------------------


def _names(fits: Sequence[Fit]) -> list[str]:
    return names_of([found.model for found in fits])


def _wavelength(fits: Sequence[Fit]) -> float:
    """The fitted one nearest to the middle of the visible range."""
    return min((nm for found in fits for nm in found.wavelengths), key=lambda nm: abs(nm - 550.0))


def _incidences(measurement: Measurement, fits: Sequence[Fit]) -> tuple[list[Incidence], str]:
    """Some of the fitted incidences, the azimuths one after another, and words that say how many there are."""
    fitted = sorted({(phi, theta) for found in fits for theta, phi in found.incidences})
    theta_i, phi_i = (measurement.dataset[name].values.tolist() for name in ("theta_i", "phi_i"))
    chosen = [fitted[k] for k in thinned(np.arange(len(fitted)), ACROSS)]
    words = "" if len(chosen) == len(fitted) else f"{len(chosen)} of {len(fitted)} incidences"
    return [incidence_at(measurement, theta_i.index(theta), phi_i.index(phi)) for phi, theta in chosen], words


def _told(measurement: Measurement, fits: Sequence[Fit], nm: float) -> str:
    """Which models were fitted to which light, and what of it is drawn."""
    names, orders = _names(fits), [found.order for found in fits]
    alike = {order: [name for name, own in zip(names, orders, strict=True) if own == order] for order in orders}
    told = [f"{_listed(some)} fitted to {_light(measurement, order)}" for order, some in alike.items()]
    polar = sorted({theta for found in fits for theta, _ in found.incidences})
    channels = list(dict.fromkeys(name for found in fits for name in found.channels))
    angles = _listed([f"{theta:g}°" for theta in polar]) if len(polar) < 7 else f"{len(polar)} angles"
    seen = _listed([name.removesuffix(" nm") for name in channels]) + " nm" * channels[0].endswith(" nm")
    seen = seen if len(channels) < 7 else f"{len(channels)} wavelengths"
    drawn = f"drawn: {channel_words(measurement, nm)}" if len(channels) > 1 else ""
    return "; ".join(part for part in (*told, f"incident at {angles}", seen, drawn) if part)


def _light(measurement: Measurement, order: str) -> str:
    """The light of an order; the only one there is needs no name."""
    return "all light" if len(measurement.dataset["order"]) == 1 else f"light of {hits(order)}"


def _listed(words: Sequence[str]) -> str:
    *front, last = words
    return f"{', '.join(front)} and {last}" if front else last


# --- Slices -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Slice:
    """One incidence in its plane, at one wavelength."""

    incidence: Incidence
    angle: Floats
    """(n,) signed theta_o, degrees"""
    measured: dict[str, tuple[Floats, Floats]]
    """By order: values (n,) in 1/sr, NaN where the count is too small, and their standard errors."""
    models: list[tuple[str, Floats]]
    """Of every fit its order and its values (n,) in 1/sr."""

    @classmethod
    def of(cls, measurement: Measurement, incidence: Incidence, fits: Sequence[Fit], nm: float) -> _Slice:
        cut, measured = Cut.of(measurement, incidence), {}
        for order in dict.fromkeys(found.order for found in fits):
            value, error = cut.read(incidence.data, order, nm)
            measured[order] = np.where(cut.enough(incidence.data, order) & (value > 0), value, np.nan), error
        wi, detector = direction(incidence.theta, incidence.phi), measurement.detector
        models = [
            (found.order, np.asarray(cut.weights @ predicted(found.model, wi, detector, np.array([nm])).value[:, 0]))
            for found in fits
        ]
        return cls(incidence, cut.angle, measured, models)

    def residuals(self) -> Iterator[Floats]:
        """Of every fit model / measured - 1 (n,), percent."""
        for order, model in self.models:
            yield 100.0 * (model / self.measured[order][0] - 1.0)


def _draw_slices(figure: FigureBase, slices: Sequence[_Slice], looks: Sequence[_Look]) -> None:
    shape: dict[str, Any] = {"squeeze": False, "sharex": True, "sharey": "row", "height_ratios": (2.2, 1.0)}
    above, below = figure.subplots(2, len(slices), **shape)
    for panel, lower, one in zip(above, below, slices, strict=True):
        for (_, model), look in zip(one.models, looks, strict=False):
            panel.plot(one.angle, np.where(model > 0, model, np.nan), color=look.colour, ls=look.line, lw=1.6)
        for order, (value, error) in one.measured.items():
            colour, bars, band = _ink(one, order), 2 * np.nan_to_num(error), 200.0 * error / value
            panel.errorbar(one.angle, value, bars, fmt=".", color=colour, ms=3, elinewidth=0.8, zorder=1)
            lower.fill_between(one.angle, -band, band, color=colour, alpha=0.2, lw=0)
        for rest, look in zip(one.residuals(), looks, strict=False):
            lower.plot(one.angle, rest, color=look.colour, ls=look.line, lw=1.2)
        mark_slice(panel, one.incidence)
        angle_axis(panel)
        angle_axis(lower)
        lower.axhline(0.0, color=INK, lw=0.8, zorder=0)
    above[0].set(yscale="log", ylim=value_limits(value for one in slices for value, _ in one.measured.values()))
    reach = _reach(slices)
    below[0].set(ylim=(-reach, reach))
    above[0].set_ylabel("BRDF (sr⁻¹)", fontsize=10)
    below[0].set_ylabel("model / measured\n- 1 (%)", fontsize=9)
    below[len(slices) // 2].set_xlabel(ANGLE, fontsize=10)


def _ink(one: _Slice, order: str) -> str:
    """The colour of what was measured: ink, and grey for the light of all orders where that of another is there."""
    return ORDERS["all"] if order == "all" and len(one.measured) > 1 else INK


def _reach(slices: Sequence[_Slice]) -> float:
    """Percent that nearly all residuals stay within, `NARROWEST` to `PERCENT`."""
    rest = np.abs(np.concatenate([rest for one in slices for rest in one.residuals()]))
    rest = rest[np.isfinite(rest)]
    return float(np.clip(1.3 * np.quantile(rest, 0.95), NARROWEST, PERCENT)) if rest.size else PERCENT


# --- Parameters -------------------------------------------------------------------------------------------------------


def _groups(fits: Sequence[Fit]) -> dict[str, list[tuple[int, Parameter]]]:
    """By what they mean: numbers of fits and their parameters."""
    groups: dict[str, list[tuple[int, Parameter]]] = {}
    for k, found in enumerate(fits):
        for parameter in found.parameters:
            groups.setdefault(_meaning(parameter.name), []).append((k, parameter))
    return groups


def _meaning(name: str) -> str:
    """What models that call it m, alpha, distribution.alpha have in common."""
    last, _, axis = name.rsplit(".", 1)[-1].partition("_")
    if last in ("m", "alpha"):
        return f"roughness along {axis}" if axis else "roughness"
    return name


def _draw_parameters(figure: FigureBase, fits: Sequence[Fit], looks: Sequence[_Look]) -> None:
    """A panel for every kind of parameter, and one for the models' residuals."""
    groups = _groups(fits)
    panels = figure.subplots(len(groups) + 1, 1, squeeze=False, height_ratios=_heights(groups, len(looks)))[:, 0]
    for panel, (meaning, rows) in zip(panels, groups.items(), strict=False):
        for place, (k, parameter) in enumerate(rows):
            _draw_parameter(panel, place, parameter, looks[k])
        facets = {parameter.facets for _, parameter in rows if parameter.facets}
        for value in facets:
            panel.axvline(value, color=INK, ls=FACETS, lw=1.1, zorder=0)
        _value_axis(panel, len(rows), f"{meaning}, facets {next(iter(facets)):.4g}" if facets else meaning)
    for place, (found, look) in enumerate(zip(fits, looks, strict=False)):
        panels[-1].barh(place, 100 * found.l1, height=0.16, color=look.colour)
        noise = "" if math.isnan(found.dispersion) else f", {found.dispersion:.3g} times the variance of noise"
        _tell(panels[-1], place, f"{look.name}: {found.l1:.2%}{noise}")
    _value_axis(panels[-1], len(looks), "residual, share of the light (L1, %)")
    panels[-1].set_xlim(left=0.0)


def _heights(groups: Mapping[str, Sequence[Any]], models: int) -> list[float]:
    """Inches of the panels on the right."""
    return [0.8 + 0.5 * count for count in (*map(len, groups.values()), models)]


def _draw_parameter(panel: Axes, place: int, parameter: Parameter, look: _Look) -> None:
    """A value with its interval, and above it the same in numbers."""
    value, (low, high) = parameter.value, parameter.interval
    name = f"{look.name}: {parameter.name.rsplit('.', 1)[-1]}"
    digits = min(max(1 - math.floor(math.log10(max(parameter.standard_error, 1e-6))), 0), 6)
    known = not parameter.at_bound
    reach = [[value - low], [high - value]] if known else None
    panel.errorbar([value], [place], xerr=reach, fmt=look.marker, color=look.colour, ms=6, capsize=4, lw=1.8, zorder=3)
    numbers = f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})" if known else f"{value:.3g} (at its limit)"
    _tell(panel, place, f"{name} = {numbers}")


def _tell(panel: Axes, place: int, words: str) -> None:
    """Words above a row."""
    note = panel.annotate(
        words,
        (0.02, place),
        (0, 8),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        fontsize=8.5,
        color=INK,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
    )
    note.set_in_layout(False)


def _value_axis(panel: Axes, rows: int, title: str) -> None:
    """Room for so many rows, and not so fine a scale that its numbers are those of rounding."""
    panel.set(ylim=(rows - 0.5, -0.9), yticks=[])
    panel.set_title(title, fontsize=11, color=INK)
    low, high = panel.dataLim.intervalx
    reach = max(0.6 * (high - low), 1e-3 * max(abs(low), abs(high)))
    reach = reach if reach > 4e-6 else 0.05
    panel.set_xlim((low + high) / 2 - reach, (low + high) / 2 + reach)
    panel.locator_params(axis="x", nbins=5)
    panel.grid(color="#dddddd", lw=0.6, axis="x")
    panel.set_axisbelow(True)
    panel.tick_params(labelsize=9)


# --- Legend -----------------------------------------------------------------------------------------------------------


def _legend(measurement: Measurement, one: _Slice, looks: Sequence[_Look], facets: bool) -> list[Artist]:
    from matplotlib.lines import Line2D

    bars = ", ± 2 standard errors" if has_errors(measurement) else ""
    handles: list[Artist] = []
    for order in one.measured:
        words = f"measured, {_light(measurement, order)}{bars}"
        handles.append(Line2D([], [], color=_ink(one, order), marker=".", ls="none", label=words))
    handles += [
        Line2D([], [], color=look.colour, ls=look.line, lw=1.8, marker=look.marker, ms=5, label=look.name)
        for look in looks
    ]
    if facets:
        handles.append(Line2D([], [], color=INK, ls=FACETS, lw=1.1, label="roughness of the facets"))
    handles.append(Line2D([], [], marker="v", color=SOURCE, ls="none", ms=8, label="incident direction"))
    handles.append(Line2D([], [], marker="^", color=SPECULAR, ls="none", ms=8, label="specular direction"))
    return handles
