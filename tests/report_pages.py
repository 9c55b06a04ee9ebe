"""What the tests of reports share: measurements, the report with everything in it, and what is found in a page."""

from __future__ import annotations

import functools
import json
import tempfile
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from synthetic import external

from gonio.detectors import HemisphereGrid
from gonio.experiment import Experiment
from gonio.fitting import fit
from gonio.measurement import Measurement
from gonio.models import Lambert
from gonio.models.specimen import models_for
from gonio.reporting import report

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


@functools.cache
def nasty_measurement() -> Measurement:
    """A measurement of an experiment whose title tries to become code."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "nasty.toml"
        path.write_text(TOML.replace("TITLE", NASTY.replace("\x07", "")), encoding="utf-8")
        return Experiment.read(path).run()


def whole_report(path: Path) -> Path:
    """The report of it with everything in it."""
    models = models_for(nasty_measurement())
    fits = [fit(nasty_measurement(), models[0])]
    return report(nasty_measurement(), path, models, fits, command="gonio report 'a <b>.nc'")


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
