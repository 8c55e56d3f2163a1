"""The demand law of an emulated SimpleFOC board: the torque in each of the library's motion modes.

The library has no fixed gains for velocity and angle; its user sets them. Here the gains follow from the motor's
inertia and the bandwidth `BANDWIDTH`. The current loop is that of the plant.
"""

from __future__ import annotations

import math
from typing import Any, Self

from sim_backend.parameters import SimParameters
from sim_backend.sensors import counted
from sim_backend.wire.plant_motor import BEAT, PlantMotor, limited

TORQUE_MODE, VELOCITY_MODE, ANGLE_MODE, ANGLE_NOCASCADE_MODE = 0, 1, 2, 5
"""The library's motion types in which the emulated motor is driven. The remaining types are open-loop or
user-defined.
"""
BANDWIDTH = 2.0 * math.pi * 10.0
"""Bandwidth of the angle loop, rad/s."""


class MotionControl:
    """The settings and control loops of one motor. target: A, rad/s or rad, depending on the mode. Limits: V, A, rad/s.

    clamps: whether the current limit also limits a target in torque mode, as since library 2.4.
    """

    def __init__(self, parameters: SimParameters, *, clamps: bool = True) -> None:
        self.mode = TORQUE_MODE
        self.target = 0.0
        self.voltage_limit = 12.0
        self.current_limit = 2.0
        self.velocity_limit = 20.0
        self._clamps = clamps
        self._constant = parameters.motor.torque_constant
        self._resistance = parameters.motor.winding_resistance
        self._angle_lsb = 2.0 * math.pi / parameters.sensors.motor_counts
        self._current_lsb = parameters.sensors.current_lsb
        self._integral = 0.0
        self._last_current = 0.0

    def angle(self, motor: PlantMotor[Any]) -> float:
        """Return the angle rounded to counts of the sensor, rad."""
        return counted(motor.position, self._angle_lsb)

    def current(self, motor: PlantMotor[Any]) -> float:
        """Return the measured current Iq, rounded to counts, A. While the motor is disabled, the last value is
        returned.
        """
        if motor.enabled:
            self._last_current = counted(motor.torque / self._constant, self._current_lsb)
        return self._last_current

    def voltage(self, motor: PlantMotor[Any]) -> float:
        """Return the voltage Vq, V."""
        return self.current(motor) * self._resistance + self._constant * motor.velocity

    def beats(self, enabled: bool) -> bool:  # noqa: ARG002 - a torque cell may watch the joint of a disabled motor too
        """Return True: the law is always evaluated at the fixed period `BEAT`."""
        return True

    def at_rest(self, motor: PlantMotor[Any]) -> Self:
        """Reset the integral of the loops; keep the settings and the last measured current."""
        self.current(motor)
        self._integral = 0.0
        return self

    def demand(self, motor: PlantMotor[Any]) -> float:
        """Return the torque that is demanded until the next evaluation, N m."""
        volts = self.voltage_limit - self._constant * abs(motor.velocity)
        ceiling = max(0.0, volts / self._resistance)
        if self._clamps or self.mode != TORQUE_MODE:
            ceiling = min(ceiling, self.current_limit)
        ceiling *= self._constant
        if self.mode == TORQUE_MODE:
            wanted = self.target * self._constant
        elif self.mode in {VELOCITY_MODE, ANGLE_MODE, ANGLE_NOCASCADE_MODE}:
            wanted = self._regulated(motor, ceiling)
        else:
            wanted = 0.0
        return limited(wanted, ceiling)

    def _regulated(self, motor: PlantMotor[Any], ceiling: float) -> float:
        damping = motor.inertia * BANDWIDTH * 3.0
        speed = self.target
        if self.mode != VELOCITY_MODE:
            speed = BANDWIDTH / 3.0 * (self.target - self.angle(motor))
        speed = limited(speed, self.velocity_limit)
        error = speed - motor.velocity
        wanted = damping * error + self._integral
        if abs(wanted) <= ceiling:
            self._integral += damping * BANDWIDTH * error * BEAT
        return wanted
