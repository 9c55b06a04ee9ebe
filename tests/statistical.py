"""What a statistical law may conclude: one family-wise error level over all its cases."""

import numpy as np
from scipy import stats

LEVEL = 1e-3
"""Probability that a law which holds fails, for its fixed seed, over all its cases together."""


def sidak(cases, level=LEVEL):
    """The level of one of `cases` independent tests that keeps `level` for all of them."""
    return -np.expm1(np.log1p(-level) / cases)


def assert_equal_within_noise(measured, expected, standard_error, degrees_of_freedom, level=LEVEL):
    """No t-score of the family is larger than noise explains; where nothing scatters, equality within rounding."""
    measured, expected, error, freedom = (
        a.ravel() for a in np.broadcast_arrays(measured, expected, standard_error, degrees_of_freedom)
    )
    difference = measured - expected
    rounding = 1e-6 * np.abs(expected)  # directions and cosines are float32
    score = np.abs(difference) / np.hypot(error, rounding)
    p = 2 * stats.t.sf(score, freedom)
    worst = int(np.argmin(p))
    assert p[worst] > sidak(p.size, level), (
        f"case {worst} of {p.size}: measured {measured[worst]:.6g}, expected {expected[worst]:.6g}, "
        f"standard error {error[worst]:.2g}, t = {score[worst]:.2f}"
    )


def assert_covers(scores, degrees_of_freedom, level=LEVEL):
    """t-scores of known cases follow Student's t: their p-values are uniform, and 95 % intervals cover 95 %."""
    p = 2 * stats.t.sf(np.abs(scores), degrees_of_freedom)
    outside = np.concatenate([np.ravel(x) for x in (p < 0.05,)])
    assert stats.binomtest(int(outside.sum()), outside.size, 0.05).pvalue > sidak(2, level), (
        f"{outside.mean():.2%} of {outside.size} 95 % intervals miss the truth"
    )
    uniform = stats.kstest(np.ravel(p), "uniform")
    assert uniform.pvalue > sidak(2, level), f"p-values are not uniform: KS distance {uniform.statistic:.3f}"
