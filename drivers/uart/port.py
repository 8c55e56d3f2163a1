"""Open a serial port with an exclusive lock, and the interface of an open port that every serial driver uses."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path
from typing import Protocol

import serial

from drivers.owner import holder, in_use
from drivers.servo import DriverError

GONE: tuple[type[Exception], ...] = (serial.SerialException, OSError)
"""The errors that mean that the port's device is gone. pyserial passes on termios.error, which is no OSError."""
with contextlib.suppress(ImportError):  # POSIX only
    import termios

    GONE += (termios.error,)

POLL = 2e-3
"""s that one read waits for bytes: a deadline is exceeded by no more than this."""
WRITE_TIMEOUT = 0.05
"""s for a write; without a limit a write to a stuck port blocks for ever."""

REMEDIES = {
    errno.ENOENT: "there is no such port: check the cable, and the name with `hil doctor`",
    errno.EACCES: "no permission: add yourself to the group that owns it (dialout on Linux), then log in again",
    errno.EPERM: "no permission: add yourself to the group that owns it (dialout on Linux), then log in again",
}
_TAKEN = frozenset({errno.EBUSY, errno.EWOULDBLOCK})


class OpenPort(Protocol):
    """An open serial port as the drivers use it: pyserial's `Serial`, or an object of a test."""

    @property
    def in_waiting(self) -> int:
        """The number of received bytes that have not been read."""

    def read(self, size: int = 1, /) -> bytes:
        """Return up to `size` bytes. Waits for them no longer than `POLL`."""

    def write(self, data: bytes, /) -> int | None:
        """Send `data`; return how many bytes were accepted."""

    def reset_input_buffer(self) -> None:
        """Discard received bytes."""

    def close(self) -> None:
        """Close the port."""


def open_port(name: str, baudrate: int) -> serial.Serial:
    """Open the port `name` at `baudrate` bit/s. Raises DriverError with the remedy."""
    try:
        port = serial.Serial(name, baudrate, timeout=POLL, write_timeout=WRITE_TIMEOUT, exclusive=True)
    except Exception as error:  # noqa: BLE001 - pyserial passes on what a port's driver and its conversions raise
        number = getattr(error, "errno", None)
        if number in _TAKEN or (number is None and "lock" in str(error)):
            raise in_use(name, holder(Path(name))) from None
        reason = os.strerror(number) if number else f"{type(error).__name__}: {error}"
        known = REMEDIES.get(number or 0, f"it cannot be opened ({reason}): check port and baud rate in the stand file")
        raise DriverError(f"{name}: {known}") from None
    hasten(port)
    return port


def hasten(port: object) -> None:
    """Set the USB adapter of a serial port to pass on received bytes at once, if the system can set that: an FTDI
    adapter delays them by 16 ms as delivered.
    """
    with contextlib.suppress(ValueError, OSError, NotImplementedError, AttributeError):
        port.set_low_latency_mode(True)  # type: ignore[attr-defined]  # a pty and a bus without a port have none
