"""Poulin and Fournier's model of anisotropic reflection: parallel micro-cylinders, ridges or grooves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from gonio.detectors import Apertures, Detector, Klems
from gonio.models.averages import bin_average
from gonio.models.cook_torrance import NORMALISATIONS, CookTorrance
from gonio.models.cylinder_lobes import COLUMNS, lambertian, rough
from gonio.models.cylinders import edge_angle, shared, strip_width, visible
from gonio.models.distributions import BECKMANN, REACH
from gonio.models.masking import CODES, VCavity
from gonio.models.microfacet import Microfacet
from gonio.optics import Conductor, Dielectric, Lambertian, Material, Mirror
from gonio.sphere import angles, as_directions, rotate_z
from microsurfaces import Cylinders
from microsurfaces.arrays import Floats, Vectors
from microsurfaces.recipe import Fraction, Positive, recipe

Local = Annotated[Lambertian | Mirror | Conductor | Dielectric | CookTorrance | Microfacet, Field(discriminator="kind")]
"""How a point of a cylinder reflects: as a diffuser, as a mirror, or as a rough surface of its own."""

_NODES = 24
"""Gauss-Legendre nodes of Fresnel's reflectance along a piece of arc that falls into one bin."""

_SAMPLES = 2000
"""Places at which a ridge's arc is asked whether the light it reflects gets away, before the edges are bisected."""


class _Piece(NamedTuple):
    """An arc whose normals run from `first` to `last` and that sends its light away after `order` reflections.

    A normal phi sends it to the projected angle slope phi + offset.
    """

    first: float
    last: float
    slope: float
    offset: float


@recipe
class PoulinFournier:
    """Poulin and Fournier's model (1990): the surface is made of small parallel cylinders, out of or into a plane.

    Physics. Seen along their axes, cylinders look like a mirror along one direction only, which is what brushed metal,
    silk or records do. Every point of a cylinder reflects by the `local` law about its own normal; what counts is what
    is lit and visible at the same time. Because the surface is invariant along the axes, that depends only on the
    projected angles psi of both directions in the plane across the cylinders, and is always one interval of normals,
    known in closed form, and one part of the flat strip between cylinders. Light reflected twice is not in the model.

    Equation. With d the distance, phi the angle of the cylinder's normal n, [phi_1, phi_2] its lit and visible arc and
    w the lit and visible width of the strip, all lengths in radii:

        f = integral of f_local(n) cos(phi - psi_i) cos(phi - psi_o) dphi / (d cos psi_i cos psi_o) + (w / d) f_local(N)

    Lambertian: closed form. Rough (CookTorrance or Microfacet): closed form for Beckmann's distribution with V-cavity
    masking or none and for GGX with none, quadrature to 1e-10 for Smith's maskings. Mirrors (Mirror, Conductor,
    Dielectric): all light goes to a cone around the axis through the specular direction. That is a measure and no
    function: `eval` refuses, `line_density` gives the power per radian along the cone, and `average` the exact content
    of a detector's bins, which is inversely proportional to their width across the cone: state the bin size with every
    number. For grooves `average(..., order=k)` is exact for k reflections as well, since inside a circle the angle of
    incidence stays the same.

    Several `groups` of cylinders side by side, large against their relief, add up by area: a weave is
    groups = ((0.5, 0), (0.5, 90)).

    What is the paper's. Its idea: cylinders added or subtracted, their distance and their height as the only
    parameters, self-blocking, groups of several directions, and a local reflection that may be any; it evaluates the
    diffuse part exactly and the specular part by Chebyshev polynomials. The closed forms here are derived anew, the
    paper's own equations were not at hand; its h may be counted from the cylinder's top, here `floor_height` is counted
    from the plane of the axes (0: half-cylinders, 1: flat), and `protrusion` = 1 - floor_height from the top.

    A feel for the numbers: distance 2 on floor 0 is the strongest anisotropy, touching half-cylinders; 0 and infinity
    are flat. Under normal light Lambertian ridges at distance 2 have f = rho / 4 from above (flat: rho / pi) and return
    0.80 rho after one reflection, mirror ridges 64 %, mirror grooves 50 %. For d < 2 the floor is hidden, and no fit
    can find it, until floor_height > sqrt(1 - d^2 / 4).

    Source: P. Poulin and A. Fournier, A Model for Anisotropic Reflection, SIGGRAPH 1990, doi:10.1145/97880.97909.
    """

    local: Local
    """How a point reflects: Lambertian, Mirror, Conductor, Dielectric, CookTorrance or Microfacet."""
    profile: Literal["ridges", "grooves"] = "ridges"
    """Cylinders that stand out of the surface, or that are cut into it."""
    distance: Positive = 2.0
    """Distance d between neighbouring axes, in radii."""
    floor_height: Annotated[float, Field(ge=0, lt=1)] | None = None
    """Height h of the floor above the axes, in radii (of grooves: depth of the lands below them); 0 if not given."""
    protrusion: Annotated[float, Field(gt=0, le=1)] | None = None
    """1 - h, how far ridges stand out of the floor in radii: give this or the floor height."""
    groups: Annotated[tuple[tuple[Fraction, float], ...], Field(min_length=1)] = ((1.0, 0.0),)
    """(area fraction, angle) of each group of cylinders: angle of its axes from y, degrees, counter-clockwise."""

    order: ClassVar[str] = "1"
    """It speaks of light that was reflected once."""
    free: ClassVar[dict[str, tuple[float, float]]] = {"distance": (0.05, 8.0), "floor_height": (0.0, 0.99)}
    """What a fit adjusts, and its bounds."""

    @model_validator(mode="after")
    def _one_floor(self) -> Self:
        if self.floor_height is not None and self.protrusion is not None:
            raise ValueError(
                f"floor_height = {self.floor_height:g} and protrusion = {self.protrusion:g}: both name one height "
                "(protrusion = 1 - floor_height), give one of them"
            )
        total = math.fsum(fraction for fraction, _ in self.groups)
        if abs(total - 1.0) > 1e-9:
            raise ValueError(f"the area fractions of groups sum to {total:g}: they must sum to 1")
        return self

    @model_validator(mode="after")
    def _isotropic_local(self) -> Self:
        if isinstance(self.local, CookTorrance | Microfacet):
            lobes = self.local.distribution.lobes()
            if (lobes[:, 2] != lobes[:, 3]).any():
                raise ValueError(
                    "local: the roughness on a cylinder must be isotropic here; give m or alpha, without _x and _y"
                )
        return self

    @classmethod
    def of(cls, statistics: Mapping[str, float | None], material: Material, surface: object = None) -> Self:
        """The model of a specimen of `Cylinders`, with its material as local reflection; else a ValueError."""
        if not isinstance(surface, Cylinders):
            raise ValueError("PoulinFournier describes cylinders, and this specimen is not known to be made of them.")
        return cls(
            local=material,
            profile=surface.profile,
            distance=surface.distance,
            floor_height=surface.floor_height,
            protrusion=surface.protrusion,
        )

    def eval(self, wi: ArrayLike, wo: ArrayLike, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """BRDF (..., W) in 1/sr, no cosine, of `wi` and `wo` (..., 3); 0 where a direction is not above the horizon.

        Raises ValueError for a mirror as local reflection, which has no values.
        """
        if isinstance(self.local, Mirror | Conductor | Dielectric):
            raise ValueError(
                f"PoulinFournier with local = {self.local!r} sends all light to a cone, a line of directions: it has "
                "no value at a point; use average for the content of a detector's bins, or line_density."
            )
        wi, wo = as_directions(wi, "wi"), as_directions(wo, "wo")
        shape = np.broadcast_shapes(wi.shape, wo.shape)
        source, eye = (np.broadcast_to(w, shape).reshape(-1, 3) for w in (wi, wo))
        total = np.zeros((len(source), np.size(wavelengths)))
        for fraction, angle in self.groups:
            turned_source, turned_eye = (np.ascontiguousarray(rotate_z(w, -angle)) for w in (source, eye))
            total += fraction * self._group(turned_source, turned_eye, wavelengths)
        return total.reshape(*shape[:-1], -1)

    def average(self, wi: ArrayLike, detector: Detector, wavelengths: ArrayLike = (550.0,), order: int = 1) -> Floats:
        """Bin averages (bins, W) in 1/sr for light from `wi` (3,).

        Exact for mirrors, to about 1e-5 of a bin or of the mean for the rest. `order` is the number of reflections, of
        which grooves with a mirror as local reflection know any; others know 1, else a ValueError.
        """
        wi = np.asarray(wi, np.float64)
        if not isinstance(self.local, Mirror | Conductor | Dielectric):
            if order != 1:
                raise ValueError(f"order = {order}: only mirror grooves have a closed form beyond one reflection.")
            return bin_average(self, self._detail, wi, detector, wavelengths)
        power = np.zeros((detector.bins, np.size(wavelengths)))
        if wi[2] > 0.0:
            for fraction, angle in self.groups:
                power += fraction * self._arrivals(rotate_z(wi, -angle), angle, detector, wavelengths, order)
        return power / detector.projected_solid_angles()[:, None]

    def line_density(self, wi: ArrayLike, psi: ArrayLike, wavelengths: ArrayLike = (550.0,), order: int = 1) -> Floats:
        """Share of the light from `wi` (3,), per radian of the projected angle `psi` (n,) radians: (n, W).

        Of mirror cylinders with one group along y; light of `order` reflections, without that of the strips.
        """
        source = np.asarray(wi, np.float64)
        psi = np.atleast_1d(np.asarray(psi, np.float64))
        density = np.zeros((psi.size, np.size(wavelengths)))
        psi_i = math.atan2(source[0], source[2])
        for piece in self._pieces(psi_i, order):
            phi = (psi - piece.offset) / piece.slope
            inside = (phi >= piece.first) & (phi < piece.last)
            cosine = np.cos(phi - psi_i)
            power = self._reflected(source, cosine, wavelengths) ** order * cosine[:, None]
            density += np.where(inside[:, None], power, 0.0) / (piece.slope * self.distance * math.cos(psi_i))
        return density

    def strip_share(self, wi: ArrayLike, wavelengths: ArrayLike = (550.0,)) -> Floats:
        """Share of the light from `wi` (3,) that flat strips send into the specular direction, (W,)."""
        source = np.asarray(wi, np.float64)
        psi = math.atan2(source[0], source[2])
        strip = shared(*self._profile(), psi, -psi)[2]
        return np.asarray(self._reflectance(np.array([source[2]]), wavelengths)[0] * strip / self.distance)

    # --- Geometry -----------------------------------------------------------------------------------------------------

    def _profile(self) -> tuple[bool, float, float, float]:
        """Ridges or not, distance, edge angle, strip width: what the kernels ask for."""
        floor = 1.0 - self.protrusion if self.protrusion is not None else self.floor_height or 0.0
        edge, width = edge_angle(self.distance, floor), strip_width(self.distance, floor)
        return self.profile == "ridges", self.distance, edge, width

    def _pieces(self, psi_i: float, order: int) -> Iterator[_Piece]:
        """The arcs that send light from the projected angle `psi_i` away after `order` mirror reflections."""
        if self.profile == "grooves":
            yield from self._inside_circle(psi_i, order)
        elif order != 1:
            raise ValueError(f"order = {order}: ridges have a closed form for one reflection only, grooves for any.")
        else:
            yield from self._off_ridge(psi_i)

    def _inside_circle(self, psi_i: float, order: int) -> Iterator[_Piece]:
        """Reflections inside a circle advance by equal steps, of 2 i - pi for the angle of incidence i > 0."""
        ridges, d, edge, w = self._profile()
        for sign in (1.0, -1.0):
            psi = sign * psi_i  # the mirror image of what advances the other way
            lo, hi, _, _ = visible(ridges, d, edge, w, psi)
            stays = ((order - 1) * (2 * psi + math.pi) - edge) / (2 * order - 1)
            leaves = (order * (2 * psi + math.pi) - edge) / (2 * order + 1)
            first, last = max(lo, psi, stays), min(hi, leaves)
            offset = -(2 * order - 1) * psi - (order - 1) * math.pi
            if last > first:
                low, high = sorted((sign * first, sign * last))
                yield _Piece(low, high, 2.0 * order, sign * offset)

    def _off_ridge(self, psi_i: float) -> Iterator[_Piece]:
        """The lit arc, without what the neighbour catches after the reflection."""
        profile = self._profile()
        lo, hi, _, _ = visible(*profile, psi_i)

        def free(phi: float) -> bool:
            psi = 2 * phi - psi_i
            if abs(psi) >= math.pi / 2:
                return False
            first, last, _, _ = visible(*profile, psi)
            return bool(first <= phi <= last)

        places = np.linspace(lo, hi, _SAMPLES + 1)[:-1] + (hi - lo) / (2 * _SAMPLES)
        got_away = np.array([False, *map(free, places), False])
        places = np.concatenate([[lo], places, [hi]])
        edges = np.flatnonzero(np.diff(got_away))
        changes = [_bisected(free, places[i], places[i + 1], bool(got_away[i])) for i in edges]
        for first, last in zip(changes[::2], changes[1::2], strict=True):
            yield _Piece(first, last, 2.0, -psi_i)

    # --- Mirrors ------------------------------------------------------------------------------------------------------

    def _reflectance(self, cosines: Floats, wavelengths: ArrayLike) -> Floats:
        """Reflectance (n, W) of the local mirror."""
        assert isinstance(self.local, Mirror | Conductor | Dielectric)
        return self.local.reflectance(cosines, wavelengths)

    def _reflected(self, source: Vectors, cosine: Floats, wavelengths: ArrayLike) -> Floats:
        """Reflectance (n, W) where the projected angle of incidence has these cosines."""
        return self._reflectance(np.clip(cosine * math.hypot(source[0], source[2]), 0.0, 1.0), wavelengths)

    def _arrivals(
        self, source: Vectors, angle: float, detector: Detector, wavelengths: ArrayLike, order: int
    ) -> Floats:
        """Share of the light (bins, W) in every bin; `source` in the frame of a group whose axes are at `angle`."""
        psi_i, share = math.atan2(source[0], source[2]), np.zeros((detector.bins, np.size(wavelengths)))
        cuts = _crossings(source, angle, detector)
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        for piece in self._pieces(psi_i, order):
            phi = (cuts - piece.offset) / piece.slope
            phi = np.concatenate([[piece.first], phi[(phi > piece.first) & (phi < piece.last)], [piece.last]])
            half, middle = np.diff(phi) / 2, (phi[1:] + phi[:-1]) / 2
            cosine = np.cos(middle[:, None] + half[:, None] * nodes - psi_i)
            power = self._reflected(source, cosine.ravel(), wavelengths) ** order * cosine.reshape(-1, 1)
            power = (power.reshape(*cosine.shape, -1) * weights[:, None]).sum(axis=1) * half[:, None]
            _deposit(
                share,
                power / (self.distance * math.cos(psi_i)),
                _on_cone(source, piece, middle),
                source,
                angle,
                detector,
            )
        if order == 1:
            mirrored = source * [-1.0, -1.0, 1.0]
            _deposit(share, self.strip_share(source, wavelengths)[None], mirrored[None], source, angle, detector)
        return share

    # --- Functions ----------------------------------------------------------------------------------------------------

    def _group(self, wi: Floats, wo: Floats, wavelengths: ArrayLike) -> Floats:
        """Values (n, W) of cylinders along y at rows of directions."""
        if isinstance(self.local, Lambertian):
            value = lambertian(self._profile(), wi, wo) * self.local.reflectance
            return np.repeat(value[:, None], np.size(wavelengths), axis=1)
        assert isinstance(self.local, CookTorrance | Microfacet)
        masking = VCavity() if isinstance(self.local, CookTorrance) else self.local.masking
        lobes = np.ascontiguousarray(self.local.distribution.lobes()[:, COLUMNS])
        geometry = rough(self._profile(), lobes, CODES[type(masking).__name__], wi, wo)
        cosine = np.minimum(np.linalg.norm(wi + wo, axis=1) / 2, 1.0)
        value = geometry[:, None] * self.local.material.reflectance(cosine, wavelengths)
        if isinstance(self.local, CookTorrance):
            value *= self.local.k_s * NORMALISATIONS[self.local.normalisation]
            value += (self.local.k_d * self.local.reflectance) * lambertian(self._profile(), wi, wo)[:, None]
        return value

    def _detail(self, wi: Vectors, wo: Vectors, radius: Floats) -> Floats:
        """The finest detail of f: across the cone, the local lobe; along it, nothing but kinks."""
        finest = np.full(len(wo), np.inf)
        if isinstance(self.local, Lambertian):
            return finest
        assert isinstance(self.local, CookTorrance | Microfacet)
        for _, angle in self.groups:
            wh = rotate_z(wi + wo, -angle)
            length = np.linalg.norm(wh, axis=-1)
            axial = np.arctan2(np.abs(wh[..., 1]), np.hypot(wh[..., 0], wh[..., 2]))
            nearest = np.maximum(axial - radius[:, None] / length, 0.0)
            for kind, _, alpha, _, _, _ in self.local.distribution.lobes():
                if kind == BECKMANN:
                    width = np.where(nearest < np.arctan(REACH * alpha), min(alpha, 1.0), np.inf)
                else:
                    width = np.minimum(np.hypot(alpha, np.tan(np.minimum(nearest, 1.5))), 1.0)
                finest = np.minimum(finest, (width * length).min(axis=1))
        return finest


def _bisected(free, a: float, b: float, free_at_a: bool) -> float:
    """Where `free` changes between a and b."""
    for _ in range(60):
        middle = (a + b) / 2
        a, b = (middle, b) if free(middle) == free_at_a else (a, middle)
    return (a + b) / 2


def _on_cone(source: Vectors, piece: _Piece, phi: Floats) -> Vectors:
    """Directions (n, 3) in which normals `phi` (n,) send the light from `source`."""
    psi, across = piece.slope * phi + piece.offset, math.hypot(source[0], source[2])
    return np.stack([across * np.sin(psi), np.full_like(psi, -source[1]), across * np.cos(psi)], axis=-1)


def _crossings(source: Vectors, angle: float, detector: Detector) -> Floats:
    """Projected angles, sorted, at which the cone through the specular direction of `source` crosses edges of bins."""
    across, axial = math.hypot(source[0], source[2]), float(source[1])
    if isinstance(detector, Apertures):
        axes = rotate_z(detector.axes, -angle)
        radius = across * np.hypot(axes[:, 0], axes[:, 2])
        level = math.cos(math.radians(detector.half_angle)) + axes[:, 1] * axial
        crossed = np.abs(level) <= radius
        middle = np.arctan2(axes[crossed, 0], axes[crossed, 2])
        apart = np.arccos(level[crossed] / radius[crossed])
        return np.sort(np.concatenate([middle - apart, middle + apart]))
    cosines = np.cos(np.radians(detector.theta_edges)) / across
    rings = np.arccos(cosines[cosines <= 1.0])
    if isinstance(detector, Klems):
        azimuths = np.radians(np.concatenate([(np.arange(n) + 0.5) * (360 / n) for n in set(detector.sectors)]) - angle)
    else:
        azimuths = np.radians(detector.dphi_edges + angles(source)[1])
    with np.errstate(divide="ignore"):
        sines = -(axial / across) / np.tan(azimuths)
    sectors = np.arcsin(sines[np.abs(sines) <= 1.0])
    return np.sort(np.concatenate([-rings, rings, sectors, [0.0]]))


def _deposit(share: Floats, power: Floats, wo: Vectors, source: Vectors, angle: float, detector: Detector) -> None:
    """Add light (n, W) that leaves in directions `wo` (n, 3) to the bins that see it."""
    if isinstance(detector, Apertures):
        seen = wo @ rotate_z(detector.axes, -angle).T >= math.cos(math.radians(detector.half_angle))
        share += seen.T @ power
        return
    np.add.at(share, detector.owner(rotate_z(wo, angle), rotate_z(source, angle)), power)
