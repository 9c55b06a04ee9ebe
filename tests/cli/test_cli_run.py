"""`gonio run | surface`: what they print and write, and what is left when they fail or are stopped."""

from __future__ import annotations

import base64
import errno
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import gonio
import microsurfaces as ms
from gonio.experiment import Experiment
from gonio.sphere import direction

Gonio = Callable[..., tuple[int, str, str]]
Files = Callable[[], set[str]]

KLEMS = """[goniometer]
paths = 4000
replicates = 4
detector = {kind = "Klems", basis = "quarter"}
"""


def test_run_writes_the_results_and_prints_what_was_measured(run: Gonio, files: Files) -> None:
    code, out, err = run("run", "toy.toml", "--threads", "1")
    assert code == 0, err
    pictures = [f"{name}.png" for name in ("lobes", "slices", "hemisphere", "albedo")]
    results = {"measurement.nc", "experiment.toml", *pictures, "report.html"}
    assert files() == {"toy.toml"} | {f"out/toy/{name}" for name in results}
    assert all(len(line) <= 80 for line in out.splitlines())
    measurement = gonio.load("out/toy/measurement.nc")
    albedo = measurement.albedo()["albedo"].sel(theta_i=30, phi_i=0, wavelength=550).item()
    row = re.search(r"30°, 0° +(.*)", out)
    assert row is not None
    values = [float(value) for value in re.findall(r"([\d.]+) ±", row[1])]
    assert values[1] == pytest.approx(albedo, abs=0.01)
    for words in ("450 nm", "1 hit", "lost or truncated", "rays/s", "CookTorrance", "Microfacet", *results):
        assert words in out
    assert "Relative standard error of the bins:" in " ".join(out.split())
    page = Path("out/toy/report.html").read_text(encoding="utf-8")
    for name in pictures:
        assert base64.b64encode(Path("out/toy", name).read_bytes()).decode() in page
    assert "CookTorrance, m " in page


@pytest.mark.usefixtures("undrawn")
def test_the_resolved_experiment_gives_the_same_file(run: Gonio) -> None:
    assert run("run", "toy.toml", "-o", "first", "--seed", "5", "--set", "surface.alpha=0.2", "--quiet")[0] == 0
    assert run("run", "first/experiment.toml", "-o", "second", "--threads", "2", "--quiet")[0] == 0
    for name in ("measurement.nc", "experiment.toml"):
        assert Path("first", name).read_bytes() == Path("second", name).read_bytes()


@pytest.mark.usefixtures("undrawn")
def test_quiet_prints_nothing(run: Gonio) -> None:
    assert run("run", "toy.toml", "--quiet") == (0, "", "")


@pytest.mark.usefixtures("undrawn")
def test_one_specimen_is_said_to_be_one(run: Gonio) -> None:
    code, out, _ = run("run", "toy.toml", "--set", "surface={kind='Flat'}", "--set", "realisations=1")
    assert code == 0
    assert "One specimen was measured" in out


def test_without_pictures_no_older_ones_are_left_beside_new_numbers(run: Gonio, files: Files) -> None:
    Path("out/toy").mkdir(parents=True)
    for name in ("lobes.png", "report.html"):
        Path("out/toy", name).write_bytes(b"older")
    code, out, err = run("run", "toy.toml", "--no-pictures")
    assert (code, err) == (0, "")
    assert files() == {"toy.toml", "out/toy/measurement.nc", "out/toy/experiment.toml"}
    assert "lobes.png" not in out
    assert "report" not in out
    assert run("run", "toy.toml", "--no-picture")[0] == 2


def test_a_run_draws_and_compares_once(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page takes what was drawn and compared; only where the best model fails is drawn for it alone."""
    calls: list[str] = []
    for name in ("lobes", "slices", "hemisphere", "albedo", "difference"):
        monkeypatch.setattr(f"gonio.plots.{name}", _counted(calls, name))
    monkeypatch.setattr(sys.modules["gonio.comparison"], "compare", _counted(calls, "compare", gonio.compare))
    monkeypatch.setattr("gonio.reporting.compare", None)
    code, out, err = run("run", "toy.toml")
    assert (code, err) == (0, "")
    assert "report.html" in out
    assert sorted(calls) == ["albedo", "compare", "compare", "difference", "hemisphere", "lobes", "slices"]


def _counted(calls: list[str], name: str, function: Callable[..., Any] | None = None) -> Callable[..., Any]:
    """Notes that it was called; draws nothing, into a file if it is asked to, where there is no `function`."""

    def counted(*values: Any, **options: Any) -> Any:
        calls.append(name)
        if function is not None:
            return function(*values, **options)
        figure = Figure(figsize=(1, 1))
        if isinstance(values[-1], Path):
            figure.savefig(values[-1])
        return figure

    return counted


def test_without_plotly_a_run_says_what_adds_the_page(
    run: Gonio, files: Files, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("plotly", "plotly.offline"):
        monkeypatch.setitem(sys.modules, name, None)
    for name in ("lobes", "slices", "hemisphere", "albedo"):
        monkeypatch.setattr(f"gonio.plots.{name}", _counted([], name))
    Path("out/toy").mkdir(parents=True)
    Path("out/toy/report.html").write_text("older")
    code, out, err = run("run", "toy.toml")
    assert (code, err) == (0, "")
    assert " ".join(out.split()).endswith('albedo.png (pip install "gonio[report]" adds report.html)')
    assert "out/toy/report.html" not in files()


@pytest.mark.usefixtures("undrawn")
def test_a_model_that_cannot_describe_the_specimen_does_not_lose_the_measurement(run: Gonio) -> None:
    changes = ("--set", "surface={kind='Flat'}", "--set", "models=['CookTorrance']")
    code, _, err = run("run", "toy.toml", *changes)
    assert code == 0
    assert err.startswith("CookTorrance: ")
    assert gonio.load("out/toy/measurement.nc")


def test_an_aperture_measurement_says_which_pictures_it_has_none_of(run: Gonio, files: Files) -> None:
    code, _, err = run("run", "toy.toml", "--set", "goniometer.detector={kind='Apertures', directions=[[30.0, 180.0]]}")
    assert code == 0
    assert "No lobes.png: " in err
    assert "out/toy/measurement.nc" in files()
    assert "out/toy/lobes.png" not in files()


@pytest.mark.parametrize("name", ["toy.npy", "toy.exr", "toy.png", "toy.x3p", "new/toy.ply", "toy.stl", "toy.obj"])
def test_surface_prints_statistics_and_saves(run: Gonio, name: str) -> None:
    code, out, _ = run("surface", "toy.toml", "--to", name)
    assert code == 0
    statistics = Experiment.read("toy.toml").relief().statistics()
    assert f"{statistics.beckmann_alpha:.5g}" in out
    assert f"{statistics.Sq:.5g} µm" in out
    assert Path(name).stat().st_size > 1000


def test_show_opens_a_window(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[ms.Mesh] = []
    monkeypatch.setattr("gonio.plots.show_surface", shown.append)
    assert run("surface", "toy.toml", "--show")[0] == 0
    assert len(shown[0].faces) == 2 * 32**2


def test_without_a_screen_show_says_so(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    code, _, err = run("surface", "toy.toml", "--show")
    assert code == 1
    assert err.startswith("No window: there is no screen")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (np.array([[0.0, np.nan], [0.0, 0.0]]), "NaN"),
        (np.zeros((1, 1)), "expected at least 2 x 2"),
        (b"", "damaged or of another type"),
    ],
)
def test_a_bad_height_map_is_one_sentence_and_writes_nothing(
    run: Gonio, files: Files, content: np.ndarray | bytes, words: str
) -> None:
    Path("map.npy").write_bytes(content) if isinstance(content, bytes) else np.save("map.npy", content)
    table = "{kind='HeightFieldFile', path='map.npy', pixel_size=1.0, unit='um', periodic='as is'}"
    code, _, err = run("run", "toy.toml", "--set", f"surface={table}")
    assert code == 2
    assert words in err
    assert err.count("\n") == 1
    assert files() == {"toy.toml", "map.npy"}


def test_a_failed_run_leaves_older_results_alone(run: Gonio) -> None:
    Path("out/toy").mkdir(parents=True)
    Path("out/toy/measurement.nc").write_text("older")
    assert run("run", "toy.toml", "--set", "surface.alpha=-1")[0] == 2
    assert Path("out/toy/measurement.nc").read_text() == "older"


@pytest.mark.usefixtures("undrawn")
def test_ctrl_c_saves_what_was_measured_and_says_so(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Experiment.scene

    def interrupted(self: Experiment, realisation: int = 0) -> gonio.Scene:
        if realisation == 1:
            raise KeyboardInterrupt
        return scene(self, realisation)

    monkeypatch.setattr(Experiment, "scene", interrupted)
    code, _, err = run("run", "toy.toml")
    assert code == 1
    assert err == "Interrupted: out/toy/measurement.nc holds what had been measured.\n"
    assert gonio.load("out/toy/measurement.nc").interrupted


def test_ctrl_c_before_anything_was_measured_writes_nothing(
    run: Gonio, files: Files, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(self: ms.Gaussian, seed: int, *_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(ms.Gaussian, "build", interrupted)
    assert run("run", "toy.toml") == (1, "", "Interrupted before anything was measured: nothing was written.\n")
    assert files() == {"toy.toml"}


def test_ctrl_c_while_drawing_keeps_the_numbers(run: Gonio, files: Files, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("gonio.plots.lobes", interrupted)
    code, _, err = run("run", "toy.toml")
    assert (code, err) == (1, "Interrupted.\n")
    assert files() == {"toy.toml", "out/toy/measurement.nc", "out/toy/experiment.toml"}


def test_a_full_disk_loses_nothing(
    run: Gonio, files: Files, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    from gonio import netcdf

    refuge, save = tmp_path_factory.mktemp("refuge"), netcdf.save

    def full(result: gonio.Measurement, path: Path) -> Path:
        if path.parent != refuge:
            raise OSError(errno.ENOSPC, "anything")
        return save(result, path)

    monkeypatch.setattr("gonio.netcdf.save", full)
    monkeypatch.setattr("tempfile.mkdtemp", lambda **_: str(refuge))
    code, _, err = run("run", "toy.toml")
    assert code == 1
    assert err == f"out/toy cannot be written (no space left on device): the results are in {refuge}.\n"
    assert files() == {"toy.toml"}
    assert {path.name for path in refuge.iterdir()} == {"measurement.nc", "experiment.toml"}


def test_too_little_memory_is_one_sentence(run: Gonio, files: Files) -> None:
    many = ", ".join(str(400 + i / 10) for i in range(2000))
    grid = "{kind='HemisphereGrid', theta_step=0.05, phi_step=0.05}"
    code, _, err = run(
        "run", "toy.toml", "--set", f"goniometer.wavelengths=[{many}]", "--set", f"goniometer.detector={grid}"
    )
    assert code == 1
    assert "GiB of memory" in err
    assert err.count("\n") == 1
    assert files() == {"toy.toml"}


def test_klems_patches_are_measured_and_exported(run: Gonio) -> None:
    """The toy under the patches: a table of one row a ring, no model, a sound self-check, and a matrix as measured."""
    Path("patches.toml").write_text(Path("toy.toml").read_text().split("[goniometer]")[0] + KLEMS)
    code, out, _ = run("run", "patches.toml", "-o", "out", "--no-pictures")
    assert code == 0
    assert "5 of 41 incidences" in out
    assert "41 of 41 incidences were measured" not in out
    code, _, err = run("compare", "out/measurement.nc", "--model", "cook-torrance")
    assert "whole patches" in err
    code, out, _ = run("export", "out/measurement.nc", "--to", "out/toy.xml", "--format", "klems-quarter")
    assert code == 0
    measured = gonio.load("out/measurement.nc")
    written = gonio.formats.FORMATS["klems-quarter"].read(Path("out/toy.xml"))
    theta, phi = measured.detector.directions[20]
    lobe = measured.dataset["brdf"].sel(order="all", theta_i=theta, phi_i=phi).values
    wo = direction(*np.array(measured.detector.directions).T)
    wi = np.broadcast_to(direction(theta, phi), wo.shape)
    found = written.eval(wi, wo)
    expected = gonio.BRDF.of(measured).in_basis(written.basis).eval(wi, wo)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
    assert found[:, 0].argmax() == lobe[:, 0].argmax()
