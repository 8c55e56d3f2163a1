"""The safety gate of a servo: which commands pass, and torque-off until the device confirms it.

Every servo holds one `Gate` and gives it two functions of its own protocol: one request for torque-off, and how to
close the link. The rules stand here once:

* A command passes only while the servo is armed, in a quantity that it supports, finite, and clamped to the limits it
  was armed with. Finiteness is checked before any clamp: `max(low, min(high, nan))` is full torque.
* Torque-off is requested until the device confirms it. `Gate.disarm` requests it three times,
  `drivers.torque_off.confirm_torque_off` repeats that for about one second.
* Whatever fails while a servo is opened or armed, torque-off is requested before the error goes on.
* A drive with a watchdog stops by itself when no request arrives. `watchdog_problem` checks that one lost reply cannot
  trip it. A tripped watchdog is a DeviceFault: the servo must be armed again.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol, runtime_checkable

from drivers.retry import Repeats
from drivers.servo import Command, DriverError, Limits, LinkLost, NoReply, Quantity, UnsafeCommand

_REQUESTS = 3
"""Requests for torque-off in one call of `Gate.disarm`."""


class Admitted(NamedTuple):
    """A command that passed. command: None if nothing is to be written. clipped: whether a limit changed it."""

    command: Command | None
    clipped: bool


class Gate:
    """The safety state of one servo: disarmed, armed or closed.

    name: the link, for messages. quantities: the set-points that the servo supports. torque_off: makes one request for
    torque-off, given the number of this request from 0, and returns only when the device has confirmed it; raises
    DriverError where it has not. release: closes the link. mode_key: the key in stand.toml that selects the quantity.
    repeats: of the link, whose lost requests are made again while the servo is opened and armed, and only then.

    live: whether current may flow. It begins as True, because an earlier program may have left the device armed.
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
    ) -> None:
        self.live = True
        self._name = name
        self._quantities = tuple(sorted(quantities))  # a tuple compares identities first, a set computes a hash
        self._torque_off = torque_off
        self._release = release
        self._remedy = f"; set {mode_key} otherwise" if mode_key else ""
        self._repeats = repeats or Repeats()
        self._limits: Limits | None = None
        self._closed = False

    @property
    def limits(self) -> Limits | None:
        """The limits the servo was armed with; None while it is disarmed."""
        return self._limits

    @property
    def armed(self) -> bool:
        """Return whether set-points are sent."""
        return self._limits is not None

    def require_open(self) -> None:
        """Raise LinkLost if the servo is closed."""
        if self._closed:
            raise LinkLost(f"{self._name} is closed")

    def admit(self, command: Command) -> Admitted:
        """Check a command and clamp it to the limits.

        `Command.rest()` always passes; it writes nothing while disarmed or where the servo has no torque set-point.
        Raises UnsafeCommand for every other command that must not reach the device, LinkLost if the servo is closed.
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
        """Guard the block that identifies the device and requests torque-off for the first time.

        Where it fails, `undo` sends torque-off without waiting for a reply, or restores the settings that were changed,
        and the link is closed.
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
        """Guard the block that enables the device; the servo is armed with `limits` when the block ends.

        Where the block fails, torque-off is requested and the error goes on. Raises LinkLost if the servo is closed.
        """
        self.require_open()
        self._limits = None
        self.live = True
        try:
            with self._repeats.active():
                yield
        except BaseException:
            with contextlib.suppress(DriverError):
                self.force_off()
            raise
        self._limits = limits

    def fall_silent(self) -> None:
        """Send no set-point any more and leave the device as it is: its torque may be on.

        `Command.rest()` only reads from now on, as on a disarmed servo, and `disarm` still requests torque-off.
        """
        self._limits = None

    def force_off(self) -> None:
        """Disarm a device that may be live although it was disarmed. Raises as `disarm`."""
        self.live = True
        self.disarm()

    def disarm(self) -> None:
        """Request torque-off up to three times, until the device confirms it. No effect where it is off already.

        Raises LinkLost if the link is gone, else DriverError, where it is not confirmed; it may be called again.
        """
        self._limits = None
        if not self.live or self._closed:
            return
        reason: DriverError | None = None
        for request in range(_REQUESTS):
            try:
                self._torque_off(request)
            except DriverError as error:
                reason = error
            else:
                self.live = False
                return
        kind = LinkLost if isinstance(reason, LinkLost) else DriverError
        raise kind(f"torque-off is not confirmed ({reason}): the motor may be live; cut the drive's power") from reason

    def close(self, restore: Callable[[], None] | None = None) -> None:
        """Request torque-off, `restore` what was changed in the device, and close the link. Never raises DriverError.

        No effect where the servo is closed already. To know that the torque is off, call `disarm` first.
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


@runtime_checkable
class FallsSilent(Protocol):
    """A servo that can stop sending set-points while its torque is on, so that its watchdog can be tried."""

    def fall_silent(self) -> None:
        """See `Gate.fall_silent`."""


def to_counts(value: float, lsb: float) -> int:
    """Return `value` in counts of `lsb`, rounded. Raises UnsafeCommand if the number cannot be encoded."""
    counts = value / lsb
    if not math.isfinite(counts):
        raise UnsafeCommand(f"set-point {value} cannot be encoded in counts of {lsb}: nothing was sent")
    return round(counts)


def watchdog_problem(table: str, watchdog: float, reply_timeout: float) -> str:
    """Return the reason why a watchdog of `watchdog` s (0: none) is too short in [`table`] of stand.toml, else ""."""
    if not 0.0 < watchdog < 2.0 * reply_timeout:
        return ""
    return (
        f"{table}.watchdog {watchdog} s is not above twice {table}.reply_timeout {reply_timeout} s: "
        "one lost reply would stop the motor"
    )


def check_watchdog(table: str, watchdog: float, reply_timeout: float) -> None:
    """Raise ValueError if `watchdog_problem` finds a reason."""
    if problem := watchdog_problem(table, watchdog, reply_timeout):
        raise ValueError(problem)
