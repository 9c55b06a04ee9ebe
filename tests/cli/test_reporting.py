"""The report: what it says follows from the numbers, nothing in it can become code, and a browser shows what it should.

The tests in a browser need Chromium and its driver (Debian: chromium, chromium-driver), and nothing else.
"""

from __future__ import annotations

import base64
import io
import json
import shutil
import socket
import subprocess
import sys
import time
import tomllib
import urllib.request
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from synthetic import external

import gonio
import microsurfaces as ms
from gonio import tables
from gonio.cli import main
from gonio.comparison import compare
from gonio.detectors import Apertures, HemisphereGrid
from gonio.experiment import Experiment
from gonio.fitting import fit
from gonio.measurement import Measurement, tabulated
from gonio.models import Lambert
from gonio.models.specimen import models_for
from gonio.reporting import explore, markup, report, words
from gonio.self_check import SelfCheckReport
from gonio.sphere import direction

NASTY = "<script>alert(1)</script> & </script><img src=x onerror=alert(2)>\x07 'quoted' \"too\""
TOML = """
title = '''TITLE'''
realisations = 2
[surface]
kind = "Gaussian"
alpha = 0.3
side = 100.0
samples = 64
[material]
kind = "Conductor"
name = "Au"
[goniometer]
theta_i = [0.0, 30.0, 60.0]
wavelengths = [450.0, 650.0]
paths = 20000
replicates = 4
detector = {kind = "HemisphereGrid", theta_step = 5.0, phi_step = 10.0}
"""
GRID = HemisphereGrid(theta_step=5.0, phi_step=10.0)
GREY = external(Lambert(reflectance=0.5), theta_i=(0.0, 40.0), wavelengths=(450.0, 650.0), detector=GRID)


@pytest.fixture(scope="module")
def measurement(tmp_path_factory: pytest.TempPathFactory) -> Measurement:
    path = tmp_path_factory.mktemp("experiment") / "nasty.toml"
    path.write_text(TOML.replace("TITLE", NASTY.replace("\x07", "")), encoding="utf-8")
    return Experiment.read(path).run()


@pytest.fixture(scope="module")
def page(measurement: Measurement, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report with everything in it."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    models = models_for(measurement)
    return report(measurement, path, models, [fit(measurement, models[0])], command="gonio report 'a <b>.nc'")


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out the pictures, which take longer than all the rest."""
    monkeypatch.setattr("gonio.reporting._picture", lambda drawn, name, *_: markup.tag("p", f"[{name}]"))


class Reader(HTMLParser):
    """What a browser finds in a page. Fails where elements do not close as they opened."""

    VOID = ("meta", "img", "input", "br", "link", "hr")

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.text = path.read_text(encoding="utf-8")
        self.feed(self.text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len(dict(attrs)) == len(attrs)
        self.elements.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append((self.open[-1] if self.open else "", data))

    def all(self, *tags: str) -> list[dict[str, str | None]]:
        return [attributes for tag, attributes in self.elements if tag in tags]

    def words(self, *tags: str) -> str:
        """Text in these elements, or in all but scripts and style."""
        return "\n".join(text for tag, text in self.texts if (tag in tags if tags else tag not in ("script", "style")))

    @property
    def data(self) -> dict[str, Any]:
        """What the page's script reads."""
        return next(json.loads(text) for tag, text in self.texts if tag == "script" and text.startswith("{"))


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
    code, out, _ = run("grey.nc", "-o", "new/page.html", "--model", "lambert reflectance=0.6")
    assert (code, Path(out.strip())) == (0, Path("new/page.html"))
    text = Reader(Path("new/page.html")).words()
    assert "overestimates the directional albedo by 20\u00a0%" in text
    assert "gonio report grey.nc --model 'lambert reflectance=0.6'" in text


@pytest.mark.parametrize(
    ("tokens", "code", "words"),
    [
        (("missing.nc",), 2, "missing.nc"),
        (("grey.nc", "-o", "page.pdf"), 2, "page.pdf: a report is a page; give a name that ends with .html."),
        (("grey.nc", "--model", "nobody"), 2, "nobody"),
        (("grey.nc", "-o", "grey.nc/page.html"), 1, "grey.nc"),
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


# --- In a browser -----------------------------------------------------------------------------------------------------

browser_is_there = pytest.mark.skipif(
    not (shutil.which("chromium") and shutil.which("chromedriver")), reason="needs chromium and chromium-driver"
)
FLAGS = ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--enable-unsafe-swiftshader")


class Browser:
    """Chromium, driven over the WebDriver protocol."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(["chromedriver", f"--port={port}"], **quiet)
        self._address = f"http://127.0.0.1:{port}"
        self._when_it_answers()
        options = {"args": [*FLAGS, "--window-size=1200,1000"]}
        logs = {"browser": "ALL", "performance": "ALL"}
        wanted = {"goog:chromeOptions": options, "goog:loggingPrefs": logs}
        session = self.call("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
        self._address += f"/session/{session['sessionId']}"

    def _when_it_answers(self) -> None:
        for _ in range(200):
            try:
                self.call("GET", "/status")
            except OSError:
                time.sleep(0.05)
            else:
                return

    def call(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        content = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self._address + path, content, method=method)
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.load(answer)["value"]

    def run(self, code: str, *arguments: Any) -> Any:
        return self.call("POST", "/execute/sync", {"script": code, "args": list(arguments)})

    def tool(self, name: str, **parameters: Any) -> Any:
        return self.call("POST", "/goog/cdp/execute", {"cmd": name, "params": parameters})

    def log(self, kind: str) -> list[dict[str, Any]]:
        return list(self.call("POST", "/se/log", {"type": kind}))

    def open(self, path: Path) -> None:
        self.call("POST", "/url", {"url": path.absolute().as_uri()})
        self.wait("return performance.getEntriesByName('drawn').length === 1")

    def wait(self, condition: str) -> None:
        for _ in range(600):
            if self.run(condition):
                return
            time.sleep(0.05)
        raise TimeoutError(condition)

    def choose(self, name: str, value: str | int) -> None:
        code = "const e = document.getElementById(arguments[0]); e.value = arguments[1]; "
        self.run(f"{code}e.dispatchEvent(new Event('input'))", name, str(value))

    def screenshot(self) -> Image.Image:
        content = self.tool("Page.captureScreenshot", format="png")["data"]
        return Image.open(io.BytesIO(base64.b64decode(content))).convert("RGB")

    def quit(self) -> None:
        try:
            self.call("DELETE", "")
        finally:
            self._process.terminate()
            self._process.wait(20)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    browser = Browser()
    yield browser
    browser.quit()


@pytest.fixture(scope="module")
def shown(browser: Browser, page: Path) -> Browser:
    """The browser with the page in it."""
    browser.open(page)
    return browser


def peak(browser: Browser) -> float:
    """The largest light of the lobe that is shown, read from its colours."""
    return float(browser.run("return Math.max(...document.getElementById('lobe').data[0].surfacecolor.flat())"))


def curve(browser: Browser, name: str) -> dict[float, float]:
    """A curve of the slice that is shown."""
    code = "const t = document.getElementById('slice').data.find((t) => t.name.startsWith(arguments[0])); "
    x, y = browser.run(f"{code}return [t.x, t.y]", name)
    return {a: v for a, v in zip(x, y, strict=True) if v is not None}


@browser_is_there
def test_a_browser_shows_what_was_chosen(shown: Browser, page: Path) -> None:
    browser = shown
    data = Reader(page).data
    assert browser.run("return document.title") == Reader(page).words("title")
    # The library was mere text until the words were there.
    assert browser.run("return document.scripts.length") == 4
    assert browser.run("return document.getElementById('incidence').value") == "2"
    for incidence, channel, order in ((2, 0, 0), (0, 0, 0), (0, 1, 0), (2, 1, 1), (2, 1, 2)):
        for name, value in (("incidence", incidence), ("channel", channel), ("order", order)):
            browser.choose(name, value)
        assert peak(browser) == max(data["lobes"]["values"][incidence][order][channel])
        cut = data["slices"][incidence]
        pairs = zip(cut["angle"], cut["value"][order][channel], strict=True)
        assert curve(browser, "measured") == {a: v for a, v in pairs if v}
        error = cut["error"][order][channel]
        highest = [v + 2 * e for v, e in zip(cut["value"][order][channel], error, strict=True) if v and e is not None]
        band = "document.getElementById('slice').data[0]"
        # Where hits are too few there is nothing to draw.
        assert (browser.run(f"return {band}.name") == "± 2 standard errors") == bool(highest)
        if highest:
            assert browser.run(f"return Math.max(...{band}.y)") == pytest.approx(max(highest), rel=1e-12)
        model = data["models"][0]
        predicted = curve(browser, model["name"])
        assert list(predicted.values()) == [v for v in model["values"][incidence][channel] if v]
        angles = f"theta_i {data['incidences'][incidence]['theta']:g}°, phi_i 0°"
        assert browser.run("return document.getElementById('incidence-value').textContent") == angles
        assert browser.run("return document.getElementById('look-around').innerText.split('theta_i').length") == 2
        brightest = float(browser.run("return document.getElementById('shown').textContent.match(/at (.*) .sr/)[1]"))
        assert brightest == pytest.approx(peak(browser), rel=5e-3)
        fainter = browser.run("return document.getElementById('models-note').textContent")
        assert (fainter == "") == (data["orders"][order] == "1")
    linear = browser.run("return document.getElementById('lobe').data[0].z.flat().map(Math.abs)")
    browser.choose("radius", "logarithmic")
    logarithmic = browser.run("return document.getElementById('lobe').data[0].z.flat().map(Math.abs)")
    assert sum(logarithmic) > 1.2 * sum(linear)
    for name, value in (("radius", "linear"), ("incidence", 2), ("order", 0)):
        browser.choose(name, value)


@browser_is_there
def test_a_lobe_points_where_the_light_goes(shown: Browser) -> None:
    x, y, z = (shown.run(f"return document.getElementById('lobe').data[0].{axis}.flat()") for axis in "xyz")
    tip = int(np.argmax(np.linalg.norm([x, y, z], axis=0)))
    assert np.linalg.norm([x[tip], y[tip], z[tip]]) == pytest.approx(1.0, abs=1e-6)
    # The incident direction is toward +x, the specular one toward -x.
    assert x[tip] < -0.7
    assert z[tip] > 0.0


@browser_is_there
def test_the_mouse_turns_the_lobe_and_the_view_stays(shown: Browser) -> None:
    eye = "return document.getElementById('lobe')._fullLayout.scene._scene.getCamera().eye"
    before = shown.run(eye)
    box = shown.run(
        "const e = document.getElementById('lobe'); e.scrollIntoView(); const b = e.getBoundingClientRect();"
        "return [b.x + b.width / 2, b.y + b.height / 2]"
    )
    place = {"x": round(box[0]), "y": round(box[1])}
    # Software rendering may take its time until the scene listens to the mouse.
    for _ in range(10):
        for kind, shift in (("mousePressed", 0), ("mouseMoved", 40), ("mouseMoved", 90), ("mouseReleased", 90)):
            where = {"x": place["x"] + shift, "y": place["y"]}
            shown.tool("Input.dispatchMouseEvent", type=kind, **where, button="left", buttons=1)
            time.sleep(0.1)
        time.sleep(0.5)
        turned = shown.run(eye)
        if turned != before:
            break
    assert abs(turned["x"] - before["x"]) + abs(turned["y"] - before["y"]) > 0.05
    shown.choose("channel", 0)
    assert shown.run(eye) == pytest.approx(turned, abs=1e-6)


@browser_is_there
def test_a_browser_has_nothing_to_complain_of_and_nothing_to_fetch(browser: Browser, page: Path) -> None:
    for kind in ("browser", "performance"):
        browser.log(kind)
    browser.open(page)
    assert [line["message"] for line in browser.log("browser") if line["level"] == "SEVERE"] == []
    events = [json.loads(line["message"])["message"] for line in browser.log("performance")]
    asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [page.absolute().as_uri()]
    blocked = browser.run("return fetch('https://example.org/').then(() => 'fetched', (error) => error.name)")
    assert blocked == "TypeError"
    first, drawn = browser.run(
        "return [performance.getEntriesByName('first-contentful-paint')[0].startTime,"
        "performance.getEntriesByName('drawn')[0].startTime]"
    )
    # A loaded two-core machine without a graphics card; a quiet one takes a third of it.
    assert first < 2000
    assert drawn < 10_000


@browser_is_there
def test_the_picture_has_the_colours_of_the_house(shown: Browser) -> None:
    shown.run("document.getElementById('look-around').scrollIntoView()")
    time.sleep(0.5)
    picture = np.asarray(shown.screenshot()).astype(int)
    for colour in ("#d98200", "#0072b2", "#e9e9e6", "#440154"):
        wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
        assert (np.abs(picture - wanted).max(axis=-1) < 12).sum() > 50, colour


@browser_is_there
def test_a_phone_and_paper_have_room_for_it(shown: Browser) -> None:
    try:
        shown.tool("Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=2, mobile=True)
        time.sleep(1.0)
        lowest = (
            "Math.max(...[...document.querySelectorAll('#slice .xtitle')].map((e) => e.getBoundingClientRect().bottom))"
        )
        assert shown.run(f"return document.querySelector('#slice .legend').getBoundingClientRect().top - {lowest}") >= 0
        assert shown.run("return document.documentElement.scrollWidth") <= 390
        lobe, cut = shown.run("return ['lobe', 'slice'].map((n) => document.getElementById(n).offsetTop)")
        assert cut > lobe + 200
    finally:
        shown.tool("Emulation.clearDeviceMetricsOverride")
    paper = base64.b64decode(shown.tool("Page.printToPDF", paperWidth=8.27, paperHeight=11.69)["data"])
    assert 3 <= paper.count(b"/Type /Page\n") <= 14
    shown.tool("Emulation.setEmulatedMedia", media="print")
    hidden = shown.run("return getComputedStyle(document.getElementById('look-around')).display")
    shown.tool("Emulation.setEmulatedMedia", media="")
    assert hidden == "none"
