"""Random rough surfaces, made in the spectrum: periodic, of any size, the same for the same seed."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from microsurfaces.height_field import HeightField
from microsurfaces.mesh import Floats
from microsurfaces.recipe import Positive, recipe


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
        sigma, tau_x, tau_y = self._axes()
        c, s = np.cos(np.radians(self.rotation)), np.sin(np.radians(self.rotation))
        offsets = np.fft.fftfreq(self.samples) * self.side
        images = int(np.ceil(6.5 * max(tau_x, tau_y) / self.side - 0.5))  # exp(-6.5²) is below machine epsilon
        total = np.zeros((self.samples, self.samples))
        for shift_x in np.arange(-images, images + 1) * self.side:
            for shift_y in np.arange(-images, images + 1) * self.side:
                x, y = offsets + shift_x, (offsets + shift_y)[:, None]
                total += np.exp(-(((c * x + s * y) / tau_x) ** 2) - ((c * y - s * x) / tau_y) ** 2)
        return sigma**2 * total

    def build(self, seed: int) -> HeightField:
        """The surface of this seed: white noise filtered by the root of the covariance's spectrum."""
        noise = np.random.Generator(np.random.Philox(seed)).standard_normal((self.samples, self.samples))
        spectrum = np.fft.rfft2(self.covariance()).real
        np.maximum(spectrum, 0.0, out=spectrum)
        heights = np.fft.irfft2(np.fft.rfft2(noise) * np.sqrt(spectrum), s=noise.shape)
        step = self.side / self.samples
        return HeightField(heights, (step, step))
