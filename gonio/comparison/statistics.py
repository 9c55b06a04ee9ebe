"""Measures of how far a model is off at one incidence, each with what noise alone would give.

Student's t of the albedo, L1 with its limits and the share of bins outside their interval, L2, reduced chi² and the
log-RMS difference of the lobe.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gonio.comparison.incidence import SURE, Incidence
from gonio.comparison.pooling import Pools, in_units
from gonio.comparison.prediction import Prediction
from microsurfaces.arrays import Floats

CONFIDENCE = 0.95
"""Level of a bin's interval, and of all judgements of one comparison together."""


def measures(
    measured: Incidence, prediction: Prediction, solid: Floats, level: float, relative_threshold: float
) -> tuple[dict[str, Any], Floats]:
    """Columns of a comparison's table, each (W,) or a scalar, and the significance of every bin (bins, W).

    `solid` are projected solid angles (bins,); `level` is the error level of one albedo; logarithms are compared above
    `relative_threshold` times the model's peak.
    """
    pools = Pools(measured, prediction, solid)
    columns = {
        **_albedo(measured, prediction, level),
        **_lobe(pools, prediction.albedo, measured.freedom),
        **_squares(pools, solid),
        **_logarithms(pools, solid, relative_threshold),
    }
    return columns, pools.spread(pools.significance())


def albedo_ratio(row: dict[str, Any]) -> float:
    """|ln(model / measured)| of the albedos in a row of the table; a ratio of nothing to nothing is no difference."""
    model, measured = (max(float(row[f"albedo_{x}"]), 1e-300) for x in ("model", "measured"))
    return abs(float(np.log(model / measured)))


# --- Albedo -----------------------------------------------------------------------------------------------------------


def _albedo(there: Incidence, prediction: Prediction, level: float) -> dict[str, Any]:
    """Measured and model albedo, and Student's t of their difference; each (W,)."""
    from scipy.special import stdtr

    model = prediction.albedo
    measured, error, error_mc = there.albedo, there.albedo_error, there.albedo_error_mc
    z = in_units(measured - model, np.hypot(error, prediction.albedo_error))
    z_mc = in_units(measured - model, np.hypot(error_mc, prediction.albedo_error))
    p_value = 2.0 * stdtr(there.freedom, -np.abs(z))
    return {
        "albedo_measured": measured,
        "albedo_standard_error": error,
        "albedo_standard_error_mc": error_mc,
        "albedo_model": model,
        "albedo_bias": in_units(model - measured, measured),
        "z": z,
        "degrees_of_freedom": np.inf if there.freedom == SURE else there.freedom,
        "p_value": p_value,
        "albedo_significant": p_value < level,
        "albedo_within_mc": 2.0 * stdtr(there.freedom_mc, -np.abs(z_mc)) >= level,
    }


# --- Lobe -------------------------------------------------------------------------------------------------------------


def _lobe(pools: Pools, albedo: Floats, freedom: float) -> dict[str, Any]:
    """L1 difference and share of pooled bins outside their interval, with what noise alone would give; each (W,)."""
    from scipy.special import stdtrit

    difference = np.abs(pools.measured - pools.model)
    outside = difference > stdtrit(pools.freedom, (1.0 + CONFIDENCE) / 2.0) * pools.error
    l1 = difference.sum(axis=0)
    noise, limit = _l1_of_noise(pools.error, pools.freedom)
    noise_mc, limit_mc = _l1_of_noise(pools.error_mc, pools.freedom_mc)
    ceiling = limit + _l1_of_shifts(pools, freedom)
    unknown = np.isnan(limit)
    outcome = np.where(l1 <= limit, "consistent", np.where(l1 <= ceiling, "inconclusive", "significant"))
    return {
        "l1": in_units(l1, albedo),
        "l1_noise": in_units(noise, albedo),
        "l1_noise_mc": in_units(noise_mc, albedo),
        "lobe": np.where(unknown, "unknown", outcome),
        "lobe_within_mc": l1 <= limit_mc,
        "share_outside": np.where(unknown, np.nan, outside.mean(axis=0)),
        "share_noise_expected": np.where(unknown, np.nan, 1.0 - CONFIDENCE),
        "bins": pools.first.size,
    }


def _squares(pools: Pools, solid: Floats) -> dict[str, Floats]:
    """L2 difference and mean square difference in standard errors, with what noise alone would give; each (W,)."""
    area, difference = pools.area(solid), pools.measured - pools.model
    scale = np.sqrt((pools.model**2 / area).sum(axis=0))
    l2, noise = (np.sqrt((x**2 / area).sum(axis=0)) for x in (difference, pools.error / _bias(pools.freedom)))
    return {
        "l2": in_units(l2, scale),
        "l2_noise": in_units(noise, scale),
        "reduced_chi2": _mean_square(difference, pools.error, pools.freedom),
        "reduced_chi2_mc": _mean_square(difference, pools.error_mc, pools.freedom_mc),
    }


def _mean_square(difference: Floats, error: Floats, freedom: Floats) -> Floats:
    """Mean over pools of squares of Student's t, as a multiple of what they are without a difference: nu / (nu - 2)."""
    if freedom.min() <= 2.0:
        return np.full(difference.shape[1], np.nan)
    return np.asarray((in_units(difference, error) ** 2 * (1.0 - 2.0 / freedom)).mean(axis=0))


def _logarithms(pools: Pools, solid: Floats, relative_threshold: float) -> dict[str, Floats]:
    """Root mean square of ln(measured / model) where both exceed the threshold, and that of noise alone; each (W,)."""
    area = np.broadcast_to(pools.area(solid), pools.model.shape)
    least = relative_threshold * (pools.model / area).max(axis=0)
    compared = (np.minimum(pools.measured, pools.model) / area >= least) & (least > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = (
            np.where(compared, x**2 * area, 0.0).sum(axis=0) / np.where(compared, area, 0.0).sum(axis=0)
            for x in (np.log(pools.measured / pools.model), pools.error / pools.measured)
        )
        rms, noise = (np.sqrt(square) for square in squares)
    return {"log_rms": rms, "log_rms_noise": noise}


# --- What noise alone gives -------------------------------------------------------------------------------------------


def _expected_l1(error: Floats, freedom: Floats) -> Floats:
    """Mean of |noise| where the standard error, itself estimated, is `error`; 0.80 of it if it is sure."""
    return np.asarray(np.sqrt(2.0 / np.pi) * error / _bias(freedom))


def _bias(freedom: Floats | float) -> Floats:
    """Mean of an estimated standard deviation over the true one, c4 (Cureton 1968)."""
    from scipy.special import gammaln

    n = np.asarray(freedom, np.float64)
    return np.asarray(np.sqrt(2.0 / n) * np.exp(gammaln((n + 1.0) / 2.0) - gammaln(n / 2.0)))


def _l1_of_noise(error: Floats, freedom: Floats) -> tuple[Floats, Floats]:
    """L1 expected from independent noise alone, and the most that it gives."""
    expected = _expected_l1(error, freedom)
    noise = expected.sum(axis=0)
    # |noise| of one bin has the standard deviation sqrt(pi / 2 - 1) times its mean.
    return noise, noise + 3.0 * np.sqrt((np.pi / 2.0 - 1.0) * (expected**2).sum(axis=0))


def _l1_of_shifts(pools: Pools, freedom: float) -> Floats:
    """How much more the specimens' differences could give if they were the same in all bins."""
    from scipy.special import stdtrit

    alone = np.sqrt(np.maximum(pools.error**2 - pools.error_mc**2, 0.0))
    mean = np.sqrt(2.0 / np.pi) / _bias(freedom)
    coherent = stdtrit(freedom, (1.0 + CONFIDENCE) / 2.0) / mean
    return np.asarray((coherent - 1.0) * _expected_l1(alone, pools.freedom).sum(axis=0))
