"""The queue of a run: what is computed first, by whom, and what waits."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from pathlib import Path

from toys import KINDS

from gonio.campaign import units
from gonio.campaign.queue import Queue
from gonio.campaign.store import CampaignStore
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan


def test_what_another_run_claims_is_done_last_and_dead_runs_claim_nothing(toy: Campaign, tmp_path: Path) -> None:
    plan = Plan.of(toy)
    store = CampaignStore(tmp_path)
    store.create(plan.manifest())
    ordered = plan.shard(1, 1)
    claim = {"host": "elsewhere", "pid": 1, "run": ""}
    (tmp_path / "claims" / ordered[0].name).write_text(json.dumps(claim))
    dead = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    claim = {"host": socket.gethostname(), "pid": int(dead.stdout), "run": ""}
    (tmp_path / "claims" / ordered[1].name).write_text(json.dumps(claim))
    (tmp_path / "claims" / ordered[2].name).write_text("")
    assert list(store.claims()) == [ordered[0].name]
    queue, taken = Queue(ordered, store), list[str]()
    while unit := queue.take():
        taken.append(unit.name)
        queue.settle(unit, None)
    assert taken == [unit.name for unit in ordered[1:]] + [ordered[0].name]
    assert not list((tmp_path / "claims").iterdir())


def test_workers_stay_with_their_relief_and_take_others_first(toy: Campaign, tmp_path: Path) -> None:
    plan = Plan.of(toy)
    CampaignStore(tmp_path).create(plan.manifest())
    queue = Queue(plan.shard(1, 1), CampaignStore(tmp_path))
    first, second = queue.take(), queue.take(None, ())
    assert first
    assert second
    assert second.relief == first.relief
    elsewhere = queue.take(None, [first.relief])
    assert elsewhere
    assert elsewhere.relief != first.relief
    for same in (first, elsewhere):
        again = queue.take(same.relief)
        assert again
        assert again.relief == same.relief


def test_no_specimen_is_begun_before_the_first_has_told_how_many_replicates_it_takes(tmp_path: Path) -> None:
    plan = Plan.of(Campaign.of([KINDS["a target"]]))
    CampaignStore(tmp_path).create(plan.manifest())
    queue, out = Queue(plan.shard(1, 1), CampaignStore(tmp_path)), list[units.Unit]()
    while unit := queue.take():
        out.append(unit)
    assert [unit.realisation for unit in out] == [0] * 4
    queue.settle(out[2], None)
    follower = queue.take()
    assert follower
    assert (follower.pilot, queue.take()) == (out[2].name, None)
