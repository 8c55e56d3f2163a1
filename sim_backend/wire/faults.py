"""Wire faults: what an emulated link does to the requests and replies that pass over it, on demand.

One module for every link. A fault begins `after` further replies and lasts for `count` of them; `DropRequests` counts
requests instead. The simulated servo has no wire: its faults are scheduled in time, in `sim_backend.faults`.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar

from sim_backend.fault_plan import FaultPlan, PlannedFault


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

_INTERRUPTIONS: Mapping[str, Interruption] = MappingProxyType(
    {"reboot": Reboots(), "unplug": Unplug(), "bus-off": BusOff()}
)
_DAMAGES: Mapping[str, WireFault] = MappingProxyType(
    {
        "drop": DropReplies(),
        "flip": CorruptReplies(),
        "truncate": TruncateReplies(),
        "delay": DelayReplies(),
        "duplicate": DuplicateReplies(),
        "noise": NoiseBefore(),
        "flood": NoiseBefore(),
    }
)
_BEHIND = 1e-6  # s by which a reply that was swapped follows the next one
_ON_THE_WIRE = frozenset({*_INTERRUPTIONS, *_DAMAGES, "drop-request", "swap", "kill"})
_SERIAL_ONLY = frozenset({"flip", "noise", "flood"})


class WireFaults(Generic[Accepted]):
    """The faults injected into one link, and the number of requests and replies that have passed over it."""

    def __init__(self) -> None:
        self.requests = 0
        self.replies = 0
        self._injected: list[tuple[int, Accepted]] = []
        self._plan, self._powered = FaultPlan(), 0.0
        self._held: list[tuple[float, bytes]] = []

    def inject(self, fault: Accepted) -> None:
        """Let `fault` happen, counted from now."""
        seen = self.requests if isinstance(fault, DropRequests) else self.replies
        self._injected.append((seen + fault.after, fault))

    def clear(self) -> None:
        """Remove every injected fault."""
        self._injected.clear()

    def follow(self, plan: FaultPlan, powered: float) -> None:
        """Let the faults of `plan` happen too; its times are s from `powered`."""
        self._plan, self._powered = plan, powered

    def loses_request(self, now: float) -> bool:
        """Count a request at `now` s; return whether it is lost."""
        self.requests += 1
        if self._plan.acting(("drop-request",), now - self._powered, self.requests):
            return True
        return any(isinstance(fault, DropRequests) for fault in self._now(self.requests))

    def interrupts_reply(self, now: float) -> Interruption | None:
        """Count a reply at `now` s; return what happens to the link or the drives instead, None if nothing does."""
        self.replies += 1
        if self._plan.acting(("kill",), now - self._powered, self.replies):
            os.kill(os.getpid(), signal.SIGKILL)
        planned = [_INTERRUPTIONS[fault.kind] for fault in self._planned(_INTERRUPTIONS, now)]
        return next((fault for fault in [*planned, *self._now(self.replies)] if isinstance(fault, Interruption)), None)

    def arriving(self, data: bytes, at: float) -> list[tuple[float, bytes]]:
        """Return what arrives, and when (s), instead of the reply `data` at `at`: the one counted last."""
        pieces = [(at, data)]
        planned = [self._made(fault) for fault in self._planned(_DAMAGES, at)]
        for fault in [*planned, *self._now(self.replies)]:
            pieces = [piece for when, part in pieces for piece in _damaged(fault, part, when)]
        held, self._held = self._held, []
        if self._planned(("swap",), at):
            self._held, pieces = pieces, []
        return pieces + [(max(at, when) + _BEHIND, part) for when, part in held]

    def _planned(self, kinds: Iterable[str], now: float) -> list[PlannedFault]:
        return self._plan.acting(tuple(kinds), now - self._powered, self.replies)

    def _made(self, fault: PlannedFault) -> WireFault:
        """Return the damage that a planned fault does to the present reply."""
        if fault.kind in {"noise", "flood"}:
            return NoiseBefore(noise=self._plan.random(self.replies).bytes(int(fault.amount)))
        if fault.kind == "truncate":
            return TruncateReplies(keep=int(fault.amount))
        return DelayReplies(seconds=fault.amount) if fault.kind == "delay" else _DAMAGES[fault.kind]

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


class Faulty(Protocol):
    """A motor whose drive can have faults."""

    def follow_plan(self, plan: FaultPlan) -> frozenset[str]:
        """Let the faults of `plan` happen; return the kinds that it knows."""


def follow(plan: FaultPlan, link: WireFaults[Any], motors: Iterable[Faulty], powered: float, *, can: bool) -> None:
    """Let the faults of `plan` happen on an emulated link and in its drives, which were powered at `powered` s.

    can: whether the link is a CAN bus. Raises ValueError for a kind that cannot happen there.
    """
    known = (_ON_THE_WIRE - _SERIAL_ONLY if can else _ON_THE_WIRE - {"bus-off"}).union(
        *(motor.follow_plan(plan) for motor in motors)
    )
    if odd := sorted(plan.kinds() - known):
        raise ValueError(f"{', '.join(odd)} cannot happen here: it knows {', '.join(sorted(known))}")
    link.follow(plan, powered)
