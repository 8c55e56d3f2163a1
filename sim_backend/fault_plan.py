"""A plan of faults for the simulated servo and the emulated drives: which faults happen, and at which time or frame."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np


class Kind(NamedTuple):
    """A kind of fault. explanation: what happens. size: meaning and unit of the fault's size, "" if the fault has no
    size.

    default, lowest, highest: default and range of the size. whole: whether the size is a whole number. lasting: whether
    the fault never ends if the plan states no duration; otherwise it happens to `count` frames.
    """

    explanation: str
    size: str = ""
    default: float = math.nan
    lowest: float = -math.inf
    highest: float = math.inf
    whole: bool = False
    lasting: bool = False

    def check(self, size: float) -> None:
        """Raise ValueError if `size` is not allowed for this kind. NaN, which means the default, is always allowed."""
        if math.isnan(size):
            return
        if not self.size:
            raise ValueError(f"size {size:g}: this kind of fault has no size; leave it out")
        if not self.lowest <= size <= self.highest or (self.whole and not float(size).is_integer()):
            number = "a whole number" if self.whole else "a number"
            raise ValueError(f"size {size:g}: give {number} from {self.lowest:g} to {self.highest:g} ({self.size})")


_BYTES = (1, 1_000_000, True)
"""Lowest and highest number of bytes, and that the number is whole."""

LINK: Mapping[str, Kind] = MappingProxyType(
    {
        "drop": Kind("a reply is lost"),
        "drop-request": Kind("a request is lost"),
        "flip": Kind("a bit of a reply arrives flipped; a CAN controller would send it again"),
        "truncate": Kind("only the first bytes of a reply arrive", "bytes", 3, *_BYTES),
        "delay": Kind("a reply arrives late", "s", 0.005, 0.0, 60.0),
        "duplicate": Kind("a reply arrives twice"),
        "swap": Kind("a reply arrives behind the next one"),
        "noise": Kind("random bytes arrive before a reply, on a serial line", "bytes", 16, *_BYTES),
        "flood": Kind("very many random bytes arrive before a reply, on a serial line", "bytes", 65536, *_BYTES),
        "reboot": Kind("every drive loses its power for a moment"),
        "unplug": Kind("the adapter is pulled out", lasting=True),
        "bus-off": Kind("the CAN controller of the host leaves the bus", lasting=True),
    }
)
"""The kinds of faults on the way between the host and the drive."""
DRIVE: Mapping[str, Kind] = MappingProxyType(
    {
        "stuck-encoder": Kind("the motor's angle stays the same", lasting=True),
        "jumping-encoder": Kind("the motor's angle is wrong by", "rad at the motor", 0.5, -1e4, 1e4, lasting=True),
        "noisy-encoder": Kind(
            "the motor's angle has noise of a standard deviation of", "rad", 0.05, 0.0, 1e4, lasting=True
        ),
        "over-temperature": Kind("the drive measures", "degC", 150.0, -273.15, 1e4, lasting=True),
        "error": Kind("the drive latches an error, with --backend sim", "its code", 16, 1, 65535, True, lasting=True),
        "ignored-off": Kind("the drive confirms a torque-off and keeps the torque on", lasting=True),
        "broken-watchdog": Kind("the drive's watchdog never acts, whatever it reports", lasting=True),
    }
)
"""The kinds of faults in the drive."""
HOST: Mapping[str, Kind] = MappingProxyType(
    {
        "kill": Kind("the process is killed (SIGKILL)"),
        "disk-full": Kind("the disk takes no more rows", lasting=True),
        "disk-frozen": Kind("the disk does not answer any more, with --realtime", lasting=True),
    }
)
"""The kinds of faults in the computer that records, or that runs the emulator."""
KINDS: Mapping[str, Kind] = MappingProxyType({**LINK, **DRIVE, **HOST})


@dataclass(frozen=True, slots=True)
class PlannedFault:
    """A fault of a kind in `KINDS`, and when it happens: exactly one of `at`, `frame` and `probability` is set.

    at: s since the servo was opened or the drive was powered; NaN if not set. frame: number of the reply, from 1; 0 if
    not set. probability: probability that a reply has the fault; 0 if not set. duration: s from `at`; NaN: without end
    for a lasting kind, else for `count` frames. size: in the unit of the kind; NaN: the kind's default. Raises
    ValueError for a size that the kind does not allow.
    """

    kind: str
    at: float = math.nan
    frame: int = 0
    probability: float = 0.0
    duration: float = math.nan
    count: int = 1
    size: float = math.nan

    def __post_init__(self) -> None:
        KINDS[self.kind].check(self.size)

    @property
    def amount(self) -> float:
        """The size of the fault; the kind's default if the plan states none."""
        return KINDS[self.kind].default if math.isnan(self.size) else self.size


class FaultPlan:
    """The faults of a run. The same seed gives the same faults. The link, the drive and the host each query the faults
    of their own kinds.
    """

    def __init__(self, faults: Sequence[PlannedFault] = (), seed: int = 0) -> None:
        self._faults = tuple(faults)
        self._seed = seed
        self._began: dict[int, int] = {}

    def kinds(self) -> frozenset[str]:
        """Return the kinds of all faults in the plan."""
        return frozenset(fault.kind for fault in self._faults)

    def acting(self, kinds: Collection[str], t: float, number: int) -> list[PlannedFault]:
        """Return the faults of `kinds` that act on the frame `number`, counted from 1, at the time `t`, s."""
        return [
            fault
            for place, fault in enumerate(self._faults)
            if fault.kind in kinds and self._acts(place, fault, t, number)
        ]

    def random(self, number: int) -> np.random.Generator:
        """Return the random generator for the frame `number`, which is the same in every run with the same seed."""
        return np.random.default_rng([self._seed, len(self._faults), number])

    def _acts(self, place: int, fault: PlannedFault, t: float, number: int) -> bool:
        if fault.probability:
            return bool(np.random.default_rng([self._seed, place, number]).random() < fault.probability)
        if fault.frame:
            begun, first = number >= fault.frame, fault.frame
        else:
            begun = t >= fault.at
            first = self._began.setdefault(place, number) if begun else number
        if not begun:
            return False
        if math.isfinite(fault.duration):
            return fault.frame > 0 or t < fault.at + fault.duration
        return KINDS[fault.kind].lasting or number < first + fault.count
