"""The way from the motor shaft to the joint and back: gear ratio, equation (1), zero and limits, in one place.

People speak of the joint and a servo speaks of the motor shaft. Everything that crosses between the two does so here:
the recorder's set-points and readings, the limits that a drive is given, the torque that is inferred from the motor,
and other people's tables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.servo import Command, Limits, Quantity
from hil.stand.file import LimitsTable, StandTable

Value = TypeVar("Value", float, NDArray[np.float64])


class Zero(NamedTuple):
    """The angles at rest, from which the deflection counts: motor and joint, rad."""

    motor: float
    joint: float = 0.0


@dataclass(frozen=True, slots=True)
class Transmission:
    """The gear between motor and joint, and the motor's own part of the torque.

    ratio: motor turns a joint turn. inertia: Dm, kg m^2. damping: Bm, N m s/rad, both at the motor shaft.
    """

    ratio: float
    inertia: float = 0.0
    damping: float = 0.0

    @classmethod
    def of(cls, stand: StandTable) -> Transmission:
        """Return the transmission that [stand] describes."""
        return cls(stand.gear_ratio, stand.motor_inertia, stand.motor_damping)

    def torque(self, motor_torque: Value) -> Value:
        """Return the motor's torque, N m, as the joint feels it: the left side of equation (1) times the ratio."""
        return self.ratio * motor_torque

    def motor_share(self, rate: Value, acceleration: Value) -> Value:
        """Return the part of `torque` that moves the motor itself: eta^2 (Dm acc + Bm rate), equation (1), N m.

        rate rad/s and acceleration rad/s^2 of the deflection, at the joint.
        """
        return self.ratio**2 * (self.inertia * acceleration + self.damping * rate)

    def deflection(self, motor: Value, joint: Value | float, zero: Zero) -> Value:
        """Return the deflection, rad, of motor and joint angles, rad."""
        return (motor - zero.motor) / self.ratio - (joint - zero.joint)

    def rate(self, motor_velocity: Value) -> Value:
        """Return the rate of the deflection, rad/s, where the joint is locked."""
        return motor_velocity / self.ratio

    def commands(self, mode: Quantity, zero: Zero) -> Callable[[float], Command]:
        """Return the conversion of a set-point at the joint, N m or rad, to the motor's command."""
        ratio, motor = self.ratio, zero.motor
        if mode is Quantity.TORQUE:
            return lambda set_point: Command(mode, set_point / ratio)
        return lambda set_point: Command(mode, motor + set_point * ratio)

    def motor_limits(self, limits: LimitsTable, zero: float) -> Limits:
        """Return the limits at the motor shaft, for a joint at rest at motor position `zero` rad."""
        reach = limits.deflection * self.ratio
        return Limits(
            torque=limits.torque / self.ratio,
            velocity=limits.velocity * self.ratio,
            temperature=limits.temperature,
            position=(zero - reach, zero + reach),
        )
