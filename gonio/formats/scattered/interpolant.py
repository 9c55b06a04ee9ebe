"""A BRDF between the incidences of a list: lobes move with the half vector."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from gonio.detectors import HemisphereGrid
from gonio.formats.scattered.bins import grid_of_steps
from gonio.formats.scattered.hemispheres import Cloud, Hemisphere, accumulate, hemisphere_of, weighted_mean
from gonio.formats.scattered.rows import Index, nodes_of
from gonio.interpolation import bracket, bracket_around
from gonio.sphere import angles, direction, half_vector, reflect, rotate_z
from microsurfaces.arrays import Floats, Vectors

MOST_SCATTERED = 500_000
"""Directions that are triangulated at most, all incidences together."""

MOST_INCIDENCES = 10_000
"""Of a table that is interpolated."""


@dataclass(frozen=True)
class Interpolant:
    """`BRDF.evaluate` between the incidences of a table."""

    theta_i: Floats
    phi_i: Sequence[Floats]
    """Azimuths of each polar angle; one, 0, if the table is isotropic."""
    hemispheres: Sequence[Sequence[Hemisphere]]
    isotropic: bool
    channels: int

    @classmethod
    def over(cls, directions: tuple[Floats, Floats, Floats, Floats], values: Floats, isotropic: bool) -> Self:
        """Of `values` (n, channels) at theta_i, phi_i, theta_o and dphi, (n,) each, degrees.

        Raises ValueError if there are too many incidences, or too many scattered directions.
        """
        at_theta_i, at_phi_i, theta_o, dphi = directions
        theta_i, row = nodes_of(at_theta_i)
        phi_i, column = nodes_of(np.zeros(len(row)) if isotropic else at_phi_i)
        key = row * len(phi_i) + column
        order = np.argsort(key, kind="stable")
        starts = np.flatnonzero(np.diff(key[order], prepend=-1))
        if len(starts) > MOST_INCIDENCES:
            raise ValueError(f"its light comes from {len(starts)} directions, more than {MOST_INCIDENCES}")
        azimuths: list[list[float]] = [[] for _ in theta_i]
        hemispheres: list[list[Hemisphere]] = [[] for _ in theta_i]
        scattered = 0
        for chosen in np.split(order, starts[1:]):
            i, j = divmod(int(key[chosen[0]]), len(phi_i))
            known = hemisphere_of(theta_o[chosen], dphi[chosen], values[chosen], mirrored=isotropic)
            scattered += len(chosen) if isinstance(known, Cloud) else 0
            if scattered > MOST_SCATTERED:
                raise ValueError(f"more than {MOST_SCATTERED} scattered directions are not supported; use a grid")
            azimuths[i].append(float(phi_i[j]))
            hemispheres[i].append(known)
        return cls(theta_i, [np.array(a) for a in azimuths], hemispheres, isotropic, values.shape[1])

    def detector(self) -> HemisphereGrid:
        """Bins that resolve the samples."""
        steps = np.array([known.steps for row in self.hemispheres for known in row])
        return grid_of_steps(*np.median(steps, axis=0).tolist())

    def __call__(self, wi: Vectors, wo: Vectors) -> Floats:
        """Values (n, channels) for `wi` and `wo` (n, 3); NaN where nothing is known, 0 below the horizon."""
        theta, phi = angles(wi)
        wh = half_vector(wi, wo)
        total = np.zeros((2, len(theta), self.channels))
        for row, at, weight in _sides(*bracket(self.theta_i, theta, "theta_i", "nearest")):
            for column, within, share in _sides(*self._columns(row, phi[at])):
                here = at[within]
                values = self._read(row, column, phi[here], wh[here], wo[here])
                accumulate(total, here, weight[within] * share, values)
        return np.where(wo[:, 2:] > 0, weighted_mean(total), 0.0)

    def _columns(self, row: int, phi: Floats) -> tuple[tuple[Index, Index], Floats]:
        return bracket_around(self.phi_i[row], phi, "nearest")

    def _read(self, row: int, column: int, phi: Floats, wh: Vectors, wo: Vectors) -> Floats:
        """What this incidence says of light from `phi`, where it would mirror about the same half vectors."""
        theta = self.theta_i[row]
        azimuth = phi if self.isotropic else np.full_like(phi, self.phi_i[row][column])
        # The light's own change of azimuth turns the half vector with it; light from the normal has no azimuth.
        turn = np.zeros_like(phi) if theta == 0 else azimuth - phi
        moved = reflect(direction(theta, azimuth), rotate_z(wh, turn))
        moved = np.where(moved[:, 2:] > 0, moved, rotate_z(wo, turn))
        theta_o, phi_o = angles(moved)
        return self.hemispheres[row][column].at(theta_o, (phi_o - azimuth) % 360)


def _sides(nodes: tuple[Index, Index], share: Floats) -> Iterator[tuple[int, Index, Floats]]:
    """Every node that counts, for which values it does, and with what weight."""
    for side, weights in zip(nodes, (1 - share, share), strict=True):
        for node in np.unique(side[weights > 0]):
            at = np.flatnonzero((side == node) & (weights > 0))
            yield int(node), at, weights[at]
