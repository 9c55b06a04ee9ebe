"""A measured BRDF: labelled values with an error bar each, the exact sums they come from, and their file.

`Measurement.dataset` is what one reads; `Measurement.sums` holds the integers that were counted. Everything in the
former follows from the latter, so measurements of further specimens merge exactly, in any order.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import TypeAdapter, ValidationError

from gonio.detectors import DETECTOR, Detector, HemisphereGrid
from gonio.html_drawing import in_plane, plane_of_incidence, thinned
from gonio.interpolation import Extrapolation, Interpolation
from gonio.optics import Material
from gonio.sphere import angles, as_directions
from gonio.tally import MAX_PATHS, UNIT, UInt128
from microsurfaces import Facets, Surface
from microsurfaces.arrays import Floats
from microsurfaces.html_card import html_card

if TYPE_CHECKING:
    import xarray as xr


def orders(count: int) -> tuple[str, ...]:
    """Labels of `count` numbers of surface hits kept apart, after their sum: ("all", "1", "2", "3+") for three."""
    return ("all", *map(str, range(1, count)), f"{count}+" if count > 1 else "1+")


ENERGY_BUDGET = ("launched", "escaped", "absorbed", "truncated", "lost")
"""Where the light went: launched = escaped + absorbed + truncated + lost."""

_WIDE = ("squared_deviations", "realisation_squares")
_ADDITIVE = ("weight", "count", "energy_budget", "paths", "realisations")
_MATERIAL: TypeAdapter[Material] = TypeAdapter(Material)
_SURFACE: TypeAdapter[Surface] = TypeAdapter(Surface)


@dataclass(frozen=True, eq=False)
class Measurement:
    """The result of a measurement.

    `dataset` is an `xarray.Dataset` over order, theta_i, phi_i, theta_o, dphi (or `detector` for apertures) and
    wavelength: `brdf` in 1/sr, `brdf_standard_error` (all that is uncertain), `brdf_standard_error_mc` (its Monte Carlo
    part), `count`, `albedo`, the energy budget in shares of 1, and their bounds. An incidence that was not measured has
    `paths` 0 and NaN.

    An external measurement (see `tabulated`) has the order "all" only, no count, paths and energy
    budget, and NaN for errors that are not known.
    """

    sums: xr.Dataset | None
    """Exact integer sums per incidence, in units of 2⁻³² path; the last bin is the whole hemisphere. None if it is
    external."""
    attributes: dict[str, Any]
    """Provenance: goniometer, detector, material, surface_statistics, facets (JSON), seed, versions, isotropic,
    interrupted."""
    external: xr.Dataset | None = None
    """The dataset of an external measurement."""

    @functools.cached_property
    def dataset(self) -> xr.Dataset:
        """Everything measured, with labels, units and provenance."""
        if self.external is not None:
            return self.external.assign_attrs(self.attributes)
        return _labelled(self.counted, self.detector, self.attributes)

    @property
    def counted(self) -> xr.Dataset:
        """`sums`; a ValueError for an external measurement."""
        if self.sums is None:
            raise ValueError(
                "this measurement comes from another program's file, without the sums that gonio counted: it can be "
                "compared, fitted, drawn and exported, but neither merged nor checked"
            )
        return self.sums

    @functools.cached_property
    def detector(self) -> Detector:
        """The detector recipe."""
        return DETECTOR.validate_json(self.attributes["detector"])

    @property
    def wavelengths(self) -> Floats:
        """Wavelengths in nm (W,)."""
        return np.asarray(self.dataset["wavelength"].values)

    @property
    def channels(self) -> tuple[str, ...]:
        """What the values along `wavelength` are called, (W,): "550 nm", or "R", "G", "B" where they are colours."""
        basis = str(self.attributes.get("basis", ""))
        if basis in ("RGB", "XYZ", "Y") and len(basis) == len(self.wavelengths):
            return tuple(basis)
        return tuple(f"{nm:g} nm" for nm in self.wavelengths)

    @property
    def isotropic(self) -> bool:
        """Whether only the relative azimuth matters: measured with `azimuth="average"`, or declared."""
        return bool(self.attributes["isotropic"])

    @property
    def interrupted(self) -> bool:
        """Whether the measurement was stopped before it was complete."""
        return bool(self.attributes["interrupted"])

    @property
    def material(self) -> Material | None:
        """The material recipe; None if the measurement is external and does not tell it."""
        try:
            return _MATERIAL.validate_json(self.attributes["material"])
        except (KeyError, ValidationError):
            if self.sums is None:
                return None
            raise

    @property
    def surface_statistics(self) -> dict[str, float | None]:
        """Statistics of the measured relief, the mean over realisations; none of an external measurement."""
        if self.sums is None and "surface_statistics" not in self.attributes:
            return {}
        statistics: dict[str, float | None] = json.loads(self.attributes["surface_statistics"])
        return statistics

    @property
    def surface(self) -> Surface | None:
        """The recipe of the surface; None if no experiment made the measurement, or if the recipe is not known here."""
        try:
            return _SURFACE.validate_json(json.dumps(json.loads(self.attributes["experiment"])["surface"]))
        except (KeyError, ValidationError):
            return None

    @property
    def facets(self) -> Facets | None:
        """What the facets of the measured relief are like, the mean over realisations; None if it was not noted."""
        noted = self.attributes.get("facets")
        return None if noted is None else Facets.from_dict(json.loads(noted))

    def incidences(self) -> Iterator[tuple[float, float]]:
        """(theta_i, phi_i) in degrees of every incidence that was measured."""
        for i, j in np.argwhere(self.measured):
            yield float(self.dataset["theta_i"][i]), float(self.dataset["phi_i"][j])

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Which incidences were measured, (theta_i, phi_i)."""
        return np.asarray(self.dataset["albedo"].sel(order="all").notnull().any("wavelength").values)

    def _repr_html_(self) -> str:
        """What a notebook shows: lobes in the plane of incidence, and key numbers."""
        sources = sorted({theta for theta, _ in self.incidences()})
        title = str(self.attributes.get("title") or "Measurement")
        return html_card(title, self._key_numbers(sources), self.sketch())

    def _key_numbers(self, sources: list[float]) -> dict[str, object]:
        """What a notebook tells, in words."""
        data, material = self.dataset, self.material
        middle = len(self.wavelengths) // 2
        rows: dict[str, object] = {
            "theta_i": ", ".join(f"{theta:g}°" for theta in sources) or "nothing was measured",
            "phi_i": "any: isotropic" if self.isotropic else ", ".join(f"{phi:g}°" for phi in data["phi_i"].values),
            "wavelengths": ", ".join(self.channels),
            "detector": self.detector,
        }
        if material is not None:
            rows["material"] = material
        if sources:
            first = np.argwhere(self.measured)[0]
            value, error = (
                float(data[name].sel(order="all").values[*first, middle])
                for name in ("albedo", "albedo_standard_error")
            )
            known = f" ± {error:.1g}" if np.isfinite(error) else ""
            rows["albedo"] = f"{value:.4g}{known} at theta_i = {sources[0]:g}°, {self.channels[middle]}"
        if self.sums is None:
            rows["origin"] = self.attributes.get("origin", "external")
        else:
            rows["paths"] = f"{int(data['paths'].sum()):,} in all{', interrupted' if self.interrupted else ''}"
        return rows

    def sketch(self) -> str:
        """A small drawing, as SVG: lobes of a few incidences at the middle wavelength."""
        sources = sorted({theta for theta, _ in self.incidences()})
        shown = [sources[k] for k in thinned(sources)]
        if "dphi" not in self.dataset.dims:
            return plane_of_incidence(shown)
        measured, nodes = self.measured, list(self.dataset["theta_i"].values)
        data = self.dataset[["brdf"]].isel(wavelength=len(self.wavelengths) // 2).sel(order="all")
        lobes = []
        for row in map(nodes.index, shown):
            angle, values = in_plane(data.isel(theta_i=row, phi_i=int(measured[row].argmax())))
            lobes.append((angle, np.maximum(values, 0.0) / max(float(values.max()), 1e-300)))
        return plane_of_incidence(shown, lobes)

    def as_isotropic(self) -> Measurement:
        """The same measurement, declared to depend on the relative azimuth only."""
        return replace(self, attributes={**self.attributes, "isotropic": 1})

    def albedo(self) -> xr.Dataset:
        """Directional-hemispherical reflectance: `albedo` and its standard error over theta_i, phi_i, wavelength."""
        return self.dataset[["albedo", "albedo_standard_error"]].sel(order="all", drop=True)

    def energy_budget(self) -> xr.Dataset:
        """Shares of the launched energy over theta_i, phi_i, wavelength: escaped, absorbed, truncated, lost."""
        if self.sums is None:
            raise ValueError("this measurement comes from another program's file, which keeps no energy budget")
        return self.dataset[list(ENERGY_BUDGET[1:])]

    def merge(self, other: Measurement) -> Measurement:
        """This measurement and that of further specimens, as one: exact, associative, commutative.

        Raises ValueError if the two were not measured in the same way, or if one of them is external.
        """
        ours, theirs = self.counted, other.counted
        for name in ("detector", "goniometer", "material"):
            if self.attributes[name] != other.attributes[name]:
                raise ValueError(f"measurements with a different {name} cannot be merged: measure both in the same way")
        both = (ours["paths"] > 0) & (theirs["paths"] > 0)
        if (both & (ours["replicates"] != theirs["replicates"])).any():
            raise ValueError("measurements with different numbers of paths per specimen cannot be merged")
        if int((ours["paths"] + theirs["paths"]).max()) > MAX_PATHS:
            raise ValueError(f"the merged measurement would hold more than {MAX_PATHS} paths per incidence")
        return replace(
            self,
            sums=_added(ours, theirs),
            attributes=_merged_attributes(self, other),
        )

    def average(self, wi: ArrayLike, detector: Detector, extrapolate: Extrapolation | None = None) -> Floats:
        """Cos-weighted averages over the bins of `detector` for light from `wi` (3,), 1/sr, shape (bins, W).

        At a measured incidence and with the measuring detector these are the measured values themselves; otherwise
        they are averages of `eval`. Raises ValueError outside the measured range, unless told to `extrapolate` (see
        `eval`).
        """
        theta, phi = (float(a) for a in angles(as_directions(wi, "wi")))
        nearest = self._incidence_at(theta, phi)
        if nearest is not None and detector == self.detector:
            values = self.dataset["brdf"].sel(order="all").values[nearest]
            return np.array(values.reshape(-1, len(self.wavelengths)))
        wo, weights = detector.quadrature(wi, nodes=4)
        return np.asarray((weights[..., None] * self.eval(wi, wo, extrapolate)).sum(axis=1))

    def standard_error(self, wi: ArrayLike) -> Floats | None:
        """That of the bins for light from `wi` (3,), 1/sr, (bins, W); None where it was not measured."""
        theta, phi = (float(a) for a in angles(as_directions(wi, "wi")))
        nearest = self._incidence_at(theta, phi)
        if nearest is None:
            return None
        values = self.dataset["brdf_standard_error"].sel(order="all").values[nearest]
        return np.array(values.reshape(-1, len(self.wavelengths)))

    def eval(self, wi: ArrayLike, wo: ArrayLike, extrapolate: Extrapolation | None = None) -> Floats:
        """BRDF in 1/sr for light from `wi` (..., 3) seen from `wo` (..., 3), shape (..., W); order "all".

        Between measured incidences lobes move with the half vector and keep their energy (see `interpolation`). Raises
        ValueError for apertures, outside the measured range of incidences, and for another azimuth of the light unless
        the data are isotropic; with `extrapolate="nearest"` the nearest measured incidence stands
        for those outside.
        """
        return self._between(as_directions(wi, "wi"), as_directions(wo, "wo"), extrapolate)

    @functools.cached_property
    def _between(self) -> Interpolation:
        """The function between the measured values."""
        if not isinstance(self.detector, HemisphereGrid):
            raise ValueError(
                "values between apertures or patches are not measured; use a HemisphereGrid to interpolate"
            )
        table = self.dataset["brdf"].sel(order="all").values
        theta_i, phi_i = self.dataset["theta_i"].values, self.dataset["phi_i"].values
        return Interpolation(table, self.detector, theta_i, phi_i, self.isotropic)

    def _incidence_at(self, theta: float, phi: float) -> tuple[int, int] | None:
        rows = np.flatnonzero(np.abs(self.dataset["theta_i"].values - theta) < 1e-6)
        apart = np.abs(self.dataset["phi_i"].values - phi) % 360
        columns = np.flatnonzero((np.minimum(apart, 360 - apart) < 1e-6) | self.isotropic)
        return (int(rows[0]), int(columns[0])) if rows.size and columns.size else None


def _added(a: xr.Dataset, b: xr.Dataset) -> xr.Dataset:
    """Sums of two measurements: plain integers, and 128-bit ones with their carry."""
    total = a.copy()
    for name in _ADDITIVE:
        total[name] = a[name] + b[name]
    total["replicates"] = np.maximum(a["replicates"], b["replicates"])
    for name in _WIDE:
        wide = UInt128(a[f"{name}_high"].values.copy(), a[f"{name}_low"].values.copy())
        wide.add(UInt128(b[f"{name}_high"].values, b[f"{name}_low"].values))
        total[f"{name}_high"] = (a[f"{name}_high"].dims, wide.high)
        total[f"{name}_low"] = (a[f"{name}_low"].dims, wide.low)
    return total


def _merged_attributes(a: Measurement, b: Measurement) -> dict[str, Any]:
    """Attributes of `a`, with what is known of the surface averaged over the realisations of both."""
    first, second = a.surface_statistics, b.surface_statistics
    n, m = int(a.counted["realisations"].max()), int(b.counted["realisations"].max())
    mean = {
        key: None if value is None or second.get(key) is None else (n * value + m * second[key]) / (n + m)  # type: ignore[operator]
        for key, value in first.items()
    }
    flags = {"isotropic": int(a.isotropic and b.isotropic), "interrupted": int(a.interrupted or b.interrupted)}
    pooled = {"surface_statistics": json.dumps(mean)}
    if a.facets is not None and b.facets is not None:
        pooled["facets"] = json.dumps(a.facets.pooled(b.facets, n, m).as_dict())
    # A self-check report speaks of the measurement that it was made for.
    kept = {name: value for name, value in a.attributes.items() if name != "self_check"}
    return {**kept, **flags, **pooled}


def _labelled(sums: xr.Dataset, detector: Detector, attributes: dict[str, Any]) -> xr.Dataset:
    """The dataset that one reads, from the sums that were counted."""
    import xarray as xr

    values, mc, whole = _estimates(sums)
    area = np.append(detector.projected_solid_angles(), 1.0)[:, None]
    incidence = ("theta_i", "phi_i")
    bin_dims = ("theta_o", "dphi") if isinstance(detector, HemisphereGrid) else ("detector",)
    per_bin, total = ("order", *incidence, *bin_dims, "wavelength"), ("order", *incidence, "wavelength")
    shape = detector.shape

    def binned(x: NDArray[Any]) -> NDArray[Any]:
        """(theta_i, phi_i, order, bin, ...) to (order, theta_i, phi_i, *bins, ...), without the hemisphere."""
        front = np.moveaxis(x[:, :, :, :-1], 2, 0)
        return front.reshape(*front.shape[:3], *shape, *front.shape[4:])

    variables: dict[str, Any] = {}
    for suffix, x in (("", values), ("_standard_error", whole), ("_standard_error_mc", mc)):
        variables[f"brdf{suffix}"] = (per_bin, binned(x / area))
        variables[f"albedo{suffix}"] = (total, np.moveaxis(x[:, :, :, -1], 2, 0))
    variables["count"] = (per_bin[:-1], binned(sums["count"].values))
    variables["projected_solid_angle"] = (bin_dims, area[:-1, 0].reshape(shape))
    variables |= _shares(sums["energy_budget"].values)
    for name in ("paths", "realisations", "replicates"):
        variables[name] = (incidence, sums[name].values)
    count, pilot = sums["realisations"].values, int(sums.attrs["pilot"])
    variables["degrees_of_freedom_mc"] = (incidence, count * (pilot - 1))
    variables["degrees_of_freedom"] = (incidence, np.where(count > 1, count - 1, pilot - 1))
    coords = {d: sums[d].values for d in ("order", *incidence, "wavelength")}
    where, bounds = _bins(detector)
    return _described(xr.Dataset({**variables, **bounds}, {**coords, **where}, attributes))


def _shares(budget: NDArray[np.int64]) -> dict[str, Any]:
    """What each termination took of the launched energy, from the integers (theta_i, phi_i, termination, W)."""
    with np.errstate(invalid="ignore"):
        shares = budget / budget[:, :, :1]
    return {name: (("theta_i", "phi_i", "wavelength"), shares[:, :, k]) for k, name in enumerate(ENERGY_BUDGET) if k}


def _estimates(sums: xr.Dataset) -> tuple[Floats, Floats, Floats]:
    """Mean share of the launched light in every bin, its Monte Carlo and its whole standard error.

    Arrays (theta_i, phi_i, order, bin, W). Per realisation the replicates' scatter r Σx² - (Σx)² gives the variance of
    one replicate; several realisations scatter by both noises together.
    """
    expand = (slice(None), slice(None), None, None, None)
    paths = sums["paths"].values[expand].astype(np.float64)
    count = sums["realisations"].values[expand].astype(np.float64)
    replicates = sums["replicates"].values[expand].astype(np.float64)
    pilot = int(sums.attrs["pilot"])
    total = sums["weight"].values
    squares = {name: UInt128(sums[f"{name}_high"].values, sums[f"{name}_low"].values) for name in _WIDE}
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = 1.0 / (paths * UNIT)
        variance = squares["squared_deviations"].floats() / (pilot * (pilot - 1))
        mc = np.sqrt(variance * replicates) * scale
        whole = mc
        if (count > 1).any():
            scatter = np.zeros(total.shape)
            for k in np.unique(sums["realisations"].values[sums["realisations"].values > 1]):
                chosen = sums["realisations"].values == k
                part = UInt128(*(np.ascontiguousarray(half[chosen]) for half in squares["realisation_squares"]))
                scatter[chosen] = part.squared_deviations(np.ascontiguousarray(total[chosen]), int(k)).floats()
            whole = np.where(count > 1, np.sqrt(scatter / (count - 1)) * scale, mc)
        return total * scale, mc, whole


_BUDGET_VERBS = {
    "escaped": "left the surface",
    "absorbed": "was absorbed",
    "truncated": "was still under way where the path was cut off",
    "lost": "was lost through numerical gaps",
}
_UNITS = {
    "brdf": ("sr-1", "bidirectional reflectance distribution function, cos-weighted bin average"),
    "brdf_standard_error": ("sr-1", "standard error of brdf: Monte Carlo and realisation noise"),
    "brdf_standard_error_mc": ("sr-1", "standard error of brdf: Monte Carlo noise alone"),
    "albedo": ("1", "directional-hemispherical reflectance"),
    "albedo_standard_error": ("1", "standard error of albedo: Monte Carlo and realisation noise"),
    "albedo_standard_error_mc": ("1", "standard error of albedo: Monte Carlo noise alone"),
    "count": ("1", "paths that arrived in the bin"),
    "projected_solid_angle": ("sr", "integral of cos(theta_o) over the bin"),
    "paths": ("1", "paths launched, all realisations"),
    "realisations": ("1", "specimens measured"),
    "replicates": ("1", "independent randomised replicates per realisation"),
    "degrees_of_freedom": ("1", "degrees of freedom of brdf_standard_error, for Student's t"),
    "degrees_of_freedom_mc": ("1", "degrees of freedom of brdf_standard_error_mc, for Student's t"),
    "order": ("1", "number of surface hits"),
    "theta_i": ("degree", "polar angle of the direction to the source"),
    "phi_i": ("degree", "azimuth of the direction to the source"),
    "theta_o": ("degree", "polar angle of the direction to the detector"),
    "phi_o": ("degree", "azimuth of the direction to the detector"),
    "dphi": ("degree", "phi_o - phi_i: 0 towards the source, 180 in the specular half plane"),
    "wavelength": ("nm", "wavelength in vacuum"),
    **{name: ("1", f"share of the launched energy that {verb}") for name, verb in _BUDGET_VERBS.items()},
}


def _bins(detector: Detector) -> tuple[dict[str, Any], dict[str, Any]]:
    """Coordinates of the bins, and their bounds."""
    if not isinstance(detector, HemisphereGrid):
        theta, phi = np.array(detector.directions).T
        return {"theta_o": ("detector", theta), "phi_o": ("detector", phi)}, {}
    edges = {"theta_o": detector.theta_edges, "dphi": detector.dphi_edges}
    bounds = {f"{d}_bounds": ((d, "bounds"), np.stack([e[:-1], e[1:]], axis=1)) for d, e in edges.items()}
    return {"theta_o": detector.theta, "dphi": detector.dphi}, bounds


def _described(dataset: xr.Dataset) -> xr.Dataset:
    """`dataset` with units and names, as the CF conventions want them."""
    for name, (unit, long_name) in _UNITS.items():
        if name in dataset.variables:
            dataset[name].attrs.update(units=unit, long_name=long_name)
        if f"{name}_bounds" in dataset:
            dataset[name].attrs["bounds"] = f"{name}_bounds"
    dataset["wavelength"].attrs["standard_name"] = "radiation_wavelength"
    ancillary = ("brdf_standard_error", "brdf_standard_error_mc", "count")
    dataset["brdf"].attrs["ancillary_variables"] = " ".join(name for name in ancillary if name in dataset)
    return dataset


def tabulated(
    brdf: ArrayLike,
    detector: HemisphereGrid,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    wavelengths: ArrayLike,
    standard_error: ArrayLike | None = None,
    attributes: Mapping[str, Any] | None = None,
) -> Measurement:
    """An external measurement: of a real instrument, another program, a model.

    `brdf` holds cos-weighted bin averages in 1/sr, (theta_i, phi_i, theta_o, dphi, W), NaN where nothing is known, and
    `brdf_standard_error` theirs if they are known; the bins are those of `detector`, angles are in degrees,
    `wavelengths` in nm. `attributes` may hold `title`, `origin`, `isotropic` and whatever else is known of it, as text
    or numbers.
    """
    import xarray as xr

    values = np.asarray(brdf, np.float64)
    errors = np.full(values.shape, np.nan) if standard_error is None else np.asarray(standard_error, np.float64)
    coords = {"order": ["all"], "theta_i": theta_i, "phi_i": phi_i, "wavelength": wavelengths}
    coords = {name: np.atleast_1d(nodes) for name, nodes in coords.items()}
    per_bin, total = ("order", "theta_i", "phi_i", "theta_o", "dphi", "wavelength"), ("order", "theta_i", "phi_i")
    area = detector.projected_solid_angles().reshape(detector.shape)
    # A hemisphere that is known in part only has the albedo of what is known.
    power = np.nansum(values * area[..., None], axis=(2, 3))
    albedo = np.where(np.isnan(values).all(axis=(2, 3)), np.nan, power)
    uncertain = np.sqrt(np.sum((np.where(np.isnan(values), 0.0, errors) * area[..., None]) ** 2, axis=(2, 3)))
    variables: dict[str, Any] = {}
    for suffix, binned, whole in (("", values, albedo), ("_standard_error", errors, uncertain)):
        variables[f"brdf{suffix}"] = (per_bin, binned[None])
        variables[f"albedo{suffix}"] = ((*total, "wavelength"), whole[None])
    variables["brdf_standard_error_mc"] = variables["brdf_standard_error"]
    variables["albedo_standard_error_mc"] = variables["albedo_standard_error"]
    variables["projected_solid_angle"] = (per_bin[3:5], area)
    where, bounds = _bins(detector)
    known = {"origin": "external", "isotropic": 0, "interrupted": 0, **(attributes or {})}
    known["detector"] = DETECTOR.dump_json(detector).decode()
    return Measurement(None, known, _described(xr.Dataset({**variables, **bounds}, {**coords, **where})))
