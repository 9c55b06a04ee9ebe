"""What the benchmarks have in common: jobs timed in turn, tables, and what machine this is."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

PACKAGES = ("gonio", "numpy", "numba", "embreex", "mitsuba", "drjit", "pyradiance")


class Times(NamedTuple):
    """Seconds of the repetitions of one job, in the order in which they ran."""

    seconds: list[float]

    @property
    def median(self) -> float:
        """The one in the middle."""
        return statistics.median(self.seconds)

    def rate(self, count: float) -> str:
        """`count` per second in millions: median (lowest to highest)."""
        low, middle, high = (count / t / 1e6 for t in (max(self.seconds), self.median, min(self.seconds)))
        return f"{middle:.2f} ({low:.2f}-{high:.2f})"

    def times_faster(self, other: Times) -> float:
        """How many times as fast as `other`: the median of the ratios turn by turn."""
        return statistics.median(b / a for a, b in zip(self.seconds, other.seconds, strict=True))


def timed(job: Callable[[], object]) -> float:
    """Seconds that `job` takes."""
    started = time.perf_counter()
    job()
    return time.perf_counter() - started


def in_turn(jobs: Mapping[str, Callable[[], object]], repetitions: int) -> dict[str, Times]:
    """Times of jobs that take turns, after one turn that is not counted: so a machine that slows down slows all."""
    for job in jobs.values():
        job()
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(repetitions):
        for name, job in jobs.items():
            seconds[name].append(timed(job))
    return {name: Times(values) for name, values in seconds.items()}


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def machine() -> str:
    """Processor, cores, system and versions, one line each."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), model)
    except OSError:
        pass
    versions = []
    for package in PACKAGES:
        try:
            versions.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            versions.append(f"{package} not installed")
    return (
        f"- {model}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}, Python "
        f"{platform.python_version()}\n- {', '.join(versions)}\n"
    )
