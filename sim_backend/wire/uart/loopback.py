"""A serial port with an emulator behind it, in virtual time and without I/O: waiting is what makes time pass."""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

from sim_backend.wire.arrivals import Arrivals

if TYPE_CHECKING:
    from drivers.clock import Clock
    from sim_backend.wire.uart.pty_line import SerialPeer

_POLL = 2e-3  # s that a read waits


class SerialLoopback:
    """A port to `peer`, as far as adapters use one. baudrate: bit/s that the host set. sent: every byte, in order."""

    def __init__(self, peer: SerialPeer, clock: Clock, baudrate: int | None = None) -> None:
        self.sent = bytearray()
        self.closed = False
        self._peer = peer
        self._clock = clock
        self._baudrate = baudrate
        self._arrivals = Arrivals[bytes]()
        self._here = bytearray()

    @property
    def in_waiting(self) -> int:
        """The number of bytes that have arrived. Raises OSError where the port is gone, as all below."""
        self._exchange(b"")
        for data in self._arrivals.until(self._clock.now()):
            self._here += data
        return len(self._here)

    def read(self, size: int = 1, /) -> bytes:
        """Return up to `size` bytes; waits for them until the poll is over."""
        end = self._clock.now() + _POLL
        while self.in_waiting < size and self._clock.now() < end:
            self._clock.sleep_until(min(end, self._arrivals.next()))
        out = bytes(self._here[:size])
        del self._here[:size]
        return out

    def write(self, data: bytes, /) -> int:
        """Send `data`."""
        self.sent += data
        self._exchange(data)
        return len(data)

    def reset_input_buffer(self) -> None:
        """Discard what has arrived."""
        if self.in_waiting:
            self._here.clear()

    def close(self) -> None:
        """Close it. No effect where it is closed."""
        self.closed = True

    def _exchange(self, data: bytes) -> None:
        if self.closed or self._peer.unplugged:
            raise OSError(errno.EIO, "device disconnected")
        self._arrivals.add(self._peer.receive(data, self._clock.now(), self._baudrate))
