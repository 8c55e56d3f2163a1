"""Faults of an emulated link, which damage, delay or drop the requests and replies that pass over it.

All emulated links use this module. A fault begins after `after` more replies and lasts for `count` replies;
`DropRequests` counts requests instead. The simulated servo has no link on a wire: its faults are in
`sim_backend.faulty_servo`.
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
    """Base class of a fault that begins after `after` more replies and lasts for `count` replies."""

    after: int = 0
    count: int = 1


class DropReplies(_Scheduled):
    """Fault: the drive replies, but nothing arrives at the host."""


class CorruptReplies(_Scheduled):
    """Fault: the reply arrives with one bit of its middle byte flipped."""


@dataclass(frozen=True, slots=True)
class TruncateReplies(_Scheduled):
    """Fault: only the first `keep` bytes of the reply arrive."""

    keep: int = 3


@dataclass(frozen=True, slots=True)
class DelayReplies(_Scheduled):
    """Fault: the reply arrives `seconds` too late."""

    seconds: float = 0.01


class DuplicateReplies(_Scheduled):
    """Fault: the reply arrives twice."""


@dataclass(frozen=True, slots=True)
class NoiseBefore(_Scheduled):
    """Fault: the bytes `noise` arrive before the reply."""

    noise: bytes = b"\x00\xff\xff\xfd\x13\x37"


class DropRequests(_Scheduled):
    """Fault: the request reaches no drive."""


class Reboots(_Scheduled):
    """Fault: every drive loses its power for a moment instead of replying."""


class Unplug(_Scheduled):
    """Fault: the adapter is unplugged before the drive replies."""


class BusOff(_Scheduled):
    """Fault: the adapter's CAN controller has counted too many errors and goes bus-off before the drive replies."""


Interruption = Reboots | Unplug | BusOff
SharedFault = DropReplies | TruncateReplies | DelayReplies | DuplicateReplies | DropRequests | Reboots | Unplug
SerialFault = SharedFault | CorruptReplies | NoiseBefore
CanFault = SharedFault | BusOff
"""The faults that a CAN bus can have. A flipped bit is not among them: the CAN controllers detect it by checksum and
send the frame again.
"""
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
    """The faults of one link. It counts the requests and replies that have passed over the link."""

    def __init__(self) -> None:
        self.requests = 0
        self.replies = 0
        self._injected: list[tuple[int, Accepted]] = []
        self._plan, self._powered = FaultPlan(), 0.0
        self._held: list[tuple[float, bytes]] = []

    def inject(self, fault: Accepted) -> None:
        """Add `fault`, whose start is counted from now."""
        seen = self.requests if isinstance(fault, DropRequests) else self.replies
        self._injected.append((seen + fault.after, fault))

    def clear(self) -> None:
        """Remove every injected fault."""
        self._injected.clear()

    def follow(self, plan: FaultPlan, powered: float) -> None:
        """Add the faults of `plan`, whose times are s since `powered`."""
        self._plan, self._powered = plan, powered

    def loses_request(self, now: float) -> bool:
        """Count a request that is sent at `now`, s. Return whether it is lost."""
        self.requests += 1
        if self._plan.acting(("drop-request",), now - self._powered, self.requests):
            return True
        return any(isinstance(fault, DropRequests) for fault in self._now(self.requests))

    def interrupts_reply(self, now: float) -> Interruption | None:
        """Count a reply that is sent at `now`, s. Return the fault that happens to the link or the drives instead of
        the reply; None if none does.
        """
        self.replies += 1
        if self._plan.acting(("kill",), now - self._powered, self.replies):
            os.kill(os.getpid(), signal.SIGKILL)
        planned = [_INTERRUPTIONS[fault.kind] for fault in self._planned(_INTERRUPTIONS, now)]
        return next((fault for fault in [*planned, *self._now(self.replies)] if isinstance(fault, Interruption)), None)

    def arriving(self, data: bytes, at: float) -> list[tuple[float, bytes]]:
        """Return what arrives at the host instead of the reply `data`, as (time s, bytes).

        at: s, when the reply would arrive. Call `interrupts_reply` before, which counts the reply.
        """
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
        """Return the link fault for `fault`, a fault of the plan that acts on the present reply."""
        if fault.kind in {"noise", "flood"}:
            return NoiseBefore(noise=self._plan.random(self.replies).bytes(int(fault.amount)))
        if fault.kind == "truncate":
            return TruncateReplies(keep=int(fault.amount))
        return DelayReplies(seconds=fault.amount) if fault.kind == "delay" else _DAMAGES[fault.kind]

    def _now(self, number: int) -> list[Accepted]:
        """Return the injected faults that act on request or reply `number`, counted from 1."""
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
    """An emulated motor whose drive can have faults."""

    def follow_plan(self, plan: FaultPlan) -> frozenset[str]:
        """Add the faults of `plan`. Return the kinds of faults that the drive can have."""


def follow(plan: FaultPlan, link: WireFaults[Any], motors: Iterable[Faulty], powered: float, *, can: bool) -> None:
    """Add the faults of `plan` to an emulated link and to its drives, which were powered at `powered`, s.

    can: whether the link is a CAN bus. Raises ValueError for a kind of fault that the link and its drives cannot have.
    """
    known = (_ON_THE_WIRE - _SERIAL_ONLY if can else _ON_THE_WIRE - {"bus-off"}).union(
        *(motor.follow_plan(plan) for motor in motors)
    )
    if odd := sorted(plan.kinds() - known):
        raise ValueError(f"{', '.join(odd)} cannot happen here: possible are {', '.join(sorted(known))}")
    link.follow(plan, powered)
