"""Faults of the simulated servo, scheduled in time: a plan is a tuple of these. Times are s since it was opened."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class _Moment:
    """A fault that begins at `at` and stays."""

    at: float


@dataclass(frozen=True, slots=True)
class _Interval:
    """A fault from `start` to `end`."""

    start: float
    end: float


class LinkDrops(_Moment):
    """The link is gone from `at` on, for every call. The drive is left to its watchdog."""


class Silence(_Interval):
    """From `start` to `end` no set-point reaches the drive and no reply comes back."""


class CorruptReplies(_Interval):
    """Replies from `start` to `end` fail their checksum; set-points still arrive."""


@dataclass(frozen=True, slots=True)
class FaultLatches(_Moment):
    """The drive latches `code` at `at` and turns its torque off."""

    code: int

    def __post_init__(self) -> None:
        if self.code < 1:
            raise ValueError(f"fault code {self.code}: zero and below mean no fault")


class EncoderFreezes(_Moment):
    """The motor encoder repeats its count from `at` on, and neither drive nor status shows it."""


class TorqueUnreadable(_Interval):
    """Both torque readings are NaN from `start` to `end`."""


class RepliesRepeat(_Interval):
    """From `start` to `end` the drive answers with what it last read, its clock included; set-points still act."""


@dataclass(frozen=True, slots=True)
class WatchdogBroken:
    """The drive's watchdog never acts, although it is announced."""


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
    """Whether an interval of this kind holds at `t`, s; its end does not belong to it."""
    return bool(plan) and any(isinstance(fault, kind) and fault.start <= t < fault.end for fault in plan)


def link_ends(plan: tuple[Fault, ...]) -> float:
    """Return the time from which the link is gone, s; infinity where it stays."""
    return min((fault.at for fault in plan if isinstance(fault, LinkDrops)), default=math.inf)


def device_faults(plan: tuple[Fault, ...]) -> list[FaultLatches | EncoderFreezes]:
    """Return the faults inside the drive, in order of time."""
    inside = [fault for fault in plan if isinstance(fault, FaultLatches | EncoderFreezes)]
    return sorted(inside, key=lambda fault: fault.at)
