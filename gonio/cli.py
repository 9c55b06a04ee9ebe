"""The command line: `gonio run | surface | compare | fit | check | validate ...`. The only file that prints or exits.

Everything heavy is imported inside the command that needs it, so that `gonio --help` answers at once.
Exit codes: 0 done, 1 failed while running, 2 bad input, told in one sentence for each mistake.
"""

from __future__ import annotations

import contextlib
import inspect
import itertools
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

from cyclopts import App, CycloptsError, Parameter
from rich.console import Console

from gonio import __version__

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo
    from rich.table import Table

    from gonio.certificate import Certificate
    from gonio.compare import Verdict
    from gonio.experiment import Experiment
    from gonio.measurement import Measurement
    from gonio.models import Model
    from microsurfaces import HeightField, Mesh

WIDTH = 100
"""No line is wider, however wide the terminal is."""

PICTURES = ("lobes", "slices", "hemisphere", "albedo")
"""What is drawn of every measurement that allows it, as functions of `plots` and as files."""

KINDS = {
    "lobes": "lobes",
    "slice": "slices",
    "hemisphere": "hemisphere",
    "albedo": "albedo",
    "difference": "difference",
    "sphere": "sphere",
    "surface": "relief",
    "paths": "paths",
}
"""What `gonio plot` draws, and the functions of `plots` that do."""

UNASKED = ("lobes", "slice", "hemisphere", "albedo")
"""What it draws if no kind is asked for."""

OF_SURFACES = {"surface", "paths"}
"""Kinds that show a surface, not a measurement."""

KIND_OPTIONS = {
    "lobes": ("wavelength", "radius", "orders", "overlaid", "true_colour", "ground", "show"),
    "hemisphere": ("wavelength",),
    "difference": ("wavelength",),
    "surface": ("show",),
    "paths": ("theta_i",),
}
"""Options of `gonio plot` that only some kinds have."""

PICTURE_SUFFIXES = (".png", ".svg", ".pdf", ".jpg", ".gif", ".mp4", ".gltf", ".glb", ".vtp")
"""What no folder's name ends with."""

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
Flag = Annotated[bool, Parameter(negative="", show_default=False)]


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
    no_pictures: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    quiet: Annotated[bool, Parameter(negative="", show_default=False)] = False,
) -> None:
    """Measure the BRDF that an experiment file describes.

    Writes measurement.nc, experiment.toml (everything resolved: run again, it
    gives the same numbers), lobes.png, slices.png, hemisphere.png, albedo.png.
    Prints albedos, orders of scattering, lost energy and how models compare.

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
    no_pictures
        Write the numbers only, which takes less time; gonio plot draws them later.
    quiet
        Print nothing but errors.
    """
    from gonio.certificate import Certificate
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
    files = _write_results(experiment, measurement, models, folder, not no_pictures)
    certificate = Certificate.from_json(measurement.attributes["certificate"])
    _complain(0, *complaints)
    if not quiet:
        _report(measurement, models, meter, seconds)
        for sentence in certificate.summary():
            _say(sentence)
        _say(f"Files in {folder}{os.sep}: {', '.join(files)}")
    if measurement.interrupted:
        raise RunError(f"Interrupted: {folder / 'measurement.nc'} holds what had been measured.")
    _insist(certificate, folder / "measurement.nc")


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
    experiment: Experiment, measurement: Measurement, models: Sequence[Model], folder: Path, pictures: bool
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
    # An older picture must not stand beside new numbers.
    for name in PICTURES:
        (folder / f"{name}.png").unlink(missing_ok=True)
    return ["measurement.nc", "experiment.toml", *(_draw(measurement, models, folder) if pictures else ())]


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
    for name in PICTURES:
        path = folder / f"{name}.png"
        options = {"models": models} if name == "slices" else {}
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
    from gonio import tables

    _show("Albedo, the share of the light that comes back, ± standard error", tables.albedo(measurement))
    _show("Orders of scattering in the reflected light, and what did not come back", tables.energy(measurement))
    paths = int(measurement.dataset["paths"].sum())
    _say(f"{paths / 1e6:.3g} M paths in {seconds:.1f} s; while tracing, {_rate(meter.rate)}.")
    if not models and int(measurement.dataset["realisations"].max()) == 1:
        _say("One specimen was measured: the errors are its Monte Carlo noise, other specimens may differ by more.")
    _judge(measurement, models)


def _show(title: str, table: Table | None) -> None:
    """Print a table under its title; nothing if there is none."""
    if table is not None:
        _say(title, style="bold")
        _console().print(table)


def _models(measurement: Measurement, names: Sequence[str] | None) -> tuple[tuple[Model, ...], tuple[str, ...]]:
    """The models to compare with, and why there are none: a measurement is worth keeping all the same."""
    from gonio.experiment import InputError, models_for

    try:
        return models_for(measurement, names), ()
    except InputError as error:
        return (), error.sentences


def _judge(
    measurement: Measurement, models: Sequence[Model], every_wavelength: bool = False, floor: float = 0.01
) -> list[Verdict]:
    """Print how each model compares with the light it speaks of, and what is noise and what is not."""
    from gonio import tables
    from gonio.compare import compare

    verdicts = []
    for model in models:
        try:
            with _working(f"comparing with {tables.name_of(model)}"):
                verdicts.append(compare(measurement, model, floor))
        except ValueError as error:
            _complain(0, f"{tables.name_of(model)}: {error}")
    for verdict in verdicts:
        heading = f"{tables.name_of(verdict.model)} against {tables.light(verdict.order)}"
        _show(heading, tables.verdict(verdict, every_wavelength))
    if verdicts:
        _say(
            ("" if every_wavelength else "Of every incidence the wavelength whose albedo differs most; ")
            + "in brackets the standard error of its last "
            "digits. L1: how far the lobes differ, and how far noise alone would make them. Differs: noise does not "
            "explain it; unclear: specimens that move the whole lobe could; more realisations would tell."
        )
        for sentence in dict.fromkeys(line for verdict in verdicts for line in verdict.preamble()):
            _say(sentence)
    return verdicts


# --- surface ---------------------------------------------------------------------------------------------------------


@app.command
def surface(
    config: Path,
    /,
    *,
    overrides: Overrides = (),
    seed: int | None = None,
    output: Annotated[Path | None, Parameter(name=["--to", "--output", "-o"])] = None,
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
        Save the surface: heights as .x3p, .exr, .png or .npy, triangles as .ply, .stl or .obj.
    show
        Open a window with the surface.
    """
    from gonio import tables
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
    _show("Statistics of the surface, measured on its facets", tables.statistics(relief.statistics().as_dict()))
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


# --- compare, fit ----------------------------------------------------------------------------------------------------


@app.command
def compare(
    file: Path,
    /,
    *,
    models: ModelNames = (),
    all: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    floor: float = 0.01,
    output: Output = None,
) -> None:
    """Compare a measurement with closed-form models, bin by bin, and tell noise from difference.

    A model is a name, with settings if need be; what is not said is the
    specimen's: its material, and the roughness measured on its facets. A file
    that comes from elsewhere tells neither, so both must be said.

      --model cook-torrance
      --model "cook-torrance m=0.35 material.name=Au"
      --model "cook-torrance m=0.35 k_d=0.1"
      --model "microfacet distribution.kind=GGX masking.kind=VCavity"
      --model models.toml     with tables [[model]]

    Parameters
    ----------
    file
        The measurement, a .nc file.
    models
        A model, as often as needed; those that fit the material if not given.
    all
        Show every wavelength, not only the one that differs most.
    floor
        Share of a lobe's peak below which logarithms are not compared.
    output
        Folder for MODEL.nc, every number and every bin of the comparison, and MODEL.png, maps of the difference.
    """
    from gonio import tables
    from gonio.experiment import InputError, models_for

    if not 0.0 <= floor < 1.0:
        raise InputError(f"--floor {floor:g}: must be 0 or more and less than 1, a share of the peak.")
    measurement = _load(file)
    chosen = models_for(measurement, models or None)
    if not chosen:
        raise InputError(
            f"{file}: no model describes this specimen by itself; name one with --model, such as "
            '--model "cook-torrance m=0.3 material.name=Au".'
        )
    verdicts = _judge(measurement, chosen, all, floor)
    for verdict in verdicts:
        _show(f"{tables.name_of(verdict.model)}, other measures of the lobe", tables.metrics(verdict, all))
        _show("The bins that add most to L1, beyond doubt (3 standard errors)", tables.worst_bins(verdict))
    if verdicts:
        _say(
            f"L2: root mean square over projected solid angle. log-RMS: of ln(measured / model) above {floor:g} of "
            "the peak; 0.1 is a typical factor of 1.1. chi2: mean square in standard errors, 1 if there is nothing "
            "but noise; MC: with Monte Carlo noise alone. Noise leaves 5 % of the bins outside their interval."
        )
        for verdict in verdicts:
            _say(f"{tables.name_of(verdict.model)}: {verdict.conclusion()}")
    if len(verdicts) > 1:
        _show("All models, the best lobe first", tables.ranking(verdicts))
    if output is not None:
        _make_writable(output)
        for path in _save_verdicts(measurement, verdicts, output):
            print(path)
    if len(verdicts) < len(chosen):
        raise RunError(f"{len(chosen) - len(verdicts)} of {len(chosen)} models could not be compared.")


def _save_verdicts(measurement: Measurement, verdicts: Sequence[Verdict], folder: Path) -> Iterator[Path]:
    """Write the numbers and the maps of every verdict; the files."""
    from gonio import plots

    for number, verdict in enumerate(verdicts, 1):
        name = type(verdict.model).__name__
        unique = sum(type(other.model).__name__ == name for other in verdicts) == 1
        stem = folder / (name if unique else f"{name}-{number}")
        try:
            yield verdict.save(stem.with_suffix(".nc"))
            yield plots.difference(measurement, verdict, stem.with_suffix(".png"))
        except OSError as error:
            raise RunError(f"{folder} cannot be written ({_reason(error)}).") from None


@app.command
def fit(
    file: Path,
    /,
    *,
    models: ModelNames,
    free: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)] = (),
    theta_i: Annotated[tuple[float, ...], Parameter(negative="", show_default=False)] = (),
    wavelength: Annotated[tuple[float, ...], Parameter(negative="", show_default=False)] = (),
    output: Output = None,
) -> None:
    """Adjust models to a measurement: parameters with 95 % intervals, and which model does best.

    Intervals include the noise and the misfit of a model that is not the
    truth. Several models are ranked by Akaike's information criterion. Of a
    file that comes from elsewhere the material must be said.

      --model cook-torrance
      --model "cook-torrance material.name=Au"
      --model "cook-torrance k_d=0.1 k_s=0.9" --free m --free k_d

    Parameters
    ----------
    file
        The measurement, a .nc file.
    models
        A model, as often as needed, with settings where the fit starts or what stays as it is.
    free
        What is adjusted, such as m, k_d, distribution.alpha, material.eta; each model's roughness if not given.
    theta_i
        Fit these incidences only, degrees.
    wavelength
        Fit these wavelengths only, nm.
    output
        A TOML file for the fitted models; gonio compare --model reads it.
    """
    from gonio import tables
    from gonio.experiment import InputError, models_for, write_models
    from gonio.fitting import fit as fitted
    from gonio.fitting import rank

    measurement = _load(file)
    if output is not None:
        _make_writable(output.parent)
    fits, mistakes = [], []
    for model in models_for(measurement, models, to_fit=True):
        with _working(f"fitting {tables.name_of(model)}"):
            try:
                fits.append(fitted(measurement, model, free or None, theta_i or None, wavelength or None))
            except ValueError as error:
                mistakes.append(str(error))
    if mistakes:
        raise InputError(*mistakes)
    for found in fits:
        _show(f"{tables.name_of(found.model)}, fitted to {tables.light(found.order)}", tables.parameters(found))
        _show("Correlations", tables.correlations(found))
        for sentence in found.remarks():
            _say(sentence)
    for order in dict.fromkeys(found.order for found in fits):
        alike = [found for found in fits if found.order == order]
        if len(alike) > 1:
            _show(f"Models of {tables.light(order)}, the best first", tables.ranked(rank(alike)))
            _say(
                "QAICc: Akaike's information criterion, lower is better; its uncertainty is how blocks of bins "
                "disagree about the difference."
            )
    if output is not None:
        try:
            print(write_models([found.model for found in fits], output))
        except OSError as error:
            raise RunError(f"{output} cannot be written ({_reason(error)}).") from None


# --- check, validate -------------------------------------------------------------------------------------------------


@app.command
def check(file: Path, /) -> None:
    """Recompute the certificate of a measurement: energy, bookkeeping, reciprocity, facets, settings.

    Exit code 1 if a check fails. A warning says where the settings limit what
    may be concluded.

    Parameters
    ----------
    file
        The measurement, a .nc file.
    """
    from gonio import tables
    from gonio.certificate import certify_file
    from gonio.experiment import InputError

    try:
        certificate = certify_file(file)
    except ValueError as error:
        raise InputError(str(error)) from None
    _show(f"Certificate of {file}", tables.checks(certificate))
    _say(certificate.summary()[0])
    _insist(certificate, file)


def _insist(certificate: Certificate, file: Path) -> None:
    """Raise `RunError` if a check of this file has failed."""
    if not certificate.passed:
        raise RunError(f"{file} fails: {', '.join(certificate.failed)}. Do not use its numbers.")


@app.command
def validate(
    *,
    quick: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    case: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)] = (),
    output: Output = None,
) -> None:
    """Measure surfaces whose reflection is known exactly, and judge the instrument by them.

    Exit code 1 if a law fails. Seeds are fixed: it gives the same rows again.

    Parameters
    ----------
    quick
        Smaller surfaces and fewer paths: about two minutes.
    case
        Only the cases whose name contains this, as often as needed.
    output
        A Markdown file for the table.
    """
    from gonio import tables
    from gonio.experiment import InputError
    from gonio.validate import CASES, Row, markdown
    from gonio.validate import run as measured
    from microsurfaces.files import replacing

    if output is not None:
        _make_writable(output.parent)
    names = [one.name for one in CASES if not case or any(part.lower() in one.name.lower() for part in case)]
    if not names:
        raise InputError(f"--case {' '.join(case)}: no such case; they are {'; '.join(one.name for one in CASES)}.")
    started, rows, interrupted = time.monotonic(), list[Row](), False
    with _cases() as show:
        try:
            for done, name in enumerate(names):
                show(name, done / len(names))
                rows += measured(quick, (name,))
        except KeyboardInterrupt:
            interrupted = True
    for name, group in itertools.groupby(rows, key=lambda row: row.case):
        _show(name, tables.validation(group))
    failures = sum(row.verdict == "FAILS" for row in rows)
    _say(
        f"{len(rows)} numbers in {time.monotonic() - started:.0f} s, {failures} fail. Scores are Student's t, the "
        "excess of chi2 per bin in units of its scatter, or a difference that has a stated bound; 'rejected' are wrong "
        "formulas that the same test must see through."
    )
    if output is not None:
        with replacing(output) as path:
            path.write_text(markdown(rows), encoding="utf-8")
        print(output)
    if interrupted:
        raise RunError(f"Interrupted after {len({row.case for row in rows})} of {len(names)} cases.")
    if failures:
        raise RunError(f"{failures} of {len(rows)} numbers are not as they should be.")


@contextlib.contextmanager
def _working(words: str) -> Iterator[None]:
    """Say on a terminal what takes a while."""
    if not sys.stderr.isatty():
        yield
        return
    with Console(stderr=True).status(words):
        yield


@contextlib.contextmanager
def _cases() -> Iterator[Callable[[str, float], None]]:
    """A bar on a terminal, a line a case elsewhere, both on stderr."""
    if not sys.stderr.isatty():

        def show(name: str, share: float) -> None:
            _complain(0, f"{share:4.0%} {name}")

        yield show
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("compiling", total=1.0)
        yield lambda name, share: bar.update(task, completed=share, description=name)


# --- plot, export ---------------------------------------------------------------------------------------------------


@app.command
def plot(
    file: Path,
    /,
    *,
    kind: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)] = (),
    models: ModelNames = (),
    wavelength: float | None = None,
    log: Annotated[bool | None, Parameter(negative="--linear", show_default=False)] = None,
    orders: Flag = False,
    overlaid: Flag = False,
    true_colour: Flag = False,
    ground: Flag = False,
    theta_i: float | None = None,
    show: Flag = False,
    output: Output = None,
) -> None:
    """Draw a measurement: lobes.png, slices.png, hemisphere.png and albedo.png, or the kinds that are asked for.

      lobes       scattered light as surfaces in space
      slice       the BRDF in the plane of incidence, with error bars and models
      hemisphere  maps of the BRDF and of its errors, seen from above
      albedo      all the light that is sent back, against the angle of incidence
      difference  where models are above or below what was measured
      sphere      what the material looks like, beside models
      surface     the microsurface and its statistics
      paths       light on a section of the microsurface

    Parameters
    ----------
    file
        The measurement: a .nc file, or a foreign file that gonio reads; of an experiment, a .toml file, surface and
        paths are drawn.
    kind
        What to draw, as often as needed.
    models
        A model, as often as needed, as for gonio compare; lobes have those beside them that are named here.
    wavelength
        Of lobes, maps and differences, nm; the measured one nearest to 550 if not given.
    log
        Draw lobes with a logarithmic or a linear radius; what suits them if not given.
    orders
        Nest lobes of 1, 2 and more hits.
    overlaid
        Put the lobes of all incidences into one another.
    true_colour
        Colour lobes as the eye sees them.
    ground
        Draw the microsurface under the lobes.
    theta_i
        The lamp's angle for paths, degrees; 45 if not given.
    show
        Open a window, too, with the lobes or the surface.
    output
        Folder for the pictures; the measurement's own if not given. For a single kind also a file: .png .svg .pdf;
        lobes moving as .gif .mp4, or for other programs as .gltf .glb .vtp.
    """
    kinds = tuple(dict.fromkeys(map(_kind, kind)))
    given = {
        "wavelength": wavelength,
        "radius": None if log is None else "log" if log else "linear",
        "orders": orders,
        "overlaid": overlaid,
        "true_colour": true_colour,
        "ground": ground,
        "theta_i": theta_i,
        "show": show,
    }
    options = {name: value for name, value in given.items() if value not in (None, False)}
    _check_options(kinds or UNASKED, options)
    pictures = list(_pictures(file, kinds, models, options))
    for name, path, draw in _placed(pictures, output, file.parent, bool(kinds)):
        _draw_one(name, path, draw, bool(kinds))


def _kind(name: str) -> str:
    """A kind of picture; `InputError` with the nearest one for anything else."""
    from difflib import get_close_matches

    from gonio.experiment import InputError

    if name in KINDS:
        return name
    near = get_close_matches(name.lower(), KINDS, 1, 0.5)
    hint = f"did you mean {near[0]}?" if near else f"choose {', '.join(KINDS)}."
    raise InputError(f"--kind {name}: there is no such picture; {hint}")


def _check_options(kinds: Sequence[str], options: Mapping[str, Any]) -> None:
    """Raise `InputError` for an option that none of the kinds has."""
    from gonio.experiment import InputError

    flags = {"radius": "--log or --linear"}
    for name in options:
        having = [kind for kind, names in KIND_OPTIONS.items() if name in names]
        if not set(having) & set(kinds):
            flag = flags.get(name, f"--{name.replace('_', '-')}")
            raise InputError(f"{flag} means nothing here: add --kind {' or --kind '.join(having)}.")


def _pictures(
    file: Path, kinds: Sequence[str], models: Sequence[str], options: Mapping[str, Any]
) -> Iterator[tuple[str, Callable[..., Any]]]:
    """The names of the pictures, and functions that draw them into a path."""
    from gonio import plots
    from gonio.experiment import models_for

    wanted = set(kinds or UNASKED)
    experiment = _experiment_behind(file) if "ground" in options or wanted & OF_SURFACES else None
    measurement = _load(file) if wanted - OF_SURFACES else None
    chosen = () if measurement is None else models_for(measurement, models or None)
    for kind in kinds or UNASKED:
        draw = getattr(plots, KINDS[kind])
        extra = {name: value for name, value in options.items() if name in KIND_OPTIONS.get(kind, ())}
        if kind in OF_SURFACES:
            assert experiment is not None
            if extra.pop("show", False):
                _open_window(experiment.relief())
            yield kind, partial(draw, experiment.surface, seed=experiment.surface_seed, **extra)
            continue
        assert measurement is not None
        if kind == "difference":
            yield from _differences(measurement, chosen, partial(draw, **extra))
        elif kind == "hemisphere":
            yield kind, partial(draw, measurement, **extra)
        elif kind == "lobes":
            under = {"ground": _height_field(experiment)} if experiment is not None and "ground" in extra else {}
            yield kind, partial(draw, measurement, models=chosen if models else (), **{**extra, **under})
        else:
            yield KINDS[kind], partial(draw, measurement, models=chosen, **extra)


def _differences(
    measurement: Measurement, models: Sequence[Model], draw: Callable[..., Any]
) -> Iterator[tuple[str, Callable[..., Any]]]:
    """One picture a model."""
    from gonio.compare import compare
    from gonio.experiment import InputError

    if not models:
        raise InputError(
            "No model describes this specimen by itself; name one with --model, such as "
            '--model "cook-torrance m=0.3 material.name=Au".'
        )
    names = [type(model).__name__ for model in models]
    for number, (model, name) in enumerate(zip(models, names, strict=True), 1):
        stem = "difference" if len(models) == 1 else f"difference-{name}"
        stem = stem if names.count(name) == 1 else f"{stem}-{number}"
        yield stem, lambda path, model=model: draw(measurement, compare(measurement, model), path)


def _placed(
    pictures: Sequence[tuple[str, Callable[..., Any]]], output: Path | None, home: Path, asked: bool
) -> Iterator[tuple[str, Path, Callable[..., Any]]]:
    """Pictures with the files that they go into: one file, or .png files in a folder, which is made."""
    from gonio.experiment import InputError

    file = output is not None and bool(output.suffix) and not output.is_dir()
    if output is not None and file and asked and len(pictures) == 1:
        _make_writable(output.parent)
        yield pictures[0][0], output, pictures[0][1]
        return
    if output is not None and output.suffix.lower() in PICTURE_SUFFIXES and not output.is_dir():
        raise InputError(f"{output}: {len(pictures)} pictures need a folder; choose a single one with --kind.")
    folder = output or home
    _make_writable(folder)
    for name, draw in pictures:
        yield name, folder / f"{name}.png", draw


def _draw_one(name: str, path: Path, draw: Callable[..., Any], asked: bool) -> None:
    """Draw and tell the file; what cannot be drawn is an error only if it was asked for."""
    from gonio.experiment import InputError

    try:
        with _working(f"drawing {path}"):
            draw(path)
    except ValueError as error:
        if asked:
            raise InputError(f"{name}: {error}.") from None
        _complain(0, f"No {path.name}: {error}")
    except RuntimeError as error:
        raise RunError(f"No window: {error}") from None
    except OSError as error:
        raise RunError(f"{path} cannot be written ({_reason(error)}).") from None
    else:
        print(path)


def _experiment_behind(file: Path) -> Experiment:
    """The experiment in a .toml file, or the one that a measurement was made with."""
    from pydantic import TypeAdapter, ValidationError

    from gonio.experiment import Experiment, InputError

    if file.suffix.lower() == ".toml":
        return Experiment.read(file)
    try:
        return TypeAdapter(Experiment).validate_json(_load(file).attributes["experiment"])
    except (KeyError, ValidationError):
        raise InputError(
            f"{file}: its surface has no recipe, which only a measurement by gonio run has; give an experiment's .toml."
        ) from None


def _height_field(experiment: Experiment) -> HeightField:
    """The relief to draw under a lobe; `InputError` for a surface that is none."""
    from gonio.experiment import InputError
    from microsurfaces import HeightField

    relief = experiment.relief()
    if not isinstance(relief, HeightField):
        raise InputError("--ground: the surface is a mesh, not a height field; leave it out, or draw --kind surface.")
    return relief


@app.command
def report(file: Path, /, *, models: ModelNames = (), output: Output = None) -> None:
    """Make one HTML page of a measurement, to look at, to print and to send.

    It holds a summary in words, pictures, a lobe that turns with the mouse,
    tables, the comparison with models, the self-checks and the experiment, and
    works offline from disk.

    Parameters
    ----------
    file
        The measurement: a .nc file, or a foreign file that gonio reads.
    models
        A model, as often as needed, as for gonio compare; those that fit the material if not given.
    output
        The page; report.html beside the measurement if not given.
    """
    from gonio.experiment import InputError, models_for
    from gonio.report import report as write

    measurement, page = _load(file), output or file.parent / "report.html"
    if page.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{page}: a report is a page; give a name that ends with .html.")
    chosen = models_for(measurement, models or None)
    _make_writable(page.parent)
    command = ["gonio", "report", file.name, *(word for name in models for word in ("--model", name))]
    try:
        with _working(f"writing {page}"):
            print(write(measurement, page, chosen, command=shlex.join(command)))
    except ValueError as error:
        raise InputError(str(error)) from None
    except OSError as error:
        raise RunError(f"{page} cannot be written ({_reason(error)}).") from None


@app.command
def export(
    file: Path,
    /,
    *,
    to: Path,
    format: str | None = None,
    isotropic: Annotated[bool, Parameter(negative="", show_default=False)] = False,
) -> None:
    """Write a measurement in another program's format, and tell what that cost.

    The file is read back as its usual readers do, and compared with the
    measurement on the measurement's own bins. gonio list shows the formats.

    Parameters
    ----------
    file
        The measurement: a .nc file, or a foreign file that gonio reads.
    to
        The file to write; its suffix decides the format.
    format
        A format that decides instead, such as exr-rgb.
    isotropic
        Declare that the surface looks the same from every azimuth of the light.
    """
    from gonio import formats
    from gonio.experiment import InputError

    measurement = _load(file)
    _make_writable(to.parent)
    try:
        with _working(f"writing {to}"):
            exported = formats.export(measurement.declared_isotropic() if isotropic else measurement, to, format)
        print(exported.path)
        with _working(f"reading {to} back"):
            sentences = (*exported.notes, exported.loss.sentence())
    except ValueError as error:
        raise InputError(str(error)) from None
    except OSError as error:
        raise RunError(f"{to} cannot be written ({_reason(error)}).") from None
    for sentence in sentences:
        _say(sentence)


def _load(file: Path) -> Measurement:
    """The measurement in a file, ours or a foreign one."""
    from gonio.experiment import InputError
    from gonio.formats import load

    try:
        return load(file)
    except ValueError as error:
        raise InputError(str(error)) from None


# --- render ----------------------------------------------------------------------------------------------------------


@app.command
def render(
    file: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    scene: str = "sphere",
    size: int = 512,
    spp: int = 256,
    seed: int = 0,
    isotropic: Annotated[bool, Parameter(negative="", show_default=False)] = False,
) -> None:
    """Path-trace a scene made of a measured surface, with Mitsuba 3 (pip install mitsuba).

    A lamp and a clear sky shine on it; light is reflected as often as it
    likes. gonio plot draws a sphere without Mitsuba.

    Parameters
    ----------
    file
        The measurement: a .nc file, a foreign file that gonio reads, or a .bsdf file of RGL's, taken as it is.
    output
        The picture: .png, exposed for a screen, or .exr, radiances in linear sRGB.
    scene
        sphere or cylinder on a floor, or ball, a sphere alone seen from afar.
    size
        Width and height in pixels.
    spp
        Paths per pixel.
    seed
        Seed of the paths.
    isotropic
        Declare that the surface looks the same from every azimuth of the light.
    """
    from gonio.experiment import InputError
    from gonio.render import render as rendered

    source: Measurement | Path = file
    if file.suffix.lower() != ".bsdf":
        source = _load(file).declared_isotropic() if isotropic else _load(file)
    _make_writable(output.parent)
    try:
        with _working(f"rendering {output}"):
            print(rendered(source, output, scene, size, spp, seed))
    except ValueError as error:
        raise InputError(str(error)) from None
    except RuntimeError as error:
        raise RunError(str(error)) from None
    except OSError as error:
        raise RunError(f"{output} cannot be written ({_reason(error)}).") from None


# --- campaign --------------------------------------------------------------------------------------------------------

campaigns = App(name="campaign", help="Data sets of many measurements that survive anything: run, continue, merge.")
app.command(campaigns)


@campaigns.command(name="run")
def campaign_run(
    file: Path,
    /,
    *,
    overrides: Overrides = (),
    workers: int = 0,
    shard: str = "1/1",
    threads: int | None = None,
    output: Output = None,
    quiet: Annotated[bool, Parameter(negative="", show_default=False)] = False,
) -> None:
    """Measure all that a campaign file asks for, or what is still missing of it.

    Every incidence of every specimen is a file in DIR/units as soon as it is
    measured. The same command continues after Ctrl-C, a crash or a full disk.
    Several runs may share a folder; results are the same to the last bit.

    Parameters
    ----------
    file
        The campaign, a TOML file such as those in configs/campaigns/.
    overrides
        Put a value in place of the base experiment's: --set goniometer.paths=10000
    workers
        Processes that share the cores; 0 measures in this one, with all cores.
    shard
        Compute the i-th of n parts only, i/n, for the jobs of an array: --shard 2/7
    threads
        Threads to use, of each worker if there are any.
    output
        Folder of the campaign; out/NAME if not given, where NAME.toml is the file.
    quiet
        Print nothing but errors.
    """
    from gonio.campaign.engine import State
    from gonio.campaign.engine import run as run_campaign
    from gonio.campaign.sweep import Campaign
    from gonio.experiment import InputError

    for name, number, least in (("workers", workers, 0), ("threads", threads, 1)):
        if number is not None and number < least:
            raise InputError(f"--{name} {number}: must be {least} or more.")
    part = _shard(shard)
    campaign, folder = Campaign.read(file, overrides), output or Path("out") / file.stem
    _check_writable(folder)
    started, latest = time.monotonic(), list[State]()
    with _campaign_progress(quiet) as show:

        def report(state: State) -> None:
            latest[:] = [state]
            show(state)

        try:
            state = run_campaign(campaign, folder, workers=workers, shard=part, threads=threads, report=report)
        except KeyboardInterrupt:
            done = f"{latest[0].kept + latest[0].computed} of {latest[0].units}" if latest else "finished"
            raise RunError(f"Interrupted: {done} units are kept in {folder}; the same command continues.") from None
        except OSError as error:
            raise RunError(
                f"{folder} cannot be written ({_reason(error)}): finished units are kept, the same command continues."
            ) from None
    if state.changed:
        _complain(0, f"{folder} held another campaign: of its units those that this one asks for were kept.")
    if state.deaths:
        _complain(0, f"{state.deaths} workers died and were replaced.")
    if state.failures:
        _complain(0, *state.failures[:20])
        raise RunError(f"{len(state.failures)} of {state.units} units could not be computed; the others are kept.")
    if not quiet:
        _say(
            f"{state.units} units: {state.kept} were there, {state.computed} computed in "
            f"{time.monotonic() - started:.1f} s. Put them together with: gonio campaign merge {folder}"
        )


def _shard(text: str) -> tuple[int, int]:
    """(i, n) of "i/n"."""
    from gonio.experiment import InputError

    number, slash, shards = text.partition("/")
    if not (slash and number.isdecimal() and shards.isdecimal() and 1 <= int(number) <= int(shards)):
        raise InputError(f"--shard {text}: must be i/n with i from 1 to n, such as 2/7.")
    return int(number), int(shards)


@contextlib.contextmanager
def _campaign_progress(quiet: bool) -> Iterator[Callable[[Any], None]]:
    """How far the campaign is: a bar on a terminal, a line every few seconds elsewhere, both on stderr."""
    started = last = time.monotonic()

    def words(state: Any) -> str:
        rate = state.rays / max(time.monotonic() - started, 1e-3)
        return f"{state.kept + state.computed} of {state.units} units, {_rate(rate)}"

    def line(state: Any) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= PLAIN_PROGRESS_SECONDS and state.paths_done:
            last = now
            left = (now - started) * max(state.paths - state.paths_done, 0) / state.paths_done
            _complain(0, f"{state.paths_done / state.paths:4.0%} done, {words(state)}, {_duration(left)} left")

    if quiet:
        yield lambda state: None
    elif not sys.stderr.isatty():
        yield line
    else:
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

        columns = (BarColumn(None), TaskProgressColumn(), TextColumn("{task.description}"), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), expand=True) as bar:
            task = bar.add_task("building the surface", total=None)
            yield lambda state: bar.update(
                task, completed=state.paths_done, total=state.paths, description=words(state)
            )


def _duration(seconds: float) -> str:
    """A time that people can read: 40 s, 12 min, 3.4 h."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


@campaigns.command(name="status")
def campaign_status(folder: Path, /) -> None:
    """Tell how far a campaign is, and which runs work on it.

    Parameters
    ----------
    folder
        The campaign's folder.
    """
    from gonio.campaign.folder import Folder, status

    found = status(Folder(folder))
    if found.title:
        _say(found.title, style="bold")
    share = found.paths_finished / found.paths
    _say(
        f"{found.units_finished} of {found.units} units are finished, {share:.0%} of the paths; "
        f"{found.experiments_finished} of {found.experiments} experiments are complete."
    )
    for run, units in found.runs.items():
        _say(f"{run}: {units} unit{'s' * (units > 1)} under way.")


@campaigns.command(name="verify")
def campaign_verify(folder: Path, /) -> None:
    """Read every finished unit and check it; damaged ones are set aside, so that the next run computes them.

    Parameters
    ----------
    folder
        The campaign's folder.
    """
    from gonio.campaign.folder import Folder, verify

    try:
        sound, sentences = verify(Folder(folder))
    except OSError as error:
        raise RunError(f"{folder} cannot be read or written ({_reason(error)}).") from None
    _complain(0, *sentences)
    _say(f"{sound} unit{'s' * (sound != 1)} {'are' if sound != 1 else 'is'} sound.")
    if sentences:
        raise RunError(f"{len(sentences)} units were damaged: run the campaign again, which computes them.")


@campaigns.command(name="merge")
def campaign_merge(folder: Path, /) -> None:
    """Put finished units together: one measurement for each experiment, and index.csv with their parameters.

    Parameters
    ----------
    folder
        The campaign's folder; DIR/measurements is written.
    """
    from gonio.campaign.results import merge

    try:
        with _working(f"merging {folder}"):
            merged = merge(folder)
    except OSError as error:
        raise RunError(f"{folder} cannot be read or written ({_reason(error)}).") from None
    _complain(0, *merged.damaged)
    if len(merged.processors) > 1:
        _complain(
            0,
            f"Units were computed on different processors ({', '.join(sorted(merged.processors))}): their last bits "
            "may not be those of a single machine.",
        )
    _say(f"{len(merged.files)} measurements and index.csv in {folder / 'measurements'}{os.sep}")
    if merged.incomplete:
        raise RunError(
            f"{merged.incomplete} of {merged.incomplete + len(merged.files)} experiments lack units: run the campaign "
            "again."
        )


# --- list ------------------------------------------------------------------------------------------------------------


@app.command(name="list")
def list_(name: str | None = None, /) -> None:
    """Show every surface, material, detector and model with its parameters and their defaults, and every file format.

    Parameters
    ----------
    name
        One of them, shown with its whole description.
    """
    from gonio.experiment import InputError
    from gonio.formats import FORMATS
    from microsurfaces.recipe import did_you_mean

    catalogue = _catalogue()
    known = {cls.__name__: cls for classes in catalogue.values() for cls in classes}
    if name is None:
        for heading, classes in catalogue.items():
            _say(f"{heading}\n", style="bold")
            for cls in classes:
                _describe(cls, (cls.__doc__ or "").partition("\n")[0])
        _list_materials()
        _list_formats()
    elif name in known:
        _describe(known[name], _reflowed(inspect.cleandoc(known[name].__doc__ or "")))
    elif name in FORMATS:
        _say(name, style="bold")
        _say(f"{FORMATS[name].title} ({FORMATS[name].suffix})\n\n{_reflowed(FORMATS[name].page)}")
    else:
        names = (*known, *FORMATS)
        raise InputError(f"{name} is none of {', '.join(names)}{did_you_mean(name, names)}")


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


def _list_formats() -> None:
    """What `gonio export` writes, and gonio reads wherever it reads a measurement."""
    from rich.table import Table
    from rich.text import Text

    from gonio.formats import FORMATS

    _say("Formats: gonio export FILE --to NAME.SUFFIX, --format for other than the first of a suffix\n", style="bold")
    table = Table.grid(padding=(0, 2, 0, 0))
    for name, format in FORMATS.items():
        table.add_row(*map(Text, (f"  {name}", format.suffix, format.title)))
    _console().print(table)


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
