"""`gonio plot`: what is drawn, into which files, with which options."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.experiment import Experiment

Gonio = Callable[..., tuple[int, str, str]]
Files = Callable[[], set[str]]
Calls = list[tuple[str, tuple[Any, ...], dict[str, Any]]]


def test_an_external_table_is_drawn(run: Gonio, files: Files, tables: Path) -> None:
    code, out, err = run("plot", str(tables / "colours.nc"), "-o", "pictures")
    assert (code, err) == (0, "")
    assert files() == {"toy.toml", *(f"pictures/{name}.png" for name in ("lobes", "slices", "hemisphere", "albedo"))}
    assert files() == {"toy.toml", *out.split()}


def test_plot_draws_into_a_folder(run: Gonio, files: Files, measured: Path) -> None:
    code, out, _ = run("plot", str(measured), "-o", "pictures")
    assert code == 0
    assert out.split() == [f"pictures/{name}.png" for name in ("lobes", "slices", "hemisphere", "albedo")]
    assert files() == {"toy.toml", *out.split()}
    assert all(Path(name).read_bytes().startswith(b"\x89PNG") for name in out.split())


@pytest.mark.parametrize(
    ("tokens", "name", "file", "options"),
    [
        ("--kind lobes --log --orders --to x.png", "lobes", "x.png", {"radius": "log", "orders": True}),
        ("--kind lobes --linear --to new/x.gltf", "lobe_meshes", "new/x.gltf", {"radius": "linear"}),
        ("--kind lobes --wavelength 450 -o out", "lobes", "out/lobes.png", {"wavelength": 450.0}),
        ("--kind hemisphere --wavelength 450 --to x.svg", "hemisphere", "x.svg", {"wavelength": 450.0}),
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


@pytest.mark.parametrize("values", ["450 550", "450 --wavelength 550", "450 550 450"])
def test_plot_draws_a_picture_for_each_wavelength(run: Gonio, measured: Path, blank: Calls, values: str) -> None:
    kinds = "--kind lobes --kind slice --kind difference --model cook-torrance -o out"
    code, out, err = run("plot", str(measured), *kinds.split(), "--wavelength", *values.split())
    assert (code, err) == (0, "")
    names = ("lobes-450nm", "lobes-550nm", "slices", "difference-450nm", "difference-550nm")
    assert out.split() == [f"out/{name}.png" for name in names]
    assert [options.get("wavelength") for _, _, options in blank] == [450.0, 550.0, None, 450.0, 550.0]
    assert blank[-1][1][1] is blank[-2][1][1], "a model is compared once"


def test_plot_draws_paths_for_each_incident_angle(run: Gonio, blank: Calls) -> None:
    code, out, _ = run("plot", "toy.toml", "--kind", "paths", "--theta-i", "0", "30", "-o", "out")
    assert code == 0
    assert out.split() == ["out/paths-0deg.png", "out/paths-30deg.png"]
    assert [options["theta_i"] for _, _, options in blank] == [0.0, 30.0]


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
        ("NC --to x.png", "--to x.png: takes a single picture, and these are lobes, slices, hemisphere, albedo;"),
        ("NC --kind lobes --wavelength 450 550 --to x.png", "these are lobes-450nm, lobes-550nm; choose a single one"),
        ("NC --kind lobes -o x.png", "must be a folder; the file of a single picture is given with --to."),
        ("NC --kind lobes --to x.png -o out", "give one of them."),
        ("NC --kind lobes --to .", "--to .: is a folder; give the name of a file."),
        ("NC --kind lobes --to x.xyz", "the suffixes are .eps, "),
        ("NC --kind lobes --orders --overlaid --to x.png", "lobes: lobes show one at a time"),
        ("TABLE --kind surface", "its surface has no recipe"),
        ("TABLE --kind difference", "No model describes this specimen by itself; name one with --model"),
        ("toy.toml --kind slice", "not a measurement that gonio wrote"),
    ],
)
def test_plot_tells_in_a_sentence_what_it_cannot_draw(
    run: Gonio, files: Files, measured: Path, tables: Path, tokens: str, words: str
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
    code, _, err = run("plot", str(measured), "--kind", "lobes", "--show", "--to", "x.vtp")
    assert code == 1
    assert err.startswith("No window: there is no screen")
    assert Path("x.vtp").exists()
