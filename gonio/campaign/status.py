"""How far a campaign is, how long it will still take, and whether what it holds is sound."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass

from gonio.campaign.store import CampaignStore, DamagedError, paths_of

PACE_SECONDS = 3600.0
"""What was finished longer ago tells nothing about how fast it goes now."""


@dataclass(frozen=True)
class Status:
    """How far a campaign is."""

    title: str
    experiments: int
    experiments_finished: int
    units: int
    units_finished: int
    paths: int
    paths_finished: int
    runs: dict[str, int]
    """Runs that work on it now, and how many units each has under way."""


def status(store: CampaignStore) -> Status:
    """How far the campaign in `store` is. Raises `InputError` where there is none."""
    manifest, finished = store.manifest(), store.finished()
    paths = paths_of(manifest)
    runs: dict[str, int] = {}
    for unit, claim in store.claims().items():
        if unit not in finished:
            run = f"{claim['host']}, process {claim['pid']}{claim['run']}"
            runs[run] = runs.get(run, 0) + 1
    done = [unit for unit in paths if unit in finished]
    whole = [entry for entry in manifest["experiments"] if finished.issuperset(entry["units"])]
    return Status(
        title=manifest["title"],
        experiments=len(manifest["experiments"]),
        experiments_finished=len(whole),
        units=len(paths),
        units_finished=len(done),
        paths=sum(paths.values()),
        paths_finished=sum(paths[unit] for unit in done),
        runs=runs,
    )


def seconds_left(store: CampaignStore) -> float | None:
    """How long a campaign will take at the pace of the last hour; None where too little was finished in it."""
    paths = paths_of(store.manifest())
    with os.scandir(store.units) as entries:
        finished = {entry.name[:-4]: entry.stat().st_mtime for entry in entries if entry.name[:-4] in paths}
    now, left = time.time(), sum(paths.values()) - sum(paths[unit] for unit in finished)
    recent = sorted((when, paths[unit]) for unit, when in finished.items() if when > now - PACE_SECONDS)
    done = sum(count for _, count in recent[1:])
    return left * (now - recent[0][0]) / done if done else None


def verify(store: CampaignStore) -> tuple[int, list[str]]:
    """Read every unit that the campaign asks for; how many are what was written, and a sentence for each that is not.

    Damaged ones are set aside: running the campaign again computes them.
    """
    wanted = {unit for entry in store.manifest()["experiments"] for unit in entry["units"]}
    present, sentences = sorted(wanted & store.finished()), []
    for unit in present:
        try:
            store.read(unit)
        except DamagedError as error:
            sentences.append(store.set_aside(unit, error))
    return len(present) - len(sentences), sentences
