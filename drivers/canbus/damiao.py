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
import serial

from drivers.servo import DriverError
from drivers.uart.port import open_port

if TYPE_CHECKING:
    from collections.abc import Iterator

BAUDRATE = 921_600
"""bit/s of the serial port; an adapter with a USB controller of its own accepts any."""
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


def encoded(message: can.Message) -> bytes:
    """Return the bytes with which the adapter sends a frame once."""
    data = bytes(message.data).ljust(8, b"\0")
    kind, extended = int(message.is_remote_frame), int(message.is_extended_id)
    head = (_BEGIN, _SIZE, _FORWARD, 1, 10, extended, message.arbitration_id, kind, message.dlc, 0, 0)
    return _SEND.pack(*head, data, 0)


class DamiaoBus(can.BusABC):
    """The bus behind the adapter at the serial port `channel`. bitrate: bit/s on the bus.

    serialPortOrig: the open port; python-can's slcan bus uses this name too. Raises DriverError if the port cannot be
    opened or the adapter refuses the bit rate, ValueError for a bit rate that it does not have.
    """

    def __init__(self, channel: str, bitrate: int) -> None:
        command = bytes([0x55, 0x05, BITRATES.index(bitrate), 0xAA, 0x55])
        self.serialPortOrig = open_port(channel, BAUDRATE)
        self._part = b""
        super().__init__(channel)
        try:
            self.serialPortOrig.reset_input_buffer()
            self.serialPortOrig.write(command)
            answers = (kind for kind, *_ in self._until(time.monotonic() + _PATIENCE))
            if next((kind for kind in answers if kind in {_SET, _REFUSED}), _SET) == _REFUSED:
                raise DriverError(f"Damiao's adapter at {channel} refuses {bitrate} bit/s: plug it in anew")
        except BaseException:
            self.shutdown()
            raise

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - python-can's signature
        """Send a frame. Raises can.CanError if the port does not take it."""
        try:
            self.serialPortOrig.write(encoded(msg))
        except serial.SerialException as error:
            raise can.CanOperationError(f"the adapter takes no frame: {error}") from error

    def shutdown(self) -> None:
        """Close the port."""
        super().shutdown()
        self.serialPortOrig.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        for kind, form, ident, data in self._until(time.monotonic() + (timeout or 0.0)):
            if kind == _FRAME:
                return _message(form, ident, data), False
            if kind in _FAILED or (kind == _ERROR and form):
                error = _BUS_OFF if (kind, form) == (_ERROR, 1) else 0
                return can.Message(arbitration_id=error, is_error_frame=True), False
        return None, False

    def _until(self, deadline: float) -> Iterator[tuple[int, int, int, bytes]]:
        """Yield command, format, identifier and data of each message of the adapter until `deadline`, s. No byte behind
        the yielded message is read yet.
        """
        while True:
            self._part += self.serialPortOrig.read(_RECEIVED.size - len(self._part))
            if len(self._part) < _RECEIVED.size:
                if time.monotonic() >= deadline:
                    return
                continue
            head, *content, tail = _RECEIVED.unpack(self._part)
            if (head, tail) == (_HEAD, _TAIL):
                self._part = b""
                yield content[0], content[1], content[2], content[3]
            else:  # bytes were lost
                at = self._part.find(_HEAD, 1)
                self._part = self._part[at:] if at > 0 else b""


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
