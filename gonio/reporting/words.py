"""The summary of a report: what a physicist would say first of a measurement and of its models."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio import tables
from gonio.detectors import Klems
from gonio.optics import Conductor, Dielectric, tabulated_materials
from gonio.wording import percent

if TYPE_CHECKING:
    from gonio.comparison import Comparison
    from gonio.measurement import Measurement
    from gonio.self_check import SelfCheckReport

GREEN = 550.0
"""The wavelength in nm whose neighbour is told of where one has to do."""

NEGLIGIBLE = 5e-4
"""A relative difference of albedos that is not worth a word where no errors are known."""


def summary(measurement: Measurement, comparisons: Sequence[Comparison], report: SelfCheckReport | None) -> list[str]:
    """Paragraphs: what was measured, what it reflects, how the models do, what the self-checks and the errors say."""
    return [
        _subject(measurement),
        " ".join((_albedo(measurement), _multiple(measurement))).strip(),
        " ".join(_models(comparisons)),
        _checks(report),
        errors(measurement),
    ]


def best(comparisons: Sequence[Comparison]) -> Comparison | None:
    """The one whose lobe differs least, the mean of L1 over incidences and wavelengths; None of none."""
    return min(comparisons, key=lambda comparison: float(comparison.table["l1"].mean()), default=None)


def _percent(share: float) -> str:
    """With a space that no line breaks at."""
    return percent(share if share > 1e-8 else 0.0).replace(" ", "\u00a0")


def _listed(words: Iterable[str]) -> str:
    """ "a, b and c"."""
    *front, last = words
    return f"{', '.join(front)} and {last}" if front else last


# --- What was measured ------------------------------------------------------------------------------------------------


def _subject(measurement: Measurement) -> str:
    """Which specimen, at which incidences, seen at which wavelengths."""
    incidences = list(measurement.incidences())
    polar = sorted({theta for theta, _ in incidences})
    angles = _listed(f"{theta:g}°" for theta in polar) if len(polar) < 9 else f"{polar[0]:g}° to {polar[-1]:g}°"
    lit = f"lit from {len(incidences)} direction{'s' * (len(incidences) > 1)} (theta_i {angles})"
    if isinstance(measurement.detector, Klems):
        lit = f"lit from {len(incidences)} of Klems's patches"
    seen = f"{lit} and seen {_channels(measurement)}"
    if measurement.sums is None:
        return f"This is an external measurement ({measurement.attributes['origin']}): a specimen {seen}."
    data = measurement.dataset
    count, paths = (int(data[name].values[measurement.measured].max()) for name in ("realisations", "paths"))
    specimens = "One specimen was" if count == 1 else f"{count} specimens were"
    stopped = " The measurement was stopped before its end." if measurement.interrupted else ""
    return f"{_relief(measurement)}. {specimens} {seen}; {paths / 1e6:.3g} million light paths an incidence.{stopped}"


def _channels(measurement: Measurement) -> str:
    names = measurement.channels
    if not names[0].endswith(" nm"):
        return f"in the colour channel{'s' * (len(names) > 1)} {_listed(names)}"
    if len(names) > 6:
        return f"at {len(names)} wavelengths from {names[0].removesuffix(' nm')} to {names[-1]}"
    return f"at {_listed(name.removesuffix(' nm') for name in names)} nm"


def _relief(measurement: Measurement) -> str:
    """What the surface is."""
    surface, roughness = measurement.surface, measurement.surface_statistics.get("beckmann_alpha")
    kind = "A relief" if surface is None else f"A surface of the kind {type(surface).__name__}"
    slopes = "" if roughness is None else f", its facets' roughness {roughness:.3g} (Beckmann's alpha),"
    return f"{kind}{slopes} of {_substance(measurement)}"


def _substance(measurement: Measurement) -> str:
    material = measurement.material
    if isinstance(material, Conductor | Dielectric) and material.name is not None:
        return tabulated_materials().get(material.name, material.name)
    return "an unknown material" if material is None else f"the material {type(material).__name__}"


def errors(measurement: Measurement) -> str:
    """What kind of errors go with the numbers."""
    if not np.isfinite(measurement.dataset["brdf_standard_error"].values).any():
        return "Errors are not known: the file gives none, so nobody can say what noise explains."
    if measurement.sums is None:
        return "Errors are those of the file, taken as independent from bin to bin."
    count = int(measurement.dataset["realisations"].values[measurement.measured].min())
    if count == 1:
        return (
            "Errors are one standard error of Monte Carlo noise, from independent replicates. One specimen was "
            "measured: the numbers speak of it, not of all surfaces made in the same way."
        )
    return (
        f"Errors are one standard error, Monte Carlo noise and the differences between {count} specimens together: the "
        "numbers speak of the ensemble of surfaces that these were drawn from."
    )


# --- What it reflects -------------------------------------------------------------------------------------------------


def _few(count: int) -> list[int]:
    """Up to four of so many places, the first and the last among them."""
    return sorted({round(k * (count - 1) / 3) for k in range(4)})


def _albedo(measurement: Measurement) -> str:
    """The albedo with its error at a few incidences, as the table has it, in the channel nearest to green."""
    table = tables.albedo(measurement)
    names = [str(column.header) for column in table.columns[1:]]
    nearest = min(names, key=lambda name: abs(measurement.wavelengths[measurement.channels.index(name)] - GREEN))
    cells = list(table.columns[1 + names.index(nearest)].cells)
    places, one = [str(place) for place in table.columns[0].cells], measurement.dataset.sizes["phi_i"] == 1
    places = [place.partition(",")[0] if one else place for place in places]
    found = [f"{cells[k]} at {places[k]}" for k in _few(len(cells))]
    where = f"At {nearest}" if nearest.endswith(" nm") else f"In channel {nearest}"
    known = "" if _whole(measurement) else ", as far as its bins are known,"
    angles = "theta_i" if one else "theta_i, phi_i"
    return f"{where} the share of the light that comes back{known} is {_listed(found)} ({angles})."


def _whole(measurement: Measurement) -> bool:
    """Whether all bins of the measured incidences are known."""
    brdf = measurement.dataset["brdf"].sel(order="all").values[measurement.measured]
    return bool(np.isfinite(brdf).all())


def _multiple(measurement: Measurement) -> str:
    """The share of multiple scattering at the steepest and at the most grazing incidence."""
    if measurement.sums is None:
        return ""
    albedo = measurement.dataset["albedo"].mean("wavelength")
    shares = []
    for theta, phi in measurement.incidences():
        here = albedo.sel(theta_i=theta, phi_i=phi)
        total = float(here.sel(order="all"))
        shares.append((theta, 1.0 - float(here.sel(order="1")) / total if total else 0.0))
    if max(share for _, share in shares) < 5e-7:
        return "All of it hit the surface once."
    ends = [shares[0]] if len(shares) == 1 else [shares[0], shares[-1]]
    told = _listed(f"{_percent(share)} at theta_i {theta:g}°" for theta, share in ends)
    return f"Multiple scattering, light that hit the surface more than once, is {told} of it (mean of all wavelengths)."


# --- How the models do ------------------------------------------------------------------------------------------------


def _models(comparisons: Sequence[Comparison]) -> list[str]:
    chosen = best(comparisons)
    if chosen is None:
        return ["No model was compared."]
    sentences = [] if len(comparisons) == 1 else [_first(chosen, len(comparisons))]
    ordered = sorted(comparisons, key=lambda comparison: float(comparison.table["l1"].mean()))
    for comparison in ordered:
        known = comparison is chosen and len(comparisons) > 1
        sentences.append(_of_albedo(comparison, "It" if known else tables.name_of(comparison.model)))
        sentences += [_of_lobe(comparison)] if comparison is chosen else []
    return sentences


def _first(comparison: Comparison, count: int) -> str:
    l1, noise = (float(comparison.table[name].mean()) for name in ("l1", "l1_noise"))
    alone = "" if np.isnan(noise) else f"; noise alone would give {_percent(noise)}"
    return (
        f"Of {count} models, {tables.name_of(comparison.model)} comes closest: its lobes differ by {_percent(l1)} on "
        f"average (L1, the absolute difference over all directions{alone})."
    )


def _of_albedo(comparison: Comparison, name: str) -> str:
    """Where a model's albedo is furthest off, or that noise explains what it is off by."""
    rows = [row for row in comparison.rows() if row["albedo_measured"] > 0.0]
    light = "" if comparison.order == "all" else f" of {tables.light(comparison.order)}"
    if not rows:
        return f"{name} predicts an albedo where nothing comes back."
    unknown = comparison.scope == "external" and all(row["lobe"] == "unknown" for row in rows)
    off = [row for row in rows if row["albedo_significant"] or (unknown and abs(row["albedo_bias"]) > NEGLIGIBLE)]
    worst = max(off or rows, key=lambda row: abs(row["albedo_bias"]))
    if not off:
        most = _percent(abs(worst["albedo_bias"]))
        noise = "" if unknown else " within noise"
        return f"{name} has the directional albedo{light} right{noise}: it is off by {most} at most."
    verb = "overestimates" if worst["albedo_bias"] > 0.0 else "underestimates"
    return f"{name} {verb} the directional albedo{light} by {_percent(abs(worst['albedo_bias']))} at {_where(worst)}."


def _of_lobe(comparison: Comparison) -> str:
    """Where the lobe of the best model fails."""
    rows = comparison.rows()
    noise = [0.0 if np.isnan(row["l1_noise"]) else float(row["l1_noise"]) for row in rows]
    k = max(range(len(rows)), key=lambda k: rows[k]["l1"] - noise[k])
    worst, alone = rows[k], f", noise alone would give {_percent(noise[k])}" if noise[k] else ""
    judged = {"consistent": "which noise explains", "inconclusive": "which noise may explain"}.get(
        str(worst["lobe"]), ""
    )
    sentence = f"Its lobe differs most at {_where(worst)}: by {_percent(worst['l1'])} (L1{alone})"
    sentence += f", {judged}" if judged else ""
    bins = comparison.worst_bins(1)
    if not bins or judged or not bins[0]["measured"]:
        return f"{sentence}."
    place = ", ".join(f"{name} {bins[0][name]:g}°" for name in ("theta_o", "dphi") if name in bins[0])
    place = place or f"detector {bins[0]['detector']:g}"
    ratio = bins[0]["model"] / bins[0]["measured"]
    wrong = f"{_percent(ratio - 1)} too bright" if ratio > 1 else f"{_percent(1 - ratio)} too dark"
    light = f"light from theta_i {bins[0]['theta_i']:g}°"
    return f"{sentence}. The bin that adds most is at {place} for {light}, where it is {wrong}."


def _where(row: dict[str, Any]) -> str:
    """Incidence and channel of a comparison's row."""
    azimuth = f", phi_i {row['phi_i']:g}°" if row["several"]["phi_i"] else ""
    channel = str(row["channel"])
    return f"{row['theta_i']:g}°{azimuth}, {channel if channel.endswith(' nm') else f'channel {channel}'}"


# --- What is sure -----------------------------------------------------------------------------------------------------


def _checks(report: SelfCheckReport | None) -> str:
    if report is None:
        return "There is no self-check report: the file holds nothing that could be checked."
    wrong = {status: [c.name for c in report.checks if c.status == status] for status in ("failed", "warning")}
    if wrong["failed"]:
        return f"The self-check fails ({_listed(wrong['failed'])}): do not use these numbers."
    warned = f", with {_warnings(wrong['warning'])}" if wrong["warning"] else ", without a warning"
    return f"The self-check passes all {len(report.checks)} checks{warned}."


def _warnings(names: Sequence[str]) -> str:
    return f"{'a warning' if len(names) == 1 else 'warnings'} about {_listed(names)}"
