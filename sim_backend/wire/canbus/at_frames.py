"""RobStride's emulated USB-CAN adapter on a pty, connected to an emulated bus.

Source: a capture of the maker's tool MotorStudio, and open clients. They do not show the following, which is assumed
here: an identifier of 11 bits is shifted left by 21, a request for data has bit 1 of the identifier's word and no data,
and a frame without its end is skipped. The port has 921600 bit/s.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.uart.pty_line import PtyLine

if TYPE_CHECKING:
    from sim_backend.wire.canbus.bus import CanBus, CanDelivery

_BAUDRATE = 921_600
_IDE, _RTR = 0b100, 0b010


class AtAdapter:
    """The emulated adapter: it takes received bytes and returns sent bytes."""

    def __init__(self, bus: CanBus) -> None:
        self._bus = bus
        self._bytes = b""

    @property
    def unplugged(self) -> bool:
        """Return whether the adapter has been unplugged."""
        return self._bus.unplugged

    def due(self) -> float:
        """Return the time, s, at which the next frame is received without a request."""
        return self._bus.due()

    def advance(self, now: float) -> None:
        """Simulate the bus up to `now`. The frames that its drives send without a request are lost."""
        self._bus.advance(now)

    def receive(self, data: bytes, now: float, baudrate: int | None = None) -> list[tuple[float, bytes]]:
        """Process the client's `data`. Return the bytes that the adapter sends up to `now`, each piece with its time,
        s. baudrate: bit/s of the client; None: the right one.
        """
        out = _texts(self._bus.advance(now))
        if baudrate not in {None, _BAUDRATE}:
            return out
        self._bytes += data
        while (begin := self._bytes.find(b"AT")) >= 0:
            self._bytes = self._bytes[begin:]
            if self._bytes.startswith(b"AT+AT\r\n"):
                self._bytes = self._bytes[7:]
                out.append((now, b"OK\r\n"))
                continue
            if len(self._bytes) < 7 or (self._bytes[6] <= 8 and len(self._bytes) < 9 + self._bytes[6]):
                break
            out += self._command(now)
        return out

    def _command(self, now: float) -> list[tuple[float, bytes]]:
        """Send the frame with which the received bytes begin; without its end, skip its head."""
        size = self._bytes[6]
        if size > 8 or self._bytes[7 + size : 9 + size] != b"\r\n":
            self._bytes = self._bytes[2:]
            return []
        word, data = int.from_bytes(self._bytes[2:6], "big"), self._bytes[7 : 7 + size]
        self._bytes = self._bytes[9 + size :]
        extended = bool(word & _IDE)
        frame = CanFrame(word >> 3 if extended else word >> 21, data, extended=extended, remote=bool(word & _RTR))
        return [] if self._bus.off else _texts(self._bus.receive(frame, now))


def _texts(deliveries: list[CanDelivery]) -> list[tuple[float, bytes]]:
    """Return received frames as bytes. The adapter reports no errors of the bus."""
    return [(at, _text(frame)) for at, frame in deliveries if not frame.error]


def _text(frame: CanFrame) -> bytes:
    word = (frame.ident << 3 | _IDE if frame.extended else frame.ident << 21) | (_RTR if frame.remote else 0)
    return b"AT" + word.to_bytes(4, "big") + bytes([len(frame.data)]) + frame.data + b"\r\n"


def at_line(link: Path, bus: CanBus) -> PtyLine:
    """Return a line that serves `bus` through RobStride's emulated adapter at `link`, a symlink to a pty."""
    return PtyLine(link, AtAdapter(bus))
