"""The report in a browser: it shows what it should. Chromium and its driver are all that these tests need."""

from __future__ import annotations

import base64
import io
import json
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from report_pages import Reader, whole_report

pytestmark = pytest.mark.slow
IN_A_BROWSER = pytest.mark.needs("chromium-driver")
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
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return whole_report(tmp_path_factory.mktemp("report") / "report.html")


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


@IN_A_BROWSER
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


@IN_A_BROWSER
def test_a_lobe_points_where_the_light_goes(shown: Browser) -> None:
    x, y, z = (shown.run(f"return document.getElementById('lobe').data[0].{axis}.flat()") for axis in "xyz")
    tip = int(np.argmax(np.linalg.norm([x, y, z], axis=0)))
    assert np.linalg.norm([x[tip], y[tip], z[tip]]) == pytest.approx(1.0, abs=1e-6)
    # The incident direction is toward +x, the specular one toward -x.
    assert x[tip] < -0.7
    assert z[tip] > 0.0


@IN_A_BROWSER
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


@IN_A_BROWSER
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


@IN_A_BROWSER
def test_the_picture_has_the_colours_of_the_house(shown: Browser) -> None:
    shown.run("document.getElementById('look-around').scrollIntoView()")
    time.sleep(0.5)
    picture = np.asarray(shown.screenshot()).astype(int)
    for colour in ("#d98200", "#0072b2", "#e9e9e6", "#440154"):
        wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
        assert (np.abs(picture - wanted).max(axis=-1) < 12).sum() > 50, colour


@IN_A_BROWSER
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
