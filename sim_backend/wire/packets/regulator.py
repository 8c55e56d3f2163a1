"""The demand law of an emulated servo in each operating mode, and the joint at its horn.

The control loops are not the vendors', whose gains have other units. The goal current becomes the current directly.
Position and velocity are controlled with gains that follow from the inertia and the bandwidth `BANDWIDTH`. In PWM mode
the stall torque is right, kt V/R, but the no-load speed is not, because the inertia is not that of a real gearbox.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

from sim_backend.parameters import SimParameters
from sim_backend.wire.default_joint import fitting_joint
from sim_backend.wire.plant_motor import BEAT, PlantMotor, limited

CURRENT, SPEED, POSITION, EXTENDED, CURRENT_POSITION, PWM = 0, 1, 3, 4, 5, 16
"""The operating modes, with DYNAMIXEL's values of Operating Mode(11)."""
COUNT = 2.0 * math.pi / 4096.0
"""rad in one count of position."""
BANDWIDTH = 2.0 * math.pi * 10.0
"""Bandwidth of the position loop, rad/s."""


class Stalling(Protocol):
    """A servo model with a known stall point. stall: voltage V, current A and torque N m at stall."""

    @property
    def stall(self) -> tuple[float, float, float]:
        """Voltage V, current A and torque N m at stall."""


def joint_at_horn(model: Stalling, parameters: SimParameters | None) -> SimParameters:
    """Return the plant of a servo whose horn drives the joint directly: `parameters` with the torque constant and the
    winding that follow from the model's stall point.

    parameters: None: the default joint, whose motor is far lighter than a real gearbox.
    """
    volts, amperes, torque = model.stall
    constant, resistance = torque / amperes, volts / amperes
    if parameters is None:
        return fitting_joint(torque, constant, resistance)
    motor = replace(parameters.motor, torque_constant=constant, winding_resistance=resistance)
    return replace(parameters, motor=motor)


@dataclass(frozen=True, slots=True)
class Goals:
    """The goals of the control loops, from the control table.

    current: A (in mode 5 the current limit). velocity: rad/s. position: rad, over any number of turns. duty: -1 to 1.
    """

    mode: int = POSITION
    current: float = 0.0
    velocity: float = 0.0
    position: float = 0.0
    duty: float = 0.0


class Regulator:
    """The control loops of a servo of `model`."""

    def __init__(self, model: Stalling) -> None:
        volts, amperes, torque = model.stall
        self.torque_constant = torque / amperes
        """N m/A."""
        self.goals = Goals()
        self._stall_torque = torque
        self._supply = volts
        self._resistance = volts / amperes
        self._integral = 0.0
        self._beat = -1
        """The last beat in which the integral grew: the demand may be asked for more often."""

    def current(self, motor: PlantMotor[Any]) -> float:
        """Return the current in the winding, A."""
        return motor.torque / self.torque_constant

    def duty(self, motor: PlantMotor[Any]) -> float:
        """Return the voltage at the motor divided by the supply voltage, -1 to 1."""
        volts = self.current(motor) * self._resistance + self.torque_constant * motor.rate
        return max(-1.0, min(1.0, volts / self._supply))

    def beats(self, enabled: bool) -> bool:
        """Return whether the control loops run, so that the torque must be computed again and again."""
        return enabled

    def at_rest(self, _motor: PlantMotor[Any]) -> Self:
        """Reset the integral of the loops; keep the goals."""
        self._integral = 0.0
        return self

    def demand(self, motor: PlantMotor[Any]) -> float:
        """Return the torque that is demanded until the next evaluation, N m."""
        goals, kt = self.goals, self.torque_constant
        if goals.mode == CURRENT:
            return limited(goals.current * kt, self._stall_torque)
        if goals.mode == PWM:
            # the back-EMF brakes; stronger than this it would overshoot within a beat on so light a motor
            braking = min(kt**2 / self._resistance, 0.5 * motor.inertia / BEAT)
            return kt * goals.duty * self._supply / self._resistance - braking * motor.rate
        ceiling = abs(goals.current) * kt if goals.mode == CURRENT_POSITION else self._stall_torque
        wanted, growth = self._speed_loop(motor) if goals.mode == SPEED else self._position_loop(motor)
        beat = math.floor(motor.time / BEAT + 1e-6)
        if abs(wanted) <= ceiling and beat != self._beat:
            self._integral += growth
        self._beat = beat
        return limited(wanted, ceiling)

    def _speed_loop(self, motor: PlantMotor[Any]) -> tuple[float, float]:
        """Return the torque that the speed loop demands, and the increment of its integral until the next evaluation, N
        m.
        """
        error, damping = self.goals.velocity - motor.velocity, motor.inertia * BANDWIDTH
        return damping * error + self._integral, damping * BANDWIDTH * error * BEAT

    def _position_loop(self, motor: PlantMotor[Any]) -> tuple[float, float]:
        error = self.goals.position - round(motor.position / COUNT) * COUNT
        stiffness, damping = motor.inertia * BANDWIDTH**2, 1.4 * motor.inertia * BANDWIDTH
        wanted = stiffness * error - damping * motor.velocity + self._integral
        return wanted, 0.5 * stiffness * BANDWIDTH * error * BEAT
