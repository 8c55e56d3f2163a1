"""The sensors of the simulated servo, with delay, resolution and noise; a sensor may be absent."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from drivers.servo import DriverError
from ga.compiled import compiled_no_refcount
from sim_backend.drive import Drive
from sim_backend.integrator import CLOCK, REMEMBERED, TIME, TRIAL, Path, recall
from sim_backend.plant import CELL, JOINT, MOTOR, TORQUE, VELOCITY, WINDING, Vector

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sim_backend.parameters import SimParameters

# One stream of random numbers a source, by number: what is added later takes the next, and no source moves another.
OUTBOUND, INBOUND, LOST, MOTOR_TORQUE, JOINT_TORQUE = range(5)
STREAMS = 5
_BLOCK = 64  # exchanges for which numbers are drawn at a time


class Noise:
    """The random numbers of the simulated servo, from one random generator for each source.

    Each source draws one number for each exchange, whether it is used or not. So one source does not change the numbers
    of another, and a seed fixes all numbers. draws: an iterator over the numbers of each exchange, in the order of the
    sources. They are standard normal; LOST is uniform in [0, 1).
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
        """Return the next random numbers of the source `number`, in the order in which they would be drawn one by one.

        Drawing many numbers in one call takes a twentieth of the time.
        """
        stream = self._streams[number]
        return list((stream.random if number == LOST else stream.standard_normal)(_BLOCK).tolist())


class Reading(NamedTuple):
    """The measurements in a reply: those of `Sample` without times and status, in the same units."""

    motor_position: float
    motor_velocity: float
    motor_torque: float
    joint_position: float
    joint_torque: float
    temperature: float
    voltage: float


def counted(value: float, lsb: float) -> float:
    """Return `value` rounded to whole counts. lsb: value of one count."""
    return math.floor(value / lsb + 0.5) * lsb


# The constants of the sensors, one number a place: the count of each reading, NaN of a sensor that the stand lacks;
# the supply's voltage; noise and errors; from _AGES on the delays of motor position, motor torque, joint position and
# joint torque, s.
_POSITION, _VELOCITY, _TORQUE, _JOINT, _CELL, _TEMPERATURE, _VOLTAGE = range(7)
_TORQUE_NOISE, _CELL_NOISE, _CELL_OFFSET, _CELL_DRIFT, _AGES = range(7, 12)


@compiled_no_refcount
def read_channels(  # noqa: PLR0917 - compiled functions take their parts by position
    path: Path, c: Vector, at: float, motor_torque: float, joint_torque: float, reading: Vector
) -> None:
    """Write the measurements of every sensor at `at`, s, into `reading`, (7,).

    The motor position is NaN if a sensor's delay is longer than the stored past. path: of the drive. c:
    constants of the sensors. motor_torque, joint_torque: noise of the two torques, standard normal.
    """
    state, known = path[TRIAL], True
    for sensor in range(4):
        known &= recall(path, path[CLOCK, TIME] - c[_AGES + sensor], state)
        if sensor == 0:
            reading[_POSITION], reading[_VELOCITY] = state[MOTOR], state[VELOCITY]
            reading[_TEMPERATURE] = state[WINDING]
        elif sensor == 1:
            reading[_TORQUE] = state[TORQUE] + c[_TORQUE_NOISE] * motor_torque
        elif sensor == 2:
            reading[_JOINT] = state[JOINT]
        else:
            wrong = c[_CELL_OFFSET] + c[_CELL_DRIFT] * at + c[_CELL_NOISE] * joint_torque
            reading[_CELL] = state[CELL] + wrong
    for channel in range(_VOLTAGE):
        reading[channel] = np.floor(reading[channel] / c[channel] + 0.5) * c[channel]
    reading[_VOLTAGE] = c[_VOLTAGE]
    if not known:
        reading[_POSITION] = math.nan


class Sensors:
    """The sensors of one simulated stand."""

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
                sensors.motor_position_delay,
                sensors.motor_torque_delay,
                sensors.joint_position_delay,
                sensors.joint_torque_delay,
            ]
        )
        self._reading = np.empty(len(Reading._fields))

    def read(self, drive: Drive, at: float, motor_torque: float, joint_torque: float) -> Reading:
        """Simulate the drive up to `at`, s, and return the measurement of every sensor, each with its own delay.

        motor_torque, joint_torque: noise of the two torques, standard normal. Raises DriverError if the plant cannot
        be integrated, or a sensor's delay is longer than its stored past.
        """
        drive.run(at)
        read_channels(drive.path, self._constants, at, motor_torque, joint_torque, self._reading)
        reading = Reading(*self._reading.tolist())
        if math.isnan(reading.motor_position):
            raise DriverError(
                "the simulated stand cannot be computed: a part is too fast for the integrator, or a sensor's delay is "
                f"longer than its last {REMEMBERED} steps; in [sim], lower stiffness, damping and delays, or raise the "
                "inertias"
            )
        return reading
