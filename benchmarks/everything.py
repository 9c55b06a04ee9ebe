"""All measurements of speed, side by side, into RESULTS.md: what `make bench` runs.

    .venv/bin/python benchmarks/everything.py [SECTION ...]

About half an hour on two cores; with names of sections (speed, growth, accuracy, models, campaigns) only those are
measured again.
Mitsuba and Radiance take part if they are installed:

    .venv/bin/pip install mitsuba pyradiance      # Mitsuba's llvm variant needs libllvm too, Debian: libllvm19
"""

from __future__ import annotations

import datetime
import re
import sys
from pathlib import Path

import accuracy
import campaigns
import growth
import models
import speed
from bench import machine

SECTIONS = {
    "speed": ("Against Embree alone and against renderers", speed.main),
    "growth": ("How time and memory grow, and where the time goes", growth.main),
    "accuracy": ("What the time buys", accuracy.main),
    "models": ("Closed-form models", models.main),
    "campaigns": ("Campaigns", campaigns.main),
}
RESULTS = Path(__file__).with_name("RESULTS.md")


def main(names: list[str]) -> None:
    """Measure the sections `names`, or all; the file appears at the end, whole."""
    before = RESULTS.read_text(encoding="utf-8") if RESULTS.exists() else ""
    kept = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", before, flags=re.M | re.S))
    head = f"# Benchmarks\n\nMade by `make bench`. What is compared ran in turns on the same machine:\n\n{machine()}"
    parts = [head]
    for name, (title, measure) in SECTIONS.items():
        if title in kept and names and name not in names:
            parts.append(f"## {title}\n{kept[title].rstrip()}\n")
        else:
            parts.append(f"## {title}\n\nMeasured on {datetime.date.today():%Y-%m-%d}.\n\n{measure()}")
    part = RESULTS.with_suffix(".part")
    part.write_text("\n".join(parts), encoding="utf-8")
    part.replace(RESULTS)


if __name__ == "__main__":
    main(sys.argv[1:])
