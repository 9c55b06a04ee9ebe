"""A comparison in plain sentences: what is consistent with noise, significant beyond it, inconclusive or unknown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.comparison.statistics import albedo_ratio
from gonio.wording import percent

if TYPE_CHECKING:
    from gonio.comparison.comparison import Comparison

# --- What a comparison speaks of --------------------------------------------------------------------------------------


def preamble(found: Comparison) -> list[str]:
    """What the comparison speaks of."""
    if found.scope == "external":
        return [*_of_errors(found), *_of_orders(found), *_of_unknown(found)]
    if found.scope == "specimen":
        scope = (
            "One specimen was measured, so the errors are Monte Carlo noise and all of this speaks of that "
            "specimen only, not of surfaces made in the same way: measure several realisations for that."
        )
    else:
        scope = (
            f"{found.realisations} specimens were measured: the errors include how they differ, and all of this "
            "speaks of the ensemble they were drawn from."
        )
    if found.beam_half_angle == 0.0:
        return [scope]
    beam = (
        f"The source's beam has a half angle of {found.beam_half_angle:g} degrees, over which the model is not "
        "averaged: differences of narrow lobes may be due to that."
    )
    return [scope, beam]


def _of_errors(found: Comparison) -> Iterator[str]:
    """What there is to say of the errors of an external measurement."""
    lobes = [row["lobe"] for row in found.rows()]
    if "unknown" not in lobes:
        yield ("The measurement is external: its errors are those in its file, taken as independent from bin to bin.")
    else:
        where = "" if set(lobes) == {"unknown"} else " of some incidences or wavelengths"
        yield (
            f"The measurement is external, and its file gives no errors{where}: differences are told, but whether "
            "they are consistent with noise is unknown."
        )


def _of_orders(found: Comparison) -> Iterator[str]:
    if found.order != found.model.order:
        hits = "one hit" if found.model.order == "1" else f"{found.model.order} hits"
        yield (
            f"Its file does not keep apart how often light has hit the surface: {type(found.model).__name__}, which "
            f"speaks of the light of {hits}, was compared with all of it."
        )


def _of_unknown(found: Comparison) -> Iterator[str]:
    judged = found.table["bins"].values
    missing = (found.table["bins_measured"].values - judged)[judged > 0]
    if missing.any():
        few, many = int(missing.min()), int(missing.max())
        yield (
            f"The file knows nothing of {few if few == many else f'{few} to {many}'} of the "
            f"{int(found.table['bins_measured'].max())} bins: they do not take part, and albedos are those of the "
            "others."
        )


# --- Conclusion -------------------------------------------------------------------------------------------------------


def conclusion(found: Comparison) -> str:
    """Whether the model may be trusted, in one sentence: with which noise it is consistent, or how far it is off."""
    rows = found.rows()
    differs = [row for row in rows if row["albedo_significant"] or row["lobe"] == "significant"]
    if differs:
        lobes = [row["l1"] - row["l1_noise"] for row in differs if row["lobe"] == "significant"]
        lobe = f", its lobe by up to {percent(max(lobes))} (L1) beyond noise" if lobes else ""
        return (
            f"the difference is significant beyond noise at {len(differs)} of {len(rows)} incidences and wavelengths; "
            f"{_albedo_off(differs)}{lobe}."
        )
    if any(row["lobe"] == "unknown" for row in rows):
        return (
            f"whether the difference is consistent with noise is unknown, as there are no errors; {_albedo_off(rows)}, "
            f"its lobe by up to {percent(max(row['l1'] for row in rows))} (L1)."
        )
    albedo = max(2.0 * row["albedo_standard_error"] / max(row["albedo_measured"], 1e-300) for row in rows)
    lobe = max(row["l1_noise"] for row in rows)
    level = f"{percent(albedo)} of the albedo (two standard errors) and {percent(lobe)} of the lobe (L1)"
    if any(row["lobe"] == "inconclusive" for row in rows):
        return f"inconclusive: specimens differ too much to tell, more realisations would; noise is up to {level}."
    within_mc = all(row["albedo_within_mc"] and row["lobe_within_mc"] for row in rows)
    noise = "Monte Carlo noise" if within_mc else "the noise of specimens, though not with Monte Carlo noise alone"
    noise = "the noise that its file tells" if found.scope == "external" else noise
    return f"the difference is consistent with {noise}, which is up to {level}."


def _albedo_off(rows: Sequence[dict[str, Any]]) -> str:
    """How far the model's albedo is off, in words, at the worst of these rows."""
    worst = max(rows, key=albedo_ratio)
    off = f"off by up to {worst['albedo_bias']:+.2%}" if worst["albedo_measured"] else "not 0"
    return f"its albedo is {off} (theta_i {worst['theta_i']:g}, {worst['channel']})"


# --- One incidence ----------------------------------------------------------------------------------------------------


def described(found: Comparison, row: dict[str, Any]) -> list[str]:
    """Two sentences on one row of the table: the albedo, and the lobe."""
    where = f"theta_i {row['theta_i']:g}"
    where += f", phi_i {row['phi_i']:g}" if row["several"]["phi_i"] else ""
    where += f", {row['channel']}" if row["several"]["wavelength"] else ""
    return [f"{where}: {_of_albedo(found, row)}", f"{where}: {_of_lobe(found, row)}"]


def _of_albedo(found: Comparison, row: dict[str, Any]) -> str:
    measured, error, model = row["albedo_measured"], row["albedo_standard_error"], row["albedo_model"]
    if measured > 0.0:
        difference = f"{percent(abs(row['albedo_bias']))} {'lower' if model < measured else 'higher'}"
    else:
        difference = "nothing was measured"
    albedo, name = "albedo" if found.order == "all" else f"order-{found.order} albedo", type(found.model).__name__
    if np.isnan(error):
        return f"{albedo} {measured:.4f}, {name} {model:.4f}: {difference}."
    digits = int(np.clip(1 - np.floor(np.log10(error)), 4, 8)) if error > 0.0 else 6
    freedom = row["degrees_of_freedom"]
    score = f"t = {row['z']:.3g} with {freedom:.0f} degrees of freedom" if freedom < np.inf else f"z = {row['z']:.3g}"
    outcome = _SIGNIFICANT if row["albedo_significant"] else _consistent(found, row["albedo_within_mc"])
    return (
        f"{albedo} {measured:.{digits}f} ± {error:.{digits}f}, {name} {model:.{digits}f}: {difference}, {score}, "
        f"p = {row['p_value']:.2g}: {outcome}."
    )


def _of_lobe(found: Comparison, row: dict[str, Any]) -> str:
    if row["lobe"] == "unknown":
        return f"the lobe differs by {percent(row['l1'])} (L1)."
    outcome = {
        "consistent": _consistent(found, row["lobe_within_mc"]),
        "inconclusive": (
            "inconclusive, as it is more than independent noise, but specimens can shift a whole lobe: more "
            "realisations would tell"
        ),
        "significant": _SIGNIFICANT,
    }[str(row["lobe"])]
    bins = "bins" if found.scope == "external" else "pooled bins"
    return (
        f"the lobe differs by {percent(row['l1'])} (L1), of which noise alone would give "
        f"{percent(row['l1_noise'])}; {percent(row['share_outside'])} of {row['bins']} {bins} are outside their "
        f"95 % interval, noise leaves {percent(row['share_noise_expected'])}: {outcome}."
    )


_SIGNIFICANT = "significant beyond noise"


def _consistent(found: Comparison, within_mc: bool) -> str:
    """With which noise."""
    if found.scope == "external":
        return "consistent with the errors of the file"
    if within_mc:
        return "consistent with Monte Carlo noise"
    return "consistent with how specimens differ, though not with Monte Carlo noise alone"
