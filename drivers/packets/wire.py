"""Encode requests to servos and decode their replies (packets). No I/O.

Other vendors' servos also use protocol 1.0 of DYNAMIXEL, but their error bits differ. Source: e-manual,
emanual.robotis.com/docs/en/dxl/protocol1/.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, Protocol

from dynamixel_sdk import Protocol1PacketHandler

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from drivers.packets.port import SerialPort

PING, READ, WRITE, SYNC_WRITE = 0x01, 0x02, 0x03, 0x83
BROADCAST = 0xFE


class Answer(NamedTuple):
    """The content of a status packet whose checksum is right.

    alert: the hardware errors that the servo reports, 0 if there are none. damaged: whether the request reached the
    servo damaged. refused: why the servo refused the request, "" if it did not.
    """

    ident: int
    alert: int
    damaged: bool
    refused: str
    data: bytes


class Wire(Protocol):
    """The interface of a packet protocol. status_size: bytes of a status packet without parameters."""

    status_size: int

    def frame(self, ident: int, instruction: int, parameters: bytes) -> bytes:
        """Return the bytes of a request to the servo `ident`."""

    def place(self, *numbers: int) -> bytes:
        """Return addresses and lengths, each encoded as the protocol requires."""

    def receive(self, port: SerialPort) -> tuple[bytes, int]:
        """Read a packet from `port` with the SDK. Return its bytes and the SDK's result code. Raises IndexError for an
        impossible length.
        """

    def opened(self, raw: bytes) -> Answer | None:
        """Decode a packet from `receive`; return None if the packet is no status packet."""

    def pings(self, received: bytes) -> Iterator[tuple[int, int]]:
        """Find the replies to a ping in the received bytes. Yield id and model number of each (0 if the protocol has no
        model number).
        """


class Wire1:
    """Protocol 1.0. Every status packet carries the servo's hardware errors, but does not say which request it answers.

    alerts: the bits of the error byte that are hardware errors. damaged: the bit that means that the request had a
    wrong checksum. refusals: for each other bit, why the servo refused the request.
    """

    status_size = 6

    def __init__(self, alerts: int, *, damaged: int = 0, refusals: Mapping[int, str] = MappingProxyType({})) -> None:
        self._packets = Protocol1PacketHandler()
        self._alerts = alerts
        self._damaged = damaged
        self._refusals = refusals

    def frame(self, ident: int, instruction: int, parameters: bytes) -> bytes:
        """Return the bytes of a request to the servo `ident`."""
        body = bytes([ident, len(parameters) + 2, instruction]) + parameters
        return b"\xff\xff" + body + bytes([~sum(body) & 0xFF])

    def place(self, *numbers: int) -> bytes:
        """Return addresses and lengths, each as one byte."""
        return bytes(numbers)

    def receive(self, port: SerialPort) -> tuple[bytes, int]:
        """See `Wire`."""
        raw, result = self._packets.rxPacket(port)
        return bytes(raw), result

    def opened(self, raw: bytes) -> Answer | None:
        """See `Wire`."""
        if len(raw) < self.status_size or raw[3] != len(raw) - 4:
            return None
        bits = raw[4]
        refused = "; ".join(text for bit, text in self._refusals.items() if bits & bit)
        return Answer(raw[2], bits & self._alerts, bool(bits & self._damaged), refused, raw[5:-1])

    def pings(self, received: bytes) -> Iterator[tuple[int, int]]:
        """See `Wire`; the model number is always 0."""
        start = 0
        while (start := received.find(b"\xff\xff", start)) >= 0:
            part = received[start + 2 : start + 6]
            whole = len(part) == 4 and part[0] <= BROADCAST and part[1] == 2 and part[3] == ~sum(part[:3]) & 0xFF
            if whole:
                yield part[0], 0
            start += 6 if whole else 1  # a checksum of 0xFF looks like the beginning of a header
