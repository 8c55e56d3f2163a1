"""Readings of a stand for a calibration: the torque cell under a load, and the motor at rest with its torque off."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock, MonotonicClock
from drivers.servo import BadReply, Command, NoReply, Servo
from hil.errors import Untrustworthy, WrongUse
from hil.stand.devices import open_sensor
from hil.stand.file import Stand
from hil.stand.opening import open_servo

_SETTLING, _READING, _STEP = 1.0, 2.0, 10.0  # s
_POLL = 5e-3  # s
_MOVED = 3.0  # counts that a motor at rest may move


class TorqueCell(Protocol):
    """The interface of a torque cell that gives each reading, in counts or as printed, with the tare subtracted."""

    tare: float

    def readings(self) -> list[tuple[float, float]]:
        """Return the time, s, and the value of each reading since the last call."""
        ...

    def close(self) -> None:
        """Close the connection to the cell."""
        ...


class Steady(NamedTuple):
    """The mean and standard deviation of a constant signal, in the signal's unit, and the number of readings."""

    mean: float
    std: float
    readings: int


def cell_table(stand: Stand) -> tuple[str, Any]:
    """Return the kind and the table of the stand's torque cell. Raises WrongUse if the stand has none."""
    if stand.sensor is None:
        raise WrongUse(
            "the stand file has no torque cell: add [joint_sensor] with kind, port and scale (any positive number; the "
            "calibration replaces it)"
        )
    return stand.sensor


@contextlib.contextmanager
def opened_cell(stand: Stand, clock: Clock | None = None) -> Iterator[TorqueCell]:
    """Yield the stand's torque cell, tared. Its readings are in counts or as printed, not in N m.

    clock: gives the times of the readings; None: a monotonic clock. Raises WrongUse if the stand has no torque cell,
    DriverError if it cannot be opened.
    """
    kind, table = cell_table(stand)
    bare: Any = dataclasses.replace(table, scale=1.0, sign=1, tare=None, delay=0.0, drift=table.drift / table.scale)
    cell = cast("TorqueCell", open_sensor(kind, bare, clock or MonotonicClock()))
    with contextlib.closing(cell):
        yield cell


def steady(cell: TorqueCell, clock: Clock) -> Steady:
    """Return the cell's reading under a load that hangs still: wait one second for the load to settle, then read for
    two seconds.

    Raises Untrustworthy if there are too few readings, LinkLost if the connection to the cell is lost.
    """
    _readings(cell, clock, _SETTLING)
    values = _readings(cell, clock, _READING)[:, 1]
    return Steady(float(values.mean()), float(values.std(ddof=1)), len(values))


def released(cell: TorqueCell, clock: Clock) -> NDArray[np.float64]:
    """Return the time, s, and the value of each reading, (n, 2), of ten seconds in which a load is taken off. Raises
    LinkLost.
    """
    return _readings(cell, clock, _STEP)


def _readings(cell: TorqueCell, clock: Clock, seconds: float) -> NDArray[np.float64]:
    rows: list[tuple[float, float]] = []
    trouble: Exception | None = None
    end = clock.now() + seconds
    while clock.now() < end:
        clock.sleep_until(min(end, clock.now() + _POLL))
        try:
            rows += cell.readings()
        except (BadReply, NoReply) as error:
            trouble = error
    if len(rows) < 2:
        reason = trouble or "nothing arrives: check the cell's plug and its program"
        raise Untrustworthy(f"{len(rows)} readings in {seconds:g} s are too few ({reason})")
    return np.array(rows, dtype=np.float64)


def motor_at_rest(stand: Stand) -> tuple[Steady, float]:
    """Return the motor's angle, rad, read from the drive with its torque off, and the size of one encoder count, rad
    (NaN if unknown).

    Raises DriverError, and Untrustworthy if the motor moves or its angle cannot be read.
    """
    plain = dataclasses.replace(stand, stand=stand.stand.model_copy(update={"zero": 0.0}), sensor=None)
    servo, _ = open_servo(plain)
    try:
        servo.disarm()
        angles = np.array(list(_angles(servo)))
        count = servo.info.position_lsb
    finally:
        servo.close()
    if len(angles) < 2:
        raise Untrustworthy("the drive gives no position while it is at rest: check the drive with hil doctor")
    moved = float(np.ptp(angles))
    if moved > _MOVED * (count if math.isfinite(count) else 1e-3):
        raise Untrustworthy(
            f"the motor moved by {moved:.3g} rad while its zero was read: leave the joint without load, and wait until "
            "it is still"
        )
    return Steady(float(angles.mean()), float(angles.std(ddof=1)), len(angles)), count


def _angles(servo: Servo) -> Iterator[float]:
    clock = servo.clock
    end = clock.now() + _READING
    while clock.now() < end:
        clock.sleep_until(clock.now() + 4.0 * _POLL)
        with contextlib.suppress(BadReply, NoReply):
            position = servo.exchange(Command.rest()).motor_position
            if math.isfinite(position):
                yield position
