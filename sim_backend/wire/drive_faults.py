"""The faults in an emulated drive: its encoder, its thermometer, and an output stage that does not open."""

from __future__ import annotations

import math
from typing import ClassVar

from sim_backend.fault_plan import FaultPlan


class DriveFaults:
    """What a drive measures under `plan`, whose times are s since it was powered. Times are on the same clock."""

    KNOWN: ClassVar[frozenset[str]] = frozenset(
        {"stuck-encoder", "jumping-encoder", "noisy-encoder", "over-temperature", "ignored-off", "broken-watchdog"}
    )

    def __init__(self, plan: FaultPlan) -> None:
        self._plan = plan
        self._none = not plan.kinds() & self.KNOWN
        self._stuck = math.nan

    def angle(self, angle: float, t: float) -> float:
        """Return the angle that the encoder shows at `t` s, rad."""
        if self._none:
            return angle
        number = _beat(t)
        for fault in self._plan.acting(("stuck-encoder", "jumping-encoder", "noisy-encoder"), t, number):
            if fault.kind == "stuck-encoder":
                self._stuck = angle if math.isnan(self._stuck) else self._stuck
                angle = self._stuck
            elif fault.kind == "jumping-encoder":
                angle += fault.amount
            else:
                angle += fault.amount * float(self._plan.random(number).standard_normal())
        return angle

    def speed(self, speed: float, t: float) -> float:
        """Return the speed that the drive computes at `t` s, rad/s: 0 where the encoder is stuck."""
        if self._none or not self._plan.acting(("stuck-encoder",), t, _beat(t)):
            return speed
        return 0.0

    def temperature(self, temperature: float, t: float) -> float:
        """Return the temperature that the drive measures at `t` s, degC."""
        if self._none:
            return temperature
        hot = self._plan.acting(("over-temperature",), t, _beat(t))
        return hot[-1].amount if hot else temperature

    def stays_on(self, t: float) -> bool:
        """Return whether the output stage stays closed at `t` s although it should open."""
        return not self._none and bool(self._plan.acting(("ignored-off",), t, _beat(t)))

    def watchdog_broken(self, t: float) -> bool:
        """Return whether the watchdog does nothing at `t` s, whatever the drive says of it."""
        return not self._none and bool(self._plan.acting(("broken-watchdog",), t, _beat(t)))


def _beat(t: float) -> int:
    """Return the number of the firmware's beat at `t` s, from 1, which is the frame of a drive's fault."""
    return 1 + int(t * 1e3)
