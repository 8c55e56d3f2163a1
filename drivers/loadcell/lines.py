"""Decode the lines that a torque cell prints. No I/O."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, NamedTuple

from drivers.servo import BadReply

if TYPE_CHECKING:
    from drivers.loadcell.config import LineFormat

FULL = 0x7FFFFF
"""The largest count of a 24 bit converter. Beyond its range an HX711 reports 7FFFFF or 800000 hex."""

_RAW = re.compile(r"(\d{1,10}),(-?\d{1,7})")
_VALUE = re.compile(r"-?\d+(\.\d*)?([eE][-+]?\d+)?")
_CHECKED = re.compile(r"(.*)\*([0-9A-Fa-f]{2})")


class Reading(NamedTuple):
    """One reading of the torque cell. micros: the board's clock, us; None if the line has no time. value: counts, or
    the printed value.
    """

    micros: int | None
    value: float


def parsed(line: str, form: LineFormat) -> Reading:
    """Decode a line. The line may end in a checksum: `*` and the exclusive or of its characters as two hex digits.

    form: the content of a line, as in `LoadCellConfig.format`. Raises BadReply if the line holds no reading or is
    damaged, or if the converter is beyond its range.
    """
    text = line.strip(" \t")
    checked = _CHECKED.fullmatch(text)
    if checked:
        text = checked[1]
        if _parity(text) != int(checked[2], 16):
            raise BadReply(f"the line {line!r} was damaged on the way: the reading is dropped")
    if form == "value":
        if not _VALUE.fullmatch(text) or not math.isfinite(float(text)):
            raise BadReply(f"the line {line!r} is no number: the reading is dropped")
        return Reading(None, float(text))
    match = _RAW.fullmatch(text)
    if not match:
        raise BadReply(f"the line {line!r} is not `micros,raw`: the reading is dropped")
    micros, raw = int(match[1]), int(match[2])
    if micros >= 1 << 32:
        raise BadReply(f"the line {line!r} holds more microseconds than a board counts: the reading is dropped")
    if not -FULL <= raw < FULL:
        raise BadReply(f"the converter is at the end of its range ({raw}): the cell is overloaded, or not connected")
    return Reading(micros, float(raw))


def _parity(text: str) -> int:
    parity = 0
    for character in text:
        parity ^= ord(character) & 0xFF
    return parity
