"""Whether there are enough replicates, realisations, incidences and paths to conclude from."""

from __future__ import annotations

import numpy as np

from gonio.comparison import ENOUGH_COUNT
from gonio.detectors import Klems
from gonio.measurement import Measurement
from gonio.self_check.report import Check, outcome
from gonio.self_check.sums import ExactSums
from gonio.self_check.surface import Sloped
from microsurfaces.mesh import SLOPES

ENOUGH_REPLICATES = 8
"""Replicates behind an error bar: 8 know it to 27 %, and a 95 % interval is 2.4 standard errors instead of 2.0."""

ENOUGH_REALISATIONS = 4
"""Specimens behind an error bar of the ensemble: with 4 a 95 % interval is 3.2 standard errors, with 2 12.7."""

SPARSE_SHARE = 0.05
"""Share of the light in bins with a low count: as much as may lie outside 95 % intervals anyway."""


def replicates(measurement: Measurement) -> Check:
    """Error bars are themselves known."""
    count = int(measurement.counted.attrs["pilot"])
    found = (
        f"{count} replicates give the error bars and know them to {100 / np.sqrt(2 * (count - 1)):.0f} %, limit "
        f"{ENOUGH_REPLICATES}"
    )
    numbers = {"replicates": float(count), "limit": float(ENOUGH_REPLICATES)}
    advice = "set goniometer.replicates higher, with the same paths"
    return outcome("replicates", count >= ENOUGH_REPLICATES, found, advice, numbers, "warning")


def realisations(measurement: Measurement, sums: ExactSums) -> Check:
    """Whether the result speaks of the ensemble of surfaces."""
    surface, count = measurement.surface, int(sums.realisations.min())
    alike = isinstance(surface, Sloped) and not surface.expected_slopes(0.0, SLOPES).spread.any()
    enough = 1 if alike else ENOUGH_REALISATIONS
    found = f"{count} specimen{'s' if count > 1 else ''} measured, limit {enough}"
    found += f" ({type(surface).__name__} is the same for every seed)" if alike else ""
    meaning = "it speaks of this one only" if count == 1 else "it hardly knows how they differ"
    advice = f"the result speaks of the ensemble of surfaces from {enough} on, {meaning}; set realisations higher"
    numbers = {"realisations": float(count), "limit": float(enough)}
    return outcome("realisations", count >= enough, found, advice, numbers, "warning")


def completeness(measurement: Measurement, sums: ExactSums) -> Check:
    """Whether the measurement ran to its end."""
    patches = measurement.detector.bins if isinstance(measurement.detector, Klems) else None
    count, wanted = len(sums.paths), patches or sums.incidences
    found = f"{count} of {wanted} incidences were measured{', then it was stopped' if measurement.interrupted else ''}"
    advice = "what is there is sound; run it again to the end for the rest"
    sound = count == wanted and not measurement.interrupted
    numbers = {"incidences": float(count), "limit": float(wanted)}
    return outcome("completeness", sound, found, advice, numbers, "warning")


def sparse_bins(sums: ExactSums) -> Check:
    """Little light is in bins whose count is too low for an error bar."""
    count, light = sums.count[:, 0, :-1], sums.weight[:, 0, :-1].astype(np.float64)
    few = (count > 0) & (count < ENOUGH_COUNT)
    share = (light * few[..., None]).sum(axis=1) / np.maximum(light.sum(axis=1), 1.0)
    found = (
        f"{100 * share.max():.2g} % of the light is in bins with a count below {ENOUGH_COUNT} ({sums.worst(share)}), "
        f"limit {100 * SPARSE_SHARE:g} %; these are {100 * few.mean():.2g} % of the bins, "
        f"{100 * (count == 0).mean():.2g} % are empty"
    )
    numbers = {"share_of_light": float(share.max()), "limit": SPARSE_SHARE}
    numbers |= {"share_of_bins": float(few.mean()), "share_empty": float((count == 0).mean())}
    advice = "their error bars mean little; take more paths or wider bins"
    return outcome("sparse bins", share.max() <= SPARSE_SHARE, found, advice, numbers, "warning")
