"""Encode and decode moteus frames, which write and read registers in one CAN FD frame. Registers and faults are in
table.toml.

A frame is a sequence of subframes: one byte for kind and count, the first register, the values. The byte 0x50 pads the
frame. Received data may be wrong: a count or a length beyond the frame raises BadReply.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

from drivers.servo import BadReply, DeviceFault, DriverError
from drivers.tables import table

INT8, INT16, INT32, FLOAT = 0, 1, 2, 3
STOPPED, FAULT, POSITION, TIMEOUT = 0, 1, 10, 11
RESTARTED = 0x100
"""Fault code of this project: the controller is stopped although armed, and reports no fault."""
WATCHDOG = 0x101
"""Fault code of this project: the controller's watchdog tripped."""
_TYPES = (struct.Struct("<b"), struct.Struct("<h"), struct.Struct("<i"), struct.Struct("<f"))
_LOWEST = (-128, -(2**15), -(2**31))
_WRITE, _READ, _REPLY, _WRITE_ERROR, _READ_ERROR, _NOP = 0x00, 0x10, 0x20, 0x30, 0x31, 0x50
_CLIENT_DATA, _SERVER_DATA, _POLL = 0x40, 0x41, 0x42
_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_CHANNEL = 1


@dataclass(frozen=True, slots=True)
class MoteusRegister:
    """A register of a moteus: its number, and the value of one count when it is sent as int8, int16 or int32."""

    number: int
    scales: tuple[float, float, float]


@cache
def registers() -> dict[str, MoteusRegister]:
    """Return the registers by name."""
    return {
        name: MoteusRegister(row[0], (row[1], row[2], row[3])) for name, row in table("moteus")["registers"].items()
    }


@cache
def _by_number() -> dict[int, tuple[str, MoteusRegister]]:
    return {register.number: (name, register) for name, register in registers().items()}


def limiting(code: int) -> bool:
    """Return whether a fault code is no fault but only names the limit that acts on the torque."""
    return str(code) in table("moteus")["limiting"]


def fault(code: int) -> DeviceFault:
    """Return the error for the fault code of a controller in fault mode."""
    words = table("moteus")["faults"].get(str(code), "not known here, see its manual")
    return DeviceFault(code, f"the moteus reports fault {code}: {words}")


def restarted() -> DeviceFault:
    """Return the error for a controller that is stopped while armed."""
    return DeviceFault(RESTARTED, "the moteus stopped by itself without a fault: it has restarted; check its supply")


def timed_out(watchdog: float) -> DeviceFault:
    """Return the error for a controller that received no command for `watchdog` s and stopped."""
    return DeviceFault(
        WATCHDOG,
        f"the moteus received nothing for {watchdog:.3g} s and stopped by itself: find out what delayed the computer "
        "or the bus; a slow recording needs a longer moteus.watchdog",
    )


def write(name: str, resolution: int, *values: float) -> bytes:
    """Return the subframe that writes values to consecutive registers, the first of which is `name`.

    resolution: how values are encoded: floats are in the register's unit, integers are counts.
    """
    head = bytes([_WRITE | resolution << 2 | len(values), registers()[name].number])
    layout = _TYPES[resolution]
    return head + b"".join(layout.pack(value if resolution == FLOAT else int(value)) for value in values)


def read(name: str, resolution: int, count: int = 1) -> bytes:
    """Return the subframe that requests `count` consecutive registers, the first of which is `name`.

    resolution: how the controller must encode the values.
    """
    return bytes([_READ | resolution << 2 | count]) + _varuint(registers()[name].number)


def filled(subframes: Iterable[bytes]) -> bytes:
    """Join the subframes to the data of one frame, padded to a length that CAN FD has."""
    data = b"".join(subframes)
    length = next(size for size in _LENGTHS if size >= len(data))
    return data + bytes([_NOP]) * (length - len(data))


def console_write(text: bytes) -> bytes:
    """Return the subframe that sends `text` to the diagnostic console."""
    return bytes([_CLIENT_DATA, _CHANNEL, len(text)]) + text


def console_read(count: int = 48) -> bytes:
    """Return the subframe that requests up to `count` bytes from the diagnostic console."""
    return bytes([_POLL, _CHANNEL, count])


def is_console(data: bytes) -> bool:
    """Return whether a reply is from the diagnostic console."""
    return data[:1] == bytes([_SERVER_DATA])


def console_text(data: bytes) -> bytes:
    """Return the console's text in a reply. Raises BadReply if the reply holds none."""
    if len(data) < 3 or data[1] != _CHANNEL or len(data) < 3 + data[2]:
        raise BadReply("the console's reply is cut short")
    return bytes(data[3 : 3 + data[2]])


class Registers(dict[str, float]):
    """The registers of a reply by name, in their units. Reading a register that the reply lacks raises BadReply."""

    def __missing__(self, name: str) -> float:
        raise BadReply(f"a reply of the moteus has no register {name}: the sample is dropped")

    def whole(self, name: str) -> int:
        """Return a register as a whole number. Raises BadReply if the reply has no value for it."""
        value = self[name]
        if not math.isfinite(value):
            raise BadReply(f"a reply of the moteus has no value in register {name}: the sample is dropped")
        return int(value)


def answers(data: bytes) -> Registers:
    """Decode the registers in a reply, in their units; NaN if the controller has no value.

    Raises BadReply if the reply cannot be decoded, DriverError if the controller refuses a register.
    """
    out = Registers()
    place = 0
    while place < len(data):
        kind = data[place]
        if kind == _NOP:
            place += 1
        elif kind & 0xF0 == _REPLY:
            place = _values(data, place, out)
        elif kind in {_WRITE_ERROR, _READ_ERROR}:
            number, _ = _varuint_at(data, place + 1)
            what = "writing" if kind == _WRITE_ERROR else "reading"
            raise DriverError(
                f"the moteus refuses {what} register 0x{number:03x}: its firmware is too old or too new; "
                "update it with moteus_tool --flash"
            )
        else:
            raise BadReply(f"a reply holds 0x{kind:02x}, which is no subframe: the sample is dropped")
    return out


def _values(data: bytes, place: int, out: dict[str, float]) -> int:
    """Decode the reply subframe at position `place` of `data` into `out`. Return the position of the next subframe."""
    resolution, count = data[place] >> 2 & 3, data[place] & 3
    place += 1
    if count == 0:
        count, place = _varuint_at(data, place)
    number, place = _varuint_at(data, place)
    layout = _TYPES[resolution]
    if count * layout.size > len(data) - place:
        raise BadReply("a reply is shorter than its count: the sample is dropped")
    for i in range(count):
        raw = layout.unpack_from(data, place + i * layout.size)[0]
        if number + i in _by_number():
            name, register = _by_number()[number + i]
            out[name] = raw if resolution == FLOAT else _scaled(raw, register, resolution)
    return place + count * layout.size


def _scaled(raw: int, register: MoteusRegister, resolution: int) -> float:
    if register.scales == (1.0, 1.0, 1.0):
        return raw
    return math.nan if raw == _LOWEST[resolution] else raw * register.scales[resolution]


def _varuint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _varuint_at(data: bytes, place: int) -> tuple[int, int]:
    value = 0
    for i in range(5):
        if place + i >= len(data):
            break
        value |= (data[place + i] & 0x7F) << 7 * i
        if not data[place + i] & 0x80:
            return value, place + i + 1
    raise BadReply("a reply ends in the middle of a number: the sample is dropped")
