"""The registers of an emulated moteus: the value of one count, and the value of a command register that a frame does
not write.

Source: mjbots/moteus docs/protocol/registers.md.
"""

from __future__ import annotations

import math

_POSITION = (0.01, 0.0001, 0.00001)
_VELOCITY = (0.1, 0.00025, 0.00001)
_ACCELERATION = (0.05, 0.001, 0.00001)
_TORQUE = (0.5, 0.01, 0.001)
_CURRENT = (1.0, 0.1, 0.001)
_VOLTAGE = (0.5, 0.1, 0.001)
_TEMPERATURE = (1.0, 0.1, 0.001)
_TIME = (0.01, 0.001, 0.000001)
_POWER = (10.0, 0.05, 0.0001)
_RATIO = (1.0 / 127.0, 1.0 / 32767.0, 1.0 / 2147483647.0)

UNITS: dict[int, tuple[float, float, float]] = (
    dict.fromkeys((0x001, 0x006, 0x020, 0x026, 0x038, 0x03B, 0x040, 0x041, 0x050, 0x052, 0x054), _POSITION)
    | dict.fromkeys((0x002, 0x01E, 0x021, 0x028, 0x039, 0x03C, 0x051, 0x053, 0x055), _VELOCITY)
    | {0x029: _ACCELERATION, 0x007: _POWER, 0x027: _TIME, 0x046: _TIME}
    | dict.fromkeys((0x003, 0x022, 0x025, *range(0x030, 0x035), 0x03A, 0x03D, 0x042, 0x045), _TORQUE)
    | dict.fromkeys((0x004, 0x005, 0x01C, 0x01D, 0x02C), _CURRENT)
    | dict.fromkeys((0x00D, 0x014, 0x015, 0x016, 0x019, 0x01A, 0x01B, 0x02A), _VOLTAGE)
    | dict.fromkeys((0x00A, 0x00E), _TEMPERATURE)
    | dict.fromkeys((0x010, 0x011, 0x012, 0x018, 0x023, 0x024, 0x02B, 0x043, 0x044, 0x047), _RATIO)
    | dict.fromkeys((*range(0x060, 0x065), *range(0x068, 0x06D), *range(0x076, 0x080), 0x073, 0x075), _RATIO)
)
"""The value of one count as int8, int16 and int32. A register that is missing here has no unit: its value is the
count.
"""

UNSET: dict[int, float] = dict.fromkeys(
    (*range(0x010, 0x013), *range(0x014, 0x017), *range(0x018, 0x01F), 0x020, 0x021, 0x022, 0x02D), 0.0
) | {
    0x023: 1.0,
    0x024: 1.0,
    0x025: math.nan,
    0x026: math.nan,
    0x027: 0.0,
    0x028: math.nan,
    0x029: math.nan,
    0x02A: math.nan,
    0x02B: 1.0,
    0x02C: math.nan,
    0x040: math.nan,
    0x041: math.nan,
}
"""The value of a command register that a frame does not write."""

COMMANDS = frozenset(UNSET)
READABLE = (
    frozenset(range(0x010))
    | frozenset(range(0x030, 0x03E))
    | frozenset(range(0x050, 0x056))
    | frozenset({0x058, 0x05C, 0x05D, 0x05E, 0x05F, 0x070, 0x071, 0x140, 0x141})
    | frozenset((*range(0x060, 0x065), *range(0x068, 0x06D), *range(0x072, 0x080)))
)
"""Registers that can be read, in addition to the command and identity registers."""
