"""The USB-CAN adapter that Damiao sells, a serial port, as a bus of python-can.

The serial port carries a CAN frame as 30 bytes when it is sent and 16 bytes when it is received, without a checksum.
Source: the maker's sheet of the adapter's serial frames; identifiers are little-endian, as in the maker's DM_Control.
python-can's own plugin (python-can-damiao 0.1.0) reads them big-endian, and loses all but the first frame of those that
arrive together.
"""

from __future__ import annotations

import struct
import time
from typing import TYPE_CHECKING

import can

from drivers.servo import DriverError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from drivers.uart.port import OpenPort

BITRATES = (1_000_000, 800_000, 666_000, 500_000, 400_000, 250_000, 200_000, 125_000, 100_000)
"""bit/s on the bus, in the order of the adapter's numbers."""
_SEND = struct.Struct("<HBBIIBIBBBB8sB")
_BEGIN, _SIZE, _FORWARD = 0xAA55, 30, 3  # 3: without a report of each frame that was sent
_RECEIVED = struct.Struct("<BBBI8sB")
_HEAD, _TAIL = 0xAA, 0x55
_FAILED, _FRAME, _REFUSED, _SET, _ERROR = (0x01, 0x02), 0x11, 0x03, 0x13, 0xEE
_BUS_OFF = 0x040
"""The class of an error frame, as Linux has it."""
_PATIENCE = 0.1  # s


class DamiaoFrames:
    """The bytes of the adapter. bitrate: bit/s on the bus. Raises ValueError
    for a bit rate that the adapter does not have.
    """

    def __init__(self, bitrate: int) -> None:
        self._command = bytes([0x55, 0x05, BITRATES.index(bitrate), 0xAA, 0x55])
        self._bitrate = bitrate
        self.part = b""

    def begin(self, port: OpenPort) -> None:
        """Set the bit rate. Raises DriverError if the adapter refuses it."""
        port.write(self._command)
        answers = (kind for kind, *_ in self._until(port, time.monotonic() + _PATIENCE))
        if next((kind for kind in answers if kind in {_SET, _REFUSED}), _SET) == _REFUSED:
            raise DriverError(f"Damiao's adapter refuses {self._bitrate} bit/s: plug it in anew")

    def encoded(self, message: can.Message) -> bytes:
        """Return the bytes with which the adapter sends a frame once."""
        data = bytes(message.data).ljust(8, b"\0")
        kind, extended = int(message.is_remote_frame), int(message.is_extended_id)
        head = (_BEGIN, _SIZE, _FORWARD, 1, 10, extended, message.arbitration_id, kind, message.dlc, 0, 0)
        return _SEND.pack(*head, data, 0)

    def received(self, port: OpenPort, deadline: float) -> can.Message | None:
        """Return the next frame, None if there is none until `deadline`, s. No byte behind it is read yet."""
        for kind, form, ident, data in self._until(port, deadline):
            if kind == _FRAME:
                return _message(form, ident, data)
            if kind in _FAILED or (kind == _ERROR and form):
                error = _BUS_OFF if (kind, form) == (_ERROR, 1) else 0
                return can.Message(arbitration_id=error, is_error_frame=True)
        return None

    def _until(self, port: OpenPort, deadline: float) -> Iterator[tuple[int, int, int, bytes]]:
        """Yield command, format, identifier and data of each message of the adapter until `deadline`, s."""
        while True:
            self.part += port.read(_RECEIVED.size - len(self.part))
            if len(self.part) < _RECEIVED.size:
                if time.monotonic() >= deadline:
                    return
                continue
            head, *content, tail = _RECEIVED.unpack(self.part)
            if (head, tail) == (_HEAD, _TAIL):
                self.part = b""
                yield content[0], content[1], content[2], content[3]
            else:  # bytes were lost
                at = self.part.find(_HEAD, 1)
                self.part = self.part[at:] if at > 0 else b""


def _message(form: int, ident: int, data: bytes) -> can.Message:
    remote, size = bool(form & 0x80), form & 0x3F
    return can.Message(
        arbitration_id=ident,
        is_extended_id=bool(form & 0x40),
        is_remote_frame=remote,
        dlc=size,
        data=None if remote else data[:size],
        check=True,  # a ValueError for what is no frame
    )
