"""Damiao's emulated USB-CAN adapter on a pty, connected to an emulated bus.

Source: the maker's sheet of the adapter's serial frames. The sheet does not state the following, which is assumed here.
Repetitions of a frame are `interval` times 0.1 ms apart. The reply to a handshake is "OK". When the adapter reports
that it sent a frame, the report contains the bytes of the frame. The adapter accepts any baud rate of the port, because
its USB controller is built in.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.uart.pty_line import PtyLine

if TYPE_CHECKING:
    from sim_backend.wire.canbus.bus import CanBus, CanDelivery

BITRATES = (1000, 800, 666, 500, 400, 250, 200, 125, 100, 80, 50, 40, 20, 10, 5)
"""kbit/s by the number in the command."""
HEARTBEAT, RECEIVED, SENT, RATE_SET, ERROR = 0x00, 0x11, 0x12, 0x13, 0xEE
"""Commands of what the adapter sends; without the high digit: the same has failed."""
_END = b"\xaa\x55"
_SHORT = {0x03: 4, 0x04: 4, 0x05: 5}
"""Lengths of the commands that begin with 55 and this byte: stop repeating, heartbeat, bit rate."""
_LONG, _PORT_RATE = 30, 11
_INTERVAL = 1e-4


@dataclass
class _Repeated:
    """A frame that is sent `left` times more: the next time at `due`, s, and then every `interval` s."""

    frame: CanFrame
    left: int
    interval: float
    due: float


class DamiaoAdapter:
    """The emulated adapter: it takes received bytes and returns sent bytes. bitrate: bit/s of the bus; None: any bit
    rate that the client sets is right.
    """

    def __init__(self, bus: CanBus, *, bitrate: int | None = None) -> None:
        self._bus = bus
        self._bitrate = bitrate
        self._set = 1_000_000
        self._bytes = bytearray()
        self._repeated: list[_Repeated] = []

    @property
    def unplugged(self) -> bool:
        """Return whether the adapter has been unplugged."""
        return self._bus.unplugged

    def due(self) -> float:
        """Return the time, s, at which the next frame is received or repeated without a request."""
        return min(self._bus.due(), min((one.due for one in self._repeated), default=math.inf))

    def receive(self, data: bytes, now: float, _baudrate: int | None = None) -> list[tuple[float, bytes]]:
        """Process the client's `data`. Return the bytes that the adapter sends up to `now`, each piece with its time,
        s.
        """
        out = self._repeat(now) + self._texts(self._bus.advance(now))
        self._bytes += data
        while (begin := self._bytes.find(0x55)) >= 0 and len(self._bytes) >= begin + 3:
            del self._bytes[:begin]
            size = self._size()
            if len(self._bytes) < size:
                break
            command = bytes(self._bytes[:size])
            del self._bytes[:size]
            out += self._command(command, now)
        if 0x55 not in self._bytes:
            self._bytes.clear()
        return out

    def advance(self, now: float) -> None:
        """Simulate the bus up to `now`. The frames that its drives send without a request are lost."""
        self._repeat(now)
        self._bus.advance(now)

    def _repeat(self, now: float) -> list[tuple[float, bytes]]:
        """Send the frames whose repetition is due, and return the replies and reports that follow."""
        out: list[tuple[float, bytes]] = []
        for one in self._repeated:
            while one.left and one.due <= now:
                out += self._sent(one.frame, one.due)
                one.left, one.due = one.left - 1, one.due + one.interval
        self._repeated = [one for one in self._repeated if one.left]
        return out

    def _size(self) -> int:
        """Return the length of the command with which the received bytes begin; 1 if the first byte begins no
        command.
        """
        kind, third = self._bytes[1], self._bytes[2]
        return (_LONG if third == _LONG else _PORT_RATE) if kind == _END[0] else _SHORT.get(kind, 1)

    def _command(self, command: bytes, now: float) -> list[tuple[float, bytes]]:
        if len(command) == _LONG:
            return self._forward(command, now)
        if not command.endswith(_END):
            return []
        if command[1] == 0x03:
            self._repeated.clear()
        elif command[1] == 0x04:
            return [(now, _report(HEARTBEAT))]
        elif command[1] == 0x05:
            known = command[2] < len(BITRATES)
            self._set = 1000 * BITRATES[command[2]] if known else self._set
            return [(now, _report(RATE_SET if known else RATE_SET & 0xF))]
        return []  # a new rate of the port too

    def _forward(self, command: bytes, now: float) -> list[tuple[float, bytes]]:
        kind, times, interval, extended, ident, remote, size = struct.unpack("<BIIBIBB", command[3:19])
        if kind == 2:
            return [(now, b"OK")]
        if kind not in {1, 3} or size > 8:
            return []
        frame = CanFrame(
            ident, b"" if remote else command[21 : 21 + size], extended=bool(extended), remote=bool(remote)
        )
        out = [(now, _report(SENT & 0xF if self._bus.off else SENT, frame))] if kind == 1 else []
        if times > 1:
            wait = max(1, interval) * _INTERVAL
            self._repeated.append(_Repeated(frame, times - 1, wait, now + wait))
        return out + self._sent(frame, now)

    def _sent(self, frame: CanFrame, now: float) -> list[tuple[float, bytes]]:
        if self._bus.off:
            return [(now, _report(ERROR, form=1))]
        if self._bitrate not in {None, self._set}:
            return []  # nobody on the bus understands it
        return self._texts(self._bus.receive(frame, now))

    def _texts(self, deliveries: list[CanDelivery]) -> list[tuple[float, bytes]]:
        """Return received frames as bytes. The only error frame that the adapter reports is that it is bus-off."""
        report = _report(ERROR, form=1)
        shown = [(at, frame) for at, frame in deliveries if self._bus.off or not frame.error]
        return [(at, report if frame.error else _report(RECEIVED, frame)) for at, frame in shown]


def damiao_line(link: Path, bus: CanBus, *, bitrate: int | None = None) -> PtyLine:
    """Return a line that serves `bus` through Damiao's emulated adapter at `link`, a symlink to a pty."""
    return PtyLine(link, DamiaoAdapter(bus, bitrate=bitrate), any_baudrate=True)


def _report(kind: int, frame: CanFrame | None = None, *, form: int = 0) -> bytes:
    if frame is None:
        return struct.pack("<BBBI8sB", 0xAA, kind, form, 0, bytes(8), 0x55)
    form = len(frame.data) | frame.extended << 6 | frame.remote << 7
    return struct.pack("<BBBI8sB", 0xAA, kind, form, frame.ident, frame.data, 0x55)
