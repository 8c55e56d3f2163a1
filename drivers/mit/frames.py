"""The frames of the MIT mini-cheetah protocol and of Damiao's registers. Motors and errors are in table.toml.

A command holds position (16 bits), velocity, kp, kd and torque (12 bits each). A reply holds the motor's id, position,
velocity and torque. High bits come first. Each value's range is mapped to all counts, so that zero lies between two
counts.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache
from typing import Literal

from drivers.canbus.counts import Counts
from drivers.servo import BadReply, DeviceFault
from drivers.tables import table

Family = Literal["cubemars", "damiao"]
REGISTERS_ID = 0x7FF
"""The CAN identifier to which register requests for a Damiao are sent."""
READ, WRITE, REFRESH = 0x33, 0x55, 0xCC
ENTER, LEAVE, CLEAR = (bytes([0xFF] * 7 + [last]) for last in (0xFC, 0xFD, 0xFB))
RESTARTED = 0x100
"""Fault code of this project: the motor no longer follows the command while armed, and reports no error."""
SERVO_CURRENT, SERVO_REPORT, SERVO_REPORTS = 0x01, 0x29, 0.11
"""Servo mode of an AK: high digits of the identifiers of 29 bits that set its current and that report its state, and s
in which a report comes (10 to 500 a second).
"""
DISABLED, ENABLED = 0, 1
LOST_COMMUNICATION = 13


@dataclass(frozen=True, slots=True)
class MitModel:
    """A CubeMars or Damiao model; table.toml explains the fields."""

    family: Family
    position: float
    velocity: float
    torque: float
    torque_uncertainty: float


@dataclass(frozen=True, slots=True)
class DamiaoRegister:
    """A register of a Damiao: its number and the `struct` layout of its value."""

    number: int
    layout: struct.Struct


@dataclass(frozen=True, slots=True)
class MitState:
    """A decoded reply: position rad (NaN at the end of its range), velocity rad/s, torque N m, temperature degC.
    status: state of a Damiao, or error code of an AK; 0 in short replies.
    """

    position: float
    velocity: float
    torque: float
    temperature: float
    status: int


@cache
def models() -> dict[str, MitModel]:
    """Return the CubeMars and Damiao models by name."""
    return {name: MitModel(**row) for name, row in table("mit")["models"].items()}


@cache
def registers() -> dict[str, DamiaoRegister]:
    """Return the registers of a Damiao by name."""
    return {
        name: DamiaoRegister(number, struct.Struct(text)) for name, (number, text) in table("mit")["registers"].items()
    }


def fault(family: Family, status: int) -> DeviceFault:
    """Return the error for `status`: an error code of an AK or a state of a Damiao. A status that is no error gives
    RESTARTED.
    """
    words = table("mit")["errors"][family].get(str(status))
    if status in {DISABLED, ENABLED} and words is None:
        return DeviceFault(
            RESTARTED, "the motor stopped following without an error: it has restarted; check its supply and plug"
        )
    return DeviceFault(status, f"the motor reports error {status}: {words or 'not known here, see its manual'}")


class Codec:
    """Encodes and decodes the frames of one motor. Its counts span plus and minus `position` rad, `velocity` rad/s and
    `torque` N m.
    """

    def __init__(self, family: Family, position: float, velocity: float, torque: float) -> None:
        self.family = family
        self.position, self.velocity, self.torque = Counts(position, 16), Counts(velocity, 12), Counts(torque, 12)

    def command(self, counts: int) -> bytes:
        """Return the data of a command with a torque of `counts`, and with kp and kd zero."""
        word = self.position.middle << 48 | self.velocity.middle << 36 | counts
        return word.to_bytes(8, "big")

    def state(self, data: bytes) -> MitState:
        """Decode a reply. Raises BadReply if the reply is too short."""
        if len(data) < (8 if self.family == "damiao" else 6):
            raise BadReply(f"a reply of {len(data)} bytes is too short: the sample is dropped")
        if self.family == "damiao":
            status, temperature = data[0] >> 4, float(max(data[6], data[7]))
        else:
            status, temperature = (data[7], float(data[6])) if len(data) >= 8 else (0, float("nan"))
        return MitState(
            position=self.position.inside(data[1] << 8 | data[2]),
            velocity=self.velocity.value(data[3] << 4 | data[4] >> 4),
            torque=self.torque.value((data[4] & 0xF) << 8 | data[5]),
            temperature=temperature,
            status=status,
        )
