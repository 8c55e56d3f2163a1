"""The conversion between motor shaft and joint: gear ratio, equation (1), zero and limits, in one module.

People state values at the joint; a servo uses values at the motor shaft. Every conversion between the two is here: of
the recorder's set-points and readings, of the limits for a drive, of the torque that is computed from the motor's
torque, and of imported tables.
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
    """The angles of motor and joint at rest, rad; the deflection is measured from these angles."""

    motor: float
    joint: float = 0.0


@dataclass(frozen=True, slots=True)
class Transmission:
    """The gear between motor and joint, with inertia and damping of the motor.

    ratio: motor turns for one joint turn. inertia: Dm, kg m^2, at the motor shaft. damping: Bm, N m s/rad, at the motor
    shaft.
    """

    ratio: float
    inertia: float = 0.0
    damping: float = 0.0

    @classmethod
    def of(cls, stand: StandTable) -> Transmission:
        """Return the transmission that the table [stand] describes."""
        return cls(stand.gear_ratio, stand.motor_inertia, stand.motor_damping)

    def torque(self, motor_torque: Value) -> Value:
        """Return the motor's torque converted to the joint, N m: the left side of equation (1) times the ratio."""
        return self.ratio * motor_torque

    def motor_share(self, rate: Value, acceleration: Value) -> Value:
        """Return the torque at the joint, N m, that accelerates and damps the motor itself: eta^2 (Dm acc + Bm rate),
        equation (1).

        rate: of the deflection at the joint, rad/s. acceleration: of the deflection at the joint, rad/s^2.
        """
        return self.ratio**2 * (self.inertia * acceleration + self.damping * rate)

    def deflection(self, motor: Value, joint: Value | float, zero: Zero) -> Value:
        """Return the deflection, rad, for the angles of motor and joint, rad. zero: these angles at rest."""
        return (motor - zero.motor) / self.ratio - (joint - zero.joint)

    def rate(self, motor_velocity: Value) -> Value:
        """Return the rate of the deflection of a locked joint, rad/s, for the velocity of the motor, rad/s."""
        return motor_velocity / self.ratio

    def commands(self, mode: Quantity, zero: Zero) -> Callable[[float], Command]:
        """Return the function that converts a set-point at the joint, N m or rad, to a command for the motor. zero:
        angles at rest.
        """
        ratio, motor = self.ratio, zero.motor
        if mode is Quantity.TORQUE:
            return lambda set_point: Command(mode, set_point / ratio)
        return lambda set_point: Command(mode, motor + set_point * ratio)

    def motor_limits(self, limits: LimitsTable, zero: float) -> Limits:
        """Return the limits converted to the motor shaft. zero: the motor's angle at rest, rad."""
        reach = limits.deflection * self.ratio
        return Limits(
            torque=limits.torque / self.ratio,
            velocity=limits.velocity * self.ratio,
            temperature=limits.temperature,
            position=(zero - reach, zero + reach),
        )
