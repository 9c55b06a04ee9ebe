"""The data behind the interactive part of a report: few digits and few directions, so that the page stays small."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio import tables
from gonio.detectors import HemisphereGrid
from gonio.plots import patches
from gonio.plots.lobe_scene import CAMERA
from gonio.plots.slices import Cut
from gonio.plots.style import (
    DECADES,
    FITTED,
    INK,
    PAPER,
    SOURCE,
    SPECULAR,
    Incidence,
    choose_incidences,
    hits,
    hue,
    some_wavelengths,
)
from gonio.reporting.words import GREEN
from microsurfaces.arrays import Floats

if TYPE_CHECKING:
    import xarray as xr

    from gonio.comparison import Comparison
    from gonio.measurement import Measurement

LOBES = 160
"""At most so many lobes are kept: incidences x orders x channels."""
FINE_LOBES = 50
"""So few of them have their vertices closer together."""
OBLIQUE = 50.0
"""Degrees; incidence near it shows the most of a lobe."""
DIGITS = 4
"""Significant digits."""


def explored(measurement: Measurement, comparisons: Sequence[Comparison]) -> dict[str, Any]:
    """Lobes and slices by incidence, order and channel, and the models' slices, as JSON has them.

    `lobes` are BRDF times cosine (1/sr) at the vertices, averaged over patches of about 3 degrees, or None where there
    is no hemisphere of bins; `slices` are BRDFs (1/sr) with standard errors. What is not known is None.
    """
    wavelengths, fewer = some_wavelengths(measurement)
    orders = [str(order) for order in measurement.dataset["order"].values]
    incidences, choice = choose_incidences(measurement, max(1, LOBES // (len(wavelengths) * len(orders))))
    cuts = [Cut.of(measurement, incidence) for incidence in incidences]
    lobes = len(incidences) * len(orders) * len(wavelengths)
    return {
        "choice": ", ".join(words for words in (choice, fewer) if words),
        "start": _start(incidences, wavelengths),
        "incidences": [{"theta": each.theta, "phi": each.phi} for each in incidences],
        "channels": [measurement.channels[int(np.argmin(abs(measurement.wavelengths - nm)))] for nm in wavelengths],
        "hues": ["#" + "".join(f"{round(255 * part):02x}" for part in hue(nm)) for nm in wavelengths],
        "orders": orders,
        "order_words": [hits(order) for order in orders],
        "lobes": _lobes(measurement, incidences, orders, wavelengths, lobes <= FINE_LOBES),
        "slices": [_slice(*pair, orders, wavelengths) for pair in zip(incidences, cuts, strict=True)],
        "curves": isinstance(measurement.detector, HemisphereGrid),
        "models": [_model(comparison, incidences, cuts, wavelengths) for comparison in comparisons],
        "decades": DECADES,
        "camera": _rounded(CAMERA),
        "colours": {"incident": SOURCE, "specular": SPECULAR, "ink": INK, "paper": PAPER, "models": FITTED},
    }


def _start(incidences: Sequence[Incidence], wavelengths: list[float]) -> dict[str, int]:
    """What is shown first: oblique incidence, as green as there is."""
    return {
        "incidence": min(range(len(incidences)), key=lambda k: abs(incidences[k].theta - OBLIQUE)),
        "channel": min(range(len(wavelengths)), key=lambda k: abs(wavelengths[k] - GREEN)),
    }


def _rounded(values: Floats) -> list[float | None]:
    """Numbers of few digits, None for those that are not known."""
    return [float(f"{x:.{DIGITS}g}") if math.isfinite(x) else None for x in np.ravel(values).tolist()]


# --- Lobes ------------------------------------------------------------------------------------------------------------


def _lobes(
    measurement: Measurement, incidences: Sequence[Incidence], orders: list[str], wavelengths: list[float], fine: bool
) -> dict[str, Any] | None:
    """Vertices and, by incidence, order and channel, the values there; those of the lobes' picture, thinned."""
    if not isinstance(measurement.detector, HemisphereGrid):
        return None
    rows, columns = slice(None, None, 2), slice(None, None, 2 if fine else 3)
    brdf = [each.data["brdf"].sel(order=orders, wavelength=wavelengths) for each in incidences]
    binned = np.stack([b.transpose("order", "wavelength", "theta_o", "dphi").values for b in brdf])
    if np.isfinite(binned).all():
        found = _scattered(incidences[0].data, binned)
    else:
        # What is not known of one incidence must not take it from the others.
        found = np.concatenate([_scattered(incidences[k].data, binned[k : k + 1]) for k in range(len(incidences))])
    thinned = found[..., rows, columns]
    return {
        "theta": patches.THETA[rows].tolist(),
        "dphi": patches.DPHI[columns].tolist(),
        "values": [[[_rounded(lobe) for lobe in order] for order in incidence] for incidence in thinned],
    }


def _scattered(data: xr.Dataset, binned: Floats) -> Floats:
    """Light around the vertices, (..., rows, columns), of values in bins (..., rings, sectors)."""
    *front, rings, sectors = binned.shape
    values = np.moveaxis(binned.reshape(-1, rings, sectors), 0, -1)
    found = np.moveaxis(patches.scattered(data, values), -1, 0)
    return found.reshape(*front, *found.shape[1:])


# --- Slices -----------------------------------------------------------------------------------------------------------


def _slice(incidence: Incidence, cut: Cut, orders: list[str], wavelengths: list[float]) -> dict[str, Any]:
    """Signed angles in the plane of incidence, and by order and channel the values and their standard errors."""
    value, error = [], []
    for order in orders:
        enough = cut.enough(incidence.data, order)
        read = [cut.read(incidence.data, order, nm) for nm in wavelengths]
        value.append([_rounded(np.where(enough, v, np.nan)) for v, _ in read])
        error.append([_rounded(np.where(enough, e, np.nan)) for _, e in read])
    return {"angle": _rounded(cut.angle), "value": value, "error": error}


def _model(
    comparison: Comparison, incidences: Sequence[Incidence], cuts: Sequence[Cut], wavelengths: list[float]
) -> dict[str, Any]:
    """A model's slices by incidence and channel, averaged over the same bins."""
    values = []
    for incidence, cut in zip(incidences, cuts, strict=True):
        lobe = comparison.lobes["model"].sel(theta_i=incidence.theta, phi_i=incidence.phi, wavelength=wavelengths)
        flat = lobe.transpose(..., "wavelength").values.reshape(-1, len(wavelengths))
        values.append([_rounded(curve) for curve in (cut.weights @ flat).T])
    return {"name": tables.name_of(comparison.model), "order": comparison.order, "values": values}
