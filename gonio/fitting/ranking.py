"""Which of several models describes a measurement best: Akaike's criterion, with the uncertainty of its differences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gonio.fitting.result import Fit


class Ranked(NamedTuple):
    """A fit's place among others."""

    fit: Fit
    difference: float
    """Of the information criterion to that of the best fit."""
    uncertainty: float
    """Standard deviation of the difference, from how the blocks of bins disagree about it."""

    @property
    def told_apart(self) -> bool:
        """Whether the measurement says that this model is worse than the best."""
        return self.difference > 2.0 * self.uncertainty


def rank(fits: Sequence[Fit]) -> list[Ranked]:
    """Fits of the same data from the best to the worst by QAICc, Akaike's criterion for small samples and rough noise.

    The scale of the noise is that of the measurement or, if that is more or not known, the best model's residual, so
    that a large sample does not turn a small lack of fit into a certainty; wavelengths of one bin count as one.
    Neighbouring bins may be wrong together, and no criterion knows it: the uncertainty comes from the scatter between
    blocks of bins (Q. H. Vuong, Econometrica 57(2), 1989, doi:10.2307/1912557). Raises ValueError if the fits are not
    of the same data and order.
    """
    if len({(f.order, f.bins, f.incidences, f.wavelengths) for f in fits}) > 1:
        raise ValueError("only fits of the same order, incidences and wavelengths can be ranked against each other.")
    closest = min(fits, key=lambda f: f.deviance)
    residual = closest.deviance / max(1, closest.bins - len(closest.parameters))
    of_noise = np.nan_to_num(closest.deviance_of_noise) / closest.bins
    scale = max(residual, of_noise, 1e-300) * len(closest.wavelengths)
    bins = closest.bins // len(closest.wavelengths)
    scores = {id(f): f.deviance / scale + _penalty(len(f.parameters) + 1, bins) for f in fits}
    best, *others = sorted(fits, key=lambda f: scores[id(f)])

    def ranked(other: Fit) -> Ranked:
        parts = (other.parts - best.parts) / scale
        return Ranked(other, scores[id(other)] - scores[id(best)], float(np.sqrt(parts.size) * parts.std(ddof=1)))

    return [Ranked(best, 0.0, 0.0), *map(ranked, others)]


def _penalty(parameters: int, bins: int) -> float:
    return 2.0 * parameters + 2.0 * parameters * (parameters + 1) / max(1, bins - parameters - 1)
