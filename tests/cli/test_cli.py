from __future__ import annotations

import base64
import errno
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from PIL import Image
from synthetic import external

import gonio
import microsurfaces as ms
from gonio import validation
from gonio.cli import main
from gonio.experiment import Experiment
from gonio.goniometer import Goniometer
from gonio.plots import style
from gonio.self_check import Check, SelfCheckReport
from gonio.sphere import direction

TOY = """
title = "A toy"
realisations = 2
[surface]
kind = "Gaussian"
alpha = 0.3
side = 100.0
samples = 32
[material]
kind = "Conductor"
name = "Au"
[goniometer]
theta_i = [0.0, 30.0]
paths = 400
replicates = 4
detector = {kind = "HemisphereGrid", theta_step = 10.0, phi_step = 20.0}
"""

KLEMS = """[goniometer]
paths = 4000
replicates = 4
detector = {kind = "Klems", basis = "quarter"}
"""

Gonio = Callable[..., tuple[int, str, str]]
Calls = list[tuple[str, tuple[Any, ...], dict[str, Any]]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Gonio:
    """Runs `gonio` in a folder of its own that holds toy.toml; (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    Path("toy.toml").write_text(TOY)

    def command(*tokens: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as exit_:
            main(tokens)
        out, err = capsys.readouterr()
        assert isinstance(exit_.value.code, int)
        assert "Traceback" not in err
        return exit_.value.code, out, err

    return command


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
    """A folder with two measurements that come from elsewhere: colours without errors, a spectrum with them."""
    folder = tmp_path_factory.mktemp("tables")
    gold = gonio.models.CookTorrance(m=0.3, material=gonio.Conductor("Au"))
    colours = {"basis": "RGB", "title": "colours"}
    gonio.save(external(gold, wavelengths=(611.4, 549.1, 464.2), attributes=colours), folder / "colours.nc")
    gonio.save(external(gold, noise=0.03, wavelengths=(450.0, 650.0)), folder / "spectrum.nc")
    return folder


def files() -> set[str]:
    return {str(path) for path in Path().rglob("*") if path.is_file()}


# --- What it does ----------------------------------------------------------------------------------------------------


def test_run_writes_the_results_and_prints_what_was_measured(run: Gonio) -> None:
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


def test_without_pictures_no_older_ones_are_left_beside_new_numbers(run: Gonio) -> None:
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


def test_without_plotly_a_run_says_what_adds_the_page(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_an_aperture_measurement_says_which_pictures_it_has_none_of(run: Gonio) -> None:
    code, _, err = run("run", "toy.toml", "--set", "goniometer.detector={kind='Apertures', directions=[[30.0, 180.0]]}")
    assert code == 0
    assert "No lobes.png: " in err
    assert "out/toy/measurement.nc" in files()
    assert "out/toy/lobes.png" not in files()


@pytest.mark.parametrize("name", ["toy.npy", "toy.exr", "toy.png", "toy.x3p", "new/toy.ply", "toy.stl", "toy.obj"])
@pytest.mark.parametrize("option", ["--to", "-o"])
def test_surface_prints_statistics_and_saves(run: Gonio, option: str, name: str) -> None:
    code, out, _ = run("surface", "toy.toml", option, name)
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


def test_compare_judges_the_models_asked_for(run: Gonio, measured: Path) -> None:
    code, out, _ = run("compare", str(measured), "--model", "Microfacet")
    assert code == 0
    assert "Microfacet" in out
    assert "CookTorrance" not in out


def test_compare_takes_settings_and_files_and_writes_numbers_and_maps(run: Gonio, measured: Path) -> None:
    Path("two.toml").write_text(
        '[[model]]\nkind = "Microfacet"\nmasking = {kind = "VCavity"}\n[[model]]\nkind = "Microfacet"'
    )
    tokens = ("--model", "cook-torrance m=0.5 k_d=0.1", "--model", "two.toml", "--all", "-o", "comparisons")
    code, out, _ = run("compare", str(measured), *tokens)
    assert code == 0
    assert all(len(line) <= 80 for line in out.splitlines())
    for words in (
        "Microfacet (Beckmann, VCavity)",
        "L2 (noise)",
        "log-RMS",
        "chi² MC",
        "All models, the best lobe first",
    ):
        assert words in out
    names = ("CookTorrance", "Microfacet-2", "Microfacet-3")
    assert files() == {
        "toy.toml",
        "two.toml",
        *(f"comparisons/{name}.{kind}" for name in names for kind in ("nc", "png")),
    }
    with xr.open_dataset("comparisons/CookTorrance.nc", engine="h5netcdf", group="table") as table:
        assert table["l1"].shape == (2, 1, 3)
        assert "m=0.5" in table.attrs["model"]
        assert "k_d=0.1, k_s=0.9" in table.attrs["model"]
    with xr.open_dataset("comparisons/CookTorrance.nc", engine="h5netcdf", group="lobes") as lobes:
        assert lobes["significance"].shape == (2, 1, 10, 18, 3)


@pytest.mark.usefixtures("undrawn")
def test_a_model_that_no_detector_resolves_is_told(run: Gonio) -> None:
    assert run("run", "toy.toml", "--set", "goniometer.theta_i=[30.0]", "--quiet")[0] == 0
    models = ("--model", "microfacet distribution.alpha=1e-9", "--model", "ward alpha=1")
    code, out, err = run("compare", "out/toy/measurement.nc", *models)
    assert code == 1
    assert "lobe too narrow" in err
    assert err.splitlines()[-1] == "1 of 2 models could not be compared."
    assert "Ward" in out


def test_fit_prints_parameters_and_writes_models(run: Gonio, measured: Path) -> None:
    tokens = ("--model", "cook-torrance", "--model", "microfacet", "--wavelength", "550", "-o", "new/fits.toml")
    code, out, _ = run("fit", str(measured), *tokens)
    assert code == 0
    assert all(len(line) <= 80 for line in out.splitlines())
    for words in ("95 % interval", "facets", "QAICc - best", "Models of the light of one hit, the best first"):
        assert words in out
    fitted = tomllib.loads(Path("new/fits.toml").read_text())["model"]
    assert [model["kind"] for model in fitted] == ["CookTorrance", "Microfacet"]
    assert f"{fitted[0]['m']:.2f}" in out
    code, out, _ = run("compare", str(measured), "--model", "new/fits.toml")
    assert code == 0
    assert "All models" in out


def test_fit_draws_what_it_found(run: Gonio, measured: Path) -> None:
    tokens = ("fit", str(measured), "--model", "cook-torrance", "--wavelength", "550")
    code, out, _ = run(*tokens, "--picture", "new/fits.png")
    assert code == 0
    assert out.splitlines()[-1] == "new/fits.png"
    colour = np.array([int(style.FITTED[0][k : k + 2], 16) for k in (1, 3, 5)])
    found = (np.abs(np.asarray(Image.open("new/fits.png").convert("RGB")).astype(int) - colour) < 20).all(axis=-1)
    # The curve on the left, the interval on the right.
    left, right = np.array_split(found.any(axis=0), [found.shape[1] * 6 // 10])
    assert left.sum() > 100
    assert right.sum() > 100
    code, out, err = run(*tokens, "--picture", "fits.bmp2")
    assert (code, out) == (2, "")
    assert "cannot draw into 'fits.bmp2': the suffixes are" in err


def test_fit_frees_what_is_named(run: Gonio, measured: Path) -> None:
    code, out, _ = run("fit", str(measured), "--model", "cook-torrance k_s=0.9", "--free", "m", "--free", "k_s")
    assert code == 0
    assert "Correlations" in out
    assert re.search(r"^ k_s ", out, flags=re.M)


GOLD = "cook-torrance m=0.3 material.name=Au"


def test_a_table_from_elsewhere_is_compared(run: Gonio, tables: Path) -> None:
    code, out, err = run("compare", str(tables / "colours.nc"), "--model", GOLD, "-o", "comparisons")
    assert (code, err) == (0, "")
    assert all(len(line) <= 80 for line in out.splitlines())
    assert re.search(r"0\.0% +- +unknown", out)
    assert " 611.4" not in out
    words = " ".join(out.split())
    for sentence in ("its file gives no errors", "was compared with all of it", "consistent with noise is unknown"):
        assert sentence in words
    assert files() == {"toy.toml", "comparisons/CookTorrance.nc", "comparisons/CookTorrance.png"}
    two = ("--model", GOLD, "--model", "ward alpha=0.3 specular=0.8 reflectance=0.1")
    code, out, err = run("compare", str(tables / "spectrum.nc"), *two)
    assert (code, err) == (0, "")
    words = " ".join(out.split())
    assert "CookTorrance, m 0.3: the difference is consistent with the noise that its file tells" in words
    assert "reflectance 0.1: the difference is significant beyond noise" in words
    assert "nan" not in out


def test_a_table_from_elsewhere_is_fitted(run: Gonio, tables: Path) -> None:
    for name, told in (("colours", False), ("spectrum", True)):
        code, out, err = run("fit", str(tables / f"{name}.nc"), "--model", "cook-torrance material.name=Au")
        assert (code, err) == (0, "")
        (value,) = re.findall(r"^ m +([\d.]+)", out, flags=re.M)
        assert float(value) == pytest.approx(0.3, abs=2e-3 if told else 1e-5)
        assert ("intervals speak of lack of fit only" in " ".join(out.split())) != told
        assert "nan" not in out


def test_a_table_from_elsewhere_is_drawn(run: Gonio, tables: Path) -> None:
    code, out, err = run("plot", str(tables / "colours.nc"), "-o", "pictures")
    assert (code, err) == (0, "")
    assert files() == {"toy.toml", *(f"pictures/{name}.png" for name in ("lobes", "slices", "hemisphere", "albedo"))}
    assert files() == {"toy.toml", *out.split()}


@pytest.mark.parametrize(
    ("tokens", "words"),
    [
        ("check NC", "comes from another program, without the sums that gonio counts"),
        ("compare NC", 'name one with --model, such as --model "cook-torrance m=0.3 material.name=Au".'),
        ("compare NC --model cook-torrance", "does not tell m and material.name of its specimen: give them, such as"),
        ("compare NC --model lambert", "does not tell reflectance of its specimen: give it"),
        ("fit NC --model cook-torrance", "does not tell material.name of its specimen: give it"),
    ],
)
def test_what_a_table_does_not_tell_is_one_sentence(run: Gonio, tables: Path, tokens: str, words: str) -> None:
    code, out, err = run(*tokens.replace("NC", str(tables / "spectrum.nc")).split())
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


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
    code, out, _ = run("validate", "--quick", "--case", "number", "-o", "new/table.md")
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
    code, _, err = run("validate", "--quick", "--case", "hits", "--case", "pits", "-o", "table.md")
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

    names = ("lobes", "lobe_meshes", "slices", "hemisphere", "albedo", "difference", "sphere", "relief", "paths")
    for name in names:
        monkeypatch.setattr(f"gonio.plots.{name}", stand_in(name))
    return calls


def test_plot_draws_into_a_folder(run: Gonio, measured: Path) -> None:
    code, out, _ = run("plot", str(measured), "-o", "pictures")
    assert code == 0
    assert out.split() == [f"pictures/{name}.png" for name in ("lobes", "slices", "hemisphere", "albedo")]
    assert files() == {"toy.toml", *out.split()}
    assert all(Path(name).read_bytes().startswith(b"\x89PNG") for name in out.split())


@pytest.mark.parametrize(
    ("tokens", "name", "file", "options"),
    [
        ("--kind lobes --log --orders -o x.png", "lobes", "x.png", {"radius": "log", "orders": True}),
        ("--kind lobes --linear -o new/x.gltf", "lobe_meshes", "new/x.gltf", {"radius": "linear"}),
        ("--kind lobes --wavelength 450 -o out", "lobes", "out/lobes.png", {"wavelength": 450.0}),
        ("--kind hemisphere --wavelength 450 -o x.svg", "hemisphere", "x.svg", {"wavelength": 450.0}),
        ("--kind difference --model cook-torrance -o out", "difference", "out/difference.png", {}),
    ],
)
def test_plot_gives_each_kind_its_options(
    run: Gonio, measured: Path, blank: Calls, tokens: str, name: str, file: str, options: dict[str, Any]
) -> None:
    code, out, err = run("plot", str(measured), *tokens.split())
    assert (code, err, out) == (0, "", f"{file}\n")
    ((drawn, _, given),) = blank
    style = given.pop("style", None)
    if style is not None:
        assert given.pop("models") == ()
        given = {key: value for key, value in (given | vars(style)).items() if value not in (None, False)}
    assert (drawn, given) == (name, options)
    assert Path(file).exists()


def test_plot_draws_models_over_slices_and_beside_lobes_if_told(run: Gonio, measured: Path, blank: Calls) -> None:
    kinds = ("slice", "albedo", "sphere", "lobes")
    tokens = [word for kind in kinds for word in ("--kind", kind)]
    assert run("plot", str(measured), *tokens, "-o", "out")[0] == 0
    assert [name for name, _, _ in blank] == ["slices", "albedo", "sphere", "lobes"]
    assert [len(options["models"]) for _, _, options in blank] == [2, 2, 2, 0]
    blank.clear()
    assert run("plot", str(measured), *tokens, "-o", "out", "--model", "cook-torrance")[0] == 0
    assert [[type(model).__name__ for model in options["models"]] for _, _, options in blank] == [["CookTorrance"]] * 4


def test_plot_compares_every_model(run: Gonio, measured: Path, blank: Calls) -> None:
    code, out, _ = run("plot", str(measured), "--kind", "difference", "-o", "out")
    assert code == 0
    assert out.split() == ["out/difference-CookTorrance.png", "out/difference-Microfacet.png"]
    assert [type(comparison.model).__name__ for _, (_, comparison), _ in blank] == ["CookTorrance", "Microfacet"]


@pytest.mark.parametrize("source", ["NC", "toy.toml"])
def test_plot_shows_the_surface_that_was_measured(run: Gonio, measured: Path, blank: Calls, source: str) -> None:
    file = source.replace("NC", str(measured))
    code, out, _ = run("plot", file, "--kind", "surface", "--kind", "paths", "--theta-i", "60", "-o", "out")
    assert code == 0
    assert out.split() == ["out/surface.png", "out/paths.png"]
    experiment = Experiment.read("toy.toml")
    (_, (first,), relief), (_, (second,), paths) = blank
    assert first == second == experiment.surface
    assert paths == {**relief, "theta_i": 60.0}
    built = first.build(relief["seed"])
    np.testing.assert_array_equal(built.heights, experiment.relief().heights)
    if source == "NC":
        assert run("plot", file, "--kind", "lobes", "--ground", "-o", "out")[0] == 0
        np.testing.assert_array_equal(blank[-1][2]["style"].ground.heights, built.heights)


@pytest.mark.parametrize(
    ("tokens", "words"),
    [
        ("NC --kind lobse", "--kind lobse: there is no such picture; did you mean lobes?"),
        ("NC --kind q", "--kind q: there is no such picture; choose lobes, slice, "),
        ("NC --kind slice --log", "--log or --linear means nothing here: add --kind lobes."),
        ("NC --theta-i 30", "--theta-i means nothing here: add --kind paths."),
        ("NC -o x.png", "x.png: 4 pictures need a folder; choose a single one with --kind."),
        ("NC --kind lobes -o x.xyz", "the suffixes are .eps, "),
        ("NC --kind lobes --orders --overlaid -o x.png", "lobes: lobes show one at a time"),
        ("TABLE --kind surface", "its surface has no recipe"),
        ("TABLE --kind difference", "No model describes this specimen by itself; name one with --model"),
        ("toy.toml --kind slice", "not a measurement that gonio wrote"),
    ],
)
def test_plot_tells_in_a_sentence_what_it_cannot_draw(
    run: Gonio, measured: Path, tables: Path, tokens: str, words: str
) -> None:
    tokens = tokens.replace("NC", str(measured)).replace("TABLE", str(tables / "colours.nc"))
    code, out, err = run("plot", *tokens.split())
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1
    assert files() == {"toy.toml"}


def test_plot_without_a_screen_draws_and_says_so(run: Gonio, measured: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    code, _, err = run("plot", str(measured), "--kind", "lobes", "--show", "-o", "x.vtp")
    assert code == 1
    assert err.startswith("No window: there is no screen")
    assert Path("x.vtp").exists()


def test_export_writes_the_format_of_the_suffix(run: Gonio, measured: Path) -> None:
    code, out, _ = run("export", str(measured), "--to", "new/toy.exr")
    assert code == 0
    assert out.startswith(str(Path("new/toy.exr")))
    assert "Read back, albedos change by at most" in out
    assert run("export", str(measured), "--to", "toy.data", "--format", "exr")[0] == 0
    assert Path("toy.data").read_bytes()[:4] == Path("new/toy.exr").read_bytes()[:4] == b"\x76\x2f\x31\x01"


def test_list_shows_every_recipe_and_every_parameter(run: Gonio) -> None:
    code, out, _ = run("list")
    assert code == 0
    assert all(len(line) <= 80 for line in out.splitlines())
    for words in ("Gaussian", "correlation_length", "HemisphereGrid", "CookTorrance", "Au", "N-BK7", "doi:10.1103"):
        assert words in out
    assert "Cook and E. Torrance" in " ".join(run("list", "Gaussian")[1].split()).replace("K. E.", "E.")


def test_help_and_version_import_nothing_heavy() -> None:
    for flag in ("--help", "--version"):
        code = f"import sys; sys.argv = ['gonio', {flag!r}]\nimport atexit\n" + (
            "atexit.register(lambda: print(sorted({m.split('.')[0] for m in sys.modules})))\n"
            "from gonio.cli import main; main()"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        loaded = done.stdout.splitlines()[-1]
        assert "cyclopts" in loaded
        for heavy in ("numpy", "pydantic", "numba", "scipy", "xarray", "matplotlib", "pyvista", "trimesh", "embreex"):
            assert f"'{heavy}'" not in loaded


def test_python_m_gonio_is_the_same_command() -> None:
    done = subprocess.run([sys.executable, "-m", "gonio", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == gonio.__version__


def test_public_names_are_all_there() -> None:
    for name in gonio.__all__:
        assert getattr(gonio, name) is not None
    assert callable(gonio.compare)
    assert set(dir(gonio)) == set(gonio.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        gonio.nothing  # noqa: B018  (the lookup is the test)


# --- What goes wrong -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tokens", "code", "words"),
    [
        ("run missing.toml", 2, "missing.toml: there is no such file"),
        ("run toy.tml", 2, "did you mean toy.toml?"),
        ("run", 2, "CONFIG requires an argument"),
        ("rum toy.toml", 2, 'Did you mean "run"?'),
        ("run toy.toml --thread 2", 2, "Did you mean --threads?"),
        ("run toy.toml --threads two", 2, 'unable to convert "two" into int'),
        ("run toy.toml --threads 0", 2, "--threads 0: must be 1 or more."),
        ("run toy.toml --seed -1", 2, "seed = -1: must be 0 or more."),
        ("run toy.toml --set nonsense", 2, "--set 'nonsense': must be key=value"),
        ("run toy.toml --set surface.aplha=1", 2, "did you mean alpha?"),
        ("run toy.toml --set surface.alpha=-1", 2, "surface.alpha = -1: must be greater than 0."),
        ("run toy.toml --set goniometer.theta_i=[90]", 2, "goniometer.theta_i[0] = 90: must be less than 90."),
        ("run toy.toml --set material.kind=Gold", 2, "choose Mirror, Conductor, Dielectric or Lambertian."),
        ("run toy.toml -o toy.toml", 1, "toy.toml is a file: give another folder with -o."),
        ("run toy.toml -o toy.toml/sub", 1, "toy.toml/sub cannot be written"),
        ("surface toy.toml --to toy.bmp", 2, "expected one of .npy, .png, .exr, .x3p, .ply, .stl, .obj."),
        ("surface toy.toml -o toy.toml/x.npy", 1, "toy.toml is a file"),
        ("compare missing.nc", 2, "missing.nc: there is no such file"),
        ("compare toy.toml", 2, "not a measurement that gonio wrote"),
        ("plot toy.toml", 2, "not a measurement that gonio wrote"),
        ("fit toy.toml --model ward", 2, "not a measurement that gonio wrote"),
        ("check toy.toml", 2, "not a measurement that gonio wrote"),
        ("check missing.nc", 2, "missing.nc: there is no such file"),
        ("validate --case nonsense", 2, "no such case; they are V-grooves"),
        ("export toy.toml --to x.exr", 2, "not a measurement that gonio wrote"),
        ("list Gausian", 2, "did you mean Gaussian?"),
    ],
)
def test_what_goes_wrong_is_one_sentence(run: Gonio, tokens: str, code: int, words: str) -> None:
    found, out, err = run(*tokens.split())
    assert found == code
    assert words in err
    assert err.count("\n") == 1
    assert err.endswith((".\n", "?\n"))
    assert out == ""
    assert files() == {"toy.toml"}


@pytest.mark.parametrize(
    ("tokens", "code", "words"),
    [
        ("compare NC --model Wardd", 2, "Wardd: there is no such model"),
        ("compare NC --model Lambert", 2, "Lambert"),
        ("compare NC --model missing.toml", 2, "missing.toml: there is no such file"),
        ("compare NC --model toy.toml", 2, "has no tables [[model]] with a kind"),
        ("compare NC --relative-threshold 2", 2, "--relative-threshold 2: must be 0 or more and less than 1"),
        ("fit NC", 2, "--model"),
        ("fit NC --model ward --free m", 2, "'m' is no parameter of Ward that can be fitted"),
        ("fit NC --model cook-torrance --free m --free m_x", 2, "cannot be fitted together"),
        ("fit NC --model cook-torrance --theta-i 5", 2, "theta_i = 5: not measured; choose from 0, 30 degrees"),
        ("export NC --to toy.foo", 2, "the formats are rgl (.bsdf)"),
        ("export NC --to toy.toml/x.exr", 1, "toy.toml is a file"),
        ("plot NC -o toy.toml", 1, "is a file"),
        ("compare CUT", 2, "not a measurement that gonio wrote"),
    ],
)
def test_what_goes_wrong_with_a_measurement_is_one_sentence(
    run: Gonio, measured: Path, tokens: str, code: int, words: str
) -> None:
    Path("cut.nc").write_bytes(measured.read_bytes()[:5000])
    found, out, err = run(*tokens.replace("NC", str(measured)).replace("CUT", "cut.nc").split())
    assert found == code
    assert words in err
    assert err.count("\n") == 1
    assert out == ""
    assert files() == {"toy.toml", "cut.nc"}


def test_all_mistakes_are_told_one_a_line(run: Gonio) -> None:
    code, _, err = run("run", "toy.toml", "--set", "surface.alpha=nan", "--set", "material.name=3", "--set", "seed=-1")
    assert code == 2
    assert [line.split(" ")[0] for line in err.splitlines()] == ["surface.alpha", "material.name", "seed"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (np.array([[0.0, np.nan], [0.0, 0.0]]), "NaN"),
        (np.zeros((1, 1)), "expected at least 2 x 2"),
        (b"", "damaged or of another type"),
    ],
)
def test_a_bad_height_map_is_one_sentence_and_writes_nothing(
    run: Gonio, content: np.ndarray | bytes, words: str
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


def test_ctrl_c_before_anything_was_measured_writes_nothing(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(self: ms.Gaussian, seed: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(ms.Gaussian, "build", interrupted)
    assert run("run", "toy.toml") == (1, "", "Interrupted before anything was measured: nothing was written.\n")
    assert files() == {"toy.toml"}


def test_ctrl_c_while_drawing_keeps_the_numbers(run: Gonio, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("gonio.plots.lobes", interrupted)
    code, _, err = run("run", "toy.toml")
    assert (code, err) == (1, "Interrupted.\n")
    assert files() == {"toy.toml", "out/toy/measurement.nc", "out/toy/experiment.toml"}


def test_a_full_disk_loses_nothing(
    run: Gonio, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
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


def test_too_little_memory_is_one_sentence(run: Gonio) -> None:
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
    found = written.evaluate(np.broadcast_to(direction(theta, phi), wo.shape), wo)
    expected = (
        gonio.formats.lobes.Lobes.of(measured)
        .in_basis(written.basis)
        .evaluate(np.broadcast_to(direction(theta, phi), wo.shape), wo)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
    assert found[:, 0].argmax() == lobe[:, 0].argmax()
