"""BRDF: a function of both directions, of whatever it comes from: a model, a measurement, a file, a Python function.

`eval(wi, wo)` are values in 1/sr, `average(wi, detector)` cos-weighted means over the bins of a detector, `albedo`
their sum over the hemisphere. The wavelengths belong to the function: it was made for them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from gonio.colour import PRIMARIES, rgb_weights, xyz_of_rgb, xyz_weights
from gonio.detectors import Detector, HemisphereGrid, Klems
from gonio.measurement import Measurement, tabulated
from gonio.models import Model
from gonio.models.averages import RandomWalk
from gonio.sphere import as_directions, direction, rotate_z
from microsurfaces.arrays import Floats, Vectors

Basis = Literal["spectrum", "RGB", "XYZ", "Y"]
"""What channels are: values at wavelengths, linear sRGB, CIE XYZ of the 1931 2° observer, or its Y; under D65."""

NOMINAL: Mapping[Basis, tuple[float, ...]] = {"RGB": PRIMARIES, "XYZ": (599.0, 555.0, 446.0), "Y": (555.0,)}
"""Wavelengths in nm that stand for the channels where one is asked for: where the eye's responses peak."""

WAVELENGTHS = (450.0, 550.0, 650.0)
"""Those of models and functions where no others are asked for, nm."""

ANISOTROPY = 0.1
"""Rms slopes along x and y that differ by more than this share are not those of an isotropic specimen."""

Function = Callable[[Vectors, Vectors], Any]
"""A user's own BRDF, `f(wi, wo)`: unit vectors (n, 3) away from the surface to values (n,) or (n, W) in 1/sr."""


@dataclass(frozen=True, eq=False, repr=False)
class BRDF:
    """A BRDF as a function of both directions, with what is known of where it comes from; made by `BRDF.of`."""

    evaluate: Callable[[Vectors, Vectors], Floats]
    """(n, 3) `wi` and `wo` to (n, channels): 1/sr, no cosine, for directions above the horizon. NaN where nothing is
    known; beyond the incidences that are known the nearest of them stands."""
    wavelengths: Floats
    """(channels,), nm; nominal ones if the channels are colours."""
    theta_i: Floats
    """Polar angles of the known incidences in degrees, ascending."""
    phi_i: Floats = field(default_factory=lambda: np.zeros(1))
    """Their azimuths in degrees, ascending; a single one if `isotropic`."""
    isotropic: bool = True
    """Whether only the relative azimuth matters."""
    basis: Basis = "spectrum"
    """What the channels are."""
    detector: HemisphereGrid = field(default_factory=HemisphereGrid)
    """Bins that resolve the lobes."""
    attributes: Mapping[str, Any] = field(default_factory=dict)
    """`title`, `origin` and more, as text or numbers."""
    averages: Callable[[Vectors, Detector], Floats] | None = None
    """Averages over bins (bins, channels) where something better is known than the mean of a few values."""
    order: str = "all"
    """The order of scattering that it speaks of: "all" light, or "1" for a model of light that was reflected once."""
    measurement: Measurement | None = None
    """The measurement behind the function, if it is one; its bins are the data, the function interpolates them."""

    def __repr__(self) -> str:
        """What it is, in a line."""
        return f"BRDF({self.title})"

    @classmethod
    def of(cls, source: BRDF | Measurement | Model | Function, wavelengths: ArrayLike | None = None) -> BRDF:
        """The BRDF of a measurement, a model or a Python function.

        A measurement brings its wavelengths; a model and a function are made for `wavelengths` in nm, 450, 550 and 650
        if left out. Incidences of a measurement that were not measured do not count. One that knows a single azimuth of
        the light counts as isotropic if its specimen's slopes are as steep along x as along y; of others the function
        raises ValueError. Klems's patches are a function in steps. Raises ValueError for apertures, if nothing was
        measured, and for wavelengths that a measurement does not have.

        >>> gonio.BRDF.of(gonio.CookTorrance(m=0.3, material=gonio.Conductor("Au")), [633.0])  # doctest: +SKIP
        >>> gonio.BRDF.of(lambda wi, wo: 0.18 / np.pi * np.ones(len(wi)))  # doctest: +SKIP
        """
        if isinstance(source, BRDF | Measurement):
            made = source if isinstance(source, BRDF) else _of_measurement(source)
            if wavelengths is not None and made.columns(wavelengths) != list(range(len(made.wavelengths))):
                raise ValueError(f"{made.title} has more wavelengths than these: take those columns of what it returns")
            return made
        nm = np.atleast_1d(np.asarray(WAVELENGTHS if wavelengths is None else wavelengths, np.float64))
        return _of_function(source, nm) if callable(source) else _of_model(source, nm)

    def columns(self, wavelengths: ArrayLike) -> list[int]:
        """Where these wavelengths in nm are among its own; ValueError for one that it does not have."""
        wanted = np.atleast_1d(np.asarray(wavelengths, np.float64))
        found = [np.flatnonzero(np.isclose(self.wavelengths, nm)) for nm in wanted]
        if not all(map(len, found)):
            known, asked = (", ".join(f"{nm:g}" for nm in values) for values in (self.wavelengths, wanted))
            raise ValueError(f"{self.title} is known at {known} nm and not at {asked} nm: ask for what it has")
        return [int(places[0]) for places in found]

    def eval(self, wi: ArrayLike, wo: ArrayLike) -> Floats:
        """Values in 1/sr, no cosine, for light from `wi` (..., 3) seen from `wo` (..., 3), shape (..., W).

        0 where a direction is not above the horizon, NaN where nothing is known. Raises ValueError for directions whose
        last axis is not 3, and for a singular model, which has averages over bins only.
        """
        wi, wo = np.broadcast_arrays(as_directions(wi, "wi"), as_directions(wo, "wo"))
        above = (wi[..., 2] > 0) & (wo[..., 2] > 0)
        values = np.zeros((*above.shape, len(self.wavelengths)))
        if above.any():
            values[above] = self.evaluate(wi[above], wo[above])
        return values

    def albedo(self, theta_i: float, phi_i: float = 0.0) -> Floats:
        """Directional-hemispherical reflectance (W,) for light from these angles, degrees; what is unknown is dark."""
        means = self.average(direction(theta_i, phi_i), self.detector)
        return np.asarray(self.detector.projected_solid_angles() @ np.nan_to_num(means))

    @property
    def title(self) -> str:
        """One line about what this is."""
        return str(self.attributes.get("title") or "a measurement by gonio")

    @property
    def channels(self) -> tuple[str, ...]:
        """A name for each channel: "R", "G", "B", or "632.8nm"."""
        if self.basis == "spectrum":
            return tuple(f"{np.format_float_positional(nm, trim='-')}nm" for nm in self.wavelengths)
        return tuple(self.basis)

    def in_basis(self, basis: Basis) -> Self:
        """The same with other channels. Raises ValueError where colours should become a spectrum."""
        if basis == self.basis:
            return self
        weights, nominal = self._weights(basis), np.array(NOMINAL[basis])
        attributes = {**self.attributes, "basis": basis}
        return replace(
            self,
            evaluate=lambda wi, wo: self.evaluate(wi, wo) @ weights.T,
            wavelengths=nominal,
            basis=basis,
            attributes=attributes,
            averages=self.averages and (lambda wi, detector: self._averaged(wi, detector) @ weights.T),
            measurement=self.measurement and _mixed(self.measurement, weights, nominal, attributes),
        )

    def _weights(self, basis: Basis) -> Floats:
        """The matrix from our channels to those of `basis`, (theirs, ours)."""
        match self.basis, basis:
            case "spectrum", "RGB":
                return rgb_weights(self.wavelengths)
            case "spectrum", "XYZ":
                return xyz_weights(self.wavelengths)
            case "spectrum", "Y":
                return xyz_weights(self.wavelengths)[1:2]
            case "RGB", "XYZ":
                return xyz_of_rgb()
            case "RGB", "Y":
                return xyz_of_rgb()[1:2]
            case "XYZ", "RGB":
                return np.asarray(np.linalg.inv(xyz_of_rgb()))
            case "XYZ", "Y":
                return np.eye(3)[1:2]
            case "Y", "RGB" | "XYZ":
                grey = np.ones(3) if basis == "RGB" else xyz_of_rgb().sum(axis=1)
                return grey[:, None]
        raise ValueError(f"channels {self.basis} cannot be turned into {basis}: a colour is no spectrum")

    def sampled(self, theta_i: ArrayLike, phi_i: ArrayLike, detector: HemisphereGrid, nodes: int = 2) -> Measurement:
        """Averages over the bins of `detector` for light from these angles in degrees, `nodes`² values a bin."""
        theta_i, phi_i = np.atleast_1d(theta_i).astype(float), np.atleast_1d(phi_i).astype(float)
        brdf = np.empty((len(theta_i), len(phi_i), *detector.shape, len(self.wavelengths)))
        for i, theta in enumerate(theta_i):
            for j, phi in enumerate(phi_i):
                brdf[i, j] = self.average(direction(theta, phi), detector, nodes).reshape(*detector.shape, -1)
        flags = {"isotropic": int(self.isotropic), "basis": self.basis}
        return tabulated(brdf, detector, theta_i, phi_i, self.wavelengths, attributes={**self.attributes, **flags})

    def average(self, wi: ArrayLike, detector: Detector, nodes: int = 2) -> Floats:
        """Cos-weighted averages over the bins of `detector` for light from `wi` (3,), (bins, W) in 1/sr.

        Those of a model are exact to 1e-5, those of a measurement at its own incidences and bins are its values; of
        others `nodes`² values a bin are averaged. Directions of which nothing is known do not count; a bin of nothing
        but such is NaN. Raises ValueError for a direction whose last axis is not 3.
        """
        wi = as_directions(wi, "wi")
        if self.measurement is not None:
            return self.measurement.average(wi, detector, extrapolate="nearest")
        if self.averages is not None:
            return self._averaged(wi, detector)
        wo, weights = detector.quadrature(wi, nodes)
        values = self.evaluate(np.broadcast_to(wi, wo.shape).reshape(-1, 3), wo.reshape(-1, 3))
        values = values.reshape(*weights.shape, -1)
        known = np.isfinite(values)
        share = np.where(known, weights[..., None], 0.0)
        with np.errstate(invalid="ignore"):
            return np.asarray((share * np.where(known, values, 0.0)).sum(axis=1) / share.sum(axis=1))

    def standard_error(self, wi: ArrayLike, detector: Detector) -> Floats:
        """That of `average`, (bins, W) in 1/sr: of a measurement at its own incidences and bins, where it is known.

        Elsewhere 0: what lies between incidences is as sure as its neighbours, and not noisier than they are.
        """
        if self.measurement is not None and detector == self.detector:
            errors = self.measurement.standard_error(as_directions(wi, "wi"))
            if errors is not None:
                return np.nan_to_num(errors)
        return np.zeros((detector.bins, len(self.wavelengths)))

    def _averaged(self, wi: Vectors, detector: Detector) -> Floats:
        assert self.averages is not None
        return self.averages(wi, detector)

    def measured(self) -> Measurement:
        """The measurement behind this, or one sampled at the incidences and bins that suit it."""
        return self.measurement or self._sample

    @cached_property
    def _sample(self) -> Measurement:
        return self.sampled(self.theta_i, self.phi_i, self.detector)


def _of_measurement(measurement: Measurement) -> BRDF:
    if isinstance(measurement.detector, Klems):
        return BRDF(
            evaluate=_in_patches(measurement, measurement.detector),
            wavelengths=measurement.wavelengths,
            theta_i=measurement.dataset["theta_i"].values,
            isotropic=False,
            detector=HemisphereGrid(theta_step=2.5, phi_step=7.5),
            attributes=measurement.attributes,
        )
    if not isinstance(measurement.detector, HemisphereGrid):
        raise ValueError(
            "this measurement was made with Apertures, between which nothing is known; measure with detector = "
            "HemisphereGrid to export it"
        )
    rows = np.flatnonzero(measurement.measured.all(axis=1))
    if not rows.size:
        raise ValueError("no incidence of this measurement was measured: nothing to export")
    data = measurement.dataset.isel(theta_i=rows)
    known = Measurement(None, measurement.attributes, data)
    if not known.isotropic and data.sizes["phi_i"] == 1 and _has_isotropic_slopes(measurement):
        known = known.as_isotropic()
    one_sided = not known.isotropic and data.sizes["phi_i"] == 1
    return BRDF(
        evaluate=_refused if one_sided else lambda wi, wo: known.eval(wi, wo, extrapolate="nearest"),
        wavelengths=known.wavelengths,
        theta_i=data["theta_i"].values,
        phi_i=data["phi_i"].values,
        isotropic=known.isotropic,
        basis=known.attributes.get("basis", "spectrum"),
        detector=measurement.detector,
        attributes=known.attributes,
        measurement=known,
    )


def _of_model(model: Model, wavelengths: Floats) -> BRDF:
    """A model at `wavelengths`; one that takes random walks is isotropic within their noise."""

    def evaluate(wi: Vectors, wo: Vectors) -> Floats:
        return model.eval(wi, wo, wavelengths)

    try:
        isotropic = _is_isotropic(evaluate, 0.05 if isinstance(model, RandomWalk) else 1e-6)
    except ValueError:  # a singular model has no values to tell
        isotropic = False
    about = {"title": repr(model), "origin": "a model"}
    averages = partial(model.average, wavelengths=wavelengths)
    return replace(_everywhere(evaluate, wavelengths, isotropic, about, averages), order=model.order)


def _of_function(function: Function, wavelengths: Floats) -> BRDF:
    """A Python function at `wavelengths`; one that knows no wavelengths is the same at all of them."""
    name = getattr(function, "__name__", type(function).__name__)

    def evaluate(wi: Vectors, wo: Vectors) -> Floats:
        values = np.asarray(function(wi, wo), np.float64)
        if values.shape not in ((len(wi),), (len(wi), 1), (len(wi), len(wavelengths))):
            raise ValueError(
                f"the function {name} returned an array of shape {values.shape} for {len(wi)} pairs of directions: "
                f"({len(wi)},) or ({len(wi)}, {len(wavelengths)}) is expected, a value for each wavelength"
            )
        return np.broadcast_to(values.reshape(len(wi), -1), (len(wi), len(wavelengths)))

    isotropic = _is_isotropic(evaluate, 1e-6)
    return _everywhere(evaluate, wavelengths, isotropic, {"title": name, "origin": "a Python function"})


def _everywhere(
    evaluate: Callable[[Vectors, Vectors], Floats],
    wavelengths: Floats,
    isotropic: bool,
    attributes: Mapping[str, Any],
    averages: Callable[[Vectors, Detector], Floats] | None = None,
) -> BRDF:
    """A function that is known for all directions."""
    phi_i = np.zeros(1) if isotropic else np.arange(0.0, 360.0, 15.0)
    about = {**attributes, "isotropic": int(isotropic)}
    theta_i = np.append(np.arange(0.0, 90.0, 5.0), 89.0)
    return BRDF(evaluate, wavelengths, theta_i, phi_i, isotropic, attributes=about, averages=averages)


def _is_isotropic(evaluate: Callable[[Vectors, Vectors], Floats], tolerance: float) -> bool:
    """Whether turning the surface changes nothing, at a few angles."""
    turned = [
        np.stack([rotate_z(w, phi) for phi in (0.0, 30.0, 75.0, 90.0)])
        for w in (direction(30.0, 0.0), direction(40.0, 165.0))
    ]
    values = evaluate(*turned)
    return bool(np.allclose(values, values[0], rtol=tolerance))


def _in_patches(measurement: Measurement, detector: Klems) -> Callable[[Vectors, Vectors], Floats]:
    """The entry of the patches in which both directions lie."""
    data = measurement.dataset["brdf"].sel(order="all")
    matrix = np.stack([data.sel(theta_i=theta, phi_i=phi).values for theta, phi in detector.directions])
    return lambda wi, wo: matrix[detector.owner(wi), detector.owner(wo)]


def _mixed(measurement: Measurement, weights: Floats, nominal: Floats, attributes: Mapping[str, Any]) -> Measurement:
    """`measurement` with other channels; errors as if the old ones erred together, as paths with all of them do."""
    data = measurement.dataset.sel(order="all")
    return tabulated(
        data["brdf"].values @ weights.T,
        measurement.detector,  # type: ignore[arg-type]
        data["theta_i"].values,
        data["phi_i"].values,
        nominal,
        standard_error=data["brdf_standard_error"].values @ np.abs(weights).T,
        attributes=attributes,
    )


def _has_isotropic_slopes(measurement: Measurement) -> bool:
    """Whether the specimen is known to have the same rms slope along x and y."""
    try:
        statistics = measurement.surface_statistics
    except KeyError:
        return False
    along_x, along_y = statistics.get("rms_slope_x"), statistics.get("rms_slope_y")
    if along_x is None or along_y is None:
        return False
    return abs(along_x - along_y) <= ANISOTROPY * max(along_x, along_y)


def _refused(wi: Vectors, wo: Vectors) -> Floats:
    """In place of a function of the azimuth that is not known."""
    raise ValueError(
        "this measurement knows one azimuth of the light (phi_i), and its specimen is not known to look the same from "
        'others: measure with azimuth = "average" or with phi_i all around, or export it with --isotropic '
        "(Measurement.as_isotropic) if it does"
    )
