"""The interface to one series of DYNAMIXEL servos: its registers, modes, units and faults."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.dynamixel.models import DynamixelRegister
    from drivers.packets.bus import Bus
    from drivers.packets.control_table import ControlTable
    from drivers.packets.wire import Wire
    from drivers.servo import Limits


class DynamixelState(NamedTuple):
    """One reading at the horn, with the servo's own sign. tick: ms of its clock, None if it cannot be read.

    position in counts over any number of turns, velocity rad/s, current A (NaN if none is measured), voltage V,
    temperature degC.
    """

    tick: int | None
    position: int
    velocity: float
    current: float
    voltage: float
    temperature: float


class Series(Protocol):
    """One servo of a series. It keeps state between two readings, so each servo has its own.

    block: address and size of what a tick reads. velocity_lsb: rad/s. eeprom_end: as in `ControlTable`. off: the
    registers whose zero takes the torque off, in the order in which they are written where no reply comes.
    zero_after_off: those which would act when the torque is switched on again.
    """

    wire: Wire
    registers: Mapping[str, DynamixelRegister]
    eeprom_end: int
    block: tuple[int, int]
    velocity_lsb: float
    off: tuple[str, ...]
    zero_after_off: tuple[str, ...]

    def identity(self, bus: Bus) -> tuple[int, int]:
        """Return model number and firmware."""

    def state(self, raw: bytes) -> DynamixelState:
        """Return the reading in the bytes of `block`."""

    def ceiling(self, torque: float) -> int:
        """Return `torque` N m in counts of the servo's torque limit, rounded down; 0 if it has none."""

    def prepare(self, table: ControlTable, limits: Limits, ceiling: int) -> None:
        """With the torque off, write mode and limits and read them back."""

    def enable(self, bus: Bus, table: ControlTable, ceiling: int) -> None:
        """Write a set-point that causes no step, and the watchdog; the caller then switches the torque on."""

    def goal(self, counts: int, ceiling: int) -> tuple[int, bytes, int]:
        """Return address and bytes of a set-point of `counts` of current or position, and its counts after clamping."""

    def raise_latched(self, bus: Bus, table: ControlTable) -> None:
        """Raise DeviceFault if an error is latched."""

    def raise_stopped(self, bus: Bus, table: ControlTable) -> None:
        """Raise DeviceFault if an armed servo has stopped by itself."""
