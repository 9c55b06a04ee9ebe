"""What a surface looks like: a sphere and a plate shaded with a BRDF, in linear sRGB, without a renderer.

The lamp is one direction, its light f cosθ_i E. The sky is all directions at once: by Helmholtz's reciprocity the light
that reaches the eye is the lobe that a lamp in the eye's place would make, times what each of its bins sees, so that
energy is kept exactly. Nothing is reflected twice between parts of the scene, and no shadow falls; the camera is far
away. Values are radiances; `exposed` turns them into a picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gonio.colour import encoded
from gonio.detectors import HemisphereGrid
from gonio.formats.lobes import Lobes
from gonio.measurement import Measurement
from gonio.models import Model
from gonio.sphere import Vectors, angles, direction

Floats = NDArray[np.float64]
Sky = Callable[[Vectors], Floats]
"""Radiance (..., 3) of the surroundings in world directions (..., 3); z is up, the camera looks along +y."""

SKY_GRID = HemisphereGrid(theta_step=3.0, phi_step=6.0)
"""Bins in which the reflected sky is summed."""

COARSE = 64
"""Texels along the side of the picture in which the reflected sky is summed; it has no fine detail."""

VIEW_THETA = np.concatenate([np.arange(0.0, 88.0, 4.0), [88.0]])
"""Polar angles of the eye for which lobes are made, degrees; others lie between."""

VIEW_PHI = np.arange(0.0, 360.0, 30.0)
"""Azimuths of the eye, for surfaces that look different from them."""

LAMP = (-0.45, -0.55, 0.7)
"""World direction to the lamp: from above, the left and the camera's side."""

IRRADIANCE = 2.0
"""Of the lamp on a surface that faces it; the sky's is about π."""


def daylight(w: Vectors) -> Floats:
    """A clear sky: pale at the horizon, blue at the zenith, over a dim ground. Radiances between 0 and 1."""
    up = w[..., 2:]
    height = np.clip(up, 0.0, 1.0) ** 0.5
    sky = (1 - height) * [0.95, 0.97, 1.0] + height * [0.35, 0.52, 0.85]
    # A soft horizon, half a degree wide: an edge would only show the bins.
    share = np.clip(0.5 + up / 0.04, 0.0, 1.0)
    return np.asarray(share * sky + (1 - share) * [0.2, 0.18, 0.16])


def coloured(source: Measurement | Model | Lobes, wavelengths: Floats | None = None) -> Lobes:
    """`source` as a function with linear sRGB channels; a model needs the wavelengths in nm at which it is asked."""
    if isinstance(source, Measurement):
        source = Lobes.of(source)
    elif not isinstance(source, Lobes):
        nm = np.array([450.0, 550.0, 650.0]) if wavelengths is None else np.asarray(wavelengths, np.float64)
        model = source
        source = Lobes(lambda wi, wo: model.eval(wi, wo, nm), nm, np.arange(0.0, 90.0, 5.0))
    return source.in_basis("RGB")


def sphere(
    source: Measurement | Model | Lobes,
    size: int = 400,
    lamp: tuple[float, float, float] = LAMP,
    irradiance: float = IRRADIANCE,
    sky: Sky | None = daylight,
    wavelengths: Floats | None = None,
) -> Floats:
    """Radiances (size, size, 3) of a sphere that fills the picture, seen from -y; NaN beside it.

    The grain of an anisotropic surface, its x, runs around the sphere along circles of latitude.
    """
    lobes = coloured(source, wavelengths)
    normals, inside = _ball(size)
    eye = np.broadcast_to([0.0, -1.0, 0.0], normals.shape)
    image = _lit(lobes, _frames(normals), eye, _unit(lamp), irradiance)
    if sky is not None:
        coarse, _ = _ball(COARSE)
        reflected = _Reflections.of(lobes).of_sky(sky, _frames(coarse), np.broadcast_to(eye[0], coarse.shape))
        image += _enlarged(reflected.reshape(COARSE, COARSE, 3), size).reshape(-1, 3)
    return np.where(inside[..., None], image.reshape(size, size, 3), np.nan)


def _ball(size: int) -> tuple[Vectors, NDArray[np.bool_]]:
    """Normals (size², 3) of a sphere in a picture of (size, size), and which texels are inside; others see its rim."""
    centres = (np.arange(size) + 0.5) * (2 / size) - 1
    x, z = np.meshgrid(centres, -centres)
    radius = np.hypot(x, z)
    shrunk = np.minimum(1.0, 0.999 / np.maximum(radius, 1e-9))
    x, z = x * shrunk, z * shrunk
    normals = np.stack([x, -np.sqrt(1 - x**2 - z**2), z], axis=-1)
    return normals.reshape(-1, 3), radius < 1


def _enlarged(image: Floats, size: int) -> Floats:
    """`image` (n, n, 3) at (size, size, 3), bilinearly."""
    from scipy.ndimage import map_coordinates

    at = (np.arange(size) + 0.5) * (len(image) / size) - 0.5
    places = np.meshgrid(at, at, indexing="ij")
    return np.stack([map_coordinates(image[..., c], places, order=1, mode="nearest") for c in range(3)], axis=-1)


def plate(
    source: Measurement | Model | Lobes,
    size: tuple[int, int] = (300, 500),
    lamp_theta: float = 75.0,
    irradiance: float = IRRADIANCE,
    wavelengths: Floats | None = None,
) -> Floats:
    """Radiances (*size, 3) of a level plate under a lamp at `lamp_theta` degrees behind it.

    The camera stands before the plate, its eye level with the top of the picture's frame: rows see the plate at 85
    degrees from the normal at the top to 25 at the bottom, columns look 35 degrees to either side. x runs to the right.
    """
    theta = np.linspace(85.0, 25.0, size[0])[:, None]
    phi = np.linspace(-35.0, 35.0, size[1])[None, :]
    eye = direction(theta, 270.0 + phi).reshape(-1, 3)
    frames = np.broadcast_to(np.eye(3), (len(eye), 3, 3))
    lamp = direction(lamp_theta, 90.0)
    return _lit(coloured(source, wavelengths), frames, eye, lamp, irradiance).reshape(*size, 3)


def exposed(*images: Floats, white: float | None = None) -> list[NDArray[np.uint8]]:
    """Pictures (rows, columns, 4) in sRGB with alpha, all with the same exposure.

    `white` is the radiance that becomes white; unless it is given, only the brightest 0.5 % of all texels are.
    """
    together = np.concatenate([image[np.isfinite(image).all(axis=-1)].ravel() for image in images])
    white = float(np.quantile(together, 0.995)) if white is None else white
    pictures = []
    for image in images:
        known = np.asarray(np.isfinite(image).all(axis=-1))
        screen = encoded(np.where(known[..., None], image, 0.0) / max(white, 1e-12))
        pictures.append((np.dstack([screen, known]) * 255 + 0.5).astype(np.uint8))
    return pictures


def _lit(lobes: Lobes, frames: Floats, eye: Vectors, lamp: Vectors, irradiance: float) -> Floats:
    """Radiances (n, 3) towards `eye` (n, 3) of surfaces whose axes are the rows of `frames` (n, 3, 3), by the lamp."""
    wo, wi = _local(frames, eye), _local(frames, np.broadcast_to(lamp, eye.shape))
    radiance = np.zeros((len(wo), 3))
    lit = wi[:, 2] > 0
    radiance[lit] = irradiance * wi[lit, 2:] * np.maximum(lobes.evaluate(wi[lit], wo[lit]), 0.0)
    return radiance


@dataclass(frozen=True)
class _Reflections:
    """For some directions of the eye, how much of what each bin of `SKY_GRID` sees is sent there."""

    theta: Floats
    phi: Floats
    shares: Floats
    """(theta, phi, bins, 3), f times projected solid angle."""

    @classmethod
    def of(cls, lobes: Lobes) -> Self:
        """The lobes of lamps in the eye's place."""
        phi = np.zeros(1) if lobes.isotropic else VIEW_PHI
        area = SKY_GRID.projected_solid_angles()[:, None]
        shares = [
            [np.nan_to_num(lobes.average(direction(t, p), SKY_GRID)).clip(0) * area for p in phi] for t in VIEW_THETA
        ]
        return cls(VIEW_THETA, phi, np.array(shares))

    def of_sky(self, sky: Sky, frames: Floats, eye: Vectors) -> Floats:
        """Radiances (n, 3) towards `eye` (n, 3) under `sky`."""
        theta, phi = angles(_local(frames, eye))
        at = np.interp(theta, self.theta, np.arange(len(self.theta)))
        low = np.minimum(at.astype(int), len(self.theta) - 2)
        around = np.zeros(len(eye), int) if len(self.phi) == 1 else np.rint(phi / 360 * len(self.phi)).astype(int)
        around %= len(self.phi)
        result = np.zeros((len(eye), 3))
        high, share = low + 1, (at - low)[:, None, None]
        for ring, theta_o in enumerate(SKY_GRID.theta):
            bins = ring * SKY_GRID.shape[1] + np.arange(SKY_GRID.shape[1])
            local = direction(theta_o, SKY_GRID.dphi + phi[:, None])
            seen = sky(np.einsum("nij,nki->nkj", frames, local))
            weights = (1 - share) * self.shares[low, around][:, bins] + share * self.shares[high, around][:, bins]
            result += (weights * seen).sum(axis=1)
        return result


def _local(frames: Floats, w: Vectors) -> Vectors:
    """World directions (n, 3) in the axes of `frames` (n, 3, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", frames, w))


def _frames(normals: Vectors) -> Floats:
    """Axes (n, 3, 3), rows x, y, z: z along the normals, x along circles of latitude about the vertical."""
    x = np.stack([-normals[:, 1], normals[:, 0], np.zeros(len(normals))], axis=-1)
    length = np.linalg.norm(x, axis=1, keepdims=True)
    x = np.where(length > 1e-9, x / np.maximum(length, 1e-9), [1.0, 0.0, 0.0])
    return np.stack([x, np.cross(normals, x), normals], axis=1)


def _unit(w: tuple[float, float, float]) -> Vectors:
    return np.asarray(np.asarray(w) / np.linalg.norm(w))
