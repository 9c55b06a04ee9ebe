"""`gonio compare | fit`: models are compared with measurements, and fitted to them."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from gonio.plots import style

Gonio = Callable[..., tuple[int, str, str]]
Files = Callable[[], set[str]]

GOLD = "cook-torrance m=0.3 material.name=Au"


def test_compare_judges_the_models_asked_for(run: Gonio, measured: Path) -> None:
    code, out, _ = run("compare", str(measured), "--model", "Microfacet")
    assert code == 0
    assert "Microfacet" in out
    assert "CookTorrance" not in out


def test_compare_takes_settings_and_files_and_writes_numbers_and_maps(run: Gonio, files: Files, measured: Path) -> None:
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
    models = ("--model", "cook-torrance", "--model", "microfacet")
    tokens = (*models, "--wavelength", "550", "650", "--to", "new/fits.toml")
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
    code, out, _ = run(*tokens, "--to", "new/fits.png")
    assert code == 0
    assert out.splitlines()[-1] == "new/fits.png"
    colour = np.array([int(style.FITTED[0][k : k + 2], 16) for k in (1, 3, 5)])
    found = (np.abs(np.asarray(Image.open("new/fits.png").convert("RGB")).astype(int) - colour) < 20).all(axis=-1)
    # The curve on the left, the interval on the right.
    left, right = np.array_split(found.any(axis=0), [found.shape[1] * 6 // 10])
    assert left.sum() > 100
    assert right.sum() > 100
    code, out, err = run(*tokens, "--to", "fits.bmp2")
    assert (code, out) == (2, "")
    assert "cannot draw into 'fits.bmp2': the suffixes are" in err


def test_fit_frees_what_is_named(run: Gonio, measured: Path) -> None:
    code, out, _ = run("fit", str(measured), "--model", "cook-torrance k_s=0.9", "--free", "m", "--free", "k_s")
    assert code == 0
    assert "Correlations" in out
    assert re.search(r"^ k_s ", out, flags=re.M)


def test_an_external_table_is_compared(run: Gonio, files: Files, tables: Path) -> None:
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


def test_an_external_table_is_fitted(run: Gonio, tables: Path) -> None:
    for name, told in (("colours", False), ("spectrum", True)):
        code, out, err = run("fit", str(tables / f"{name}.nc"), "--model", "cook-torrance material.name=Au")
        assert (code, err) == (0, "")
        (value,) = re.findall(r"^ m +([\d.]+)", out, flags=re.M)
        assert float(value) == pytest.approx(0.3, abs=2e-3 if told else 1e-5)
        assert ("intervals speak of lack of fit only" in " ".join(out.split())) != told
        assert "nan" not in out


@pytest.mark.parametrize(
    ("tokens", "words"),
    [
        ("check NC", "comes from another program, without the sums that gonio counts"),
        ("compare NC", 'name one with --model, such as --model "cook-torrance m=0.3 material.name=Au".'),
        ("compare NC --model cook-torrance", "nothing tells m and material.name of the specimen: give them, such as"),
        ("compare NC --model lambert", "nothing tells reflectance of the specimen: give it"),
        ("fit NC --model cook-torrance", "nothing tells material.name of the specimen: give it"),
    ],
)
def test_what_a_table_does_not_tell_is_one_sentence(run: Gonio, tables: Path, tokens: str, words: str) -> None:
    code, out, err = run(*tokens.replace("NC", str(tables / "spectrum.nc")).split())
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1
