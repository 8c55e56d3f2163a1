"""The near end of an emulated wire in virtual time and without I/O: waiting is what makes time pass."""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

import can

from sim_backend.wire.arrivals import Arrivals
from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.canbus.messages import from_message, to_message

if TYPE_CHECKING:
    from drivers.clock import Clock
    from sim_backend.wire.canbus.bus import CanBus
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


class CanLoopback(can.BusABC):
    """The bus that a program in the same process opens to reach the drives of `bus`. sent: every message, in order."""

    def __init__(self, bus: CanBus, clock: Clock) -> None:
        super().__init__(channel="loopback")
        self.bus = bus
        self.sent: list[can.Message] = []
        self.closed = False
        self._clock = clock
        self._arrivals = Arrivals[CanFrame]()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - python-can's signature
        """Give a message to the bus. Raises can.CanOperationError where the adapter is gone."""
        self._check()
        self.sent.append(msg)
        self._arrivals.add(self.bus.receive(from_message(msg), self._clock.now()))

    def advance(self) -> None:
        """Carry the bus to the clock's time; frames sent meanwhile wait to be read."""
        self._arrivals.add(self.bus.advance(self._clock.now()))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        end = self._clock.now() + (timeout or 0.0)
        while True:
            self._check()
            self.advance()
            for frame in self._arrivals.until(self._clock.now()):
                return to_message(frame), False
            following = min(self.bus.due(), self._arrivals.next())
            self._clock.sleep_until(min(following, end))
            if following > end:
                return None, False

    def shutdown(self) -> None:
        """Close it. No effect where it is closed."""
        if not self.closed:
            super().shutdown()
        self.closed = True

    def __del__(self) -> None:
        """Nothing to release: python-can's warns of a bus left open, in whichever thread collects the garbage."""

    def _check(self) -> None:
        if self.closed or self.bus.unplugged:
            raise can.CanOperationError("the adapter is gone")
