"""A serial port for dynamixel-sdk whose reads sleep instead of polling, and never wait longer than their deadline.

The SDK's own port has these faults: it reads without blocking and so keeps a core busy; it measures time with the wall
clock, which steps; it allows at least 34 ms for a reply; it opens without a lock, so that two programs can drive one
servo; it has no time limit for a write.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from dynamixel_sdk import PortHandler

from drivers.clock import no_later
from drivers.uart.adapter import Echo
from drivers.uart.port import GONE, POLL, open_port

if TYPE_CHECKING:
    from drivers.clock import Clock

BUDGET = 4096
"""Most bytes that are read for one reply: a line that never falls silent must not block this program."""
SILENT_FOR = 2e-3
"""s without a byte after which the line counts as silent, if the adapter holds no bytes back."""
PATIENCE = 0.1
"""s to wait for the line to fall silent."""


class SerialPort(PortHandler):  # type: ignore[misc]  # the SDK ships no types
    """The serial port `name` at `baudrate` bit/s, as dynamixel-sdk uses it. Method names in camel case are the
    SDK's.
    """

    def __init__(self, name: str, baudrate: int, clock: Clock) -> None:
        super().__init__(name)
        self.baudrate = baudrate
        self._clock = clock
        self._deadline = 0.0
        self._budget = 0
        self._whole = 0
        self._ahead = bytearray()
        self._echo = Echo()

    def openPort(self) -> bool:  # noqa: N802 - the SDK's name
        """Open the port with an exclusive lock. Raises DriverError with the remedy."""
        self.ser = open_port(self.port_name, self.baudrate)
        self.is_open = True
        return True

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        """Close the port. Has no effect if the port is closed already or the device is gone."""
        self.is_open = False
        if self.ser is not None:
            with contextlib.suppress(*GONE):
                self.ser.close()

    def expect(self, deadline: float, size: int) -> None:
        """Prepare to read a reply of `size` bytes. deadline: s on the clock."""
        self._deadline = no_later(deadline)
        self._budget = BUDGET
        self._whole = size
        self._ahead.clear()

    def writePort(self, packet: bytes) -> int:  # noqa: N802 - the SDK's name
        """Send `packet` and return how many of its bytes were accepted."""
        self._echo.sent(packet)
        return self.ser.write(packet) or 0

    def keep_echo(self) -> bool:
        """Return also the sent bytes from `readPort`, until the next request. Return whether the line returns any."""
        self._echo.sent(b"")
        return self._echo.returns

    def readPort(self, length: int) -> bytes:  # noqa: N802 - the SDK's name
        """Return up to `length` bytes. Waits for them no longer than `POLL`, and not after the deadline.

        The SDK reads the header of a reply first. The first wait is for the whole reply, so that the process wakes up
        once instead of twice.
        """
        if len(self._ahead) < length and self._budget > 0:
            wanted = max(length, self._whole) - len(self._ahead) + self._echo.due
            self._whole = 0
            if self._clock.now() >= self._deadline:
                wanted = min(wanted, self.ser.in_waiting)
            data: bytes = self.ser.read(wanted) if wanted > 0 else b""
            self._budget -= len(data)
            self._ahead += self._echo.without(data)
        out = bytes(self._ahead[:length])
        del self._ahead[:length]
        return out

    def isPacketTimeout(self) -> bool:  # noqa: N802 - the SDK's name
        """Return whether the deadline has passed, or more bytes were read than a reply can have."""
        return self._budget <= 0 or self._clock.now() >= self._deadline

    def drain(self, silence: float) -> bool:
        """Discard received bytes until none arrives for `silence` s. Return False if bytes still arrive `PATIENCE` s
        after the line could have been silent for so long.
        """
        self._echo.sent(b"")
        end = no_later(self._clock.now() + silence + PATIENCE)
        quiet_since = self._clock.now()
        while self._clock.now() < end:
            self.expect(self._clock.now() + POLL, 0)
            if self.readPort(256):
                quiet_since = self._clock.now()
            elif self._clock.now() - quiet_since >= silence:
                return True
        return False
