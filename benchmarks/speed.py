"""Paths per second against Embree alone and against renderers, side by side on one machine.

    .venv/bin/python benchmarks/speed.py [REPETITIONS]

The job: a 1024 x 1024 Gaussian height field in gold, or touching micro-cylinders, light from one direction, 3
wavelengths, bins of 1 degree, every bounce. Four programs take turns at it:

* gonio;
* embreex: the same instrument with every ray traced by Embree, as it is done for meshes;
* bare loop: only those rays asked of Embree again, from as many threads, and nothing done with the answers: what no
  program over embreex can undercut;
* Mitsuba 3, if it is installed: `mitsuba_goniometer.py`, an independent virtual goniometer in its llvm variant.

Radiance, if it is installed, measures all 145 Klems patches of light at once; it has a table of its own.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from bench import Times, in_turn, table

import gonio
import microsurfaces as ms

PATHS, MANY = 2_000_000, 16_000_000
REPETITIONS = 3
ALPHAS = (0.1, 0.3, 0.5, 1.0)
THETAS = (0.0, 45.0, 75.0)
WAVELENGTHS = (450.0, 550.0, 650.0)
GOLD = gonio.Conductor("Au")
FULL = 2_000
THREADS = os.cpu_count() or 1


def main(repetitions: int = REPETITIONS) -> str:
    """The tables of all surfaces, as Markdown."""
    rows, agreement = [], []
    for name, relief, theta in jobs():
        times, albedos, difference = compared(relief, theta, repetitions)
        rows.append([name, f"{theta:g}°", *cells(times)])
        agreement.append([name, f"{theta:g}°", *(albedo(values) for values in albedos), difference])
        print(" | ".join(map(str, rows[-1])), flush=True)
    programs = ["gonio", "embreex", "bare loop", "Mitsuba"]
    ratios = ["times embreex", "times the bare loop", "times Mitsuba"]
    return (
        f"{PATHS:,} paths, {THREADS} threads. Millions of paths per second, median of {repetitions} turns (lowest to "
        f"highest); ratios are medians turn by turn.\n\n{table(['surface', 'light', *programs, *ratios], rows)}\n"
        "Albedos at 450, 550, 650 nm, and the largest difference between gonio's and Mitsuba's lobes in bins of 5 x 15 "
        f"degrees with more than {FULL:,} hits, in combined standard errors of independent paths.\n\n"
        f"{table(['surface', 'light', 'gonio', 'embreex', 'Mitsuba', 'lobes'], agreement)}\n{many()}\n{radiance()}"
    )


def many(turns: int = 2) -> str:
    """gonio and Mitsuba over the same tiles with more paths, whose neighbours share more of what the caches hold."""
    rows = []
    for name, relief, theta in jobs():
        if not isinstance(relief, ms.HeightField) or not (peer := mitsuba(relief)):
            continue
        scene = gonio.Scene(relief, GOLD)
        goniometer = gonio.Goniometer(theta_i=(theta,), wavelengths=WAVELENGTHS, paths=MANY)
        programs = {
            "gonio": lambda g=goniometer, s=scene: g.measure(s, threads=THREADS),
            "Mitsuba": lambda p=peer, t=theta: p.measure(t, MANY, 1),
        }
        times = in_turn(programs, turns)
        ratio = times["gonio"].times_faster(times["Mitsuba"])
        rows.append([name, f"{theta:g}°", *(t.rate(MANY) for t in times.values()), f"**{ratio:.2f}**"])
        print(" | ".join(map(str, rows[-1])), flush=True)
    return f"The same with {MANY:,} paths.\n\n{table(['surface', 'light', 'gonio', 'Mitsuba', 'times Mitsuba'], rows)}"


def jobs() -> Iterator[tuple[str, ms.HeightField | ms.Mesh, float]]:
    """Name, relief and angle of incidence of every job."""
    for alpha in ALPHAS:
        relief = ms.Gaussian(alpha=alpha, samples=1024).build(1)
        yield from ((f"alpha = {alpha:g}", relief, theta) for theta in THETAS)
    for profile in ("ridges", "grooves"):
        relief = ms.Cylinders(profile=profile, distance=2.0).build(1)
        yield f"cylinders, {profile}", relief, 45.0


def compared(
    relief: ms.HeightField | ms.Mesh, theta: float, repetitions: int
) -> tuple[dict[str, Times], list[np.ndarray | None], str]:
    """Times by program, albedos of gonio, embreex and Mitsuba, and how far apart the lobes are."""
    field = isinstance(relief, ms.HeightField)
    traced = gonio.Scene(relief.mesh() if field else relief, GOLD)
    scene = gonio.Scene(relief, GOLD) if field else traced
    goniometer = gonio.Goniometer(theta_i=(theta,), wavelengths=WAVELENGTHS, paths=PATHS)
    queries = recorded(traced, lambda: goniometer.measure(traced, threads=THREADS))
    programs: dict[str, Callable[[], object]] = {"gonio": lambda: goniometer.measure(scene, threads=THREADS)}
    programs["embreex"] = lambda: goniometer.measure(traced, threads=THREADS)
    programs["bare loop"] = lambda: bare(traced, queries)
    peer = mitsuba(relief) if field else None
    if peer:
        programs["Mitsuba"] = lambda: peer.measure(theta, PATHS, 1)
    times = in_turn(programs, repetitions)
    ours = goniometer.measure(scene, threads=THREADS)
    albedos = [m.albedo()["albedo"].values.ravel() for m in (ours, goniometer.measure(traced, threads=THREADS))]
    if not peer:
        return times, [*albedos, None], "-"
    theirs = peer.measure(theta, PATHS, 2)
    return times, [*albedos, theirs.albedo], apart(ours, theirs)


def mitsuba(relief: ms.HeightField):  # type: ignore[no-untyped-def]
    """Mitsuba's goniometer over `relief`, or None where Mitsuba or LLVM is missing."""
    try:
        from mitsuba_goniometer import MitsubaGoniometer

        return MitsubaGoniometer(relief, GOLD.refractive_index(np.array(WAVELENGTHS)))
    except (ImportError, RuntimeError) as error:
        print(f"Without Mitsuba: {error}", file=sys.stderr)
        return None


def apart(ours: gonio.Measurement, theirs) -> str:  # type: ignore[no-untyped-def]
    """The largest score of a wide bin between both lobes, over all orders and wavelengths."""
    grid, wide = gonio.HemisphereGrid(), gonio.HemisphereGrid(theta_step=5, phi_step=15)
    owners = grid.owners(wide)
    data = ours.dataset.sel(order="all").isel(theta_i=0, phi_i=0)
    solid_angles = grid.projected_solid_angles()[:, None]

    def pooled(bins: np.ndarray) -> np.ndarray:
        """Sums over the wide bins, (wide bins, columns)."""
        return np.stack([np.bincount(owners, column, wide.bins) for column in bins.T], axis=-1)

    light = pooled(data["brdf"].values.reshape(-1, len(WAVELENGTHS)) * solid_angles)
    hits = pooled(data["count"].values.reshape(-1, 1))
    their_light = pooled(theirs.brdf.sum(axis=0) * solid_angles)
    their_hits = pooled(theirs.hits.sum(axis=0).reshape(-1, 1))
    full = ((hits > FULL) & (their_hits > FULL)).ravel()
    error = np.sqrt(light**2 / hits.clip(1) + their_light**2 / their_hits.clip(1))[full]
    return f"{np.abs((light - their_light)[full] / error).max():.1f} in {full.sum()} bins"


def recorded(scene: gonio.Scene, job: Callable[[], object]) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Copies of everything that `job` asks `scene` for."""
    queries = []
    traced = scene.geometry.traced
    ask = traced.intersect

    def record(origins: np.ndarray, directions: np.ndarray, reach: np.ndarray) -> dict[str, np.ndarray]:
        queries.append((origins.copy(), directions.copy(), reach.copy()))
        return ask(origins, directions, reach)

    traced.intersect = record  # type: ignore[method-assign]
    try:
        job()
    finally:
        traced.intersect = ask  # type: ignore[method-assign]
    return queries


def bare(scene: gonio.Scene, queries: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
    """Ask for all of it again."""
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(lambda query: scene.geometry.traced.intersect(*query) and None, queries))


def cells(times: dict[str, Times]) -> list[str]:
    """Rates of all programs and the ratios of gonio to the others."""
    names = ("gonio", "embreex", "bare loop", "Mitsuba")
    rates = [times[name].rate(PATHS) if name in times else "-" for name in names]
    return rates + [
        f"**{times['gonio'].times_faster(times[name]):.2f}**" if name in times else "-" for name in names[1:]
    ]


def albedo(values: np.ndarray | None) -> str:
    """Three numbers, or a dash."""
    return "-" if values is None else ", ".join(f"{value:.5f}" for value in values)


def radiance(samples: int = 10_000) -> str:
    """Radiance's genBSDF over the same tile as a lossless mirror, against gonio at as many directions."""
    try:
        from radiance_goniometer import RadianceGoniometer

        relief = ms.Gaussian(alpha=0.3, samples=1024).build(1)
        peer = RadianceGoniometer(relief, reflectance=0.9)
    except ImportError as error:
        return f"Radiance: {error}\n"
    result = peer.measure(samples)
    patch, theta = 0, 0.0
    goniometer = gonio.Goniometer(theta_i=(theta,), paths=1_000_000, orders=8, wavelengths=(550.0,))
    orders = goniometer.measure(gonio.Scene(relief, gonio.Mirror())).dataset["albedo"].values.ravel()[1:]
    expected = float(np.sum(orders * 0.9 ** np.arange(1, len(orders) + 1)))
    return (
        f"Radiance's genBSDF, alpha = 0.3, mirror of reflectance 0.9, all 145 Klems patches of light: "
        f"{result.paths / result.seconds / 1e6:.3f} million paths per second; albedo of the patch about the normal "
        f"{result.albedo[patch]:.4f}, gonio's at 0° {expected:.4f}.\n"
    )


if __name__ == "__main__":
    print(main(*map(int, sys.argv[1:])))
