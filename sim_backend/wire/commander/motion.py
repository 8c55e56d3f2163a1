"""The demand law of an emulated SimpleFOC board: the library's motion modes over the plant.

The library's velocity and angle gains are its user's own; here the loops are closed with gains from the inertia, at
the bandwidth below. The current loop is the plant's.
"""

from __future__ import annotations

import math
from typing import Any, Self

from sim_backend.parameters import SimParameters
from sim_backend.sensors import counted
from sim_backend.wire.plant_motor import BEAT, PlantMotor

TORQUE_MODE, VELOCITY_MODE, ANGLE_MODE, ANGLE_NOCASCADE_MODE = 0, 1, 2, 5
"""The library's motion types that drive the motor here; the others are open-loop or the user's own."""
BANDWIDTH = 2.0 * math.pi * 10.0
"""rad/s of the angle loop."""


class MotionControl:
    """The settings of one motor and its loops. target: A, rad/s or rad, by the mode. Limits: V, A, rad/s.

    clamps: whether the current limit bounds a target in torque mode, as since library 2.4.
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
        """Return the angle in counts of the sensor, rad."""
        return counted(motor.position, self._angle_lsb)

    def current(self, motor: PlantMotor[Any]) -> float:
        """Return Iq as the board measures it in counts, A; while the motor is disabled the last is repeated."""
        if motor.enabled:
            self._last_current = counted(motor.torque / self._constant, self._current_lsb)
        return self._last_current

    def voltage(self, motor: PlantMotor[Any]) -> float:
        """Return Vq, V."""
        return self.current(motor) * self._resistance + self._constant * motor.velocity

    def beats(self, enabled: bool) -> bool:  # noqa: ARG002 - a torque cell may watch the joint of a disabled motor too
        """Return that time always passes in beats."""
        return True

    def at_rest(self, motor: PlantMotor[Any]) -> Self:
        """Empty the integral and keep the current that was measured last; the settings stay."""
        self.current(motor)
        self._integral = 0.0
        return self

    def demand(self, motor: PlantMotor[Any]) -> float:
        """Return the torque demanded in this beat, N m."""
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
        return max(-ceiling, min(ceiling, wanted))

    def _regulated(self, motor: PlantMotor[Any], ceiling: float) -> float:
        damping = motor.inertia * BANDWIDTH * 3.0
        speed = self.target
        if self.mode != VELOCITY_MODE:
            speed = BANDWIDTH / 3.0 * (self.target - self.angle(motor))
        speed = max(-self.velocity_limit, min(self.velocity_limit, speed))
        error = speed - motor.velocity
        wanted = damping * error + self._integral
        if abs(wanted) <= ceiling:
            self._integral += damping * BANDWIDTH * error * BEAT
        return wanted
