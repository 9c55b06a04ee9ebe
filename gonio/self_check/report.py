"""What a self-check finds, and the report of all of them that goes with every measurement."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Literal, get_args

Status = Literal["passed", "warning", "failed", "not applicable"]


@dataclass(frozen=True)
class Check:
    """One self-check: what was found, against which limit, and what to do about it."""

    name: str
    status: Status
    sentence: str
    numbers: dict[str, float]


@dataclass(frozen=True)
class SelfCheckReport:
    """All self-checks of one measurement."""

    checks: tuple[Check, ...]

    @property
    def failed(self) -> list[str]:
        """Names of the checks that failed."""
        return [check.name for check in self.checks if check.status == "failed"]

    @property
    def passed(self) -> bool:
        """Whether no check failed; warnings do not count."""
        return not self.failed

    def sentences(self) -> list[str]:
        """A line for each check: its name, how it ended, what was found."""
        return [f"{check.name}, {check.status}: {check.sentence}" for check in self.checks]

    def summary(self) -> list[str]:
        """How many checks ended how, and a line for each that did not pass."""
        count = {status: sum(check.status == status for check in self.checks) for status in get_args(Status)}
        found = ", ".join(f"{count[status]} {status}" for status in ("passed", "failed", "not applicable"))
        warnings = f"{count['warning']} warning{'s' * (count['warning'] != 1)}"
        wrong = [check for check in self.checks if check.status in ("failed", "warning")]
        return [
            f"Self-check: {len(self.checks)} checks, {found}, {warnings}.",
            *(f"{check.name}, {check.status}: {check.sentence}" for check in wrong),
        ]

    def to_json(self) -> str:
        """As it goes with a measurement into its file, as the attribute `self_check`."""
        return json.dumps([check.__dict__ for check in self.checks])

    @classmethod
    def from_json(cls, text: str) -> SelfCheckReport:
        """From what `to_json` made."""
        return cls(tuple(Check(**check) for check in json.loads(text)))


def outcome(
    name: str, sound: bool, found: str, advice: str, numbers: dict[str, float], otherwise: Status = "failed"
) -> Check:
    """A check that passed if `sound`, and otherwise comes with `advice`."""
    if sound:
        return Check(name, "passed", f"{found}.", numbers)
    return Check(name, otherwise, f"{found}: {advice}.", numbers)


def not_applicable(name: str, why: str) -> Check:
    """A check that the measurement cannot be put to, and why."""
    return Check(name, "not applicable", why, {})
