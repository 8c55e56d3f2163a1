"""The DYNAMIXEL X series on protocol 2.0.

A tick reads the addresses 120 to 146: Realtime Tick, Present Current, Velocity, Position, Input Voltage and
Temperature, all sampled at one moment. Source: e-manual, emanual.robotis.com/docs/en/dxl/x/xm430-w350/ (the pages of
the other models differ only in numbers, which are in table.toml).
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

from drivers.dynamixel.faults import latched, reboot, watchdog
from drivers.dynamixel.models import VELOCITY_LSB, DynamixelModel, DynamixelRegister, registers
from drivers.dynamixel.series import DynamixelState
from drivers.dynamixel.wire import Wire2
from drivers.overload import Overload

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.dynamixel.config import DynamixelConfig, Mode
    from drivers.packets.bus import Bus
    from drivers.packets.control_table import ControlTable
    from drivers.packets.wire import Wire
    from drivers.servo import Limits

_MODE_CODES: dict[Mode, int] = {"current": 0, "extended-position": 4, "current-based-position": 5}
_FIELDS = struct.Struct(
    "<HBBhhiiiiHB"
)  # tick, moving, status, PWM, current, velocity, position, two trajectories, V, degC
_WATCHDOG_LSB = 0.02
_LONGEST_POSITION = 256 * 4096
_PWM_MOST, _OVERLOAD = 885, 0x20
_TORQUE_ON_BY_GOAL = 0x08  # Drive Mode(10) bit 3


class XSeries:
    """A servo of the X series (`drivers.dynamixel.series.Series`)."""

    eeprom_end = 64
    block = (120, 27)
    off: tuple[str, ...] = ("goal_current", "torque_enable")  # a goal may switch the torque on (Drive Mode bit 3)
    zero_after_off: tuple[str, ...] = ("bus_watchdog",)  # it may have tripped
    velocity_lsb = VELOCITY_LSB

    def __init__(self, model: DynamixelModel, config: DynamixelConfig, torque_lsb: float) -> None:
        self.wire: Wire = Wire2()
        self.registers: Mapping[str, DynamixelRegister] = registers(2)
        self._model = model
        self._config = config
        self._mode = config.effective_mode
        self._torque_lsb = torque_lsb

    def identity(self, bus: Bus) -> tuple[int, int]:
        """Return model number and firmware from the reply to a ping."""
        data = bus.ping(3)
        return int.from_bytes(data[:2], "little"), data[2]

    def state(self, raw: bytes) -> DynamixelState:
        """See `Series`."""
        tick, _, _, _, current, velocity, position, _, _, voltage, temperature = _FIELDS.unpack(raw)
        amperes = current * self._model.current_lsb if self._model.current_lsb else math.nan
        return DynamixelState(tick, position, velocity * VELOCITY_LSB, amperes, voltage * 0.1, float(temperature))

    def ceiling(self, torque: float) -> int:
        """Return `torque`, N m, in counts of Current Limit(38)."""
        if not self._model.current_lsb:
            return 0
        return min(math.floor(torque / self._torque_lsb + 1e-9), self._model.current_max)

    def choose_mode(self, table: ControlTable) -> None:
        """See `Series`. Position control mode ignores a large Homing Offset(20)."""
        table.settings.require("operating_mode", _MODE_CODES[self._mode])

    def prepare(self, table: ControlTable, limits: Limits, ceiling: int) -> None:
        """See `Series`."""
        model = self._model
        table.put("bus_watchdog", 0)
        self.choose_mode(table)
        table.settings.require("drive_mode", table.get("drive_mode") & ~_TORQUE_ON_BY_GOAL)
        table.settings.require("temperature_limit", min(math.floor(limits.temperature), model.temperature_max))
        velocity = math.floor(limits.velocity / VELOCITY_LSB)
        table.settings.require("velocity_limit", max(1, min(velocity, model.velocity_max)))
        if model.current_lsb:
            table.settings.require("current_limit", ceiling)

    def enable(self, bus: Bus, table: ControlTable, ceiling: int) -> None:
        """Write a set-point of zero current or of the present position, then the watchdog."""
        del bus
        if self._mode == "current":
            table.settings.require("goal_current", 0)
        else:
            table.settings.require("profile_velocity", 0)
            table.settings.require("profile_acceleration", 0)
            if self._mode == "current-based-position":
                table.settings.require("goal_current", ceiling)
            table.put("goal_position", table.get("present_position"))
        table.settings.require("goal_pwm", table.get("pwm_limit"))
        if self._config.watchdog:
            table.settings.require("bus_watchdog", math.ceil(self._config.watchdog / _WATCHDOG_LSB - 1e-9))

    def goal(self, counts: int, ceiling: int) -> tuple[int, bytes, int]:
        """See `Series`."""
        current = self._mode == "current"
        most, register = (
            (ceiling, self.registers["goal_current"])
            if current
            else (_LONGEST_POSITION, self.registers["goal_position"])
        )
        clipped = max(-most, min(most, counts))
        return register.address, register.encoded(clipped), clipped

    def overload(self, table: ControlTable) -> Overload | None:
        """See `Series`. The load is that at which the current loop needs the whole of PWM Limit(36)."""
        shutdown, limit = table.get("shutdown"), table.get("pwm_limit")
        if not shutdown & _OVERLOAD or not self._model.stall:
            return None
        acts = (
            f"if that lasts, the servo switches its torque off: Shutdown(63) is {shutdown}, with the bit for an "
            f"overload, and PWM Limit(36) {limit} of {_PWM_MOST}"
        )
        remedy = f"raise PWM Limit(36) to {_PWM_MOST}" if limit < _PWM_MOST else "choose a stronger servo"
        return Overload(self._config.largest_torque * limit / _PWM_MOST, acts, remedy)

    def raise_latched(self, bus: Bus, table: ControlTable) -> None:
        """Raise DeviceFault if Hardware Error Status(70) is not zero."""
        del bus
        bits = table.get("hardware_error_status")
        if bits:
            raise latched(bits)

    def raise_stopped(self, bus: Bus, table: ControlTable) -> None:
        """See `Series`."""
        del bus
        if self._config.watchdog and table.get("bus_watchdog") == -1:
            raise watchdog(self._config.watchdog)
        if table.get("torque_enable") == 0:
            raise reboot()
