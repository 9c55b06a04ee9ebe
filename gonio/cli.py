"""The command line: `gonio run | surface | compare | fit | check | validate ...`. The only file that prints or exits.

Everything heavy is imported inside the command that needs it, so that `gonio --help` answers at once.
Exit codes: 0 done, 1 failed while running, 2 bad input, told in one sentence for each mistake.
"""

from __future__ import annotations

import contextlib
import inspect
import itertools
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
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

PICTURES = ("lobes", "slices", "hemisphere")
"""What is drawn of every measurement that allows it, as functions of `plots` and as files."""

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
    no_pictures: Annotated[bool, Parameter(negative="", show_default=False)] = False,
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
