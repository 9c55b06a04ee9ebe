"""What the time buys: error bars against independent random starts, and one full data set.

.venv/bin/python benchmarks/accuracy.py
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from bench import table, timed

import gonio
import microsurfaces as ms

GOLD = gonio.Conductor("Au")
PATHS = 1_048_576
THETAS = (0.0, 45.0, 75.0)


def main() -> str:
    """Both parts, as Markdown."""
    return f"{starts()}\n{data_set()}"


def starts() -> str:
    """Errors and times of stratified starts against those of independent ones, by alpha in turn."""
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        for alpha in (0.1, 0.3, 0.5, 1.0):
            stratified, independent = (in_process(kind, alpha, cache) for kind in ("stratified", "independent"))
            for theta, ours, theirs in zip(THETAS, stratified, independent, strict=True):
                slower, albedo, bins = (theirs[key] / ours[key] for key in ("seconds", "albedo", "bin"))
                gains = (albedo, bins, slower, albedo * slower**0.5, bins * slower**0.5)
                rows.append([f"{alpha:g}", f"{theta:g}°", *(f"{gain:.2f}" for gain in gains)])
                print(" | ".join(rows[-1]), flush=True)
    head = ["alpha", "light", "albedo", "median bin of 1°", "time", "albedo x √time", "median bin x √time"]
    return (
        f"Independent random starts over stratified ones along a Morton curve, {PATHS:,} paths: standard errors, time, "
        f"and error x √time. Above 1 the stratified are better.\n\n{table(head, rows)}"
    )


def in_process(kind: str, alpha: float, cache: str) -> list[dict[str, float]]:
    """`figures` of a process of its own; kernels that start elsewhere are compiled into a cache of their own."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(Path(cache) / kind)}
    words = [sys.executable, __file__, kind, str(alpha)]
    return json.loads(subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout)


def start_anywhere() -> None:
    """Make every path start at random on the whole tile, before the kernels are compiled."""
    from numba import uint64

    from gonio import paths
    from gonio.randomness import kernel, uniform

    apart = paths.every_second_bit

    @kernel
    def start(path, count, word):  # type: ignore[no-untyped-def]
        """A place of the Morton curve, whatever the number of the path."""
        place = uint64(uniform(word) * 2.0**52)
        return (apart(place) + 0.5) * 2.0**-26, (apart(place >> uint64(1)) + 0.5) * 2.0**-26

    paths.start = start


def figures(alpha: float) -> list[dict[str, float]]:
    """Seconds, and Monte Carlo standard errors of the albedo and of the median bin, per angle of incidence."""
    results = []
    scene = gonio.Scene(ms.Gaussian(alpha=alpha, samples=1024).build(1), GOLD)
    for theta in THETAS:
        settings = {"theta_i": (theta,), "wavelengths": (550.0,), "paths": PATHS}
        timing = gonio.Goniometer(**settings)
        # 128 replicates know an error to 6 %, four runs of them to 3 %.
        runs = [gonio.Goniometer(replicates=128, **settings).measure(scene, seed=seed) for seed in range(4)]
        bins = [run.dataset.sel(order="all").squeeze() for run in runs]
        full = bins[0]["count"].values > 20
        results.append({
            "seconds": min(timed(lambda t=timing: t.measure(scene)) for _ in range(5)),
            "albedo": float(np.mean([error(run) ** 2 for run in runs]) ** 0.5),
            "bin": float(
                np.median(np.mean([b["brdf_standard_error_mc"].values[full] ** 2 for b in bins], axis=0) ** 0.5)
            ),
        })  # fmt: skip
    return results


def error(measurement: gonio.Measurement) -> float:
    """Monte Carlo standard error of the albedo."""
    return float(measurement.dataset["albedo_standard_error_mc"].sel(order="all").item())


def data_set(target: float = 0.02) -> str:
    """An isotropic data set, 19 incidences by 1 degree by 3 wavelengths, to a median error of 2 % a bin."""
    started = time.perf_counter()
    scene = gonio.Scene(ms.Gaussian(alpha=0.3, samples=1024).build(1), GOLD)
    paths = 80_000_000
    goniometer = gonio.Goniometer(
        theta_i=(*np.arange(0.0, 90.0, 5.0).tolist(), 87.0), wavelengths=(450.0, 550.0, 650.0), paths=paths,
        azimuth="average",
    )  # fmt: skip
    data = goniometer.measure(scene).dataset.sel(order="all")
    seconds = time.perf_counter() - started
    bright = data["brdf"] > 0.01 * data["brdf"].max(("theta_o", "dphi"))
    errors = (data["brdf_standard_error_mc"] / data["brdf"]).where(bright)
    each = errors.median(("theta_o", "dphi", "phi_i")).max("wavelength").values
    return (
        f"One isotropic data set: alpha = 0.3, 1024² nodes, 19 incidences, 1° bins, 3 wavelengths, averaged over "
        f"azimuth, {paths:,} paths an incidence: **{seconds:.0f} s**, surface and set-up included. Median relative "
        f"Monte Carlo error of the bins above 1 % of the peak: {float(errors.median()):.2%} over all, {each.max():.2%} "
        f"at the worst incidence (wanted: below {target:.0%}).\n"
    )


if __name__ == "__main__":
    if len(sys.argv) == 3:
        if sys.argv[1] == "independent":
            start_anywhere()
        print(json.dumps(figures(float(sys.argv[2]))))
    else:
        print(main())
