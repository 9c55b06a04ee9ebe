"""`gonio check | validate`: a measurement and an installation are checked."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import pytest

import gonio
from gonio import validation
from gonio.goniometer import Goniometer
from gonio.self_check import Check, SelfCheckReport

Gonio = Callable[..., tuple[int, str, str]]
Files = Callable[[], set[str]]


def test_check_recomputes_the_report(run: Gonio, measured: Path) -> None:
    code, out, _ = run("check", str(measured))
    assert code == 0
    assert all(len(line) <= 80 for line in out.splitlines())
    stored = json.loads(gonio.load(measured).attributes["self_check"])
    for check in stored:
        assert check["name"] in out
    assert "Self-check: 15 checks" in out


def test_check_of_a_damaged_file_fails(run: Gonio, measured: Path) -> None:
    Path("damaged.nc").write_bytes(measured.read_bytes())
    with h5py.File("damaged.nc", "r+") as file:
        file["brdf"][0, 0, 0, 0, 0, 0] *= 1.001
    code, out, err = run("check", "damaged.nc")
    assert code == 1
    assert "failed" in out
    assert err == "damaged.nc fails: values. Do not use its numbers.\n"


def test_a_run_tells_its_self_check(run: Gonio, undrawn: None) -> None:
    code, out, _ = run("run", "toy.toml")
    assert code == 0
    assert "Self-check: 15 checks" in out
    assert "realisations, warning: 2 specimens measured, limit 4" in out


@pytest.mark.usefixtures("undrawn")
def test_a_run_that_fails_its_self_check_says_so(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = SelfCheckReport((Check("lost light", "failed", "half of it was lost.", {"share": 0.5}),))
    monkeypatch.setattr("gonio.experiment.check", lambda _: bad)
    code, _, err = run("run", "toy.toml", "--quiet")
    assert code == 1
    assert err == f"{Path('out/toy/measurement.nc')} fails: lost light. Do not use its numbers.\n"
    assert Path("out/toy/measurement.nc").exists()


def test_validate_prints_and_writes_a_table(run: Gonio) -> None:
    code, out, _ = run("validate", "--quick", "--case", "number", "--to", "new/table.md")
    assert code == 0
    assert all(len(line) <= 80 for line in out.splitlines())
    assert "0 fail" in out
    text = Path("new/table.md").read_text()
    assert "half-pipe, 2 hits" in text
    assert "agrees" in text


def test_validate_keeps_what_was_done_before_ctrl_c(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = validation.validate

    def until_pits(quick: bool, cases: tuple[str]) -> tuple[validation.Row, ...]:
        if cases == ("spherical pits",):
            raise KeyboardInterrupt
        return honest(quick, cases)

    monkeypatch.setattr("gonio.validation.validate", until_pits)
    code, _, err = run("validate", "--quick", "--case", "hits", "--case", "pits", "--to", "table.md")
    assert code == 1
    assert err.splitlines()[-1] == "Interrupted after 1 of 2 cases."
    assert "half-pipe, 2 hits" in Path("table.md").read_text()


def test_validate_tells_a_failure(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = Goniometer.measure

    def crooked(self, scene, seed, threads=None):
        measurement = honest(self, scene, seed, threads)
        sums = measurement.sums.assign(weight=measurement.sums["weight"] * 99 // 100)
        return replace(measurement, sums=sums)

    monkeypatch.setattr(Goniometer, "measure", crooked)
    code, out, err = run("validate", "--quick", "--case", "number")
    assert code == 1
    assert "FAILS" in out
    assert err.splitlines()[-1].endswith("numbers are not as they should be.")
