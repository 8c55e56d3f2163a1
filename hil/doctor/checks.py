"""What an examination of a stand finds: checks, each with a verdict and the remedy, and the figures of the link."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

from drivers.servo import ServoInfo


class Verdict(StrEnum):
    """How a check came out."""

    OK = "ok"
    NOTE = "note"
    PROBLEM = "problem"
    SKIPPED = "not checked"


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was looked at: its name, how it came out, and a sentence that holds the remedy."""

    name: str
    verdict: Verdict
    message: str


@dataclass(frozen=True, slots=True)
class BusFigures:
    """The link at its fastest: round trips and lost replies; rate Hz; median, p99 and longest round trip, s."""

    exchanges: int
    lost: int
    rate: float
    median: float
    p99: float
    longest: float


def _tell_nobody(check: Check) -> None:
    del check


@dataclass(slots=True)
class Examination:
    """What was found so far. `tell` hears of every check as it is made.

    info and bus are None where it did not get so far; signal: the one that ended it early, or 0.
    """

    tell: Callable[[Check], None] = _tell_nobody
    checks: list[Check] = field(default_factory=list)
    info: ServoInfo | None = None
    bus: BusFigures | None = None
    signal: int = 0

    @property
    def ok(self) -> bool:
        """Whether no problem was found."""
        return all(check.verdict is not Verdict.PROBLEM for check in self.checks)

    def add(self, name: str, verdict: Verdict, message: str) -> None:
        """Keep a check, and tell of it."""
        check = Check(name, verdict, message)
        self.checks.append(check)
        self.tell(check)
