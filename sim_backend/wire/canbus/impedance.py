"""The law by which an emulated CAN drive computes its torque."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from sim_backend.wire.plant_motor import PlantMotor, limited


@dataclass(frozen=True, slots=True)
class Impedance:
    """The demand law torque = feedforward + kp (position - measured) + kd (velocity - measured), with a magnitude of at
    most `ceiling`.

    feedforward, ceiling: N m. kp: N m/rad. kd: N m s/rad. position: rad. velocity: rad/s. fastest: rad/s, limit of the
    speed that position error and velocity command together, as in a cascade; it needs a kd.
    """

    feedforward: float = 0.0
    kp: float = 0.0
    kd: float = 0.0
    position: float = 0.0
    velocity: float = 0.0
    ceiling: float = math.inf
    fastest: float = math.inf

    def beats(self, enabled: bool) -> bool:
        """Return whether the torque depends on measurements, so that it must be computed again and again."""
        return enabled and bool(self.kp or self.kd)

    @property
    def affine(self) -> tuple[float, float, float, float] | None:
        """The torque at angle and rate zero, N m, kp, kd and the ceiling; None if the law is not affine in angle and
        rate up to the ceiling, or does not depend on them.
        """
        if not (self.kp or self.kd) or math.isfinite(self.fastest):
            return None
        torque = self.feedforward + self.kp * self.position + self.kd * self.velocity
        return torque, self.kp, self.kd, self.ceiling

    def demand(self, motor: PlantMotor[Any]) -> float:
        """Return the torque at the motor's present position and velocity, N m."""
        if math.isinf(self.fastest):
            wanted = (
                self.feedforward
                + self.kp * (self.position - motor.position)
                + self.kd * (self.velocity - motor.velocity)
            )
        else:
            speed = self.velocity + self.kp / self.kd * (self.position - motor.position)
            wanted = self.feedforward + self.kd * (limited(speed, self.fastest) - motor.velocity)
        return limited(wanted, self.ceiling)

    def at_rest(self, _motor: PlantMotor[Any]) -> Impedance:
        """Return a law without torque."""
        return Impedance()


CanMotor = PlantMotor[Impedance]
