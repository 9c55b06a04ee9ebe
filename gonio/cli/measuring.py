"""`gonio run` and `gonio surface`: what an experiment file describes, measured and built."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from gonio.cli.judging import insist, judge, models_to_compare, show_comparisons
from gonio.cli.terminal import (
    Flag,
    Meter,
    Output,
    Overrides,
    RunError,
    app,
    check_writable,
    complain,
    make_room,
    open_window,
    progress,
    rays_per_second,
    read_experiment,
    reason,
    say,
    show_table,
    telling_mistakes,
    telling_refusals,
)
from gonio.toml_files import InputError

if TYPE_CHECKING:
    from gonio.comparison import Comparison
    from gonio.experiment import Experiment
    from gonio.measurement import Measurement
    from gonio.models import Model


PICTURES = ("lobes", "slices", "hemisphere", "albedo")
"""What is drawn of every measurement that allows it, as functions of `plots` and as files."""

WITH_MODELS = ("slices", "albedo")
"""Those that show models, too."""

PAGE = "report.html"
"""The page with all of it."""


@app.command
def run(
    config: Path,
    /,
    *,
    overrides: Overrides = (),
    threads: int | None = None,
    seed: int | None = None,
    output: Output = None,
    no_pictures: Flag = False,
    quiet: Flag = False,
) -> None:
    """Measure the BRDF that an experiment file describes.

    Writes measurement.nc, experiment.toml (everything resolved: run again, it
    gives the same numbers), lobes.png, slices.png, hemisphere.png, albedo.png,
    and report.html, one page to send (with pip install "gonio[report]").
    Prints albedos, orders of scattering, the energy budget, how models compare
    and the self-checks.

    Parameters
    ----------
    config
        The experiment, a .toml file such as those in configs/.
    overrides
        Put a value in place of the file's, as often as needed: --set surface.alpha=0.2 --set goniometer.paths=100000
    threads
        Threads to use; all cores if not given. Results do not depend on it.
    seed
        Seed of all random numbers, in place of the file's.
    output
        Folder for the results; out/NAME if not given, where NAME.toml is the experiment.
    no_pictures
        Write the numbers only, which takes less time; gonio plot and gonio report draw them later.
    quiet
        Print nothing but errors.
    """
    from gonio.self_check import SelfCheckReport

    experiment = read_experiment(config, overrides, seed)
    if threads is not None and threads < 1:
        raise InputError(f"--threads {threads}: must be 1 or more.")
    folder = output or Path("out") / config.stem
    check_writable(folder)
    started = time.monotonic()
    with progress(quiet) as meter:
        try:
            measurement = experiment.run(threads=threads, progress=meter)
        except KeyboardInterrupt:
            raise RunError("Interrupted before anything was measured: nothing was written.") from None
    seconds = time.monotonic() - started
    _write_results(experiment, measurement, folder)
    models, complaints = models_to_compare(measurement, experiment.models)
    complain(0, *complaints)
    comparisons = [] if quiet and no_pictures else judge(measurement, models)
    report = SelfCheckReport.from_json(measurement.attributes["self_check"])
    if not quiet:
        _report(measurement, comparisons, meter, seconds)
        for sentence in report.summary():
            say(sentence)
    shown = [] if no_pictures else _show(measurement, models, comparisons, folder)
    if not quiet:
        files = ", ".join(("measurement.nc", "experiment.toml", *shown))
        hint = "" if no_pictures or _can_write_pages() else f' (pip install "gonio[report]" adds {PAGE})'
        say(f"Files in {folder}{os.sep}: {files}{hint}")
    if measurement.interrupted:
        raise RunError(f"Interrupted: {folder / 'measurement.nc'} holds what had been measured.")
    insist(report, folder / "measurement.nc")


def _write_results(experiment: Experiment, measurement: Measurement, folder: Path) -> None:
    """Write the numbers; each file appears whole. What showed older ones is taken away."""
    try:
        _write_numbers(experiment, measurement, folder)
    except OSError as error:
        refuge = Path(tempfile.mkdtemp(prefix="gonio-"))
        with contextlib.suppress(OSError):
            _write_numbers(experiment, measurement, refuge)
            raise RunError(f"{folder} cannot be written ({reason(error)}): the results are in {refuge}.") from None
        raise RunError(
            f"{folder} cannot be written ({reason(error)}), nor can {refuge}: the results are lost."
        ) from None
    for name in (*(f"{name}.png" for name in PICTURES), PAGE):
        (folder / name).unlink(missing_ok=True)


def _write_numbers(experiment: Experiment, measurement: Measurement, folder: Path) -> None:
    from gonio.netcdf import save
    from microsurfaces.atomic_write import atomic_write

    folder.mkdir(parents=True, exist_ok=True)
    save(measurement, folder / "measurement.nc")
    with atomic_write(folder / "experiment.toml") as path:
        experiment.write(path)


def _show(
    measurement: Measurement, models: Sequence[Model], comparisons: Sequence[Comparison], folder: Path
) -> list[str]:
    """Draw every picture that this measurement allows, and put them into a page; the names of the files."""
    from gonio import plots
    from gonio.reporting import report

    shown: list[Path] = []
    for name in PICTURES:
        options = {"models": models} if name in WITH_MODELS else {}
        shown += _made(partial(getattr(plots, name), measurement, **options), folder / f"{name}.png")
    if _can_write_pages():
        others = [model for model in models if all(model is not comparison.model for comparison in comparisons)]
        page = partial(report, measurement, models=(*comparisons, *others), pictures=tuple(shown))
        shown += _made(page, folder / PAGE)
    return [path.name for path in shown]


def _made(make: Callable[[Path], object], path: Path) -> list[Path]:
    """The file, once it is there; nothing where it cannot be made, which is told."""
    try:
        make(path)
    except (ValueError, OSError) as error:
        complain(0, f"No {path.name}: {error}")
        return []
    return [path]


def _can_write_pages() -> bool:
    """Whether plotly is there."""
    return importlib.util.find_spec("plotly") is not None


def _report(measurement: Measurement, comparisons: Sequence[Comparison], meter: Meter, seconds: float) -> None:
    """What was measured, in two tables, how sure it is, and how well the models do."""
    from gonio import tables
    from gonio.noise import noises

    show_table("Albedo, the share of the light that comes back, ± standard error", tables.albedo(measurement))
    show_table("Orders of scattering in the reflected light, and what did not come back", tables.energy(measurement))
    paths = int(measurement.dataset["paths"].sum())
    say(f"{paths / 1e6:.3g} M paths in {seconds:.1f} s; while tracing, {rays_per_second(meter.rate)}.")
    if int(measurement.dataset["realisations"].max()) > 1:
        for sentence in noises(measurement).sentences():
            say(sentence)
    elif not comparisons:
        say("One specimen was measured: the errors are its Monte Carlo noise, other specimens may differ by more.")
    show_comparisons(comparisons)


@app.command
def surface(
    config: Path,
    /,
    *,
    overrides: Overrides = (),
    seed: int | None = None,
    to: Path | None = None,
    show: Flag = False,
) -> None:
    """Build an experiment's surface and print its statistics.

    Parameters
    ----------
    config
        The experiment, a .toml file such as those in configs/.
    overrides
        Put a value in place of the file's, as often as needed: --set surface.alpha=0.2
    seed
        Seed of all random numbers, in place of the file's.
    to
        A file for the surface: heights as .x3p, .exr, .png or .npy, triangles as .ply, .stl or .obj.
    show
        Open a window with the surface.
    """
    from gonio import tables
    from microsurfaces.files import save_surface

    experiment = read_experiment(config, overrides, seed)
    if to is not None:
        make_room(to)
    relief = experiment.relief()
    if to is not None:
        with telling_mistakes(), telling_refusals(to):
            save_surface(relief, to)
    show_table("Statistics of the surface, measured on its facets", tables.statistics(relief.statistics().as_dict()))
    if to is not None:
        print(to)
    if show:
        open_window(relief)
