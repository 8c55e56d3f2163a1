"""The drive's firmware: sampled, with its own loop, its own limits and its own faults.

It runs at `drive.loop_rate`. On each beat it takes the set-point over, closes the position loop on the encoder's
counts, and turns the torque off by itself where velocity or temperature is too high or no set-point arrives any more.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING, cast

import numpy as np

from drivers.servo import Command, Limits, Quantity
from ga.compiled import compiled_no_refcount, compiled_within
from sim_backend.integrator import CLOCK, STATE, TIME, Path, integrate, start
from sim_backend.plant import MOTOR, TORQUE, VELOCITY, WINDING, Packed, Vector, constants, coupling_torque, packed

if TYPE_CHECKING:
    from sim_backend.parameters import SimParameters


class FaultCode(IntEnum):
    """The faults the drive latches by itself."""

    OVER_VELOCITY = 1
    OVER_TEMPERATURE = 2
    WATCHDOG = 3


REMEDY = {
    FaultCode.OVER_VELOCITY: "the motor turned faster than its limit: lower the amplitude or look for a loose cable",
    FaultCode.OVER_TEMPERATURE: "the winding is hotter than its limit: let it cool, then lower the torque",
    FaultCode.WATCHDOG: "no set-point came in time, so the drive turned its torque off: look for what held the host up",
}

# The drive's memory, one number a place.
(
    ENABLED,
    POSITION_MODE,
    SETPOINT,
    DEMAND,
    INTEGRAL,
    FED,
    FAULT,
    SATURATED,
    FROZEN,  # rad: the angle that a frozen encoder repeats; NaN while it works
    MAX_TORQUE,
    MAX_VELOCITY,
    MAX_TEMPERATURE,
    NEXT_AT,  # s from which the set-point that has arrived last may be taken over; infinite where it has been
    NEXT_POSITION,
    NEXT_VALUE,
    # constants of the firmware: s, s, rad, then as in `DriveParameters`
    PERIOD,
    WATCHDOG,
    LSB,
    GAIN,
    INTEGRAL_GAIN,
    DAMPING_GAIN,
    PLACES,
) = range(22)


@compiled_no_refcount
def run(memory: Vector, path: Path, constants: Packed, until: float) -> int:
    """Carry plant and firmware to `until`, s, or to a beat that finds a fault; return its code, 0 for none.

    memory: the firmware's, (PLACES,).
    """
    while True:
        end, beat = until, math.inf
        if memory[ENABLED] != 0.0:
            # The millionth of a period keeps a beat that has just been struck from being struck again.
            beat = (math.floor(path[CLOCK, TIME] / memory[PERIOD] + 1e-6) + 1.0) * memory[PERIOD]
            end = until if beat > until else beat
        integrate(path, memory[DEMAND], end, constants)
        if beat > until:
            return 0
        fault = _beat(path, memory, beat)
        if fault != 0:
            return fault


@compiled_within
def _beat(path: Path, memory: Vector, now: float) -> int:
    """Take the set-point over that has arrived, look for faults, then regulate; return the code of a fault or 0."""
    if memory[NEXT_AT] < now:
        if memory[NEXT_POSITION] != 0.0 and memory[POSITION_MODE] == 0.0:
            memory[INTEGRAL] = 0.0
        memory[POSITION_MODE] = memory[NEXT_POSITION]
        memory[SETPOINT] = memory[NEXT_VALUE]
        memory[NEXT_AT] = math.inf
    velocity = path[STATE, VELOCITY] if math.isnan(memory[FROZEN]) else 0.0
    if abs(velocity) > memory[MAX_VELOCITY]:
        return 1
    if path[STATE, WINDING] > memory[MAX_TEMPERATURE]:
        return 2
    if now - memory[FED] > memory[WATCHDOG]:
        return 3
    _regulate(path, memory)
    return 0


@compiled_within
def _regulate(path: Path, memory: Vector) -> None:
    """Set the torque demand, N m, for the beat that begins now."""
    ceiling = memory[MAX_TORQUE]
    wanted = memory[SETPOINT]
    if memory[POSITION_MODE] != 0.0:
        position = math.floor(path[STATE, MOTOR] / memory[LSB] + 0.5) * memory[LSB]
        velocity = path[STATE, VELOCITY]
        if not math.isnan(memory[FROZEN]):
            position, velocity = memory[FROZEN], 0.0
        error = memory[SETPOINT] - position
        wanted = memory[GAIN] * error - memory[DAMPING_GAIN] * velocity + memory[INTEGRAL]
        if abs(wanted) <= ceiling:  # an integral that goes on while the torque cannot would wind up
            memory[INTEGRAL] += memory[INTEGRAL_GAIN] * error * memory[PERIOD]
    if abs(wanted) > ceiling:
        memory[SATURATED] = 1.0
    memory[DEMAND] = ceiling if wanted > ceiling else -ceiling if wanted < -ceiling else wanted


def _numbers(array: Vector) -> memoryview[float]:
    """Return the numbers of an array, of which one is read in a third of the array's time."""
    return cast("memoryview[float]", array.data)


class Drive:
    """A drive on the plant, commanded without a link. Times are in s since it was switched on.

    watchdog: s of silence after which it turns its torque off. memory: the firmware's numbers, (PLACES,).
    """

    def __init__(self, parameters: SimParameters, *, watchdog: float) -> None:
        drive = parameters.drive
        self.constants = constants(parameters)
        self.path = start(self.constants)
        self.memory = np.zeros(PLACES)
        self._packed = packed(self.constants)
        self._memory, self._clock = _numbers(self.memory), _numbers(self.path[CLOCK])
        self._memory[FROZEN] = math.nan
        self._memory[NEXT_AT] = math.inf
        self._memory[PERIOD] = 1.0 / drive.loop_rate
        self._memory[WATCHDOG] = watchdog
        self._memory[LSB] = 2.0 * math.pi / parameters.sensors.motor_counts
        self._memory[GAIN] = drive.position_gain
        self._memory[INTEGRAL_GAIN] = drive.position_integral_gain
        self._memory[DAMPING_GAIN] = drive.position_damping_gain
        self._ceiling = drive.torque_limit

    @property
    def time(self) -> float:
        """The time that plant and firmware have been carried to, s."""
        return self._clock[TIME]

    @property
    def enabled(self) -> bool:
        """Whether current can flow."""
        return self._memory[ENABLED] != 0.0

    @property
    def fault(self) -> int:
        """The latched fault, 0 where there is none."""
        return int(self._memory[FAULT])

    @property
    def demand(self) -> float:
        """The motor torque the current loop is asked for now, N m."""
        return self._memory[DEMAND]

    @property
    def coupling_torque(self) -> float:
        """sigma_c now, N m."""
        return float(coupling_torque(self.path[STATE], self._packed))

    def run(self, until: float) -> None:
        """Carry plant and firmware to `until`; nothing happens where that is past."""
        while fault := run(self.memory, self.path, self._packed, until):
            self._trip(fault)

    def enable(self, limits: Limits) -> None:
        """Set the limits and let current flow, at zero torque; the watchdog starts now."""
        memory = self._memory
        self._trip(0)
        memory[MAX_TORQUE] = min(limits.torque, self._ceiling)
        memory[MAX_VELOCITY] = limits.velocity
        memory[MAX_TEMPERATURE] = limits.temperature
        memory[SATURATED] = 0.0
        memory[FED] = self.time
        memory[ENABLED] = 1.0

    def _trip(self, code: int) -> None:
        """Open the output stage, so that no current flows, and latch `code` (0: none)."""
        memory = self._memory
        for place in (ENABLED, DEMAND, SETPOINT, POSITION_MODE, INTEGRAL):
            memory[place] = 0.0
        memory[NEXT_AT] = math.inf
        self.path[STATE, TORQUE] = 0.0
        memory[FAULT] = memory[FAULT] or code

    def disable(self) -> None:
        """No current from now on."""
        self._trip(0)

    def latch(self, code: int) -> None:
        """Latch a fault from outside and open the output stage."""
        self._trip(code)

    def feed(self) -> None:
        """Tell the watchdog that the host is alive."""
        self._memory[FED] = self._clock[TIME]

    def follow(self, command: Command, at: float) -> None:
        """Take a set-point over at the first beat after `at`; it has no effect while disabled."""
        memory = self._memory
        if memory[NEXT_AT] != math.inf:
            self.run(at)  # the one before is taken over in time
        if memory[ENABLED] != 0.0:
            memory[NEXT_POSITION] = 1.0 if command.quantity is Quantity.POSITION else 0.0
            memory[NEXT_VALUE] = command.value
            memory[NEXT_AT] = at

    def take_saturated(self) -> bool:
        """Whether the torque limit has acted since this was last asked."""
        acted = self._memory[SATURATED] != 0.0
        self._memory[SATURATED] = 0.0
        return acted

    def freeze_encoder(self) -> None:
        """From now on the motor encoder repeats its count."""
        memory = self._memory
        memory[FROZEN] = math.floor(self.path[STATE, MOTOR] / memory[LSB] + 0.5) * memory[LSB]

    @property
    def frozen(self) -> float:
        """The angle that a frozen motor encoder repeats, rad; NaN while it works."""
        return self._memory[FROZEN]
