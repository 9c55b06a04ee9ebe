"""`gonio compare | fit | check | validate`: models, results and the instrument itself are judged."""

from __future__ import annotations

import contextlib
import itertools
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.console import Console

from gonio.cli.terminal import (
    Flag,
    Models,
    Numbers,
    Output,
    RunError,
    Words,
    app,
    check_writable,
    complain,
    load_measurement,
    make_room,
    make_writable,
    refuse_folder,
    say,
    show_table,
    telling_mistakes,
    telling_refusals,
    working,
)
from gonio.toml_files import InputError

if TYPE_CHECKING:
    from gonio.comparison import Comparison
    from gonio.fitting import Fit
    from gonio.measurement import Measurement
    from gonio.models import Model
    from gonio.self_check import SelfCheckReport


def models_to_compare(
    measurement: Measurement, names: Sequence[str] | None
) -> tuple[tuple[Model, ...], tuple[str, ...]]:
    """The models to compare with, and why there are none: a measurement is worth keeping all the same."""
    from gonio.models.specimen import models_for

    try:
        return models_for(measurement, names), ()
    except InputError as error:
        return (), error.sentences


def judge(measurement: Measurement, models: Sequence[Model], relative_threshold: float = 0.01) -> list[Comparison]:
    """How each model compares with the light it describes; why one could not be compared is told."""
    from gonio import tables
    from gonio.comparison import compare

    comparisons = []
    for model in models:
        try:
            with working(f"comparing with {tables.name_of(model)}"):
                comparisons.append(compare(measurement, model, relative_threshold))
        except ValueError as error:
            complain(0, f"{tables.name_of(model)}: {error}")
    return comparisons


def show_comparisons(comparisons: Sequence[Comparison], every_wavelength: bool = False) -> None:
    """Print how each model compares, and which differences are significant."""
    from gonio import tables

    for comparison in comparisons:
        heading = f"{tables.name_of(comparison.model)} against {tables.light(comparison.order)}"
        show_table(heading, tables.comparison(comparison, every_wavelength))
    if comparisons:
        say(
            ("" if every_wavelength else "Of every incidence the wavelength whose albedo differs most; ")
            + "in brackets the standard error of its last digits. L1: how far the lobes differ, and how far noise "
            "alone would make them. Consistent: noise explains the difference; significant: it does not; "
            "inconclusive: specimens that move the whole lobe could, more realisations would tell; unknown: there are "
            "no errors."
        )
        for sentence in dict.fromkeys(line for comparison in comparisons for line in comparison.preamble()):
            say(sentence)


@app.command
def compare(
    file: Path,
    /,
    *,
    models: Models = (),
    all: Flag = False,
    relative_threshold: float = 0.01,
    output: Output = None,
) -> None:
    """Compare closed-form models with a measurement, bin by bin: which are consistent with it, and which are not.

    A model is a name, with settings if need be; what is not said is the
    specimen's: its material, and the roughness measured on its facets. An
    external file tells neither, so both must be said.

      --model cook-torrance
      --model "cook-torrance m=0.35 material.name=Au"
      --model "cook-torrance m=0.35 k_d=0.1"
      --model "microfacet distribution.kind=GGX masking.kind=VCavity"
      --model models.toml     with tables [[model]]

    Parameters
    ----------
    file
        The measurement: a .nc file, or another program's file that gonio reads.
    models
        A model, as often as needed; those that describe the specimen if not given.
    all
        Show every wavelength, not only the one that differs most.
    relative_threshold
        Share of a lobe's peak below which logarithms are not compared, from 0 to below 1.
    output
        Folder for MODEL.nc, every number and every bin of a comparison, and MODEL.png, maps of the difference.
    """
    from gonio import tables
    from gonio.models.specimen import models_for

    if not 0.0 <= relative_threshold < 1.0:
        raise InputError(
            f"--relative-threshold {relative_threshold:g}: must be 0 or more and less than 1, a share of the peak."
        )
    if output is not None:
        check_writable(output)
    measurement = load_measurement(file)
    chosen = models_for(measurement, models or None)
    if not chosen:
        raise InputError(
            f"{file}: no model describes this specimen by itself; name one with --model, such as "
            '--model "cook-torrance m=0.3 material.name=Au".'
        )
    comparisons = judge(measurement, chosen, relative_threshold)
    show_comparisons(comparisons, all)
    for comparison in comparisons:
        show_table(f"{tables.name_of(comparison.model)}, other measures of the lobe", tables.metrics(comparison, all))
        show_table("The bins that add most to L1, significant at 3 standard errors", tables.worst_bins(comparison))
    if comparisons:
        say(
            "L2: root mean square over projected solid angle. log-RMS: of ln(measured / model) above "
            f"{relative_threshold:g} of the peak; 0.1 is a typical factor of 1.1. Reduced chi²: mean square in "
            "standard errors, 1 if there is nothing but noise; MC: with Monte Carlo noise alone. Noise leaves 5 % of "
            "the bins outside their interval."
        )
        for comparison in comparisons:
            say(f"{tables.name_of(comparison.model)}: {comparison.conclusion()}")
    if len(comparisons) > 1:
        show_table("All models, the best lobe first", tables.ranking(comparisons))
    if output is not None:
        make_writable(output)
        for path in _save_comparisons(measurement, comparisons, output):
            print(path)
    if len(comparisons) < len(chosen):
        raise RunError(f"{len(chosen) - len(comparisons)} of {len(chosen)} models could not be compared.")


def _save_comparisons(measurement: Measurement, comparisons: Sequence[Comparison], folder: Path) -> Iterator[Path]:
    """Write the numbers and the maps of every comparison; the files."""
    from gonio import plots

    for number, comparison in enumerate(comparisons, 1):
        name = type(comparison.model).__name__
        unique = sum(type(other.model).__name__ == name for other in comparisons) == 1
        stem = folder / (name if unique else f"{name}-{number}")
        with telling_refusals(folder):
            yield comparison.save(stem.with_suffix(".nc"))
            plots.difference(measurement, comparison, stem.with_suffix(".png"))
        yield stem.with_suffix(".png")


@app.command
def fit(
    file: Path,
    /,
    *,
    models: Models,
    free: Words = (),
    theta_i: Numbers = (),
    wavelength: Numbers = (),
    to: Annotated[tuple[Path, ...], Parameter(negative="", show_default=False)] = (),
) -> None:
    """Adjust models to a measurement: parameters with 95 % intervals, and which model does best.

    Intervals include the noise and the lack of fit of a model that is not the
    truth. Several models are ranked by Akaike's information criterion. Of an
    external file the material must be said.

      --model cook-torrance
      --model "cook-torrance material.name=Au"
      --model "cook-torrance k_d=0.1 k_s=0.9" --free m --free k_d

    Parameters
    ----------
    file
        The measurement: a .nc file, or another program's file that gonio reads.
    models
        A model, as often as needed, with settings where the fit starts or what stays as it is.
    free
        What is adjusted, as often as needed: m, k_d, distribution.alpha, material.eta ...; roughness if not given.
    theta_i
        Fit these incident angles only, one or several, degrees; all if not given.
    wavelength
        Fit these wavelengths only, one or several, nm; all if not given.
    to
        A file, as often as needed: .toml for the models, to be compared with --model, or .png .svg .pdf for a picture.
    """
    from gonio import tables
    from gonio.fitting import fit as fitted
    from gonio.models.specimen import models_for

    measurement = load_measurement(file)
    _check_fit_files(to)
    fits, mistakes = [], []
    for model in models_for(measurement, models, to_fit=True):
        with working(f"fitting {tables.name_of(model)}"):
            try:
                fits.append(fitted(measurement, model, free or None, theta_i or None, wavelength or None))
            except ValueError as error:
                mistakes.append(str(error))
    if mistakes:
        raise InputError(*mistakes)
    _show_fits(fits)
    for path in to:
        print(_write_fits(measurement, fits, path))


def _check_fit_files(files: Sequence[Path]) -> None:
    """Refuse, before the fit, what no fit can be written to."""
    from gonio.plots.style import check_path

    for path in files:
        make_room(path)
        if path.suffix.lower() != ".toml":
            try:
                check_path(path)
            except ValueError as error:
                raise InputError(f"--to {path}: {error}; models are written to .toml") from None


def _show_fits(fits: Sequence[Fit]) -> None:
    """Print the parameters of every fit, and which model of the same light does best."""
    from gonio import tables
    from gonio.fitting import rank

    for found in fits:
        show_table(f"{tables.name_of(found.model)}, fitted to {tables.light(found.order)}", tables.parameters(found))
        show_table("Correlations", tables.correlations(found))
        for sentence in found.remarks():
            say(sentence)
    for order in dict.fromkeys(found.order for found in fits):
        alike = [found for found in fits if found.order == order]
        if len(alike) > 1:
            show_table(f"Models of {tables.light(order)}, the best first", tables.ranked(rank(alike)))
            say(
                "QAICc: Akaike's information criterion, lower is better; its uncertainty is how blocks of bins "
                "disagree about the difference."
            )


def _write_fits(measurement: Measurement, fits: Sequence[Fit], path: Path) -> Path:
    """Write the fitted models, or draw them, as the suffix says; the path."""
    from gonio import plots
    from gonio.models.specimen import write_models

    if path.suffix.lower() == ".toml":
        with telling_refusals(path):
            return write_models([found.model for found in fits], path)
    with telling_mistakes(), telling_refusals(path), working(f"drawing {path}"):
        plots.fits(measurement, fits, path)
    return path


@app.command
def check(file: Path, /) -> None:
    """Self-check of one measurement: energy budget, sums, reciprocity, facets, settings.

    Exit code 1 if a check fails. A warning says where the settings limit what
    may be concluded.

    Parameters
    ----------
    file
        The measurement, a .nc file.
    """
    from gonio import tables
    from gonio.self_check import check_file

    refuse_folder(file)
    with telling_mistakes():
        report = check_file(file)
    show_table(f"Self-check report of {file}", tables.checks(report))
    say(report.summary()[0])
    insist(report, file)


def insist(report: SelfCheckReport, file: Path) -> None:
    """Raise `RunError` if a check of this file has failed."""
    if not report.passed:
        raise RunError(f"{file} fails: {', '.join(report.failed)}. Do not use its numbers.")


@app.command
def validate(
    *,
    quick: Flag = False,
    case: Words = (),
    to: Path | None = None,
) -> None:
    """Validate this installation: measure surfaces whose reflection is known exactly.

    Exit code 1 if a number is not as it should be. Seeds are fixed: it gives
    the same rows again.

    Parameters
    ----------
    quick
        Smaller surfaces and fewer paths: about two minutes.
    case
        Only the cases whose name contains this, as often as needed; all if not given.
    to
        A Markdown file (.md) for the table; only printed if not given.
    """
    from gonio import tables, validation
    from microsurfaces.atomic_write import atomic_write

    if to is not None:
        if to.suffix.lower() != ".md":
            raise InputError(f"--to {to}: the table is Markdown; give a name that ends with .md.")
        make_room(to)
    known = [one.name for one in validation.CASES]
    names = [name for name in known if not case or any(part.lower() in name.lower() for part in case)]
    if not names:
        raise InputError(f"--case {' '.join(case)}: no such case; they are {'; '.join(known)}.")
    started, rows, interrupted = time.monotonic(), list[validation.Row](), False
    with _cases() as show:
        try:
            for done, name in enumerate(names):
                show(name, done / len(names))
                rows += validation.validate(quick, (name,))
        except KeyboardInterrupt:
            interrupted = True
    for name, group in itertools.groupby(rows, key=lambda row: row.case):
        show_table(name, tables.validation(group))
    failures = sum(row.outcome == "FAILS" for row in rows)
    say(
        f"{len(rows)} numbers in {time.monotonic() - started:.0f} s, {failures} fail. Scores are Student's t, the "
        "excess of reduced chi² over 1 in units of its scatter, or a difference that has a stated bound; 'rejected' "
        "are wrong formulas that the same test must see through."
    )
    if to is not None:
        with telling_refusals(to), atomic_write(to) as path:
            path.write_text(validation.markdown(rows), encoding="utf-8")
        print(to)
    if interrupted:
        raise RunError(f"Interrupted after {len({row.case for row in rows})} of {len(names)} cases.")
    if failures:
        raise RunError(f"{failures} of {len(rows)} numbers are not as they should be.")


@contextlib.contextmanager
def _cases() -> Iterator[Callable[[str, float], None]]:
    """A bar on a terminal, a line a case elsewhere, both on stderr."""
    if not sys.stderr.isatty():

        def show(name: str, share: float) -> None:
            complain(0, f"{share:4.0%} {name}")

        yield show
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("compiling", total=1.0)
        yield lambda name, share: bar.update(task, completed=share, description=name)
