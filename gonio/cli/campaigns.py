"""`gonio campaign run | status | verify | merge`: many measurements in one folder."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter
from rich.console import Console

from gonio.cli.terminal import (
    PLAIN_PROGRESS_SECONDS,
    Output,
    Overrides,
    RunError,
    app,
    check_writable,
    complain,
    rays_per_second,
    reason,
    say,
    working,
)

if TYPE_CHECKING:
    pass


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
    check_writable(folder)
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
                f"{folder} cannot be written ({reason(error)}): finished units are kept, the same command continues."
            ) from None
    if state.changed:
        complain(0, f"{folder} held another campaign: of its units those that this one asks for were kept.")
    if state.deaths:
        complain(0, f"{state.deaths} workers died and were replaced.")
    if state.failures:
        complain(0, *state.failures[:20])
        raise RunError(f"{len(state.failures)} of {state.units} units could not be computed; the others are kept.")
    if not quiet:
        say(
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
        return f"{state.kept + state.computed} of {state.units} units, {rays_per_second(rate)}"

    def line(state: Any) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= PLAIN_PROGRESS_SECONDS and state.paths_done:
            last = now
            left = (now - started) * max(state.paths - state.paths_done, 0) / state.paths_done
            complain(0, f"{state.paths_done / state.paths:4.0%} done, {words(state)}, {_duration(left)} left")

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
        say(found.title, style="bold")
    share = found.paths_finished / found.paths
    say(
        f"{found.units_finished} of {found.units} units are finished, {share:.0%} of the paths; "
        f"{found.experiments_finished} of {found.experiments} experiments are complete."
    )
    for run, units in found.runs.items():
        say(f"{run}: {units} unit{'s' * (units > 1)} under way.")


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
        raise RunError(f"{folder} cannot be read or written ({reason(error)}).") from None
    complain(0, *sentences)
    say(f"{sound} unit{'s' * (sound != 1)} {'are' if sound != 1 else 'is'} sound.")
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
        with working(f"merging {folder}"):
            merged = merge(folder)
    except OSError as error:
        raise RunError(f"{folder} cannot be read or written ({reason(error)}).") from None
    complain(0, *merged.damaged)
    if len(merged.processors) > 1:
        complain(
            0,
            f"Units were computed on different processors ({', '.join(sorted(merged.processors))}): their last bits "
            "may not be those of a single machine.",
        )
    say(f"{len(merged.files)} measurements and index.csv in {folder / 'measurements'}{os.sep}")
    if merged.incomplete:
        raise RunError(
            f"{merged.incomplete} of {merged.incomplete + len(merged.files)} experiments lack units: run the campaign "
            "again."
        )
