"""The USB-CAN adapter that RobStride sells, a serial port, as a bus of python-can.

The serial port carries a CAN frame as "AT", the identifier in four bytes, the number of data bytes, the data, and CR
LF, without a checksum. An identifier of 29 bits is shifted left by 3 and has bit 2 set. Source: a capture of the
maker's tool MotorStudio, and open clients. They do not show the following, which is assumed here: an identifier of 11
bits is shifted left by 21, bit 1 requests data, and the bus has 1 Mbit/s.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import can

from drivers.servo import DriverError

if TYPE_CHECKING:
    from drivers.uart.port import OpenPort

BITRATE = 1_000_000
HANDSHAKE, READY = b"AT+AT\r\n", b"OK\r\n"
_HEAD, _END, _FIXED = b"AT", b"\r\n", 9
_EXTENDED, _REMOTE = 4, 2


class AtFrames:
    """The bytes of the adapter. bitrate: bit/s on the bus, which the adapter
    fixes. Raises DriverError for another bit rate.
    """

    def __init__(self, bitrate: int) -> None:
        if bitrate != BITRATE:
            raise DriverError(f"RobStride's adapter has {BITRATE} bit/s on the bus, not {bitrate}: use another adapter")
        self.part = b""

    def begin(self, port: OpenPort) -> None:
        """Shake hands with the adapter."""
        port.write(HANDSHAKE)
        deadline, answer = time.monotonic() + 0.1, b""
        while len(answer) < len(READY) and time.monotonic() < deadline:
            answer += port.read(len(READY) - len(answer))

    def encoded(self, message: can.Message) -> bytes:
        """Return the bytes with which the adapter sends a frame once."""
        ident = message.arbitration_id
        word = (ident << 3 | _EXTENDED if message.is_extended_id else ident << 21) | _REMOTE * message.is_remote_frame
        data = bytes(message.data)
        return _HEAD + word.to_bytes(4, "big") + bytes([len(data)]) + data + _END

    def received(self, port: OpenPort, deadline: float) -> can.Message | None:
        """Return the next frame, None if there is none until `deadline`, s. No byte behind it is read yet."""
        while True:
            size = self.part[6] if len(self.part) > 6 else 0
            missing = _FIXED + size - len(self.part)
            if not _HEAD.startswith(self.part[:2]) or size > 8 or (missing <= 0 and not self.part.endswith(_END)):
                at = self.part.find(_HEAD[:1], 1)  # bytes were lost
                self.part = self.part[at:] if at > 0 else b""
            elif missing <= 0:
                part, self.part = self.part, b""
                return _message(int.from_bytes(part[2:6], "big"), part[7:-2])
            else:  # the number of data bytes is known from the seventh byte on
                more = port.read(missing if len(self.part) > 6 else 7 - len(self.part))
                self.part += more
                if not more and time.monotonic() >= deadline:
                    return None


def _message(word: int, data: bytes) -> can.Message:
    extended, remote = bool(word & _EXTENDED), bool(word & _REMOTE)
    return can.Message(
        arbitration_id=word >> 3 if extended else word >> 21,
        is_extended_id=extended,
        is_remote_frame=remote,
        data=None if remote else data,
        check=True,  # a ValueError for what is no frame
    )
