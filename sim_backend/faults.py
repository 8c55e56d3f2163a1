"""Faults of the simulated servo at planned times. A plan is a tuple of these objects. Times are s since the servo was
opened.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class _Moment:
    """Base class of a fault that begins at `at` and never ends."""

    at: float


@dataclass(frozen=True, slots=True)
class _Interval:
    """Base class of a fault that lasts from `start` to `end`."""

    start: float
    end: float


class LinkDrops(_Moment):
    """Fault: the link is gone from `at` on, and every call raises LinkLost. Only the drive's watchdog can switch the
    torque off.
    """


class Silence(_Interval):
    """Fault: from `start` to `end` no set-point reaches the drive and no reply arrives."""


class CorruptReplies(_Interval):
    """Fault: replies from `start` to `end` fail their checksum. Set-points still reach the drive."""


@dataclass(frozen=True, slots=True)
class FaultLatches(_Moment):
    """Fault: at the time `at` the drive latches `code` and turns its torque off."""

    code: int

    def __post_init__(self) -> None:
        if self.code < 1:
            raise ValueError(f"fault code {self.code}: zero and below mean no fault")


class EncoderFreezes(_Moment):
    """Fault: from `at` on the motor encoder repeats its count. Neither the drive nor the status of the samples reports
    this.
    """


class TorqueUnreadable(_Interval):
    """Fault: both torque readings are NaN from `start` to `end`."""


class RepliesRepeat(_Interval):
    """Fault: from `start` to `end` the drive repeats its last reply, including its clock. Set-points still act."""


@dataclass(frozen=True, slots=True)
class WatchdogBroken:
    """Fault: the drive's watchdog never acts, although `ServoInfo` states one."""


Fault = (
    WatchdogBroken
    | LinkDrops
    | Silence
    | CorruptReplies
    | FaultLatches
    | EncoderFreezes
    | TorqueUnreadable
    | RepliesRepeat
)


def within(plan: tuple[Fault, ...], kind: type[_Interval], t: float) -> bool:
    """Return whether a fault of the class `kind` is active at `t`, s. At its `end` a fault is no longer active."""
    return bool(plan) and any(isinstance(fault, kind) and fault.start <= t < fault.end for fault in plan)


def link_ends(plan: tuple[Fault, ...]) -> float:
    """Return the time from which the link is gone, s; infinity if the plan has no such fault."""
    return min((fault.at for fault in plan if isinstance(fault, LinkDrops)), default=math.inf)


def device_faults(plan: tuple[Fault, ...]) -> list[FaultLatches | EncoderFreezes]:
    """Return the faults inside the drive, ordered by time."""
    inside = [fault for fault in plan if isinstance(fault, FaultLatches | EncoderFreezes)]
    return sorted(inside, key=lambda fault: fault.at)
