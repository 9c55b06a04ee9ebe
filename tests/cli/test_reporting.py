"""The report: what it says follows from the numbers, and nothing in it can become code."""

from __future__ import annotations

import base64
import io
import json
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from report_pages import GREY, GRID, NASTY, Reader, nasty_measurement, whole_report
from synthetic import external

import gonio
import microsurfaces as ms
from gonio import tables
from gonio.cli import main
from gonio.comparison import compare
from gonio.detectors import Apertures, HemisphereGrid
from gonio.fitting import fit
from gonio.measurement import Measurement, tabulated
from gonio.models import Lambert
from gonio.models.specimen import models_for
from gonio.reporting import explore, markup, report, words
from gonio.self_check import SelfCheckReport
from gonio.sphere import direction


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    return nasty_measurement()


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return whole_report(tmp_path_factory.mktemp("report") / "report.html")


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out the pictures, which take longer than all the rest."""
    monkeypatch.setattr("gonio.reporting._picture", lambda drawn, name, *_: markup.tag("p", f"[{name}]"))


# --- The page --------------------------------------------------------------------------------------------------------


def test_the_page_is_sound_html_and_needs_nothing_else(page: Path) -> None:
    reader = Reader(page)
    assert reader.text.startswith('<!DOCTYPE html>\n<html lang="en">')
    assert reader.all("meta")[0] == {"charset": "utf-8"}
    identifiers = [attributes["id"] for _, attributes in reader.elements if "id" in attributes]
    assert len(identifiers) == len(set(identifiers))
    assert {label["for"] for label in reader.all("label")} == {"incidence", "channel", "order", "radius"}
    assert all(attributes["for"] in identifiers for attributes in reader.all("label", "output"))
    assert len(reader.all("h1")) == 1
    links = [link["href"] or "" for link in reader.all("a")]
    assert {link.removeprefix("#") for link in links if link.startswith("#")} == {
        section["id"] for section in reader.all("section")
    }
    sources = [*links, *(image["src"] or "" for image in reader.all("img"))]
    assert all(source.startswith(("data:", "#")) for source in sources)
    assert not reader.all("link", "iframe", "object", "base", "form")[1:]
    assert all("src" not in script for script in reader.all("script"))
    assert "default-src 'none'" in str(reader.all("meta")[1]["content"])
    assert reader.text.count("* plotly.js v") == 1
    # No browser reads it as a program before the page's own script asks for that.
    assert [script.get("type") for script in reader.all("script")] == ["text/plain", "application/json", None]
    assert page.stat().st_size < 12e6
    assert [path.name for path in page.parent.iterdir()] == ["report.html"]


def test_pictures_are_embedded_with_words_for_those_who_do_not_see_them(page: Path, measurement: Measurement) -> None:
    images = Reader(page).all("img")
    chosen = words.best([compare(measurement, model) for model in models_for(measurement)])
    assert chosen is not None
    assert [str(image["alt"]).partition(":")[0].partition(" against")[0] for image in images] == [
        "Lobes",
        "Slices",
        "The hemisphere from above",
        "Albedo",
        tables.name_of(chosen.model),
        "Fits",
    ]
    for image in images:
        content = base64.b64decode(str(image["src"]).removeprefix("data:image/png;base64,"), validate=True)
        picture = Image.open(io.BytesIO(content))
        assert picture.size == (int(str(image["width"])), int(str(image["height"])))
        assert np.asarray(picture.convert("L")).std() > 10


def test_what_exists_already_is_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Comparisons stand for their models, and pictures go into the page byte by byte."""

    def again(*_: Any, **__: Any) -> None:
        raise AssertionError

    comparison = compare(GREY, Lambert(reflectance=0.6))
    names = ("lobes", "slices", "hemisphere", "albedo", "difference")
    for k, name in enumerate(names):
        Image.new("RGB", (3 + k, 2)).save(tmp_path / f"{name}.png")
        monkeypatch.setattr(f"gonio.plots.{name}", again)
    monkeypatch.setattr("gonio.reporting.compare", again)
    drawn = [tmp_path / f"{name}.png" for name in names]
    reader = Reader(report(GREY, tmp_path / "x.html", [comparison], pictures=drawn))
    images = reader.all("img")
    assert [image["width"] for image in images] == ["3", "4", "5", "6", "7"]
    for image, path in zip(images, drawn, strict=True):
        assert base64.b64decode(str(image["src"]).partition("base64,")[2]) == path.read_bytes()
    assert "Lambert, reflectance 0.6 overestimates the directional albedo by 20\u00a0%" in reader.words()
    assert reader.data["models"][0]["name"] == "Lambert, reflectance 0.6"


def test_tables_hold_what_the_terminal_shows(page: Path, measurement: Measurement) -> None:
    cells = {text for tag, text in Reader(page).texts if tag in ("td", "th", "caption")}
    models = models_for(measurement)
    comparisons = [compare(measurement, model) for model in models]
    self_check = SelfCheckReport.from_json(measurement.attributes["self_check"])
    shown = [
        tables.albedo(measurement),
        tables.energy(measurement),
        tables.ranking(comparisons),
        *map(tables.comparison, comparisons),
        tables.parameters(fit(measurement, models[0])),
        tables.checks(self_check),
    ]
    for table in shown:
        assert table is not None
        assert {cell for column in table.columns for cell in map(str, column.cells) if cell} <= cells


def test_every_self_check_is_there_with_its_judgement(page: Path, measurement: Measurement) -> None:
    self_check = SelfCheckReport.from_json(measurement.attributes["self_check"])
    assert len(self_check.checks) == 15
    judged = [row.get("class") for row in Reader(page).all("tr")]
    for status in ("warning", "failed"):
        assert judged.count(status) == sum(check.status == status for check in self_check.checks)
    assert judged.count("warning") > 0


def test_the_experiment_can_be_taken_out_and_run_again(page: Path, measurement: Measurement) -> None:
    reader = Reader(page)
    shown = next(text for tag, text in reader.texts if tag == "code" and "[surface]" in text)
    saved = next(link for link in reader.all("a") if "download" in link)
    packed = base64.b64decode(str(saved["href"]).partition("base64,")[2]).decode()
    wanted = json.loads(measurement.attributes["experiment"])
    assert tomllib.loads(shown) == tomllib.loads(packed) == wanted
    commands = reader.words("code")
    assert 'pip install "gonio[report]==0.1.0"' in commands
    assert "gonio report 'a <b>.nc'" in commands


def test_the_page_tells_where_it_comes_from(page: Path, measurement: Measurement) -> None:
    reader = Reader(page)
    rows = {text for tag, text in reader.texts if tag in ("th", "td")}
    assert {"seed", "0", "versions", "platform", measurement.attributes["platform"]} <= rows
    assert any(f"numpy {np.__version__}" in text for text in rows)
    assert not {"self check", "surface statistics", "goniometer"} & rows
    sources = reader.words("li")
    for source in ("gonio 0.1.0", "Refractive indices of Au: P. B. Johnson", "doi:10.1145/357290.357293"):
        assert source in sources


def test_nothing_that_is_told_becomes_markup(page: Path, tmp_path: Path, undrawn: None) -> None:
    there = {"title": NASTY, "origin": NASTY, NASTY: NASTY}
    other = tabulated(np.ones((1, 1, *GRID.shape, 1)) / np.pi, GRID, 30.0, 0.0, 550.0, attributes=there)
    for reader, title in (
        (Reader(page), NASTY.replace("\x07", "")),
        (Reader(report(other, tmp_path / "x.html")), NASTY.replace("\x07", "\ufffd")),
    ):
        assert title in (reader.words("h1"), reader.words("title"))
        assert len(reader.all("script")) == 3
        assert all("onerror" not in attributes for _, attributes in reader.elements)
        assert not any("alert(" in text for tag, text in reader.texts if tag == "script" and len(text) < 1e6)


def test_data_cannot_end_their_element(tmp_path: Path) -> None:
    content = {"</script><script>alert(1)//": ["<!--<script ", "</script x", "&lt;", "\u2028]]>", None]}
    page = tmp_path / "page.html"
    page.write_text(markup.page(markup.tag("html", markup.data("d", content))), encoding="utf-8")
    reader = Reader(page)
    assert reader.data == content
    assert reader.text.count("<") == 5  # the doctype, html, script and their ends
    assert len(reader.elements) == 2
    with pytest.raises(ValueError, match="cannot be part of a page"):
        markup.script("'</SCRIPT>'")


def test_elements_keep_the_order_of_words() -> None:
    assert markup.page(markup.tag("p", "a<", markup.tag("b", "c"), None, "d", "e", class_="x y")) == (
        '<!DOCTYPE html>\n<p class="x y">a&lt;<b>c</b>de</p>\n'
    )


def test_the_same_measurement_gives_the_same_page(measurement: Measurement, tmp_path: Path, undrawn: None) -> None:
    pages = [report(measurement, tmp_path / name).read_bytes() for name in ("a.html", "b.html")]
    assert pages[0] == pages[1]


# --- The words -------------------------------------------------------------------------------------------------------


def said(measurement: Measurement, *models: Any) -> str:
    return "\n".join(words.summary(measurement, [compare(measurement, model) for model in models], None))


def test_the_summary_tells_how_far_models_are_off() -> None:
    bright, dark, right = (Lambert(reflectance=rho) for rho in (0.6, 0.4, 0.5))
    text = said(GREY, bright, dark, right)
    assert "450 and 650 nm" in text
    assert "0.5000 at 0° and 0.5000 at 40° (theta_i)" in text
    assert "Lambert, reflectance 0.6 overestimates the directional albedo by 20\u00a0% at 0°, 450 nm." in text
    assert "Lambert, reflectance 0.4 underestimates the directional albedo by 20\u00a0% at 0°, 450 nm." in text
    assert "Of 3 models, Lambert, reflectance 0.5 comes closest" in text
    assert "It has the directional albedo right: it is off by 0\u00a0% at most." in text
    assert "Errors are not known" in text


def test_the_summary_tells_noise_from_difference() -> None:
    noisy = external(Lambert(reflectance=0.5), noise=0.05, detector=GRID)
    text = said(noisy, Lambert(reflectance=0.5))
    assert "Lambert, reflectance 0.5 has the directional albedo right within noise" in text
    assert ", which noise explains." in text
    assert "Errors are those of the file" in text
    assert "overestimates the directional albedo by 20\u00a0%" in said(noisy, Lambert(reflectance=0.6))


def test_the_summary_tells_the_worst_bin() -> None:
    brdf = np.full((1, 1, *GRID.shape, 1), 0.5 / np.pi)
    brdf[0, 0, 8, 18] *= 4.0
    bump = tabulated(brdf, GRID, 30.0, 0.0, 550.0, standard_error=brdf * 1e-3)
    text = said(bump, Lambert(reflectance=0.5))
    assert "is at theta_o 40°, dphi 180° for light from theta_i 30°, where it is 75\u00a0% too dark." in text


def test_the_summary_of_what_gonio_measured(measurement: Measurement) -> None:
    self_check = SelfCheckReport.from_json(measurement.attributes["self_check"])
    text = "\n".join(words.summary(measurement, [], self_check))
    assert "A surface of the kind Gaussian" in text
    assert "of gold. 2 specimens were lit from 3 directions (theta_i 0°, 30° and 60°)" in text
    assert "0.04 million light paths an incidence" in text
    whole, once = (measurement.dataset["albedo"].sel(order=order, theta_i=60, phi_i=0) for order in ("all", "1"))
    share = 1.0 - float(once.mean()) / float(whole.mean())
    assert f"{100 * share:.2g}\u00a0% at theta_i 60°" in text
    assert "No model was compared." in text
    assert "the differences between 2 specimens together" in text
    failing = SelfCheckReport(tuple(c.__class__(c.name, "failed", c.sentence, {}) for c in self_check.checks[:1]))
    assert "The self-check fails (energy budget): do not use these numbers." in words.summary(measurement, [], failing)


def test_a_mirror_scatters_once() -> None:
    flat = gonio.Scene(ms.Flat().build(seed=1), gonio.Mirror())
    mirror = gonio.Goniometer(theta_i=(0, 30), paths=1000, detector=GRID).measure(flat)
    assert "All of it hit the surface once." in said(mirror)


# --- What is left out ------------------------------------------------------------------------------------------------


def test_an_external_measurement_has_no_energy_budget_and_no_self_checks(tmp_path: Path, undrawn: None) -> None:
    colours = external(
        Lambert(reflectance=0.5), detector=GRID, wavelengths=(611.4, 549.1, 464.2), attributes={"basis": "RGB"}
    )
    reader = Reader(report(colours, tmp_path / "rgb.html", [Lambert(reflectance=0.6)]))
    text = reader.words()
    for sentence in (
        "The file keeps no orders of scattering",
        "without the sums that self-checks are made of",
        "Errors are not known",
        "in the colour channels R, G and B",
        "by 20\u00a0% at 30°, channel R.",
        "No experiment file made this measurement",
    ):
        assert sentence in text
    assert reader.data["channels"] == ["R", "G", "B"]
    assert reader.data["orders"] == ["all"]
    assert {error for cut in reader.data["slices"] for row in cut["error"][0] for error in row} == {None}


def test_apertures_have_points_and_no_lobe(tmp_path: Path) -> None:
    relief = ms.Gaussian(alpha=0.3, side=100.0, samples=64).build(seed=1)
    seen = Apertures(directions=((20.0, 180.0), (40.0, 180.0), (40.0, 90.0)), half_angle=5.0)
    instrument = gonio.Goniometer(theta_i=(30,), wavelengths=(550,), paths=10_000, replicates=4, detector=seen)
    points = instrument.measure(gonio.Scene(relief, gonio.Conductor("Au")))
    reader = Reader(report(points, tmp_path / "points.html", [Lambert(reflectance=0.5)]))
    assert "no regular grid of bins, so there is no lobe to turn" in reader.words()
    assert "No picture of the lobes" in reader.words("p")
    assert reader.data["lobes"] is None
    assert reader.data["slices"][0]["angle"] == [20.0, 40.0]
    assert reader.data["models"][0]["values"][0][0] == [round(0.5 / np.pi, 4)] * 2


def test_a_model_that_cannot_be_compared_is_told(tmp_path: Path, undrawn: None, monkeypatch: Any) -> None:
    def refuse(*_: Any) -> None:
        raise ValueError("because <b>")

    monkeypatch.setattr("gonio.reporting.compare", refuse)
    text = Reader(report(GREY, tmp_path / "x.html", [Lambert(reflectance=0.5)])).words("p")
    assert "Lambert, reflectance 0.5 was not compared: because <b>" in text


def test_without_plotly_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("plotly", "plotly.offline"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ValueError, match=r"plotly, which is not installed: pip install gonio\[report\]"):
        report(GREY, tmp_path / "x.html")
    assert not list(tmp_path.iterdir())


def test_nothing_measured_is_no_report(tmp_path: Path) -> None:
    unknown = tabulated(np.full((1, 1, *GRID.shape, 1), np.nan), GRID, 30.0, 0.0, 550.0)
    with pytest.raises(ValueError, match="nothing to report"):
        report(unknown, tmp_path / "x.html")


# --- The data behind the interactive part -----------------------------------------------------------------------------


def test_a_lambertian_lobe_is_a_cosine() -> None:
    data = explore.explored(GREY, [compare(GREY, Lambert(reflectance=0.4))])
    theta, dphi = (np.array(data["lobes"][name]) for name in ("theta", "dphi"))
    lobe = np.array(data["lobes"]["values"][1][0][1]).reshape(len(theta), len(dphi))
    assert theta[0] == 0.0
    assert theta[-1] == 90.0
    np.testing.assert_allclose(lobe[:-1], 0.5 / np.pi * np.cos(np.radians(theta[:-1, None])) + 0 * dphi, atol=2e-3)
    assert not lobe[-1].any()
    assert set(data["slices"][1]["value"][0][0]) == {round(0.5 / np.pi, 4)}
    assert set(data["models"][0]["values"][1][0]) == {round(0.4 / np.pi, 4)}


def test_lobes_and_slices_have_their_sides_and_errors() -> None:
    """Brighter on the specular side than on the incident one, and on the left (dphi 90) than on the right."""
    azimuth = np.radians(GRID.dphi)
    brdf = np.broadcast_to(2.0 - np.cos(azimuth) + 0.5 * np.sin(azimuth), GRID.shape)[None, None, ..., None]
    brdf = np.where(np.isin(np.arange(GRID.shape[0]), (14, 15, 16))[:, None, None], np.nan, brdf)
    chiral = tabulated(brdf, GRID, 30.0, 90.0, 550.0, standard_error=0.01 * brdf)
    data = explore.explored(chiral, [])
    theta, dphi = data["lobes"]["theta"], data["lobes"]["dphi"]
    lobe = np.array(data["lobes"]["values"][0][0][0], float).reshape(len(theta), len(dphi))
    ring = lobe[theta.index(45.0)] / np.cos(np.radians(45.0))
    for angle, value in ((0.0, 1.0), (90.0, 2.5), (180.0, 3.0), (270.0, 1.5)):
        assert ring[dphi.index(angle)] == pytest.approx(value, rel=0.02)
    cut = data["slices"][0]
    at = cut["angle"].index
    assert cut["value"][0][0][at(-40.0)] == 1.0
    assert cut["value"][0][0][at(40.0)] == 3.0
    assert cut["error"][0][0][at(40.0)] == 0.03
    assert cut["value"][0][0][at(75.0)] is None
    assert np.isnan(lobe[theta.index(75.0)]).all()


def test_orders_are_kept_apart(measurement: Measurement) -> None:
    data = explore.explored(measurement, [])
    parts = [np.array(data["lobes"]["values"][2][k][0]) for k in range(4)]
    assert data["orders"] == ["all", "1", "2", "3+"]
    np.testing.assert_allclose(parts[0], parts[1] + parts[2] + parts[3], rtol=2e-3, atol=1e-3 * parts[0].max())
    assert parts[2].any()


def test_models_are_averaged_over_the_same_bins(measurement: Measurement) -> None:
    model = models_for(measurement)[0]
    data = explore.explored(measurement, [compare(measurement, model)])
    exact = model.average(direction(60.0, 0.0), GRID, measurement.wavelengths).reshape(*GRID.shape, -1)
    shown = dict(zip(data["slices"][2]["angle"], data["models"][0]["values"][2][1], strict=True))
    assert data["models"][0]["order"] == "1"
    # At 60 degrees a bin is wider than the band of the slice: one bin stands for itself.
    assert shown[60.0] == pytest.approx(exact[12, 18, 1], rel=1e-3)
    assert shown[-60.0] == pytest.approx(exact[12, 0, 1], rel=1e-3)


def test_many_lobes_are_thinned_so_that_the_page_stays_small() -> None:
    angles, wavelengths = tuple(float(t) for t in range(0, 81, 2)), tuple(float(nm) for nm in range(400, 701, 20))
    coarse = HemisphereGrid(theta_step=15.0, phi_step=30.0)
    many = external(Lambert(reflectance=0.5), theta_i=angles, wavelengths=wavelengths, detector=coarse)
    data = explore.explored(many, [])
    assert (len(data["incidences"]), len(data["channels"])) == (32, 5)
    assert data["choice"] == "32 of 41 incidences, 5 of 16 wavelengths"
    assert len(json.dumps(data)) < 4e6


# --- The command ------------------------------------------------------------------------------------------------------


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], undrawn: None) -> Any:
    """Runs `gonio report` in a folder that holds grey.nc; (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    gonio.save(GREY, "grey.nc")

    def command(*tokens: str) -> tuple[Any, str, str]:
        with pytest.raises(SystemExit) as exit_:
            main(("report", *tokens))
        return (exit_.value.code, *capsys.readouterr())

    return command


def test_the_command_writes_the_page(run: Callable[..., tuple[Any, str, str]]) -> None:
    assert run("grey.nc") == (0, "report.html\n", "")
    code, out, _ = run("grey.nc", "--to", "new/page.html", "--model", "lambert reflectance=0.6")
    assert (code, Path(out.strip())) == (0, Path("new/page.html"))
    text = Reader(Path("new/page.html")).words()
    assert "overestimates the directional albedo by 20\u00a0%" in text
    assert "gonio report grey.nc --model 'lambert reflectance=0.6'" in text


@pytest.mark.parametrize(
    ("tokens", "code", "words"),
    [
        (("missing.nc",), 2, "missing.nc"),
        (("grey.nc", "--to", "page.pdf"), 2, "--to page.pdf: a report is a page; give a name that ends with .html."),
        (("grey.nc", "--model", "nobody"), 2, "nobody"),
        (("grey.nc", "--to", "grey.nc/page.html"), 2, "grey.nc is a file, not a folder"),
    ],
)
def test_the_command_tells_mistakes(
    run: Callable[..., tuple[Any, str, str]], tokens: tuple[str, ...], code: int, words: str
) -> None:
    found = run(*tokens)
    assert found[0] == code
    assert words in found[2]
    assert len(found[2].splitlines()) == 1
    assert not Path("report.html").exists()
