"""The life of an emulated drive: what every family's firmware does alike from its power-up on."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal

from sim_backend.wire.plant_motor import PlantMotor

WatchdogState = Literal["none", "off", "on", "tripped"]
"""The state of a drive's watchdog. none: the drive has no watchdog. off: the watchdog is not active now. on: it is
active. tripped: it has stopped the drive.
"""
_LOOK = 0.05
"""s between two looks at the output of a servo that may be overloaded."""


class Life:
    """The life of an emulated drive whose `motor` is powered at `now`. Times are s on the clock of the drive's bus.

    powered: the time at which the drive was made. booted: when it was powered last. ready: when that boot ends, before
    which it does not reply. heard: when it last received what feeds its watchdog. lapsed: whether the watchdog has
    acted since the motor was on. ignores_off: whether a torque-off is acknowledged but not carried out: a fault for
    tests. watches: a function that returns whether the watchdog is active, 0 if not, None if the drive has none.
    tripped: a function that returns whether the watchdog has stopped the drive, 0 if not; None: `lapsed` says so.
    """

    def __init__(
        self,
        motor: PlantMotor[Any],
        now: float,
        watches: Callable[[], float | None] = lambda: None,
        tripped: Callable[[], float] | None = None,
    ) -> None:
        self.motor = motor
        self.powered = self.booted = self.ready = self.heard = now
        self.lapsed = self.ignores_off = False
        self._watches = watches
        self._tripped = tripped or (lambda: self.lapsed and not self.motor.enabled)
        self._strained = math.inf

    @property
    def now(self) -> float:
        """The time up to which the drive is simulated."""
        return self.powered + self.motor.time

    @property
    def watchdog_state(self) -> WatchdogState:
        """The state of the drive's watchdog."""
        watches = self._watches()
        return "none" if watches is None else "tripped" if self._tripped() else "on" if watches else "off"

    def run(self, until: float) -> None:
        """Simulate the motor up to `until`. Has no effect if this time has passed."""
        self.motor.run(until - self.powered)

    def lapses(self, now: float, timeout: float) -> bool:
        """Simulate the motor up to the time at which an active watchdog acts, `timeout` s after the drive last heard
        something, if this is before `now`. Return whether the watchdog acts.
        """
        self.lapsed = self.lapsed and not self.motor.enabled
        if not self._watches() or now - self.heard <= timeout or self.motor.watchdog_broken:
            return False
        self.run(self.heard + timeout)
        self.lapsed = True
        return True

    def boot(self, now: float, lasting: float) -> None:
        """Cut the power at `now`: the torque goes off, and the drive does not reply for `lasting` s."""
        self.motor.disable()
        self.booted = self.heard = now
        self.ready = now + lasting

    def overloads(self, until: float, high: Callable[[], bool], lasting: float) -> bool:
        """Simulate the motor up to `until`, or until its output has been too high for `lasting` s. Return whether it
        has. high: a function that returns whether the output is too high now.
        """
        motor, end = self.motor, until - self.powered
        while motor.time < end:
            motor.run(min(end, motor.time + _LOOK) if motor.enabled else end)
            self._strained = min(self._strained, motor.time) if motor.enabled and high() else math.inf
            if motor.time - self._strained >= lasting:
                self._strained = math.inf
                return True
        return False
