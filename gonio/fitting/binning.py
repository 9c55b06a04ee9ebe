"""What is fitted: the energies of every incidence, in bins joined as long as the lobes keep their shape."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gonio.detectors import Detector, HemisphereGrid
from gonio.measurement import Measurement
from gonio.sphere import direction
from microsurfaces.arrays import Floats, Vectors

_ENOUGH_BINS = 40.0
"""Bins that must share a lobe's light (its participation number) for bins to be joined before a fit."""

_WIDEST = 6.0, 15.0
"""Degrees in theta and phi beyond which bins are not joined."""

_KEPT = 0.9
"""Share of a lobe's known light that must remain where joined bins, a part of which is unknown, are left out."""

_BACKGROUND = 1e-3
"""Share of the mean BRDF that is added to both sides, so that a model's faintest tails do not decide a fit."""


class Lobe(NamedTuple):
    """One incidence as it is fitted: energies, shares of the incident light."""

    wi: Vectors
    detector: Detector
    kept: NDArray[np.intp]
    """(bins,): which bins of the detector these are, those that are known at all wavelengths."""
    solid: Floats
    """(bins, 1) sr"""
    energy: Floats
    """(bins, W)"""
    error: Floats
    """(bins, W), standard errors, NaN if they are not known"""
    unit: Floats
    """(W,): variance per energy, what one count would carry."""
    background: Floats
    """(bins, W)"""
    blocks: NDArray[np.intp]
    """(bins,): which block of neighbours a bin belongs to; blocks disagree independently about a wrong model."""


class Observations(NamedTuple):
    """All that a model is fitted to."""

    order: str
    """The order of scattering."""
    incidences: tuple[tuple[float, float], ...]
    """(theta_i, phi_i), degrees."""
    wavelengths: Floats
    """nm."""
    channels: tuple[str, ...]
    """What the values at these wavelengths are called."""
    lobes: list[Lobe]
    """One for each incidence."""


def observations(
    measurement: Measurement, order: str, theta_i: Iterable[float] | None, wavelengths: Iterable[float] | None
) -> Observations:
    """What of a measurement is to be fitted; ValueError in one sentence if it is not there or not known."""
    data = measurement.dataset
    thetas = _chosen(data["theta_i"].values, theta_i, "theta_i", "degrees")
    chosen = _chosen(data["wavelength"].values, wavelengths, "wavelengths", "nm")
    picked = data.sel(order=order, wavelength=chosen)
    angles = [at for at in measurement.incidences() if at[0] in thetas]
    if not angles:
        raise ValueError("nothing was measured that could be fitted.")
    raw = []
    for theta, phi in angles:
        here = picked.sel(theta_i=theta, phi_i=phi)
        solid = measurement.detector.projected_solid_angles()[:, None]
        raw.append([here[name].values.reshape(-1, chosen.size) * solid for name in ("brdf", "brdf_standard_error")])
    detector, owner = joined(measurement.detector, [energy for energy, _ in raw])
    known = [bool(np.isfinite(summed(energy, owner, detector.bins)).all(axis=1).any()) for energy, _ in raw]
    if not any(known):
        raise ValueError("no bin is known at all of these wavelengths: fit them one at a time, with wavelengths.")
    angles, raw = list(itertools.compress(angles, known)), list(itertools.compress(raw, known))
    lobes = [
        _lobe(direction(*at), detector, owner, energy, error) for at, (energy, error) in zip(angles, raw, strict=True)
    ]
    if not any(lobe.energy.any() for lobe in lobes):
        raise ValueError(f"order {order!r} of the measurement holds no light: there is nothing to fit.")
    named = zip(measurement.channels, measurement.wavelengths, strict=True)
    channels = tuple(name for name, nm in named if nm in chosen)
    return Observations(order, tuple(angles), chosen, channels, lobes)


def _chosen(measured: Floats, wanted: Iterable[float] | None, name: str, unit: str) -> Floats:
    """Those of the `measured` values that are `wanted`."""
    if wanted is None:
        return measured
    values = np.array(list(wanted), np.float64)
    missing = [f"{value:g}" for value in values if not np.isclose(measured, value).any()]
    if missing or not values.size:
        there = ", ".join(f"{value:g}" for value in measured)
        raise ValueError(f"{name} = {', '.join(missing) or 'nothing'}: not measured; choose from {there} {unit}.")
    return measured[[bool(np.isclose(values, value).any()) for value in measured]]


def joined(detector: Detector, energies: Sequence[Floats]) -> tuple[Detector, NDArray[np.intp]]:
    """The widest bins that still show the lobes' shape, and which of them each bin of `detector` belongs to."""
    alone = np.arange(detector.bins)
    if not isinstance(detector, HemisphereGrid):
        return detector, alone
    powers = [power for energy in energies if np.nansum(power := energy.sum(axis=1)) > 0.0]
    for wider in _wider(detector):
        owner = detector.owners(wider)
        light = [np.bincount(owner, power, wider.bins).astype(np.float64) for power in powers]
        kept = all(np.nansum(p) >= _KEPT * np.nansum(power) for p, power in zip(light, powers, strict=True))
        if kept and min((_participation(p) for p in light), default=0.0) >= _ENOUGH_BINS:
            return wider, owner
    return detector, alone


def _participation(power: Floats) -> float:
    """How many bins share the light, those that are not known left out."""
    known = power[np.isfinite(power)]
    return float(known.sum() ** 2 / (known**2).sum())


def _wider(grid: HemisphereGrid) -> list[HemisphereGrid]:
    """Grids of whole bins of `grid`, the widest first."""
    factors = []
    for step, most, whole in ((grid.theta_step, _WIDEST[0], 90.0), (grid.phi_step, _WIDEST[1], 180.0)):
        odd = range(1, max(1, int(most / step)) + 1, 2)
        factors.append([f for f in odd if abs(whole / (f * step) - round(whole / (f * step))) < 1e-9][::-1])
    pairs = itertools.zip_longest(*factors)
    filled = [(a or 1, b or 1) for a, b in pairs]
    return [
        HemisphereGrid(theta_step=grid.theta_step * a, phi_step=grid.phi_step * b, spacing=grid.spacing)
        for a, b in filled
        if (a, b) != (1, 1)
    ]


def _lobe(wi: Vectors, detector: Detector, owner: NDArray[np.intp], energy: Floats, error: Floats) -> Lobe:
    energy = summed(energy, owner, detector.bins)
    kept = np.flatnonzero(np.isfinite(energy).all(axis=1))
    energy, variance = energy[kept], summed(error**2, owner, detector.bins)[kept]
    solid = detector.projected_solid_angles()[kept, None]
    total = np.maximum(energy.sum(axis=0), 1e-300)
    noise = variance.sum(axis=0) / total
    # Without noise all bins weigh as counts do, in units that leave the deviance a number of order 1.
    unit = np.where(noise > 0.0, noise, total / len(energy))
    background = _BACKGROUND * total * solid / solid.sum()
    return Lobe(wi, detector, kept, solid, energy, np.sqrt(variance), unit, background, _blocks(detector)[kept])


def summed(values: Floats, owner: NDArray[np.intp], bins: int) -> Floats:
    """Sums (bins, n) of the rows of `values` that belong to the same `owner`."""
    total = np.zeros((bins, values.shape[1]))
    np.add.at(total, owner, values)
    return total


def _blocks(detector: Detector) -> NDArray[np.intp]:
    """Blocks of 3 x 3 neighbouring bins; apertures stand alone."""
    if not isinstance(detector, HemisphereGrid):
        return np.arange(detector.bins)
    rings, sectors = detector.shape
    across = -(-sectors // 3)
    # The specular direction, in the middle of the sectors, is in the middle of a block.
    ring, sector = (np.arange(rings) + 1) // 3, ((np.arange(sectors) - sectors // 2 + 1) % sectors) // 3
    return np.asarray(ring[:, None] * across + sector).ravel()
