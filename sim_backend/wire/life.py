"""The life of an emulated drive: what every family's firmware does alike from its power-up on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from sim_backend.wire.plant_motor import PlantMotor

WatchdogState = Literal["none", "off", "on", "tripped"]
"""The state of a drive's watchdog. none: the drive has no watchdog. off: the watchdog is not active now. on: it is
active. tripped: it has stopped the drive.
"""


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
