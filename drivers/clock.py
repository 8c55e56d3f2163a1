"""The clocks from which the time stamps of a servo's samples are taken."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Protocol


class Clock(Protocol):
    """A source of time, in s from an arbitrary zero. The time never goes back."""

    def now(self) -> float:
        """Return the time now, s."""

    def sleep_until(self, t: float) -> None:
        """Wait until the time `t`, s. Return at once if `t` has passed."""


_latest: ContextVar[float] = ContextVar("latest", default=math.inf)


@contextmanager
def waits_end_by(end: float) -> Iterator[None]:
    """Context manager: in its block, no wait for a reply lasts beyond the time `end`, s on the servo's clock.

    A request is still sent after that time, but its reply is not awaited: a torque-off that nobody confirms must become
    an alarm in time, however long the drive's own time limits are.
    """
    before = _latest.set(min(end, _latest.get()))
    try:
        yield
    finally:
        _latest.reset(before)


def no_later(end: float) -> float:
    """Return the time `end`, s, or that of the enclosing `waits_end_by` if that is earlier."""
    return min(end, _latest.get())


def machine_time() -> float:
    """Return the computer's monotonic time, s. The time for which the computer was suspended is included, if the
    operating system can measure it.

    A drive may keep its torque on while its computer is suspended, so that time must be counted.
    """
    return time.clock_gettime(time.CLOCK_BOOTTIME) if _COUNTS_SLEEP else time.monotonic()


_COUNTS_SLEEP = hasattr(time, "CLOCK_BOOTTIME")
_SPIN = 100e-6  # s before its time at which a sleep ends: the system wakes a process up late by about as much


class MonotonicClock:
    """The clock of real stands. It returns `machine_time`: a step of the wall clock has no effect, and a suspended
    computer shows as a delay.
    """

    def now(self) -> float:
        """Return the time now, s."""
        return machine_time()

    def sleep_until(self, t: float) -> None:
        """Wait until the time `t`, s, or a few microseconds longer. Return at once if `t` has passed."""
        remaining = t - _SPIN - machine_time()
        if remaining > 0.0:
            time.sleep(remaining)
        while machine_time() < t:
            pass


class VirtualClock:
    """A clock whose time advances only in `sleep_until`: for simulation, replay and tests."""

    def __init__(self) -> None:
        self._t = 0.0

    def now(self) -> float:
        """Return the time now, s."""
        return self._t

    def sleep_until(self, t: float) -> None:
        """Advance the time to `t`, s. A `t` that has passed has no effect."""
        if t > self._t:  # noqa: PLR1730 - `max` takes five times as long, once a tick
            self._t = t
