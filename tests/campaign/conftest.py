"""What the tests of campaigns have in common: a small campaign, finished, and the command line."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path

import pytest
from command_line import called
from toys import TOY, UNITS, Gonio, read

from gonio.campaign import results, running
from gonio.campaign.sweep import Campaign


@pytest.fixture(scope="session")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    return read(tmp_path_factory.mktemp("toy"), TOY)


@pytest.fixture(scope="session")
def finished(toy: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of TOY, all computed in one process and merged; not to be changed."""
    path = tmp_path_factory.mktemp("finished")
    state = running.run(toy, path)
    assert (state.computed, state.kept, state.failures) == (UNITS, 0, [])
    assert results.merge(path).incomplete == 0
    return path


@pytest.fixture
def copied(finished: Path, tmp_path: Path) -> Path:
    """A copy of the finished campaign, to be harmed."""
    return shutil.copytree(finished, tmp_path / "copied")


@pytest.fixture
def gonio_campaign(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Gonio:
    """Runs `gonio campaign`; (exit code, stdout, stderr)."""
    monkeypatch.setenv("COLUMNS", "100")

    return partial(called, capsys, "campaign")


@pytest.fixture
def run(gonio_campaign: Gonio, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Gonio:
    """`gonio_campaign` in a folder of its own that holds toy.toml."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "toy.toml").write_text(TOY)
    return gonio_campaign
