"""Diagnostic checks of a stand: each with a verdict and the remedy, and the figures of the link."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from drivers.servo import ServoInfo


class Verdict(StrEnum):
    """The outcome of a check."""

    OK = "ok"
    WARNING = "warning"
    ERROR = "error"
    SKIPPED = "not checked"


@dataclass(frozen=True, slots=True)
class Check:
    """One check: its name, its verdict, and a sentence with the remedy."""

    name: str
    verdict: Verdict
    message: str


@dataclass(frozen=True, slots=True)
class LinkFigures:
    """The link at its fastest: round trips and lost replies; rate Hz; median, p99 and longest round trip, s."""

    exchanges: int
    lost: int
    rate: float
    median: float
    p99: float
    longest: float


def _ignore(check: Check) -> None:
    del check


@dataclass(slots=True)
class CheckList:
    """The checks so far. on_check: called with each as it is made.

    keys: for each check, the keys of the stand file on which it depends; an error names them. info and bus are None if
    the checks ended before they were known; signal: the one that ended them early, or 0.
    """

    on_check: Callable[[Check], None] = _ignore
    keys: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    checks: list[Check] = field(default_factory=list)
    info: ServoInfo | None = None
    bus: LinkFigures | None = None
    signal: int = 0

    @property
    def ok(self) -> bool:
        """Return whether no check is an error."""
        return all(check.verdict is not Verdict.ERROR for check in self.checks)

    def add(self, name: str, verdict: Verdict, message: str) -> None:
        """Add a check."""
        keys = self.keys.get(name, ()) if verdict is Verdict.ERROR else ()
        if keys and not any(key in message for key in keys):
            message += f" (in the stand file: {', '.join(keys)})"
        check = Check(name, verdict, message)
        self.checks.append(check)
        self.on_check(check)

    def passed(self, name: str, message: str) -> None:
        """Add a check that passed."""
        self.add(name, Verdict.OK, message)

    def failed(self, name: str, message: str) -> None:
        """Add a check that failed: an error."""
        self.add(name, Verdict.ERROR, message)
