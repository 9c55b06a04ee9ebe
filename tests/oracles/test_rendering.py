"""Path-traced pictures: energy, agreement with the shaded sphere, and sentences for what cannot be rendered."""

import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from readers.mitsuba import MITSUBA

import gonio
from gonio import appearance, rendering
from gonio.cli import main
from gonio.detectors import HemisphereGrid
from gonio.models import Beckmann, Lambert, Microfacet, SmithCorrelated
from gonio.optics import Conductor

GOLD = Microfacet(distribution=Beckmann(0.3), masking=SmithCorrelated(), material=Conductor("Au"))
SIZE = 48


def measured(model):
    """A model as another program would have measured it."""
    return appearance.coloured(model).sampled(np.arange(0.0, 86.0, 5.0), 0.0, HemisphereGrid(2.0, 3.0))


@pytest.fixture(scope="module")
def gold(tmp_path_factory):
    """Gold, and the file that Mitsuba reads."""
    measurement = measured(GOLD)
    path = tmp_path_factory.mktemp("gold") / "gold.bsdf"
    gonio.export(measurement, path, "rgl")
    return measurement, path


def run(capsys, *tokens):
    with pytest.raises(SystemExit) as stop:
        main([str(token) for token in tokens])
    out, err = capsys.readouterr()
    return stop.value.code, out, err


@MITSUBA
@pytest.mark.parametrize("name", ["gold", "grey"])
def test_in_a_white_furnace_a_ball_sends_its_albedo(name, gold):
    """Of radiance 1 all around a ball sends, on average over its disc, its albedo averaged with sin 2 theta."""
    measurement = gold[0] if name == "gold" else measured(Lambert(reflectance=0.7))
    image = rendering.radiances(
        gold[1] if name == "gold" else measurement, "ball", SIZE, 64, sky=np.ones_like, irradiance=0
    )
    inside = appearance.silhouette(SIZE) == 1
    radius = np.hypot(*np.meshgrid(*[(np.arange(SIZE) + 0.5) * 2 / SIZE - 1] * 2))
    theta = np.degrees(np.arcsin(radius[inside]))
    albedo = measurement.dataset["albedo"].values[0, :, 0]
    expected = [np.interp(theta, measurement.dataset["theta_i"], albedo[:, c]).mean() for c in range(3)]
    assert image[inside].mean(axis=0) == pytest.approx(expected, rel=0.01)


@MITSUBA
def test_a_traced_ball_is_the_shaded_one(gold):
    """Nothing is reflected twice by a ball alone: both see the same source and the same sky."""
    traced = rendering.radiances(gold[1], "ball", SIZE, 256)
    shaded = appearance.sphere(gold[0], SIZE)
    inside = appearance.silhouette(SIZE) == 1
    assert traced[inside].mean(axis=0) == pytest.approx(shaded[inside].mean(axis=0), rel=0.01)
    # Noise of 256 paths, and half a texel of the highlight.
    assert np.abs(traced - shaded)[inside].mean() < 0.05 * shaded[inside].mean()
    for image in (traced, shaded):
        row, column = np.unravel_index(np.where(inside, image[..., 0], 0).argmax(), inside.shape)
        assert row < SIZE / 2 > column


@MITSUBA
def test_the_sky_stands_the_right_way_round(gold):
    """Red from the right, green from behind the ball, blue from above."""

    def sky(w):
        return 1.0 + w

    traced = rendering.radiances(gold[1], "ball", SIZE, 256, sky=sky, irradiance=0)
    shaded = appearance.sphere(gold[0], SIZE, sky=sky, irradiance=0.0)
    inside = appearance.silhouette(SIZE) == 1
    assert np.abs(traced - shaded)[inside].mean() < 0.03 * shaded[inside].mean()
    left, right = shaded[SIZE // 2, 8, 0], shaded[SIZE // 2, -9, 0]
    assert right > 2 * left


@MITSUBA
def test_seeds_decide_and_the_floor_has_a_shadow(gold):
    pictures = [rendering.radiances(gold[1], "sphere", 32, 32, seed=seed) for seed in (1, 1, 2)]
    # To the rounding of sums in any order.
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=1e-4)
    assert np.abs(pictures[0] - pictures[2]).mean() > 1e-3
    floor = pictures[0][24:28].mean(axis=-1)
    # The source is at the upper left: the shadow lies on the right.
    assert floor[:, -3:].min() < 0.6 * floor[:, :3].mean()


@MITSUBA
def test_a_measurement_its_brdf_and_its_files_give_one_picture(gold, tmp_path):
    measurement, bsdf = gold
    sources = (measurement, gonio.BRDF.of(measurement), gonio.save(measurement, tmp_path / "gold.nc"), bsdf)
    pictures = []
    for k, source in enumerate(sources):
        path = gonio.render(source, tmp_path / f"{k}.png", scene="ball", size=8, spp=4)
        with Image.open(path) as picture:
            pictures.append(np.asarray(picture).astype(int))
    for other in pictures[1:]:
        np.testing.assert_allclose(other, pictures[0], atol=1)


@MITSUBA
def test_the_command_writes_pictures(gold, tmp_path, capsys):
    code, out, err = run(
        capsys, "render", gold[1], "--to", tmp_path / "a.png", "--size", 24, "--spp", 4, "--scene", "cylinder"
    )
    assert (code, out.strip(), err) == (0, str(tmp_path / "a.png"), "")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (24, 24)
    gonio.save(gold[0], tmp_path / "gold.nc")
    assert run(capsys, "render", tmp_path / "gold.nc", "--to", tmp_path / "a.exr", "--size", 16, "--spp", 4)[0] == 0
    import OpenEXR

    pixels = OpenEXR.File(str(tmp_path / "a.exr")).channels()["RGB"].pixels
    np.testing.assert_allclose(pixels, rendering.radiances(gold[0], size=16, spp=4), rtol=1e-5)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.exr", "a.png", "gold.nc"]


@MITSUBA
def test_spectra_are_turned_into_colours(tmp_path):
    spectrum = gonio.BRDF(
        lambda wi, wo: GOLD.eval(wi, wo, [450.0, 550.0, 650.0]), np.array([450.0, 550.0, 650.0]), np.arange(0, 90, 10.0)
    )
    gonio.export(spectrum, tmp_path / "gold.bsdf", "rgl-spectral")
    image = rendering.radiances(tmp_path / "gold.bsdf", "ball", 16, 16)
    red, _, blue = image[appearance.silhouette(16) == 1].mean(axis=0)
    assert red > 1.3 * blue


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--to", "x.jpg"), "x.jpg.*the suffixes are .exr and .png"),
        (("--to", "x.png", "--scene", "sphera"), "no scene 'sphera'; did you mean sphere"),
        (("--to", "x.png", "--size", "0"), "size = 0: must be a whole number from 1 to"),
        (("--to", "x.png", "--spp", "-3"), "spp = -3: must be a whole number from 1 to"),
    ],
)
def test_what_cannot_be_rendered_is_told_in_one_sentence(more, words, gold, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, "render", gold[1], *more)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert re.search(words, err)
    assert not list(tmp_path.iterdir())


@MITSUBA
def test_files_that_are_none_are_told(tmp_path, capsys):
    (tmp_path / "not.bsdf").write_text("hello")
    code, _, err = run(capsys, "render", tmp_path / "not.bsdf", "--to", tmp_path / "x.png")
    assert (code, err.count("\n")) == (2, 1)
    assert "not a tensor file" in err
    code, _, err = run(capsys, "render", tmp_path / "none.bsdf", "--to", tmp_path / "x.png")
    assert (code, err.count("\n")) == (2, 1)
    assert "there is no such file" in err


def test_without_mitsuba_one_sentence_says_what_to_install(gold, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    code, out, err = run(capsys, "render", gold[1], "--to", tmp_path / "x.png")
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert "pip install mitsuba" in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("program", "variant"), [("import os; os.abort()", "scalar_rgb"), ("pass", "llvm_ad_rgb")])
def test_a_compiler_that_would_end_the_program_is_not_used(program, variant, monkeypatch):
    """Old LLVM libraries abort the process that uses them, as Debian 12's does."""
    chosen = []
    rendering._fast_variant_works.cache_clear()
    monkeypatch.setattr(rendering, "PROBE", program)
    rendering._choose_variant(SimpleNamespace(set_variant=chosen.append))
    rendering._fast_variant_works.cache_clear()
    assert chosen == [variant]
