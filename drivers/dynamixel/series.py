"""What differs between the series of DYNAMIXEL servos: registers, modes, units, and how a fault shows."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.dynamixel.bus import Bus
    from drivers.dynamixel.control_table import ControlTable
    from drivers.dynamixel.models import Register
    from drivers.dynamixel.wire import Wire
    from drivers.servo import Limits


class State(NamedTuple):
    """One reading at the horn, with the servo's own sign. tick: None where its clock cannot be read.

    position in counts over any number of turns, velocity rad/s, current A (NaN where none is measured), voltage V,
    temperature degC.
    """

    tick: int | None
    position: int
    velocity: float
    current: float
    voltage: float
    temperature: float


class Series(Protocol):
    """One servo of a series; what is remembered between two readings is its own.

    block: address and size of what a tick reads. velocity_lsb: rad/s. eeprom_end: as in `ControlTable`. off: the
    registers whose zero takes the torque off, in the order in which they are written where no reply comes.
    """

    wire: Wire
    registers: Mapping[str, Register]
    eeprom_end: int
    block: tuple[int, int]
    velocity_lsb: float
    off: tuple[str, ...]

    def identity(self, bus: Bus) -> tuple[int, int]:
        """Model number and firmware of who answers."""
        ...

    def state(self, raw: bytes) -> State:
        """What a block of `block` says."""
        ...

    def ceiling(self, torque: float) -> int:
        """`torque` N m in the counts of the servo's torque limit, rounded down; 0 where it has none."""
        ...

    def prepare(self, table: ControlTable, limits: Limits, ceiling: int) -> None:
        """With the torque off, write and read back what must be there before current flows."""
        ...

    def enable(self, bus: Bus, table: ControlTable, ceiling: int) -> None:
        """The set-point that does not jerk, then everything up to the torque itself, which the caller switches on."""
        ...

    def rest(self, table: ControlTable) -> None:
        """After torque-off: leave nothing behind that would act when the torque comes back."""
        ...

    def goal(self, counts: int, ceiling: int) -> tuple[int, bytes, int]:
        """Address and bytes of a set-point of `counts` of current or position, and the counts that it holds."""
        ...

    def raise_latched(self, bus: Bus, table: ControlTable) -> None:
        """Raise DeviceFault where an error is latched."""
        ...

    def raise_stopped(self, bus: Bus, table: ControlTable) -> None:
        """Raise DeviceFault where an armed servo is not doing what it was armed for."""
        ...
