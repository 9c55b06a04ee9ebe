"""How well a model describes a measurement, and how much of the difference is noise.

Models of single scattering are compared with order 1, the light that hit the surface once, and as what the instrument
measures: averages over the detector's bins.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.detectors import Detector, HemisphereGrid
from gonio.measurement import Measurement
from gonio.models import Model
from gonio.models.averages import TOLERANCE
from gonio.sphere import Vectors, direction

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

ENOUGH_HITS = 10
"""Bins with fewer hits are pooled with their neighbours before anything is said about a bin."""

CONFIDENCE = 0.95
"""Level of a bin's interval, and of all judgements of one comparison together."""

_FINE = HemisphereGrid(theta_step=2.0, phi_step=3.0)
"""Where a model's albedo is summed if the detector does not cover the hemisphere."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """A model judged against a measurement: numbers in `table`, words from `sentences()`.

    `table` is an `xarray.Dataset` over theta_i, phi_i, wavelength, NaN where nothing was measured:

    * `albedo_measured`, `albedo_standard_error`, `albedo_standard_error_mc` (its Monte Carlo part), `albedo_model`: the
      directional-hemispherical reflectance of single scattering;
    * `z`, `p_value`: their difference (measured - model) in standard errors, and the probability of one at least as
      large by chance, by Student's t with `degrees_of_freedom`; `albedo_differs`: whether that is less than 5 %, all
      the incidences and wavelengths of the comparison together (Sidak);
    * `l1`: the lobe's difference, the sum of |measured - model| times projected solid angle over the pooled bins, as a
      share of the model's albedo; `l1_noise`: what noise alone is expected to add up to, `l1_noise_mc` the Monte Carlo
      noise alone; `lobe`: "noise", "unclear" or "differs" (see `compare`);
    * `share_outside`: share of the pooled bins in which the model is outside the 95 % interval of the measurement;
      `share_noise_expected`: the share that noise alone leaves outside;
    * `bins`: pooled bins that were judged, `bins_measured`: bins of the detector.
    """

    table: xr.Dataset
    """The numbers."""
    model: Model
    """The model that was judged."""
    scope: Literal["specimen", "class"]
    """What the error bars speak of: this one specimen (one realisation), or the class that several were drawn from."""
    realisations: int
    """How many specimens the measurement holds (the fewest of any incidence)."""
    beam_half_angle: float
    """Half the angle of the lamp's beam, degrees."""

    def sentences(self) -> list[str]:
        """The verdict in plain sentences: what it speaks of, then two for each incidence, at its worst wavelength."""
        name = type(self.model).__name__
        return [*self.preamble(), *(line for row in self.worst_rows() for line in _describe(row, name))]

    def preamble(self) -> list[str]:
        """What the verdict speaks of."""
        if self.scope == "specimen":
            scope = (
                "One specimen was measured, so the errors are Monte Carlo noise and all of this speaks of that "
                "specimen only, not of surfaces made in the same way: measure several realisations for that."
            )
        else:
            scope = (
                f"{self.realisations} specimens were measured: the errors include how they differ, and all of this "
                "speaks of the class they were drawn from."
            )
        if self.beam_half_angle == 0.0:
            return [scope]
        beam = (
            f"The lamp's beam has a half angle of {self.beam_half_angle:g} degrees, over which the model is not "
            "averaged: differences of narrow lobes may be due to that."
        )
        return [scope, beam]

    def worst_rows(self) -> list[dict[str, Any]]:
        """One row of `table` an incidence, the wavelength at which the albedos differ most; `several` tells which of
        the coordinates vary."""
        rows = []
        for theta in self.table["theta_i"].values:
            for phi in self.table["phi_i"].values:
                cell = self.table.sel(theta_i=theta, phi_i=phi)
                if cell["bins"].values[0] == 0:
                    continue
                # A ratio of nothing to nothing is no difference.
                model, measured = (np.maximum(cell[f"albedo_{x}"].values, 1e-300) for x in ("model", "measured"))
                worst = cell.isel(wavelength=int(np.abs(np.log(model / measured)).argmax()))
                row: dict[str, Any] = {str(name): variable.values[()] for name, variable in worst.variables.items()}
                rows.append({**row, "several": {name: self.table.sizes[name] > 1 for name in ("phi_i", "wavelength")}})
        return rows


class _Incidence(NamedTuple):
    """What was measured at one incidence, order 1: bins flattened in theta_o, dphi order."""

    brdf: Array
    """(bins, W)"""
    error: Array
    """(bins, W)"""
    error_mc: Array
    """(bins, W)"""
    hits: NDArray[np.int64]
    """(bins,)"""
    freedom: float
    """Degrees of freedom of `error`."""


def compare(measurement: Measurement, model: Model) -> Verdict:
    """Judge `model` against order 1 of `measurement`, incidence by incidence, bin average by bin average.

    Bins with fewer than 10 hits are pooled with those that follow them in theta_o, dphi order until a pool has 10.
    Noise is what the standard errors say: Monte Carlo noise if one realisation was measured, and the difference between
    specimens as well if several were. The numerical error of the model's averages counts as noise too.

    The albedo differs if Student's t says so (see `Verdict`). The lobe is "noise" as long as its L1 difference stays
    within three standard deviations of what independent noise in every bin adds up to. But specimens may move a lobe as
    a whole: "differs" needs more than realisation noise could give even if it were the same in all bins (97.5 % limit);
    between the two it is "unclear", and more realisations would tell.

    Raises ValueError if the measurement holds no incidence, or if the model cannot be averaged over its bins.
    """
    import xarray as xr

    data = measurement.dataset
    if not (data["paths"].values > 0).any():
        raise ValueError("The measurement holds no measured incidence to compare with: run it again to the end.")
    shape = tuple(data.sizes[name] for name in ("theta_i", "phi_i", "wavelength"))
    columns: dict[str, NDArray[Any]] = {}
    level = 1.0 - CONFIDENCE ** (1.0 / (np.count_nonzero(data["paths"].values) * shape[2]))
    for i, j in zip(*np.nonzero(data["paths"].values), strict=True):
        wi = direction(data["theta_i"].values[i], data["phi_i"].values[j])
        row = _judge(data, (int(i), int(j)), wi, measurement.detector, model, level)
        for name, values in row.items():
            columns.setdefault(name, _blank(shape, np.asarray(values).dtype))[i, j] = values
    coordinates = {name: data[name].values for name in ("theta_i", "phi_i", "wavelength")}
    table = xr.Dataset({name: (tuple(coordinates), column) for name, column in columns.items()}, coordinates)
    realisations = int(data["realisations"].values[data["paths"].values > 0].min())
    scope: Literal["specimen", "class"] = "specimen" if realisations == 1 else "class"
    return Verdict(table, model, scope, realisations, _beam_half_angle(measurement))


def _beam_half_angle(measurement: Measurement) -> float:
    return float(json.loads(measurement.attributes["goniometer"]).get("beam_half_angle", 0.0))


def _blank(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """An array that says "not measured": NaN, 0, False or an empty word."""
    return np.full(shape, np.nan) if dtype.kind == "f" else np.zeros(shape, "U7" if dtype.kind == "U" else dtype)


def _judge(
    data: xr.Dataset, at: tuple[int, int], wi: Vectors, detector: Detector, model: Model, level: float
) -> dict[str, Any]:
    """One incidence's columns of the table, each (W,) or a scalar."""
    wavelengths = data["wavelength"].values
    average = model.average(wi, detector, wavelengths)
    covers = isinstance(detector, HemisphereGrid)
    solid = detector.projected_solid_angles()
    whole = solid @ average if covers else _FINE.projected_solid_angles() @ model.average(wi, _FINE, wavelengths)
    lobe = _lobe(_incidence(data, at), average, solid, whole)
    return {**_albedo(data, at, whole, level), **lobe, "bins_measured": detector.bins}


def _incidence(data: xr.Dataset, at: tuple[int, int]) -> _Incidence:
    chosen = data.sel(order="1").isel(theta_i=at[0], phi_i=at[1])
    brdf, error, error_mc = (
        chosen[name].transpose(..., "wavelength").values.reshape(-1, data.sizes["wavelength"])
        for name in ("brdf", "standard_error", "standard_error_mc")
    )
    return _Incidence(brdf, error, error_mc, chosen["hits"].values.ravel(), float(chosen["degrees_of_freedom"]))


# --- Albedo -----------------------------------------------------------------------------------------------------------


def _albedo(data: xr.Dataset, at: tuple[int, int], model: Array, level: float) -> dict[str, Any]:
    """Measured and model albedo, and Student's t of their difference; each (W,)."""
    from scipy.special import stdtr

    chosen = data.sel(order="1").isel(theta_i=at[0], phi_i=at[1])
    measured, error = chosen["albedo"].values, chosen["albedo_standard_error"].values
    freedom = float(chosen["degrees_of_freedom"])
    z = _in_units(measured - model, np.hypot(error, TOLERANCE * model))
    p_value = 2.0 * stdtr(freedom, -np.abs(z))
    return {
        "albedo_measured": measured,
        "albedo_standard_error": error,
        "albedo_standard_error_mc": chosen["albedo_standard_error_mc"].values,
        "albedo_model": model,
        "z": z,
        "degrees_of_freedom": freedom,
        "p_value": p_value,
        "albedo_differs": p_value < level,
    }


def _in_units(value: Array, unit: Array) -> Array:
    """`value` in units of `unit`; 0 where both are 0, infinite where only the unit is."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(value == 0.0, 0.0, value / unit)


# --- Lobe -------------------------------------------------------------------------------------------------------------


def _lobe(measured: _Incidence, model: Array, solid: Array, albedo: Array) -> dict[str, Any]:
    """L1 difference and share of pooled bins outside their interval, with what noise alone would give; each (W,)."""
    from scipy.special import stdtrit

    first = _pools(measured.hits)
    power = solid[:, None]
    difference = np.add.reduceat((measured.brdf - model) * power, first)
    numerical = TOLERANCE * np.add.reduceat(model * power, first)
    variance, freedom = _pooled_variance(measured.error * power, measured.freedom, measured.hits, first)
    variance_mc = np.add.reduceat((measured.error_mc * power) ** 2, first)
    error, error_mc = np.sqrt(variance + numerical**2), np.sqrt(np.minimum(variance, variance_mc) + numerical**2)
    outside = np.abs(difference) > stdtrit(freedom, (1.0 + CONFIDENCE) / 2.0) * error
    l1 = np.abs(difference).sum(axis=0)
    noise, floor, ceiling = _l1_limits(error, error_mc, freedom, measured.freedom)
    return {
        "l1": _in_units(l1, albedo),
        "l1_noise": _in_units(noise, albedo),
        "l1_noise_mc": _in_units(_expected_l1(error_mc, freedom).sum(axis=0), albedo),
        "lobe": np.where(l1 <= floor, "noise", np.where(l1 <= ceiling, "unclear", "differs")),
        "share_outside": outside.mean(axis=0),
        "share_noise_expected": 1.0 - CONFIDENCE,
        "bins": first.size,
    }


def _pools(hits: NDArray[np.int64]) -> NDArray[np.intp]:
    """Where each pool of consecutive bins starts: a pool ends with the bin that gives it enough hits.

    What is left over at the end joins the last pool, so that every bin, and all of the energy, is in one pool.
    """
    starts, filled = [0], 0
    for index, count in enumerate(hits.tolist()):
        if filled >= ENOUGH_HITS:
            starts.append(index)
            filled = 0
        filled += count
    return np.asarray(starts if filled >= ENOUGH_HITS or len(starts) == 1 else starts[:-1], np.intp)


def _pooled_variance(
    error: Array, freedom: float, hits: NDArray[np.int64], first: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Variance (pools, W) of the sum of a pool's bins, and its degrees of freedom (Welch and Satterthwaite).

    Bins are taken as independent. A count of n hits knows its own variance no better than 2 n degrees of freedom do.
    """
    variance = np.add.reduceat(error**2, first)
    fourth = np.add.reduceat(error**4, first)
    count = np.add.reduceat(hits, first)[:, None]
    size = np.diff(np.append(first, hits.size))[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        welch = np.where(fourth > 0.0, freedom * variance**2 / fourth, freedom)
    return variance, np.where(size == 1, freedom, np.minimum(welch, np.maximum(2 * count, freedom)))


def _expected_l1(error: Array, freedom: Array | float) -> Array:
    """Mean of |noise| where the standard error, itself estimated, is `error`; 0.80 of it if it is sure."""
    return np.asarray(np.sqrt(2.0 / np.pi) * error / _bias(freedom))


def _bias(freedom: Array | float) -> Array:
    """Mean of an estimated standard deviation over the true one, c4 (Cureton 1968)."""
    from scipy.special import gammaln

    n = np.asarray(freedom, np.float64)
    return np.asarray(np.sqrt(2.0 / n) * np.exp(gammaln((n + 1.0) / 2.0) - gammaln(n / 2.0)))


def _l1_limits(error: Array, error_mc: Array, freedom: Array, freedom_specimens: float) -> tuple[Array, Array, Array]:
    """L1 expected from noise alone; the most that independent noise gives; the most that coherent noise could give."""
    from scipy.special import stdtrit

    expected = _expected_l1(error, freedom)
    noise = expected.sum(axis=0)
    # |noise| of one bin has the standard deviation sqrt(pi / 2 - 1) times its mean.
    independent = noise + 3.0 * np.sqrt((np.pi / 2.0 - 1.0) * (expected**2).sum(axis=0))
    realisation = _expected_l1(np.sqrt(np.maximum(error**2 - error_mc**2, 0.0)), freedom).sum(axis=0)
    mean = np.sqrt(2.0 / np.pi) / _bias(freedom_specimens)
    coherent = stdtrit(freedom_specimens, (1.0 + CONFIDENCE) / 2.0) / mean
    return noise, independent, independent + (coherent - 1.0) * realisation


# --- Words ------------------------------------------------------------------------------------------------------------


def _describe(row: dict[str, Any], name: str) -> list[str]:
    """Two sentences on one incidence."""
    where = f"theta_i {row['theta_i']:g}"
    where += f", phi_i {row['phi_i']:g}" if row["several"]["phi_i"] else ""
    where += f", {row['wavelength']:g} nm" if row["several"]["wavelength"] else ""
    return [f"{where}: {_albedo_sentence(row, name)}", f"{where}: {_lobe_sentence(row)}"]


def _albedo_sentence(row: dict[str, Any], name: str) -> str:
    measured, error, model = row["albedo_measured"], row["albedo_standard_error"], row["albedo_model"]
    digits = int(np.clip(1 - np.floor(np.log10(error)), 4, 8)) if error > 0.0 else 6
    if measured > 0.0:
        comparison = f"{_percent(abs(model / measured - 1.0))} {'lower' if model < measured else 'higher'}"
    else:
        comparison = "nothing was measured"
    judgement = "not noise" if row["albedo_differs"] else "within the noise"
    return (
        f"order-1 albedo {measured:.{digits}f} ± {error:.{digits}f}, {name} {model:.{digits}f}: {comparison}, "
        f"t = {row['z']:.3g} with {row['degrees_of_freedom']:.0f} degrees of freedom, "
        f"p = {row['p_value']:.2g}: {judgement}."
    )


def _lobe_sentence(row: dict[str, Any]) -> str:
    words = {
        "noise": "that is noise",
        "unclear": "more than independent noise, but specimens can shift a whole lobe: more realisations would tell",
        "differs": "not noise",
    }
    return (
        f"the lobe differs by {_percent(row['l1'])} (L1), of which noise alone would give {_percent(row['l1_noise'])}; "
        f"{_percent(row['share_outside'])} of {row['bins']} pooled bins are outside their 95 % interval, noise leaves "
        f"{_percent(row['share_noise_expected'])}: {words[str(row['lobe'])]}."
    )


def _percent(share: float) -> str:
    """Two significant digits, such as 0.012 %, 3.7 % or 85 %."""
    value = 100.0 * float(share)
    return f"{value:.2g} %" if value < 99.5 else f"{value:.0f} %"
