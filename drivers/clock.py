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


_SPIN = 100e-6  # s before its time at which a sleep ends: the system wakes a process up late by about as much


class MonotonicClock:
    """The machine's own monotonic time: a step of the wall clock does not change it."""

    def now(self) -> float:
        """Return the time now, s."""
        return time.monotonic()

    def sleep_until(self, t: float) -> None:
        """Return at `t` s or a few microseconds later; at once where `t` has passed."""
        remaining = t - _SPIN - time.monotonic()
        if remaining > 0.0:
            time.sleep(remaining)
        while time.monotonic() < t:
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
