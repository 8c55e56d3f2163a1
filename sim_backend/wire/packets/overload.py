"""The overload protection of an emulated servo: it acts when the output has been too high for too long."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from sim_backend.wire.plant_motor import PlantMotor

_LOOK = 0.05
"""s between two checks of the output while nothing is received."""


class Overload:
    """Measures how long the output of a motor has been too high."""

    def __init__(self) -> None:
        self._since = math.inf

    def trips(self, motor: PlantMotor[Any], until: float, *, high: Callable[[], bool], lasting: float) -> bool:
        """Simulate `motor` up to `until`, s since it was made, or until the protection acts. Return whether it acts.

        high: whether the output is too high now. lasting: s for which it may be.
        """
        while motor.time < until:
            motor.run(min(until, motor.time + _LOOK) if motor.enabled else until)
            self._since = min(self._since, motor.time) if motor.enabled and high() else math.inf
            if motor.time - self._since >= lasting:
                self._since = math.inf
                return True
        return False
