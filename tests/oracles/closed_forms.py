"""BRDFs in closed form that files are filled from.

The source is a closed form of the four angles and the wavelength, chiral and, if wanted, dependent on the azimuth of
the light, so that no two angles can be exchanged and no azimuth reversed.
"""

import math

import numpy as np

from gonio.brdf import BRDF
from gonio.detectors import HemisphereGrid
from gonio.measurement import tabulated

GRID = HemisphereGrid(theta_step=10.0, phi_step=15.0)
THETA_I, WAVELENGTHS = (0.0, 30.25, 60.0), (450.0, 550.0, 632.8)
ALL_AROUND = (0.0, 50.0, 130.0, 220.0, 300.0)


def chiral(theta_i, phi_i, theta_o, dphi, nm, turning=0.0):
    """Smooth, brightest where the specular direction is turned by 30 degrees; `turning` is how much phi_i matters."""
    lobe = 0.3 * np.sin(np.radians(theta_o)) * (1 + np.cos(np.radians(dphi - 210)))
    return nm / 550 * (0.2 + lobe) + 0.004 * theta_i + turning * (1 + np.cos(np.radians(phi_i - 40)))


def measured(phi_i=(0.0,), turning=0.0, grid=GRID, basis="spectrum", wavelengths=WAVELENGTHS, known=None):
    """The closed form at the bins' centres, with errors; unknown (NaN) where `known(theta_o, dphi)` is false."""
    axes = np.meshgrid(THETA_I, phi_i, grid.theta, grid.dphi, wavelengths, indexing="ij")
    values = chiral(*axes, turning)
    if known is not None:
        values = np.where(known(axes[2], axes[3]), values, np.nan)
    flags = {"title": "chiral", "isotropic": int(not turning), "basis": basis}
    errors = 0.01 * values + 1e-4 * axes[2]
    return tabulated(values, grid, THETA_I, phi_i, wavelengths, standard_error=errors, attributes=flags)


def isotropic(**more):
    return BRDF.of(measured(**more))


def anisotropic(**more):
    return BRDF.of(measured(ALL_AROUND, turning=0.1, **more))


def lambertian(rho=0.5, wavelengths=WAVELENGTHS):
    values = np.full(len(wavelengths), rho / math.pi)
    return BRDF(
        lambda wi, wo: np.broadcast_to(values, (len(wo), len(values))),
        np.array(wavelengths),
        np.array(THETA_I),
        detector=GRID,
        attributes={"title": "matt"},
    )


def directions(count, seed=0, most=80.0):
    """Random pairs of directions, as angles in degrees."""
    random = np.random.default_rng(seed).random((4, count))
    return most * random[0], 360 * random[1], most * random[2], 360 * random[3]
