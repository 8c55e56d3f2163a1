"""Faults of the simulated servo, scheduled in time: a plan is a tuple of these. Times are s since it was opened."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numpy.random import Generator


@dataclass(frozen=True, slots=True)
class LinkDrops:
    """The link is gone from `at` on, for every call. The drive is left to its watchdog."""

    at: float


@dataclass(frozen=True, slots=True)
class Silence:
    """From `start` to `end` no set-point reaches the drive and no reply comes back."""

    start: float
    end: float


@dataclass(frozen=True, slots=True)
class CorruptReplies:
    """Replies from `start` to `end` fail their checksum; set-points still arrive."""

    start: float
    end: float


@dataclass(frozen=True, slots=True)
class FaultLatches:
    """The drive latches `code` at `at` and turns its torque off."""

    at: float
    code: int

    def __post_init__(self) -> None:
        if self.code < 1:
            raise ValueError(f"fault code {self.code}: zero and below mean no fault")


@dataclass(frozen=True, slots=True)
class EncoderFreezes:
    """The motor encoder repeats its count from `at` on, and neither drive nor status shows it."""

    at: float


@dataclass(frozen=True, slots=True)
class TorqueUnreadable:
    """Both torque readings are NaN from `start` to `end`."""

    start: float
    end: float


@dataclass(frozen=True, slots=True)
class RepliesRepeat:
    """From `start` to `end` the drive answers with what it last read, its clock included; set-points still act."""

    start: float
    end: float


Fault = LinkDrops | Silence | CorruptReplies | FaultLatches | EncoderFreezes | TorqueUnreadable | RepliesRepeat
Interval = Silence | CorruptReplies | TorqueUnreadable | RepliesRepeat


def within(plan: tuple[Fault, ...], kind: type[Interval], t: float) -> bool:
    """Whether an interval of this kind holds at `t`, s; its end does not belong to it."""
    return any(isinstance(fault, kind) and fault.start <= t < fault.end for fault in plan)


def link_ends(plan: tuple[Fault, ...]) -> float:
    """Return the time from which the link is gone, s; infinity where it stays."""
    return min((fault.at for fault in plan if isinstance(fault, LinkDrops)), default=math.inf)


def device_faults(plan: tuple[Fault, ...]) -> list[FaultLatches | EncoderFreezes]:
    """Return the faults inside the drive, in order of time."""
    inside = [fault for fault in plan if isinstance(fault, FaultLatches | EncoderFreezes)]
    return sorted(inside, key=lambda fault: fault.at)


def random_plan(rng: Generator, duration: float) -> tuple[Fault, ...]:
    """A plan of one to three faults of any kind within `duration` s, intervals up to a tenth of it; from `rng` only."""
    return tuple(_random_fault(rng, duration) for _ in range(int(rng.integers(1, 4))))


def _random_fault(rng: Generator, duration: float) -> Fault:
    at = float(rng.uniform(0.0, duration))
    end = at + float(rng.uniform(0.0, 0.1 * duration))
    kinds: tuple[Fault, ...] = (
        LinkDrops(at),
        Silence(at, end),
        CorruptReplies(at, end),
        FaultLatches(at, int(rng.integers(16, 32))),
        EncoderFreezes(at),
        TorqueUnreadable(at, end),
        RepliesRepeat(at, end),
    )
    return kinds[int(rng.integers(len(kinds)))]
