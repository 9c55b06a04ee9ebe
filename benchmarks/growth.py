"""How time and memory grow: with the size of the surface, threads, wavelengths, incidences; and where the time goes.

.venv/bin/python benchmarks/growth.py
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench import in_turn, table, timed

import gonio
import microsurfaces as ms

ALPHA, THETA, PATHS, MANY, REPETITIONS = 0.3, 45.0, 2_000_000, 16_000_000, 3
SIZES = (256, 1024, 4096)
GOLD = gonio.Conductor("Au")
TOY = """
title = "Toy"
[surface]
kind = "Gaussian"
alpha = 0.3
side = 100.0
samples = 128
[material]
kind = "Conductor"
name = "Au"
[goniometer]
theta_i = [0.0, 45.0]
paths = 100_000
[goniometer.detector]
kind = "HemisphereGrid"
theta_step = 5.0
phi_step = 15.0
"""


def main() -> str:
    """All tables, as Markdown."""
    parts = [sizes(), threads(), wavelengths(), incidences(), command()]
    return "\n".join(parts)


def surface(samples: int) -> ms.Gaussian:
    """A tile of that many nodes a side, always as rough for its spacing."""
    return ms.Gaussian(alpha=ALPHA, samples=samples, side=600.0 * samples / 1024)


def goniometer(**changes: object) -> gonio.Goniometer:
    """The instrument that everything is compared with."""
    return gonio.Goniometer(**{"theta_i": (THETA,), "wavelengths": (450.0, 550.0, 650.0), "paths": PATHS, **changes})


def sizes() -> str:
    """Every size in a process of its own, for the sake of its memory; Embree's set-up in another."""
    rows = []
    for samples in SIZES:
        ours, embree = (in_process(samples, kind) for kind in ("grid", "embree"))
        rows.append(
            [
                f"{samples}²",
                *(f"{ours[stage]:.2f}" for stage in ("surface", "set-up")),
                f"{embree['set-up']:.1f}",
                f"{ours['ns']:.0f}",
                *(f"{ours[stage]:.2f}" for stage in ("describe", "save")),
                f"{ours['GiB']:.2f}",
                f"{embree['GiB']:.2f}",
            ]
        )
        print(" | ".join(rows[-1]), flush=True)
    head = [
        "nodes", "surface, s", "set-up, s", "of that by `TriangleMesh`, s", "ns a path", "statistics, s", "save, s",
        "peak, GiB", "peak with `TriangleMesh`, GiB",
    ]  # fmt: skip
    return (
        f"alpha = {ALPHA}, {THETA:g}°, {PATHS:,} paths, warm. The set-up of gonio are the tables of the grid; that "
        f"of plain embreex a scene with one `TriangleMesh` of the same triangles.\n\n{table(head, rows)}"
    )


def in_process(samples: int, kind: str) -> dict[str, float]:
    """What one size costs, by stage, measured in a fresh process."""
    answer = subprocess.run([sys.executable, __file__, kind, str(samples)], capture_output=True, text=True, check=True)
    return json.loads(answer.stdout)


def one_size(kind: str, samples: int) -> dict[str, float]:
    """Seconds by stage, nanoseconds a path, and the peak of memory."""
    import numpy as np

    stages = {}
    # Compiled kernels and imported packages are not what is measured.
    gonio.Scene(surface(128).build(1), GOLD)
    started = time.perf_counter()
    relief = surface(samples).build(1)
    stages["surface"] = time.perf_counter() - started
    if kind == "embree":
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore import EmbreeDevice
        from embreex.rtcore_scene import EmbreeScene

        mesh = relief.mesh()
        vertices, faces = mesh.vertices.astype(np.float32), mesh.faces
        started = time.perf_counter()
        scene = EmbreeScene(EmbreeDevice(), robust=True)
        kept = TriangleMesh(scene, vertices, faces)
        scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
        stages["set-up"] = time.perf_counter() - started
        del kept
    else:
        started = time.perf_counter()
        scene = gonio.Scene(relief, GOLD)
        stages["set-up"] = time.perf_counter() - started
        stages["describe"] = timed(lambda: (relief.statistics(), relief.facets))
        instrument = goniometer()
        instrument.measure(scene)
        stages["ns"] = min(timed(lambda: instrument.measure(scene)) for _ in range(3)) / PATHS * 1e9
        with tempfile.TemporaryDirectory() as folder:
            measurement = instrument.measure(scene)
            stages["save"] = timed(lambda: gonio.save(measurement, Path(folder) / "m.nc"))
    stages["GiB"] = peak()
    return stages


def peak() -> float:
    """The most memory that this process ever had, GiB; what its parent had does not count, as it does for getrusage."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))) / 2**20


def compare(name: str, instruments: dict[str, tuple[gonio.Goniometer, int]], unit: str) -> str:
    """A table of measurements that take turns, relative to the first."""
    scene = gonio.Scene(surface(1024).build(1), GOLD)
    jobs = {
        label: lambda instrument=instrument, cores=cores: instrument.measure(scene, threads=cores)
        for label, (instrument, cores) in instruments.items()
    }
    times = in_turn(jobs, REPETITIONS)
    first = next(iter(times.values()))
    rows = [
        [label, f"{t.median:.3f} ({min(t.seconds):.3f}-{max(t.seconds):.3f})", f"{1 / t.times_faster(first):.2f}"]
        for label, t in times.items()
    ]
    print(name, rows, flush=True)
    return f"{table([unit, 'seconds, median (lowest-highest)', 'times the first'], rows)}"


def threads() -> str:
    """One thread and two."""
    instrument = goniometer(paths=MANY)
    return f"{MANY:,} paths.\n\n" + compare("threads", {str(n): (instrument, n) for n in (1, 2)}, "threads")


def wavelengths() -> str:
    """3 wavelengths first, what the others are compared with."""
    cores = os.cpu_count() or 1
    spectra = {n: tuple(400.0 + 300.0 * k / max(n - 1, 1) for k in range(n)) for n in (3, 1, 31, 81)}
    tables = [f"{paths:,} paths.\n\n" + compare(
        "wavelengths",
        {str(n): (goniometer(wavelengths=w, paths=paths), cores) for n, w in spectra.items()},
        "wavelengths",
    ) for paths in (PATHS, MANY)]  # fmt: skip
    return "\n".join(tables)


def incidences() -> str:
    """The surface and its set-up belong to the job here: once, however many incidences."""
    relief = surface(1024)
    sources = {n: tuple(float(90 // n * k) for k in range(n)) for n in (1, 10, 90)}

    def job(thetas: tuple[float, ...]) -> None:
        goniometer(theta_i=thetas, paths=1_000_000, detector=gonio.HemisphereGrid(1.0, 1.0)).measure(
            gonio.Scene(relief.build(1), GOLD)
        )

    times = in_turn({str(n): lambda thetas=thetas: job(thetas) for n, thetas in sources.items()}, 2)
    mean = in_turn({"mean": lambda: [job((t,)) for t in (0.0, 30.0, 60.0, 80.0)]}, 2)["mean"].median / 4
    rows = [[n, f"{t.median:.2f}", f"{t.median / mean:.1f}"] for n, t in times.items()]
    return (
        f"1,000,000 paths an incidence, surface and set-up included. One incidence alone takes {mean:.2f} s, mean of "
        f"0°, 30°, 60°, 80°.\n\n{table(['incidences', 'seconds', 'times that'], rows)}"
    )


def command() -> str:
    """`gonio run` on a toy: cold, that is with kernels to compile, warm, and with pictures."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "toy.toml").write_text(TOY)

        def run(*options: str, cache: Path | None = None) -> float:
            environment = {**os.environ, **({"NUMBA_CACHE_DIR": str(cache)} if cache else {})}
            words = [sys.executable, "-m", "gonio", "run", "toy.toml", "--quiet", "-o", "out", *options]
            return timed(lambda: subprocess.run(words, cwd=folder, env=environment, check=True))

        rows.append(["nothing compiled yet, no pictures", f"{run('--no-pictures', cache=folder / 'cache'):.1f}"])
        run()
        warm = sorted(run("--no-pictures") for _ in range(5))
        drawn = sorted(run() for _ in range(3))
        help_ = sorted(timed(lambda: subprocess.run([sys.executable, "-m", "gonio", "--help"], capture_output=True))
                       for _ in range(3))  # fmt: skip
    rows += [
        ["warm, no pictures", f"{warm[2]:.2f} ({warm[0]:.2f}-{warm[-1]:.2f})"],
        ["warm, with pictures", f"{drawn[1]:.2f} ({drawn[0]:.2f}-{drawn[-1]:.2f})"],
        ["`gonio --help`", f"{help_[1]:.2f}"],
        *([f"of the warm run: {stage}", f"{seconds:.2f}"] for stage, seconds in stages().items()),
    ]
    print(rows, flush=True)
    about = "`gonio run` on a toy: 128² nodes, 2 incidences, 100,000 paths, bins of 5 x 15°."
    return f"{about}\n\n{table(['', 'seconds'], rows)}"


def stages() -> dict[str, float]:
    """Where a warm run without pictures spends its time."""
    script = """
import json, time
marks = [time.perf_counter()]
import gonio, gonio.self_check, gonio.experiment, gonio.cli
gonio.Experiment, gonio.save, gonio.Scene, gonio.Goniometer
import xarray, h5netcdf
marks.append(time.perf_counter())
experiment = gonio.Experiment.read("toy.toml")
relief = experiment.surface.build(1)
scene = gonio.Scene(relief, experiment.material)
marks.append(time.perf_counter())
experiment.goniometer.measure(scene)
marks.append(time.perf_counter())
measurement = experiment.run()
marks.append(time.perf_counter())
gonio.save(measurement, "m.nc")
marks.append(time.perf_counter())
print(json.dumps([b - a for a, b in zip(marks, marks[1:])]))
"""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "toy.toml").write_text(TOY)
        answer = subprocess.run([sys.executable, "-c", script], cwd=folder, capture_output=True, text=True, check=True)
    imports, built, first, whole, saved = json.loads(answer.stdout)
    return {
        "imports": imports,
        "surface and set-up, kernels loaded": built,
        "first measurement, kernels loaded": first,
        "measurement again, self-check": whole,
        "save": saved,
    }


if __name__ == "__main__":
    if len(sys.argv) == 3:
        print(json.dumps(one_size(sys.argv[1], int(sys.argv[2]))))
    else:
        print(main())
