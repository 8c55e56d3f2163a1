"""Read and write the registers of a servo by name."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Protocol

from drivers.servo import NoReply
from drivers.settings import Settings

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from drivers.packets.bus import Bus


class Register(Protocol):
    """An item of a servo's control table."""

    @property
    def address(self) -> int:
        """The address of the register's first byte."""

    @property
    def size(self) -> int:
        """The number of bytes of the register."""

    def encoded(self, value: int) -> bytes:
        """Return the bytes of `value`. Raises OverflowError if `value` does not fit."""

    def decoded(self, data: bytes) -> int:
        """Return the value that the bytes encode."""


class ControlTable:
    """The registers of the servo on `bus` by name. Every method raises NoReply, BadReply, LinkLost, DriverError.

    settings: registers that are written for a run and read back. Those below the address `eeprom_end` keep their value
    without power, so they are restored at the end.
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

    def unanswered(self, name: str, value: int, neighbours: Iterable[int] = ()) -> bytes:
        """Return the packet that writes a register, also in the servos `neighbours`, and has no reply."""
        register = self.registers[name]
        return self._bus.unanswered(register.address, register.encoded(value), neighbours)

    def put(self, name: str, value: int) -> None:
        """Write `value`, in counts, to the register `name`."""
        register = self.registers[name]
        self._bus.write(register.address, register.encoded(value))

    def _write(self, name: str, value: int) -> None:
        """Write a register without its confirmation, which may be missing: the register is read back afterwards."""
        with contextlib.suppress(NoReply):
            self.put(name, value)
