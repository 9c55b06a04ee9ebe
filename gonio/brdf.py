"""A BRDF as a function of both directions: what foreign files are filled from, and what they are read into."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from gonio.colour import PRIMARIES, rgb_weights, xyz_of_rgb, xyz_weights
from gonio.detectors import HemisphereGrid, Klems
from gonio.measurement import Measurement, tabulated
from gonio.sphere import direction
from microsurfaces.arrays import Floats, Vectors

Basis = Literal["spectrum", "RGB", "XYZ", "Y"]
"""What channels are: values at wavelengths, linear sRGB, CIE XYZ of the 1931 2° observer, or its Y; under D65."""

NOMINAL: Mapping[Basis, tuple[float, ...]] = {"RGB": PRIMARIES, "XYZ": (599.0, 555.0, 446.0), "Y": (555.0,)}
"""Wavelengths in nm that stand for the channels where one is asked for: where the eye's responses peak."""

ANISOTROPY = 0.1
"""Rms slopes along x and y that differ by more than this share are not those of an isotropic specimen."""


@dataclass(frozen=True, eq=False)
class BRDF:
    """A BRDF as a function of both directions, with what is known of where it comes from."""

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
    measurement: Measurement | None = None
    """The measurement behind the function, if it is one; its bins are the data, the function interpolates them."""

    @classmethod
    def of(cls, measurement: Measurement) -> Self:
        """A measurement as a function; incidences that were not measured do not count.

        One that knows a single azimuth of the light counts as isotropic if its specimen's slopes are as steep along x
        as along y; of others the function raises ValueError. Klems's patches are a function in steps. Raises ValueError
        for apertures, and if nothing was measured.
        """
        if isinstance(measurement.detector, Klems):
            return cls(
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
        if not known.isotropic and data.sizes["phi_i"] == 1 and _looks_isotropic(measurement):
            known = known.as_isotropic()
        one_sided = not known.isotropic and data.sizes["phi_i"] == 1
        return cls(
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

    def average(self, wi: Vectors, detector: HemisphereGrid, nodes: int = 2) -> Floats:
        """Cos-weighted averages over the bins of `detector` for light from `wi` (3,), (bins, channels).

        Directions of which nothing is known do not count; a bin of nothing but such is NaN. At the incidences and bins
        of the measurement behind this they are its values.
        """
        if self.measurement is not None:
            return self.measurement.average(wi, detector, extrapolate="nearest")
        wo, weights = detector.quadrature(wi, nodes)
        values = self.evaluate(np.broadcast_to(wi, wo.shape).reshape(-1, 3), wo.reshape(-1, 3))
        values = values.reshape(*weights.shape, -1)
        known = np.isfinite(values)
        share = np.where(known, weights[..., None], 0.0)
        with np.errstate(invalid="ignore"):
            return np.asarray((share * np.where(known, values, 0.0)).sum(axis=1) / share.sum(axis=1))

    def measured(self) -> Measurement:
        """The measurement behind this, or one sampled at the incidences and bins that suit it."""
        return self.measurement or self.sampled(self.theta_i, self.phi_i, self.detector)


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


def _looks_isotropic(measurement: Measurement) -> bool:
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
