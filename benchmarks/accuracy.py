"""What the time buys: error bars against independent random starts, and one full data set.

.venv/bin/python benchmarks/accuracy.py
"""

from __future__ import annotations

import time

import numpy as np
from bench import table

import gonio
import microsurfaces as ms

GOLD = gonio.Conductor("Au")


def main() -> str:
    """Both parts, as Markdown."""
    return f"{starts()}\n{data_set()}"


def starts(paths: int = 1_048_576) -> str:
    """Errors of stratified starts against those of as many independent ones.

    Replicates of a single path start anywhere: the scatter of 1024 of them is that of independent starts, which falls
    with the root of their number. For bins it is the noise of counting.
    """
    rows = []
    for alpha in (0.1, 0.3, 0.5, 1.0):
        scene = gonio.Scene(ms.Gaussian(alpha=alpha, samples=1024).build(1), GOLD)
        for theta in (0.0, 45.0, 75.0):
            settings = {"theta_i": (theta,), "wavelengths": (550.0,)}
            # Errors of errors: a chi-squared of 1000 degrees of freedom, and the mean of some runs of 128 replicates.
            single = gonio.Goniometer(paths=1024, replicates=1024, **settings)
            alone = np.mean([error(single.measure(scene, seed=s)) for s in range(4)]) * np.sqrt(1024 / paths)
            whole = gonio.Goniometer(paths=paths, replicates=128, **settings).measure(scene, seed=1)
            bins = whole.dataset.sel(order="all").squeeze()
            full = (bins["hits"] > 100).values
            counted = (bins["brdf"] / np.sqrt(bins["hits"])).values[full]
            # At gold's 550 nm weights hardly differ, so that counting is their noise.
            gain = np.median(counted / bins["standard_error_mc"].values[full])
            rows.append([f"{alpha:g}", f"{theta:g}°", f"{alone / error(whole):.2f}", f"{gain:.2f}"])
    return (
        f"Standard errors of {paths:,} independent random starts over those of as many stratified ones (128 "
        "replicates); above 1 the stratified are better, in the same number of paths.\n\n"
        f"{table(['alpha', 'light', 'albedo', 'median bin of 1°'], rows)}"
    )


def error(measurement: gonio.Measurement) -> float:
    """Monte Carlo standard error of the albedo."""
    return float(measurement.dataset["albedo_standard_error_mc"].sel(order="all").item())


def data_set(target: float = 0.02) -> str:
    """An isotropic data set, 19 incidences by 1 degree by 3 wavelengths, to a median error of 2 % a bin."""
    started = time.perf_counter()
    scene = gonio.Scene(ms.Gaussian(alpha=0.3, samples=1024).build(1), GOLD)
    paths = 64_000_000
    goniometer = gonio.Goniometer(
        theta_i=(*np.arange(0.0, 90.0, 5.0).tolist(), 87.0), wavelengths=(450.0, 550.0, 650.0), paths=paths,
        azimuth="average",
    )  # fmt: skip
    data = goniometer.measure(scene).dataset.sel(order="all")
    seconds = time.perf_counter() - started
    bright = data["brdf"] > 0.01 * data["brdf"].max(("theta_o", "dphi"))
    errors = (data["standard_error_mc"] / data["brdf"]).where(bright)
    each = errors.median(("theta_o", "dphi", "phi_i")).max("wavelength").values
    return (
        f"One isotropic data set: alpha = 0.3, 1024² nodes, 19 incidences, 1° bins, 3 wavelengths, averaged over "
        f"azimuth, {paths:,} paths an incidence: **{seconds:.0f} s**, surface and set-up included. Median relative "
        f"Monte Carlo error of the bins above 1 % of the peak: {float(errors.median()):.2%} over all, {each.max():.2%} "
        f"at the worst incidence (wanted: below {target:.0%}).\n"
    )


if __name__ == "__main__":
    print(main())
