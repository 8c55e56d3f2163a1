"""The one interface between the recorder and every servo, real or simulated.

Every quantity is at the motor shaft and in SI: rad, rad/s, N m, s, degC, V. The recorder, not the servo, knows the gear
ratio and the joint. A `Servo` is one axis with one round trip in each tick: write the set-point, read the state.

Rules of every servo, which `drivers.gate` implements and the contract tests check:

* A set-point is bounded by `Limits.bound` before it is encoded: a NaN is refused, never clamped.
* `disarm` and `close` may be called twice, at any time, on a latched or half-dead device, and leave the torque off. If
  the device does not confirm this, `disarm` raises a DriverError and may be called again; `close` never raises.
* Stopping means torque off. No servo holds a position to stop.
* A lost reply raises `NoReply` (the recorder stores it as a gap); a link that is gone raises `LinkLost`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import IntFlag, StrEnum
from typing import Protocol, Self

from drivers.clock import Clock


class Quantity(StrEnum):
    """The quantity that a set-point commands: torque or position."""

    TORQUE = "torque"
    POSITION = "position"


class Status(IntFlag):
    """Flags of a sample. A sample without flags (zero) is good."""

    NO_REPLY = 1
    """No reply in this tick; the row holds no measurement."""
    BAD_REPLY = 2
    """The reply cannot be decoded; the row holds no measurement."""
    LATE = 4
    """The tick began more than half a period after its time."""
    SATURATED = 8
    """The torque limit or the current limit acted, or the set-point was clamped."""
    STALE = 16
    """The drive's own clock has not advanced since the previous sample."""
    MISSED = 32
    """Nothing was sent, because the next tick was already due: the drive kept its previous set-point. Always set
    together with NO_REPLY and LATE.
    """


class DriverError(Exception):
    """A drive or its link did something other than what was requested. Base class of the errors below."""


class LinkLost(DriverError, ConnectionError):
    """The serial port or the bus is gone. The run ends; the motor may be live."""


def reason_of(error: object) -> str:
    """Return the text of an error, without the operating system's error number."""
    return (isinstance(error, OSError) and error.strerror) or str(error)


def link_lost(name: str, reason: object) -> LinkLost:
    """Return the error LinkLost for the link `name`. reason: why the link is gone."""
    why = reason_of(reason)
    return LinkLost(f"{name} is gone ({why}): whether the motor is live is not known; cut the power before touching it")


class NoReply(DriverError, TimeoutError):
    """No reply arrived before the deadline. One lost reply is a gap in the data; several in a row end the run."""


class BadReply(DriverError, ValueError):
    """A reply arrived, but its checksum, its length or its sender is wrong."""


class DeviceFault(DriverError, RuntimeError):
    """The drive has latched a fault. `code` is the drive's own number, `message` the meaning of the fault with the
    remedy.
    """

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class UnsafeCommand(DriverError, ValueError):
    """The set-point must not reach a drive: it is not finite, or the servo is disarmed."""


@dataclass(slots=True, unsafe_hash=True)  # not frozen: that takes three times as long to make, once a tick
class Command:
    """A set-point at the motor shaft. value: N m for a torque, rad from the drive's own zero for a position.
    Immutable.
    """

    quantity: Quantity
    value: float

    @classmethod
    def rest(cls) -> Self:
        """Return the set-point of zero torque, the only one that a disarmed servo accepts."""
        return cls(Quantity.TORQUE, 0.0)


_LIMITS = ": nothing was sent; correct [limits], gear_ratio and zero in the stand file"


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits that the drive must never exceed, at the motor shaft.

    torque: largest magnitude, N m. velocity: largest magnitude, rad/s. temperature: highest, degC. position: lowest and
    highest, rad. Raises UnsafeCommand if a limit is not a positive number or the positions are no range.
    """

    torque: float
    velocity: float
    temperature: float
    position: tuple[float, float]

    def __post_init__(self) -> None:
        for name in ("torque", "velocity", "temperature"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise UnsafeCommand(f"the limit of {name} at the motor, {value:g}, is not a positive number{_LIMITS}")
        low, high = self.position
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise UnsafeCommand(f"the limits of position at the motor, {low:g} to {high:g} rad, are no range{_LIMITS}")

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
    """The measurements of one round trip. Immutable. A value is NaN if the stand has no such sensor.

    t: s, when the set-point was sent. t_read: s, the midpoint of the bus read. t_joint: s, when a separate sensor
    measured the joint; NaN without such a sensor. All three are on the servo's clock. motor_position rad,
    motor_velocity rad/s, motor_torque N m: at the motor shaft. joint_position rad, joint_torque N m: at the locked
    joint. temperature degC, voltage V: of the drive.
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
        """Return a sample without values, for the reply that is missing to the request sent at `t`, s."""
        return cls(t=t, t_read=math.nan, status=status)


@dataclass(frozen=True, slots=True)
class ServoInfo:
    """The identity of a servo and the resolution of its readings.

    quantities: the set-points that the servo supports. position_lsb rad, torque_lsb N m, velocity_lsb rad/s: the value
    of one count at the motor shaft, NaN if not known. torque_most N m: twice the stall torque, infinite if not known. A
    larger reading is damaged: even a motor that is reversed at full speed does not carry more than twice its stall
    current. torque_uncertainty: relative standard uncertainty of the torque scale, NaN if not known. watchdog: s of
    silence after which the device turns its torque off by itself; 0 if it never does, or if that is not known.
    watchdog_remedy: which setting enables the watchdog; "" if the device has none. serial_is_id: whether `serial` is
    only the servo's number on the bus, because the servo reports no serial number. measures_when_off: whether the servo
    measures its torque while the torque is off; otherwise it only reports zero without a measurement.
    """

    backend: str
    model: str
    serial: str = ""
    firmware: str = ""
    quantities: frozenset[Quantity] = frozenset(Quantity)
    position_lsb: float = math.nan
    velocity_lsb: float = math.nan
    torque_lsb: float = math.nan
    torque_most: float = math.inf
    torque_uncertainty: float = math.nan
    watchdog: float = 0.0
    watchdog_remedy: str = ""
    serial_is_id: bool = False
    measures_when_off: bool = True

    def check_readings(self, position: float, velocity: float, torque: float) -> None:
        """Check the readings of one reply. Raises BadReply if a reading is not finite, or the torque, N m, is above
        `torque_most`.

        A checksum of one byte accepts one in 256 damaged replies. A damaged reading in range cannot be recognised.
        """
        for name, value in (("position", position), ("velocity", velocity), ("torque", torque)):
            if not math.isfinite(value):
                raise BadReply(f"the drive reports a {name} that is not a number: the sample is dropped")
        if abs(torque) > self.torque_most:
            raise BadReply(
                f"the reply holds a torque of {torque:.3g} N m, more than twice the drive's stall torque "
                f"({self.torque_most / 2.0:.3g} N m): it is damaged, and the sample is dropped; check the cable"
            )


class Servo(Protocol):
    """A motor axis that is commanded and read over one link."""

    @property
    def info(self) -> ServoInfo:
        """The identity of the servo and the resolution of its readings."""

    @property
    def clock(self) -> Clock:
        """The clock of the samples: virtual for the simulator, monotonic for hardware."""

    def arm(self, limits: Limits) -> None:
        """Write the limits into the device, if it has registers for them, then enable the device at zero torque.

        Raises DeviceFault if a fault is latched, DriverError if the device refuses a limit.
        """

    def exchange(self, command: Command) -> Sample:
        """Write the set-point and read the state.

        A disarmed servo accepts only `Command.rest()`, for which it only reads. Raises UnsafeCommand, NoReply,
        BadReply, LinkLost, DeviceFault.
        """

    def disarm(self) -> None:
        """Switch the torque off. Has no effect if it is off already. Raises DriverError if the device does not confirm
        it.
        """

    def close(self) -> None:
        """Switch the torque off, then close the link. Has no effect if the link is closed already. Never raises."""


class JointSensor(Protocol):
    """A separate sensor at the locked joint, with its own link."""

    def read(self) -> tuple[float, float]:
        """Return the newest reading without waiting: its time, s on the servo's clock, and the joint torque, N m.

        The same reading is returned until a newer one arrives, so that the control loop never waits for a slow sensor.
        Raises NoReply, BadReply, LinkLost.
        """

    def close(self) -> None:
        """Close the link. Has no effect if the link is closed already."""
