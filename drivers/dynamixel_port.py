"""A serial port for dynamixel-sdk that waits without spinning and never past its deadline.

The SDK's own port reads without blocking, so that it spins a core; measures time with the wall clock, which steps;
allows 34 ms at least for a reply; opens without a lock, so that two programs may drive one servo; and has no limit on
how long a write may hang.
"""

from __future__ import annotations

import contextlib
import errno
from typing import TYPE_CHECKING

import serial
from dynamixel_sdk import PortHandler

from drivers.servo import DriverError

if TYPE_CHECKING:
    from drivers.servo import Clock

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
BUDGET = 4096
"""Bytes looked at for one reply; a line that never falls silent must not hold us."""
SILENT_FOR = 2e-3
"""s without a byte after which the line counts as silent."""
PATIENCE = 0.1
"""s that the line may take to fall silent."""

_REMEDIES = {
    errno.ENOENT: "there is no such port: check the cable, and the name with `hil doctor`",
    errno.EACCES: "no permission: add yourself to the group that owns it (dialout on Linux), then log in again",
    errno.EPERM: "no permission: add yourself to the group that owns it (dialout on Linux), then log in again",
    errno.EBUSY: "another program has it open: close that first",
    errno.EWOULDBLOCK: "another program has it open: close that first",
}


class SerialPort(PortHandler):  # type: ignore[misc]  # the SDK ships no types
    """The port `name` at `baudrate` bit/s. Names in camel case are the SDK's."""

    def __init__(self, name: str, baudrate: int, clock: Clock) -> None:
        super().__init__(name)
        self.baudrate = baudrate
        self._clock = clock
        self._deadline = 0.0
        self._budget = 0
        self._whole = 0
        self._ahead = bytearray()

    def openPort(self) -> bool:  # noqa: N802 - the SDK's name
        """Open it for us alone. Raises DriverError with the remedy."""
        try:
            self.ser = serial.Serial(
                self.port_name, self.baudrate, timeout=POLL, write_timeout=WRITE_TIMEOUT, exclusive=True
            )
        except _NOT_OPENED as error:
            number = getattr(error, "errno", None)
            if number is None and "lock" in str(error):
                number = errno.EWOULDBLOCK
            remedy = _REMEDIES.get(number or 0, "it cannot be opened")
            raise DriverError(f"{self.port_name}: {remedy} ({error})") from None
        self.is_open = True
        with contextlib.suppress(ValueError, OSError, NotImplementedError, AttributeError):
            self.ser.set_low_latency_mode(True)  # a USB adapter may hold bytes back for 16 ms; a pty has no such mode
        return True

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        """Let go of it. Harmless when closed, or when the device is gone."""
        self.is_open = False
        if self.ser is not None:
            with contextlib.suppress(*GONE):
                self.ser.close()

    def expect(self, deadline: float, size: int) -> None:
        """Begin to wait for a reply of `size` bytes, until `deadline` s on the clock."""
        self._deadline = deadline
        self._budget = BUDGET
        self._whole = size
        self._ahead.clear()

    def readPort(self, length: int) -> bytes:  # noqa: N802 - the SDK's name
        """Up to `length` bytes; waits for them no longer than `POLL` and the deadline allow.

        The SDK asks for the head of a reply first. The first wait is for the whole of it: one wake-up instead of two.
        """
        if len(self._ahead) < length and self._budget > 0:
            wanted = max(length, self._whole) - len(self._ahead)
            self._whole = 0
            if self._clock.now() >= self._deadline:
                wanted = min(wanted, self.ser.in_waiting)
            data: bytes = self.ser.read(wanted) if wanted > 0 else b""
            self._budget -= len(data)
            self._ahead += data
        out = bytes(self._ahead[:length])
        del self._ahead[:length]
        return out

    def isPacketTimeout(self) -> bool:  # noqa: N802 - the SDK's name
        """Whether the deadline has passed, or more has been read than any reply can be."""
        return self._budget <= 0 or self._clock.now() >= self._deadline

    def drain(self) -> bool:
        """Throw away what arrives until the line is silent. False where it does not fall silent."""
        end = self._clock.now() + PATIENCE
        quiet_since = self._clock.now()
        while self._clock.now() < end:
            self.expect(self._clock.now() + POLL, 0)
            if self.readPort(256):
                quiet_since = self._clock.now()
            elif self._clock.now() - quiet_since >= SILENT_FOR:
                return True
        return False
