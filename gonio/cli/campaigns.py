"""`gonio campaign run | status | verify | merge | publish`: many measurements in one folder."""

from __future__ import annotations

import contextlib
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter
from rich.console import Console

from gonio.cli.terminal import (
    PLAIN_PROGRESS_SECONDS,
    Flag,
    Output,
    RunError,
    app,
    check_writable,
    complain,
    rays_per_second,
    reason,
    say,
)
from gonio.toml_files import InputError

if TYPE_CHECKING:
    from gonio.campaign.queue import State
    from gonio.campaign.results import Merged, Steps
    from gonio.campaign.running import WorkerPool

CampaignFile = Annotated[Path, Parameter(help="The campaign, a TOML file such as configs/roughness_and_metal.toml.")]
CampaignFolder = Annotated[Path, Parameter(help="The campaign's folder.")]
BaseOverrides = Annotated[
    tuple[str, ...],
    Parameter(
        name="--set",
        negative="",
        show_default=False,
        help="Put a value in place of the base experiment's: --set goniometer.paths=10000",
    ),
]

campaigns = App(
    name="campaign",
    help="Data sets of many measurements that survive anything: run, continue, merge.",
    help_epilogue="Start with: gonio campaign run configs/roughness_and_metal.toml",
)


app.command(campaigns)


@campaigns.command(name="run")
def campaign_run(
    file: CampaignFile,
    /,
    *,
    overrides: BaseOverrides = (),
    workers: int = 0,
    shard: str = "1/1",
    threads: int | None = None,
    scheduler: str | None = None,
    output: Output = None,
    quiet: Flag = False,
) -> None:
    """Measure all that a campaign file asks for, or what is still missing of it.

    Every incidence of every specimen is a file in DIR/units as soon as it is
    measured. The same command continues after Ctrl-C, a crash or a full disk.
    Several runs may share a folder; results are the same to the last bit.

    With goniometer.target_error, for all experiments or swept, each incidence
    takes as many paths as the scatter of its first ones asks for, once: however
    often the run is stopped and continued, and shared among processes, shards
    and machines, paths and error bars are the same. docs/cluster.md tells about
    clusters.

    Parameters
    ----------
    workers
        Processes that share the cores; 0 measures in this one, with all cores.
    shard
        Compute the i-th of n parts only, i/n, for the jobs of an array: --shard 2/7
    threads
        Threads to use, of each worker if there are any.
    scheduler
        Address of a Dask scheduler, whose workers compute: tcp://HOST:PORT
    output
        Folder of the campaign; out/NAME if not given, where NAME.toml is the file.
    quiet
        Print nothing but errors.
    """
    from gonio.campaign.running import run as run_campaign
    from gonio.campaign.sweep import Campaign

    check_numbers(workers=(workers, 0), threads=(threads, 1))
    if scheduler is not None and (workers or threads):
        raise InputError("--scheduler: its workers have threads of their own, leave --workers and --threads out.")
    part = _shard(shard)
    campaign, folder = Campaign.read(file, overrides), output or Path("out") / file.stem
    check_writable(folder)
    started = time.monotonic()
    latest: list[State] = []
    with (
        _telling_what_is_kept(folder, latest),
        _worker_pool(workers, threads, scheduler) as pool,
        _campaign_progress(quiet) as show,
    ):

        def report(state: State) -> None:
            latest[:] = [state]
            show(state)

        state = run_campaign(campaign, folder, pool, shard=part, report=report)
    _complain_about(state, folder)
    if not quiet:
        say(
            f"{state.units} units: {state.kept} were there, {state.computed} computed in "
            f"{time.monotonic() - started:.1f} s. To put them together:"
        )
        print(f"gonio campaign merge {folder}")


@contextlib.contextmanager
def _worker_pool(workers: int, threads: int | None, scheduler: str | None) -> Iterator[WorkerPool]:
    """Who computes: the workers of a cluster, so many processes of this machine, or this process."""
    from gonio.campaign.cluster import connected
    from gonio.campaign.processes import ProcessPool
    from gonio.campaign.running import ThisProcess

    if scheduler is not None:
        with connected(scheduler) as pool:
            yield pool
    else:
        yield ProcessPool(workers, threads) if workers else ThisProcess(threads)


@contextlib.contextmanager
def _telling_what_is_kept(folder: Path, latest: Sequence[State]) -> Iterator[None]:
    """Raise `RunError` in place of what ends a run early; `latest` holds how far it is, once that is known."""
    from gonio.campaign.cluster import ClusterError

    kept = "the same command continues"
    try:
        with telling_system_errors(f"{folder} cannot be written", f"finished units are kept, {kept}"):
            yield
    except KeyboardInterrupt:
        done = f"{latest[0].kept + latest[0].computed} of {latest[0].units}" if latest else "finished"
        raise RunError(f"Interrupted: {done} units are kept in {folder}; {kept}.") from None
    except ClusterError as error:
        raise RunError(f"{error}: finished units are kept in {folder}; {kept}.") from None


@contextlib.contextmanager
def telling_system_errors(sentence: str, remedy: str = "") -> Iterator[None]:
    """Raise `RunError` in place of what the system says when files cannot be read or written."""
    try:
        yield
    except OSError as error:
        raise RunError(f"{sentence} ({reason(error)}){remedy and f': {remedy}'}.") from None


def _complain_about(state: State, folder: Path) -> None:
    """Tell what was not as it should be in a run; raise `RunError` if units are missing."""
    complain(0, *state.refused)
    if state.changed:
        complain(0, f"{folder} held another campaign: of its units those that this one asks for were kept.")
    if state.deaths:
        complain(0, f"Workers died {state.deaths} times; their units were computed again.")
    if state.failures:
        complain(0, *state.failures[:20])
        raise RunError(f"{len(state.failures)} of {state.units} units could not be computed; the others are kept.")


def check_numbers(**numbers: tuple[int | None, int]) -> None:
    """Raise `InputError` for an option that is below its least value; None is not given."""
    for name, (number, least) in numbers.items():
        if number is not None and number < least:
            raise InputError(f"--{name} {number}: must be {least} or more.")


def _shard(text: str) -> tuple[int, int]:
    """(i, n) of "i/n"."""
    number, slash, shards = text.partition("/")
    if not (slash and number.isdecimal() and shards.isdecimal() and 1 <= int(number) <= int(shards)):
        raise InputError(f"--shard {text}: must be i/n with i from 1 to n, such as 2/7.")
    return int(number), int(shards)


@contextlib.contextmanager
def _campaign_progress(quiet: bool) -> Iterator[Callable[[State], None]]:
    """How far the campaign is: a bar on a terminal, a line every few seconds elsewhere, both on stderr."""
    started = last = time.monotonic()

    def words(state: State) -> str:
        rate = state.rays / max(time.monotonic() - started, 1e-3)
        found = f"{state.kept + state.computed} of {state.units} units, {rays_per_second(rate)}"
        if state.workers is None:
            return found
        return f"{found}, {state.workers} workers" if state.workers else "waiting for workers"

    def line(state: State) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= PLAIN_PROGRESS_SECONDS and state.paths_done:
            last = now
            left = (now - started) * max(state.paths - state.paths_done, 0) / state.paths_done
            complain(0, f"{state.paths_done / state.paths:4.0%} done, {words(state)}, {duration(left)} left")

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


def duration(seconds: float) -> str:
    """A time that people can read: 40 s, 12 min, 3.4 h."""
    if seconds < 300:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


@contextlib.contextmanager
def steps(words: str) -> Iterator[Steps]:
    """A bar on a terminal for so many steps; nothing elsewhere."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    columns = (TextColumn(words), BarColumn(None), MofNCompleteColumn())
    with Progress(*columns, console=Console(stderr=True), expand=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@campaigns.command(name="status")
def campaign_status(folder: CampaignFolder, /) -> None:
    """Tell how far a campaign is, and which runs work on it."""
    from gonio.campaign.status import seconds_left, status
    from gonio.campaign.store import CampaignStore

    found = status(CampaignStore(folder))
    left = seconds_left(CampaignStore(folder)) if found.runs else None
    if found.title:
        say(found.title, style="bold")
    share = found.paths_finished / found.paths
    say(
        f"{found.units_finished} of {found.units} units are finished, {share:.0%} of the paths; "
        f"{found.experiments_finished} of {found.experiments} experiments are complete"
        f"{'' if left is None else f', about {duration(left)} are left'}."
    )
    for run, units in found.runs.items():
        say(f"{run}: {units} unit{'s' * (units > 1)} under way.")


@campaigns.command(name="verify")
def campaign_verify(folder: CampaignFolder, /) -> None:
    """Verify that stored files are intact; damaged ones are set aside, so that the next run computes them.

    This is about files: gonio check is the self-check of one measurement, and
    gonio validate holds the instrument to exact results.
    """
    from gonio.campaign.status import verify
    from gonio.campaign.store import CampaignStore

    with telling_system_errors(f"{folder} cannot be read or written"):
        sound, sentences = verify(CampaignStore(folder))
    complain(0, *sentences)
    say(f"{sound} unit{'s' * (sound != 1)} {'are' if sound != 1 else 'is'} sound.")
    if sentences:
        raise RunError(f"{len(sentences)} units were damaged: run the campaign again, which computes them.")


@campaigns.command(name="merge")
def campaign_merge(folder: CampaignFolder, /) -> None:
    """Put finished units together: one measurement for each experiment, and index.csv with their parameters.

    Writes DIR/measurements in the campaign's folder.
    """
    from gonio.campaign.results import merge

    with telling_system_errors(f"{folder} cannot be read or written"), steps("merging") as show:
        merged = merge(folder, show)
    complain(0, *merged.damaged)
    if len(merged.processors) > 1:
        complain(
            0,
            f"Units were computed on different processors ({', '.join(sorted(merged.processors))}): their last bits "
            "may not be those of a single machine.",
        )
    say(f"{len(merged.files)} measurements and index.csv in {folder / 'measurements'}{os.sep}")
    _advise(merged)
    if merged.incomplete:
        raise RunError(
            f"{merged.incomplete} of {merged.incomplete + len(merged.files)} experiments lack units: run the campaign "
            "again."
        )


def _advise(merged: Merged) -> None:
    """How uncertain a campaign's measurements are, which is the worst, and what would help."""
    from gonio.noise import Noises

    found = merged.noises
    if not found:
        return
    worst = max(found, key=lambda number: found[number].bins.total if found[number].bins.known else math.inf)
    if len(found) > 1:
        say(f"All {len(found)} experiments together:", style="bold")
        for sentence in Noises.together(list(found.values())).sentences():
            say(sentence)
    say(f"Experiment {worst + 1}, the least certain:" if len(found) > 1 else "The experiment:", style="bold")
    for sentence in found[worst].sentences():
        say(sentence)


@campaigns.command(name="publish")
def campaign_publish(
    folder: CampaignFolder,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    creator: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)],
    licence: Annotated[str, Parameter(name=["--licence", "--license"])],
    title: str | None = None,
    description: str = "",
    single: Flag = False,
) -> None:
    """Make a data set of a finished campaign, ready for an archive that gives it a DOI.

    Writes a new folder: measurements/*.nc with licence and creators in each,
    index.csv, thumbnails, README.md, datacite.json for the DOI, and SHA256SUMS.
    gonio.open_campaign(FOLDER) opens it as one xarray.Dataset.

    Parameters
    ----------
    output
        The data set's folder, which must not exist yet.
    creator
        Who made it, "Family, Given", as often as needed.
    licence
        What others may do with it, an SPDX identifier: CC0-1.0, CC-BY-4.0, ...
    title
        The data set's title; the campaign's if not given.
    description
        A paragraph for the README and the DOI.
    single
        Write one file, campaign.nc, instead of one for each measurement.
    """
    from gonio.campaign.publication import About, publish

    heading = title or _title_of(folder)
    if not heading:
        raise InputError("--title: the campaign has none; say what the data set is called.")
    for name, text in (("licence", licence), *(("creator", one) for one in creator)):
        if not text.strip():
            raise InputError(f"--{name} is empty: a data set without one cannot be used by others.")
    with telling_system_errors(f"{output} cannot be written", "nothing was published"), steps("publishing") as show:
        publish(folder, output, About(heading, creator, licence, description), single, show)
    print(output)


def _title_of(folder: Path) -> str:
    from gonio.campaign.store import CampaignStore

    return str(CampaignStore(folder).manifest()["title"])
