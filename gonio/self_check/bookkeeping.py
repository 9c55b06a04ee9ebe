"""Whether the sums agree with each other, and the labelled values with the sums: exact."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gonio.measurement import ENERGY_BUDGET
from gonio.self_check.report import Check, outcome
from gonio.self_check.sums import ExactSums
from gonio.tally import UNIT, UInt128

if TYPE_CHECKING:
    import xarray as xr


ROUNDING = 1e-12
"""Relative difference that another machine's arithmetic may make to a labelled value."""


def energy_budget(sums: ExactSums) -> Check:
    """launched = escaped + absorbed + truncated + lost, and each is what it is said to be: exact."""
    budget = sums.energy_budget
    residues = (
        budget["launched"] - sum(budget[name] for name in ENERGY_BUDGET[1:]),
        budget["launched"] - sums.paths[:, None] * UNIT,
        budget["escaped"] - sums.reflected[:, 0],
        np.minimum(0, np.min(list(budget.values()), axis=0)),
    )
    residue = np.abs(residues).max(axis=0) / UNIT
    found = (
        f"launched = escaped + absorbed + truncated + lost within {residue.max():.6g} paths at all {residue.size} "
        f"incidences and wavelengths (worst: {sums.worst(residue)}), limit 0, exactly"
    )
    advice = "energy is unaccounted for, so the sums were changed; measure again"
    return outcome("energy budget", not residue.any(), found, advice, {"residue": float(residue.max()), "limit": 0.0})


def orders(sums: ExactSums, covers: bool) -> Check:
    """Orders add up to "all", bins to the hemisphere, one specimen's squares are squares; no path weighs more than 1.

    Only a grid (`covers`) has bins that add up to the hemisphere; an aperture sees no more than it.
    """
    false = [(sums.weight < 0) | (sums.weight > sums.count[..., None] * UNIT), sums.count[:, 0, -1] > sums.paths]
    for values in (sums.weight, sums.count):
        bins, hemisphere = values[:, :, :-1], values[:, :, -1]
        false += [values[:, 0] != values[:, 1:].sum(axis=1)]
        false += [bins.sum(axis=2) != hemisphere if covers else bins.max(axis=2) > hemisphere]
    alone = sums.realisations == 1
    squares = UInt128.zeros(sums.weight[alone].shape)
    squares.add_square(sums.weight[alone])
    false += [(squares.high != sums.squares.high[alone]) | (squares.low != sums.squares.low[alone])]
    contradictions = int(sum(np.count_nonzero(wrong) for wrong in false))
    found = (
        f"orders add up to their total, bins to the hemisphere and weights to no more than their counts, with "
        f"{contradictions} contradictions in {sums.weight.size} sums, limit 0"
    )
    advice = "the sums were changed; measure again"
    return outcome(
        "orders", contradictions == 0, found, advice, {"contradictions": float(contradictions), "limit": 0.0}
    )


def labelled_values(fresh: xr.Dataset, stored: xr.Dataset) -> Check:
    """What is labelled follows from the sums."""
    deviations = {name: _deviation(stored, fresh, name) for name in map(str, fresh.variables)}
    worst = max(deviations, key=deviations.__getitem__)
    wrong = sorted(name for name, deviation in deviations.items() if deviation > ROUNDING)
    found = (
        f"{len(deviations) - len(wrong)} of {len(deviations)} labelled variables (brdf, standard errors ...) follow "
        f"from the exact sums; the largest relative deviation is {deviations[worst]:.2g}, limit {ROUNDING:g}"
    )
    advice = f"{', '.join(wrong)} changed; load the file and save it again, which restores them"
    return outcome("values", not wrong, found, advice, {"deviation": deviations[worst], "limit": ROUNDING})


def _deviation(stored: xr.Dataset, fresh: xr.Dataset, name: str) -> float:
    """Largest relative deviation of a variable from what it should be; 1 for what is not the same and must be."""
    expected = fresh[name].values
    if name not in stored.variables or stored[name].shape != expected.shape:
        return 1.0
    found = stored[name].values
    if {expected.dtype.kind, found.dtype.kind} != {"f"}:
        return float((found != expected).any())
    same = (found == expected) | (np.isnan(found) & np.isnan(expected))
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.abs(found - expected) / np.maximum(np.abs(expected), np.abs(found))
    return float(np.where(same, 0.0, np.nan_to_num(relative, nan=1.0)).max(initial=0.0))
