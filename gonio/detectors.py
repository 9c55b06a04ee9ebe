"""Detectors: what a bin of the instrument sees, and how large it is in projected solid angle.

A bin averages the BRDF with the weight cosθ dω. No bin edge lies on the plane of incidence: azimuth bins are centred on
multiples of their step, polar bins are a cap of half a step around the pole, then centred on multiples of their step,
then half a bin at the horizon.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, TypeAdapter, model_validator

from gonio.sphere import angles, direction
from microsurfaces.arrays import Floats, Vectors
from microsurfaces.recipe import Positive, recipe

DEFAULT_NODES = 8


@recipe
class HemisphereGrid:
    """Bins over the whole hemisphere, rings in theta_o times sectors in dphi = phi_o - phi_i.

    The grid turns with the source: dphi = 0 is the source's side, 180 the specular one, for every incidence. Equal
    steps in angle suit plots and tables; rings of equal projected solid angle give every bin the same share of a
    Lambertian surface's light, and therefore even noise.
    """

    theta_step: Positive = 1.0
    """Polar width of a bin in degrees, a whole fraction of 90; with equal projected areas, 90 / number of rings."""
    phi_step: Positive = 1.0
    """Azimuthal width of a bin in degrees, a whole fraction of 180."""
    spacing: Literal["angle", "projected_area"] = "angle"
    """Rings of equal steps in theta ("angle") or of equal projected solid angle ("projected_area")."""

    @model_validator(mode="after")
    def _steps_divide_the_circle(self) -> HemisphereGrid:
        for name, step, whole in (("theta_step", self.theta_step, 90), ("phi_step", self.phi_step, 180)):
            count = whole / step
            if count < 1 or abs(count - round(count)) > 1e-9 * count:
                raise ValueError(
                    f"{name} = {step:g} must divide {whole} degrees into whole bins; "
                    f"{whole / max(1, round(count)):g} would"
                )
        return self

    @property
    def theta_edges(self) -> Floats:
        """Ring edges in degrees, from 0 to 90, shape (rings + 1,)."""
        count = round(90 / self.theta_step)
        if self.spacing == "projected_area":
            return np.degrees(np.arcsin(np.sqrt(np.arange(count + 1) / count)))
        inner = (np.arange(count) + 0.5) * (90 / count)
        return np.concatenate([[0.0], inner, [90.0]])

    @property
    def theta(self) -> Floats:
        """Ring centres in degrees: half the projected area on either side, or the middle; 0 for the polar cap."""
        edges = self.theta_edges
        if self.spacing == "projected_area":
            sin2 = np.sin(np.radians(edges)) ** 2
            return np.asarray(np.degrees(np.arcsin(np.sqrt((sin2[1:] + sin2[:-1]) / 2))))
        centres = np.asarray((edges[1:] + edges[:-1]) / 2)
        centres[0] = 0.0
        return centres

    @property
    def dphi(self) -> Floats:
        """Sector centres in degrees, 0 <= dphi < 360."""
        count = round(360 / self.phi_step)
        return np.arange(count, dtype=np.float64) * (360 / count)

    @property
    def dphi_edges(self) -> Floats:
        """Sector edges in degrees, from minus half a step to 360 minus half a step, shape (sectors + 1,)."""
        count = round(360 / self.phi_step)
        return (np.arange(count + 1, dtype=np.float64) - 0.5) * (360 / count)

    @property
    def shape(self) -> tuple[int, int]:
        """(rings, sectors)."""
        return len(self.theta_edges) - 1, round(360 / self.phi_step)

    @property
    def bins(self) -> int:
        """How many bins there are."""
        rings, sectors = self.shape
        return rings * sectors

    def projected_solid_angles(self) -> Floats:
        """Exact ∫ cosθ dω of every bin in sr, ring after ring, shape (bins,); they sum to π."""
        sectors = self.shape[1]
        sin2 = np.sin(np.radians(self.theta_edges)) ** 2
        return np.repeat(np.diff(sin2) / 2 * (2 * math.pi / sectors), sectors)

    def quadrature(
        self, wi: ArrayLike, nodes: int = DEFAULT_NODES, bins: NDArray[np.intp] | None = None
    ) -> tuple[Vectors, Floats]:
        """Gauss-Legendre nodes of every bin for light from `wi` (3,), `nodes` an axis.

        Returns directions (bins, nodes², 3) and weights (bins, nodes²) that carry cosθ dω and sum to 1 in each bin.
        `bins` restricts it to those bins.
        """
        rings, sectors = self.shape
        ring, sector = np.divmod(np.arange(rings * sectors) if bins is None else np.asarray(bins), sectors)
        polar = np.stack([self.theta_edges[ring], self.theta_edges[ring + 1]], axis=-1)
        return patch_quadrature(polar, self.dphi[sector] + angles(wi)[1], np.full(len(ring), 180 / sectors), nodes)

    def owner(self, w: ArrayLike, wi: ArrayLike) -> NDArray[np.intp]:
        """The bin that each direction `w` (..., 3) above the horizon lies in for light from `wi` (3,), (...)."""
        rings, sectors = self.shape
        return ringed(self.theta_edges, np.full(rings, sectors), w, float(angles(wi)[1]))

    def owners(self, wider: HemisphereGrid) -> NDArray[np.intp]:
        """The bin of `wider` that each of our bins lies in, (bins,); a ValueError if one lies in several."""
        if not all(
            np.abs(np.subtract.outer(theirs, ours)).min(axis=1).max() < 1e-9
            for theirs, ours in ((wider.theta_edges, self.theta_edges), (wider.dphi_edges[1:], self.dphi_edges))
        ):
            raise ValueError(f"{wider!r} does not consist of whole bins of {self!r}.")
        ring = np.searchsorted(wider.theta_edges, self.theta, side="right") - 1
        sector = np.floor(self.dphi / wider.phi_step + 0.5).astype(np.intp) % wider.shape[1]
        return np.asarray(ring[:, None] * wider.shape[1] + sector).ravel()

    def edge_at(self, theta: float) -> bool:
        """Whether a ring edge lies on `theta` degrees, where rounding would split a specular lobe."""
        edges = self.theta_edges[1:-1]
        return bool(edges.size and np.abs(edges - theta).min() < 1e-4)


@recipe
class Apertures:
    """Round detector apertures at given directions, as a real instrument has.

    Directions are absolute: they do not turn with the source. Apertures may overlap and need not cover the hemisphere;
    a hemispherical total is kept beside them.
    """

    directions: Annotated[tuple[tuple[float, float], ...], Field(min_length=1)]
    """(theta_o, phi_o) of each aperture's axis, degrees."""
    half_angle: Positive = 1.0
    """Half the angle that the aperture subtends at the sample, degrees."""

    @model_validator(mode="after")
    def _above_the_horizon(self) -> Apertures:
        for theta, phi in self.directions:
            if theta < 0 or theta + self.half_angle > 90:
                raise ValueError(
                    f"the aperture at ({theta:g}, {phi:g}) with half_angle = {self.half_angle:g} must lie wholly above "
                    f"the horizon: 0 <= theta <= {90 - self.half_angle:g} degrees"
                )
        return self

    @property
    def axes(self) -> Vectors:
        """Unit vectors of the aperture axes (bins, 3)."""
        theta, phi = np.array(self.directions).T
        return direction(theta, phi)

    @property
    def shape(self) -> tuple[int]:
        """(apertures,)."""
        return (len(self.directions),)

    @property
    def bins(self) -> int:
        """How many apertures there are."""
        return len(self.directions)

    def projected_solid_angles(self) -> Floats:
        """Exact ∫ cosθ dω of every aperture in sr, shape (bins,): π sin²(half angle) cosθ."""
        return np.asarray(math.pi * math.sin(math.radians(self.half_angle)) ** 2 * self.axes[:, 2])

    def quadrature(
        self, wi: ArrayLike, nodes: int = DEFAULT_NODES, bins: NDArray[np.intp] | None = None
    ) -> tuple[Vectors, Floats]:
        """As `HemisphereGrid.quadrature`; here the directions do not depend on `wi`."""
        theta, phi = np.array(self.directions)[slice(None) if bins is None else bins].T
        return cone_quadrature(theta, phi, self.half_angle, nodes)


@recipe
class Klems:
    """The patches of Klems's matrices, as WINDOW and Radiance have them, for the detector and for the light alike.

    With this detector light comes from whole patches, too, one after another and cos-weighted over each, so that what
    is measured are the entries of the matrix itself. Directions are absolute: they do not turn with the source.
    """

    basis: Literal["full", "half", "quarter"] = "full"
    """145, 77 or 41 patches."""

    @property
    def theta_edges(self) -> Floats:
        """Ring edges in degrees, from 0 to 90, shape (rings + 1,)."""
        return np.array([0.0, *(upper for upper, _ in _KLEMS[self.basis])])

    @property
    def sectors(self) -> NDArray[np.int64]:
        """How many patches each ring has, (rings,)."""
        return np.array([count for _, count in _KLEMS[self.basis]])

    @property
    def directions(self) -> tuple[tuple[float, float], ...]:
        """(theta, phi) of each patch's centre, degrees; ring after ring, counter-clockwise from phi = 0."""
        edges = self.theta_edges
        middle = (edges[1:] + edges[:-1]) / 2
        middle[0] = 0.0
        return tuple(
            (float(theta), 360 * k / int(count))
            for theta, count in zip(middle, self.sectors, strict=True)
            for k in range(count)
        )

    @property
    def shape(self) -> tuple[int]:
        """(patches,)."""
        return (self.bins,)

    @property
    def bins(self) -> int:
        """How many patches there are."""
        return int(self.sectors.sum())

    def owner(self, w: ArrayLike, wi: ArrayLike = (0.0, 0.0, 1.0)) -> NDArray[np.intp]:
        """As `HemisphereGrid.owner`; here `wi` does not matter."""
        return ringed(self.theta_edges, self.sectors, w)

    def limits(self, bins: NDArray[np.intp] | None = None) -> tuple[Floats, Floats]:
        """Lower and upper polar angle (bins, 2), and azimuth of the centre and half the width (bins, 2), degrees."""
        edges, sectors = self.theta_edges, self.sectors
        ring = np.repeat(np.arange(len(sectors)), sectors)
        polar = np.stack([edges[ring], edges[ring + 1]], axis=-1)
        around = np.stack([np.array(self.directions)[:, 1], 180.0 / sectors[ring]], axis=-1)
        chosen = slice(None) if bins is None else bins
        return polar[chosen], around[chosen]

    def projected_solid_angles(self) -> Floats:
        """Exact ∫ cosθ dω of every patch in sr, shape (bins,); they sum to π."""
        polar, around = self.limits()
        return np.asarray(np.diff(np.sin(np.radians(polar)) ** 2)[:, 0] * np.radians(around[:, 1]))

    def quadrature(
        self, wi: ArrayLike, nodes: int = DEFAULT_NODES, bins: NDArray[np.intp] | None = None
    ) -> tuple[Vectors, Floats]:
        """As `HemisphereGrid.quadrature`; here the directions do not depend on `wi`."""
        polar, around = self.limits(bins)
        return patch_quadrature(polar, around[:, 0], around[:, 1], nodes)


_KLEMS = {
    "full": ((5, 1), (15, 8), (25, 16), (35, 20), (45, 24), (55, 24), (65, 24), (75, 16), (90, 12)),
    "half": ((6.5, 1), (19.5, 8), (32.5, 12), (45.5, 16), (58.5, 20), (71.5, 12), (90, 8)),
    "quarter": ((9, 1), (27, 8), (45, 12), (63, 12), (90, 8)),
}
"""Upper polar edge in degrees, and number of patches, of every ring (Klems, ASHRAE Trans. 100(1), 1994; WINDOW 7)."""


def ringed(theta_edges: ArrayLike, sectors: ArrayLike, w: ArrayLike, phi: float = 0.0) -> NDArray[np.intp]:
    """The bin that each direction `w` (..., 3) lies in, ring after ring between `theta_edges` in degrees, (...).

    Ring k has `sectors[k]` equal sectors, the first centred on azimuth `phi` in degrees; the pole is in the first.
    """
    theta, azimuth = angles(w)
    counts = np.asarray(sectors)
    ring = np.clip(np.searchsorted(np.asarray(theta_edges), theta, side="right") - 1, 0, len(counts) - 1)
    sector = np.floor((azimuth - phi) / 360 * counts[ring] + 0.5).astype(np.intp) % counts[ring]
    return np.asarray(np.cumsum(counts)[ring] - counts[ring] + np.where(theta > 1e-9, sector, 0))


def patch_quadrature(polar: Floats, phi: Floats, half_width: Floats, nodes: int) -> tuple[Vectors, Floats]:
    """Gauss-Legendre directions (n, nodes², 3) and cos-weighted weights (n, nodes²), summing to 1, over patches.

    Patches lie between the polar angles `polar` (n, 2), `half_width` (n,) around the azimuths `phi` (n,), degrees.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    theta = polar[:, :1] + np.diff(polar) * (x + 1) / 2
    wo = direction(theta[:, :, None], (phi[:, None] + half_width[:, None] * x)[:, None, :])
    weight = w * np.sin(np.radians(2 * theta))
    weight = weight[:, :, None] * w / (weight.sum(axis=1)[:, None, None] * w.sum())
    return wo.reshape(len(polar), -1, 3), weight.reshape(len(polar), -1)


def cone_quadrature(theta: Floats, phi: Floats, half_angle: float, nodes: int) -> tuple[Vectors, Floats]:
    """Directions (n, q, 3) and cos-weighted weights (n, q), summing to 1, over cones about (theta, phi), degrees.

    Gauss-Legendre in the polar angle of the cone, the periodic trapezoidal rule around it; all above the horizon.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    delta = math.radians(half_angle) * (x + 1) / 2
    psi = (np.arange(2 * nodes) + 0.5) * (math.pi / nodes)
    d, p = (a.ravel() for a in np.meshgrid(delta, psi, indexing="ij"))
    local = np.stack([np.sin(d) * np.cos(p), np.sin(d) * np.sin(p), np.cos(d)], axis=-1)
    frame = np.stack([direction(theta + 90, phi), direction(90.0, phi + 90), direction(theta, phi)], axis=-2)
    wo = local @ frame
    weight = np.repeat(w * np.sin(delta), 2 * nodes) * wo[..., 2]
    return wo, weight / weight.sum(axis=-1, keepdims=True)


Detector = Annotated[HemisphereGrid | Apertures | Klems, Field(discriminator="kind")]
"""Every detector there is."""

DETECTOR: TypeAdapter[Detector] = TypeAdapter(Detector)
"""Reads and writes any detector."""
