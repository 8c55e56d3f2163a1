"""Faults inside an emulated drive: of its encoder, of its thermometer, and of an output stage that stays on."""

from __future__ import annotations

import math
from typing import ClassVar

from sim_backend.fault_plan import FaultPlan


class DriveFaults:
    """Applies the faults of `plan` to the measurements of a drive. Times are s since the drive was powered."""

    KNOWN: ClassVar[frozenset[str]] = frozenset(
        {"stuck-encoder", "jumping-encoder", "noisy-encoder", "over-temperature", "ignored-off", "broken-watchdog"}
    )

    def __init__(self, plan: FaultPlan) -> None:
        self._plan = plan
        self._none = not plan.kinds() & self.KNOWN
        self._stuck = math.nan

    @property
    def of_encoder(self) -> bool:
        """Return whether the plan has a fault of the encoder."""
        return bool(self._plan.kinds() & {"stuck-encoder", "jumping-encoder", "noisy-encoder"})

    def angle(self, angle: float, t: float) -> float:
        """Return the angle that the encoder shows at `t` s when the motor's true angle is `angle`, rad."""
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
        """Return the speed that the drive computes at `t` s when the true speed is `speed`, rad/s: 0 if the encoder is
        stuck.
        """
        if self._none or not self._plan.acting(("stuck-encoder",), t, _beat(t)):
            return speed
        return 0.0

    def temperature(self, temperature: float, t: float) -> float:
        """Return the temperature that the drive measures at `t` s when the true temperature is `temperature`, degC."""
        if self._none:
            return temperature
        hot = self._plan.acting(("over-temperature",), t, _beat(t))
        return hot[-1].amount if hot else temperature

    def stays_on(self, t: float) -> bool:
        """Return whether a fault keeps the output stage on at `t` s although the drive was switched off."""
        return not self._none and bool(self._plan.acting(("ignored-off",), t, _beat(t)))

    def watchdog_broken(self, t: float) -> bool:
        """Return whether a fault keeps the watchdog from acting at `t` s, although the drive reports it as working."""
        return not self._none and bool(self._plan.acting(("broken-watchdog",), t, _beat(t)))


def _beat(t: float) -> int:
    """Return the number of the firmware's 1 ms cycle at `t` s, from 1. A planned fault of a drive counts these cycles
    as its frames.
    """
    return 1 + int(t * 1e3)
