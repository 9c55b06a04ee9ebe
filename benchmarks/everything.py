"""All measurements of speed, side by side, into RESULTS.md: what `make bench` runs.

About half an hour on two cores. Mitsuba and Radiance take part if they are installed:

    .venv/bin/pip install mitsuba pyradiance      # Mitsuba's llvm variant needs libllvm too, Debian: libllvm19
"""

from __future__ import annotations

import datetime
from pathlib import Path

import accuracy
import growth
import models
import speed
from bench import machine


def main() -> None:
    """Run everything; the file appears at the end, whole."""
    parts = [
        f"# Benchmarks\n\nMade by `make bench` on {datetime.date.today():%Y-%m-%d}. What is compared ran in turns on "
        f"the same machine:\n\n{machine()}",
        f"## Against Embree alone and against renderers\n\n{speed.main()}",
        f"## How time and memory grow, and where the time goes\n\n{growth.main()}",
        f"## What the time buys\n\n{accuracy.main()}",
        f"## Closed-form models\n\n{models.main()}",
    ]
    target = Path(__file__).with_name("RESULTS.md")
    part = target.with_suffix(".part")
    part.write_text("\n".join(parts), encoding="utf-8")
    part.replace(target)


if __name__ == "__main__":
    main()
