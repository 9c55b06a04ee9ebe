"""Puts the table of `gonio validate --quick` into the README."""

import re
from pathlib import Path

from gonio.validation import run, summary

README = Path(__file__).parents[1] / "README.md"
START, END = "<!-- gonio validate --quick -->\n", "<!-- end -->"

if __name__ == "__main__":
    table = summary(run(quick=True))
    text = README.read_text(encoding="utf-8")
    README.write_text(re.sub(f"{START}.*?{END}", lambda _: START + table + END, text, flags=re.S), encoding="utf-8")
