"""The drive's firmware: sampled, with its own loop, its own limits and its own faults.

It runs at `drive.loop_rate`. On each beat it takes the set-point over, closes the position loop on the encoder's
counts, and turns the torque off by itself where velocity or temperature is too high or no set-point arrives any more.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, cast

import numpy as np

from drivers.servo import Command, Limits, Quantity
from ga.compiled import compiled
from sim_backend.integrator import SIZE, TIME, Path, integrate, path_in, recall, start
from sim_backend.plant import (
    CELL,
    JOINT,
    MOTOR,
    TORQUE,
    VELOCITY,
    WINDING,
    Constants,
    Vector,
    constants,
    coupling_torque,
    packed,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sim_backend.parameters import SimParameters


Packed: TypeAlias = "NDArray[np.void]"


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
ENABLED = 0
POSITION_MODE = 1
SETPOINT = 2
DEMAND = 3
INTEGRAL = 4
FED = 5
FAULT = 6
SATURATED = 7
FROZEN = 8
"""rad: the angle that a frozen encoder repeats; NaN while it works."""
MAX_TORQUE = 9
MAX_VELOCITY = 10
MAX_TEMPERATURE = 11
NEXT_AT = 12
"""s from which the set-point that has arrived last may be taken over; infinite where it has been."""
NEXT_POSITION = 13
NEXT_VALUE = 14
PLACES = 15

_AGES = 4
"""s since what each sensor shows: motor position, motor torque, joint position, joint torque."""


class Settings(NamedTuple):
    """The firmware's constants. period, watchdog s; lsb rad; the rest as in `DriveParameters`."""

    period: float
    watchdog: float
    lsb: float
    gain: float
    integral_gain: float
    damping_gain: float


_SETTINGS = np.dtype([(name, np.float64) for name in Settings._fields])
_CONSTANTS = np.dtype([(name, np.float64) for name in Constants._fields])
_TO_SETTINGS = PLACES + len(Settings._fields)
_TO_CONSTANTS = _TO_SETTINGS + len(Constants._fields)
_HEAD = _TO_CONSTANTS + _AGES


@compiled
def _trip(path: Path, memory: Vector, code: float) -> None:
    """Open the output stage, so that no current flows, and latch `code` (0: none)."""
    memory[ENABLED] = 0.0
    memory[DEMAND] = 0.0
    memory[SETPOINT] = 0.0
    memory[POSITION_MODE] = 0.0
    memory[INTEGRAL] = 0.0
    memory[NEXT_AT] = math.inf
    path.state[TORQUE] = 0.0
    if memory[FAULT] == 0.0:
        memory[FAULT] = code


@compiled
def _regulate(path: Path, memory: Vector, settings: Settings) -> None:
    """Set the torque demand, N m, for the beat that begins now."""
    ceiling = memory[MAX_TORQUE]
    wanted = memory[SETPOINT]
    if memory[POSITION_MODE] != 0.0:
        position = math.floor(path.state[MOTOR] / settings.lsb + 0.5) * settings.lsb
        velocity = path.state[VELOCITY]
        if not math.isnan(memory[FROZEN]):
            position, velocity = memory[FROZEN], 0.0
        error = memory[SETPOINT] - position
        wanted = settings.gain * error - settings.damping_gain * velocity + memory[INTEGRAL]
        if abs(wanted) <= ceiling:  # an integral that goes on while the torque cannot would wind up
            memory[INTEGRAL] += settings.integral_gain * error * settings.period
    if abs(wanted) > ceiling:
        memory[SATURATED] = 1.0
    memory[DEMAND] = max(-ceiling, min(ceiling, wanted))


@compiled
def _beat(path: Path, memory: Vector, settings: Settings) -> None:
    """One beat of the firmware: look for faults, then regulate."""
    velocity = path.state[VELOCITY] if math.isnan(memory[FROZEN]) else 0.0
    if abs(velocity) > memory[MAX_VELOCITY]:
        _trip(path, memory, 1.0)
    elif path.state[WINDING] > memory[MAX_TEMPERATURE]:
        _trip(path, memory, 2.0)
    elif path.now[TIME] - memory[FED] > settings.watchdog:
        _trip(path, memory, 3.0)
    else:
        _regulate(path, memory, settings)


class _Parts(NamedTuple):
    """The one memory of a drive, which is passed to a compiled function in a twentieth of the time of its parts."""

    memory: Vector
    settings: Packed
    constants: Packed
    ages: Vector
    path: Path


@compiled
def _parts(drive: Vector) -> _Parts:
    return _Parts(
        drive[:PLACES],
        drive[PLACES:_TO_SETTINGS].view(_SETTINGS),
        drive[_TO_SETTINGS:_TO_CONSTANTS].view(_CONSTANTS),
        drive[_TO_CONSTANTS:_HEAD],
        path_in(drive[_HEAD:]),
    )


@compiled
def run(drive: Vector, until: float) -> None:
    """Carry plant and firmware to `until`, s."""
    parts = _parts(drive)
    _carry(parts.path, parts.memory, parts.settings[0], parts.constants[0], until)


@compiled
def _take_over(memory: Vector) -> None:
    """Take the set-point over that has arrived: a torque, N m, or a position, rad."""
    if memory[NEXT_POSITION] != 0.0 and memory[POSITION_MODE] == 0.0:
        memory[INTEGRAL] = 0.0
    memory[POSITION_MODE] = memory[NEXT_POSITION]
    memory[SETPOINT] = memory[NEXT_VALUE]
    memory[NEXT_AT] = math.inf


@compiled
def _carry(path: Path, memory: Vector, settings: Settings, c: Constants, until: float) -> None:
    """Carry plant and firmware to `until`, s."""
    while memory[ENABLED] != 0.0:
        # The millionth of a period keeps a beat that has just been struck from being struck again.
        beat = (math.floor(path.now[TIME] / settings.period + 1e-6) + 1.0) * settings.period
        if beat > until:
            break
        integrate(path, memory[DEMAND], beat, c)
        if memory[NEXT_AT] < beat:
            _take_over(memory)
        _beat(path, memory, settings)
    integrate(path, memory[DEMAND], until, c)


class Seen(NamedTuple):
    """The quantities at the sensors, each at its own instant, before noise and counts.

    motor_position rad, motor_velocity rad/s (filtered), motor_torque N m, joint_position rad, joint_torque N m
    (filtered), temperature degC.
    """

    motor_position: float
    motor_velocity: float
    motor_torque: float
    joint_position: float
    joint_torque: float
    temperature: float


@compiled
def look(drive: Vector) -> Seen:
    """Return what the sensors see of the drive in `Drive.numbers`; its motor angle is NaN where that is forgotten."""
    parts = _parts(drive)
    path, ages, state = parts.path, parts.ages, parts.path.trial
    now = path.now[TIME]
    known = recall(path, now - ages[0], state)
    angle, velocity, temperature = state[MOTOR], state[VELOCITY], state[WINDING]
    known &= recall(path, now - ages[1], state)
    torque = state[TORQUE]
    known &= recall(path, now - ages[2], state)
    joint = state[JOINT]
    known &= recall(path, now - ages[3], state)
    if not known:
        angle = math.nan
    return Seen(angle, velocity, torque, joint, state[CELL], temperature)


def _numbers(array: Vector) -> memoryview[float]:
    """Return the numbers of an array, of which one is read in a third of the array's time."""
    return cast("memoryview[float]", array.data)


class Drive:
    """A drive on the plant, commanded without a link. Times are in s since it was switched on.

    watchdog: s of silence after which it turns its torque off. numbers: its whole state, for compiled functions.
    """

    def __init__(self, parameters: SimParameters, *, watchdog: float) -> None:
        drive, sensors = parameters.drive, parameters.sensors
        self.constants = constants(parameters)
        self._ceiling = drive.torque_limit
        self._lsb = 2.0 * math.pi / sensors.motor_counts
        settings = Settings(
            period=1.0 / drive.loop_rate,
            watchdog=float(watchdog),
            lsb=self._lsb,
            gain=float(drive.position_gain),
            integral_gain=float(drive.position_integral_gain),
            damping_gain=float(drive.position_damping_gain),
        )
        ages = (
            sensors.motor_position_delay,
            sensors.motor_torque_delay,
            sensors.joint_position_delay,
            sensors.joint_torque_delay,
        )
        self.numbers = np.zeros(_HEAD + SIZE)
        self.numbers[PLACES:_HEAD] = (*settings, *self.constants, *ages)
        self.path = start(self.constants, self.numbers[_HEAD:])
        self._memory = _numbers(self.numbers[:PLACES])
        self._now = _numbers(self.path.now)
        self._memory[FROZEN] = math.nan
        self._memory[NEXT_AT] = math.inf

    @property
    def time(self) -> float:
        """The time that plant and firmware have been carried to, s."""
        return self._now[TIME]

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
        return float(coupling_torque(self.path.state, packed(self.constants, Constants._fields)[0]))

    def run(self, until: float) -> None:
        """Carry plant and firmware to `until`; nothing happens where that is past."""
        run(self.numbers, until)

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
        _trip(self.path, self.numbers[:PLACES], float(code))

    def disable(self) -> None:
        """No current from now on."""
        self._trip(0)

    def latch(self, code: int) -> None:
        """Latch a fault from outside and open the output stage."""
        self._trip(code)

    def feed(self) -> None:
        """Tell the watchdog that the host is alive."""
        self._memory[FED] = self._now[TIME]

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
        self._memory[FROZEN] = math.floor(self.path.state[MOTOR] / self._lsb + 0.5) * self._lsb

    @property
    def frozen(self) -> float:
        """The angle that a frozen motor encoder repeats, rad; NaN while it works."""
        return self._memory[FROZEN]
