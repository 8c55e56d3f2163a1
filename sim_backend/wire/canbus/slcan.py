"""An emulated serial CAN adapter of the LAWICEL kind on a pty, connected to an emulated bus.

Source: the LAWICEL CANUSB manual for commands and replies; the CANable 2 firmware's additions for CAN FD (Yn, d, D, b,
B). A command ends with CR: Sn bit rate, Yn data bit rate, O L C open and close, V N version and serial number, F status
flags, t T data frame, r R remote frame. Replies: CR means done (z CR or Z CR for an accepted frame), BEL means refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from sim_backend.wire.canbus.frames import FD_LENGTHS, CanFrame
from sim_backend.wire.uart.pty_line import PtyLine

if TYPE_CHECKING:
    from sim_backend.wire.canbus.bus import CanBus, CanDelivery

OK, BELL = b"\r", b"\a"
BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000, 83_300)
"""bit/s of the commands S0 to S9 (S9 is CANable's)."""
LONGEST = 160


class SlcanAdapter:
    """The emulated adapter: it takes received text and returns its replies. bitrate: bit/s of the bus; None: the
    adapter accepts every bit rate that the client sets.
    """

    def __init__(self, bus: CanBus, *, bitrate: int | None = None) -> None:
        self._bus = bus
        self._bitrate = bitrate
        self._set: int | None = None
        self._text = bytearray()
        self._open = False
        self._listening = False

    @property
    def unplugged(self) -> bool:
        """Return whether the adapter has been unplugged."""
        return self._bus.unplugged

    def due(self) -> float:
        """Return the time at which a drive next sends a frame without a request, s."""
        return self._bus.due()

    def receive(self, data: bytes, now: float, _baudrate: int | None = None) -> list[tuple[float, bytes]]:
        """Process the client's `data`. Return the replies, and the frames that drives sent without a request up to
        `now`, each as text with its time, s.
        """
        out = self._texts(self._bus.advance(now))
        self._text += data
        while OK[0] in self._text:
            line, _, rest = bytes(self._text).partition(OK)
            self._text = bytearray(rest)
            if line:
                out += self._command(line, now)
        if len(self._text) > LONGEST:
            self._text.clear()
            out.append((now, BELL))
        return out

    def advance(self, now: float) -> None:
        """Simulate the bus up to `now`. The frames that its drives send without a request are lost."""
        self._bus.advance(now)

    def _command(self, line: bytes, now: float) -> list[tuple[float, bytes]]:
        letter = line[:1]
        if letter in b"tTrRdDbB":
            return self._transmit(line, now)
        answer = BELL
        if letter == b"S" and line[1:].isdigit() and not self._open and int(line[1:]) < len(BITRATES):
            self._set = BITRATES[int(line[1:])]
            answer = OK
        elif letter in b"sYMmZU" and not self._open:
            answer = OK
        elif letter in b"OL" and not self._open:
            self._open, self._listening = True, letter == b"L"
            answer = OK
        elif letter == b"C":
            answer = OK if self._open else BELL
            self._open = False
        elif letter == b"V":
            answer = b"V1013\r"
        elif letter == b"N":
            answer = b"NHIL1\r"
        elif letter == b"F" and self._open:
            answer = b"F80\r" if self._bus.off else b"F00\r"
        return [(now, answer)]

    def _transmit(self, line: bytes, now: float) -> list[tuple[float, bytes]]:
        frame = _parsed(line)
        if frame is None or not self._open or self._listening or self._bus.off:
            return [(now, BELL)]
        taken = b"Z\r" if frame.extended else b"z\r"
        if self._bitrate not in {None, self._set}:
            return [(now, taken)]  # nobody on the bus understands it
        return [(now, taken), *self._texts(self._bus.receive(frame, now))]

    def _texts(self, deliveries: list[CanDelivery]) -> list[tuple[float, bytes]]:
        """Return received frames as text. Error frames are left out: this kind of adapter reports errors only in reply
        to F.
        """
        return [(at, _text(frame)) for at, frame in deliveries if self._open and not frame.error]


def slcan_line(link: Path, bus: CanBus, *, bitrate: int | None = None) -> PtyLine:
    """Return a line that serves `bus` through an emulated adapter at `link`, a symlink to a pty."""
    return PtyLine(link, SlcanAdapter(bus, bitrate=bitrate), any_baudrate=True)


def _parsed(line: bytes) -> CanFrame | None:
    """Return the frame of a transmit command; None if the line is no valid transmit command."""
    letter = line[:1].decode("ascii")
    extended, remote, fd = letter in "TRDB", letter in "rR", letter in "dDbB"
    digits = 8 if extended else 3
    try:
        ident = int(line[1 : 1 + digits], 16)
        length = int(line[1 + digits : 2 + digits], 16)
        data = b"" if remote else bytes.fromhex(line[2 + digits :].decode("ascii"))
    except ValueError:
        return None
    wanted = 0 if remote else FD_LENGTHS[length]
    if (length > 8 and not fd) or len(data) != wanted or ident >= 1 << (29 if extended else 11):
        return None
    return CanFrame(ident, data, extended=extended, remote=remote, fd=fd, fast=letter in "bB")


def _text(frame: CanFrame) -> bytes:
    letter = ("b" if frame.fast else "d") if frame.fd else ("r" if frame.remote else "t")
    ident = f"{frame.ident:08X}" if frame.extended else f"{frame.ident:03X}"
    length = next(code for code, size in enumerate(FD_LENGTHS) if size >= len(frame.data))
    head = (letter.upper() if frame.extended else letter) + ident + f"{length:X}"
    return (head + frame.data.hex().upper()).encode("ascii") + OK
