from __future__ import annotations

import dataclasses
import json
import tomllib
from pathlib import Path

import command_line
import numpy as np
import pytest
from synthetic import external

import gonio
import microsurfaces as ms
from gonio.experiment import Experiment
from gonio.models.specimen import models_for
from gonio.toml_files import InputError

TOY = command_line.TOY.replace("realisations = 2", "seed = 3\nrealisations = 2").replace(
    "paths = 400", "wavelengths = [550.0]\npaths = 400"
)


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    path = tmp_path / "toy.toml"
    path.write_text(TOY)
    return path


def mistakes(path: Path, *overrides: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        Experiment.read(path, overrides)
    return list(caught.value.sentences)


# --- Reading ---------------------------------------------------------------------------------------------------------


def test_a_file_becomes_recipes(toy: Path) -> None:
    assert Experiment.read(toy) == Experiment(
        surface=ms.Gaussian(alpha=0.3, side=100.0, samples=32),
        material=gonio.Conductor("Au"),
        goniometer=gonio.Goniometer(
            theta_i=(0.0, 30.0),
            wavelengths=(550.0,),
            paths=400,
            replicates=4,
            detector=gonio.HemisphereGrid(theta_step=10.0, phi_step=20.0),
        ),
        title="A toy",
        seed=3,
        realisations=2,
    )


@pytest.mark.parametrize(
    ("override", "value"),
    [
        ("surface.alpha=0.2", 0.2),
        ("surface.alpha = 2e-1", 0.2),
        ("surface.alpha=1", 1.0),
    ],
)
def test_overrides_are_toml_values(toy: Path, override: str, value: float) -> None:
    surface = Experiment.read(toy, [override]).surface
    assert isinstance(surface, ms.Gaussian)
    assert surface.alpha == value


def test_overrides_may_be_bare_words_lists_and_tables(toy: Path) -> None:
    changes = ["title=Silver", "material.name=Ag", "goniometer.theta_i=[10, 20.5]", "surface={kind='Flat'}"]
    experiment = Experiment.read(toy, changes)
    assert experiment.title == "Silver"
    assert experiment.material == gonio.Conductor("Ag")
    assert experiment.goniometer.theta_i == (10.0, 20.5)
    assert experiment.surface == ms.Flat()


@pytest.mark.parametrize("override", ["nonsense", "=3", "surface.alpha=", "surface..alpha=1", "surface.alpha.x=3"])
def test_what_is_no_override_is_one_sentence(toy: Path, override: str) -> None:
    (sentence,) = mistakes(toy, override)
    assert sentence.startswith(f"--set {override!r}: ")


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("", " is empty: "),
        ("# nothing\n", " is empty: "),
        ("seed = 1\ntitle = \n", ", line 2, column 9: "),
        ("seed = 1\nseed = 2\n", ", line 2, column 9: "),
        (TOY[: TOY.index("toy")], ", end of document: "),
        ("[surface", ", end of document: "),
        ("x = " + "[" * 5000, ": "),
    ],
)
def test_broken_toml_is_one_sentence_that_says_where(tmp_path: Path, text: str, place: str) -> None:
    path = tmp_path / "broken.toml"
    path.write_text(text)
    (told,) = mistakes(path)
    assert told.startswith(f"{path}{place}")
    assert told.endswith(".")


def test_files_that_are_none_are_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "binary.toml").write_bytes(bytes(range(128, 256)))
    (tmp_path / "gold_beckmann.toml").write_text(TOY)
    assert mistakes(tmp_path) == [f"{tmp_path} is a folder: give a TOML file."]
    assert mistakes(tmp_path / "binary.toml") == [
        f"{tmp_path / 'binary.toml'} is not text: an experiment is a TOML file in UTF-8."
    ]
    assert mistakes(tmp_path / "gold_bekmann.toml") == [
        f"{tmp_path / 'gold_bekmann.toml'}: there is no such file; did you mean {tmp_path / 'gold_beckmann.toml'}?"
    ]
    assert mistakes(tmp_path / "nowhere" / "x.toml") == [f"{tmp_path / 'nowhere' / 'x.toml'}: there is no such file."]


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("surface.alpha=-1", "surface.alpha = -1: must be greater than 0."),
        ("surface.alpha=nan", "surface.alpha = nan: must be a finite number."),
        ("surface.side=inf", "surface.side = inf: must be a finite number."),
        ("surface.alpha=1979-05-27", "surface.alpha = '1979-05-27': must be a number."),
        ("surface.aplha=1", "surface.aplha: Gaussian has no such parameter; did you mean alpha?"),
        ("surface.kind=Gausian", "surface.kind = 'Gausian': unknown; choose "),
        (
            "material={kind='Gold'}",
            "material.kind = 'Gold': unknown; choose Mirror, Conductor, Dielectric or Lambertian.",
        ),
        ("material={name='Au'}", "material.kind is missing: choose Mirror, Conductor, Dielectric or Lambertian."),
        ("material.name=Gold", "material.name = 'Gold': "),
        ("goniometer.theta_i=[90]", "goniometer.theta_i[0] = 90: must be less than 90."),
        ("goniometer.theta_i=[30, 10]", "goniometer.theta_i = [30.0, 10.0] must increase"),
        ("goniometer.theta_i=[]", "goniometer.theta_i = []: must be a list of 1 or more."),
        ("goniometer.paths=1e6", "goniometer.paths = 1000000.0: must be a whole number, written 1000000."),
        ("goniometer.wavelengths=[100.0]", "goniometer.wavelengths: Au has no refractive index at 100 nm"),
        ("goniometer.detector.theta_step=7", "goniometer.detector.theta_step = 7 must divide 90"),
        ("models=['Wardd']", "models = ['Wardd']: there is no such model; choose from "),
        ("models=['Lambert']", "models = ['Lambert']: "),
        ("realisations=0", "realisations = 0: must be 1 or more."),
        ("seed=-1", "seed = -1: must be 0 or more."),
        ("detector=3", "detector: Experiment has no such parameter"),
    ],
)
def test_a_wrong_value_is_one_sentence(toy: Path, override: str, sentence: str) -> None:
    (told,) = mistakes(toy, override)
    assert told.startswith(sentence)
    assert told.endswith((".", "?"))


def test_all_mistakes_of_a_file_are_told_at_once(toy: Path) -> None:
    told = mistakes(toy, "surface.alpha=-1", "nonsense", "material.kind=Gold", "goniometer.paths=0")
    assert [sentence.split(" ")[0] for sentence in told] == [
        "--set",
        "surface.alpha",
        "material.kind",
        "goniometer.paths",
    ]


# --- Writing ---------------------------------------------------------------------------------------------------------


def test_writing_and_reading_gives_the_same_experiment(toy: Path, tmp_path: Path) -> None:
    experiment = dataclasses.replace(Experiment.read(toy), models=("CookTorrance",))
    experiment.write(tmp_path / "resolved.toml")
    assert Experiment.read(tmp_path / "resolved.toml") == experiment


def test_a_resolved_file_has_every_default_and_kind_only_where_there_is_a_choice(toy: Path, tmp_path: Path) -> None:
    Experiment.read(toy).write(tmp_path / "resolved.toml")
    table = tomllib.loads((tmp_path / "resolved.toml").read_text())
    assert table["surface"]["correlation_length"] == 10.0
    assert table["goniometer"]["azimuth"] == "fixed"
    assert "kind" not in table
    assert "kind" not in table["goniometer"]
    assert next(iter(table["surface"])) == "kind"


def test_a_height_map_is_looked_for_beside_the_file(tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", np.zeros((4, 4)))
    (tmp_path / "map.toml").write_text(
        '[surface]\nkind = "HeightFieldFile"\npath = "map.npy"\npixel_size = 1.0\nunit = "um"\nperiodic = "as is"\n'
        '[material]\nkind = "Mirror"\n'
    )
    experiment = Experiment.read(tmp_path / "map.toml")
    assert isinstance(experiment.surface, ms.HeightFieldFile)
    assert experiment.surface.path == str(tmp_path / "map.npy")
    assert experiment.relief().period == (4.0, 4.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("path='missing.npy'", "does not exist"),
        ("path='nan.npy'", "NaN or infinite"),
        ("path='pixel.npy'", "expected at least 2 x 2"),
        ("path='cut.npy'", "damaged or of another type"),
        ("path='empty.npy'", "damaged or of another type"),
    ],
)
def test_a_bad_height_map_is_one_sentence(tmp_path: Path, change: str, words: str) -> None:
    np.save(tmp_path / "map.npy", np.zeros((4, 4)))
    np.save(tmp_path / "nan.npy", np.array([[0.0, 1.0], [np.nan, 0.0]]))
    np.save(tmp_path / "pixel.npy", np.zeros((1, 1)))
    (tmp_path / "cut.npy").write_bytes((tmp_path / "map.npy").read_bytes()[:150])
    (tmp_path / "empty.npy").write_bytes(b"")
    (tmp_path / "map.toml").write_text(
        '[surface]\nkind = "HeightFieldFile"\npath = "map.npy"\npixel_size = 1.0\nunit = "um"\nperiodic = "as is"\n'
        '[material]\nkind = "Mirror"\n'
    )
    with pytest.raises(InputError) as caught:
        Experiment.read(tmp_path / "map.toml", [f"surface.{change}"]).scene()
    (sentence,) = caught.value.sentences
    assert words in sentence
    assert "\n" not in sentence
    assert mistakes(tmp_path / "map.toml", "surface.unit=inch") == ["surface.unit = 'inch': must be nm, um, mm or m."]


# --- Running ---------------------------------------------------------------------------------------------------------


def test_specimens_differ_and_a_longer_series_begins_with_the_shorter(toy: Path) -> None:
    short, long = Experiment.read(toy), Experiment.read(toy, ["realisations=5"])
    heights = [long.relief(k).heights for k in range(2)]
    np.testing.assert_array_equal(short.relief(1).heights, heights[1])
    assert abs(np.corrcoef(heights[0].ravel(), heights[1].ravel())[0, 1]) < 0.9
    assert (Experiment.read(toy, ["seed=4"]).relief(0).heights != heights[0]).any()


def test_tiles_of_v_grooves_are_stratified_together(toy: Path) -> None:
    experiment = Experiment.read(toy, ["surface={kind='VGrooves', m=0.5, grooves=8}", "realisations=4"])
    slopes = np.concatenate([-np.unique(experiment.relief(k).vertices[:, (0, 2)], axis=0)[1::2, 1] for k in range(4)])
    u = np.sort(1 - np.exp(-((slopes / 0.5) ** 2)))
    np.testing.assert_array_equal(np.floor(u * 32), np.arange(32))


def test_realisations_are_merged_with_both_noises_and_their_provenance(toy: Path) -> None:
    experiment = Experiment.read(toy)
    measurement = experiment.run()
    dataset = measurement.dataset
    assert (dataset["realisations"] == 2).all()
    assert (dataset["paths"] == 800).all()
    shares = sum(dataset[name] for name in ("escaped", "absorbed", "truncated", "lost"))
    np.testing.assert_allclose(shares, 1.0, rtol=1e-12)
    assert not (dataset["brdf_standard_error"] == dataset["brdf_standard_error_mc"]).all()
    alphas = [experiment.relief(k).statistics().beckmann_alpha for k in range(2)]
    assert measurement.surface_statistics["beckmann_alpha"] == pytest.approx(np.mean(alphas), rel=1e-12)
    assert json.loads(dataset.attrs["experiment"]) == experiment.to_dict()
    assert dataset.attrs["title"] == "A toy"
    assert dataset.attrs["seed"] == "3"
    assert {"numpy", "numba", "embreex", "python"} <= set(json.loads(dataset.attrs["versions"]))
    assert dataset.attrs["instruction_set"]
    assert dataset.attrs["platform"]


def test_the_resolved_experiment_runs_again_to_the_same_numbers(toy: Path, tmp_path: Path) -> None:
    first = Experiment.read(toy)
    first.write(tmp_path / "resolved.toml")
    again = Experiment.read(tmp_path / "resolved.toml").run(threads=1)
    assert again.dataset.identical(first.run(threads=2).dataset)


def test_progress_goes_through_all_realisations(toy: Path) -> None:
    calls: list[tuple[int, int, int]] = []
    Experiment.read(toy).run(progress=lambda *call: calls.append(call))
    done, total, rays = zip(*calls, strict=True)
    assert done[-1] == total[-1] == 1600
    assert list(done) == sorted(done)
    assert list(rays) == sorted(rays)


def test_an_interruption_keeps_what_was_measured(toy: Path) -> None:
    def interrupt(done: int, total: int, rays: int) -> None:
        if done > 1250:
            raise KeyboardInterrupt

    measurement = Experiment.read(toy).run(progress=interrupt)
    assert measurement.interrupted
    np.testing.assert_array_equal(measurement.dataset["realisations"].values[:, 0], [2, 1])


def test_an_interruption_before_anything_was_measured_is_passed_on(toy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(self: Experiment, realisation: int = 0) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Experiment, "scene", interrupted)
    with pytest.raises(KeyboardInterrupt):
        Experiment.read(toy).run()


def test_with_a_target_error_all_realisations_take_the_replicates_that_the_first_needed(toy: Path) -> None:
    experiment = Experiment.read(toy, ["goniometer.target_error=0.05", "goniometer.theta_i=[0.0]"])
    alone = dataclasses.replace(experiment, realisations=1).run()
    both = experiment.run()
    needed = int(alone.dataset["replicates"].max())
    assert needed > 4
    assert int(both.dataset["replicates"].max()) == needed
    assert int(both.dataset["paths"].max()) == 2 * needed * 100


def test_models_for_a_measurement_have_its_roughness_and_material(toy: Path) -> None:
    measurement = Experiment.read(toy).run()
    cook_torrance, microfacet = models_for(measurement)
    assert isinstance(cook_torrance, gonio.CookTorrance)
    assert isinstance(microfacet, gonio.Microfacet)
    assert cook_torrance.m == measurement.surface_statistics["beckmann_alpha"]
    assert cook_torrance.material == gonio.Conductor("Au")
    assert models_for(measurement, ["Microfacet"]) == (microfacet,)
    with pytest.raises(InputError) as caught:
        models_for(measurement, ["Wardd", "Lambert"])
    assert [sentence.split(":")[0] for sentence in caught.value.sentences] == ["Wardd", "Lambert"]


def test_more_paths_than_can_be_summed_are_refused_before_they_are_measured(toy: Path) -> None:
    with pytest.raises(
        InputError, match=r"^realisations = 30: with goniometer\.paths = 100000000 .* lower one of them"
    ):
        Experiment.read(toy, ["realisations=30", "goniometer.paths=100_000_000"])


def test_a_target_out_of_reach_is_a_sentence(toy: Path) -> None:
    with pytest.raises(
        InputError, match=r"^goniometer\.target_error = 1e-07 needs .* ask for less, or for wider bins$"
    ):
        Experiment.read(toy, ["goniometer.target_error=1e-7"]).run()


def test_models_for_an_external_measurement_must_be_told_what_it_is_made_of() -> None:
    measurement = external()
    assert models_for(measurement) == ()
    gold = gonio.CookTorrance(m=0.3, material=gonio.Conductor("Au"))
    assert models_for(measurement, ["cook-torrance m=0.3 material.name=Au"]) == (gold,)
    with pytest.raises(InputError) as caught:
        models_for(measurement, ["CookTorrance", "Lambert"])
    assert len(caught.value.sentences) == 2
    assert caught.value.sentences[0].startswith("CookTorrance: nothing tells m and material.name")
    made_of_gold = external(attributes={"material": '{"kind": "Conductor", "name": "Au"}'})
    assert models_for(made_of_gold, ["cook-torrance m=0.3"]) == (gold,)
