"""The command line as a whole: help, public names, lists, and what goes wrong."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gonio
from gonio.cli.terminal import app
from gonio.detectors import Detector
from gonio.models import Distribution, Masking, Model
from gonio.optics import Material
from microsurfaces.recipe import members

Gonio = Callable[..., tuple[int, str, str]]
Files = Callable[[], set[str]]


def test_export_writes_the_format_of_the_suffix(run: Gonio, measured: Path) -> None:
    code, out, _ = run("export", str(measured), "--to", "new/toy.exr")
    assert code == 0
    assert out.startswith(str(Path("new/toy.exr")))
    assert "Read back, albedos change by at most" in out
    assert run("export", str(measured), "--to", "toy.data", "--format", "exr")[0] == 0
    assert Path("toy.data").read_bytes()[:4] == Path("new/toy.exr").read_bytes()[:4] == b"\x76\x2f\x31\x01"


def test_export_writes_models_like_measurements(run: Gonio) -> None:
    model = "cook-torrance m=0.4 name=Au"
    code, out, err = run("export", model, "--to", "model.exr", "--wavelength", "450", "633")
    assert (code, err) == (0, "")
    assert "albedos change by at most" in " ".join(out.split())
    written = gonio.load("model.exr")
    expected = gonio.BRDF.of(gonio.CookTorrance(m=0.4, material=gonio.Conductor("Au")), [450.0, 633.0])
    np.testing.assert_allclose(gonio.BRDF.of(written).albedo(30.0), expected.albedo(30.0), rtol=1e-6)


@pytest.mark.parametrize(
    ("model", "words"),
    [("microfacet alpha=0.3", "nothing tells material.name"), ("microfaset m=1", "did you mean Microfacet")],
)
def test_export_says_what_a_model_lacks(run: Gonio, model: str, words: str) -> None:
    code, _, err = run("export", model, "--to", "x.exr")
    assert code == 2
    assert words in err


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


def test_every_option_has_a_sentence_of_its_own() -> None:
    """One line in the source each: the help keeps the source's line ends, and wraps at the terminal's width besides."""
    commands = [app[name] for name in app if not name.startswith("-")]
    commands += [command[name] for command in commands for name in command if not name.startswith("-")]
    for command in commands:
        for argument in command.assemble_argument_collection(parse_docstring=True) if command.default_command else ():
            if argument.show:
                assert argument.parameter.help, f"{argument.name} of {command.name} is not described"
                assert "\n" not in argument.parameter.help, f"{argument.name} of {command.name}: more than a line"


@pytest.mark.parametrize(("name", "what"), [("check", "measurement"), ("validate", "installation")])
def test_two_checks_are_told_apart(run: Gonio, name: str, what: str) -> None:
    code, out, _ = run(name, "--help")
    assert code == 0
    assert what in out


def test_python_m_gonio_is_the_same_command() -> None:
    done = subprocess.run([sys.executable, "-m", "gonio", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == gonio.__version__


@pytest.mark.parametrize("union", [Model, Material, Detector, Distribution, Masking], ids=str)
def test_every_recipe_of_light_is_public(union: Any) -> None:
    for name, cls in members(union).items():
        assert getattr(gonio, name) is cls
        assert name in gonio.__all__


def test_public_names_are_all_there() -> None:
    for name in gonio.__all__:
        assert getattr(gonio, name) is not None
    declared = ast.parse(Path(gonio.__file__).read_text(encoding="utf-8")).body
    typed = [node for node in declared if isinstance(node, ast.If)]
    imported = {alias.asname for node in ast.walk(typed[0]) if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert imported | {"__version__"} == set(gonio.__all__), "type checkers see other names than Python"
    assert callable(gonio.compare)
    assert set(dir(gonio)) == set(gonio.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        gonio.nothing  # noqa: B018  (the lookup is the test)


@pytest.mark.parametrize(
    ("tokens", "code", "words"),
    [
        ("run missing.toml", 2, "missing.toml: there is no such file"),
        ("run toy.tml", 2, "did you mean toy.toml?"),
        ("run", 2, "gonio run needs CONFIG, which comes before the options; gonio run --help shows"),
        ("rum toy.toml", 2, "rum: gonio has no such command; did you mean run?"),
        ("campaign foo", 2, "foo: gonio campaign has no such command; gonio campaign --help shows them."),
        ("run toy.toml --thread 2", 2, "--thread: gonio run has no such option; did you mean --threads?"),
        ("run toy.toml --nothing", 2, "--nothing: gonio run has no such option; gonio run --help shows"),
        ("run toy.toml --threads two", 2, "--threads two: must be a whole number."),
        ("run toy.toml --threads", 2, "--threads: its value is missing;"),
        ("run toy.toml --quiet=3", 2, "--quiet takes no value."),
        ("run toy.toml --seed 1 --seed 2", 2, "--seed: given twice, or with its opposite; gonio run takes it once."),
        ("run toy.toml toy.toml", 2, "toy.toml: belongs to no option of gonio run; put quotes around"),
        ("run .", 2, ". is a folder"),
        ("run toy.toml --threads 0", 2, "--threads 0: must be 1 or more."),
        ("run toy.toml --seed -1", 2, "seed = -1: must be 0 or more."),
        ("run toy.toml --set nonsense", 2, "--set 'nonsense': must be key=value"),
        ("run toy.toml --set surface.aplha=1", 2, "did you mean alpha?"),
        ("run toy.toml --set surface.alpha=-1", 2, "surface.alpha = -1: must be greater than 0."),
        ("run toy.toml --set goniometer.theta_i=[90]", 2, "goniometer.theta_i[0] = 90: must be less than 90."),
        ("run toy.toml --set material.kind=Gold", 2, "choose Mirror, Conductor, Dielectric or Lambertian."),
        ("run toy.toml -o toy.toml", 2, "--output toy.toml: toy.toml is a file, not a folder."),
        ("run toy.toml -o toy.toml/sub", 2, "--output toy.toml/sub: toy.toml is a file, not a folder."),
        ("run toy.toml -o x.nc", 2, "--output x.nc: must be a folder, and this is the name of a file."),
        ("run toy.toml --to x.nc", 2, "--to: gonio run has no such option; did you mean --output?"),
        ("surface toy.toml --to toy.bmp", 2, "expected one of .npy, .png, .exr, .x3p, .ply, .stl, .obj."),
        ("surface toy.toml --to toy.toml/x.npy", 2, "--to toy.toml: toy.toml is a file, not a folder."),
        ("surface toy.toml --to .", 2, "--to .: is a folder; give the name of a file."),
        ("surface toy.toml -o x.npy", 2, "-o: gonio surface has no such option; did you mean --to?"),
        ("compare missing.nc", 2, "missing.nc: there is no such file"),
        ("compare toy.toml", 2, "not a measurement that gonio wrote"),
        ("plot toy.toml", 2, "not a measurement that gonio wrote"),
        ("fit toy.toml --model ward", 2, "not a measurement that gonio wrote"),
        ("check toy.toml", 2, "not a measurement that gonio wrote"),
        ("check .", 2, ". is a folder: give a .nc file."),
        ("check missing.nc", 2, "missing.nc: there is no such file"),
        ("validate --case nonsense", 2, "no such case; they are V-grooves"),
        ("export toy.toml --to x.exr", 2, "toy.toml: has no tables [[model]] with a kind"),
        ("export NC --to x.exr --wavelength 450", 2, "is written at the wavelengths that were measured"),
        ("validate --case number --to table.html", 2, "give a name that ends with .md."),
        ("list Gausian", 2, "did you mean Gaussian?"),
    ],
)
def test_what_goes_wrong_is_one_sentence(run: Gonio, files: Files, tokens: str, code: int, words: str) -> None:
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
        ("compare NC --model ward alpha=1", 2, "alpha=1: belongs to no option of gonio compare; put quotes around"),
        ("compare NC -o toy.toml", 2, "toy.toml is a file, not a folder"),
        ("fit NC", 2, "gonio fit needs --model;"),
        ("fit NC --model ward --theta 30", 2, "--theta: gonio fit has no such option; did you mean --theta-i?"),
        ("fit NC --model ward --wavelength", 2, "--wavelength: its value is missing"),
        ("fit NC --model ward --wavelength 450 green", 2, "--wavelength green: must be a number."),
        ("fit NC --model ward --to fits.nc", 2, "models are written to .toml."),
        ("fit NC --model ward --free m", 2, "'m' is no parameter of Ward that can be fitted"),
        ("fit NC --model cook-torrance --free m --free m_x", 2, "cannot be fitted together"),
        ("fit NC --model cook-torrance --theta-i 5", 2, "theta_i = 5: not measured; choose from 0, 30 degrees"),
        ("export NC --to toy.foo", 2, "the formats are rgl (.bsdf)"),
        ("export NC", 2, "gonio export needs --to;"),
        ("export NC --to toy.toml/x.exr", 2, "toy.toml is a file, not a folder"),
        ("plot NC -o toy.toml", 2, "toy.toml is a file, not a folder"),
        ("plot --wavelength 450 NC", 2, "gonio plot needs FILE, which comes before the options"),
        ("report NC -o x.html", 2, "-o: gonio report has no such option; did you mean --to?"),
        ("compare CUT", 2, "not a measurement that gonio wrote"),
    ],
)
def test_what_goes_wrong_with_a_measurement_is_one_sentence(
    run: Gonio, files: Files, measured: Path, tokens: str, code: int, words: str
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
