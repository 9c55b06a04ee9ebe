"""Random rough surfaces, made in the spectrum: periodic, of any size, the same for the same seed."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from microsurfaces.arrays import Floats
from microsurfaces.height_field import HeightField
from microsurfaces.mesh import SlopeLaw
from microsurfaces.recipe import Positive, recipe
from microsurfaces.seeds import derived_seed


@recipe
class Gaussian:
    """A rough surface with Gaussian heights and a Gaussian correlation: the surface behind Beckmann's distribution.

    The heights have the autocovariance C(r) = sigma² exp(-r²/tau²), tau being `correlation_length`, so that slopes are
    Gaussian and independent along x and y: Beckmann's distribution with alpha = 2 sigma/tau, √2 times the rms slope
    along an axis. An anisotropic surface has alpha_x = 2 sigma/tau_x and alpha_y = 2 sigma/tau_y with
    sigma = tau √(alpha_x alpha_y)/2, tau_x = tau √(alpha_y/alpha_x), tau_y = tau √(alpha_x/alpha_y): tau stays the
    geometric mean of both lengths.

    The tile is periodic. Its expected covariance is exactly the sum of C over all periods, at every node. A facet
    between nodes dx apart sees a finite difference, hence alpha √((1-exp(-e²))/e²) with e = dx/tau: 0.2 % less at
    tau = 10 dx, 1.6 % less at tau = 4 dx. One tile of n = side/tau correlation lengths differs from the class by 1.25/n
    in its mean square slope (2 % at n = 60), by 0.63/n in alpha.

    A feel for the numbers: alpha 0.1 is a satin finish, 0.3 blasted metal (rms slope 0.21 along an axis, 12°), and from
    0.7 on multiple scattering is no longer small. Recommended: tau ≥ 10 dx and side ≥ 60 tau; the defaults have 17 and
    60.

    Reference: R. L. Cook and K. E. Torrance, A reflectance model for computer graphics, doi:10.1145/357290.357293.
    """

    alpha: Positive | None = None
    """Roughness of the isotropic surface: 2 sigma/tau, √2 times the rms slope along an axis."""
    alpha_x: Positive | None = None
    """Roughness along the surface's own x axis; give alpha_y with it and no alpha."""
    alpha_y: Positive | None = None
    """Roughness along the surface's own y axis."""
    rotation: float = 0.0
    """Angle from x to the surface's own x axis, degrees, counter-clockwise."""
    correlation_length: Positive = 10.0
    """tau in µm: the distance at which the correlation falls to 1/e."""
    side: Positive = 600.0
    """Side of the square tile, µm."""
    samples: Annotated[int, Field(ge=2, le=16384)] = 1024
    """Nodes along a side."""

    @model_validator(mode="after")
    def _one_roughness(self) -> Gaussian:
        values = {"alpha": self.alpha, "alpha_x": self.alpha_x, "alpha_y": self.alpha_y}
        given = {name: value for name, value in values.items() if value is not None}
        if list(given) not in (["alpha"], ["alpha_x", "alpha_y"]):
            found = " and ".join(f"{name} = {value:g}" for name, value in given.items()) or "alpha is missing"
            raise ValueError(f"{found}: give either alpha alone, or alpha_x and alpha_y together")
        if self.side < 4 * max(self._axes()[1:]):
            raise ValueError(
                f"side = {self.side:g} µm is less than 4 correlation lengths of {max(self._axes()[1:]):g} µm: "
                "make the side larger (60 are recommended) or the correlation length smaller"
            )
        return self

    def _axes(self) -> tuple[float, float, float]:
        """(sigma, tau_x, tau_y) in µm along the surface's own axes."""
        ax = self.alpha or self.alpha_x or 0.0
        ay = self.alpha or self.alpha_y or 0.0
        tau = self.correlation_length
        return tau * np.sqrt(ax * ay) / 2, tau * np.sqrt(ay / ax), tau * np.sqrt(ax / ay)

    def covariance(self) -> Floats:
        """Covariance of the heights of two nodes by their offset, (samples, samples) µm², summed over all periods."""
        offsets: Floats = np.fft.fftfreq(self.samples).astype(np.float64) * self.side
        return self._covariance_at(offsets, offsets[:, None])

    def _covariance_at(self, x: Floats, y: Floats) -> Floats:
        """Covariance of the heights of two points by their offset within half a period, µm²."""
        sigma, tau_x, tau_y = self._axes()
        c, s = np.cos(np.radians(self.rotation)), np.sin(np.radians(self.rotation))
        images = int(np.ceil(6.5 * max(tau_x, tau_y) / self.side - 0.5))  # exp(-6.5²) is below machine epsilon
        total = np.zeros(np.broadcast_shapes(x.shape, y.shape))
        for shift_x in np.arange(-images, images + 1) * self.side:
            for shift_y in np.arange(-images, images + 1) * self.side:
                u, v = x + shift_x, y + shift_y
                total += np.exp(-(((c * u + s * v) / tau_x) ** 2) - ((c * v - s * u) / tau_y) ** 2)
        return sigma**2 * total

    def build(self, seed: int, realisation: int = 0, realisations: int = 1) -> HeightField:
        """Specimen number `realisation` of this seed: white noise filtered by the root of the covariance's spectrum."""
        random = np.random.Generator(np.random.Philox(derived_seed(seed, "surface", realisation)))
        noise = random.standard_normal((self.samples, self.samples))
        spectrum = np.fft.rfft2(self.covariance()).real
        np.maximum(spectrum, 0.0, out=spectrum)
        heights = np.fft.irfft2(np.fft.rfft2(noise) * np.sqrt(spectrum), s=noise.shape)
        step = self.side / self.samples
        return HeightField(heights, (step, step))

    def expected_slopes(self, azimuth: float, slopes: Floats) -> SlopeLaw:
        """Distribution of the facets' slopes along `azimuth`, degrees, at `slopes`, exact for the mesh.

        Both kinds of facets, of falling and of rising diagonals, have Gaussian slopes, of different variance where
        `azimuth` lies between the axes.
        """
        from scipy.special import ndtr

        c, s = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
        falling, rising = np.sqrt(self._slope_variances(c, s))
        share = (self.samples**2 + 1) // 2 / self.samples**2
        cdf = share * ndtr(slopes / falling) + (1 - share) * ndtr(slopes / rising)
        spread = self._spread(c, s, slopes / np.sqrt((falling**2 + rising**2) / 2))
        return SlopeLaw(cdf, spread, 0.0)

    def _slope_variances(self, c: float, s: float) -> tuple[float, float]:
        """Variance of c dz/dx + s dz/dy on facets of cells with falling and with rising diagonals."""
        step = self.side / self.samples
        offsets = np.array([(0, 0), (1, 0), (0, 1), (1, 1), (1, -1)]) * step
        node, x, y, up, down = self._covariance_at(*offsets.T) / step**2
        both = c**2 * 2 * (node - x) + s**2 * 2 * (node - y)
        return float(both + 2 * c * s * (node - x - y + down)), float(both + 2 * c * s * (x + y - node - up))

    def _spread(self, c: float, s: float, scores: Floats) -> Floats:
        """Standard deviation, from tile to tile, of the share of slopes below `scores` standard deviations.

        The covariance of "slope < u" at two points whose slopes have the correlation rho is, u being the same for both,
        the integral of exp(-u²/(1 + sin t)) / 2π over t from 0 to asin(rho) (Sheppard); the mean over all pairs of
        points is the variance. The correlation is that of a smaller tile of the same kind, wide enough to hold it.
        """
        patch = self._patch()
        n, waves = patch.samples, np.fft.fftfreq(patch.samples) * 2 * np.pi
        gradient = c * (np.exp(1j * waves) - 1) + s * (np.exp(1j * waves[:, None]) - 1)
        correlation = np.fft.ifft2(np.fft.fft2(patch.covariance()).real * np.abs(gradient) ** 2).real
        angles = np.arcsin(np.clip(correlation / correlation[0, 0], -1, 1)).ravel()
        # Every angle is shared between two nodes of a grid, on which the integral is known.
        half = 256
        place = (angles / np.pi + 0.5) * 2 * half
        below = np.minimum(place.astype(np.intp), 2 * half - 1)
        pairs = sum(np.bincount(below + k, np.abs(1 - k - place + below), 2 * half + 1) for k in (0, 1))
        middles = (np.arange(2 * half) + 0.5 - half) * np.pi / (2 * half)
        steps = np.exp(-(scores[..., None] ** 2) / (1 + np.sin(middles))) / (4 * half)
        integral = np.concatenate([np.zeros((*scores.shape, 1)), np.cumsum(steps, axis=-1)], axis=-1)
        variance = (integral - integral[..., half : half + 1]) @ pairs / n**2
        return np.asarray(np.sqrt(np.maximum(variance, 0)) * patch.side / self.side)

    def _patch(self) -> Gaussian:
        """A tile of up to 12 correlation lengths with at least 8 nodes in each, as far as this one has them."""
        _, tau_x, tau_y = self._axes()
        side = float(min(self.side, 12 * max(tau_x, tau_y)))
        step = max(self.side / self.samples, min(tau_x, tau_y) / 8)
        return replace(self, side=side, samples=min(1024, max(2, round(side / step))))
