"""A serial port that ends in an emulator in virtual time: no I/O, and a wait for bytes is what makes time pass."""

from __future__ import annotations

import errno
import heapq
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.clock import Clock
    from sim_backend.wire.uart.pty_line import SerialPeer

_POLL = 2e-3  # s that a read waits


class SerialLoopback:
    """What an adapter needs of a port, with `peer` behind it. baudrate: bit/s that the host set."""

    def __init__(self, peer: SerialPeer, clock: Clock, baudrate: int | None = None) -> None:
        self.sent = bytearray()
        self.closed = False
        self._peer = peer
        self._clock = clock
        self._baudrate = baudrate
        self._due: list[tuple[float, int, bytes]] = []
        self._count = 0
        self._here = bytearray()

    @property
    def in_waiting(self) -> int:
        """Bytes that have arrived. Raises OSError where the port is gone, as all below."""
        self._hear(b"")
        while self._due and self._due[0][0] <= self._clock.now():
            self._here += heapq.heappop(self._due)[2]
        return len(self._here)

    def read(self, size: int = 1, /) -> bytes:
        """Up to `size` bytes; waits for them until the poll is over."""
        end = self._clock.now() + _POLL
        while self.in_waiting < size and self._clock.now() < end:
            self._clock.sleep_until(min(end, self._due[0][0]) if self._due else end)
        out = bytes(self._here[:size])
        del self._here[:size]
        return out

    def write(self, data: bytes, /) -> int:
        """Send `data`."""
        self.sent += data
        self._hear(data)
        return len(data)

    def reset_input_buffer(self) -> None:
        """Throw away what has arrived."""
        if self.in_waiting:
            self._here.clear()

    def close(self) -> None:
        """Let go of it."""
        self.closed = True

    def _hear(self, data: bytes) -> None:
        if self.closed or self._peer.unplugged:
            raise OSError(errno.EIO, "device disconnected")
        for at, reply in self._peer.receive(data, self._clock.now(), self._baudrate):
            self._count += 1
            heapq.heappush(self._due, (at, self._count, reply))
