"""Results as tables for a terminal: what was measured, how models compare, what was fitted, what was checked."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table

from microsurfaces.recipe import parameters as fields

if TYPE_CHECKING:
    from gonio.brdf import BRDF
    from gonio.comparison import Comparison
    from gonio.fitting import Fit, Ranked
    from gonio.measurement import Measurement
    from gonio.models import Model
    from gonio.self_check import SelfCheckReport
    from gonio.validation import Row

MOST_ROWS = 40
"""Of more incidences than that, tables show one for each theta_i."""

_COLOURS = {"passed": "green", "warning": "yellow", "failed": "bold red", "FAILS": "bold red"}
"""What stands out in a list of judgements."""


def albedo(measurement: Measurement) -> Table:
    """Albedo with its standard error (if it is known) for every incidence and up to three wavelengths."""
    dataset = measurement.albedo()
    wavelengths = dataset["wavelength"].values
    count = min(len(wavelengths), 3)
    chosen = [round(i * (len(wavelengths) - 1) / max(count - 1, 1)) for i in range(count)]
    table = _of_incidences(*(measurement.channels[i] for i in chosen))
    for theta, phi in _some(measurement):
        here = dataset.sel(theta_i=theta, phi_i=phi)
        values, errors = here["albedo"].values, here["albedo_standard_error"].values
        table.add_row(_incidence(theta, phi), *(_with_error(values[i], errors[i]) for i in chosen))
    table.caption = "; ".join(
        f"{shown} of {whole} {things}"
        for shown, whole, things in (
            (count, len(wavelengths), "wavelengths"),
            (table.row_count, int(measurement.measured.sum()), "incidences"),
        )
        if shown < whole
    )
    table.caption = f"{table.caption}; all are in measurement.nc" if table.caption else None
    return table


def _some(measurement: Measurement) -> Iterator[tuple[float, float]]:
    """The incidences, (theta_i, phi_i) in degrees; of too many, one for each theta_i."""
    incidences = list(measurement.incidences())
    first = {theta: (theta, phi) for theta, phi in reversed(incidences)}
    yield from incidences if len(incidences) <= MOST_ROWS else reversed(first.values())


def energy(measurement: Measurement) -> Table | None:
    """Orders of scattering and the energy budget, means over the wavelengths; None where nobody kept them."""
    if measurement.sums is None:
        return None
    reflected = measurement.dataset["albedo"].mean("wavelength")
    budget = measurement.energy_budget().mean("wavelength")
    orders = reflected["order"].values[1:]
    hits = (f"{order[:-1]} or more" if order.endswith("+") else order for order in orders)
    table = _of_incidences(*(f"{many} hit{'s' * (many != '1')}" for many in hits), "absorbed", "lost or truncated")
    for theta, phi in _some(measurement):
        here, ended = (shares.sel(theta_i=theta, phi_i=phi) for shares in (reflected, budget))
        total = float(here.sel(order="all")) or 1.0
        shares = [float(here.sel(order=order)) / total for order in orders]
        missing = float(ended["lost"] + ended["truncated"])
        table.add_row(
            _incidence(theta, phi),
            *(f"{share:.2%}" for share in (*shares, float(ended["absorbed"]))),
            f"{missing:.1e}" if missing else "0",
        )
    return table


def statistics(values: Mapping[str, float | None]) -> Table:
    """Name and value of each statistic of a surface."""
    table = Table.grid(padding=(0, 2))
    for name, value in values.items():
        unit = " µm" if name in ("Sa", "Sq") or name.startswith("correlation") else ""
        table.add_row(name, "not defined" if value is None else f"{value:.5g}{unit}")
    return table


# --- Models -----------------------------------------------------------------------------------------------------------


def name_of(model: Model | BRDF) -> str:
    """A model's name, those of the parts that are a matter of choice, and the numbers that are."""
    from gonio.brdf import BRDF
    from gonio.models.parameters import owner

    if isinstance(model, BRDF):
        return model.title
    parts = (getattr(model, part) for part in ("distribution", "masking", "local") if part in fields(type(model)))
    named = ", ".join(type(part).__name__ for part in parts)
    numbers = ((name.rsplit(".", 1)[-1], getattr(owner(model, name), name.rsplit(".", 1)[-1])) for name in model.free)
    told = "".join(f", {name} {value:.4g}" for name, value in numbers if value is not None)
    return type(model).__name__ + (f" ({named})" if named else "") + told


def light(order: str) -> str:
    """The light of an order, in words."""
    if order == "all":
        return "all light"
    return "the light of one hit" if order == "1" else f"the light of {order} hits"


def comparison(found: Comparison, every_wavelength: bool = False) -> Table:
    """Albedo and lobe of a model, each with its outcome: a row an incidence, at the wavelength that differs most."""
    table = _of_incidences(_unit(found), "albedo", "bias", "albedo\noutcome", "L1", "noise", "lobe\noutcome")
    for row in found.rows() if every_wavelength else found.worst_rows():
        measured, unknown = float(row["albedo_measured"]), row["lobe"] == "unknown"
        table.add_row(
            _incidence(row["theta_i"], row["phi_i"]),
            _channel(row),
            _concise(measured, float(row["albedo_standard_error"])),
            f"{row['albedo_bias']:+.2%}" if measured else "-",
            "unknown" if unknown else "significant" if row["albedo_significant"] else "consistent",
            f"{row['l1']:.1%}",
            "-" if unknown else f"{row['l1_noise']:.1%}",
            str(row["lobe"]),
        )
    return table


def metrics(found: Comparison, every_wavelength: bool = False) -> Table:
    """How far the lobe differs by other measures, in brackets what noise alone would give."""
    table = _of_incidences(
        _unit(found), "L2 (noise)", "log-RMS (noise)", "reduced\nchi²", "reduced\nchi² MC", "outside"
    )
    for row in found.rows() if every_wavelength else found.worst_rows():
        table.add_row(
            _incidence(row["theta_i"], row["phi_i"]),
            _channel(row),
            _beside(row["l2"], row["l2_noise"], ".1%"),
            _beside(row["log_rms"], row["log_rms_noise"], ".3f"),
            _number(row["reduced_chi2"]),
            "-" if found.scope == "external" else _number(row["reduced_chi2_mc"]),
            "-" if math.isnan(row["share_outside"]) else f"{row['share_outside']:.1%}",
        )
    return table


def worst_bins(found: Comparison) -> Table | None:
    """The bins that add most to the L1 difference beyond doubt; None if there are none."""
    rows = found.worst_bins()
    if not rows:
        return None
    places = [name for name in ("theta_o", "dphi", "detector") if name in rows[0]]
    table = _of_incidences(_unit(found), *places, "measured", "model", "off by", "of L1")
    for row in rows:
        off = f"{row['model'] / row['measured'] - 1:+.0%} " if row["measured"] else ""
        table.add_row(
            _incidence(row["theta_i"], row["phi_i"]),
            _channel(row),
            *(f"{row[name]:g}" + "°" * (name != "detector") for name in places),
            _concise(row["measured"], row["standard_error"]),
            f"{row['model']:.4g}",
            f"{off}({-row['significance']:+.1f} s.e.)",
            f"{row['share']:.1%}",
        )
    return table


def ranking(comparisons: Sequence[Comparison]) -> Table:
    """Several models side by side, the best lobe first: means and extremes over incidences and wavelengths."""
    table = _headed("model", "light", "albedo bias", "L1 (noise)", "log-RMS", "reduced chi²")
    for found in sorted(comparisons, key=lambda each: float(each.table["l1"].mean())):
        mean = {name: float(found.table[name].mean()) for name in ("l1", "l1_noise", "log_rms", "reduced_chi2")}
        bias = found.table["albedo_bias"].values.ravel()
        table.add_row(
            name_of(found.model),
            "all" if found.order == "all" else f"{found.order} hit{'s' * (found.order != '1')}",
            f"{max(bias[bias == bias], key=abs, default=math.nan):+.2%}",
            _beside(mean["l1"], mean["l1_noise"], ".1%"),
            f"{mean['log_rms']:.3f}",
            _number(mean["reduced_chi2"]),
        )
    return table


# --- Fits -------------------------------------------------------------------------------------------------------------


def parameters(found: Fit) -> Table:
    """Fitted numbers with their errors and intervals, and what the facets have in their place."""
    table = _headed("parameter", "value", "noise", "lack of fit", "95 % interval", "facets")
    table.columns[0].no_wrap = True
    for each in found.parameters:
        error = max(each.standard_error, 1e-8)
        digits = min(max(1 - math.floor(math.log10(error)), 0), 8)
        facets = "" if not each.facets else f"{each.facets:.{digits}f}, {each.value / each.facets - 1:+.1%}"
        table.add_row(
            each.name,
            _concise(each.value, each.standard_error),
            "-" if math.isnan(each.noise) else f"{each.noise:.2g}",
            f"{each.lack_of_fit:.2g}",
            "at its limit" if each.at_bound else " to ".join(f"{end:.{digits}f}" for end in each.interval),
            facets,
        )
    return table


def correlations(found: Fit) -> Table | None:
    """Correlations between fitted numbers; None for a single one."""
    names = [each.name for each in found.parameters]
    if len(names) == 1:
        return None
    table = _headed("correlation", *names)
    for name, row in zip(names, found.correlation, strict=True):
        table.add_row(name, *(f"{value:+.3f}" for value in row))
    return table


def ranked(rows: Iterable[Ranked]) -> Table:
    """Fitted models from the best to the worst by the information criterion."""
    table = _headed("model", "QAICc - best", "residual (L1)", "variance/noise", "outcome")
    for place, row in enumerate(rows):
        outcome = "worse" if row.told_apart else "as good: not told apart"
        table.add_row(
            name_of(row.fit.model),
            f"{row.difference:.1f} ± {row.uncertainty:.1f}" if place else "0",
            f"{row.fit.l1:.2%}",
            _number(row.fit.dispersion),
            outcome if place else "best",
        )
    return table


# --- Judgements -------------------------------------------------------------------------------------------------------


def checks(found: SelfCheckReport) -> Table:
    """Every self-check, how it ended and what was found."""
    table = _headed("check", "", "found")
    table.columns[1].no_wrap = table.columns[0].no_wrap = True
    table.columns[2].justify = table.columns[1].justify = "left"
    for check in found.checks:
        table.add_row(check.name, check.status, check.sentence, style=_COLOURS.get(check.status))
    return table


def validation(rows: Iterable[Row]) -> Table:
    """Every number of one case of the ground truth."""
    table = _headed("quantity", "measured", "error", "exact", "score", "limit", "outcome")
    for row in rows:
        error = "" if math.isnan(row.error) else f"{row.error:.1g}"
        score = f"{row.statistic} {row.score:.2g}".replace("difference", "off by")
        numbers = (f"{row.measured:.5g}", error, f"{row.exact:.5g}", score, f"{row.limit:.2g}")
        table.add_row(row.quantity, *numbers, row.outcome.split(" ")[0], style=_COLOURS.get(row.outcome))
    return table


# --- Cells ------------------------------------------------------------------------------------------------------------


def _headed(first: str, *others: str) -> Table:
    """A table of these columns, the first of words, the others of numbers."""
    table = Table(
        box=box.SIMPLE_HEAD, caption_justify="left", pad_edge=False, collapse_padding=True, padding=(0, 1, 0, 0)
    )
    table.add_column(first)
    for heading in others:
        table.add_column(heading, justify="right")
    return table


def _of_incidences(*headings: str) -> Table:
    """A table whose first column is the incident direction, theta_i and phi_i."""
    table = Table(box=box.SIMPLE_HEAD, caption_justify="left", pad_edge=False, collapse_padding=True)
    for heading in ("incidence", *headings):
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _incidence(theta: float, phi: float) -> str:
    return f"{theta:g}°, {phi:g}°"


def _unit(found: Comparison) -> str:
    """Heading of the column that says which wavelength, or which channel of a colour."""
    return "nm" if found.channels[0].endswith(" nm") else "channel"


def _channel(row: Mapping[str, Any]) -> str:
    """A wavelength without its unit, or a channel of a colour."""
    return str(row["channel"]).removesuffix(" nm")


def _beside(value: float, noise: float, form: str) -> str:
    """A value, with that of noise in brackets if it is known."""
    if math.isnan(value):
        return "-"
    return f"{value:{form}}" if math.isnan(noise) else f"{value:{form}} ({noise:{form}})"


def _with_error(value: float, error: float) -> str:
    """A value with as many digits as its standard error allows, four where none is known."""
    if math.isnan(error):
        return f"{value:.4f}"
    if not error >= 5e-7:
        return f"{value:.6f} ± {error:.0g}"
    decimals = min(max(1 - math.floor(math.log10(error)), 0), 6)
    return f"{value:.{decimals}f} ± {error:.{decimals}f}"


def _concise(value: float, error: float) -> str:
    """A value with the standard error of its last two digits in brackets, as metrologists write it.

    Where no error is known it has four digits.
    """
    if math.isnan(error):
        return f"{value:.4f}"
    if not error >= 5e-8:
        return f"{value:.6f}"
    decimals = max(1 - math.floor(math.log10(error)), 0)
    return f"{value:.{decimals}f}({error * 10**decimals:.0f})"


def _number(value: Any) -> str:
    """Three significant digits, or a dash where there is no number."""
    return "-" if math.isnan(value) else f"{value:.0f}" if value >= 100 else f"{value:.3g}"
