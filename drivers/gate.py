"""The safety gate of a servo: it checks every command, and requests torque-off until the device confirms it.

Every servo holds one `Gate` and gives it two functions of its own protocol: one that requests torque-off, and one that
closes the link. `DriveServo` is a servo with its gate, for a family of drives to complete. The rules of the gate:

* A command is sent only while the servo is armed, if the servo supports its quantity, and if its value is finite. The
  value is clamped to the armed limits. Finiteness is checked before any clamp: `max(low, min(high, nan))` is full
  torque.
* Torque-off is requested until the device confirms it. `Gate.disarm` requests it three times, but waits for the
  confirmation no longer than `CONFIRMS`. `drivers.torque_off.confirm_torque_off` repeats that, and gives the alarm.
* When an error occurs while a servo is opened or armed, torque-off is requested before the error is raised further.
* A drive with a watchdog stops by itself when no request arrives. `watchdog_problem` checks that one lost reply cannot
  trip the watchdog. A tripped watchdog is a DeviceFault: the servo must be armed again.
"""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Protocol, runtime_checkable

from drivers.clock import Clock, MonotonicClock, waits_end_by
from drivers.retry import Repeats
from drivers.servo import (
    Command,
    DriverError,
    Limits,
    LinkLost,
    NoReply,
    Quantity,
    Sample,
    ServoInfo,
    Status,
    UnsafeCommand,
)
from drivers.settings import Settings

_REQUESTS = 3
"""How many times one call of `Gate.disarm` requests torque-off."""
CONFIRMS = 0.7
"""s in which a drive must confirm torque-off; then the alarm is given, within 1 s in any case."""
_AFTER_ERROR = 0.2
"""s to wait for the confirmation after an error of arming: whoever armed the servo then confirms the torque-off."""


class Admitted(NamedTuple):
    """The result of `Gate.admit`. command: the clamped command; None if nothing is to be sent. clipped: whether a limit
    changed the command.
    """

    command: Command | None
    clipped: bool


class Gate:
    """The safety state of one servo: disarmed, armed or closed.

    name: name of the link in messages. quantities: the set-points that the servo supports. torque_off: a function that
    makes one request for torque-off, given the number of the request from 0. It returns when the device has confirmed,
    and raises DriverError if the device has not. release: a function that closes the link. mode_key: the key in
    stand.toml that selects the quantity. repeats: the object that repeats requests whose reply was lost, used only
    while the servo is opened and armed. clock: the servo's clock, which limits the waits of a torque-off.

    live: whether current may flow in the motor. Starts as True, because an earlier program may have left the device
    armed.
    """

    def __init__(
        self,
        name: str,
        quantities: frozenset[Quantity],
        *,
        torque_off: Callable[[int], None],
        release: Callable[[], None],
        mode_key: str = "",
        repeats: Repeats | None = None,
        clock: Clock | None = None,
    ) -> None:
        self.live = True
        self._name = name
        self._quantities = tuple(sorted(quantities))  # a tuple compares identities first, a set computes a hash
        self._torque_off = torque_off
        self._release = release
        self._remedy = f"; set {mode_key} otherwise" if mode_key else ""
        self._repeats = repeats or Repeats()
        self._clock = clock or MonotonicClock()
        self._limits: Limits | None = None
        self._closed = False

    @property
    def limits(self) -> Limits | None:
        """The limits with which the servo was armed; None while it is disarmed."""
        return self._limits

    @property
    def armed(self) -> bool:
        """Return whether the servo is armed: only then are set-points sent."""
        return self._limits is not None

    def require_open(self) -> None:
        """Raise LinkLost if the servo is closed."""
        if self._closed:
            raise LinkLost(f"{self._name} is closed")

    def admit(self, command: Command) -> Admitted:
        """Check a command, clamp it to the limits, and return it.

        `Command.rest()` is always allowed; nothing is sent for it while disarmed or if the servo takes no torque
        set-point. Raises UnsafeCommand for every other command that must not reach the device, LinkLost if the servo is
        closed.
        """
        if not math.isfinite(command.value):
            raise UnsafeCommand(f"set-point {command.value} is not a number: nothing was sent")
        limits = self._limits
        unsupported = command.quantity not in self._quantities
        if limits is not None and not unsupported:
            self.require_open()
            bounded = limits.bound(command)
            return Admitted(bounded, bounded is not command)
        at_rest = command == Command.rest()
        if limits is None and not at_rest:
            raise UnsafeCommand(
                f"{command.quantity} set-point {command.value} while disarmed: nothing was sent; arm first"
            )
        if not at_rest:
            raise UnsafeCommand(
                f"{command.quantity} set-point, but this servo is driven by {' or '.join(self._quantities)} "
                f"only: nothing was sent{self._remedy}"
            )
        self.require_open()
        return Admitted(None, clipped=False)

    @contextlib.contextmanager
    def opening(self, undo: Callable[[], None] = lambda: None) -> Iterator[None]:
        """Context manager for the block that identifies the device and requests torque-off for the first time.

        If the block raises, `undo` is called and the link is closed. `undo` sends torque-off without waiting for a
        reply, or restores the settings that were changed.
        """
        try:
            with self._repeats.active((NoReply,)):  # a garbled reply may be that of two devices
                yield
        except BaseException:
            self._closed = True
            try:
                with contextlib.suppress(DriverError):
                    undo()
            finally:
                self._release()
            raise

    @contextlib.contextmanager
    def arming(self, limits: Limits) -> Iterator[None]:
        """Context manager for the block that enables the device. When the block ends, the servo is armed with `limits`.

        If the block raises, torque-off is requested and the error is raised further. Raises LinkLost if the servo is
        closed.
        """
        self.require_open()
        self._limits = None
        self.live = True
        try:
            with self._repeats.active():
                yield
        except BaseException:
            with contextlib.suppress(DriverError), waits_end_by(self._clock.now() + _AFTER_ERROR):
                self.force_off()
            raise
        self._limits = limits

    def fall_silent(self) -> None:
        """Stop sending set-points and leave the device as it is: its torque may be on.

        From now on an exchange with `Command.rest()` only reads, as on a disarmed servo. `disarm` still requests
        torque-off.
        """
        self._limits = None

    def force_off(self) -> None:
        """Request torque-off even if the servo counts as disarmed: its device may still be live. Raises LinkLost,
        DriverError.
        """
        self.live = True
        self.disarm()

    def disarm(self) -> None:
        """Request torque-off up to three times, until the device confirms it, and wait for that `CONFIRMS` s at most.
        Has no effect if the torque is off already.

        If the device does not confirm, raises LinkLost if the link is gone, else DriverError; `disarm` may then be
        called again.
        """
        self._limits = None
        if not self.live or self._closed:
            return
        reason: DriverError | None = None
        end = self._clock.now() + CONFIRMS
        for request in range(_REQUESTS):
            try:
                with waits_end_by(end):
                    self._torque_off(request)
            except DriverError as error:  # after the end there was no time to wait for a reply, which is no reason
                reason = reason if reason is not None and self._clock.now() >= end else error
            else:
                self.live = False
                return
        kind = LinkLost if isinstance(reason, LinkLost) else DriverError
        raise kind(f"torque-off is not confirmed ({reason}): the motor may be live; cut the drive's power") from reason

    def close(self, restore: Callable[[], None] | None = None) -> None:
        """Request torque-off, call `restore` to restore the device's settings, and close the link. Never raises
        DriverError.

        Has no effect if the servo is closed already. To be sure that the torque is off, call `disarm` first.
        """
        if self._closed:
            return
        try:
            with contextlib.suppress(DriverError):
                self.disarm()
            if restore is not None:
                with contextlib.suppress(DriverError):
                    restore()
        finally:
            self._closed = True
            self._release()


_STATUS = ((Status(0), Status.SATURATED), (Status.STALE, Status.STALE | Status.SATURATED))


class DriveServo(ABC):
    """A `drivers.servo.Servo` behind its gate: what is the same in all families of drives.

    A base class and no wrapper, because what a drive can do besides, such as naming its neighbours, is asked of the
    servo itself.

    A family opens and identifies its drive in `__init__`, makes `_gate`, sets `info`, and implements `_arm` and
    `_exchange`. sign: 1 if the drive's positive direction is the stand's, else -1. clock: None for the real clock.

    _settings: the settings of the drive that a run changes and `close` restores; None if there are none.
    """

    info: ServoInfo
    _gate: Gate
    _settings: Settings[Any, Any] | None = None

    def __init__(self, sign: int, clock: Clock | None) -> None:
        self.clock: Clock = clock or MonotonicClock()
        self._sign = sign

    def arm(self, limits: Limits) -> None:
        """Write the limits into the drive and enable it at zero torque, or at its present position; see `_arm`.

        Raises DeviceFault if a fault is latched, DriverError if the drive refuses a value or a limit is below one
        count; the torque is off then.
        """
        with self._gate.arming(limits):
            self._arm(limits)

    def exchange(self, command: Command) -> Sample:
        """Send the set-point and read the state in one round trip; see `_exchange`.

        Raises UnsafeCommand, NoReply, BadReply, LinkLost, and DeviceFault if the drive reports a fault, has stopped by
        itself or has restarted.
        """
        return self._exchange(self._gate.admit(command))

    def disarm(self) -> None:
        """Switch the torque off. Raises DriverError if the drive does not confirm it."""
        self._gate.disarm()

    def close(self) -> None:
        """Switch the torque off, restore the settings, and close the link. Never raises DriverError."""
        self._gate.close(self._restore)

    def fall_silent(self) -> None:
        """See `Gate.fall_silent`."""
        self._gate.fall_silent()

    def keep_journal(self, journal: Callable[[], None]) -> None:
        """See `drivers.off_path.HasJournal`."""
        if self._settings is not None:
            self._settings.journal = journal

    @abstractmethod
    def _arm(self, limits: Limits) -> None:
        """Enable the drive, whose torque may be on. If this raises, torque-off is requested."""

    @abstractmethod
    def _exchange(self, admitted: Admitted) -> Sample:
        """Send an admitted set-point, if there is any, and return the state."""

    def _restore(self) -> None:
        if self._settings is not None:
            self._settings.restore()

    def _sample(
        self,
        times: tuple[float, float],
        position: float,
        velocity: float,
        torque: float | None,
        *,
        temperature: float = math.nan,
        voltage: float = math.nan,
        saturated: bool = False,
        stale: bool = False,
    ) -> Sample:
        """Return the checked readings of one reply as a sample. Raises BadReply if they are damaged.

        times: s, of the request and of the end of the reply. position rad, velocity rad/s, torque N m: in the drive's
        own direction; torque None if the drive measures none. saturated, stale: the flags of `Status`.
        """
        self.info.check_readings(position, velocity, 0.0 if torque is None else torque)
        sign = self._sign
        return Sample(
            t=times[0],
            t_read=0.5 * (times[0] + times[1]),
            motor_position=sign * position,
            motor_velocity=sign * velocity,
            motor_torque=math.nan if torque is None else sign * torque,
            temperature=temperature,
            voltage=voltage,
            status=_STATUS[stale][saturated],
        )


@runtime_checkable
class FallsSilent(Protocol):
    """A servo that can stop sending set-points while its torque is on, so that its watchdog can be tested."""

    def fall_silent(self) -> None:
        """See `Gate.fall_silent`."""


def to_counts(value: float, lsb: float) -> int:
    """Return `value` divided by `lsb` (the value of one count), rounded. Raises UnsafeCommand if the number cannot be
    encoded.
    """
    counts = value / lsb
    if not math.isfinite(counts):
        raise UnsafeCommand(f"set-point {value} cannot be encoded in counts of {lsb}: nothing was sent")
    return round(counts)


def below_one_count(torque: float, lsb: float, model: str) -> DriverError:
    """Return the error for a torque limit, N m, smaller than the `lsb` N m of one count of a motor."""
    return DriverError(
        f"torque limit {torque:.3g} N m is below one count of the {model}, {lsb:.3g} N m: raise it or take a smaller "
        "motor"
    )


def watchdog_problem(table: str, watchdog: float, reply_timeout: float) -> str:
    """Return why a watchdog of `watchdog` s (0: none) is too short for a reply that takes `reply_timeout` s; "" if it
    is not.

    table: name of the table in stand.toml, for the message.
    """
    if not 0.0 < watchdog < 2.0 * reply_timeout:
        return ""
    return (
        f"{table}.watchdog {watchdog} s is not above twice {table}.reply_timeout {reply_timeout} s: "
        "one lost reply would stop the motor"
    )


def check_watchdog(table: str, watchdog: float, reply_timeout: float) -> None:
    """Raise ValueError if a watchdog of `watchdog` s (0: none) is too short for a reply that takes
    `reply_timeout` s.
    """
    if problem := watchdog_problem(table, watchdog, reply_timeout):
        raise ValueError(problem)
