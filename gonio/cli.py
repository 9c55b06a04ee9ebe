"""The command line: `gonio run | surface | compare | plot | export | list`. The only file that prints or exits.

Everything heavy is imported inside the command that needs it, so that `gonio --help` answers at once.
Exit codes: 0 done, 1 failed while running, 2 bad input, told in one sentence for each mistake.
"""

from __future__ import annotations

import contextlib
import inspect
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

from cyclopts import App, CycloptsError, Parameter
from rich.console import Console

from gonio import __version__

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo
    from rich.table import Table

    from gonio.compare import Verdict
    from gonio.experiment import Experiment
    from gonio.measurement import Measurement
    from gonio.models import Model
    from microsurfaces import HeightField, Mesh

WIDTH = 100
"""No line is wider, however wide the terminal is."""

PLAIN_PROGRESS_SECONDS = 10.0
"""Where there is no terminal to draw a bar on, a line this often."""

app = App(
    name="gonio",
    help="A virtual gonioreflectometer: a rough surface in, a measured BRDF with an error bar on every bin out.",
    help_epilogue="Start with: gonio run configs/gold_beckmann.toml",
    version=__version__,
    help_format="plaintext",
    suppress_keyboard_interrupt=False,
)

Overrides = Annotated[tuple[str, ...], Parameter(name="--set", negative="", show_default=False)]
ModelNames = Annotated[tuple[str, ...], Parameter(name="--model", negative="", show_default=False)]
Output = Annotated[Path | None, Parameter(name=["--output", "-o"])]


class RunError(Exception):
    """What went wrong while running, in one sentence."""


def main(tokens: Sequence[str] | None = None) -> NoReturn:
    """Run the command that `tokens` (or the command line) ask for, and exit with its code."""
    code = _attempt(tokens)
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.flush()
        sys.exit(code)
    # The reader of a pipe, such as head, has enough.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


def _attempt(tokens: Sequence[str] | None) -> int:
    """Run a command; what can go wrong is told in sentences, everything else is a fault of ours and shows its trace."""
    try:
        app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        return _complain(2, _usage(error))
    except RunError as error:
        return _complain(1, str(error))
    except KeyboardInterrupt:
        return _complain(1, "Interrupted.")
    except MemoryError as error:
        return _complain(1, f"Not enough memory: {error or 'make the surface, the detector or the run smaller'}.")
    except BrokenPipeError:
        return 0
    except ValueError as error:
        from gonio.experiment import InputError

        if not isinstance(error, InputError):
            raise
        return _complain(2, *error.sentences)
    return 0


def _complain(code: int, *sentences: str) -> int:
    for sentence in sentences:
        print(sentence if sentence.endswith((".", "?", "!")) else f"{sentence}.", file=sys.stderr)
    return code


def _usage(error: CycloptsError) -> str:
    """cyclopts' complaint in one line, with where to look."""
    return f"{' '.join(str(error).split())} See gonio --help."


# --- run -------------------------------------------------------------------------------------------------------------


@app.command
def run(
    config: Path,
    /,
    *,
    overrides: Overrides = (),
    threads: int | None = None,
    seed: int | None = None,
    output: Output = None,
    quiet: Annotated[bool, Parameter(negative="", show_default=False)] = False,
) -> None:
    """Measure the BRDF that an experiment file describes.

    Writes measurement.nc, experiment.toml (everything resolved: run again, it
    gives the same numbers), lobes.png, slices.png and hemisphere.png. Prints
    albedos, orders of scattering, lost energy and how models compare.

    Parameters
    ----------
    config
        The experiment, a TOML file such as those in configs/.
    overrides
        Put a value in place of the file's, as often as needed: --set surface.alpha=0.2 --set goniometer.paths=100000
    threads
        Threads to use; all cores if not given. Results do not depend on it.
    seed
        Seed in place of the file's.
    output
        Folder for the results; out/NAME if not given, where NAME.toml is the experiment.
    quiet
        Print nothing but errors.
    """
    from gonio.experiment import InputError

    experiment = _experiment(config, overrides, seed)
    if threads is not None and threads < 1:
        raise InputError(f"--threads {threads}: must be 1 or more.")
    folder = output or Path("out") / config.stem
    _check_writable(folder)
    started = time.monotonic()
    with _progress(quiet) as meter:
        try:
            measurement = experiment.run(threads=threads, progress=meter)
        except KeyboardInterrupt:
            raise RunError("Interrupted before anything was measured: nothing was written.") from None
    seconds = time.monotonic() - started
    models, complaints = _models(measurement, experiment.compare)
    files = _write_results(experiment, measurement, models, folder)
    _complain(0, *complaints)
    if not quiet:
        _report(measurement, models, meter, seconds)
        _say(f"Files in {folder}{os.sep}: {', '.join(files)}")
    if measurement.interrupted:
        raise RunError(f"Interrupted: {folder / 'measurement.nc'} holds what had been measured.")


def _check_writable(folder: Path) -> None:
    """Raise `RunError` if results could not be written to `folder`, before a long run; creates nothing."""
    if folder.exists() and not folder.is_dir():
        raise RunError(f"{folder} is a file: give another folder with -o.")
    existing = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise RunError(f"{folder} cannot be written ({_reason(error)}): give another folder with -o.") from None


def _make_writable(folder: Path) -> None:
    """Create `folder` where it does not exist; raise `RunError` if files could not be written to it."""
    _check_writable(folder)
    folder.mkdir(parents=True, exist_ok=True)


def _write_results(
    experiment: Experiment, measurement: Measurement, models: Sequence[Model], folder: Path
) -> list[str]:
    """Write the numbers, then the pictures; each file appears whole. The names of the files, the numbers' first."""
    try:
        _write_numbers(experiment, measurement, folder)
    except OSError as error:
        refuge = Path(tempfile.mkdtemp(prefix="gonio-"))
        with contextlib.suppress(OSError):
            _write_numbers(experiment, measurement, refuge)
            raise RunError(f"{folder} cannot be written ({_reason(error)}): the results are in {refuge}.") from None
        raise RunError(
            f"{folder} cannot be written ({_reason(error)}), nor can {refuge}: the results are lost."
        ) from None
    return ["measurement.nc", "experiment.toml", *_draw(measurement, models, folder)]


def _write_numbers(experiment: Experiment, measurement: Measurement, folder: Path) -> None:
    from gonio.measurement import save
    from microsurfaces.files import replacing

    folder.mkdir(parents=True, exist_ok=True)
    save(measurement, folder / "measurement.nc")
    with replacing(folder / "experiment.toml") as path:
        experiment.write(path)


def _draw(measurement: Measurement, models: Sequence[Model], folder: Path) -> list[str]:
    """Draw every picture that this measurement allows; the names of the files. What cannot be drawn is told."""
    from gonio import plots

    drawn = []
    pictures = {"lobes": {}, "slices": {"models": models}, "hemisphere": {}}
    for name, options in pictures.items():
        path = folder / f"{name}.png"
        # An older picture must not stand beside new numbers.
        path.unlink(missing_ok=True)
        try:
            getattr(plots, name)(measurement, path, **options)
        except (ValueError, OSError) as error:
            _complain(0, f"No {path.name}: {error}")
        else:
            drawn.append(path.name)
    return drawn


def _reason(error: OSError) -> str:
    """Why the system refused, in its own few words."""
    return (os.strerror(error.errno) if error.errno else str(error).split("\n")[0]).lower()


class _Meter:
    """Counts rays and the time they took; `show` is called with paths done, paths in all, and rays per second."""

    def __init__(self, show: Callable[[int, int, float], None]) -> None:
        self._show = show
        self._last = time.monotonic()
        self._seconds = 0.0
        self.rays = 0

    def __call__(self, done: int, total: int, rays: int) -> None:
        now = time.monotonic()
        # Without new rays a kernel is being compiled, and a long pause is a surface being built.
        if rays > self.rays and now - self._last < 2:
            self._seconds += now - self._last
        self._last, self.rays = now, rays
        self._show(done, total, self.rate)

    @property
    def rate(self) -> float:
        """Rays per second of tracing."""
        return self.rays / max(self._seconds, 1e-3)


@contextlib.contextmanager
def _progress(quiet: bool) -> Iterator[_Meter]:
    """A bar on a terminal, a line every few seconds elsewhere, both on stderr."""
    if quiet:
        yield _Meter(lambda done, total, rate: None)
    elif not sys.stderr.isatty():
        yield _Meter(_plain_progress())
    else:
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

        columns = (BarColumn(None), TaskProgressColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), expand=True) as bar:
            task = bar.add_task("building the surface", total=None)
            yield _Meter(
                lambda done, total, rate: bar.update(task, completed=done, total=total, description=_rate(rate))
            )


def _plain_progress() -> Callable[[int, int, float], None]:
    """Prints a line of progress to stderr now and then."""
    started = last = time.monotonic()

    def show(done: int, total: int, rate: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= PLAIN_PROGRESS_SECONDS and done:
            last, left = now, (now - started) * (total - done) / done
            _complain(0, f"{done / total:4.0%} done, {_rate(rate)}, {left:.0f} s left")

    return show


def _rate(rays_per_second: float) -> str:
    return (
        f"{rays_per_second / 1e6:.1f} M rays/s" if rays_per_second >= 1e5 else f"{rays_per_second / 1e3:.0f} k rays/s"
    )


def _console() -> Console:
    """Standard output, never wider than `WIDTH`."""
    console = Console(highlight=False)
    console.width = min(console.width, WIDTH)
    return console


def _say(text: str, style: str | None = None) -> None:
    """Print a paragraph, wrapped at the terminal's width."""
    _console().print(text, style=style, markup=False)


def _report(measurement: Measurement, models: Sequence[Model], meter: _Meter, seconds: float) -> None:
    """What was measured, in two tables, and how well the models do."""
    _show("Albedo, the share of the light that comes back, ± standard error", _albedo_table(measurement))
    _show("Orders of scattering in the reflected light, and what did not come back", _energy_table(measurement))
    paths = int(measurement.dataset["paths"].sum())
    _say(f"{paths / 1e6:.3g} M paths in {seconds:.1f} s; while tracing, {_rate(meter.rate)}.")
    if not models and int(measurement.dataset["realisations"].max()) == 1:
        _say("One specimen was measured: the errors are its Monte Carlo noise, other specimens may differ by more.")
    _judge(measurement, models)


def _albedo_table(measurement: Measurement) -> Table:
    """Albedo with its standard error for every incidence and up to three wavelengths."""
    dataset = measurement.albedo()
    wavelengths = dataset["wavelength"].values
    count = min(len(wavelengths), 3)
    chosen = [round(i * (len(wavelengths) - 1) / max(count - 1, 1)) for i in range(count)]
    table = _incidence_table()
    for i in chosen:
        table.add_column(f"{wavelengths[i]:g} nm", justify="right")
    for theta, phi in measurement.incidences():
        here = dataset.sel(theta_i=theta, phi_i=phi)
        values, errors = here["albedo"].values, here["standard_error"].values
        table.add_row(_incidence(theta, phi), *(_with_error(values[i], errors[i]) for i in chosen))
    if count < len(wavelengths):
        table.caption = f"{count} of {len(wavelengths)} wavelengths; all are in measurement.nc"
    return table


def _energy_table(measurement: Measurement) -> Table:
    """Orders of scattering and the ledger, means over the wavelengths."""
    albedo, ledger = measurement.dataset["albedo"].mean("wavelength"), measurement.ledger().mean("wavelength")
    table = _incidence_table()
    orders = albedo["order"].values[1:]
    for order in orders:
        hits = f"{order[:-1]} or more" if order.endswith("+") else f"{order} hit{'s' * (order != '1')}"
        table.add_column(hits, justify="right")
    for heading in ("absorbed", "lost or truncated"):
        table.add_column(heading, justify="right")
    for theta, phi in measurement.incidences():
        here, fate = albedo.sel(theta_i=theta, phi_i=phi), ledger.sel(theta_i=theta, phi_i=phi)
        total = float(here.sel(order="all")) or 1.0
        shares = [float(here.sel(order=order)) / total for order in orders]
        missing = float(fate["lost"] + fate["truncated"])
        table.add_row(
            _incidence(theta, phi),
            *(f"{share:.2%}" for share in (*shares, float(fate["absorbed"]))),
            f"{missing:.1e}" if missing else "0",
        )
    return table


def _incidence_table() -> Table:
    """A table whose first column says where the light comes from."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, caption_justify="left")
    table.add_column("light from", justify="right", no_wrap=True)
    return table


def _incidence(theta: float, phi: float) -> str:
    return f"{theta:g}°, {phi:g}°"


def _show(title: str, table: Table) -> None:
    """Print a table under its title."""
    _say(title, style="bold")
    _console().print(table)


def _with_error(value: float, error: float) -> str:
    """A value with as many digits as its standard error allows."""
    if not error >= 5e-7:
        return f"{value:.6f} ± {error:.0g}"
    decimals = min(max(1 - math.floor(math.log10(error)), 0), 6)
    return f"{value:.{decimals}f} ± {error:.{decimals}f}"


def _concise(value: float, error: float) -> str:
    """A value with the standard error of its last two digits in brackets, as metrologists write it."""
    if not error >= 5e-8:
        return f"{value:.6f}"
    decimals = max(1 - math.floor(math.log10(error)), 0)
    return f"{value:.{decimals}f}({error * 10**decimals:.0f})"


def _models(measurement: Measurement, names: Sequence[str] | None) -> tuple[tuple[Model, ...], tuple[str, ...]]:
    """The models to compare with, and why there are none: a measurement is worth keeping all the same."""
    from gonio.experiment import InputError, models_for

    try:
        return models_for(measurement, names), ()
    except InputError as error:
        return (), error.sentences


def _judge(measurement: Measurement, models: Sequence[Model]) -> None:
    """Print how each model compares with single scattering as measured, and what is noise and what is not."""
    from gonio.compare import compare

    verdicts = [compare(measurement, model) for model in models]
    for verdict in verdicts:
        _show(f"{_short(verdict.model)} against the light of one hit", _verdict_table(verdict))
    if verdicts:
        _say(
            "Of every incidence the wavelength whose albedo differs most; in brackets the standard error of its last "
            "digits. L1: how far the lobes differ, and how far noise alone would make them. Differs: noise does not "
            "explain it; unclear: specimens that move the whole lobe could; more realisations would tell."
        )
        for sentence in verdicts[0].preamble():
            _say(sentence)


def _short(model: Model) -> str:
    """A model's name, and that of its masking where it has one."""
    masking = getattr(model, "masking", None)
    parts = [type(part).__name__ for part in (getattr(model, "distribution", None), masking) if part is not None]
    return type(model).__name__ + (f" ({', '.join(parts)})" if parts else "")


def _verdict_table(verdict: Verdict) -> Table:
    """Albedo and lobe of a model, each with its verdict, one row an incidence."""
    table = _incidence_table()
    for heading in ("nm", "albedo", "model", "verdict", "L1", "noise", "verdict"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in verdict.worst_rows():
        measured, model = float(row["albedo_measured"]), float(row["albedo_model"])
        difference = f"{model / measured - 1:+.2%}" if measured else "-"
        table.add_row(
            _incidence(row["theta_i"], row["phi_i"]),
            f"{row['wavelength']:g}",
            _concise(measured, float(row["albedo_standard_error"])),
            difference,
            "differs" if row["albedo_differs"] else "noise",
            f"{row['l1']:.1%}",
            f"{row['l1_noise']:.1%}",
            str(row["lobe"]),
        )
    return table


# --- surface ---------------------------------------------------------------------------------------------------------


@app.command
def surface(
    config: Path,
    /,
    *,
    overrides: Overrides = (),
    seed: int | None = None,
    output: Output = None,
    show: Annotated[bool, Parameter(negative="", show_default=False)] = False,
) -> None:
    """Build an experiment's surface and print its statistics.

    Parameters
    ----------
    config
        The experiment, a TOML file.
    overrides
        Put a value in place of the file's: --set surface.alpha=0.2
    seed
        Seed in place of the file's.
    output
        Save the surface: heights as .exr or .npy, triangles as .ply or .stl.
    show
        Open a window with the surface.
    """
    from gonio.experiment import InputError
    from microsurfaces.files import save_surface

    experiment = _experiment(config, overrides, seed)
    relief = experiment.relief()
    if output is not None:
        _make_writable(output.parent)
        try:
            save_surface(relief, output)
        except ValueError as error:
            raise InputError(str(error)) from None
    _show("Statistics of the surface, measured on its facets", _statistics_table(relief.statistics().as_dict()))
    if output is not None:
        print(f"Saved as {output}")
    if show:
        _open_window(relief)


def _open_window(relief: HeightField | Mesh) -> None:
    """Show a surface until its window is closed."""
    from gonio import plots
    from microsurfaces import Mesh

    try:
        plots.show(relief if isinstance(relief, Mesh) else relief.mesh())
    except RuntimeError as error:
        raise RunError(f"No window: {error}") from None


def _experiment(config: Path, overrides: Sequence[str], seed: int | None) -> Experiment:
    """The experiment of a file, with the command line's changes."""
    from gonio.experiment import Experiment

    return Experiment.read(config, (*overrides, *(() if seed is None else (f"seed={seed}",))))


def _statistics_table(statistics: Mapping[str, float | None]) -> Table:
    """Name and value of each statistic."""
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    for name, value in statistics.items():
        unit = " µm" if name in ("Sa", "Sq") or name.startswith("correlation") else ""
        table.add_row(name, "not defined" if value is None else f"{value:.5g}{unit}")
    return table


# --- compare, plot, export -------------------------------------------------------------------------------------------


@app.command
def compare(file: Path, /, *, models: ModelNames = ()) -> None:
    """Compare a measurement with closed-form models, whose roughness is the one measured on the surface.

    Parameters
    ----------
    file
        The measurement, a .nc file.
    models
        Name of a model, as often as needed; those that fit the material if not given.
    """
    from gonio.experiment import models_for

    measurement = _load(file)
    _judge(measurement, models_for(measurement, models or None))


@app.command
def plot(file: Path, /, *, output: Output = None) -> None:
    """Draw a measurement: lobes.png, slices.png, hemisphere.png.

    Parameters
    ----------
    file
        The measurement, a .nc file.
    output
        Folder for the pictures; the measurement's own if not given.
    """
    from gonio.experiment import models_for

    measurement = _load(file)
    folder = output or file.parent
    _make_writable(folder)
    for name in _draw(measurement, models_for(measurement), folder):
        print(folder / name)


@app.command
def export(file: Path, /, *, to: Path, format: str | None = None) -> None:
    """Write a measurement in another program's format.

    Parameters
    ----------
    file
        The measurement, a .nc file.
    to
        The file to write; its suffix decides the format.
    format
        A suffix that decides instead, such as exr.
    """
    from gonio import formats
    from gonio.experiment import InputError

    measurement = _load(file)
    _make_writable(to.parent)
    try:
        print(formats.export(measurement, to, format))
    except ValueError as error:
        raise InputError(str(error)) from None
    except OSError as error:
        raise RunError(f"{to} cannot be written ({_reason(error)}).") from None


def _load(file: Path) -> Measurement:
    """The measurement in a file."""
    from gonio.experiment import InputError
    from gonio.measurement import load

    try:
        return load(file)
    except ValueError as error:
        raise InputError(str(error)) from None


# --- list ------------------------------------------------------------------------------------------------------------


@app.command(name="list")
def list_(name: str | None = None, /) -> None:
    """Show every surface, material, detector and model with its parameters and their defaults.

    Parameters
    ----------
    name
        One of them, shown with its whole description.
    """
    from gonio.experiment import InputError
    from microsurfaces.recipe import did_you_mean

    catalogue = _catalogue()
    known = {cls.__name__: cls for classes in catalogue.values() for cls in classes}
    if name is None:
        for heading, classes in catalogue.items():
            _say(f"{heading}\n", style="bold")
            for cls in classes:
                _describe(cls, (cls.__doc__ or "").partition("\n")[0])
        _list_materials()
    elif name in known:
        _describe(known[name], _reflowed(inspect.cleandoc(known[name].__doc__ or "")))
    else:
        raise InputError(f"{name} is none of {', '.join(known)}{did_you_mean(name, known)}")


def _catalogue() -> dict[str, list[type]]:
    """Every recipe, under the heading it is listed with."""
    from gonio.detectors import Detector
    from gonio.experiment import Experiment
    from gonio.goniometer import Goniometer
    from gonio.models import Model
    from gonio.optics import Material
    from microsurfaces import Surface
    from microsurfaces.recipe import members

    unions: dict[str, Any] = {
        "Surfaces: [surface]": Surface,
        "Materials: [material]": Material,
        "Detectors: [goniometer.detector]": Detector,
        "Models: compare = [...], gonio compare --model": Model,
        "The experiment, its goniometer": Experiment,
    }
    catalogue = {heading: list(members(union).values()) for heading, union in unions.items()}
    catalogue["The experiment, its goniometer"].append(Goniometer)
    return catalogue


def _describe(cls: type, text: str) -> None:
    """Print a recipe: its description, then a table of parameters, defaults and meanings."""
    from rich.table import Table
    from rich.text import Text

    from microsurfaces.recipe import parameters

    console = _console()
    _say(cls.__name__, style="bold")
    _say(text)
    table = Table.grid(padding=(0, 2, 0, 0))
    for name, field in parameters(cls).items():
        row = (f"  {name}", _default(field), " ".join((field.description or "").split()))
        table.add_row(*map(Text, row))
    console.print(table, "") if table.row_count else console.print()


def _reflowed(text: str) -> str:
    """`text` with one line a paragraph, but for what is set in as formulas are."""
    paragraphs = text.split("\n\n")
    return "\n\n".join(p if p.startswith(" ") else " ".join(p.split("\n")) for p in paragraphs) + "\n"


def _default(field: FieldInfo) -> str:
    """The default of a parameter as TOML has it."""
    from microsurfaces.recipe import as_toml

    if field.is_required():
        return "required"
    value = field.get_default()
    return "-" if value is None else type(value).__name__ if hasattr(value, "kind") else as_toml(value)


def _list_materials() -> None:
    """Print the materials that have a table of refractive indices, with their sources."""
    from rich.table import Table

    from gonio.optics import citation, materials

    table = Table.grid(padding=(0, 2, 0, 0))
    for symbol, english in materials().items():
        table.add_row(f"  {symbol}", english, citation(symbol))
    _say("Materials with a name: Conductor or Dielectric, name = ...\n", style="bold")
    _console().print(table)
