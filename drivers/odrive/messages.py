"""CANSimple messages and error bits of ODrive axes. They are read from table.toml, which names the sources."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

from drivers.canbus.link import frame
from drivers.servo import BadReply, DeviceFault
from drivers.tables import table, texts_of

Layout = Literal["0.5", "0.6"]
"""The layout of the messages. 0.5: as in firmware 0.5.6, the last for the ODrive v3. 0.6: as in the firmware of Pro, S1
and Micro.
"""
RESTARTED = 0x1_0000_0000
"""Fault code of this project: the axis left closed loop without an error. It is above every error word."""
IDLE, CLOSED_LOOP = 1, 8
TORQUE_CONTROL, PASSTHROUGH = 1, 1
COMMAND_BITS = 5


@cache
def endpoint_names() -> dict[str, str]:
    """Return the vendor's name of each parameter that this project uses, by this project's name."""
    return dict(table("odrive")["endpoints"])


@dataclass(frozen=True, slots=True)
class Message:
    """A CANSimple message: its command number and the `struct` layout of its data."""

    name: str
    number: int
    layout: struct.Struct


@cache
def messages(layout: Layout) -> dict[str, Message]:
    """Return the messages of a firmware layout by name."""
    rows = table("odrive")["messages"][layout]
    return {name: Message(name, number, struct.Struct(text)) for name, (number, text) in rows.items()}


def watchdog_bit(layout: Layout) -> int:
    """Return the bit of the error word that means that the watchdog tripped. layout: of the firmware."""
    return int(table("odrive")["watchdog"][layout])


def fault(layout: Layout, bits: int) -> DeviceFault:
    """Return the error for the error word `bits` of a firmware `layout`; the fault RESTARTED if `bits` is zero."""
    if not bits:
        return DeviceFault(
            RESTARTED,
            "the axis left closed loop by itself without an error: it has restarted; check its supply and plug",
        )
    texts = {int(key, 0): text for key, text in table("odrive")["errors"][layout].items()}
    return DeviceFault(bits, f"the ODrive latched error 0x{bits:x}: {texts_of(bits, texts)}")


class Codec:
    """Encodes and decodes the frames of the axis with node id `ident`."""

    def __init__(self, ident: int, layout: Layout) -> None:
        self._base = ident << COMMAND_BITS
        self.layout = layout
        self._messages = messages(layout)
        self._names = {message.number: name for name, message in self._messages.items()}

    def has(self, name: str) -> bool:
        """Return whether this firmware has the message `name`."""
        return name in self._messages

    def request(self, name: str) -> Any:
        """Return the remote frame that requests the message `name`."""
        return frame(self._base | self._messages[name].number, remote=True)

    def put(self, name: str, *values: float | bytes) -> Any:
        """Return the frame that sends `values` in the message `name`."""
        message = self._messages[name]
        return frame(self._base | message.number, message.layout.pack(*values))

    def name_of(self, ident: int, *, extended: bool, remote: bool) -> str | None:
        """Return the name of a received message; None if another node sent it.

        extended: whether the identifier has 29 bits. remote: whether it is a remote frame.
        """
        if extended or remote or ident & ~((1 << COMMAND_BITS) - 1) != self._base:
            return None
        return self._names.get(ident & ((1 << COMMAND_BITS) - 1))

    def decoded(self, name: str, data: bytes) -> tuple[Any, ...]:
        """Return the values in the data of the message `name`. Raises BadReply if the data is too short."""
        layout = self._messages[name].layout
        if len(data) < layout.size:
            raise BadReply(f"{name}: {len(data)} bytes instead of {layout.size}: the sample is dropped")
        return layout.unpack_from(data)
