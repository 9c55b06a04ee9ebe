"""The instrument: which directions, wavelengths and how many paths; `measure` turns a scene into a Measurement."""

from __future__ import annotations

import hashlib
import importlib.metadata
import itertools
import json
import math
import os
import platform
import struct
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter, model_validator

from gonio.detectors import Detector, HemisphereGrid, Klems
from gonio.measurement import ENERGY_BUDGET, Measurement, orders
from gonio.tally import MAX_PATHS, UNIT, Tally, UInt128
from gonio.transport import trace
from gonio.transport.light import surface_optics
from gonio.transport.scene import Scene
from gonio.transport.scoring import Scores, bins_of
from gonio.transport.setup import Setup
from gonio.transport.source import Source
from gonio.transport.termination import ABSORBED, LOST, TRUNCATED
from microsurfaces.recipe import NonNegative, Positive, recipe

Progress = Callable[[int, int, int], None]
"""Called a few times a second with (paths done, paths in all, rays traced)."""

_TICK = 0.1

GROUP_BYTES = 192 << 20
"""What the bins of the replicates that one thread traces side by side may take; one replicate always may."""


@recipe
class Goniometer:
    """A source, a sample holder and a detector: light from every (theta_i, phi_i), collected in the detector's bins.

    Every incidence is measured with `replicates` independent randomised replicates of equal size; their scatter is the
    error bar. `measure` returns the same bytes for the same seed whatever the number of threads.
    """

    theta_i: Annotated[tuple[Annotated[float, Field(ge=0, lt=90)], ...], Field(min_length=1)] = (0.0,)
    """Polar angles of the light, degrees, 0 to below 90, increasing."""
    phi_i: Annotated[tuple[Annotated[float, Field(ge=0, lt=360)], ...], Field(min_length=1)] = (0.0,)
    """Azimuths of the light, degrees, 0 to below 360, increasing."""
    wavelengths: Annotated[tuple[Positive, ...], Field(min_length=1)] = (450.0, 550.0, 650.0)
    """Wavelengths in vacuum, nm, increasing."""
    paths: Annotated[int, Field(ge=1, le=MAX_PATHS)] = 1_000_000
    """Light paths per incidence and realisation, rounded up to whole replicates."""
    target_error: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Stop criterion: more replicates, beyond `paths`, until half of the reflected light leaves through bins whose
    relative Monte Carlo standard error is below this."""
    detector: Detector = HemisphereGrid()
    """Where the light is collected."""
    azimuth: Literal["fixed", "average"] = "fixed"
    """"average" turns the surface by another angle for every path: the isotropic average of any surface."""
    beam_half_angle: NonNegative = 0.0
    """Half the angle that the source subtends at the sample, degrees; 0 is a collimated beam."""
    replicates: Annotated[int, Field(ge=2, le=1024)] = 16
    """Independent replicates that the error bars come from."""
    orders: Annotated[int, Field(ge=2, le=1000)] = 3
    """Numbers of surface hits that are kept apart: 1, 2, and so on; the last holds all beyond as well."""

    @model_validator(mode="after")
    def _directions_make_sense(self) -> Goniometer:
        for name in ("theta_i", "phi_i", "wavelengths"):
            values = getattr(self, name)
            if any(b <= a for a, b in itertools.pairwise(values)):
                raise ValueError(f"{name} = {list(values)} must increase from each value to the next")
        if isinstance(self.detector, Klems) and (self.theta_i, self.phi_i, self.beam_half_angle) != ((0,), (0,), 0):
            raise ValueError(
                "with the detector Klems light comes from its patches: leave theta_i, phi_i and beam_half_angle out"
            )
        for theta in self.theta_i:
            if self.beam_half_angle and theta + self.beam_half_angle > 90:
                raise ValueError(
                    f"theta_i = {theta:g} with beam_half_angle = {self.beam_half_angle:g} puts part of the source "
                    f"below the horizon: keep their sum at or below 90 degrees"
                )
            if isinstance(self.detector, HemisphereGrid) and self.detector.edge_at(theta):
                raise ValueError(
                    f"theta_i = {theta:g} lies on a bin edge of the detector, where rounding would split the mirror "
                    f"lobe: move theta_i or choose another theta_step than {self.detector.theta_step:g}"
                )
        return self

    def axes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Every theta_i and every phi_i from which light comes, degrees; with `Klems` not in all combinations."""
        if isinstance(self.detector, Klems):
            theta, phi = np.array(self.detector.directions).T
            return np.unique(theta), np.unique(phi)
        return np.array(self.theta_i, np.float64), np.array(self.phi_i, np.float64)

    def incidences(self) -> list[Incidence]:
        """What is measured, in this order."""
        theta_i, phi_i = self.axes()
        if not isinstance(self.detector, Klems):
            source_sin2 = math.sin(math.radians(self.beam_half_angle)) ** 2
            return [
                Incidence(i, j, float(theta), float(phi), source_sin2, (0.0, 0.0, 0.0))
                for i, theta in enumerate(theta_i)
                for j, phi in enumerate(phi_i)
            ]
        patches = zip(self.detector.directions, *self.detector.limits(), strict=True)
        return [
            Incidence(
                int(np.searchsorted(theta_i, theta)), int(np.searchsorted(phi_i, phi)), theta, phi, 0.0,
                (*(np.sin(np.radians(polar)) ** 2).tolist(), math.radians(around[1])),
            )
            for (theta, phi), polar, around in patches
        ]  # fmt: skip

    def measure(
        self,
        scene: Scene,
        seed: int = 0,
        threads: int | None = None,
        progress: Progress | None = None,
        replicates: Sequence[int] | None = None,
    ) -> Measurement:
        """Measure `scene` at every incidence.

        `threads` defaults to the number of cores. `replicates`, a number for each theta_i and phi_i (phi_i fastest),
        overrides what `target_error` would choose: further specimens are to be measured as often as the first was. A
        KeyboardInterrupt ends the measurement early: what is complete is returned, and marked `interrupted`. Raises
        MemoryError, with what it would need, when the sums cannot fit.
        """
        workers = threads or os.cpu_count() or 1
        _refuse_what_cannot_fit(self, workers)
        incidences = self.incidences()
        job = _Job(self, scene, seed, workers, progress, len(incidences))
        sums = empty_sums(self)
        interrupted = False
        # The sums of one incidence are entered while the next is measured.
        with ThreadPoolExecutor(1) as clerk:
            entry: Future[None] | None = None
            for incidence in incidences:
                at = incidence.row, incidence.column
                index = incidence.row * sums.sizes["phi_i"] + incidence.column
                try:
                    tally = job.incidence(incidence, None if replicates is None else range(replicates[index]))
                    if entry:
                        entry.result()
                except KeyboardInterrupt:
                    interrupted = True
                    break
                entry = clerk.submit(enter, tally, sums, at)
            if entry:
                entry.result()
        return Measurement(sums, self.provenance(scene, seed, interrupted))

    def tally(
        self,
        scene: Scene,
        seed: int,
        incidence: Incidence,
        threads: int | None = None,
        progress: Progress | None = None,
        replicates: range | None = None,
    ) -> Tally:
        """Count the light of one of the `incidences`, or of some of its `replicates` only; see `measure`.

        Tallies of different replicates add up to what all of them together would have been. Raises KeyboardInterrupt,
        and MemoryError as `measure` does.
        """
        workers = threads or os.cpu_count() or 1
        _refuse_what_cannot_fit(self, workers)
        return _Job(self, scene, seed, workers, progress, 1).incidence(incidence, replicates)

    def provenance(self, scene: Scene, seed: int, interrupted: bool = False) -> dict[str, Any]:
        """What is known of a measurement, as plain strings and numbers that any netCDF reader shows."""
        packages = ("gonio", "numpy", "numba", "embreex", "xarray")
        versions = {name: _version(name) for name in packages}
        return {
            "Conventions": "CF-1.11",
            "title": "BRDF measured by gonio, a virtual gonioreflectometer",
            "source": "ray tracing of a microsurface",
            "goniometer": TypeAdapter(Goniometer).dump_json(self).decode(),
            "detector": TypeAdapter(Detector).dump_json(self.detector).decode(),
            "material": TypeAdapter(type(scene.material)).dump_json(scene.material).decode(),
            "surface_statistics": json.dumps(scene.geometry.statistics.as_dict()),
            "facets": json.dumps(scene.relief.facets.as_dict()),
            "isotropic": int(self.azimuth == "average"),
            "interrupted": int(interrupted),
            "seed": str(seed),
            "versions": json.dumps({**versions, "python": platform.python_version()}),
            "platform": f"{platform.system()} {platform.machine()}",
        }


class Incidence(NamedTuple):
    """One direction that light comes from, or one patch of directions."""

    row: int
    column: int
    """Where it belongs among the theta_i and phi_i of the measurement."""
    theta: float
    phi: float
    """Its centre, degrees."""
    source_sin2: float
    patch: tuple[float, float, float]
    """As `Source` has them."""


def _wanted(tally: Tally, target: float) -> int:
    """How many replicates bring the median relative error of the reflected light down to `target`."""
    return max(tally.pilot, math.ceil(tally.pilot * (median_error(tally) / target) ** 2))


def median_error(tally: Tally) -> float:
    """The relative error that half of the light's bins stay below, at the worst wavelength, as the pilot tells it."""
    count = min(tally.pilot, tally.replicates)
    light = tally.piloted[0, :-1].astype(np.float64)
    scatter = tally.squares.squared_deviations(tally.piloted, count).floats()[0, :-1]
    error = np.sqrt(scatter / (count - 1)) / np.maximum(light, 1.0)
    return max(_weighted_median(error[:, w], light[:, w]) for w in range(light.shape[1]))


def _weighted_median(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    if cumulative[-1] == 0:
        return 0.0
    return float(values[order][np.searchsorted(cumulative, cumulative[-1] / 2)])


def enter(tally: Tally, sums: Any, at: tuple[int, int]) -> None:
    """Write the tally of one incidence into `sums` (see `empty_sums`), at its row and column."""
    scatter, squares = tally.squared_deviations(), UInt128.zeros(tally.total.shape)
    squares.add_square(tally.total)
    for name, value in (
        ("weight", tally.total),
        ("count", tally.count),
        ("squared_deviations_high", scatter.high),
        ("squared_deviations_low", scatter.low),
        ("realisation_squares_high", squares.high),
        ("realisation_squares_low", squares.low),
        ("paths", tally.paths * tally.replicates),
        ("replicates", tally.replicates),
        ("realisations", 1),
    ):
        sums[name].values[at] = value
    launched = np.full(tally.total.shape[2], tally.paths * tally.replicates * UNIT)
    spent = tally.energy_budget[[ABSORBED, TRUNCATED, LOST]]
    sums["energy_budget"].values[at] = [launched, tally.total[0, -1], *spent]


@dataclass
class _Job:
    """One measurement under way: its threads and its progress."""

    goniometer: Goniometer
    scene: Scene
    seed: int
    threads: int
    progress: Progress | None
    incidences: int
    stop: threading.Event = field(default_factory=threading.Event)
    lock: threading.Lock = field(default_factory=threading.Lock)
    spare: list[Scores] = field(default_factory=list)
    """Histograms to be used again: fresh memory costs more than the zeros in it."""
    paths: int = 0
    rays: int = 0
    finished: int = 0
    """Paths of the incidences that are complete."""

    def incidence(self, incidence: Incidence, replicates: range | None) -> Tally:
        """Measure one incidence: those replicates, or a pilot of them and as many more as the target needs."""
        g = self.goniometer
        wavelengths = np.array(g.wavelengths)
        theta, phi = incidence.theta, incidence.phi
        source = Source(
            math.radians(theta), math.radians(phi), incidence.source_sin2, incidence.patch, g.azimuth == "average",
            _key(self.seed, theta, phi),
        )  # fmt: skip
        setup = Setup(source, surface_optics(self.scene.material, wavelengths), bins_of(g.detector, phi))
        shape = (g.orders + 1, g.detector.bins + 1, len(wavelengths))
        tally = Tally.empty(g.replicates, math.ceil(g.paths / g.replicates), shape)
        self._run(tally, setup, replicates or range(g.replicates))
        if replicates is None and g.target_error is not None:
            wanted = _wanted(tally, g.target_error)
            if wanted * tally.paths > MAX_PATHS:
                raise ValueError(
                    f"target_error = {g.target_error:g} needs {wanted * tally.paths:.2g} paths at theta_i = {theta:g}, "
                    f"more than the {MAX_PATHS} that can be summed exactly: ask for less, or for wider bins"
                )
            self._run(tally, setup, range(g.replicates, wanted))
        self.finished += tally.paths * tally.replicates
        self.incidences -= 1
        return tally

    def _run(self, tally: Tally, setup: Setup, replicates: range) -> None:
        """Trace replicates on all threads; every thread takes the next group when it has finished one."""
        count = tally.replicates + len(replicates) + (self.incidences - 1) * tally.pilot
        expected = self.finished + tally.paths * count
        share = math.ceil(len(replicates) / self.threads)
        group = max(1, min(share, GROUP_BYTES // tally.total.nbytes))
        queue = (replicates[first : first + group] for first in range(0, len(replicates), group))
        with ThreadPoolExecutor(self.threads) as pool:
            pending: set[Future[None]] = set()
            try:
                while True:
                    for some in itertools.islice(queue, self.threads - len(pending)):
                        pending.add(pool.submit(self._group, tally, setup, some))
                    if not pending:
                        break
                    done, pending = wait(pending, timeout=_TICK, return_when=FIRST_COMPLETED)
                    for future in done:
                        future.result()
                    if self.progress:
                        self.progress(self.paths, max(expected, self.paths), self.rays)
            except BaseException:
                self.stop.set()
                raise

    def _group(self, tally: Tally, setup: Setup, replicates: range) -> None:
        labels, bins, width = tally.total.shape
        with self.lock:
            scores = self.spare.pop() if self.spare else None
        if scores is None or len(replicates) != len(scores.energy_budget):
            scores = Scores.empty(len(replicates), labels - 1, bins, width)
        if trace(self.scene, setup, replicates, tally.paths, scores, self._advanced):
            tally.add(replicates, scores.bins, scores.energy_budget)
            with self.lock:
                self.spare.append(scores)

    def _advanced(self, paths: int, rays: int) -> bool:
        with self.lock:
            self.paths += paths
            self.rays += rays
        return not self.stop.is_set()


def _key(seed: int, theta: float, phi: float) -> tuple[int, int]:
    """Two 32-bit words that depend on the seed and on the incidence's values, not on its place in the list."""
    digest = hashlib.blake2b(str(seed).encode() + struct.pack("<dd", theta, phi), digest_size=8).digest()
    low, high = struct.unpack("<II", digest)
    return low, high


def empty_sums(goniometer: Goniometer) -> Any:
    """The sums of a measurement of which nothing has been counted yet."""
    import xarray as xr

    theta_i, phi_i = goniometer.axes()
    incidence = (len(theta_i), len(phi_i))
    labels, bins, width = goniometer.orders + 1, goniometer.detector.bins + 1, len(goniometer.wavelengths)
    full = ("theta_i", "phi_i", "order", "bin", "wavelength")
    shapes: dict[str, tuple[tuple[str, ...], tuple[int, ...], type]] = {
        "weight": (full, (labels, bins, width), np.int64),
        "count": (full[:-1], (labels, bins), np.int64),
        "energy_budget": (("theta_i", "phi_i", "termination", "wavelength"), (len(ENERGY_BUDGET), width), np.int64),
        **dict.fromkeys(("paths", "replicates", "realisations"), (full[:2], (), np.int64)),
        **{
            f"{name}_{half}": (full, (labels, bins, width), np.uint64)
            for name in ("squared_deviations", "realisation_squares")
            for half in ("high", "low")
        },
    }
    sums = xr.Dataset(
        {name: (dims, np.zeros(incidence + shape, dtype)) for name, (dims, shape, dtype) in shapes.items()},
        coords={
            "theta_i": theta_i,
            "phi_i": phi_i,
            "order": list(orders(goniometer.orders)),
            "termination": list(ENERGY_BUDGET),
            "wavelength": np.array(goniometer.wavelengths, np.float64),
        },
    )
    return sums.assign_attrs(pilot=goniometer.replicates, units="2-32 path")


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _refuse_what_cannot_fit(goniometer: Goniometer, threads: int) -> None:
    """Raise MemoryError if the sums and the labelled result need more than the machine has."""
    entries = (goniometer.orders + 1) * (goniometer.detector.bins + 1) * len(goniometer.wavelengths)
    incidences = math.prod(map(len, goniometer.axes()))
    need = 8 * entries * (incidences * 12 + 6 + 2 * threads) + threads * GROUP_BYTES
    have = _memory()
    if have is not None and need > have:
        raise MemoryError(
            f"the result of {incidences} incidences x {goniometer.detector.bins} bins x {len(goniometer.wavelengths)} "
            f"wavelengths needs about {need / 2**30:.1f} GiB of memory and this machine has {have / 2**30:.1f}: choose "
            f"wider bins, or fewer incidences or wavelengths at a time"
        )


def _memory() -> int | None:
    """Bytes of physical memory, where the system tells."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return None
