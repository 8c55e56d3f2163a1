"""The checks of `hil doctor`: each has a verdict and a remedy; and the measured speed of the link."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from drivers.servo import ServoInfo


class Verdict(StrEnum):
    """The outcome of a check: passed, warning or error."""

    OK = "ok"
    WARNING = "warning"
    ERROR = "error"
    SKIPPED = "not checked"


@dataclass(frozen=True, slots=True)
class Check:
    """One check: its name, its verdict, and a sentence that contains the remedy."""

    name: str
    verdict: Verdict
    message: str


@dataclass(frozen=True, slots=True)
class LinkFigures:
    """The speed of the link, measured as fast as the drive answers: numbers of round trips and lost replies; rate, Hz;
    median, 99 % and longest round trip, s.
    """

    exchanges: int
    lost: int
    rate: float
    median: float
    p99: float
    longest: float


def _ignore(item: object) -> None:
    del item


@dataclass(slots=True)
class CheckList:
    """The checks made so far. on_check: called with each check when it has been made. on_alarm: called with each alarm.

    keys: for each check, the keys of the stand file on which the check depends; an error names these keys. info:
    description of the drive. bus: speed of the link. Both are None if the checks ended before they were known. signal:
    number of the signal that ended the checks early, or 0.
    """

    on_check: Callable[[Check], None] = _ignore
    on_alarm: Callable[[str], object] = _ignore
    keys: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    checks: list[Check] = field(default_factory=list)
    info: ServoInfo | None = None
    bus: LinkFigures | None = None
    signal: int = 0

    @property
    def ok(self) -> bool:
        """Return whether no check is an error."""
        return all(check.verdict is not Verdict.ERROR for check in self.checks)

    @property
    def verdict(self) -> Verdict:
        """Return the worst verdict of all checks."""
        found = {check.verdict for check in self.checks}
        return next((one for one in (Verdict.ERROR, Verdict.WARNING) if one in found), Verdict.OK)

    def add(self, name: str, verdict: Verdict, message: str) -> None:
        """Append a check with its verdict and message."""
        keys = self.keys.get(name, ()) if verdict is Verdict.ERROR else ()
        if keys and not any(key in message for key in keys):
            message += f" (in the stand file: {', '.join(keys)})"
        check = Check(name, verdict, message)
        self.checks.append(check)
        self.on_check(check)

    def passed(self, name: str, message: str) -> None:
        """Append a check that passed."""
        self.add(name, Verdict.OK, message)

    def failed(self, name: str, message: str) -> None:
        """Append a check that failed; its verdict is an error."""
        self.add(name, Verdict.ERROR, message)

    def alarm(self, sentence: str) -> None:
        """Append the failed check "torque off", unless it has this message already, and call `on_alarm`."""
        if sentence not in [check.message for check in self.checks]:
            self.failed("torque off", sentence)
            self.on_alarm(sentence)


def called(info: ServoInfo) -> str:
    """Return kind and model of a drive, with serial number and firmware if it tells them."""
    words = [f"{info.backend} {info.model}", info.serial, f"firmware {info.firmware}" if info.firmware else ""]
    return ", ".join(word for word in words if word)
