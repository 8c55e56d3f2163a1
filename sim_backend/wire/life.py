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

    powered: the time at which the drive was made. watches: a function that returns whether the drive's watchdog is
    active, 0 if not; None: the drive has no watchdog. tripped: the same for whether it has stopped the drive.
    """

    def __init__(
        self,
        motor: PlantMotor[Any],
        now: float,
        watches: Callable[[], float] | None = None,
        tripped: Callable[[], float] = lambda: 0,
    ) -> None:
        self.motor = motor
        self.powered = now
        self._watches, self._tripped = watches, tripped
        self._strained = math.inf

    @property
    def now(self) -> float:
        """The time up to which the drive is simulated."""
        return self.powered + self.motor.time

    @property
    def watchdog_state(self) -> WatchdogState:
        """The state of the drive's watchdog."""
        if self._watches is None:
            return "none"
        return "tripped" if self._tripped() else "on" if self._watches() else "off"

    def run(self, until: float) -> None:
        """Simulate the motor up to `until`. Has no effect if this time has passed."""
        self.motor.run(until - self.powered)

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
