"""One servo's registers by name, read back after they are written, and put back the way they were found."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.servo import DriverError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.dynamixel.bus import Bus
    from drivers.dynamixel.models import Register


class ControlTable:
    """The registers of the servo on `bus`: by name, and those below `eeprom_end` keep their value without power.

    Every method raises what `Bus` does.
    """

    def __init__(self, bus: Bus, registers: Mapping[str, Register], eeprom_end: int) -> None:
        self.registers = registers
        self._bus = bus
        self._eeprom_end = eeprom_end
        self._found: dict[str, int] = {}

    def get(self, name: str) -> int:
        """The value of a register, in counts."""
        register = self.registers[name]
        return register.decoded(self._bus.read(register.address, register.size))

    def put(self, name: str, value: int) -> None:
        """Write a register."""
        register = self.registers[name]
        self._bus.write(register.address, register.encoded(value))

    def require(self, name: str, value: int) -> None:
        """Make a register hold `value`, and read it back. The EEPROM is written only where it holds something else.

        What was found in the EEPROM is kept for `restore`. Raises DriverError where the servo keeps another value.
        """
        found = self.get(name)
        if found == value:
            return
        if self.registers[name].address < self._eeprom_end:
            self._found.setdefault(name, found)
        self.put(name, value)
        kept = self.get(name)
        if kept != value:
            raise DriverError(f"the servo keeps {kept} in {name} where {value} was written: it is not safe to go on")

    def restore(self) -> None:
        """Put the EEPROM back as it was found, as far as the servo lets us."""
        while self._found:
            name, value = self._found.popitem()
            try:
                self.put(name, value)
            except DriverError:
                continue  # one that cannot be put back must not keep the others from it
