"""Demand laws of a moteus other than the plain impedance: stay within bounds, and a trajectory to a position.

Source: mjbots/moteus fw/bldc_servo_control.h for staying within bounds, docs/protocol/registers.md for limits of speed
and acceleration. A trajectory begins at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from sim_backend.wire.canbus.impedance import Impedance
from sim_backend.wire.plant_motor import PlantMotor


@dataclass(frozen=True, slots=True)
class Within:
    """Demand law of the mode "stay within bounds": outside the bounds, `law` drives back to the nearest bound; inside,
    only the feedforward of `law` acts.

    lowest, highest: the bounds, rad; NaN: no bound.
    """

    law: Impedance
    lowest: float
    highest: float

    def beats(self, enabled: bool) -> bool:
        """Return whether the torque depends on measurements, so that it must be computed again and again."""
        return enabled

    def demand(self, motor: PlantMotor[Any]) -> float:
        """Return the torque for the motor's position, N m."""
        law = replace(self.law, kp=0.0, kd=0.0)
        for bound, passed in (
            (self.lowest, motor.position < self.lowest),
            (self.highest, motor.position > self.highest),
        ):
            law = replace(self.law, position=bound) if passed else law
        return law.demand(motor)

    def at_rest(self, _motor: PlantMotor[Any]) -> Impedance:
        """Return a law without torque."""
        return Impedance()


@dataclass(frozen=True, slots=True)
class Guided:
    """Demand law with a trajectory: the position of `law` is reached from `start` with limited speed and acceleration.

    begin: time at which the trajectory begins, s. start: rad. speed: limit, rad/s. acceleration: limit, rad/s^2. An
    infinite limit means no limit.
    """

    law: Impedance
    begin: float
    start: float
    speed: float
    acceleration: float

    @property
    def duration(self) -> float:
        """Return the duration of the trajectory, s."""
        way = abs(self.law.position - self.start)
        reached, ramp = self._cruise(way)
        if way == 0.0 or reached == math.inf:
            return 0.0
        return 2.0 * ramp + max(0.0, way - reached * ramp) / reached if reached > 0.0 else math.inf

    def beats(self, enabled: bool) -> bool:
        """Return whether the torque depends on measurements, so that it must be computed again and again."""
        return enabled

    def demand(self, motor: PlantMotor[Any]) -> float:
        """Return the torque for the motor's position and velocity, N m."""
        position, velocity = self._at(motor.time - self.begin)
        return replace(self.law, position=position, velocity=velocity).demand(motor)

    def at_rest(self, _motor: PlantMotor[Any]) -> Impedance:
        """Return a law without torque."""
        return Impedance()

    def _cruise(self, way: float) -> tuple[float, float]:
        """Return the highest speed on a trajectory of length `way`, rad/s, and the time to reach this speed, s."""
        reached = min(self.speed, math.sqrt(way * self.acceleration))
        return reached, reached / self.acceleration if self.acceleration else math.inf

    def _at(self, elapsed: float) -> tuple[float, float]:
        """Return position, rad, and velocity, rad/s, at `elapsed` s after the trajectory's begin."""
        way, whole = self.law.position - self.start, self.duration
        if elapsed >= whole:
            return self.law.position, self.law.velocity
        if math.isinf(whole):  # it may not move
            return self.start, 0.0
        reached, ramp = self._cruise(abs(way))
        done, speed = reached * (elapsed - 0.5 * ramp), reached
        if elapsed < ramp:
            done, speed = 0.5 * self.acceleration * elapsed**2, self.acceleration * elapsed
        elif elapsed > whole - ramp:
            left = whole - elapsed
            done, speed = abs(way) - 0.5 * self.acceleration * left**2, self.acceleration * left
        return self.start + math.copysign(done, way), math.copysign(speed, way)
