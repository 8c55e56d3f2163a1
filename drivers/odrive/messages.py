"""CANSimple messages and error bits, from `tables/odrive.toml`, whose head names the sources."""

from __future__ import annotations

import struct
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Literal

from drivers.canbus.link import frame
from drivers.servo import BadReply, DeviceFault

Layout = Literal["0.5", "0.6"]
"""0.5 is that of 0.5.6, the last for the ODrive v3; 0.6 that of the Pro, S1 and Micro."""
RESTARTED = 0x1_0000_0000
"""Our code for an axis that left closed loop and says no error: above every error word."""
IDLE, CLOSED_LOOP = 1, 8
TORQUE_CONTROL, PASSTHROUGH = 1, 1
COMMAND_BITS = 5


@cache
def _table() -> dict[str, Any]:
    return tomllib.loads(files("drivers").joinpath("odrive/table.toml").read_text(encoding="utf-8"))


@cache
def endpoint_names() -> dict[str, str]:
    """The vendor's name of each parameter that is used, by ours."""
    return dict(_table()["endpoints"])


@dataclass(frozen=True, slots=True)
class Message:
    """A command and how its data are laid out."""

    name: str
    number: int
    layout: struct.Struct


@cache
def messages(layout: Layout) -> dict[str, Message]:
    """The messages of a firmware, by name."""
    rows = _table()["messages"][layout]
    return {name: Message(name, number, struct.Struct(text)) for name, (number, text) in rows.items()}


def watchdog_bit(layout: Layout) -> int:
    """The bit of the error word that says the watchdog ran out."""
    return int(_table()["watchdog"][layout])


def fault(layout: Layout, bits: int) -> DeviceFault:
    """The fault for an error word; RESTARTED where it is zero."""
    if not bits:
        return DeviceFault(
            RESTARTED,
            "the axis left closed loop by itself and says no error: it was restarted; check its supply and plug",
        )
    words = {int(key, 0): text for key, text in _table()["errors"][layout].items()}
    said = [text for bit, text in words.items() if bits & bit]
    unknown = bits & ~sum(words)
    if unknown:
        said.append(f"unknown error bits 0x{unknown:x}: see the vendor's manual")
    return DeviceFault(bits, f"the ODrive latched error 0x{bits:x}: {'; '.join(said)}")


class Codec:
    """The frames of the axis with one node id."""

    def __init__(self, ident: int, layout: Layout) -> None:
        self._base = ident << COMMAND_BITS
        self.layout = layout
        self._messages = messages(layout)
        self._names = {message.number: name for name, message in self._messages.items()}

    def knows(self, name: str) -> bool:
        """Whether this firmware has the message."""
        return name in self._messages

    def request(self, name: str) -> Any:
        """The remote frame that asks for a message."""
        return frame(self._base | self._messages[name].number, remote=True)

    def put(self, name: str, *values: float | bytes) -> Any:
        """The frame that sets something."""
        message = self._messages[name]
        return frame(self._base | message.number, message.layout.pack(*values))

    def name_of(self, ident: int, *, extended: bool, remote: bool) -> str | None:
        """What a frame that arrived is; None where it is not from this axis."""
        if extended or remote or ident & ~((1 << COMMAND_BITS) - 1) != self._base:
            return None
        return self._names.get(ident & ((1 << COMMAND_BITS) - 1))

    def decoded(self, name: str, data: bytes) -> tuple[Any, ...]:
        """The values in a reply. Raises BadReply where it is shorter than it should be."""
        layout = self._messages[name].layout
        if len(data) < layout.size:
            raise BadReply(f"{name}: {len(data)} bytes where there should be {layout.size}: the sample is dropped")
        return layout.unpack_from(data)
