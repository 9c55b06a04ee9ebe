"""Measurements of models that are known, with noise that is known."""

import json
from dataclasses import dataclass, field, replace

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
    """What `compare` and `fit` read of a measurement."""

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


@dataclass(frozen=True)
class Conditions:
    """How a specimen is lit and seen; degrees and nm."""

    detector: HemisphereGrid | Apertures = GRID
    theta_i: tuple[float, ...] = (30.0,)
    phi_i: tuple[float, ...] = (0.0,)
    wavelengths: tuple[float, ...] = (550.0,)

    @property
    def shape(self):
        return len(self.theta_i), len(self.phi_i)

    @property
    def binned(self):
        """The shape of what has a value for every incidence, bin and wavelength."""
        return *self.shape, *self.detector.shape, len(self.wavelengths)

    def averages(self, truth):
        """Exact bin averages of a model (theta_i, phi_i, bins, wavelength) in 1/sr."""
        wi = [direction(theta, phi) for theta in self.theta_i for phi in self.phi_i]
        exact = np.stack([truth.average(each, self.detector, self.wavelengths) for each in wi])
        return exact.reshape(*self.shape, *exact.shape[1:])


@dataclass(frozen=True)
class Specimens(Conditions):
    """What is measured, and how."""

    realisations: int = 1
    common: float = 0.0
    """Relative size of a change of the whole lobe that differs from specimen to specimen."""
    count: int = 1000
    """Arrivals in every bin, or in each."""
    beam: float = 0.0
    """Half angle of the source's beam, degrees."""
    skip: tuple[tuple[int, int], ...] = ()
    """Places in theta_i, phi_i that were not measured."""
    order: str = "1"

    @property
    def freedom(self):
        return FREEDOM if self.realisations == 1 else self.realisations - 1

    @property
    def measured(self):
        """Which incidences were."""
        measured = np.ones(self.shape, bool)
        for place in self.skip:
            measured[place] = False
        return measured


SUFFIXES = ("", "_standard_error", "_standard_error_mc")


def synthetic(truth=TRUTH, noise=0.02, seed=0, **conditions):
    """A measurement of `truth` with Gaussian noise of relative size `noise` in every bin, estimated from 16 replicates.

    `conditions` are those of `Specimens`.
    """
    setup, rng = Specimens(**conditions), np.random.default_rng(seed)
    detector, measured = setup.detector, setup.measured
    exact = setup.averages(truth)
    brdf = [np.full(setup.binned, np.nan) for _ in SUFFIXES]
    albedo = [np.full((*setup.shape, len(setup.wavelengths)), np.nan) for _ in SUFFIXES]
    for place in map(tuple, np.argwhere(measured)):
        bins, sums = replicated(rng, exact[place], noise, setup)
        for array, values in zip(brdf, bins, strict=True):
            array[place] = values.reshape(setup.binned[2:])
        for array, values in zip(albedo, sums, strict=True):
            array[place] = values
    count = np.broadcast_to(setup.count, detector.bins).reshape(detector.shape)
    count = count * measured[..., *[None] * count.ndim]
    bins = ("theta_o", "dphi") if isinstance(detector, HemisphereGrid) else ("detector",)
    front = ("order", "theta_i", "phi_i")
    named = [(f"brdf{suffix}", values, (*bins, "wavelength")) for suffix, values in zip(SUFFIXES, brdf, strict=True)]
    named += [(f"albedo{suffix}", values, ("wavelength",)) for suffix, values in zip(SUFFIXES, albedo, strict=True)]
    data = xr.Dataset(
        {
            **{name: ((*front, *dims), values[None]) for name, values, dims in (*named, ("count", count, bins))},
            "paths": (front[1:], 1000 * measured),
            "realisations": (front[1:], setup.realisations * measured),
            "degrees_of_freedom": (front[1:], np.full(setup.shape, setup.freedom)),
            "degrees_of_freedom_mc": (front[1:], np.full(setup.shape, FREEDOM * setup.realisations)),
        },
        {
            "order": [setup.order],
            "theta_i": list(setup.theta_i),
            "phi_i": list(setup.phi_i),
            "wavelength": list(setup.wavelengths),
            **{name: getattr(detector, name.removesuffix("_o")) for name in bins if name != "detector"},
        },
    )
    return Synthetic(data, detector, {"goniometer": json.dumps({"beam_half_angle": setup.beam})})


def replicated(rng, exact, noise, setup):
    """Of one incidence the bins (bins, W) and the albedo (W,), each with standard error and its Monte Carlo part."""
    root = np.sqrt(setup.freedom + 1)
    solid = setup.detector.projected_solid_angles()[:, None]
    samples = exact * (1 + noise * root * rng.standard_normal((setup.freedom + 1, *exact.shape)))
    alone = samples.std(axis=0, ddof=1) / root
    samples = samples * (1 + setup.common * root * rng.standard_normal((setup.freedom + 1, 1, 1)))
    sums = (samples * solid).sum(axis=1)
    error, error_of_sum = (values.std(axis=0, ddof=1) / root for values in (samples, sums))
    several = setup.realisations > 1
    independent = np.sqrt(((alone * solid) ** 2).sum(axis=0)) if several else error_of_sum
    return (
        (samples.mean(axis=0), error, alone if several else error),
        (sums.mean(axis=0), error_of_sum, independent),
    )


def poisson(seed, photons, truth=TRUTH, **conditions):
    """A measurement of `truth` that counted about `photons` paths an incidence in 16 replicates.

    A path carries its weight at every wavelength: their noise is one. `conditions` are those of `Specimens`.
    """
    rng = np.random.default_rng(seed)
    base = synthetic(truth, 0.0, seed, **conditions)
    brdf, solid = base.dataset["brdf"], base.detector.projected_solid_angles()[:, None]
    exact = brdf.values.reshape(-1, *solid.shape[:1], brdf.sizes["wavelength"])
    mean = exact.mean(axis=2, keepdims=True)
    lit = photons / 16 * solid * mean
    counts = rng.poisson(np.broadcast_to(lit, (16, *lit.shape)))
    value = counts * (exact / np.maximum(lit, 1e-300))
    error = value.std(axis=0, ddof=1) / 4
    data = base.dataset.assign(
        brdf=(brdf.dims, value.mean(axis=0).reshape(brdf.shape)),
        brdf_standard_error=(brdf.dims, error.reshape(brdf.shape)),
        brdf_standard_error_mc=(brdf.dims, error.reshape(brdf.shape)),
        count=(brdf.dims[:-1], counts.sum(axis=0).reshape(brdf.shape[:-1])),
    )
    return replace(base, dataset=data)


def external(truth=TRUTH, noise=None, seed=0, unknown=None, attributes=None, **conditions):
    """An external measurement of `truth`, exact and without errors, or with noise and its errors.

    `noise` is relative. Values are not known where `unknown` is true; it broadcasts with theta_i, phi_i, theta_o, dphi,
    W. `conditions` are those of `Conditions`.
    """
    setup = Conditions(**conditions)
    exact = setup.averages(truth).reshape(setup.binned)
    error = None if noise is None else noise * exact
    brdf = exact if noise is None else exact + error * np.random.default_rng(seed).standard_normal(exact.shape)
    if unknown is not None:
        brdf = np.where(unknown, np.nan, brdf)
    return tabulated(brdf, setup.detector, setup.theta_i, setup.phi_i, setup.wavelengths, error, attributes)
