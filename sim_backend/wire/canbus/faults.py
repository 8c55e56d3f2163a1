"""What goes wrong on a CAN bus on purpose. `after` and `count` are replies (or requests), counted from the injection.

A flipped bit is not among them: the controllers' checksum catches it and the frame is sent again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from sim_backend.wire.canbus.frames import CanFrame


@dataclass(frozen=True, slots=True)
class DropReplies:
    """The drive answers and nothing arrives."""

    after: int = 0
    count: int = 1


@dataclass(frozen=True, slots=True)
class TruncateReplies:
    """Only the first `keep` bytes arrive: an adapter or a gateway cut them off."""

    after: int = 0
    count: int = 1
    keep: int = 3


@dataclass(frozen=True, slots=True)
class DelayReplies:
    """The adapter holds the reply up for `seconds`, and what comes behind it."""

    after: int = 0
    count: int = 1
    seconds: float = 0.01


@dataclass(frozen=True, slots=True)
class DuplicateReplies:
    """The reply arrives twice."""

    after: int = 0
    count: int = 1


@dataclass(frozen=True, slots=True)
class DropRequests:
    """The frame does not reach any drive."""

    after: int = 0
    count: int = 1


@dataclass(frozen=True, slots=True)
class Reboots:
    """Every drive loses its power for a moment, before it would have answered."""

    after: int = 0
    count: int = 1


@dataclass(frozen=True, slots=True)
class Unplug:
    """The adapter is pulled out, before the drive would have answered."""

    after: int = 0
    count: int = 1


@dataclass(frozen=True, slots=True)
class BusOff:
    """The adapter's controller has counted too many errors and leaves the bus, before the drive would have answered."""

    after: int = 0
    count: int = 1


Fault = DropReplies | TruncateReplies | DelayReplies | DuplicateReplies | DropRequests | Reboots | Unplug | BusOff


def spoiled(fault: Fault, frame: CanFrame, at: float) -> list[tuple[float, CanFrame]]:
    """What arrives, and when (s), instead of the reply `frame` at `at`."""
    match fault:
        case DropReplies():
            arriving: list[tuple[float, CanFrame]] = []
        case TruncateReplies():
            arriving = [(at, replace(frame, data=frame.data[: fault.keep]))]
        case DelayReplies():
            arriving = [(at + fault.seconds, frame)]
        case DuplicateReplies():
            arriving = [(at, frame), (at, frame)]
        case _:
            arriving = [(at, frame)]
    return arriving
