"""The sensors of the simulated servo: delay, resolution, noise, absence."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ga.compiled import compiled
from sim_backend.drive import FROZEN, Drive, look, run
from sim_backend.plant import Vector

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sim_backend.parameters import SimParameters

# One stream of random numbers a source, by number: what is added later takes the next, and no source moves another.
OUTBOUND, INBOUND, LOST, MOTOR_TORQUE, JOINT_TORQUE = range(5)
STREAMS = 5
_BLOCK = 64  # exchanges for which numbers are drawn at a time


class Noise:
    """One generator a source; each gives one number an exchange, used or not, so that a seed fixes them all.

    draws: for each exchange its numbers, in the order of the sources: standard normal; LOST: [0, 1).
    """

    def __init__(self, seed: int) -> None:
        if seed < 0:
            raise ValueError(f"seed {seed} is negative")
        self._streams = [np.random.default_rng([seed, stream]) for stream in range(STREAMS)]
        self.draws = self._draws()

    def _draws(self) -> Iterator[tuple[float, ...]]:
        while True:
            yield from zip(*map(self._block, range(STREAMS)), strict=True)

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


# The constants of the sensors, one number a place. The count of a sensor that the stand has not is NaN.
_POSITION, _VELOCITY, _TORQUE, _JOINT, _CELL, _TEMPERATURE, _VOLTAGE = range(7)
_TORQUE_NOISE, _CELL_NOISE, _CELL_OFFSET, _CELL_DRIFT = range(7, 11)


@compiled
def _counts(value: float, lsb: float) -> float:
    return float(np.floor(value / lsb + 0.5) * lsb)


@compiled
def _read(drive: Vector, at: float, c: Vector, motor_torque: float, joint_torque: float) -> Reading:
    """Carry a drive to `at` s; return every channel there."""
    run(drive, at)
    seen = look(drive)
    position, velocity = _counts(seen.motor_position, c[_POSITION]), _counts(seen.motor_velocity, c[_VELOCITY])
    frozen = drive[FROZEN]
    if not math.isnan(frozen):
        position, velocity = frozen, velocity * 0.0
    wrong = c[_CELL_OFFSET] + c[_CELL_DRIFT] * at + c[_CELL_NOISE] * joint_torque
    return Reading(
        position,
        velocity,
        _counts(seen.motor_torque + c[_TORQUE_NOISE] * motor_torque, c[_TORQUE]),
        _counts(seen.joint_position, c[_JOINT]),
        _counts(seen.joint_torque + wrong, c[_CELL]),
        _counts(seen.temperature, c[_TEMPERATURE]),
        c[_VOLTAGE],
    )


class Sensors:
    """The channels of one stand."""

    def __init__(self, parameters: SimParameters) -> None:
        sensors = parameters.sensors
        self.position_lsb = 2.0 * math.pi / sensors.motor_counts
        self.torque_lsb = sensors.current_lsb * parameters.motor.torque_constant
        self._constants = np.array(
            [
                self.position_lsb,
                sensors.velocity_lsb if sensors.reports_velocity else math.nan,
                self.torque_lsb,
                2.0 * math.pi / sensors.joint_counts if sensors.joint_encoder else math.nan,
                sensors.torque_cell_lsb if sensors.torque_cell else math.nan,
                sensors.temperature_lsb,
                parameters.drive.supply_voltage,
                sensors.motor_torque_noise,
                sensors.torque_cell_noise,
                sensors.torque_cell_offset,
                sensors.torque_cell_drift,
            ]
        )

    def read(self, drive: Drive, at: float, motor_torque: float, joint_torque: float) -> Reading:
        """Carry the drive to `at`, s, and return every channel at its own instant.

        The noise of the two torques is given, standard normal. Raises RuntimeError where one shows an instant further
        back than the plant remembers.
        """
        reading = _read(drive.numbers, at, self._constants, motor_torque, joint_torque)
        if reading[0] != reading[0]:
            raise RuntimeError(
                "a sensor shows an instant the plant no longer remembers: "
                "lower the sensors' delays or fixture.stiffness"
            )
        return reading
