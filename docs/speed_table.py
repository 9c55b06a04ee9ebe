"""Puts the medians of the first two tables of benchmarks/RESULTS.md into the README."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
START, END = "<!-- docs/speed_table.py -->\n", "<!-- end -->"
HEAD = [
    "| surface | light | gonio | embreex, every ray | embreex, rays alone | Mitsuba 3 "
    "| gonio, 16 M | Mitsuba 3, 16 M |",
    "| --- | --- | --- | --- | --- | --- | --- | --- |",
]


def rows(text: str) -> list[list[str]]:
    """The cells of all lines of tables that begin with a surface and an angle."""
    lines = re.findall(r"^\| ((?:alpha|cylinders)[^|]*\| \d+° \|.*) \|$", text, flags=re.M)
    return [[cell.strip().split(" (")[0] for cell in line.split("|")] for line in lines]


if __name__ == "__main__":
    results = (ROOT / "benchmarks" / "RESULTS.md").read_text(encoding="utf-8")
    section = re.search(r"^## Against Embree.*?(?=^## |\Z)", results, flags=re.M | re.S)
    assert section
    speeds = [row for row in rows(section[0]) if len(row) == 9]
    many = {tuple(row[:2]): row[2:4] for row in rows(section[0]) if len(row) == 5}
    lines = ["| " + " | ".join([*row[:6], *many.get(tuple(row[:2]), ["-", "-"])]) + " |" for row in speeds]
    readme = ROOT / "README.md"
    text = readme.read_text(encoding="utf-8")
    table = "\n".join([*HEAD, *lines]) + "\n"
    readme.write_text(re.sub(f"{START}.*?{END}", lambda _: START + table + END, text, flags=re.S), encoding="utf-8")
