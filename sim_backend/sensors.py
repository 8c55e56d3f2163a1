"""The sensors of the simulated servo: delay, resolution, noise, absence."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sim_backend.drive import Drive
    from sim_backend.parameters import SimParameters

# One stream of random numbers a source, by number: what is added later takes the next, and no source moves another.
OUTBOUND, INBOUND, LOST, MOTOR_TORQUE, JOINT_TORQUE = range(5)
STREAMS = 5
_BLOCK = 64  # exchanges for which numbers are drawn at a time


class Draw(NamedTuple):
    """The random part of one exchange. outbound, inbound, motor_torque, joint_torque: standard normal; lost: [0, 1)."""

    outbound: float
    inbound: float
    lost: float
    motor_torque: float
    joint_torque: float


class Noise:
    """One generator a source; each gives one number an exchange, used or not, so that a seed fixes them all."""

    def __init__(self, seed: int) -> None:
        if seed < 0:
            raise ValueError(f"seed {seed} is negative")
        self._streams = [np.random.default_rng([seed, stream]) for stream in range(STREAMS)]
        self._ahead: Iterator[Draw] = iter(())

    def draw(self) -> Draw:
        """The numbers of the next exchange."""
        for numbers in self._ahead:
            return numbers
        self._ahead = map(Draw._make, zip(*map(self._block, range(STREAMS)), strict=True))
        return next(self._ahead)

    def _block(self, number: int) -> list[float]:
        """Return the next numbers of a stream: the same as if each were drawn alone, in a twentieth of the time."""
        stream = self._streams[number]
        return list((stream.random if number == LOST else stream.standard_normal)(_BLOCK).tolist())


class Reading(NamedTuple):
    """The readings in a reply: `Sample` without its times and status, in the same units."""

    motor_position: float
    motor_velocity: float
    motor_torque: float
    joint_position: float
    joint_torque: float
    temperature: float
    voltage: float


def counted(value: float, lsb: float) -> float:
    """`value` to the nearest whole count."""
    return math.floor(value / lsb + 0.5) * lsb


class Sensors:
    """The channels of one stand."""

    def __init__(self, parameters: SimParameters) -> None:
        self._sensors = parameters.sensors
        self._voltage = parameters.drive.supply_voltage
        self.position_lsb = 2.0 * math.pi / parameters.sensors.motor_counts
        self.torque_lsb = parameters.sensors.current_lsb * parameters.motor.torque_constant
        self._joint_lsb = 2.0 * math.pi / parameters.sensors.joint_counts

    def read(self, drive: Drive, draw: Draw) -> Reading:
        """Every channel at its own instant."""
        seen, sensors = drive.look(), self._sensors
        position, velocity = counted(seen.motor_position, self.position_lsb), math.nan
        if sensors.reports_velocity:
            velocity = counted(seen.motor_velocity, sensors.velocity_lsb)
        frozen = drive.frozen
        if not math.isnan(frozen):
            position, velocity = frozen, velocity * 0.0
        joint_position = joint_torque = math.nan
        if sensors.joint_encoder:
            joint_position = counted(seen.joint_position, self._joint_lsb)
        if sensors.torque_cell:
            wrong = sensors.torque_cell_offset + sensors.torque_cell_drift * drive.time
            wrong += sensors.torque_cell_noise * draw.joint_torque
            joint_torque = counted(seen.joint_torque + wrong, sensors.torque_cell_lsb)
        torque = seen.motor_torque + sensors.motor_torque_noise * draw.motor_torque
        return Reading(
            position,
            velocity,
            counted(torque, self.torque_lsb),
            joint_position,
            joint_torque,
            counted(seen.temperature, sensors.temperature_lsb),
            self._voltage,
        )
