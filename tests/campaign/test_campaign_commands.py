"""`gonio campaign`: run, status and merge from the command line, and what goes wrong."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toys import ROUGH, TINY, UNITS, Gonio, content, half_bad, index

import gonio
from gonio.campaign import running
from gonio.campaign.status import status
from gonio.campaign.store import CampaignStore
from gonio.campaign.sweep import Campaign
from gonio.campaign.units import Plan
from gonio.experiment import Experiment
from gonio.toml_files import InputError


def test_run_status_merge_from_the_command_line(run: Gonio, finished: Path) -> None:
    code, out, err = run("run", "toy.toml", "--shard", "1/2")
    assert (code, err) == (0, "")
    assert out.startswith("12 units: 0 were there, 12 computed in ")
    assert run("status", "out/toy") == (
        0,
        "Toys\n12 of 24 units are finished, 50% of the paths; 2 of 4 experiments are complete.\n",
        "",
    )
    code, out, err = run("merge", "out/toy")
    assert (code, err) == (1, "2 of 4 experiments lack units: run the campaign again.\n")
    assert run("run", "toy.toml", "--quiet") == (0, "", "")
    code, out, err = run("merge", "out/toy")
    assert code == 0
    assert out.startswith("4 measurements and index.csv in out/toy/measurements/\nAll 4 experiments together:\n")
    assert content(Path("out/toy")) == content(finished)
    rows = index(Path("out/toy"))
    assert [(row["experiment"], row["surface.alpha"], row["material.name"]) for row in rows] == [
        ("1", "0.2", "Au"), ("2", "0.2", "Al"), ("3", "0.4", "Au"), ("4", "0.4", "Al")
    ]  # fmt: skip
    for row in rows:
        measured = gonio.load(Path("out/toy/measurements") / row["file"])
        assert measured.material == gonio.Conductor(row["material.name"])


def test_status_tells_who_works_on_it(run: Gonio, copied: Path) -> None:
    unit = sorted(copied.glob("units/*.npz"))[0]
    unit.unlink()
    claim = {"host": "node7", "pid": 12, "run": ", shard 2/7"}
    (copied / "claims" / unit.stem).write_text(json.dumps(claim))
    code, out, _ = run("status", str(copied))
    assert code == 0
    assert out.endswith("node7, process 12, shard 2/7: 1 unit under way.\n")


def test_the_status_of_ten_thousand_units(tmp_path: Path) -> None:
    grids = replace(TINY, phi_i=tuple(np.arange(50.0)), theta_i=(0.0,))
    campaign = Campaign.of([Experiment(ROUGH, gonio.Mirror(), grids, seed=seed, realisations=10) for seed in range(20)])
    plan, store = Plan.of(campaign), CampaignStore(tmp_path)
    store.create(plan.manifest())
    every = [unit.name for group in plan.units for unit in group]
    assert len(every) == 10_000
    for name in every[:7000]:
        (store.units / f"{name}.npz").touch()
    found = subprocess.run(
        [sys.executable, "-m", "gonio", "campaign", "status", str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert "7000 of 10000 units are finished, 70% of the paths; 14 of 20 experiments are" in found.stdout


def test_progress_is_plain_lines_without_a_terminal(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gonio.cli.campaigns.PLAIN_PROGRESS_SECONDS", 0.0)
    code, _, err = run("run", "toy.toml", "-o", "c")
    assert code == 0
    lines = err.splitlines()
    assert len(lines) >= UNITS
    assert lines[-1].startswith(f"100% done, {UNITS} of {UNITS} units, ")
    assert lines[-1].endswith("rays/s, 0 s left.")


@pytest.mark.parametrize(
    ("tokens", "words"),
    [
        ("run toy.toml --shard 0/7", "--shard 0/7: must be i/n"),
        ("run toy.toml --shard 3", "--shard 3: must be i/n"),
        ("run toy.toml --workers -1", "--workers -1: must be 0 or more"),
        ("run toy.toml --threads 0", "--threads 0: must be 1 or more"),
        ("run toy.toml --set surface.alpha", "--set 'surface.alpha': must be key=value"),
        ("run toi.toml", "did you mean toy.toml?"),
        ("status nowhere", "nowhere: holds no campaign"),
        ("merge nowhere", "nowhere: holds no campaign"),
        ("verify nowhere", "nowhere: holds no campaign"),
    ],
)
def test_what_goes_wrong_is_one_sentence_and_writes_nothing(run: Gonio, tokens: str, words: str) -> None:
    code, out, err = run(*tokens.split())
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1
    assert [path.name for path in Path().iterdir()] == ["toy.toml"]


def test_a_surface_that_cannot_be_built_stops_no_other(run: Gonio) -> None:
    Path("c.toml").write_text(half_bad(Path()))
    code, _, err = run("run", "c.toml", "-o", "c")
    assert code == 1
    assert "experiment 2, realisation 1: surface: " in err
    assert "16 of 16 heights are NaN" in err
    assert err.endswith("6 of 12 units could not be computed; the others are kept.\n")
    assert len(CampaignStore(Path("c")).finished()) == 6


CONFIGS = [
    path for path in sorted((Path(__file__).parents[2] / "configs").glob("*.toml")) if "[sweep]" in path.read_text()
]


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_campaigns_in_configs_run(path: Path, tmp_path: Path) -> None:
    text = path.read_text()
    assert text.startswith("# ")
    with pytest.raises(InputError, match=f"{path.name} is a campaign: gonio campaign run"):
        Experiment.read(path)
    assert f"#     gonio campaign run configs/{path.name} -o " in text
    small = ["goniometer.paths=512", "surface.samples=32", "surface.side=100.0", "realisations=2"]
    campaign = Campaign.read(path, small)
    assert campaign.title
    assert not running.run(campaign, tmp_path).failures
    found = status(CampaignStore(tmp_path))
    assert found.experiments_finished == len(campaign.experiments) > 1
