"""The firmware of the simulated drive: a control loop at a fixed rate, its limits and its faults.

The firmware runs at `drive.loop_rate`. In each period it accepts a new set-point, closes the position loop on the
encoder's counts, and turns the torque off by itself if the velocity or the temperature is too high or no set-point
arrives any more.
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
    """The faults that the simulated drive latches by itself."""

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
) = range(21)


@compiled_no_refcount
def run(memory: Vector, path: Path, constants: Packed, until: float) -> int:
    """Simulate plant and firmware up to `until`, s, or up to the first fault. Return the code of the fault, 0 for none.

    memory (PLACES,): the firmware's variables. path: the present state of the plant and its recorded history. Both
    arrays are updated. constants: constants of the plant.
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
    """Run the firmware once: accept the set-point that has arrived, check for faults, then set the torque. Return the
    code of a fault or 0.
    """
    if memory[NEXT_AT] < now:
        if memory[NEXT_POSITION] != 0.0 and memory[POSITION_MODE] == 0.0:
            memory[INTEGRAL] = 0.0
        memory[POSITION_MODE] = memory[NEXT_POSITION]
        memory[SETPOINT] = memory[NEXT_VALUE]
        memory[NEXT_AT] = math.inf
    if abs(path[STATE, VELOCITY]) > memory[MAX_VELOCITY]:
        return 1
    if path[STATE, WINDING] > memory[MAX_TEMPERATURE]:
        return 2
    if now - memory[FED] > memory[WATCHDOG]:
        return 3
    _regulate(path, memory)
    return 0


@compiled_within
def _regulate(path: Path, memory: Vector) -> None:
    """Set the torque demand, N m, until the next run of the firmware."""
    ceiling = memory[MAX_TORQUE]
    wanted = memory[SETPOINT]
    if memory[POSITION_MODE] != 0.0:
        position = math.floor(path[STATE, MOTOR] / memory[LSB] + 0.5) * memory[LSB]
        error = memory[SETPOINT] - position
        wanted = memory[GAIN] * error - memory[DAMPING_GAIN] * path[STATE, VELOCITY] + memory[INTEGRAL]
        if abs(wanted) <= ceiling:  # an integral that goes on while the torque cannot would wind up
            memory[INTEGRAL] += memory[INTEGRAL_GAIN] * error * memory[PERIOD]
    if abs(wanted) > ceiling:
        memory[SATURATED] = 1.0
    memory[DEMAND] = ceiling if wanted > ceiling else -ceiling if wanted < -ceiling else wanted


def _numbers(array: Vector) -> memoryview[float]:
    """Return a view of an array; reading one number from the view takes a third of the time."""
    return cast("memoryview[float]", array.data)


class Drive:
    """The simulated drive with the plant, commanded without a link. Times are s since the drive was switched on.

    watchdog: s without a set-point after which the drive turns its torque off. memory: the firmware's variables,
    (PLACES,).
    """

    def __init__(self, parameters: SimParameters, *, watchdog: float) -> None:
        drive = parameters.drive
        self.constants = constants(parameters)
        self.path = start(self.constants)
        self.memory = np.zeros(PLACES)
        self._packed = packed(self.constants)
        self._memory, self._clock = _numbers(self.memory), _numbers(self.path[CLOCK])
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
        """The time up to which plant and firmware are simulated, s."""
        return self._clock[TIME]

    @property
    def enabled(self) -> bool:
        """Return whether current can flow."""
        return self._memory[ENABLED] != 0.0

    @property
    def fault(self) -> int:
        """The code of the latched fault, 0 if there is none."""
        return int(self._memory[FAULT])

    @property
    def demand(self) -> float:
        """The motor torque that is demanded of the current loop now, N m."""
        return self._memory[DEMAND]

    @property
    def coupling_torque(self) -> float:
        """The torque in the coupling now, sigma_c, N m."""
        return float(coupling_torque(self.path[STATE], self._packed))

    def run(self, until: float) -> None:
        """Simulate plant and firmware up to `until`, s. Has no effect if this time has passed."""
        while fault := run(self.memory, self.path, self._packed, until):
            self._trip(fault)

    def enable(self, limits: Limits) -> None:
        """Set the limits and switch the output stage on at zero torque. The watchdog starts now."""
        memory = self._memory
        self._trip(0)
        memory[MAX_TORQUE] = min(limits.torque, self._ceiling)
        memory[MAX_VELOCITY] = limits.velocity
        memory[MAX_TEMPERATURE] = limits.temperature
        memory[SATURATED] = 0.0
        memory[FED] = self.time
        memory[ENABLED] = 1.0

    def _trip(self, code: int) -> None:
        """Switch the output stage off, so that no current flows, and latch the fault `code` (0: no fault)."""
        memory = self._memory
        for place in (ENABLED, DEMAND, SETPOINT, POSITION_MODE, INTEGRAL):
            memory[place] = 0.0
        memory[NEXT_AT] = math.inf
        self.path[STATE, TORQUE] = 0.0
        memory[FAULT] = memory[FAULT] or code

    def disable(self) -> None:
        """Switch the output stage off, so that no current flows."""
        self._trip(0)

    def feed(self) -> None:
        """Reset the watchdog: the host is alive."""
        self._memory[FED] = self._clock[TIME]

    def follow(self, command: Command, at: float) -> None:
        """Make the firmware accept the set-point `command` in its first period after `at`, s. Has no effect while the
        drive is disabled.
        """
        memory = self._memory
        if memory[NEXT_AT] != math.inf:
            self.run(at)  # the one before is taken over in time
        if memory[ENABLED] != 0.0:
            memory[NEXT_POSITION] = 1.0 if command.quantity is Quantity.POSITION else 0.0
            memory[NEXT_VALUE] = command.value
            memory[NEXT_AT] = at

    def take_saturated(self) -> bool:
        """Return whether the torque limit has acted since the last call."""
        acted = self._memory[SATURATED] != 0.0
        self._memory[SATURATED] = 0.0
        return acted
