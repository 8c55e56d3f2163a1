"""Decode the subframes of moteus' multiplex protocol, and encode the replies, as a controller does.

Source: mjbots/moteus docs/protocol/can.md. From a frame that is cut short, the complete subframes are executed.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

FLOAT = 3
NOP = 0x50
CODES = "bhif"
LARGEST = (127, 32767, 2147483647)
_LARGEST_FLOAT = 3.4028234e38


@dataclass(frozen=True, slots=True)
class Write:
    """A subframe that writes consecutive registers from `start` on. kind: encoding of the values: 0 int8, 1 int16, 2
    int32, 3 float.
    """

    kind: int
    start: int
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Read:
    """A subframe that requests `count` consecutive registers from `start` on."""

    kind: int
    start: int
    count: int


@dataclass(frozen=True, slots=True)
class Say:
    """A subframe with text for the console on `channel`."""

    channel: int
    text: bytes


@dataclass(frozen=True, slots=True)
class Poll:
    """A subframe that requests up to `most` bytes from the console on `channel`."""

    channel: int
    most: int


Subframe = Write | Read | Say | Poll


class Reader:
    """Decodes the data of a frame."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def subframes(self) -> list[Subframe]:
        """Return all complete subframes."""
        out: list[Subframe] = []
        try:
            while self._at < len(self._data):
                item = self._next()
                if item is not None:
                    out.append(item)
        except (IndexError, struct.error, ValueError):
            pass  # the rest is cut short or unknown
        return out

    def _next(self) -> Subframe | None:
        first = self._byte()
        if first == NOP:
            return None
        if first in {0x40, 0x42}:
            channel, size = self._varuint(), self._varuint()
            if first == 0x42:
                return Poll(channel, size)
            text = self._data[self._at : self._at + size]
            self._at += size
            return Say(channel, text)
        family, kind = first >> 4, first >> 2 & 3
        if family not in {0, 1}:
            raise ValueError(first)
        count = first & 3 or self._varuint()
        start = self._varuint()
        if family == 1:
            return Read(kind, start, count)
        layout = struct.Struct(f"<{count}{CODES[kind]}")
        values = layout.unpack_from(self._data, self._at)
        self._at += layout.size
        return Write(kind, start, values)

    def _byte(self) -> int:
        value = self._data[self._at]
        self._at += 1
        return value

    def _varuint(self) -> int:
        value = shift = 0
        while True:
            byte = self._byte()
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80 or shift > 28:
                return value


def varuint(value: int) -> bytes:
    """Encode a number as a varuint: seven bits in each byte, the lowest bits first."""
    out = bytearray()
    while True:
        out.append(value & 0x7F | (0x80 if value > 0x7F else 0))
        value >>= 7
        if not value:
            return bytes(out)


def reply(kind: int, start: int, raw: list[float]) -> bytes:
    """Return the subframe that answers a read. raw: the values in counts, or floats, encoded as `kind`."""
    head = bytes([0x20 | kind << 2 | (len(raw) if len(raw) < 4 else 0)])
    count = b"" if len(raw) < 4 else varuint(len(raw))
    values = [value if kind == FLOAT else int(value) for value in raw]
    return head + count + varuint(start) + struct.pack(f"<{len(raw)}{CODES[kind]}", *values)


def refusal(writing: bool, number: int, code: int = 1) -> bytes:
    """Return the subframe that refuses register `number` with the error `code`. writing: whether a write is refused,
    else a read.
    """
    return bytes([0x30 if writing else 0x31]) + varuint(number) + varuint(code)


def console(channel: int, text: bytes) -> bytes:
    """Return the subframe that sends the console's text on `channel`."""
    return bytes([0x41]) + varuint(channel) + varuint(len(text)) + text


def counted(value: float, unit: tuple[float, float, float] | None, kind: int) -> float:
    """Return a value in counts of the encoding `kind`, as it is sent. unit: value of one count as int8, int16 and
    int32.

    Counts are limited to the range of `kind`; NaN becomes the lowest count. Without a unit the value itself is the
    count and wraps at the range.
    """
    if kind == FLOAT:
        return value if not abs(value) > _LARGEST_FLOAT else math.copysign(math.inf, value)
    if unit is None and math.isfinite(value):
        span = 1 << 8 * (1 << kind)
        return (int(value) + span // 2) % span - span // 2
    if unit is None or not math.isfinite(value):
        return -LARGEST[kind] - 1
    return max(-LARGEST[kind], min(LARGEST[kind], int(value / unit[kind])))


def valued(raw: float, unit: tuple[float, float, float] | None, kind: int) -> float:
    """Return the value of the received counts `raw` in the encoding `kind`; the lowest count means NaN. unit: value of
    one count as int8, int16 and int32.
    """
    if kind == FLOAT or unit is None:
        return float(raw)
    return math.nan if raw == -LARGEST[kind] - 1 else raw * unit[kind]
