"""How fast the instrument is, against a bare embreex loop over the very same rays, in one run.

    make bench

The job: a 1024 x 1024 Gaussian height field of alpha 0.3 in gold at 45 degrees, 3 wavelengths, 1 degree bins. First
the rays that the instrument asks Embree for are recorded; then both take turns: the whole measurement, and the least
that any program over embreex can do, which is to ask for those hits again from the same number of threads and do
nothing with the answers.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import gonio
import microsurfaces as ms

PATHS = 2_000_000
REPETITIONS = 7


def main() -> None:
    """Time both and print a table."""
    threads = os.cpu_count() or 1
    started = time.perf_counter()
    scene = gonio.Scene(ms.Gaussian(alpha=0.3, samples=1024).build(1), gonio.Conductor("Au"))
    built = time.perf_counter()
    goniometer = gonio.Goniometer(theta_i=(45,), wavelengths=(450, 550, 650), paths=PATHS)
    goniometer.measure(scene, threads=threads)
    print(f"surface and acceleration structure {built - started:.2f} s; first measurement, compilation included, "
          f"{time.perf_counter() - built:.2f} s")  # fmt: skip

    queries = recorded(scene, lambda: goniometer.measure(scene, threads=threads))
    rays = sum(len(origins) for origins, _, _ in queries)

    def bare() -> None:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(lambda query: scene.intersect(*query), queries))

    jobs = {"gonio": lambda: goniometer.measure(scene, threads=threads), "bare embreex": bare}
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(REPETITIONS):
        for name, job in jobs.items():
            seconds[name].append(timed(job))
    print(f"\n{PATHS:,} paths, {rays / PATHS:.2f} rays a path, {threads} threads, {REPETITIONS} repetitions in turn\n")
    print("| | M paths/s, median (lowest to highest) | M rays/s |")
    print("|---|---|---|")
    for name, times in seconds.items():
        low, middle, high = (PATHS / t / 1e6 for t in (max(times), statistics.median(times), min(times)))
        print(f"| {name} | {middle:.2f} ({low:.2f} to {high:.2f}) | {middle * rays / PATHS:.2f} |")
    ratios = [b / g for g, b in zip(seconds["gonio"], seconds["bare embreex"], strict=True)]
    print(f"\ngonio reaches {statistics.median(ratios):.0%} of the bare loop's paths/s "
          f"(pair by pair {min(ratios):.0%} to {max(ratios):.0%})")  # fmt: skip


def recorded(scene: gonio.Scene, job: Callable[[], object]) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Copies of everything that `job` asks `scene` for."""
    queries = []
    ask = scene.intersect

    def record(origins: np.ndarray, directions: np.ndarray, reach: np.ndarray) -> dict[str, np.ndarray]:
        queries.append((origins.copy(), directions.copy(), reach.copy()))
        return ask(origins, directions, reach)

    scene.intersect = record  # type: ignore[method-assign]
    try:
        job()
    finally:
        scene.intersect = ask  # type: ignore[method-assign]
    return queries


def timed(job: Callable[[], object]) -> float:
    """Seconds that `job` takes."""
    started = time.perf_counter()
    job()
    return time.perf_counter() - started


if __name__ == "__main__":
    main()
