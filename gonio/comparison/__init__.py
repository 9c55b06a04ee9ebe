"""How well a model describes a measurement, and how much of the difference is noise.

Models are compared with the light they speak of, most with order 1, the light that hit the surface once; and as what
the instrument measures: averages over the detector's bins.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.detectors import Detector, HemisphereGrid, Klems
from gonio.measurement import Measurement
from gonio.models import Model
from gonio.models.averages import TOLERANCE, Estimate, RandomWalk
from gonio.sphere import direction
from gonio.wording import percent
from microsurfaces.arrays import Floats, Vectors
from microsurfaces.atomic_write import atomic_write

if TYPE_CHECKING:
    import xarray as xr

ENOUGH_HITS = 10
"""Bins with fewer hits are pooled with their neighbours before anything is said about a bin."""

CONFIDENCE = 0.95
"""Level of a bin's interval, and of all judgements of one comparison together."""

FLOOR = 0.01
"""Share of a lobe's peak below which logarithms of it are not compared."""

_SURE = 1e6
"""Degrees of freedom with which nothing is left to know of a standard error."""

_FINE = HemisphereGrid(theta_step=2.0, phi_step=3.0)
"""Where a model's albedo is summed if the detector does not cover the hemisphere."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A model judged against a measurement: numbers in `table`, words from `sentences()`.

    `table` is an `xarray.Dataset` over theta_i, phi_i, wavelength, NaN where nothing was measured, and in all that
    speaks of noise where a measurement from elsewhere gives no errors (truth values are False there):

    * `albedo_measured`, `albedo_standard_error`, `albedo_standard_error_mc` (its Monte Carlo part), `albedo_model`: the
      directional-hemispherical reflectance of the compared order; `albedo_bias`: model / measured - 1;
    * `z`, `p_value`: their difference (measured - model) in standard errors, and the probability of one at least as
      large by chance, by Student's t with `degrees_of_freedom` (infinite for a measurement that comes from
      elsewhere: its errors are taken as they are); `albedo_significant`: whether that is less than 5 %, all
      the incidences and wavelengths of the comparison together (Sidak); `albedo_within_mc`: whether Monte Carlo noise
      alone explains it;
    * `l1`: the lobe's difference, the sum of |measured - model| times projected solid angle over the pooled bins, as a
      share of the model's albedo; `l1_noise`: what noise alone is expected to add up to, `l1_noise_mc` the Monte Carlo
      noise alone; `lobe`: "consistent", "inconclusive" or "significant" (see `compare`), "unknown" without errors, and
      `lobe_within_mc`: whether Monte Carlo noise alone explains it;
    * `l2`, `l2_noise`: root mean square over projected solid angle, as a share of that of the model;
    * `log_rms`, `log_rms_noise`: root mean square over projected solid angle of ln(measured / model) where both exceed
      `floor` times the model's peak (0.1 is a typical factor of 1.1);
    * `chi2`, `chi2_mc`: mean square difference in standard errors, which is 1 if there is nothing but noise (the
      uncertainty of the standard errors is taken out); the second with Monte Carlo noise only. NaN where fewer than 4
      specimens do not allow it;
    * `share_outside`: share of the pooled bins in which the model is outside the 95 % interval of the measurement;
      `share_noise_expected`: the share that noise alone leaves outside;
    * `bins`: pooled bins that were judged, `bins_measured`: bins of the detector. Bins of which nothing is known do not
      take part, and albedos are those of the others.

    `lobes` is an `xarray.Dataset` over theta_i, phi_i, the detector's bins and wavelength, in 1/sr: `measured`,
    `standard_error`, `model`; and `significance`: (measured - model) in standard errors, of the pool that a bin is in.
    """

    table: xr.Dataset
    """The numbers."""
    lobes: xr.Dataset
    """Bin by bin."""
    model: Model
    """The model that was judged."""
    order: str
    """The order of scattering that it was compared with: "1", "all" ..."""
    scope: Literal["specimen", "ensemble", "external"]
    """What the error bars speak of: this one specimen (one realisation), the class that several were drawn from, or
    whatever those mean by them who made a measurement that comes from elsewhere."""
    realisations: int
    """How many specimens the measurement holds (the fewest of any incidence); 0 if that is not known."""
    beam_half_angle: float
    """Half the angle of the source's beam, degrees."""
    floor: float
    """Share of the peak below which logarithms were not compared."""
    channels: tuple[str, ...]
    """What the values along `wavelength` are called: "550 nm", "R" ..."""

    def sentences(self) -> list[str]:
        """The comparison in plain sentences: what it speaks of, then two for each incidence, at its worst
        wavelength."""
        return [*self.preamble(), *(line for row in self.worst_rows() for line in self._describe(row))]

    def preamble(self) -> list[str]:
        """What the comparison speaks of."""
        if self.scope == "external":
            return [*self._of_errors(), *self._of_orders(), *self._of_unknown()]
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
            f"The source's beam has a half angle of {self.beam_half_angle:g} degrees, over which the model is not "
            "averaged: differences of narrow lobes may be due to that."
        )
        return [scope, beam]

    def _of_errors(self) -> Iterator[str]:
        """What there is to say of the errors of a measurement from elsewhere."""
        lobes = [row["lobe"] for row in self.rows()]
        if "unknown" not in lobes:
            yield (
                "The measurement comes from elsewhere: its errors are those in its file, taken as independent from bin "
                "to bin."
            )
        else:
            where = "" if set(lobes) == {"unknown"} else " of some incidences or wavelengths"
            yield (
                f"The measurement comes from elsewhere, and its file gives no errors{where}: differences are told, but "
                "not what noise explains of them."
            )

    def _of_orders(self) -> Iterator[str]:
        if self.order != self.model.order:
            hits = "one hit" if self.model.order == "1" else f"{self.model.order} hits"
            yield (
                f"Its file does not keep apart how often light has hit the surface: {type(self.model).__name__}, which "
                f"speaks of the light of {hits}, was compared with all of it."
            )

    def _of_unknown(self) -> Iterator[str]:
        judged = self.table["bins"].values
        missing = (self.table["bins_measured"].values - judged)[judged > 0]
        if missing.any():
            few, many = int(missing.min()), int(missing.max())
            yield (
                f"The file knows nothing of {few if few == many else f'{few} to {many}'} of the "
                f"{int(self.table['bins_measured'].max())} bins: they do not take part, and albedos are those of the "
                "others."
            )

    def conclusion(self) -> str:
        """Whether the model may be trusted, in one sentence: below which noise the disagreement is, or how large."""
        rows = self.rows()
        differs = [row for row in rows if row["albedo_significant"] or row["lobe"] == "significant"]
        if differs:
            lobes = [row["l1"] - row["l1_noise"] for row in differs if row["lobe"] == "significant"]
            lobe = f", its lobe by up to {percent(max(lobes))} (L1) beyond noise" if lobes else ""
            return (
                f"noise does not explain the difference at {len(differs)} of {len(rows)} incidences and wavelengths; "
                f"{_albedo_off(differs)}{lobe}."
            )
        if any(row["lobe"] == "unknown" for row in rows):
            return (
                f"without errors nobody can say what noise explains; {_albedo_off(rows)}, its lobe by up to "
                f"{percent(max(row['l1'] for row in rows))} (L1)."
            )
        albedo = max(2.0 * row["albedo_standard_error"] / max(row["albedo_measured"], 1e-300) for row in rows)
        lobe = max(row["l1_noise"] for row in rows)
        level = f"{percent(albedo)} of the albedo (two standard errors) and {percent(lobe)} of the lobe (L1)"
        if any(row["lobe"] == "inconclusive" for row in rows):
            return f"specimens differ too much to tell; more realisations would. They limit it to {level}."
        within_mc = all(row["albedo_within_mc"] and row["lobe_within_mc"] for row in rows)
        noise = "the Monte Carlo noise" if within_mc else "the noise of specimens, though not of Monte Carlo"
        noise = "the noise that its file tells" if self.scope == "external" else noise
        return f"the disagreement is below {noise}, which is up to {level}."

    def save(self, path: str | Path) -> Path:
        """Write `table` and `lobes` as two groups of one netCDF file; it appears whole or not at all."""
        path = Path(path)
        about = {"model": repr(self.model), "order": self.order, "scope": self.scope, "floor": self.floor}
        about["channels"] = ", ".join(self.channels)
        with atomic_write(path) as temporary:
            # netCDF knows no truth values.
            flags = {name: variable.astype("int8") for name, variable in self.table.items() if variable.dtype == bool}
            self.table.assign_attrs(about).assign(flags).to_netcdf(temporary, engine="h5netcdf", group="table")
            self.lobes.assign_attrs(about).to_netcdf(temporary, engine="h5netcdf", group="lobes", mode="a")
        return path

    def rows(self) -> list[dict[str, Any]]:
        """One row of `table` an incidence and wavelength, with what that is called as `channel`.

        `several` tells which of the coordinates vary.
        """
        several = {name: self.table.sizes[name] > 1 for name in ("phi_i", "wavelength")}
        rows = []
        for i, j, w in zip(*np.nonzero(self.table["bins"].values), strict=True):
            cell = self.table.isel(theta_i=i, phi_i=j, wavelength=w)
            values = {str(name): variable.values[()] for name, variable in cell.variables.items()}
            rows.append({**values, "channel": self.channels[w], "several": several})
        return rows

    def worst_rows(self) -> list[dict[str, Any]]:
        """One row of `table` an incidence, the wavelength at which the albedos differ most."""
        incidences = itertools.groupby(self.rows(), key=lambda row: (row["theta_i"], row["phi_i"]))
        return [max(rows, key=_albedo_ratio) for _, rows in incidences]

    def worst_bins(self, count: int = 5) -> list[dict[str, Any]]:
        """The `count` bins that add most to the L1 differences beyond doubt (3 standard errors), the largest first.

        Of every bin the wavelength that differs most. Each has its coordinates and `channel`, `measured`,
        `standard_error`, `model` (1/sr), `significance` (standard errors) and `share` of the incidence's L1 difference.
        """
        difference = abs(self.lobes["measured"] - self.lobes["model"]) * self.lobes["projected_solid_angle"]
        bins = [name for name in difference.dims if name not in self.table.dims]
        share = difference / difference.sum(bins)
        doubtless = share.where(abs(self.lobes["significance"]) > 3.0, 0.0).fillna(0.0)
        doubtless = doubtless.where(doubtless["wavelength"] == doubtless.idxmax("wavelength"), 0.0)
        order = np.argsort(doubtless.values, axis=None)[::-1][:count]
        rows = []
        for index in zip(*np.unravel_index(order, doubtless.shape), strict=True):
            at = dict(zip(map(str, doubtless.dims), index, strict=True))
            if doubtless.values[index] == 0.0:
                break
            names = ("measured", "standard_error", "model", "significance")
            rows.append(
                {
                    **{name: float(doubtless[name].values[place]) for name, place in at.items()},
                    **{name: float(self.lobes[name].isel(at)) for name in names},
                    "channel": self.channels[at["wavelength"]],
                    "share": float(share.values[index]),
                }
            )
        return rows

    def _describe(self, row: dict[str, Any]) -> list[str]:
        """Two sentences on one incidence."""
        where = f"theta_i {row['theta_i']:g}"
        where += f", phi_i {row['phi_i']:g}" if row["several"]["phi_i"] else ""
        where += f", {row['channel']}" if row["several"]["wavelength"] else ""
        return [f"{where}: {self._albedo_sentence(row)}", f"{where}: {self._lobe_sentence(row)}"]

    def _which_noise(self, within_mc: bool) -> str:
        if self.scope == "external":
            return "within the errors of the file"
        return (
            "within the Monte Carlo noise" if within_mc else "above the Monte Carlo noise, within what specimens differ"
        )

    def _albedo_sentence(self, row: dict[str, Any]) -> str:
        measured, error, model = row["albedo_measured"], row["albedo_standard_error"], row["albedo_model"]
        if measured > 0.0:
            comparison = f"{percent(abs(row['albedo_bias']))} {'lower' if model < measured else 'higher'}"
        else:
            comparison = "nothing was measured"
        albedo, name = "albedo" if self.order == "all" else f"order-{self.order} albedo", type(self.model).__name__
        if np.isnan(error):
            return f"{albedo} {measured:.4f}, {name} {model:.4f}: {comparison}."
        digits = int(np.clip(1 - np.floor(np.log10(error)), 4, 8)) if error > 0.0 else 6
        freedom = row["degrees_of_freedom"]
        score = (
            f"t = {row['z']:.3g} with {freedom:.0f} degrees of freedom" if freedom < np.inf else f"z = {row['z']:.3g}"
        )
        judgement = "not noise" if row["albedo_significant"] else self._which_noise(row["albedo_within_mc"])
        return (
            f"{albedo} {measured:.{digits}f} ± {error:.{digits}f}, {name} {model:.{digits}f}: {comparison}, {score}, "
            f"p = {row['p_value']:.2g}: {judgement}."
        )

    def _lobe_sentence(self, row: dict[str, Any]) -> str:
        if row["lobe"] == "unknown":
            return f"the lobe differs by {percent(row['l1'])} (L1)."
        words = {
            "consistent": self._which_noise(row["lobe_within_mc"]),
            "inconclusive": (
                "more than independent noise, but specimens can shift a whole lobe: more realisations would tell"
            ),
            "significant": "not noise",
        }
        bins = "bins" if self.scope == "external" else "pooled bins"
        return (
            f"the lobe differs by {percent(row['l1'])} (L1), of which noise alone would give "
            f"{percent(row['l1_noise'])}; {percent(row['share_outside'])} of {row['bins']} {bins} are outside their "
            f"95 % interval, noise leaves {percent(row['share_noise_expected'])}: {words[str(row['lobe'])]}."
        )


def _albedo_ratio(row: dict[str, Any]) -> float:
    """How far apart the albedos are; a ratio of nothing to nothing is no difference."""
    model, measured = (max(float(row[f"albedo_{x}"]), 1e-300) for x in ("model", "measured"))
    return abs(float(np.log(model / measured)))


def _albedo_off(rows: list[dict[str, Any]]) -> str:
    """How far the model's albedo is off, in words, at the worst of these rows."""
    worst = max(rows, key=_albedo_ratio)
    off = f"off by up to {worst['albedo_bias']:+.2%}" if worst["albedo_measured"] else "not 0"
    return f"its albedo is {off} (theta_i {worst['theta_i']:g}, {worst['channel']})"


class _Incidence(NamedTuple):
    """What was measured at one incidence, one order: bins flattened in theta_o, dphi order."""

    brdf: Floats
    """(bins, W)"""
    error: Floats
    """(bins, W)"""
    error_mc: Floats
    """(bins, W)"""
    albedo: Floats
    """(W,)"""
    albedo_error: Floats
    """(W,)"""
    albedo_error_mc: Floats
    """(W,)"""
    hits: NDArray[np.int64] | None
    """(bins,); None if nobody counted."""
    freedom: float
    """Degrees of freedom of the errors; `_SURE` if they are taken as they are."""
    freedom_mc: float
    """Degrees of freedom of their Monte Carlo part."""

    def among(self, bins: NDArray[np.bool_], w: slice) -> _Incidence:
        """Some of the bins at some wavelengths; the albedo is that of all bins that are known."""
        hits = None if self.hits is None else self.hits[bins]
        return _Incidence(
            self.brdf[bins, w],
            self.error[bins, w],
            self.error_mc[bins, w],
            self.albedo[w],
            self.albedo_error[w],
            self.albedo_error_mc[w],
            hits,
            self.freedom,
            self.freedom_mc,
        )


class _Prediction(NamedTuple):
    """What a model says of one incidence."""

    brdf: Floats
    """(bins, W)"""
    random: Floats
    """(bins, W), standard errors of a model that is a random walk; 0 for all others."""
    albedo: Floats
    """(W,)"""
    albedo_error: Floats
    """(W,)"""

    def among(self, bins: NDArray[np.bool_], w: slice, solid: Floats) -> _Prediction:
        """Some of the bins, of projected solid angles `solid`, at some wavelengths, and their part of the albedo."""
        brdf, random = self.brdf[bins, w], self.random[bins, w]
        albedo = solid @ brdf
        return _Prediction(brdf, random, albedo, np.hypot(TOLERANCE * albedo, np.sqrt(solid**2 @ random**2)))


def order_of(measurement: Measurement, model: Model) -> str:
    """The order of scattering that `model` is held against: its own, or "all" where orders were not kept apart.

    Raises ValueError if other orders were kept apart than the model's.
    """
    known = [str(order) for order in measurement.dataset["order"].values]
    if known == ["all"]:
        return "all"
    if model.order not in known:
        raise ValueError(f"the measurement has no order {model.order!r}, only {', '.join(known)}.")
    return model.order


def predicted(model: Model, wi: Vectors, detector: Detector, wavelengths: Floats) -> Estimate:
    """Bin averages (bins, W) of `model` in 1/sr with their random standard errors, 0 for models that have none."""
    if isinstance(model, RandomWalk):
        value, error = model.estimate(wi, detector, wavelengths, orders=1)
        return Estimate(value[0], error[0])
    average = model.average(wi, detector, wavelengths)
    return Estimate(average, np.zeros_like(average))


def compare(measurement: Measurement, model: Model, floor: float = FLOOR) -> Comparison:
    """Judge `model` against the order of `measurement` that it speaks of, incidence by incidence, bin by bin.

    A measurement that comes from elsewhere keeps no orders apart: `model` is judged against all of its light. Every bin
    counts on its own with the error that it has; without errors differences are told, but not what noise explains.
    Bins with fewer than 10 hits, or whose error says that they are worth fewer, are pooled with those that follow them
    in theta_o, dphi order until a pool has 10.
    Noise is what the standard errors say: Monte Carlo noise if one realisation was measured, and the difference between
    specimens as well if several were. The numerical error of the model's averages counts as noise too. `floor` is the
    share of the lobe's peak below which logarithms are not compared.

    The albedo differs if Student's t says so (see `Comparison`). The lobe is "consistent" as long as its L1 difference
    stays within three standard deviations of what independent noise in every bin adds up to. But specimens may move a
    lobe as a whole: "significant" needs more than realisation noise could give even if it were the same in all bins
    (97.5 % limit); between the two it is "inconclusive", and more realisations would tell.

    Raises ValueError if the measurement holds no incidence or not the model's order, if its light came from whole
    patches (`Klems`), or if the model cannot be averaged over its bins.
    """
    import xarray as xr

    if isinstance(measurement.detector, Klems):
        raise ValueError(
            "The light of this measurement came from Klems's whole patches, over which models are not averaged: "
            "measure with the detector HemisphereGrid to compare them."
        )
    data, there, order = measurement.dataset, np.nonzero(measurement.measured), order_of(measurement, model)
    if not there[0].size:
        raise ValueError("The measurement holds no measured incidence to compare with: run it again to the end.")
    shape = tuple(data.sizes[name] for name in ("theta_i", "phi_i", "wavelength"))
    detector = measurement.detector
    columns: dict[str, NDArray[Any]] = {}
    lobes = {name: np.full((*shape[:2], detector.bins, shape[2]), np.nan) for name in _BINNED}
    level = 1.0 - CONFIDENCE ** (1.0 / (there[0].size * shape[2]))
    for i, j in zip(*there, strict=True):
        wi = direction(data["theta_i"].values[i], data["phi_i"].values[j])
        rows, binned = _judge(data.sel(order=order).isel(theta_i=i, phi_i=j), wi, detector, model, level, floor)
        for w, row in rows:
            for name, values in row.items():
                columns.setdefault(name, _blank(shape, np.asarray(values).dtype))[i, j, w] = values
        for name, values in zip(_BINNED, binned, strict=True):
            lobes[name][i, j] = values
    coordinates = {name: data[name].values for name in ("theta_i", "phi_i", "wavelength")}
    table = xr.Dataset({name: (tuple(coordinates), column) for name, column in columns.items()}, coordinates)
    scope, realisations, beam = _scope(measurement)
    binned_lobes = _bin_by_bin(data, detector, lobes)
    return Comparison(table, binned_lobes, model, order, scope, realisations, beam, floor, measurement.channels)


def _scope(measurement: Measurement) -> tuple[Literal["specimen", "ensemble", "external"], int, float]:
    """What the errors of a measurement speak of, how many specimens it holds, and half the angle of the source's
    beam."""
    if "realisations" not in measurement.dataset:
        return "external", 0, 0.0
    realisations = int(measurement.dataset["realisations"].values[measurement.measured].min())
    beam = float(json.loads(measurement.attributes["goniometer"]).get("beam_half_angle", 0.0))
    return "specimen" if realisations == 1 else "ensemble", realisations, beam


_BINNED = ("measured", "standard_error", "model", "significance")


def _bin_by_bin(data: xr.Dataset, detector: Detector, lobes: dict[str, Floats]) -> xr.Dataset:
    """The lobes, labelled as the measurement is."""
    import xarray as xr

    bins = data["brdf"].dims[3:-1]
    dims = ("theta_i", "phi_i", *bins, "wavelength")
    solid = detector.projected_solid_angles().reshape(detector.shape)
    variables = {name: (dims, values.reshape(*values.shape[:2], *detector.shape, -1)) for name, values in lobes.items()}
    units = {name: {"units": "1" if name == "significance" else "sr-1"} for name in variables}
    coordinates = {str(name): data[name].values for name in dims if name in data.coords}
    return xr.Dataset(
        {name: (*variable, units[name]) for name, variable in variables.items()}
        | {"projected_solid_angle": (bins, solid, {"units": "sr"})},
        coordinates,
    )


def _blank(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """An array that says "not measured": NaN, 0, False or an empty word."""
    return np.full(shape, np.nan) if dtype.kind == "f" else np.zeros(shape, "U12" if dtype.kind == "U" else dtype)


def _judge(
    data: xr.Dataset, wi: Vectors, detector: Detector, model: Model, level: float, floor: float
) -> tuple[list[tuple[slice, dict[str, Any]]], tuple[Floats, ...]]:
    """One incidence: columns of the table for all or for single wavelengths, and the bins, each (bins, W)."""
    prediction = _predict(model, wi, detector, data["wavelength"].values)
    measured = _incidence(data)
    solid = detector.projected_solid_angles()
    known = np.isfinite(measured.brdf)
    significance = np.full(known.shape, np.nan)
    rows = []
    if known.all():
        row, significance = _row(measured, prediction, solid, level, floor)
        rows.append((slice(None), row))
    else:
        for w in (slice(k, k + 1) for k in np.flatnonzero(known.any(axis=0)).tolist()):
            bins = known[:, w.start]
            there, said = measured.among(bins, w), prediction.among(bins, w, solid[bins])
            row, significance[bins, w] = _row(there, said, solid[bins], level, floor)
            rows.append((w, row))
    for _, row in rows:
        row["bins_measured"] = detector.bins
    return rows, (measured.brdf, measured.error, prediction.brdf, significance)


def _row(
    measured: _Incidence, prediction: _Prediction, solid: Floats, level: float, floor: float
) -> tuple[dict[str, Any], Floats]:
    """Columns of the table, each (W,) or a scalar, and the significance of every bin (bins, W)."""
    pools = _Pools(measured, prediction, solid)
    row = {
        **_albedo(measured, prediction, level),
        **_lobe(pools, prediction.albedo, measured.freedom),
        **_squares(pools, solid),
        **_logarithms(pools, solid, floor),
    }
    return row, pools.spread(pools.significance())


def _predict(model: Model, wi: Vectors, detector: Detector, wavelengths: Floats) -> _Prediction:
    """Bins and hemisphere."""
    brdf, random = predicted(model, wi, detector, wavelengths)
    if isinstance(model, RandomWalk):
        albedo, error = model.albedo(wi, wavelengths, orders=1)
        return _Prediction(brdf, random, albedo[0], error[0])
    covers = isinstance(detector, HemisphereGrid)
    solid = (detector if covers else _FINE).projected_solid_angles()
    albedo = solid @ (brdf if covers else model.average(wi, _FINE, wavelengths))
    return _Prediction(brdf, random, albedo, TOLERANCE * albedo)


def _incidence(data: xr.Dataset) -> _Incidence:
    brdf, error, error_mc = (
        data[name].transpose(..., "wavelength").values.reshape(-1, data.sizes["wavelength"])
        for name in ("brdf", "brdf_standard_error", "brdf_standard_error_mc")
    )
    total, error_of_total, error_of_total_mc = (
        data[f"albedo{suffix}"].values for suffix in ("", "_standard_error", "_standard_error_mc")
    )
    hits, freedom, freedom_mc = None, _SURE, _SURE
    if "count" in data:
        hits = data["count"].values.ravel()
        freedom, freedom_mc = (float(data[name]) for name in ("degrees_of_freedom", "degrees_of_freedom_mc"))
    return _Incidence(brdf, error, error_mc, total, error_of_total, error_of_total_mc, hits, freedom, freedom_mc)


# --- Albedo -----------------------------------------------------------------------------------------------------------


def _albedo(there: _Incidence, prediction: _Prediction, level: float) -> dict[str, Any]:
    """Measured and model albedo, and Student's t of their difference; each (W,)."""
    from scipy.special import stdtr

    model = prediction.albedo
    measured, error, error_mc = there.albedo, there.albedo_error, there.albedo_error_mc
    z = _in_units(measured - model, np.hypot(error, prediction.albedo_error))
    z_mc = _in_units(measured - model, np.hypot(error_mc, prediction.albedo_error))
    p_value = 2.0 * stdtr(there.freedom, -np.abs(z))
    return {
        "albedo_measured": measured,
        "albedo_standard_error": error,
        "albedo_standard_error_mc": error_mc,
        "albedo_model": model,
        "albedo_bias": _in_units(model - measured, measured),
        "z": z,
        "degrees_of_freedom": np.inf if there.freedom == _SURE else there.freedom,
        "p_value": p_value,
        "albedo_significant": p_value < level,
        "albedo_within_mc": 2.0 * stdtr(there.freedom_mc, -np.abs(z_mc)) >= level,
    }


def _in_units(value: Floats, unit: Floats) -> Floats:
    """`value` in units of `unit`; 0 where both are 0, infinite where only the unit is, NaN where it is not known."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((value == 0.0) & ~np.isnan(unit), 0.0, value / unit)


# --- Lobe -------------------------------------------------------------------------------------------------------------


def _at_most(freedom: Floats) -> Floats:
    """Degrees of freedom with which nothing is left to know, in place of more or of none."""
    return np.clip(np.where(freedom > 0.0, freedom, np.inf), None, _SURE)


class _Pools:
    """Neighbouring bins joined until they have enough hits: energies (pools, W), and what is uncertain about them."""

    def __init__(self, measured: _Incidence, prediction: _Prediction, solid: Floats) -> None:
        power = solid[:, None]
        self.first = _pools(measured.hits, measured.brdf * power, (measured.error * power) ** 2)
        self.size = np.diff(np.append(self.first, solid.size))
        self.measured = self._sum(measured.brdf * power)
        self.model = self._sum(prediction.brdf * power)
        numerical = (TOLERANCE * self.model) ** 2 + self._sum((prediction.random * power) ** 2)
        variance = self._sum((measured.error * power) ** 2)
        variance_mc = self._sum((measured.error_mc * power) ** 2)
        self.error = np.sqrt(variance + numerical)
        self.error_mc = np.sqrt(np.minimum(variance, variance_mc) + numerical)
        count = np.zeros((solid.size, 1), np.int64) if measured.hits is None else self._sum(measured.hits)[:, None]
        fourth, fourth_mc = (self._sum((error * power) ** 4) for error in (measured.error, measured.error_mc))
        # What is known of the model, without degrees of freedom, makes the sum of both the better known.
        surer, surer_mc = (_in_units(v + numerical, v) ** 2 for v in (variance, variance_mc))
        self.freedom = _at_most(self._freedom(variance, fourth, count, measured.freedom) * surer)
        self.freedom_mc = _at_most(self._freedom(variance_mc, fourth_mc, count, measured.freedom_mc) * surer_mc)

    def _sum(self, values: NDArray[Any]) -> NDArray[Any]:
        return np.add.reduceat(values, self.first)

    def _freedom(self, variance: Floats, fourth: Floats, count: NDArray[np.int64], freedom: float) -> Floats:
        """Degrees of freedom of the variance of a pool, its bins taken as independent (Welch and Satterthwaite).

        A count of n hits knows its own variance no better than 2 n degrees of freedom do.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            welch = np.where(fourth > 0.0, freedom * variance**2 / fourth, freedom)
        return np.where(self.size[:, None] == 1, freedom, np.minimum(welch, np.maximum(2 * count, freedom)))

    def significance(self) -> Floats:
        """(measured - model) in standard errors, (pools, W)."""
        return _in_units(self.measured - self.model, self.error)

    def spread(self, values: Floats) -> Floats:
        """What is known of pools (pools, W) for each of their bins (bins, W)."""
        return np.repeat(values, self.size, axis=0)


def _pools(hits: NDArray[np.int64] | None, energy: Floats, variance: Floats) -> NDArray[np.intp]:
    """Where each pool of consecutive bins starts: a pool ends with the bin that gives it enough hits.

    Where nobody counted `hits` every bin is a pool.

    They must be worth as many independent ones: where specimens differ, hits come in clusters from the few that have a
    facet of the right tilt, and energy^2 / variance (bins, W) counts these. What is left over at the end joins the last
    pool, so that every bin, and all of the energy, is in one pool.
    """
    if hits is None:
        return np.arange(len(energy))
    starts, filled, clusters = [0], 0, np.zeros((2, energy.shape[1]))
    for index, count in enumerate(hits.tolist()):
        if filled >= ENOUGH_HITS and (clusters[0] ** 2 >= ENOUGH_HITS * clusters[1]).all():
            starts.append(index)
            filled, clusters = 0, np.zeros_like(clusters)
        filled += count
        clusters += energy[index], variance[index]
    enough = filled >= ENOUGH_HITS and (clusters[0] ** 2 >= ENOUGH_HITS * clusters[1]).all()
    return np.asarray(starts if enough or len(starts) == 1 else starts[:-1], np.intp)


def _lobe(pools: _Pools, albedo: Floats, freedom: float) -> dict[str, Any]:
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
        "l1": _in_units(l1, albedo),
        "l1_noise": _in_units(noise, albedo),
        "l1_noise_mc": _in_units(noise_mc, albedo),
        "lobe": np.where(unknown, "unknown", outcome),
        "lobe_within_mc": l1 <= limit_mc,
        "share_outside": np.where(unknown, np.nan, outside.mean(axis=0)),
        "share_noise_expected": np.where(unknown, np.nan, 1.0 - CONFIDENCE),
        "bins": pools.first.size,
    }


def _squares(pools: _Pools, solid: Floats) -> dict[str, Floats]:
    """L2 difference and mean square difference in standard errors, with what noise alone would give; each (W,)."""
    area = np.add.reduceat(solid, pools.first)[:, None]
    scale = np.sqrt((pools.model**2 / area).sum(axis=0))
    l2, noise = (
        np.sqrt((x**2 / area).sum(axis=0)) for x in (pools.measured - pools.model, pools.error / _bias(pools.freedom))
    )
    return {
        "l2": _in_units(l2, scale),
        "l2_noise": _in_units(noise, scale),
        "chi2": _mean_square(pools.measured - pools.model, pools.error, pools.freedom),
        "chi2_mc": _mean_square(pools.measured - pools.model, pools.error_mc, pools.freedom_mc),
    }


def _mean_square(difference: Floats, error: Floats, freedom: Floats) -> Floats:
    """Mean over pools of squares of Student's t, as a multiple of what they are without a difference: nu / (nu - 2)."""
    if freedom.min() <= 2.0:
        return np.full(difference.shape[1], np.nan)
    return np.asarray((_in_units(difference, error) ** 2 * (1.0 - 2.0 / freedom)).mean(axis=0))


def _logarithms(pools: _Pools, solid: Floats, floor: float) -> dict[str, Floats]:
    """Root mean square of ln(measured / model) where both are above the floor, and that of noise alone; each (W,)."""
    area = np.broadcast_to(np.add.reduceat(solid, pools.first)[:, None], pools.model.shape)
    least = floor * (pools.model / area).max(axis=0)
    compared = (np.minimum(pools.measured, pools.model) / area >= least) & (least > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = (
            np.where(compared, x**2 * area, 0.0).sum(axis=0) / np.where(compared, area, 0.0).sum(axis=0)
            for x in (np.log(pools.measured / pools.model), pools.error / pools.measured)
        )
        rms, noise = (np.sqrt(square) for square in squares)
    return {"log_rms": rms, "log_rms_noise": noise}


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


def _l1_of_shifts(pools: _Pools, freedom: float) -> Floats:
    """How much more the specimens' differences could give if they were the same in all bins."""
    from scipy.special import stdtrit

    alone = np.sqrt(np.maximum(pools.error**2 - pools.error_mc**2, 0.0))
    mean = np.sqrt(2.0 / np.pi) / _bias(freedom)
    coherent = stdtrit(freedom, (1.0 + CONFIDENCE) / 2.0) / mean
    return np.asarray((coherent - 1.0) * _expected_l1(alone, pools.freedom).sum(axis=0))
