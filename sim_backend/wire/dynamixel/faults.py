"""What goes wrong on the wire on purpose. `after` and `count` are replies (or requests), counted from the injection."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DropReplies:
    """The servo answers and nothing arrives."""

    after: int = 0
    count: int = 1


@dataclass(frozen=True, slots=True)
class CorruptReplies:
    """One bit of the middle byte arrives flipped."""

    after: int = 0
    count: int = 1


@dataclass(frozen=True, slots=True)
class TruncateReplies:
    """Only the first `keep` bytes arrive."""

    after: int = 0
    count: int = 1
    keep: int = 9


@dataclass(frozen=True, slots=True)
class DelayReplies:
    """The reply arrives `seconds` later than it should."""

    after: int = 0
    count: int = 1
    seconds: float = 0.04


@dataclass(frozen=True, slots=True)
class DuplicateReplies:
    """The reply arrives twice."""

    after: int = 0
    count: int = 1


@dataclass(frozen=True, slots=True)
class NoiseBefore:
    """`noise` arrives in front of the reply."""

    after: int = 0
    count: int = 1
    noise: bytes = b"\x00\xff\xff\xfd\x13\x37"


@dataclass(frozen=True, slots=True)
class DropRequests:
    """The instruction does not reach any servo."""

    after: int = 0
    count: int = 1


@dataclass(frozen=True, slots=True)
class Reboots:
    """Every servo loses its power for a moment, before it would have answered."""

    after: int = 0
    count: int = 1


@dataclass(frozen=True, slots=True)
class Unplug:
    """The adapter is pulled out, before the servo would have answered."""

    after: int = 0
    count: int = 1


Fault = (
    DropReplies
    | CorruptReplies
    | TruncateReplies
    | DelayReplies
    | DuplicateReplies
    | NoiseBefore
    | DropRequests
    | Reboots
    | Unplug
)


def spoiled(fault: Fault, data: bytes, at: float) -> list[tuple[float, bytes]]:
    """What arrives, and when (s), instead of the reply `data` at `at`."""
    match fault:
        case DropReplies():
            arriving: list[tuple[float, bytes]] = []
        case CorruptReplies():
            middle = len(data) // 2
            arriving = [(at, data[:middle] + bytes([data[middle] ^ 0x10]) + data[middle + 1 :])]
        case TruncateReplies():
            arriving = [(at, data[: fault.keep])]
        case DelayReplies():
            arriving = [(at + fault.seconds, data)]
        case DuplicateReplies():
            arriving = [(at, data), (at, data)]
        case NoiseBefore():
            arriving = [(at, fault.noise + data)]
        case _:
            arriving = [(at, data)]
    return arriving
