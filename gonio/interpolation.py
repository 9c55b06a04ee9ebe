"""A measured BRDF between its incidences and bins: lobes that move with the half vector and keep their energy.

At each neighbouring incidence the value is read where that incidence would mirror about the same half vector. What is
taken to be the same there is not the BRDF f itself but f (cosθ_i cosθ_o)^p: with p = 1 that is the numerator of a
microfacet model, with p = 0 a diffuser's f. The measurement tells which: p is chosen so that, half way between measured
incidences, the albedo is the mean of theirs. What is left of a difference is scaled away, so that the albedo of light
from anywhere is what lies between those that were measured, and beyond them that of the nearest.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gonio.detectors import HemisphereGrid
from gonio.sphere import angles, direction, half_vector, reflect
from microsurfaces.arrays import Floats, Indices, Vectors

Extrapolation = Literal["nearest"]
"""What stands for light from outside the measured incidences."""

GRAZING = 0.05
"""Added to cosines in f (cosθ_i cosθ_o)^p: at the horizon f stays finite."""

EXPONENTS = np.linspace(0.0, 1.2, 13)
"""The p to choose from."""

WITHOUT_NEIGHBOURS = 1.0
"""p where a single incidence cannot tell: facets are the rule."""

COARSE = HemisphereGrid(theta_step=5.0, phi_step=10.0)
"""Bins in which albedos of interpolated lobes are summed."""

SCALES = np.append(np.arange(0.0, 88.0, 4.0), 89.0)
"""Polar angles of the light at which energy is restored, degrees, besides those that were measured."""


@dataclass(frozen=True, eq=False)
class Interpolation:
    """The function between the values of a table over incidences and the bins of a grid."""

    table: Floats
    """(theta_i, phi_i, theta_o, dphi, W), 1/sr."""
    detector: HemisphereGrid
    theta_i: Floats
    phi_i: Floats
    """Incidences, degrees."""
    isotropic: bool
    """Whether only the relative azimuth matters."""

    def __call__(self, wi: Vectors, wo: Vectors, extrapolate: Extrapolation | None = None) -> Floats:
        """The BRDF (..., W) in 1/sr for light from `wi` (..., 3) seen from `wo` (..., 3).

        Raises ValueError outside the measured range of incidences, and for another azimuth of the light unless the data
        are isotropic; with `extrapolate="nearest"` the nearest measured incidence stands
        for those outside.
        """
        wi, wo = np.broadcast_arrays(np.asarray(wi, np.float64), np.asarray(wo, np.float64))
        value = self._moved(wi, wo, self.exponent, extrapolate) * self._scale(wi)
        return np.where((wo[..., 2] > 0)[..., None], value, 0.0)

    def _moved(self, wi: Vectors, wo: Vectors, exponent: float, extrapolate: Extrapolation | None) -> Floats:
        """Values of the neighbouring incidences, moved here and weighted."""
        theta, phi = angles(wi)
        wh = half_vector(wi, wo)
        here = _cosines(wi, wo)
        value = np.zeros((*theta.shape, self.table.shape[-1]))
        for row, column, share in self._neighbours(theta, phi, extrapolate):
            # The facets of an isotropic specimen are the same for all azimuths; those of others stay where they are.
            measured_wi = direction(self.theta_i[row], phi if self.isotropic else self.phi_i[column])
            moved = reflect(measured_wi, wh)
            moved = np.where((moved[..., 2] > 0)[..., None], moved, wo)
            weight = share * (_cosines(measured_wi, moved) / here) ** exponent
            value += weight[..., None] * self._read(row, column, measured_wi, moved)
        return value

    def _neighbours(
        self, theta: Floats, phi: Floats, extrapolate: Extrapolation | None
    ) -> Iterator[tuple[Indices, Indices, Floats]]:
        """Row, column and share of each measured incidence around (theta, phi)."""
        rows, share_t = bracket(self.theta_i, theta, "theta_i", extrapolate)
        columns, share_p = (np.zeros(theta.shape, np.intp),) * 2, np.zeros(theta.shape)
        if not self.isotropic:
            columns, share_p = bracket_around(self.phi_i, phi, extrapolate)
        for row, weight_t in zip(rows, (1 - share_t, share_t), strict=True):
            for column, weight_p in zip(columns, (1 - share_p, share_p), strict=True):
                yield row, column, weight_t * weight_p

    def _read(self, row: Indices, column: Indices, wi: Vectors, wo: Vectors) -> Floats:
        """The lobes of these incidences bilinearly at `wo`."""
        theta, phi = angles(wo)
        rings, sectors = self.detector.shape
        at = np.interp(theta, self.detector.theta, np.arange(rings))
        ring = np.minimum(at.astype(int), rings - 2)
        around = ((phi - angles(wi)[1]) % 360) / 360 * sectors
        sector = np.floor(around).astype(int)
        t, p = at - ring, around - sector
        value = np.zeros((*theta.shape, self.table.shape[-1]))
        for i, weight_t in ((ring, 1 - t), (ring + 1, t)):
            for j, weight_p in ((sector % sectors, 1 - p), ((sector + 1) % sectors, p)):
                value += (weight_t * weight_p)[..., None] * self.table[row, column, i, j]
        return value

    @functools.cached_property
    def exponent(self) -> float:
        """p: how f changes with the cosines where lobes move."""
        if len(self.theta_i) == 1:
            return WITHOUT_NEIGHBOURS
        middles = direction((self.theta_i[1:] + self.theta_i[:-1]) / 2, self.phi_i[0])
        wanted = np.stack([self._albedo_between(wi) for wi in middles])
        misses = [
            float(np.nansum((np.stack([self._albedo(wi, exponent) for wi in middles]) - wanted) ** 2))
            for exponent in EXPONENTS
        ]
        return float(EXPONENTS[int(np.argmin(misses))])

    @functools.cached_property
    def _scales(self) -> tuple[Floats, Floats, Floats]:
        """Polar angles (n,) and azimuths (m,) in degrees, and by how much to scale lobes there (n, m, W)."""
        theta = np.unique(np.concatenate([SCALES, self.theta_i]))
        phi = self.phi_i[:1] if self.isotropic else self.phi_i
        factors = np.ones((len(theta), len(phi), self.table.shape[-1]))
        for i, j in np.ndindex(len(theta), len(phi)):
            if not np.isin(theta[i], self.theta_i):
                wi = direction(theta[i], phi[j])
                found, wanted = self._albedo(wi, self.exponent), self._albedo_between(wi)
                factors[i, j] = np.divide(wanted, found, out=np.ones_like(found), where=found > 0)
        return theta, phi, factors

    def _scale(self, wi: Vectors) -> Floats:
        """By how much to scale the lobes of light from `wi` (..., 3), (..., W)."""
        nodes_t, nodes_p, factors = self._scales
        theta, phi = angles(wi)
        (low, high), share = bracket(nodes_t, theta, "theta_i", extrapolate="nearest")
        column = np.zeros(theta.shape, np.intp)
        if len(nodes_p) > 1:
            column = np.abs((phi[..., None] - nodes_p + 180) % 360 - 180).argmin(axis=-1)
        return np.asarray((1 - share)[..., None] * factors[low, column] + share[..., None] * factors[high, column])

    def _albedo(self, wi: Vectors, exponent: float) -> Floats:
        """Of the moved lobes for light from `wi` (3,), (W,); what is not known is dark."""
        wo, weights = COARSE.quadrature(wi, nodes=1)
        values = self._moved(np.broadcast_to(wi, wo.shape), wo, exponent, extrapolate="nearest")[:, 0]
        return np.asarray(COARSE.projected_solid_angles() @ np.nan_to_num(values) * weights[0, 0])

    def _albedo_between(self, wi: Vectors) -> Floats:
        """Between those of the measured incidences around `wi` (3,), (W,)."""
        theta, phi = angles(wi)
        return np.asarray(
            sum(share * self._albedos[row, column] for row, column, share in self._neighbours(theta, phi, "nearest"))
        )

    @functools.cached_property
    def _albedos(self) -> Floats:
        """Of the measured incidences, summed as those of moved lobes are, (theta_i, phi_i, W)."""
        shape = (len(self.theta_i), len(self.phi_i))
        albedos = np.empty((*shape, self.table.shape[-1]))
        for i, j in np.ndindex(*shape):
            albedos[i, j] = self._albedo(direction(self.theta_i[i], self.phi_i[j]), 0.0)
        return albedos


def _cosines(wi: Vectors, wo: Vectors) -> Floats:
    return np.asarray((wi[..., 2] + GRAZING) * (np.maximum(wo[..., 2], 0.0) + GRAZING))


def bracket(
    nodes: Floats, values: Floats, name: str, extrapolate: Extrapolation | None
) -> tuple[tuple[Indices, Indices], Floats]:
    """Indices of the nodes below and above `values`, and how far between them, 0 to 1."""
    slack = 1e-6
    outside = (values < nodes[0] - slack) | (values > nodes[-1] + slack)
    if outside.any() and extrapolate is None:
        raise ValueError(
            f"{name} = {values[outside].flat[0]:g} lies outside the measured range {nodes[0]:g} to {nodes[-1]:g} "
            f"degrees: measure it, or declare the data isotropic if only the azimuth differs"
        )
    lower = np.clip(np.searchsorted(nodes, values, side="right") - 1, 0, max(0, len(nodes) - 2))
    upper = np.minimum(lower + 1, len(nodes) - 1)
    width = np.where(upper > lower, nodes[upper] - nodes[lower], 1.0)
    return (lower, upper), np.clip((values - nodes[lower]) / width, 0.0, 1.0)


def bracket_around(
    nodes: Floats, values: Floats, extrapolate: Extrapolation | None
) -> tuple[tuple[Indices, Indices], Floats]:
    """As `bracket` for azimuths in degrees; nodes that go all around have no gap between the last and the first."""
    gaps = np.diff(nodes, append=nodes[0] + 360)
    if len(nodes) < 3 or gaps[-1] > 1.5 * gaps[:-1].max():
        # The azimuth that lies within or nearest to the known part.
        centre = (nodes[0] + nodes[-1]) / 2
        return bracket(nodes, (values - centre + 180) % 360 - 180 + centre, "phi_i", extrapolate)
    (lower, upper), share = bracket(
        np.append(nodes, nodes[0] + 360), (values - nodes[0]) % 360 + nodes[0], "phi_i", extrapolate
    )
    return (lower % len(nodes), upper % len(nodes)), share
