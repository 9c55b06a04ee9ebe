"""The comparison of a model with a measurement: its numbers, and how they are made."""

from __future__ import annotations

import itertools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from gonio.brdf import BRDF, Function
from gonio.comparison import sentences
from gonio.comparison.incidence import Incidence
from gonio.comparison.prediction import Prediction, order_of
from gonio.comparison.statistics import CONFIDENCE, albedo_ratio, measures
from gonio.detectors import Detector, Klems
from gonio.measurement import Measurement
from gonio.models import Model
from gonio.sphere import direction
from microsurfaces.arrays import Floats
from microsurfaces.atomic_write import atomic_write

if TYPE_CHECKING:
    import xarray as xr

RELATIVE_THRESHOLD = 0.01
"""Share of a lobe's peak below which logarithms of it are not compared."""

Scope = Literal["specimen", "ensemble", "external"]
"""What error bars speak of."""

_BINNED = ("measured", "standard_error", "model", "significance")


@dataclass(frozen=True, eq=False)
class Comparison:
    """A model judged against a measurement: numbers in `table`, words from `sentences()`.

    `table` is an `xarray.Dataset` over theta_i, phi_i, wavelength, NaN where nothing was measured, and in all that
    speaks of noise where an external measurement gives no errors (truth values are False there):

    * `albedo_measured`, `albedo_standard_error`, `albedo_standard_error_mc` (its Monte Carlo part), `albedo_model`: the
      directional-hemispherical reflectance of the compared order; `albedo_bias`: model / measured - 1;
    * `z`, `p_value`: their difference (measured - model) in standard errors, and the probability of one at least as
      large by chance, by Student's t with `degrees_of_freedom` (infinite for an external measurement: its errors are
      taken as they are); `albedo_significant`: whether that is less than 5 %, all the incidences and wavelengths of the
      comparison together (Sidak); `albedo_within_mc`: whether Monte Carlo noise alone explains it;
    * `l1`: the lobe's difference, the sum of |measured - model| times projected solid angle over the pooled bins, as a
      share of the model's albedo; `l1_noise`: what noise alone is expected to add up to, `l1_noise_mc` the Monte Carlo
      noise alone; `lobe`: "consistent", "inconclusive" or "significant" (see `compare`), "unknown" without errors, and
      `lobe_within_mc`: whether Monte Carlo noise alone explains it;
    * `l2`, `l2_noise`: root mean square over projected solid angle, as a share of that of the model;
    * `log_rms`, `log_rms_noise`: root mean square over projected solid angle of ln(measured / model) where both exceed
      `relative_threshold` times the model's peak (0.1 is a typical factor of 1.1);
    * `reduced_chi2`, `reduced_chi2_mc`: mean square difference in standard errors, which is 1 if there is nothing but
      noise (the uncertainty of the standard errors is taken out); the second with Monte Carlo noise only. NaN where
      fewer than 4 specimens do not allow it;
    * `share_outside`: share of the pooled bins in which the model is outside the 95 % interval of the measurement;
      `share_noise_expected`: the share that noise alone leaves outside;
    * `bins`: pooled bins that were judged, `bins_measured`: bins of the detector. Bins of which nothing is known do not
      take part, and albedos are those of the others.

    `lobes` is an `xarray.Dataset` over theta_i, phi_i, the detector's bins and wavelength, in 1/sr: `measured`,
    `standard_error`, `model`; `significance`: (measured - model) in standard errors, of the pool that a bin is in; and
    over the bins alone `projected_solid_angle` in sr.
    """

    table: xr.Dataset
    """The numbers."""
    lobes: xr.Dataset
    """Bin by bin."""
    model: Model | BRDF
    """The model that was judged."""
    order: str
    """The order of scattering that it was compared with: "1", "all" ..."""
    scope: Scope
    """What the error bars speak of: this one specimen (one realisation), the ensemble that several were drawn from, or
    whatever those mean by them who made an external measurement."""
    realisations: int
    """How many specimens the measurement holds (the fewest of any incidence); 0 if that is not known."""
    beam_half_angle: float
    """Half the angle of the source's beam, degrees."""
    relative_threshold: float
    """Share of the peak below which logarithms were not compared."""
    channels: tuple[str, ...]
    """What the values along `wavelength` are called: "550 nm", "R" ..."""

    def sentences(self) -> list[str]:
        """The comparison in plain sentences: what it speaks of, then two for each incidence, at its worst
        wavelength."""
        return [*self.preamble(), *(line for row in self.worst_rows() for line in sentences.described(self, row))]

    def preamble(self) -> list[str]:
        """What the comparison speaks of."""
        return sentences.preamble(self)

    def conclusion(self) -> str:
        """Whether the model may be trusted, in one sentence: with which noise it is consistent, or how far it is
        off."""
        return sentences.conclusion(self)

    def save(self, path: str | Path) -> Path:
        """Write `table` and `lobes` as two groups of one netCDF file; it appears whole or not at all."""
        path = Path(path)
        about = {
            "model": repr(self.model),
            "order": self.order,
            "scope": self.scope,
            "relative_threshold": self.relative_threshold,
            "channels": ", ".join(self.channels),
        }
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
        return [max(rows, key=albedo_ratio) for _, rows in incidences]

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
            rows.append(
                {
                    **{name: float(doubtless[name].values[place]) for name, place in at.items()},
                    **{name: float(self.lobes[name].isel(at)) for name in _BINNED},
                    "channel": self.channels[at["wavelength"]],
                    "share": float(share.values[index]),
                }
            )
        return rows


def compare(
    measurement: Measurement | BRDF,
    model: Model | BRDF | Measurement | Function,
    relative_threshold: float = RELATIVE_THRESHOLD,
) -> Comparison:
    """Judge `model` against the order of `measurement` that it speaks of, incidence by incidence, bin by bin.

    Another measurement, any `BRDF` and a Python function `f(wi, wo)` are judged like a model, against all light; the
    errors of a measurement in the model's place count where it has the same incidences and bins.
    An external measurement keeps no orders apart: `model` is judged against all of its light. Every bin counts on its
    own with the error that it has; without errors differences are told, but not what noise explains. Bins with a count
    below 10, or whose error says that they are worth fewer arrivals, are pooled with those that follow them in theta_o,
    dphi order until a pool has 10.
    Noise is what the standard errors say: Monte Carlo noise if one realisation was measured, and the difference between
    specimens as well if several were. The numerical error of the model's averages counts as noise too.
    `relative_threshold`, from 0 to 1, is the share of the lobe's peak below which logarithms are not compared.

    The albedo is significant if Student's t says so (see `Comparison`). The lobe is "consistent" as long as its L1
    difference stays within three standard deviations of what independent noise in every bin adds up to. But specimens
    may move a lobe as a whole: "significant" needs more than realisation noise could give even if it were the same in
    all bins (97.5 % limit); between the two it is "inconclusive", and more realisations would tell.

    Raises ValueError if the measurement holds no incidence or not the model's order, if its light came from whole
    patches (`Klems`), or if the model cannot be averaged over its bins.
    """
    import xarray as xr

    if isinstance(measurement, BRDF):
        measurement = measurement.measured()
    if isinstance(model, Measurement) or callable(model):
        model = BRDF.of(model, measurement.wavelengths)
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
        here = data.sel(order=order).isel(theta_i=i, phi_i=j)
        prediction = Prediction.of(model, wi, detector, here["wavelength"].values)
        rows, binned = _judged(Incidence.of(here), prediction, detector, level, relative_threshold)
        for w, row in rows:
            for name, values in row.items():
                columns.setdefault(name, _blank(shape, np.asarray(values).dtype))[i, j, w] = values
        for name, values in zip(_BINNED, binned, strict=True):
            lobes[name][i, j] = values
    coordinates = {name: data[name].values for name in ("theta_i", "phi_i", "wavelength")}
    table = xr.Dataset({name: (tuple(coordinates), column) for name, column in columns.items()}, coordinates)
    scope, realisations, beam = _scope(measurement)
    return Comparison(
        table=table,
        lobes=_bin_by_bin(data, detector, lobes),
        model=model,
        order=order,
        scope=scope,
        realisations=realisations,
        beam_half_angle=beam,
        relative_threshold=relative_threshold,
        channels=measurement.channels,
    )


def _scope(measurement: Measurement) -> tuple[Scope, int, float]:
    """What the errors of a measurement speak of, how many specimens it holds, and half the angle of the source's
    beam."""
    if "realisations" not in measurement.dataset:
        return "external", 0, 0.0
    realisations = int(measurement.dataset["realisations"].values[measurement.measured].min())
    beam = float(json.loads(measurement.attributes["goniometer"]).get("beam_half_angle", 0.0))
    return "specimen" if realisations == 1 else "ensemble", realisations, beam


def _judged(
    measured: Incidence, prediction: Prediction, detector: Detector, level: float, relative_threshold: float
) -> tuple[list[tuple[slice, dict[str, Any]]], tuple[Floats, ...]]:
    """One incidence: columns of the table for all or for single wavelengths, and the bins, each (bins, W)."""
    solid = detector.projected_solid_angles()
    known = np.isfinite(measured.brdf)
    significance = np.full(known.shape, np.nan)
    rows = []
    if known.all():
        columns, significance = measures(measured, prediction, solid, level, relative_threshold)
        rows.append((slice(None), columns))
    else:
        for w in (slice(k, k + 1) for k in np.flatnonzero(known.any(axis=0)).tolist()):
            bins = known[:, w.start]
            there, said = measured.among(bins, w), prediction.among(bins, w, solid[bins])
            columns, significance[bins, w] = measures(there, said, solid[bins], level, relative_threshold)
            rows.append((w, columns))
    for _, columns in rows:
        columns["bins_measured"] = detector.bins
    return rows, (measured.brdf, measured.error, prediction.brdf, significance)


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
