"""What campaigns cost beyond tracing: per unit of work, with two workers, for the status of many units, in memory."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from bench import in_turn, table, timed

import gonio
import microsurfaces as ms
from gonio.campaign import running
from gonio.campaign.processes import ProcessPool
from gonio.campaign.store import CampaignStore
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan
from gonio.experiment import Experiment

UNITS = 300
MANY = 10_000
REPETITIONS = 5

FINE = gonio.HemisphereGrid(theta_step=2.0, phi_step=3.0)
SMALL = gonio.Goniometer(theta_i=(0.0, 30.0, 60.0), paths=16, replicates=4, detector=FINE)
PLAIN = ms.Gaussian(alpha=0.3, side=100.0, samples=32)
INCIDENCES = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 80.0, 85.0)
HEAVY = Experiment(
    ms.Gaussian(alpha=0.5, side=300.0, samples=512),
    gonio.Conductor("Au"),
    replace(SMALL, theta_i=INCIDENCES, paths=2_000_000, detector=gonio.HemisphereGrid()),
    realisations=6,
)
"""48 units of about a second."""

RUN = """
import resource, sys
from pathlib import Path
from gonio.campaign import running
from gonio.campaign.processes import ProcessPool
from gonio.campaign.sweep import Campaign
if __name__ == "__main__":
    running.run(Campaign.read(sys.argv[1]), sys.argv[2], ProcessPool(2))
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""
SWEPT = """
[experiment.surface]
kind = "Gaussian"
alpha = 0.3
side = 100.0
samples = 32
[experiment.material]
kind = "Mirror"
[experiment.goniometer]
theta_i = [0.0]
paths = 16
replicates = 4
[sweep]
seed = {{start = 1, stop = {units}, step = 1}}
"""


def main() -> str:
    """A Markdown table."""
    rows = [_overhead(), _workers(), _status(), *_memory()]
    return table(("quantity", "measured", "how"), rows)


@contextlib.contextmanager
def _folder():
    with tempfile.TemporaryDirectory() as scratch:
        yield Path(scratch) / "campaign"


def _overhead() -> tuple[str, str, str]:
    """Small units in a campaign against the same measurements without one."""
    campaign = Campaign.of([Experiment(PLAIN, gonio.Mirror(), SMALL, seed=seed) for seed in range(UNITS // 3)])

    def run() -> None:
        with _folder() as folder:
            running.run(campaign, folder)

    def measure() -> None:
        for experiment in campaign.experiments:
            experiment.goniometer.measure(experiment.scene(), experiment.light_seed())

    times = in_turn({"campaign": run, "measure": measure}, REPETITIONS)
    extra = (times["campaign"].median - times["measure"].median) / UNITS
    how = f"{UNITS} units of 16 paths, 2° x 3° bins, less the same by Goniometer.measure"
    return "overhead of a unit", f"{1000 * extra:.0f} ms", how


def _workers() -> tuple[str, str, str]:
    """The same work with one worker and with two, each with one thread."""
    campaign = Campaign.of([HEAVY])

    def run(workers: int) -> None:
        with _folder() as folder:
            running.run(campaign, folder, ProcessPool(workers, threads=1))

    times = in_turn({"two": lambda: run(2), "one": lambda: run(1)}, 3)
    ratio = times["two"].times_faster(times["one"])
    units = len(Plan.of(campaign).shard(1, 1))
    how = f"{units} units of 2 M paths, {times['one'].median:.0f} s with one, starts included"
    return "2 workers against 1", f"{ratio:.2f} x as fast", how


def _status() -> tuple[str, str, str]:
    """`gonio campaign status` of many units, a process of its own."""
    grids = replace(SMALL, theta_i=(0.0,), phi_i=tuple(7.2 * k for k in range(50)))
    campaign = Campaign.of([Experiment(PLAIN, gonio.Mirror(), grids, seed=seed, realisations=10) for seed in range(20)])
    with _folder() as folder:
        plan, store = Plan.of(campaign), CampaignStore(folder)
        store.create(plan.manifest())
        for unit in plan.shard(1, 1)[: 7 * MANY // 10]:
            (store.units / f"{unit.name}.npz").touch()
        command = [sys.executable, "-m", "gonio", "campaign", "status", str(folder)]
        seconds = sorted(timed(lambda: subprocess.run(command, check=True, capture_output=True)) for _ in range(5))
    return f"status of {MANY:,} units", f"{seconds[2]:.2f} s", "gonio campaign status, start of Python included"


def _memory() -> list[tuple[str, str, str]]:
    """Peak memory of the process that coordinates two workers."""
    rows = []
    for units in (100, 1000):
        with _folder() as folder:
            folder.parent.mkdir(exist_ok=True)
            file = folder.with_suffix(".toml")
            file.write_text(SWEPT.format(units=units))
            script = folder.with_suffix(".py")
            script.write_text(RUN)
            started = time.monotonic()
            done = subprocess.run(
                [sys.executable, str(script), str(file), str(folder)], check=True, capture_output=True, text=True
            )
            seconds = time.monotonic() - started
        peak = int(done.stdout) / 2**20
        rows.append((f"memory of the coordinator, {units} units", f"{peak:.0f} MiB", f"two workers, {seconds:.0f} s"))
    return rows


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    print(main())
