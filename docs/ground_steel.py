"""Make configs/ground_steel.png, a synthetic height map that looks like profilometer data of ground steel.

Grinding leaves the lower envelope of many nearly parallel grooves of random depth: z = min over grits of the parabola
that each one cut. A few late, deep scratches, a fine self-affine roughness and the blur of an optical profilometer
finish it. One grey level is 1 nm and one pixel 0.5 µm; the lay runs along x. Run it as `python docs/ground_steel.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

PIXELS = 256
PIXEL_SIZE = 0.5
LEVEL = 0.001
"""µm per grey level."""

Heights = NDArray[np.float64]


def grooves(rng: np.random.Generator, count: int, spread: float, deepest: float) -> Heights:
    """Lower envelope (µm) of `count` parabolic cuts whose directions differ by `spread` degrees from the x axis."""
    y, x = np.mgrid[:PIXELS, :PIXELS] * PIXEL_SIZE
    z = np.zeros((PIXELS, PIXELS))
    side = PIXELS * PIXEL_SIZE
    for _ in range(count):
        angle = np.radians(rng.normal(0.0, spread))
        across = (y - rng.uniform(-0.1, 1.1) * side) * np.cos(angle) - (x - side / 2) * np.sin(angle)
        along = (x - rng.uniform(-0.3, 1.3) * side) / rng.uniform(0.5, 1.5) / side
        floor = -min(rng.gamma(2.0, 0.3), deepest) * (1.0 - along**2)
        z = np.minimum(z, floor + across**2 / (2.0 * rng.uniform(1.5, 8.0)))
    return z


def fine_roughness(rng: np.random.Generator, rms: float, hurst: float) -> Heights:
    """A self-affine random field (µm), flat above 10 µm wavelength."""
    f = np.hypot(np.fft.fftfreq(PIXELS)[:, None], np.fft.rfftfreq(PIXELS)[None, :]) / PIXEL_SIZE
    amplitude = np.hypot(f, 1 / 10.0) ** -(hurst + 1.0)
    z = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(PIXELS, PIXELS))) * amplitude, s=(PIXELS, PIXELS))
    return np.asarray(z * (rms / z.std()))


def instrument_blur(z: Heights, sigma: float) -> Heights:
    """`z` seen through a Gaussian optical response of `sigma` µm; the border is extended by reflection."""
    pad = 8
    padded = np.pad(z, pad, mode="reflect")
    fx, fy = np.fft.rfftfreq(padded.shape[1]), np.fft.fftfreq(padded.shape[0])[:, None]
    response = np.exp(-2.0 * (np.pi * sigma / PIXEL_SIZE) ** 2 * (fx**2 + fy**2))
    return np.asarray(np.fft.irfft2(np.fft.rfft2(padded) * response, s=padded.shape)[pad:-pad, pad:-pad])


def heights(seed: int = 1982) -> Heights:
    """The map (µm), lowest point 0."""
    rng = np.random.default_rng(seed)
    z = grooves(rng, 420, 1.5, 1.6) + 0.4 * grooves(rng, 14, 9.0, 1.6) + fine_roughness(rng, 0.1, 0.75)
    z = instrument_blur(z, 0.45)
    return np.asarray(z - z.min(), np.float64)


def save(path: Path) -> None:
    """Write the map as a 16-bit grey PNG."""
    note = PngInfo()
    note.add_text("Description", "Synthetic ground steel; 0.5 um per pixel, 0.001 um per grey level, lay along x.")
    levels = np.rint(heights() / LEVEL).astype(np.uint16)
    Image.fromarray(levels).save(path, pnginfo=note, optimize=True)


if __name__ == "__main__":
    save(Path(__file__).parents[1] / "configs" / "ground_steel.png")
