"""Wire faults: what an emulated link does to the requests and replies that pass over it, on demand.

One module for every link. A fault begins `after` further replies and lasts for `count` of them; `DropRequests` counts
requests instead. The simulated servo has no wire: its faults are scheduled in time, in `sim_backend.faults`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar


@dataclass(frozen=True, slots=True)
class _Scheduled:
    """A fault that begins `after` further replies and lasts for `count` of them."""

    after: int = 0
    count: int = 1


class DropReplies(_Scheduled):
    """The drive answers and nothing arrives."""


class CorruptReplies(_Scheduled):
    """One bit of the middle byte arrives flipped."""


@dataclass(frozen=True, slots=True)
class TruncateReplies(_Scheduled):
    """Only the first `keep` bytes arrive."""

    keep: int = 3


@dataclass(frozen=True, slots=True)
class DelayReplies(_Scheduled):
    """The reply arrives `seconds` later than it should."""

    seconds: float = 0.01


class DuplicateReplies(_Scheduled):
    """The reply arrives twice."""


@dataclass(frozen=True, slots=True)
class NoiseBefore(_Scheduled):
    """The bytes `noise` arrive in front of the reply."""

    noise: bytes = b"\x00\xff\xff\xfd\x13\x37"


class DropRequests(_Scheduled):
    """The request does not reach any drive."""


class Reboots(_Scheduled):
    """Every drive loses its power for a moment, before it would have answered."""


class Unplug(_Scheduled):
    """The adapter is pulled out, before the drive would have answered."""


class BusOff(_Scheduled):
    """The adapter's CAN controller has counted too many errors and leaves the bus, before the drive would have
    answered.
    """


Interruption = Reboots | Unplug | BusOff
SharedFault = DropReplies | TruncateReplies | DelayReplies | DuplicateReplies | DropRequests | Reboots | Unplug
SerialFault = SharedFault | CorruptReplies | NoiseBefore
CanFault = SharedFault | BusOff
"""A flipped bit is no fault of a CAN bus: the controllers' checksum catches it and the frame is sent again."""
WireFault = SerialFault | CanFault
Accepted = TypeVar("Accepted", bound=WireFault)


class WireFaults(Generic[Accepted]):
    """The faults injected into one link, and the number of requests and replies that have passed over it."""

    def __init__(self) -> None:
        self.requests = 0
        self.replies = 0
        self._injected: list[tuple[int, Accepted]] = []

    def inject(self, fault: Accepted) -> None:
        """Let `fault` happen, counted from now."""
        seen = self.requests if isinstance(fault, DropRequests) else self.replies
        self._injected.append((seen + fault.after, fault))

    def clear(self) -> None:
        """Remove every injected fault."""
        self._injected.clear()

    def loses_request(self) -> bool:
        """Count a request; return whether it is lost."""
        self.requests += 1
        return any(isinstance(fault, DropRequests) for fault in self._now(self.requests))

    def interrupts_reply(self) -> Interruption | None:
        """Count a reply; return what happens to the link or the drives instead of it, None where nothing does."""
        self.replies += 1
        return next((fault for fault in self._now(self.replies) if isinstance(fault, Interruption)), None)

    def arriving(self, data: bytes, at: float) -> list[tuple[float, bytes]]:
        """Return what arrives, and when (s), instead of the reply `data` at `at`: the one counted last."""
        pieces = [(at, data)]
        for fault in self._now(self.replies):
            pieces = [piece for when, part in pieces for piece in _damaged(fault, part, when)]
        return pieces

    def _now(self, number: int) -> list[Accepted]:
        """Return the faults that act on request or reply `number`, counted from 1."""
        return [fault for first, fault in self._injected if first < number <= first + fault.count]


def _damaged(fault: WireFault, data: bytes, at: float) -> list[tuple[float, bytes]]:
    pieces = [(at, data)]
    match fault:
        case DropReplies():
            pieces = []
        case CorruptReplies() if data:
            middle = len(data) // 2
            pieces = [(at, data[:middle] + bytes([data[middle] ^ 0x10]) + data[middle + 1 :])]
        case TruncateReplies():
            pieces = [(at, data[: fault.keep])]
        case DelayReplies():
            pieces = [(at + fault.seconds, data)]
        case DuplicateReplies():
            pieces = [(at, data), (at, data)]
        case NoiseBefore():
            pieces = [(at, fault.noise + data)]
    return pieces
