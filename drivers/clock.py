"""Clocks: whose time a servo's samples carry."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Whose time the recording keeps, in s from an arbitrary zero; it never goes back."""

    def now(self) -> float:
        """Return the time now, s."""

    def sleep_until(self, t: float) -> None:
        """Return at `t` s or later; at once where `t` has passed."""


def machine_time() -> float:
    """Return the machine's monotonic time, s, which counts the time that it is asleep where the system offers such.

    A drive may pull on while its computer is suspended: that must be time too.
    """
    return time.clock_gettime(time.CLOCK_BOOTTIME) if _COUNTS_SLEEP else time.monotonic()


_COUNTS_SLEEP = hasattr(time, "CLOCK_BOOTTIME")
_SPIN = 100e-6  # s before its time at which a sleep ends: the system wakes a process up late by about as much


class MonotonicClock:
    """The time of `machine_time`: a step of the wall clock does not change it, and a suspended computer is late."""

    def now(self) -> float:
        """Return the time now, s."""
        return machine_time()

    def sleep_until(self, t: float) -> None:
        """Return at `t` s or a few microseconds later; at once where `t` has passed."""
        remaining = t - _SPIN - machine_time()
        if remaining > 0.0:
            time.sleep(remaining)
        while machine_time() < t:
            pass


class VirtualClock:
    """Time that passes only when someone waits for it: for simulation, replay and tests."""

    def __init__(self) -> None:
        self._t = 0.0

    def now(self) -> float:
        """Return the time now, s."""
        return self._t

    def sleep_until(self, t: float) -> None:
        """Let time pass until `t` s; no time passes where `t` is not later."""
        if t > self._t:  # noqa: PLR1730 - `max` takes five times as long, once a tick
            self._t = t
