"""`gonio campaign plan`: what a campaign will take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from gonio.cli.campaigns import (
    BaseOverrides,
    CampaignFile,
    campaigns,
    check_numbers,
    duration,
    steps,
    telling_system_errors,
)
from gonio.cli.terminal import say, show_table
from gonio.wording import percent

if TYPE_CHECKING:
    from rich.table import Table

    from gonio.campaign.planning import Forecast


@campaigns.command(name="plan")
def campaign_plan(
    file: CampaignFile,
    /,
    *,
    overrides: BaseOverrides = (),
    pilot: int | None = None,
    workers: int = 0,
    threads: int | None = None,
) -> None:
    """Tell how long a campaign will take, how much disk, and how exact it will be, before it is run.

    A pilot is measured: up to 16 of its units that differ as much as they can,
    each with few paths. What it took is interpolated between them. Give a target
    to learn how many paths it takes: --set goniometer.target_error=0.02

    Parameters
    ----------
    pilot
        Paths of each of the pilot's units; as many as can be timed if not given.
    workers
        Processes that will share the cores of this machine, as in gonio campaign run.
    threads
        Threads of each.
    """
    from gonio.campaign.planning import plan
    from gonio.campaign.sweep import Campaign

    check_numbers(pilot=(pilot, 1), workers=(workers, 0), threads=(threads, 1))
    campaign = Campaign.read(file, overrides)
    refused = telling_system_errors("The pilot's temporary folder cannot be written", "set TMPDIR")
    with refused, steps("measuring a pilot") as show:
        forecast = plan(campaign, workers=workers, threads=threads, pilot=pilot, progress=show)
    targets = sorted({e.goniometer.target_error for e in campaign.experiments if e.goniometer.target_error})
    show_table(f"Forecast for {campaign.title or file}", _forecast_table(forecast))
    for sentence in _forecast_sentences(forecast, targets):
        say(sentence)


def _forecast_table(forecast: Forecast) -> Table:
    """What a campaign will take, a row for each quantity."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, show_header=False, pad_edge=False)
    paths = f"{forecast.paths:,}"
    if forecast.paths_needed > forecast.paths:
        paths = f"{_rounded(forecast.paths_needed)} for the target, beyond {paths}"
    processes = f"{forecast.workers} worker{'s' * (forecast.workers > 1)}"
    threads = f"{forecast.threads} thread{'s' * (forecast.threads > 1)}"
    rows = {
        "experiments": f"{forecast.experiments:,}",
        "units of work": f"{forecast.units:,}, on {forecast.reliefs:,} surfaces",
        "paths": paths,
        "time": f"{duration(forecast.seconds)} with {processes} of {threads}",
        "work": f"{forecast.work * forecast.threads / 3600:.3g} core hours",
        "units on disk": _bytes(forecast.units_bytes),
        "merged on disk": _bytes(forecast.merged_bytes),
        "memory": "unknown" if forecast.memory is None else _bytes(forecast.memory),
        "error of a bin": _median_and_worst(forecast.bin_error),
        "error of the albedo": _median_and_worst(forecast.albedo_error),
    }
    for row in rows.items():
        table.add_row(*row)
    return table


def _median_and_worst(errors: tuple[float, float]) -> str:
    return f"{percent(errors[0])} (median of the experiments), {percent(errors[1])} (the worst)"


def _forecast_sentences(forecast: Forecast, targets: Sequence[float]) -> Iterator[str]:
    """What the numbers of a forecast mean."""
    traced = [pilot.paths for pilot in forecast.pilots]
    yield (
        f"Measured: {len(traced)} of {forecast.units} units, with {min(traced):,} to {max(traced):,} paths each; all "
        "others are interpolated."
    )
    yield (
        "Errors are relative standard errors of Monte Carlo in one specimen, at the worst incidence of an experiment: "
        "half of its light leaves through bins with a smaller one. Several specimens make them smaller; how far "
        "specimens differ no pilot of one can tell."
    )
    if targets:
        wanted = f"{targets[0]:.3g}" if len(targets) == 1 else f"{targets[0]:.3g} to {targets[-1]:.3g}"
        yield (
            f"target_error = {wanted} takes {forecast.paths_needed / forecast.paths:.3g} times the paths that "
            "goniometer.paths asks for."
        )
    if forecast.beyond:
        yield (
            f"In {forecast.beyond} experiments the target needs more paths than can be summed exactly: ask for a "
            "larger target_error, or for wider bins."
        )


def _rounded(count: int) -> str:
    """A large number that is an estimate."""
    return f"{float(f'{count:.3g}'):,.0f}"


def _bytes(size: int) -> str:
    """A size that people can read: 40 kB, 1.3 GB."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6)):
        if size >= 0.95 * scale:
            return f"{size / scale:.3g} {unit}"
    return f"{size / 1e3:.3g} kB"
