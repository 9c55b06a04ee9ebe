"""How numbers are judged: by Student's t, by the reduced chi² of pooled bins, or by a stated bound."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from gonio.models.averages import TOLERANCE
from microsurfaces.arrays import Floats

LEVEL = 0.01
"""Probability that a case whose laws all hold has a row that says FAILS."""

ENOUGH_PATHS = 320
"""Expected paths in a pool of bins, 10 a block: fewer would not scatter like a Gaussian."""

LOST = 1e-5
"""Share of the light that restart offsets may lose on steep grooves, as the instrument promises."""

ROUNDING = 1e-6
"""Share of the light that float32 directions may put into another bin."""

Outcome = Literal["agrees", "rejected as it should be", "FAILS"]
Statistic = Literal["t", "reduced chi²", "difference"]


@dataclass(frozen=True)
class Row:
    """One number that was judged.

    `score` is Student's t, the excess of reduced chi² over 1 in units of its own scatter, or the difference itself, as
    `statistic` says; beyond `limit` the law does not hold.
    """

    case: str
    quantity: str
    settings: str
    """Sizes, paths and seeds, in words."""
    measured: float
    error: float
    """Standard error of what was measured; NaN where it is not known."""
    exact: float
    statistic: Statistic
    score: float
    limit: float
    outcome: Outcome


class Finding(NamedTuple):
    """A number before it is judged: the limit depends on how many there are."""

    quantity: str
    settings: str
    measured: float
    error: float
    exact: float
    statistic: Statistic
    limit: Callable[[float], float]
    """The largest score that noise gives, but with this probability."""
    holds: bool = True
    """Whether it is a law; else it must be rejected."""


@dataclass(frozen=True)
class Case:
    """A law, or a family of them, and the surfaces that it is tested on."""

    name: str
    function: Callable[[bool], Iterable[Finding]]
    """Called with `quick`; its docstring says what is tested."""


def judged(case: Case, quick: bool) -> tuple[Row, ...]:
    """Judge the findings of a case, each at the level that leaves LEVEL to all of them together."""
    findings = tuple(case.function(quick))
    level = -math.expm1(math.log1p(-LEVEL) / len(findings))
    return tuple(_row(case.name, finding, finding.limit(level)) for finding in findings)


def _row(case: str, finding: Finding, limit: float) -> Row:
    score = finding.measured - finding.exact
    if score and finding.statistic != "difference":
        score = score / finding.error if finding.error else math.copysign(math.inf, score)
    within = excess(finding.statistic, score) <= limit
    outcome: Outcome = "FAILS" if within != finding.holds else "agrees" if within else "rejected as it should be"
    numbers = (finding.measured, finding.error, finding.exact)
    return Row(case, finding.quantity, finding.settings, *numbers, finding.statistic, score, limit, outcome)


def excess(statistic: Statistic, score: float) -> float:
    """What is held against the limit; less scatter than expected is no sign of a difference."""
    return score if statistic == "reduced chi²" else abs(score)


def t_test(quantity: str, settings: str, blocks: Floats, exact: float, systematic: float = LOST) -> Finding:
    """The mean of `blocks` (n,) against a number that is exact but for `systematic`, by Student's t."""
    error = math.hypot(blocks.std(ddof=1) / math.sqrt(blocks.size), systematic)
    return Finding(quantity, settings, float(blocks.mean()), error, float(exact), "t", _student(blocks.size - 1))


def _student(freedom: int) -> Callable[[float], float]:
    from scipy.special import stdtrit

    return lambda level: float(stdtrit(freedom, 1.0 - level / 2.0))


def bounded(
    quantity: str,
    settings: str,
    measured: float,
    exact: float,
    bound: float,
    error: float = math.nan,
    holds: bool = True,
) -> Finding:
    """A number against one that is known up to a stated bound."""
    return Finding(quantity, settings, float(measured), error, float(exact), "difference", lambda _: bound, holds)


def reduced_chi2(quantity: str, settings: str, blocks: Floats, exact: Floats, holds: bool = True) -> Finding:
    """The bins of `blocks` (n, bins) against exact shares (bins,), as one number.

    With nu = n - 1 degrees of freedom, t^2 of one bin has the mean nu / (nu - 2) and 2 (nu - 1) / (nu - 4) times the
    square of that as variance. Their mean over bins, over nu / (nu - 2), is 1 if there is nothing but noise. Bins are
    correlated: neighbours compete for the light at their common edge, and one groove sends light into many. As
    cov(t_j^2, t_k^2) is proportional to rho_jk^2, the variance of the mean is that of independent bins times
    sum(rho_jk^2) / bins, where an estimate r^2 from n blocks exceeds rho^2 by 1 / nu. A gamma distribution of this mean
    and variance gives the limit.
    """
    count, bins = blocks.shape
    freedom = count - 1
    error = np.hypot(blocks.std(axis=0, ddof=1) / math.sqrt(count), np.hypot(ROUNDING, TOLERANCE * exact))
    value = float(np.mean(((blocks.mean(axis=0) - exact) / error) ** 2) * (freedom - 2) / freedom)
    standard = blocks - blocks.mean(axis=0)
    standard /= np.maximum(np.linalg.norm(standard, axis=0), 1e-300)
    excess = (np.square(standard.T @ standard).sum() - bins) / bins - (bins - 1) / freedom
    variance = 2.0 * (freedom - 1) / (freedom - 4) / bins * (1.0 + max(0.0, float(excess)))
    name, scatter = f"{quantity}, reduced chi² of {bins} bins", math.sqrt(variance)

    def limit(level: float) -> float:
        from scipy.special import gammainccinv

        return float((gammainccinv(1.0 / variance, level) * variance - 1.0) / scatter)

    return Finding(name, settings, value, scatter, 1.0, "reduced chi²", limit, holds)


def pooled(blocks: Floats, exact: Floats, paths: float) -> tuple[Floats, Floats]:
    """Neighbouring bins of `blocks` (n, bins) and `exact` (bins,) joined until ENOUGH_PATHS of `paths` are expected."""
    starts, expected = [0], 0.0
    for index, share in enumerate(exact.tolist()):
        if expected >= ENOUGH_PATHS:
            starts.append(index)
            expected = 0.0
        expected += share * paths
    if expected < ENOUGH_PATHS and len(starts) > 1:
        starts.pop()
    return np.add.reduceat(blocks, starts, axis=1), np.add.reduceat(exact, starts)
