"""The drive's firmware: sampled, with its own loop, its own limits and its own faults.

It runs at `drive.loop_rate`. On each beat it takes the set-point over, closes the position loop on the encoder's
counts, and turns the torque off by itself where velocity or temperature is too high or no set-point arrives any more.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from drivers.servo import Command, Limits, Quantity
from ga.compiled import compiled
from sim_backend.integrator import TIME, Path, integrate, recall, start
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
PLACES = 12


class Settings(NamedTuple):
    """The firmware's constants. period, watchdog s; lsb rad; the rest as in `DriveParameters`."""

    period: float
    watchdog: float
    lsb: float
    gain: float
    integral_gain: float
    damping_gain: float


@compiled
def _trip(path: Path, memory: Vector, code: float) -> None:
    """Open the output stage, so that no current flows, and latch `code` (0: none)."""
    memory[ENABLED] = 0.0
    memory[DEMAND] = 0.0
    memory[SETPOINT] = 0.0
    memory[POSITION_MODE] = 0.0
    memory[INTEGRAL] = 0.0
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


@compiled
def _run(path: Path, memory: Vector, packed_settings: Packed, packed_constants: Packed, until: float) -> None:
    """Carry plant and firmware to `until`, s."""
    settings: Settings = packed_settings[0]
    c: Constants = packed_constants[0]
    while memory[ENABLED] != 0.0:
        # The millionth of a period keeps a beat that has just been struck from being struck again.
        beat = (math.floor(path.now[TIME] / settings.period + 1e-6) + 1.0) * settings.period
        if beat > until:
            break
        integrate(path, memory[DEMAND], beat, c)
        _beat(path, memory, settings)
    integrate(path, memory[DEMAND], until, c)


@compiled
def _look(path: Path, ages: Vector) -> tuple[float, float, float, float, float, float]:
    """The fields of `Seen`; NaN where the past has been forgotten."""
    state = np.empty_like(path.state)
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
    return angle, velocity, torque, joint, state[CELL], temperature


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


class Drive:
    """A drive on the plant, commanded without a link. Times are in s since it was switched on.

    watchdog: s of silence after which it turns its torque off.
    """

    def __init__(self, parameters: SimParameters, *, watchdog: float) -> None:
        drive, sensors = parameters.drive, parameters.sensors
        self.constants = constants(parameters)
        self.path = start(self.constants)
        self._ceiling = drive.torque_limit
        self._memory = np.zeros(PLACES)
        self._memory[FROZEN] = math.nan
        self._lsb = 2.0 * math.pi / sensors.motor_counts
        settings = Settings(
            period=1.0 / drive.loop_rate,
            watchdog=float(watchdog),
            lsb=self._lsb,
            gain=float(drive.position_gain),
            integral_gain=float(drive.position_integral_gain),
            damping_gain=float(drive.position_damping_gain),
        )
        self._settings = packed(settings, Settings._fields)
        self._constants = packed(self.constants, Constants._fields)
        self._ages = np.array(
            [
                sensors.motor_position_delay,
                sensors.motor_torque_delay,
                sensors.joint_position_delay,
                sensors.joint_torque_delay,
            ]
        )

    @property
    def time(self) -> float:
        """The time that plant and firmware have been carried to, s."""
        return float(self.path.now[TIME])

    @property
    def enabled(self) -> bool:
        """Whether current can flow."""
        return bool(self._memory[ENABLED])

    @property
    def fault(self) -> int:
        """The latched fault, 0 where there is none."""
        return int(self._memory[FAULT])

    @property
    def demand(self) -> float:
        """The motor torque the current loop is asked for now, N m."""
        return float(self._memory[DEMAND])

    @property
    def coupling_torque(self) -> float:
        """sigma_c now, N m."""
        return float(coupling_torque(self.path.state, self._constants[0]))

    def run(self, until: float) -> None:
        """Carry plant and firmware to `until`; nothing happens where that is past."""
        _run(self.path, self._memory, self._settings, self._constants, until)

    def enable(self, limits: Limits) -> None:
        """Set the limits and let current flow, at zero torque; the watchdog starts now."""
        memory = self._memory
        _trip(self.path, memory, 0.0)
        memory[MAX_TORQUE] = min(limits.torque, self._ceiling)
        memory[MAX_VELOCITY] = limits.velocity
        memory[MAX_TEMPERATURE] = limits.temperature
        memory[SATURATED] = 0.0
        memory[FED] = self.time
        memory[ENABLED] = 1.0

    def disable(self) -> None:
        """No current from now on."""
        _trip(self.path, self._memory, 0.0)

    def latch(self, code: int) -> None:
        """Latch a fault from outside and open the output stage."""
        _trip(self.path, self._memory, float(code))

    def feed(self) -> None:
        """Tell the watchdog that the host is alive."""
        self._memory[FED] = self.time

    def follow(self, command: Command) -> None:
        """Set a set-point, which acts from the next beat. No effect while disabled."""
        memory = self._memory
        if memory[ENABLED] == 0.0:
            return
        position = command.quantity is Quantity.POSITION
        if position and memory[POSITION_MODE] == 0.0:
            memory[INTEGRAL] = 0.0
        memory[POSITION_MODE] = float(position)
        memory[SETPOINT] = command.value

    def take_saturated(self) -> bool:
        """Whether the torque limit has acted since this was last asked."""
        acted = bool(self._memory[SATURATED])
        self._memory[SATURATED] = 0.0
        return acted

    def freeze_encoder(self) -> None:
        """From now on the motor encoder repeats its count."""
        self._memory[FROZEN] = math.floor(self.path.state[MOTOR] / self._lsb + 0.5) * self._lsb

    @property
    def frozen(self) -> float:
        """The angle that a frozen motor encoder repeats, rad; NaN while it works."""
        return float(self._memory[FROZEN])

    def look(self) -> Seen:
        """The quantity at each sensor now.

        Raises RuntimeError where one shows an instant further back than the plant remembers.
        """
        seen = _look(self.path, self._ages)
        if math.isnan(seen[0]):
            raise RuntimeError(
                "a sensor shows an instant the plant no longer remembers: "
                "lower the sensors' delays or fixture.stiffness"
            )
        return Seen(*seen)
