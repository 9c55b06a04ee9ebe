"""What a surface looks like: a sphere and a plate shaded with a BRDF, in linear sRGB, without a renderer.

The light of a distant source comes from one direction and is reflected as f cosθ_i E. The sky is all directions at
once: by Helmholtz's reciprocity the light that reaches the eye is the lobe of light from the eye's place, times what
each of its bins sees; what is measured keeps its energy exactly. Nothing is reflected twice, and no shadow falls; the
camera is far away. Values are radiances; `exposed` turns them into a picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from gonio.brdf import BRDF
from gonio.colour import encoded
from gonio.detectors import HemisphereGrid, patch_quadrature
from gonio.interpolation import bracket, bracket_around
from gonio.measurement import Measurement, tabulated
from gonio.models import Model
from gonio.models.averages import RandomWalk
from gonio.sphere import angles, direction
from microsurfaces.arrays import Floats, Vectors

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Sky = Callable[[Vectors], Floats]
"""Radiance (..., 3) of the surroundings in world directions (..., 3); z is up, the camera looks along +y."""

RINGS, SECTORS = 30, 60
"""Bins in which the reflected sky is summed: the lobe of light from the eye's place."""

VIEW_STEP = {True: 4.0, False: 8.0}
"""Degrees between polar angles of the eye at which that is done, from 0 to 88, if isotropic and if not."""

AROUND = 36
"""Azimuths around the eye at which the reflected sky is summed; it has no fine detail."""

PATCH = 3.0, 10.0
"""Least and largest radius of the patches over which noisy lobes are averaged, degrees."""

PATCH_GRID = HemisphereGrid(theta_step=2.0, phi_step=4.0)
"""Bins that hold what is left of them."""

STOPS = 8.0
"""White is at most so many times as bright as half of a picture."""

VISIBLE = 0.03
"""Relative noise that is left in a patch."""

EYE = (0.0, -1.0, 0.0)
"""World direction to the eye that looks at a sphere."""

_TOWARDS_EYE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Axes of the picture, rows: to the right, up, to the eye."""

LIGHT = (-0.45, -0.55, 0.7)
"""World direction from which the light of the distant source comes: from above, the left and the camera's side."""

IRRADIANCE = 2.0
"""Of the distant source on a surface that faces it; the sky's is about π."""


def daylight(w: Vectors) -> Floats:
    """A clear sky: pale at the horizon, blue at the zenith, over a dim ground. Radiances between 0 and 1."""
    up = w[..., 2:]
    height = np.clip(up, 0.0, 1.0) ** 0.5
    sky = (1 - height) * [0.95, 0.97, 1.0] + height * [0.35, 0.52, 0.85]
    # A soft horizon, half a degree wide: an edge would only show the bins.
    share = np.clip(0.5 + up / 0.04, 0.0, 1.0)
    return np.asarray(share * sky + (1 - share) * [0.2, 0.18, 0.16])


def coloured(source: Measurement | Model | BRDF, wavelengths: Floats | None = None) -> BRDF:
    """`source` as a function with linear sRGB channels; a model needs the wavelengths in nm at which it is asked."""
    brdf = BRDF.of(source, None if isinstance(source, Measurement | BRDF) else wavelengths)
    if isinstance(source, RandomWalk):
        # Walks are taken once, for the bins of a table, and not for every texel.
        phi_i = np.zeros(1) if brdf.isotropic else np.arange(0.0, 360.0, 30.0)
        brdf = BRDF.of(brdf.sampled(np.arange(0.0, 86.0, 5.0), phi_i, PATCH_GRID))
    return brdf.in_basis("RGB")


def sphere(
    source: Measurement | Model | BRDF,
    size: int = 400,
    light_direction: tuple[float, float, float] = LIGHT,
    irradiance: float = IRRADIANCE,
    sky: Sky | None = daylight,
    wavelengths: Floats | None = None,
) -> Floats:
    """Radiances (size, size, 3) of a sphere that fills the picture, seen from -y; NaN in texels that it does not touch.

    The grain of an anisotropic surface, its x, runs around the sphere along circles of latitude. `silhouette` tells how
    much of a texel at the rim the sphere covers.
    """
    lobes = coloured(source, wavelengths)
    normals = _ball(size)
    eye = np.broadcast_to(EYE, normals.shape)
    image = _lit(lobes, _frames(normals), eye, _unit(light_direction), irradiance)
    if sky is not None:
        image += _reflected_sky(lobes, sky, normals)
    return np.where(silhouette(size)[..., None] > 0, image.reshape(size, size, 3), np.nan)


def silhouette(size: int) -> Floats:
    """The share of each texel (size, size) that is covered by the sphere of `sphere`, 0 to 1."""
    centres = np.arange(size) + 0.5 - size / 2
    return np.asarray(np.clip(size / 2 - np.hypot(centres, centres[:, None]) + 0.5, 0.0, 1.0))


def _ball(size: int) -> Vectors:
    """Normals (size², 3) of a sphere in a picture of (size, size); texels beside it see its rim."""
    centres = (np.arange(size) + 0.5) * (2 / size) - 1
    x, z = np.meshgrid(centres, -centres)
    shrunk = np.minimum(1.0, 0.999 / np.maximum(np.hypot(x, z), 1e-9))
    x, z = x * shrunk, z * shrunk
    return np.stack([x, -np.sqrt(1 - x**2 - z**2), z], axis=-1).reshape(-1, 3)


def plate(
    source: Measurement | Model | BRDF,
    size: tuple[int, int] = (300, 500),
    light_theta: float = 70.0,
    irradiance: float = IRRADIANCE,
    wavelengths: Floats | None = None,
) -> Floats:
    """Radiances (*size, 3) of a level plate under light from behind it, at `light_theta` degrees from its normal.

    The camera stands before the plate: rows see it at 80 degrees from the normal at the top to 20 at the bottom,
    columns look 35 degrees to either side. x runs to the right.
    """
    theta = np.linspace(80.0, 20.0, size[0])[:, None]
    phi = np.linspace(-35.0, 35.0, size[1])[None, :]
    eye = direction(theta, 270.0 + phi).reshape(-1, 3)
    frames = np.broadcast_to(np.eye(3), (len(eye), 3, 3))
    light = direction(light_theta, 90.0)
    return _lit(coloured(source, wavelengths), frames, eye, light, irradiance).reshape(*size, 3)


def exposure(*images: Floats) -> float:
    """The radiance that becomes white in pictures of all `images`: of the brightest 0.5 % of the texels, or `STOPS`
    times the median, so that a small highlight does not leave the rest in the dark."""
    together = np.concatenate([image[np.isfinite(image).all(axis=-1)].ravel() for image in images])
    return float(min(np.quantile(together, 0.995), STOPS * np.median(together))) or 1.0


def exposed(*images: Floats, white: float | None = None) -> list[NDArray[np.uint8]]:
    """Pictures (rows, columns, 4) in sRGB with alpha, all with the same exposure.

    `white` is the radiance that becomes white; unless it is given, it is their `exposure`.
    """
    white = exposure(*images) if white is None else white
    pictures = []
    for image in images:
        known = np.asarray(np.isfinite(image).all(axis=-1))
        screen = encoded(np.where(known[..., None], image, 0.0) / max(white, 1e-12))
        pictures.append((np.dstack([screen, known]) * 255 + 0.5).astype(np.uint8))
    return pictures


def softened(measurement: Measurement) -> tuple[Measurement, float]:
    """`measurement` without the noise that would sparkle, and the radius in degrees of the patches that it took.

    The light per solid angle is averaged over patches with a smooth bump as weight. They are as large as the standard
    errors ask for, to leave about `VISIBLE`, within the limits of `PATCH`. A measurement whose bins are larger, or
    quiet enough, or without errors, as another program's, stays as it is; the radius is 0 then.
    """
    detector = measurement.detector
    if not isinstance(detector, HemisphereGrid):
        return measurement, 0.0
    radius = _patch_radius(measurement, detector)
    if radius <= detector.theta_step:
        return measurement, 0.0
    radius = float(np.clip(np.ceil(radius), *PATCH))
    data = measurement.dataset
    table = data["brdf"].sel(order="all").transpose("theta_o", "dphi", "theta_i", "phi_i", "wavelength").values
    flat, weights = table.reshape(detector.bins, -1), _patches(detector, radius)
    with np.errstate(invalid="ignore"):
        means = (weights @ np.nan_to_num(flat)) / (weights @ np.isfinite(flat).astype(float))
    means = np.moveaxis(means.reshape(*PATCH_GRID.shape, *table.shape[2:]), (0, 1), (2, 3))
    # The light of every incidence is kept.
    light = data["albedo"].sel(order="all").transpose("theta_i", "phi_i", "wavelength").values
    area = PATCH_GRID.projected_solid_angles().reshape(*PATCH_GRID.shape, 1)
    found = np.nansum(means * area, axis=(2, 3))
    means *= np.divide(light, found, out=np.ones_like(found), where=found > 0)[:, :, None, None]
    theta_i, phi_i, wavelengths = (data[name].values for name in ("theta_i", "phi_i", "wavelength"))
    smooth = tabulated(means, PATCH_GRID, theta_i, phi_i, wavelengths, attributes=measurement.attributes)
    return smooth, radius


def _patch_radius(measurement: Measurement, detector: HemisphereGrid) -> float:
    """Radius in degrees of patches in which a typical share of the light has the relative noise `VISIBLE`; 0 if no
    noise is known."""
    data = measurement.dataset.sel(order="all").mean("wavelength")
    area = detector.projected_solid_angles().reshape(detector.shape)
    light, noise = (
        np.nan_to_num(data["brdf"].values) * area,
        np.nan_to_num(data["brdf_standard_error_mc"].values) * area,
    )
    solid = area / np.cos(np.radians(detector.theta))[:, None]
    per_steradian = (np.divide(noise**2, light, out=np.zeros_like(light), where=light > 0) * solid).sum() / light.sum()
    # A bump of this kind has the noise of a disc of 5/9 of its area.
    return float(np.degrees(np.sqrt(per_steradian * 9 / 5 / np.pi) / VISIBLE))


def _patches(detector: HemisphereGrid, radius: float) -> csr_array:
    """How much each bin of `detector` counts in each of `PATCH_GRID`, (theirs, ours)."""
    from scipy.sparse import csr_array
    from scipy.spatial import KDTree

    theirs, ours = (direction(grid.theta[:, None], grid.dphi).reshape(-1, 3) for grid in (PATCH_GRID, detector))
    reach = 2 * np.sin(np.radians(radius) / 2)
    pairs = KDTree(theirs).sparse_distance_matrix(KDTree(ours), reach, output_type="ndarray")
    bump = (1 - (pairs["v"] / reach) ** 2) ** 2 * detector.projected_solid_angles()[pairs["j"]]
    return csr_array((bump, (pairs["i"], pairs["j"])), shape=(len(theirs), len(ours)))


def _lit(lobes: BRDF, frames: Floats, eye: Vectors, light: Vectors, irradiance: float) -> Floats:
    """Radiances (n, 3) towards `eye` (n, 3) of surfaces whose axes are the rows of `frames` (n, 3, 3), lit from
    `light`."""
    wo, wi = _local(frames, eye), _local(frames, np.broadcast_to(light, eye.shape))
    radiance = np.zeros((len(wo), 3))
    lit = wi[:, 2] > 0
    values = np.nan_to_num(lobes.evaluate(wi[lit], wo[lit]))
    radiance[lit] = irradiance * wi[lit, 2:] * np.maximum(values, 0.0)
    return radiance


def _reflected_sky(lobes: BRDF, sky: Sky, normals: Vectors) -> Floats:
    """Radiances (n, 3) towards the eye of a sphere with these normals under `sky`.

    They are summed for normals in rings around the eye, and lie on smooth curves between those.
    """
    from scipy.ndimage import map_coordinates

    step = VIEW_STEP[lobes.isotropic]
    theta, around = np.arange(0.0, 89.0, step), np.arange(0.0, 360.0, 360 / AROUND)
    rings = np.stack([_sky_of_ring(lobes, sky, t, _facing(t, around)) for t in theta])
    # Beyond the middle lies the other side of the same ring.
    beyond = np.roll(rings[3:0:-1], AROUND // 2, axis=1)
    polar = np.concatenate([beyond, rings])
    polar = np.concatenate([polar[:, -4:], polar, polar[:, :5]], axis=1)
    seen, turn = angles(_local(_TOWARDS_EYE, normals))
    places = [np.minimum(seen / step, len(theta) - 1) + len(beyond), turn * (AROUND / 360) + 4]
    image = np.stack([map_coordinates(polar[..., c], places, mode="nearest") for c in range(3)], axis=-1)
    return np.asarray(image.clip(0))


def _facing(theta: float, around: Floats) -> Vectors:
    """Normals (n, 3) that lie `theta` degrees off the eye."""
    return np.asarray(direction(theta, around) @ _TOWARDS_EYE)


def _sky_of_ring(lobes: BRDF, sky: Sky, theta: float, normals: Vectors) -> Floats:
    """Radiances (n, 3) towards the eye of surfaces with these normals, all of them `theta` degrees off the eye."""
    frames = _frames(normals)
    _, phi = angles(_local(frames, np.broadcast_to(EYE, normals.shape)))
    bins = _Bins.around_specular() if lobes.isotropic else _Bins.even()
    local = direction(bins.theta.mean(axis=1)[:, None], bins.dphi[:, None] + phi)
    seen = sky(np.einsum("nij,bni->bnj", frames, local, optimize=True))
    if lobes.isotropic:
        return np.asarray(np.einsum("bc,bnc->nc", _shares(lobes, theta, 0.0, bins, 2), seen))
    # Every azimuth has a lobe of its own: between lobes that turn, a blend would show stars.
    shares = np.stack([_shares(lobes, theta, p, bins, 1) for p in phi], axis=1)
    return np.asarray((shares * seen).sum(axis=0))


@dataclass(frozen=True)
class _Bins:
    """Bins of the hemisphere: ring edges (n, 2), sector centres and half widths (n,), degrees."""

    theta: Floats
    dphi: Floats
    half: Floats

    @classmethod
    def even(cls) -> Self:
        """Sectors of the same width."""
        return cls._of(np.linspace(0.0, 360.0, SECTORS + 1))

    @classmethod
    def around_specular(cls) -> Self:
        """Sectors that are narrow about the specular direction, as lobes are that graze the surface."""
        u = np.linspace(-1.0, 1.0, SECTORS + 1)
        return cls._of(180 + 180 * u * np.abs(u))

    @classmethod
    def _of(cls, sectors: Floats) -> Self:
        rings = np.linspace(0.0, 90.0, RINGS + 1)
        theta = np.repeat(np.stack([rings[:-1], rings[1:]], axis=1), SECTORS, axis=0)
        centre, half = (sectors[1:] + sectors[:-1]) / 2, np.diff(sectors) / 2
        return cls(theta, np.tile(centre, RINGS), np.tile(half, RINGS))

    @property
    def area(self) -> Floats:
        """Projected solid angles (n,), sr."""
        return np.asarray(np.diff(np.sin(np.radians(self.theta)) ** 2)[:, 0] * np.radians(self.half))


def _shares(lobes: BRDF, theta: float, phi: float, bins: _Bins, nodes: int) -> Floats:
    """How much of what each bin sees is sent to an eye at these angles, (bins, 3): the lobe of light from its place.

    `nodes`² values a bin are averaged.
    """
    eye = direction(theta, phi)
    wo, weights = patch_quadrature(bins.theta, bins.dphi + phi, bins.half, nodes)
    values = lobes.evaluate(np.broadcast_to(eye, wo.shape).reshape(-1, 3), wo.reshape(-1, 3)).reshape(*wo.shape)
    shares = np.asarray(np.einsum("bkc,bk,b->bc", np.nan_to_num(values), weights, bins.area).clip(0))
    if lobes.measurement is None or not lobes.measurement.measured.all():
        return shares
    return np.asarray(shares * (_albedo(lobes.measurement, theta, phi) / np.maximum(shares.sum(axis=0), 1e-12)))


def _albedo(measurement: Measurement, theta: float, phi: float) -> Floats:
    """Of light from these angles, (3,), between those that were measured, never less than 0."""
    table = measurement.dataset["albedo"].sel(order="all").values
    rows, part = bracket(measurement.dataset["theta_i"].values, np.array(theta), "theta_i", extrapolate="nearest")
    along = (1 - part) * table[rows[0]] + part * table[rows[1]]
    if measurement.isotropic:
        return np.asarray(along[0].clip(0))
    columns, part = bracket_around(measurement.dataset["phi_i"].values, np.array(phi), extrapolate="nearest")
    return np.asarray(((1 - part) * along[columns[0]] + part * along[columns[1]]).clip(0))


def _local(frames: Floats, w: Vectors) -> Vectors:
    """World directions (n, 3) in the axes of `frames`, (n, 3, 3) or (3, 3)."""
    return np.asarray((frames @ w[..., None])[..., 0])


def _frames(normals: Vectors) -> Floats:
    """Axes (n, 3, 3), rows x, y, z: z along the normals, x along circles of latitude about the vertical."""
    x = np.stack([-normals[:, 1], normals[:, 0], np.zeros(len(normals))], axis=-1)
    length = np.linalg.norm(x, axis=1, keepdims=True)
    x = np.where(length > 1e-9, x / np.maximum(length, 1e-9), [1.0, 0.0, 0.0])
    return np.stack([x, np.cross(normals, x), normals], axis=1)


def _unit(w: tuple[float, float, float]) -> Vectors:
    return np.asarray(np.asarray(w) / np.linalg.norm(w))
