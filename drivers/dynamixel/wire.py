"""The two DYNAMIXEL protocols: encode requests and decode replies. No I/O.

Source: e-manual, emanual.robotis.com/docs/en/dxl/protocol1/ and .../protocol2/.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynamixel_sdk import Protocol2PacketHandler

from drivers.packets.wire import Answer, Wire1

if TYPE_CHECKING:
    from collections.abc import Iterator

    from drivers.packets.port import SerialPort

_STATUS = 0x55

_REFUSALS_2 = {
    1: "it could not execute the request",
    2: "it does not have that instruction",
    4: "the value is out of range, or a tripped bus watchdog blocks it",
    5: "the length does not fit the register",
    6: "the value is beyond the limit set in the servo",
    7: "there is no such register, or it cannot be written while the torque is on",
}


class Wire2:
    """DYNAMIXEL protocol 2.0.

    A packet that contains FF FF FD needs byte stuffing: a byte FD is inserted behind these bytes. dynamixel-sdk does
    not stuff requests and removes the stuffing of some replies wrongly, so this class stuffs and unstuffs instead.
    """

    status_size = 11
    _header = b"\xff\xff\xfd\x00"
    _ping_answer = 14

    def __init__(self) -> None:
        self._packets = Protocol2PacketHandler()

    def frame(self, ident: int, instruction: int, parameters: bytes) -> bytes:
        """Return the bytes of a request to the servo `ident`."""
        body = (bytes([instruction]) + parameters).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        frame = self._header + bytes([ident]) + (len(body) + 2).to_bytes(2, "little") + body
        return frame + self._checksum(frame)

    def place(self, *numbers: int) -> bytes:
        """Return addresses and lengths, each as two bytes."""
        return b"".join(number.to_bytes(2, "little") for number in numbers)

    def receive(self, port: SerialPort) -> tuple[bytes, int]:
        """See `Wire`."""
        # `fast` stops the SDK from unstuffing; it also accepts the broadcast id, nothing else differs
        raw, result = self._packets.rxPacket(port, True)
        return bytes(raw), result

    def opened(self, raw: bytes) -> Answer | None:
        """See `Wire`. The alert is bit 0x80 of the error byte."""
        body = raw[7 : 5 + int.from_bytes(raw[5:7], "little")].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        if body[:1] != bytes([_STATUS]) or len(body) < 2:
            return None
        number = body[1] & 0x7F
        refused = _REFUSALS_2.get(number, f"error {number}") if number not in {0, 3} else ""
        return Answer(raw[4], body[1] & 0x80, number == 3, refused, body[2:])

    def pings(self, received: bytes) -> Iterator[tuple[int, int]]:
        """See `Wire`."""
        for part in received.split(self._header)[1:]:
            answer = self._header + part[: self._ping_answer - len(self._header)]
            if len(answer) == self._ping_answer and answer[-2:] == self._checksum(answer[:-2]):
                yield answer[4], int.from_bytes(answer[9:11], "little")

    def _checksum(self, data: bytes) -> bytes:
        checksum: int = self._packets.updateCRC(0, data, len(data))
        return checksum.to_bytes(2, "little")


_ALERTS_1 = 0x25  # voltage, heat, overload
_DAMAGED_1 = 0x10
_REFUSALS_1 = {
    0x02: "the position is outside its angle limits",
    0x08: "the value is out of range",
    0x40: "it does not have that instruction",
}


def wire_1() -> Wire1:
    """Return protocol 1.0 with the error bits of DYNAMIXEL servos."""
    return Wire1(_ALERTS_1, damaged=_DAMAGED_1, refusals=_REFUSALS_1)
