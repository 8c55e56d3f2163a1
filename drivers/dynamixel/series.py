"""What a series of DYNAMIXEL servos must implement: its registers, modes, units and faults."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.dynamixel.models import DynamixelRegister
    from drivers.overload import Overload
    from drivers.packets.bus import Bus
    from drivers.packets.control_table import ControlTable
    from drivers.packets.wire import Wire
    from drivers.servo import Limits


class DynamixelState(NamedTuple):
    """One reading at the horn, with the servo's own sign. tick: ms on the servo's clock, None if the clock cannot be
    read.

    position: counts over any number of turns. velocity: rad/s. current: A, NaN if none is measured. voltage: V.
    temperature: degC.
    """

    tick: int | None
    position: int
    velocity: float
    current: float
    voltage: float
    temperature: float


class Series(Protocol):
    """One servo of a DYNAMIXEL series. It stores state between two readings, so each servo needs its own object.

    block: address and size of the registers that a tick reads. velocity_lsb: rad/s in one count of velocity.
    eeprom_end: first address after the EEPROM. off: the registers that switch the torque off when zero is written, in
    the order in which another process writes them. zero_after_off: registers to set to zero afterwards, because they
    would act when the torque is switched on again.
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
        """Decode the bytes of `block`."""

    def ceiling(self, torque: float) -> int:
        """Return `torque`, N m, in counts of the servo's torque limit, rounded down; 0 if the servo has no torque
        limit.
        """

    def choose_mode(self, table: ControlTable) -> None:
        """Write the operating mode, on which the angle may depend, before the first angle is read. The torque must be
        off.
        """

    def prepare(self, table: ControlTable, limits: Limits, ceiling: int) -> None:
        """Write mode and limits and read them back. The torque must be off. ceiling: the torque limit in counts."""

    def enable(self, bus: Bus, table: ControlTable, ceiling: int) -> None:
        """Write a set-point that causes no step, and the watchdog. The caller then switches the torque on. ceiling: the
        torque limit in counts.
        """

    def goal(self, counts: int, ceiling: int) -> tuple[int, bytes, int]:
        """Clamp a set-point of `counts` (of current or position). Return its address, its bytes and the clamped counts.

        ceiling: the torque limit in counts.
        """

    def overload(self, table: ControlTable) -> Overload | None:
        """Return the load at which the servo switches its torque off; None if that is off or not known."""

    def raise_latched(self, bus: Bus, table: ControlTable) -> None:
        """Raise DeviceFault if an error is latched."""

    def raise_stopped(self, bus: Bus, table: ControlTable) -> None:
        """Raise DeviceFault if an armed servo has stopped by itself."""
