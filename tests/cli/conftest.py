"""What the tests of the command line share: a folder with a small experiment, measurements, pictures left out."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from command_line import TOY, called
from synthetic import external

import gonio
from gonio.experiment import Experiment

Gonio = Callable[..., tuple[int, str, str]]
Calls = list[tuple[str, tuple[Any, ...], dict[str, Any]]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Gonio:
    """Runs `gonio` in a folder of its own that holds toy.toml; (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    Path("toy.toml").write_text(TOY)

    return partial(called, capsys)


@pytest.fixture
def files() -> Callable[[], set[str]]:
    """The files in the folder that `gonio` runs in, when it is called."""
    return lambda: {str(path) for path in Path().rglob("*") if path.is_file()}


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out the pictures, which take longer than all the rest."""
    monkeypatch.setattr("gonio.cli.measuring._show", lambda *_: [])


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a small measurement."""
    folder = tmp_path_factory.mktemp("measured")
    (folder / "toy.toml").write_text(TOY)
    return gonio.save(Experiment.read(folder / "toy.toml").run(), folder / "toy.nc")


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two external measurements: colours without errors, a spectrum with them."""
    folder = tmp_path_factory.mktemp("tables")
    gold = gonio.models.CookTorrance(m=0.3, material=gonio.Conductor("Au"))
    colours = {"basis": "RGB", "title": "colours"}
    gonio.save(external(gold, wavelengths=(611.4, 549.1, 464.2), attributes=colours), folder / "colours.nc")
    gonio.save(external(gold, noise=0.03, wavelengths=(450.0, 650.0)), folder / "spectrum.nc")
    return folder


@pytest.fixture
def blank(monkeypatch: pytest.MonkeyPatch) -> Calls:
    """Pictures are empty files; the functions of `plots` that were asked for them, and what they were given."""
    calls: Calls = []

    def stand_in(name: str) -> Callable[..., None]:
        def draw(*given: Any, **options: Any) -> None:
            *what, path = given
            calls.append((name, tuple(what), options))
            Path(path).touch()

        return draw

    for name in ("lobes", "lobe_meshes", "slices", "hemisphere", "albedo", "difference", "sphere", "relief", "paths"):
        monkeypatch.setattr(f"gonio.plots.{name}", stand_in(name))
    return calls
