"""A list of directions and values: a measurement if they are the bins of one, otherwise a function between them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from gonio.brdf import BRDF, NOMINAL, Basis
from gonio.detectors import HemisphereGrid
from gonio.formats.scattered.bins import MOST_VALUES, grid_of
from gonio.formats.scattered.interpolant import Interpolant
from gonio.formats.scattered.rows import first_seen, insist_on_rows, joined, nodes_of, places_of, spread, upright
from gonio.measurement import Measurement, tabulated
from microsurfaces.arrays import Floats

LARGEST_BRDF = 1e15
"""In 1/sr; more is a damaged number, and its sums overflow."""


@dataclass(frozen=True, eq=False)
class Table:
    """A BRDF as a list of directions, and what is known about it."""

    theta_i: Floats
    """(n,), degrees; a negative polar angle stands for the opposite azimuth."""
    phi_i: Floats
    theta_o: Floats
    dphi: Floats
    """(n,), degrees: phi_o - phi_i."""
    values: Floats
    """(n, channels), 1/sr, NaN where unknown."""
    wavelengths: Floats
    """(channels,), nm; nominal ones if the channels are colours."""
    standard_error: Floats | None = None
    """(n, channels), 1/sr."""
    basis: Basis = "spectrum"
    isotropic: bool | None = None
    """Whether only the relative azimuth matters; None if the file does not tell: then it does if there is but one."""
    detector: HemisphereGrid | None = None
    """The bins whose averages these are; None if the file does not tell."""
    attributes: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of_rows(
        cls,
        theta_i: Floats,
        phi_i: Floats,
        theta_o: Floats,
        dphi: Floats,
        wavelength: Floats,
        values: Floats,
        standard_error: Floats | None = None,
        **about: Any,
    ) -> Self:
        """From a list in which every wavelength has a row of its own, in any order; rows that repeat are averaged.

        Wavelengths come in the order in which the list has them first. Raises ValueError if it is no table.
        """
        insist_on_rows(theta_i, phi_i, theta_o, dphi, wavelength)
        if wavelength.min() <= 0:
            raise ValueError(f"wavelength = {wavelength.min():g} must be positive")
        columns = upright(theta_i, phi_i, theta_o, dphi)
        wavelengths, channel = first_seen(wavelength)
        key = joined([nodes_of(column)[1] for column in columns])
        _, first, place = np.unique(key, return_index=True, return_inverse=True)
        shape = (len(first), len(wavelengths))
        if math.prod(shape) > 16 * len(key):
            raise ValueError(f"its {shape[0]} directions and {shape[1]} wavelengths do not form a table")
        cell = place * shape[1] + channel
        count = np.bincount(cell, minlength=math.prod(shape))

        def mean(column: Floats) -> Floats:
            with np.errstate(invalid="ignore"):
                return np.asarray(np.bincount(cell, column, minlength=len(count)) / count).reshape(shape)

        errors = None if standard_error is None else mean(standard_error)
        one, two, three, four = (column[first] for column in columns)
        return cls(one, two, three, four, mean(values), wavelengths, errors, **about)

    @property
    def directions(self) -> tuple[Floats, Floats, Floats, Floats]:
        """theta_i, phi_i, theta_o and dphi, (n,) each, degrees."""
        return self.theta_i, self.phi_i, self.theta_o, self.dphi

    def in_colours(self, name: object) -> Self:
        """The same with the colours that a file says its channels are; a spectrum if it says nothing that fits."""
        for basis in NOMINAL:
            if name == basis and len(basis) == len(self.wavelengths):
                # Nominal wavelengths descend, in the order of the channels.
                order = np.argsort(-self.wavelengths)
                errors = None if self.standard_error is None else self.standard_error[:, order]
                return replace(
                    self,
                    values=self.values[:, order],
                    wavelengths=self.wavelengths[order],
                    standard_error=errors,
                    basis=basis,
                )
        return self

    def to_brdf(self) -> BRDF:
        """The BRDF that the list stands for. Raises ValueError if the list is none, empty, or too long."""
        insist_on_rows(*self.directions)
        theta_i, phi_i, theta_o, dphi = upright(*self.directions)
        isotropic = len(nodes_of(phi_i[theta_i > 0])[0]) < 2 if self.isotropic is None else self.isotropic
        attributes = {**self.attributes, "isotropic": int(isotropic), "basis": self.basis}
        errors = None if self.standard_error is None else _known_values(self.standard_error)
        table = replace(
            self,
            theta_i=theta_i,
            phi_i=phi_i,
            theta_o=theta_o,
            dphi=dphi,
            values=_known_values(self.values),
            standard_error=errors,
            isotropic=isotropic,
            attributes=attributes,
        )
        measurement = table._measurement()
        return BRDF.of(measurement) if measurement is not None else table._interpolated()

    def _measurement(self) -> Measurement | None:
        """The measurement whose bins these are, if they are the bins of one."""
        grid = self.detector or grid_of(nodes_of(self.theta_o)[0], nodes_of(self.dphi)[0])
        if grid is None:
            return None
        ring, sector = places_of(grid.theta, self.theta_o), places_of(np.append(grid.dphi, 360.0), self.dphi)
        (theta_i, row), (phi_i, column) = nodes_of(self.theta_i), nodes_of(self.phi_i)
        shape = (len(theta_i), len(phi_i), *grid.shape)
        # A short file that names narrow bins shall not become a large table.
        most = min(MOST_VALUES // len(self.wavelengths), 1000 * len(row))
        if ring is None or sector is None or math.prod(shape) > most:
            return None
        cell = np.ravel_multi_index((row, column, ring, sector % shape[3]), shape)
        once = np.bincount(cell, minlength=math.prod(shape)).reshape(*shape[:2], -1)
        if once.max() > 1 or not once.any(axis=2).all():
            return None
        values = spread(self.values, cell, shape)
        errors = None if self.standard_error is None else spread(self.standard_error, cell, shape)
        if not np.isfinite(values).any(axis=(2, 3, 4)).all():
            return None
        return tabulated(values, grid, theta_i, phi_i, self.wavelengths, errors, self.attributes)

    def _interpolated(self) -> BRDF:
        """Everything else: a function between the samples, and its averages with errors if those are known."""
        function = Interpolant.over(self.directions, self.values, bool(self.isotropic))
        phi_i = np.zeros(1) if self.isotropic else nodes_of(self.phi_i)[0]
        detector = function.detector()
        if len(function.theta_i) * len(phi_i) * detector.bins * len(self.wavelengths) > MOST_VALUES:
            raise ValueError(
                f"its {len(function.theta_i)} polar angles and {len(phi_i)} azimuths of the light, seen in bins of "
                f"{detector.theta_step:g} x {detector.phi_step:g} degrees, are too many; split the file"
            )
        brdf = BRDF(
            evaluate=function,
            wavelengths=self.wavelengths,
            theta_i=function.theta_i,
            phi_i=phi_i,
            isotropic=bool(self.isotropic),
            basis=self.basis,
            detector=detector,
            attributes=self.attributes,
        )
        if self.standard_error is None or not np.isfinite(self.standard_error).any():
            return brdf
        # The error of an average of interpolated values is taken to be that of the values: they err together.
        deviating = Interpolant.over(self.directions, self.standard_error, bool(self.isotropic))
        errors = replace(brdf, evaluate=deviating).measured().dataset["brdf"].values[0]
        known = brdf.measured().dataset
        values, attributes = known["brdf"].values[0], known.attrs
        measurement = tabulated(values, detector, brdf.theta_i, phi_i, self.wavelengths, errors, attributes)
        return replace(brdf, measurement=measurement)


def _known_values(values: Floats) -> Floats:
    """`values` in 1/sr with NaN for those that are not finite. Raises ValueError if they are absurdly large."""
    known = np.where(np.isfinite(values), values, np.nan)
    most = np.abs(known).max(initial=0.0, where=~np.isnan(known))
    if most > LARGEST_BRDF:
        raise ValueError(f"a value of {most:g} 1/sr is no BRDF")
    return known
