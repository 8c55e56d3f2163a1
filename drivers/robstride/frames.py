"""The frames of RobStride's private protocol. Motors, parameters and faults are in table.toml.

The identifier of 29 bits holds a type (5 bits), a field (16 bits) and a destination (8 bits). In an operation frame the
field holds the torque; in a feedback it holds the motor's id, faults and mode. Angle, velocity and torque have 16 bits
each, high byte first. Each range is mapped to all counts, so that zero lies between two counts.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from functools import cache

from drivers.canbus.counts import Counts
from drivers.servo import BadReply, DeviceFault
from drivers.tables import table, texts_of

IDENTITY, OPERATE, FEEDBACK, ENABLE, STOP, READ, WRITE, FAULT, REPORTING = 0, 1, 2, 3, 4, 17, 18, 21, 24
"""Types of frames."""
COMMANDS = frozenset({ENABLE, STOP, WRITE})
"""Types that only a host sends, with its id in the field."""
BROADCAST = 0xFE
"""The destination of a motor's identity."""
ASK_VERSION, VERSION = bytes([0x00, 0xC4, 0, 0, 0, 0, 0, 0]), bytes([0x00, 0xC4, 0x56])
REPORT_NOTHING = bytes([1, 2, 3, 4, 5, 6, 0, 8])
STOPPED, RUNNING = 0, 2
"""Modes of a motor."""
WATCHDOG, RESTARTED, OTHER_HOST, REPORTED = 0x100, 0x101, 0x102, 1 << 24
"""Our codes beside the fault bits; REPORTED is added to the bits of a fault frame."""
_WRAPS, _CLAMPS, _WRAPS_SINCE = 4.0 * math.pi, 12.5, (0, 0, 2, 6)
_STATE = struct.Struct(">HHHH")


@dataclass(frozen=True, slots=True)
class RobstrideModel:
    """A RobStride model; table.toml explains the fields."""

    line: tuple[int, ...]
    velocity: float
    torque: float
    torque_uncertainty: float
    watchdog: bool = True


@dataclass(frozen=True, slots=True)
class RobstrideState:
    """A decoded feedback: position rad (NaN at the end of its range), velocity rad/s, torque N m, temperature degC,
    fault bits and mode.
    """

    position: float
    velocity: float
    torque: float
    temperature: float
    faults: int
    mode: int


@cache
def models() -> dict[str, RobstrideModel]:
    """Return the RobStride models by name."""
    rows = table("robstride")["models"]
    return {name: RobstrideModel(**(row | {"line": tuple(row["line"])})) for name, row in rows.items()}


@cache
def parameters() -> dict[str, tuple[int, struct.Struct]]:
    """Return the index and the `struct` layout of each parameter by name."""
    return {name: (index, struct.Struct(text)) for name, (index, text) in table("robstride")["parameters"].items()}


def identifier(kind: int, field: int, destination: int) -> int:
    """Return the identifier of a frame, from its type `kind`, its field and its destination."""
    return kind << 24 | field << 8 | destination


def parts(ident: int) -> tuple[int, int, int]:
    """Return type, field and destination of an identifier."""
    return ident >> 24 & 0x1F, ident >> 8 & 0xFFFF, ident & 0xFF


def position_range(firmware: tuple[int, ...]) -> float:
    """Return the full scale of the angle, rad. (An RS00 had 12.5 rad before firmware 0.0.2.6.)"""
    return _CLAMPS if firmware[:2] == _WRAPS_SINCE[:2] and firmware < _WRAPS_SINCE else _WRAPS


def fault(bits: int, reported: int) -> DeviceFault:
    """Return the error for a fault. bits: the fault bits of a feedback. reported: those of a fault frame, 0 without
    one, which are preferred.
    """
    name, found, code = ("reported", reported, REPORTED | reported) if reported else ("faults", bits, bits)
    texts = {int(bit): text for bit, text in table("robstride")[name].items()}
    return DeviceFault(code, f"the motor reports a fault, kept until its power is off: {texts_of(found, texts)}")


class Codec:
    """Decodes the feedback of one motor. The counts span plus and minus `position` rad, `velocity` rad/s and `torque` N
    m.
    """

    def __init__(self, position: float, velocity: float, torque: float) -> None:
        self.position, self.velocity, self.torque = (Counts(most, 16) for most in (position, velocity, torque))

    def state(self, field: int, data: bytes) -> RobstrideState:
        """Return the values of a feedback. Raises BadReply if the feedback is too short."""
        if len(data) != _STATE.size:
            raise BadReply(f"a reply of {len(data)} bytes is too short: the sample is dropped")
        position, velocity, torque, temperature = _STATE.unpack(data)
        return RobstrideState(
            position=self.position.inside(position),
            velocity=self.velocity.value(velocity),
            torque=self.torque.value(torque),
            temperature=0.1 * temperature,
            faults=field >> 8 & 0x3F,
            mode=field >> 14,
        )
