"""Opening a serial port for us alone, with the remedy where that fails; what every serial adapter shares."""

from __future__ import annotations

import contextlib
import errno
from typing import Protocol

import serial

from drivers.servo import DriverError

GONE: tuple[type[Exception], ...] = (serial.SerialException, OSError)
"""What a port raises once its device is gone; pyserial lets an error of termios through, which is no OSError."""
with contextlib.suppress(ImportError):  # POSIX only
    import termios

    GONE += (termios.error,)
_NOT_OPENED: tuple[type[Exception], ...] = (*GONE, ValueError)

POLL = 2e-3
"""s that one read waits for bytes: how far past a deadline a wait can run."""
WRITE_TIMEOUT = 0.05
"""s; without one, a write into a stuck port hangs for ever."""

REMEDIES = {
    errno.ENOENT: "there is no such port: check the cable, and the name with `hil doctor`",
    errno.EACCES: "no permission: add yourself to the group that owns it (dialout on Linux), then log in again",
    errno.EPERM: "no permission: add yourself to the group that owns it (dialout on Linux), then log in again",
    errno.EBUSY: "another program has it open: close that first",
    errno.EWOULDBLOCK: "another program has it open: close that first",
}


class Port(Protocol):
    """What an adapter needs of an open port: pyserial's `Serial`, or what a test brings."""

    @property
    def in_waiting(self) -> int:
        """Bytes that have come and were not read."""
        ...

    def read(self, size: int = 1, /) -> bytes:
        """Up to `size` bytes; waits for them no longer than `POLL`."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send `data`; how many bytes were taken."""
        ...

    def reset_input_buffer(self) -> None:
        """Throw away what has come."""
        ...

    def close(self) -> None:
        """Let go of it."""
        ...


def open_port(name: str, baudrate: int) -> serial.Serial:
    """The port `name` at `baudrate` bit/s. Raises DriverError with the remedy."""
    try:
        port = serial.Serial(name, baudrate, timeout=POLL, write_timeout=WRITE_TIMEOUT, exclusive=True)
    except _NOT_OPENED as error:
        number = getattr(error, "errno", None)
        if number is None and "lock" in str(error):
            number = errno.EWOULDBLOCK
        remedy = REMEDIES.get(number or 0, "it cannot be opened")
        raise DriverError(f"{name}: {remedy} ({error})") from None
    with contextlib.suppress(ValueError, OSError, NotImplementedError, AttributeError):
        port.set_low_latency_mode(True)  # a USB adapter may hold bytes back for 16 ms; a pty has no such mode
    return port
