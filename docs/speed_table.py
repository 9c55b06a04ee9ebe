"""Puts the medians of the first two tables of benchmarks/RESULTS.md into docs/performance.md, some into the README."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
START, END = "<!-- docs/speed_table.py -->\n", "<!-- end -->"
HEAD = ["surface", "light", "gonio", "embreex, every ray", "embreex, rays alone", "Mitsuba 3"]
MANY = ["gonio, 16 M", "Mitsuba 3, 16 M"]
IN_README = ("alpha = 0.3", "cylinders, ridges")


def rows(text: str) -> list[list[str]]:
    """The cells of all lines of tables that begin with a surface and an angle."""
    lines = re.findall(r"^\| ((?:alpha|cylinders)[^|]*\| \d+° \|.*) \|$", text, flags=re.M)
    return [[cell.strip().split(" (")[0] for cell in line.split("|")] for line in lines]


def speeds(results: str) -> list[list[str]]:
    """The cells of every surface and incidence under `HEAD` and `MANY`, from the text of RESULTS.md."""
    section = re.search(r"^## Against Embree.*?(?=^## |\Z)", results, flags=re.M | re.S)
    assert section
    found = rows(section[0])
    many = {tuple(row[:2]): row[2:4] for row in found if len(row) == 5}
    return [[*row[:6], *many.get(tuple(row[:2]), ["-", "-"])] for row in found if len(row) == 9]


def table(head: list[str], lines: list[list[str]]) -> str:
    """A Markdown table of as many columns as there are heads."""
    body = [head, ["---"] * len(head), *(line[: len(head)] for line in lines)]
    return "".join(f"| {' | '.join(line)} |\n" for line in body)


def put(path: Path, text: str) -> None:
    """Replace what stands between the markers in the file at `path`."""
    before = path.read_text(encoding="utf-8")
    path.write_text(re.sub(f"{START}.*?{END}", lambda _: START + text + END, before, flags=re.S), encoding="utf-8")


if __name__ == "__main__":
    measured = speeds((ROOT / "benchmarks" / "RESULTS.md").read_text(encoding="utf-8"))
    put(ROOT / "docs" / "performance.md", table(HEAD + MANY, measured))
    put(ROOT / "README.md", table(HEAD, [line for line in measured if line[0] in IN_README]))
