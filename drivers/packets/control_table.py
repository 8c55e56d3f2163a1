"""The registers of one servo by name."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Protocol

from drivers.servo import NoReply
from drivers.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.packets.bus import Bus


class Register(Protocol):
    """An item of the control table; size in bytes."""

    @property
    def address(self) -> int:
        """The address of its first byte."""

    @property
    def size(self) -> int:
        """Its number of bytes."""

    def encoded(self, value: int) -> bytes:
        """Return the bytes of `value`. Raises OverflowError if it does not fit."""

    def decoded(self, data: bytes) -> int:
        """Return the value of the bytes."""


class ControlTable:
    """The registers of the servo on `bus` by name. Every method raises what `Bus` does.

    settings: written for a run and read back; those below `eeprom_end`, which keep their value without power, are
    restored.
    """

    def __init__(self, bus: Bus, registers: Mapping[str, Register], eeprom_end: int) -> None:
        self.registers = registers
        self._bus = bus
        self.settings: Settings[str, int] = Settings(
            self.get, self._write, kept=lambda name: registers[name].address < eeprom_end
        )

    def get(self, name: str) -> int:
        """Return the value of a register, in counts."""
        register = self.registers[name]
        return register.decoded(self._bus.read(register.address, register.size))

    def unanswered(self, name: str, value: int) -> bytes:
        """Return the packet that writes a register and has no reply."""
        register = self.registers[name]
        return self._bus.unanswered(register.address, register.encoded(value))

    def put(self, name: str, value: int) -> None:
        """Write a register."""
        register = self.registers[name]
        self._bus.write(register.address, register.encoded(value))

    def _write(self, name: str, value: int) -> None:
        """Write a register that is read back afterwards: a servo that confirms no writes takes it all the same."""
        with contextlib.suppress(NoReply):
            self.put(name, value)
