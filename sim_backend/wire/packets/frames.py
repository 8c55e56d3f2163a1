"""The packets of DYNAMIXEL protocol 2.0 as a servo handles them: decode instructions and encode replies. No I/O and no
time.

Source: ROBOTIS e-manual, "Protocol 2.0" (emanual.robotis.com/docs/en/dxl/protocol2/) and "CRC calculation"
(docs/en/dxl/crc/).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
LONGEST = 1024
"""The largest value of the length field that is accepted; a packet with a larger value is taken as noise."""
SILENCE = 0.1
"""s without a byte after which a servo discards an incomplete packet ("Protocol 1.0", Instruction Packet)."""


class Instruction(IntEnum):
    """The instructions of protocol 2.0, with the numbers of the manual's table."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    BACKUP = 0x20
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


class Error(IntEnum):
    """The error number of a status packet. Bit 7 of the same byte is the alert."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


@dataclass(frozen=True, slots=True)
class Frame:
    """A received instruction packet. sound: whether its checksum is right. size: number of its bytes on the wire, with
    stuffing.
    """

    id: int
    instruction: int
    parameters: bytes
    sound: bool
    size: int


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = (value << 1) ^ 0x8005 if value & 0x8000 else value << 1
        table.append(value & 0xFFFF)
    return tuple(table)


_CRC = _crc_table()


def crc(data: bytes, start: int = 0) -> int:
    """Return the 16 bit checksum of `data`: polynomial 0x8005, most significant bit first, with the initial value
    `start`.
    """
    value = start
    for byte in data:
        value = ((value << 8) & 0xFFFF) ^ _CRC[(value >> 8) ^ byte]
    return value


def stuffed(payload: bytes) -> bytes:
    """Return `payload` (instruction to last parameter) with a byte FD inserted after every FF FF FD."""
    return payload.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuffed(payload: bytes) -> bytes:
    """Return `payload` without the bytes that `stuffed` inserted."""
    return payload.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def packet(ident: int, payload: bytes) -> bytes:
    """Return a packet to or from `ident`. payload: instruction and parameters."""
    body = stuffed(payload)
    frame = HEADER + bytes([ident]) + (len(body) + 2).to_bytes(2, "little") + body
    return frame + crc(frame).to_bytes(2, "little")


def status(ident: int, error: int, parameters: bytes = b"") -> bytes:
    """Return a status packet from the servo `ident`."""
    return packet(ident, bytes([Instruction.STATUS, error]) + parameters)


class Taken(NamedTuple):
    """The beginning of a stream of bytes. frame: its packet; None if the stream begins with bytes of no packet. used:
    the length of this packet, or of these bytes.
    """

    frame: Frame | None
    used: int


class Framer:
    """Finds packets in a stream of bytes, which may arrive in any pieces and with junk between packets.

    take: the protocol's function `take_packet`, which returns None if more bytes are needed.
    """

    def __init__(self, take: Callable[[bytes], Taken | None]) -> None:
        self._take = take
        self._rest = b""
        self._heard = 0.0

    def feed(self, data: bytes, begin: float = 0.0, end: float = 0.0) -> list[tuple[Frame, int]]:
        """Add `data` to the stream. Return the packets that are complete now, each with the number of bytes of `data`
        up to its end.

        begin, end: s, when the first byte of `data` begins and the last byte ends.
        """
        if data:
            self._rest = b"" if begin - self._heard > SILENCE else self._rest
            self._heard = end
        before = len(self._rest)
        self._rest += data
        used = 0
        found = []
        while (taken := self._take(self._rest)) is not None:
            self._rest = self._rest[taken.used :]
            used += taken.used
            if taken.frame is not None:
                found.append((taken.frame, max(0, used - before)))
        return found


def take_packet(rest: bytes) -> Taken | None:
    """Return the packet or the junk with which `rest` begins; None if more bytes are needed. Status packets of other
    devices count as junk.

    After a packet with a wrong checksum the search continues behind the packet's header, so that a damaged length field
    loses only the bytes of that packet.
    """
    at = rest.find(HEADER)
    if at < 0:
        at = len(rest) - next((n for n in (3, 2, 1) if rest.endswith(HEADER[:n])), 0)
    if at > 0:
        return Taken(None, at)
    if len(rest) < 7:
        return None
    length = int.from_bytes(rest[5:7], "little")
    if rest[4] in {0xFD, 0xFF} or not 3 <= length <= LONGEST:
        return Taken(None, len(HEADER))
    total = 7 + length
    if len(rest) < total:
        return None
    sound = crc(rest[: total - 2]) == int.from_bytes(rest[total - 2 : total], "little")
    body = unstuffed(rest[7 : total - 2])
    frame = Frame(rest[4], body[0], body[1:], sound, total)
    return Taken(None if frame.instruction == Instruction.STATUS else frame, total if sound else len(HEADER))


def writes(frame: Frame) -> list[tuple[int, int, bytes]]:
    """Return the writes of a Sync Write or Bulk Write, each as (id, address, data); an empty list for any other
    instruction.
    """
    p, out = frame.parameters, []
    if frame.instruction == Instruction.SYNC_WRITE:
        address, size = _words(p)
        return [(p[i], address, p[i + 1 : i + 1 + size]) for i in range(4, len(p) - size, size + 1)]
    while frame.instruction == Instruction.BULK_WRITE and len(p) >= 5:
        address, size = _words(p[1:])
        out.append((p[0], address, p[5 : 5 + size]))
        p = p[5 + size :]
    return out


def reads(frame: Frame) -> list[tuple[int, int, int]]:
    """Return the reads of a Sync Read or Bulk Read, fast or not, each as (id, address, size); an empty list for any
    other instruction.
    """
    p = frame.parameters
    if frame.instruction in {Instruction.SYNC_READ, Instruction.FAST_SYNC_READ}:
        return [(ident, *_words(p)) for ident in p[4:]]
    if frame.instruction in {Instruction.BULK_READ, Instruction.FAST_BULK_READ}:
        return [(p[i], *_words(p[i + 1 :])) for i in range(0, len(p) - 4, 5)]
    return []


def _words(p: bytes) -> tuple[int, int]:
    return int.from_bytes(p[:2], "little"), int.from_bytes(p[2:4], "little")
