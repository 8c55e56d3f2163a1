"""The demand law of an emulated servo in its operating modes, and the joint at its horn.

The loops are not the vendors', whose gains are in units of their own: the current goal is the current, and position and
velocity are closed with gains from the inertia, at the bandwidth below. In PWM mode the stall torque is right, kt V/R,
and the speed without load is not, since the inertia is not a real gearbox's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from sim_backend.parameters import CouplingParameters, LinkParameters, MotorParameters, SimParameters
from sim_backend.wire.plant_motor import BEAT, PlantMotor

CURRENT, SPEED, POSITION, EXTENDED, CURRENT_POSITION, PWM = 0, 1, 3, 4, 5, 16
"""The modes, by DYNAMIXEL's values of Operating Mode(11)."""
COUNT = 2.0 * math.pi / 4096.0
"""rad a count of position."""
BANDWIDTH = 2.0 * math.pi * 10.0
"""rad/s of the position loop."""


class Stalling(Protocol):
    """A model of a servo. stall: V, A, N m at stall."""

    @property
    def stall(self) -> tuple[float, float, float]:
        """The stall point."""


def joint_at_horn(model: Stalling, coupling: CouplingParameters | None = None) -> SimParameters:
    """Return the plant of a servo that drives the joint directly: eta is 1, and motor and gearbox are the servo's own.

    coupling: the cable, the paper's joint where None. The inertia at the horn is the default motor's at its joint, so
    that the resonance is the same; it is far below that of a real gearbox.
    """
    volts, amperes, torque = model.stall
    motor = MotorParameters(
        gear_ratio=1.0,
        inertia=3.2e-6,
        viscous_friction=1.6e-6,
        torque_constant=torque / amperes,
        winding_resistance=volts / amperes,
    )
    return SimParameters(
        motor=motor, coupling=coupling or CouplingParameters(), link=LinkParameters(lost_reply=0.0, jitter=0.0)
    )


@dataclass(frozen=True, slots=True)
class Goals:
    """The goals that the control table sets.

    current A (the ceiling in mode 5), velocity rad/s, position rad over any number of turns, duty -1 to 1.
    """

    mode: int = POSITION
    current: float = 0.0
    velocity: float = 0.0
    position: float = 0.0
    duty: float = 0.0


class Regulator:
    """The loops of one servo of `model`."""

    def __init__(self, model: Stalling) -> None:
        volts, amperes, torque = model.stall
        self.torque_constant = torque / amperes
        """N m/A."""
        self.goals = Goals()
        self._stall_torque = torque
        self._supply = volts
        self._resistance = volts / amperes
        self._integral = 0.0

    def current(self, motor: PlantMotor[Any]) -> float:
        """Return the current in the winding, A."""
        return motor.torque / self.torque_constant

    def duty(self, motor: PlantMotor[Any]) -> float:
        """Return the share of the supply voltage that is across the motor, -1 to 1."""
        volts = self.current(motor) * self._resistance + self.torque_constant * motor.rate
        return max(-1.0, min(1.0, volts / self._supply))

    def beats(self, enabled: bool) -> bool:
        """Return whether the loops run."""
        return enabled

    def at_rest(self, _motor: PlantMotor[Any]) -> Self:
        """Empty the integral; the goals stay."""
        self._integral = 0.0
        return self

    def demand(self, motor: PlantMotor[Any]) -> float:
        """Return the torque demanded in this beat, N m."""
        goals, kt = self.goals, self.torque_constant
        if goals.mode == CURRENT:
            return float(np.clip(goals.current * kt, -self._stall_torque, self._stall_torque))
        if goals.mode == PWM:
            # the back-EMF brakes; stronger than this it would overshoot within a beat on so light a motor
            braking = min(kt**2 / self._resistance, 0.5 * motor.inertia / BEAT)
            return kt * goals.duty * self._supply / self._resistance - braking * motor.rate
        ceiling = abs(goals.current) * kt if goals.mode == CURRENT_POSITION else self._stall_torque
        wanted, growth = self._speed_loop(motor) if goals.mode == SPEED else self._position_loop(motor)
        if abs(wanted) <= ceiling:
            self._integral += growth
        return max(-ceiling, min(ceiling, wanted))

    def _speed_loop(self, motor: PlantMotor[Any]) -> tuple[float, float]:
        """Return the torque wanted, and by how much the integral grows in a beat, N m."""
        error, damping = self.goals.velocity - motor.velocity, motor.inertia * BANDWIDTH
        return damping * error + self._integral, damping * BANDWIDTH * error * BEAT

    def _position_loop(self, motor: PlantMotor[Any]) -> tuple[float, float]:
        error = self.goals.position - round(motor.position / COUNT) * COUNT
        stiffness, damping = motor.inertia * BANDWIDTH**2, 1.4 * motor.inertia * BANDWIDTH
        wanted = stiffness * error - damping * motor.velocity + self._integral
        return wanted, 0.5 * stiffness * BANDWIDTH * error * BEAT
