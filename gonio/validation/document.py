"""The outcome as a Markdown document."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

from gonio.validation.cases import CASES
from gonio.validation.judging import LEVEL, Row, excess


def markdown(rows: Iterable[Row]) -> str:
    """The rows as a Markdown document: a summary, and for every case what it tests and a table."""
    rows = tuple(rows)
    failures = sum(row.outcome == "FAILS" for row in rows)
    laws = {case.name: case.function.__doc__ or "" for case in CASES}
    lines = [
        "# Validation",
        "",
        f"{len(rows)} numbers were compared: {len(rows) - failures} are as they should be, {failures} FAIL.",
        "",
        "The score is Student's t; for reduced chi², its excess over 1 in units of its scatter; or, where only a band "
        "is known, the difference itself. Beyond the limit it is not noise: a case whose laws hold fails with "
        f"probability {LEVEL:g}, all its rows together.",
        "",
        summary(rows).rstrip(),
    ]
    for name, group in itertools.groupby(rows, key=lambda row: row.case):
        lines += ["", f"## {name}", "", " ".join(laws.get(name, "").split()), "", *_head(_COLUMNS)]
        lines += [_line(_cells(row)) for row in group]
    return "\n".join(lines) + "\n"


def summary(rows: Iterable[Row]) -> str:
    """A Markdown table of one line a case: its sizes, and of its laws the number that comes closest to its limit."""
    lines = _head(
        ("case", "numbers", "closest to its limit", "measured", "exact", "score", "limit", "outcome", "settings")
    )
    for name, group in itertools.groupby(rows, key=lambda row: row.case):
        members = tuple(group)
        laws = [row for row in members if row.outcome == "agrees"] or list(members)
        closest = max(laws, key=lambda row: excess(row.statistic, row.score) / row.limit)
        rejected = sum(row.outcome.startswith("rejected") for row in members)
        failures = sum(row.outcome == "FAILS" for row in members)
        outcome = f"**{failures} FAIL**" if failures else "agrees"
        outcome += f", {rejected} wrong forms rejected" if rejected else ""
        quantity, measured, error, exact, score, limit, _, settings = _cells(closest)
        measured += f" ± {error}" if error else ""
        lines.append(_line((name, str(len(members)), quantity, measured, exact, score, limit, outcome, settings)))
    return "\n".join(lines) + "\n"


def _head(columns: tuple[str, ...]) -> list[str]:
    return [_line(columns), "| --- " * len(columns) + "|"]


def _line(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(cells) + " |"


_COLUMNS = ("quantity", "measured", "error", "exact", "score", "limit", "outcome", "settings")


def _cells(row: Row) -> tuple[str, ...]:
    error = "" if math.isnan(row.error) else f"{row.error:.2g}"
    outcome = f"**{row.outcome}**" if row.outcome == "FAILS" else row.outcome
    score = f"{row.statistic} {row.score:.3g}"
    exact, limit = f"{row.exact:.6g}", f"{row.limit:.3g}"
    return row.quantity, f"{row.measured:.6g}", error, exact, score, limit, outcome, row.settings
