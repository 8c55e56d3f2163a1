"""Packets on a line of servos: encoding of requests and decoding of replies, without I/O.

Protocol 1.0 of DYNAMIXEL is also what other vendors' servos speak, with error bits of their own. Source: e-manual,
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
    """A status packet with a valid checksum.

    alert: the hardware errors it reports, 0 for none. damaged: whether the request reached the servo damaged.
    refused: why the servo refused the request, "" if it did not.
    """

    ident: int
    alert: int
    damaged: bool
    refused: str
    data: bytes


class Wire(Protocol):
    """One of the protocols. status_size: bytes of a status packet without parameters."""

    status_size: int

    def frame(self, ident: int, instruction: int, parameters: bytes) -> bytes:
        """Return the bytes of a request."""

    def place(self, *numbers: int) -> bytes:
        """Return addresses and lengths as the protocol encodes them."""

    def receive(self, port: SerialPort) -> tuple[bytes, int]:
        """Return the packet that the SDK reads from `port`, and its result. Raises IndexError for a bad length."""

    def opened(self, raw: bytes) -> Answer | None:
        """Return the content of a packet from `receive`; None if it is no status packet."""

    def pings(self, received: bytes) -> Iterator[tuple[int, int]]:
        """Yield id and model number (0 where the protocol has none) of each reply to a ping in received bytes."""


class Wire1:
    """Protocol 1.0. Every status packet carries the servo's hardware errors, and none names its request.

    alerts: the bits of the error byte that are hardware errors. damaged: the bit for a request with a wrong checksum.
    refusals: by bit, why a request was refused.
    """

    status_size = 6

    def __init__(self, alerts: int, *, damaged: int = 0, refusals: Mapping[int, str] = MappingProxyType({})) -> None:
        self._packets = Protocol1PacketHandler()
        self._alerts = alerts
        self._damaged = damaged
        self._refusals = refusals

    def frame(self, ident: int, instruction: int, parameters: bytes) -> bytes:
        """Return the bytes of a request."""
        body = bytes([ident, len(parameters) + 2, instruction]) + parameters
        return b"\xff\xff" + body + bytes([~sum(body) & 0xFF])

    def place(self, *numbers: int) -> bytes:
        """Return one byte for each."""
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
        """See `Wire`; the model number is not reported."""
        for part in received.split(b"\xff\xff")[1:]:
            if len(part) == 4 and part[1] == 2 and part[3] == ~sum(part[:3]) & 0xFF:
                yield part[0], 0
