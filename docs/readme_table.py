"""Puts the table of `gonio validate --quick` into the README, without the sizes of the samples: a minute or two."""

from __future__ import annotations

import re
from pathlib import Path

from gonio.validation import summary, validate

README = Path(__file__).parents[1] / "README.md"
START, END = "<!-- gonio validate --quick -->\n", "<!-- end -->"
KEPT = ("case", "numbers", "closest to its limit", "measured", "exact", "outcome")


def condensed(table: str) -> str:
    """The columns `KEPT` of a Markdown table, in their order."""
    rows = [line.strip().strip("|").split("|") for line in table.strip().splitlines()]
    rows = [[cell.strip() for cell in row] for row in rows]
    columns = [rows[0].index(name) for name in KEPT]
    return "".join(f"| {' | '.join(row[column] for column in columns)} |\n" for row in rows)


if __name__ == "__main__":
    table = condensed(summary(validate(quick=True)))
    text = README.read_text(encoding="utf-8")
    README.write_text(re.sub(f"{START}.*?{END}", lambda _: START + table + END, text, flags=re.S), encoding="utf-8")
