"""The sensors of the simulated servo: delay, resolution, noise, absence."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from sim_backend.drive import Drive
    from sim_backend.parameters import SimParameters

# One stream of random numbers a source, by number: what is added later takes the next, and no source moves another.
OUTBOUND, INBOUND, LOST, MOTOR_TORQUE, JOINT_TORQUE = range(5)
STREAMS = 5


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
        streams = [np.random.default_rng([seed, stream]) for stream in range(STREAMS)]
        self._outbound = streams[OUTBOUND].standard_normal
        self._inbound = streams[INBOUND].standard_normal
        self._lost = streams[LOST].random
        self._motor_torque = streams[MOTOR_TORQUE].standard_normal
        self._joint_torque = streams[JOINT_TORQUE].standard_normal

    def draw(self) -> Draw:
        """The numbers of the next exchange."""
        return Draw(self._outbound(), self._inbound(), self._lost(), self._motor_torque(), self._joint_torque())


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
        if not math.isnan(drive.frozen):
            position, velocity = drive.frozen, velocity * 0.0
        joint_position = joint_torque = math.nan
        if sensors.joint_encoder:
            joint_position = counted(seen.joint_position, self._joint_lsb)
        if sensors.torque_cell:
            wrong = sensors.torque_cell_offset + sensors.torque_cell_drift * drive.time
            wrong += sensors.torque_cell_noise * draw.joint_torque
            joint_torque = counted(seen.joint_torque + wrong, sensors.torque_cell_lsb)
        torque = seen.motor_torque + sensors.motor_torque_noise * draw.motor_torque
        return Reading(
            motor_position=position,
            motor_velocity=velocity,
            motor_torque=counted(torque, self.torque_lsb),
            joint_position=joint_position,
            joint_torque=joint_torque,
            temperature=counted(seen.temperature, sensors.temperature_lsb),
            voltage=self._voltage,
        )
