"""The one interface between the recorder and anything that turns a motor.

Everything here is at the motor shaft, in SI: rad, rad/s, N m, s, degC, V. The gear ratio and the joint belong to
the layer above. A `Servo` is one axis with one round trip a tick: write the set-point, read the state.

Rules of every servo, which `drivers.gate` implements and the contract tests check:

* A set-point is bounded by `Limits.bound` before it is encoded: a NaN is refused, never clamped.
* `disarm` and `close` may be called twice, at any time, on a latched or half-dead device, and leave the torque off.
  Where that is not confirmed `disarm` raises a DriverError, and may be called again until it is; `close` never raises.
* Stopping means torque off. No servo holds a position to stop.
* A lost reply is `NoReply` (data: the recorder counts a gap); a link that is gone is `LinkLost`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import IntFlag, StrEnum
from typing import Protocol, Self

from drivers.clock import Clock


class Quantity(StrEnum):
    """The quantity that a set-point commands."""

    TORQUE = "torque"
    POSITION = "position"


class Status(IntFlag):
    """Flags of a sample; zero is a good sample."""

    NO_REPLY = 1
    """No reply in this tick; the row holds no measurement."""
    BAD_REPLY = 2
    """The reply cannot be decoded; the row holds no measurement."""
    LATE = 4
    """The tick began more than half a period after its time."""
    SATURATED = 8
    """The torque limit or the current limit acted, or the set-point was clamped."""
    STALE = 16
    """The drive's own clock has not changed since the sample before."""
    MISSED = 32
    """The next tick was due already, so that nothing was sent: the drive kept the set-point before. Never alone, but
    with NO_REPLY and LATE."""


class DriverError(Exception):
    """A drive or its link did something other than what was asked."""


class LinkLost(DriverError, ConnectionError):
    """The port or the bus is gone. The run ends; the motor may be live."""


def reason_of(error: object) -> str:
    """Return an error in words, without the system's number."""
    return (isinstance(error, OSError) and error.strerror) or str(error)


def link_lost(name: str, reason: object) -> LinkLost:
    """Return the error for the link `name` that is gone for `reason`."""
    why = reason_of(reason)
    return LinkLost(f"{name} is gone ({why}): whether the motor is live is not known; cut the power before touching it")


class NoReply(DriverError, TimeoutError):
    """No reply within the deadline. One is a gap in the data; several in a row end the run."""


class BadReply(DriverError, ValueError):
    """A reply that fails its checksum, its length or its identity."""


class DeviceFault(DriverError, RuntimeError):
    """The drive latched a fault.

    `code` is the drive's own number, `message` its meaning with the remedy.
    """

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class UnsafeCommand(DriverError, ValueError):
    """A set-point that must not reach a drive: not finite, or sent while disarmed."""


@dataclass(slots=True, unsafe_hash=True)  # not frozen: that takes three times as long to make, once a tick
class Command:
    """A set-point at the motor shaft: N m for torque, rad (the drive's own zero) for position. Never changed."""

    quantity: Quantity
    value: float

    @classmethod
    def rest(cls) -> Self:
        """Zero torque: the only set-point a disarmed servo accepts."""
        return cls(Quantity.TORQUE, 0.0)


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits that the drive must never exceed, at the motor shaft.

    torque: N m, magnitude. velocity: rad/s, magnitude. temperature: degC. position: rad, lowest and highest.
    Raises ValueError if one is not a positive number or the positions are reversed.
    """

    torque: float
    velocity: float
    temperature: float
    position: tuple[float, float]

    def __post_init__(self) -> None:
        for name in ("torque", "velocity", "temperature"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"limit of {name}: {value} is not a positive number")
        low, high = self.position
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError(f"limit of position: {low} to {high} is not a range")

    def bound(self, command: Command) -> Command:
        """Return the set-point clamped to the limits.

        Finiteness is checked first: `max(low, min(high, nan))` is `high`, which would be full torque.
        Raises UnsafeCommand if the value is not finite.
        """
        if not math.isfinite(command.value):
            raise UnsafeCommand(f"set-point {command.value} is not a number: nothing was sent")
        low, high = self.position if command.quantity is Quantity.POSITION else (-self.torque, self.torque)
        if low <= command.value <= high:
            return command
        return replace(command, value=max(low, min(high, command.value)))


@dataclass(slots=True, unsafe_hash=True)  # not frozen: see Command
class Sample:
    """The result of one round trip, which nobody changes; NaN where the stand has no such sensor.

    t: s, when the set-point was sent. t_read: s, the midpoint of the bus read. t_joint: s, when another device read the
    joint; NaN if none does. All on the servo's clock.
    motor_position rad, motor_velocity rad/s, motor_torque N m: at the motor shaft.
    joint_position rad, joint_torque N m: at the locked joint.
    temperature degC, voltage V.
    """

    t: float
    t_read: float
    motor_position: float = math.nan
    motor_velocity: float = math.nan
    motor_torque: float = math.nan
    joint_position: float = math.nan
    joint_torque: float = math.nan
    temperature: float = math.nan
    voltage: float = math.nan
    status: Status = field(default=Status(0))
    t_joint: float = math.nan

    @classmethod
    def missing(cls, t: float, status: Status = Status.NO_REPLY) -> Self:
        """Return a row without values for a reply that was lost at `t` s."""
        return cls(t=t, t_read=math.nan, status=status)


@dataclass(frozen=True, slots=True)
class ServoInfo:
    """The identity of a servo and the resolution of its readings.

    quantities: the set-points it supports. position_lsb rad, torque_lsb N m, velocity_lsb rad/s: one count at the motor
    shaft, NaN if not known. torque_uncertainty: relative standard uncertainty of the torque scale, NaN where not
    known. watchdog: s of silence after which the device turns its torque off by itself; 0 if it does not, or where
    that is not known. watchdog_remedy: what to set so that it does; "" if it has no watchdog. serial_is_id: whether
    `serial` is no more than its number on the bus, since it reports no serial number. measures_when_off: whether it
    measures a torque while it is off; where not, its reading of zero then is no more than its word.
    """

    backend: str
    model: str
    serial: str = ""
    firmware: str = ""
    quantities: frozenset[Quantity] = frozenset(Quantity)
    position_lsb: float = math.nan
    velocity_lsb: float = math.nan
    torque_lsb: float = math.nan
    torque_uncertainty: float = math.nan
    watchdog: float = 0.0
    watchdog_remedy: str = ""
    serial_is_id: bool = False
    measures_when_off: bool = True


class Servo(Protocol):
    """One axis behind one link."""

    @property
    def info(self) -> ServoInfo:
        """The identity of the servo."""

    @property
    def clock(self) -> Clock:
        """The clock of its samples: virtual for the simulator, monotonic for hardware."""

    def arm(self, limits: Limits) -> None:
        """Write the limits into the device where it has registers for them, then enable it at zero torque.

        Raises DeviceFault if a fault is latched, DriverError if a limit is refused.
        """

    def exchange(self, command: Command) -> Sample:
        """Write the set-point, read the state.

        A disarmed servo is only read, and accepts only `Command.rest()`.
        Raises UnsafeCommand, NoReply, BadReply, LinkLost, DeviceFault.
        """

    def disarm(self) -> None:
        """Switch the torque off. Harmless when already off. Raises DriverError if the device does not confirm it."""

    def close(self) -> None:
        """Switch the torque off, then close the link. Harmless when already closed; never raises."""


class JointSensor(Protocol):
    """A second device that reads the locked joint, on its own link."""

    def read(self) -> tuple[float, float]:
        """Return the newest reading without waiting: its time, s on the servo's clock, and the joint torque, N m.

        It returns the same reading again until there is a new one, so that the loop never waits for a slow sensor.
        Raises NoReply, BadReply, LinkLost.
        """

    def close(self) -> None:
        """Close the link. Harmless when already closed."""
