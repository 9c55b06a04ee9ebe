"""Measurements of models that are known, with noise that is known."""

import json
from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from gonio.detectors import Apertures, HemisphereGrid
from gonio.measurement import tabulated
from gonio.models import Beckmann, Microfacet, SmithCorrelated
from gonio.optics import Mirror
from gonio.sphere import direction

GRID = HemisphereGrid(theta_step=5.0, phi_step=15.0)
TRUTH = Microfacet(distribution=Beckmann(0.4), masking=SmithCorrelated(), material=Mirror())
FREEDOM = 15


@dataclass(frozen=True)
class Synthetic:
    """What `compare` reads of a measurement."""

    dataset: xr.Dataset
    detector: HemisphereGrid | Apertures
    attributes: dict[str, str]
    surface_statistics: dict[str, float | None] = field(default_factory=dict)

    @property
    def wavelengths(self):
        return self.dataset["wavelength"].values

    @property
    def channels(self):
        return tuple(f"{nm:g} nm" for nm in self.wavelengths)

    @property
    def measured(self):
        return self.dataset["albedo"].isel(order=0).notnull().any("wavelength").values

    def incidences(self):
        for i, j in np.argwhere(self.measured):
            yield float(self.dataset["theta_i"][i]), float(self.dataset["phi_i"][j])


def synthetic(
    truth=TRUTH,
    noise=0.02,
    seed=0,
    detector=GRID,
    theta_i=(30.0,),
    phi_i=(0.0,),
    wavelengths=(550.0,),
    realisations=1,
    common=0.0,
    hits=1000,
    beam=0.0,
    skip=(),
    order="1",
):
    """A measurement of `truth` with Gaussian noise of relative size `noise` in every bin, estimated from 16 replicates.

    `common` is the relative size of a change of the whole lobe that differs from specimen to specimen.
    """
    rng = np.random.default_rng(seed)
    freedom = FREEDOM if realisations == 1 else realisations - 1
    bins = ("theta_o", "dphi") if isinstance(detector, HemisphereGrid) else ("detector",)
    shape = (1, len(theta_i), len(phi_i))
    names = ("brdf", "brdf_standard_error", "brdf_standard_error_mc")
    binned = {name: np.full((*shape, *detector.shape, len(wavelengths)), np.nan) for name in names}
    total = {
        f"albedo{name}": np.full((*shape, len(wavelengths)), np.nan)
        for name in ("", "_standard_error", "_standard_error_mc")
    }
    counts = np.zeros((*shape, *detector.shape), np.int64)
    paths = np.full(shape[1:], 1000)
    solid = detector.projected_solid_angles()[:, None]
    for i, theta in enumerate(theta_i):
        for j, phi in enumerate(phi_i):
            if (i, j) in skip:
                paths[i, j] = 0
                continue
            exact = truth.average(direction(theta, phi), detector, wavelengths)
            samples = exact * (1 + noise * np.sqrt(freedom + 1) * rng.standard_normal((freedom + 1, *exact.shape)))
            alone = samples.std(axis=0, ddof=1) / np.sqrt(freedom + 1)
            samples = samples * (1 + common * np.sqrt(freedom + 1) * rng.standard_normal((freedom + 1, 1, 1)))
            sums = (samples * solid).sum(axis=1)
            error = samples.std(axis=0, ddof=1) / np.sqrt(freedom + 1)
            per_bin = (samples.mean(axis=0), error, alone if realisations > 1 else error)
            for name, values in zip(names, per_bin, strict=True):
                binned[name][0, i, j] = values.reshape(*detector.shape, -1)
            total["albedo"][0, i, j] = sums.mean(axis=0)
            total["albedo_standard_error"][0, i, j] = sums.std(axis=0, ddof=1) / np.sqrt(freedom + 1)
            independent = np.sqrt(((alone * solid) ** 2).sum(axis=0))
            total["albedo_standard_error_mc"][0, i, j] = (
                independent if realisations > 1 else total["albedo_standard_error"][0, i, j]
            )
            counts[0, i, j] = np.broadcast_to(hits, detector.bins).reshape(detector.shape)
    front = ("order", "theta_i", "phi_i")
    data = xr.Dataset(
        {
            **{name: ((*front, *bins, "wavelength"), values) for name, values in binned.items()},
            **{name: ((*front, "wavelength"), values) for name, values in total.items()},
            "count": ((*front, *bins), counts),
            "paths": (front[1:], paths),
            "realisations": (front[1:], np.where(paths > 0, realisations, 0)),
            "degrees_of_freedom": (front[1:], np.full(paths.shape, freedom)),
            "degrees_of_freedom_mc": (front[1:], np.full(paths.shape, FREEDOM * realisations)),
        },
        {
            "order": [order],
            "theta_i": list(theta_i),
            "phi_i": list(phi_i),
            "wavelength": list(wavelengths),
            **{name: getattr(detector, name.removesuffix("_o")) for name in bins if name != "detector"},
        },
    )
    return Synthetic(data, detector, {"goniometer": json.dumps({"beam_half_angle": beam})})


def poisson(seed, photons, truth=TRUTH, theta_i=(30.0,), wavelengths=(550.0,), detector=GRID):
    """A measurement of `truth` that counted about `photons` paths an incidence in 16 replicates.

    A path carries its weight at every wavelength: their noise is one.
    """
    rng = np.random.default_rng(seed)
    base = synthetic(truth, 0.0, seed, detector, theta_i, wavelengths=wavelengths)
    exact = base.dataset["brdf"].values.reshape(len(theta_i), detector.bins, -1)
    mean = exact.mean(axis=2, keepdims=True)
    lit = photons / 16 * detector.projected_solid_angles()[:, None] * mean
    counts = rng.poisson(np.broadcast_to(lit, (16, *lit.shape)))
    value = counts * (exact / np.maximum(lit, 1e-300))
    error = value.std(axis=0, ddof=1) / 4
    brdf = base.dataset["brdf"]
    data = base.dataset.assign(
        brdf=(brdf.dims, value.mean(axis=0).reshape(brdf.shape)),
        brdf_standard_error=(brdf.dims, error.reshape(brdf.shape)),
        brdf_standard_error_mc=(brdf.dims, error.reshape(brdf.shape)),
        count=(brdf.dims[:-1], counts.sum(axis=0).reshape(brdf.shape[:-1])),
    )
    return Synthetic(data, detector, base.attributes)


def external(
    truth=TRUTH,
    noise=None,
    seed=0,
    detector=GRID,
    theta_i=(30.0,),
    phi_i=(0.0,),
    wavelengths=(550.0,),
    unknown=None,
    attributes=None,
):
    """A measurement of `truth` that comes from elsewhere, exact and without errors, or with noise and its errors.

    `noise` is relative. Values are not known where `unknown` is true; it broadcasts with theta_i, phi_i, theta_o, dphi,
    W.
    """
    wi = [direction(theta, phi) for theta in theta_i for phi in phi_i]
    exact = np.stack([truth.average(each, detector, wavelengths) for each in wi])
    exact = exact.reshape(len(theta_i), len(phi_i), *detector.shape, len(wavelengths))
    error = None if noise is None else noise * exact
    brdf = exact if noise is None else exact + error * np.random.default_rng(seed).standard_normal(exact.shape)
    if unknown is not None:
        brdf = np.where(unknown, np.nan, brdf)
    return tabulated(brdf, detector, theta_i, phi_i, wavelengths, error, attributes)
