"""MX-64 and MX-106 on protocol 1.0.

A tick reads the addresses 36 to 69: Present Position, Speed, Load, Voltage, Temperature, Realtime Tick and Current.
There is no bus watchdog. Torque is commanded in torque control mode (70, 71), position in multi-turn mode. Source:
e-manual, emanual.robotis.com/docs/en/dxl/mx/mx-64/ and .../mx-106/. Two things are not in the manual. This module
assumes that a positive current and a positive Goal Torque both turn counter-clockwise, in which the position grows.
This module always counts turns itself, because the position may or may not count turns in torque control mode; the
motor must therefore turn less than half a turn between two readings.
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

from drivers.dynamixel.faults import reboot, shut_down
from drivers.dynamixel.models import TURN, DynamixelModel, DynamixelRegister, registers
from drivers.dynamixel.series import DynamixelState
from drivers.dynamixel.wire import wire_1
from drivers.servo import DriverError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.dynamixel.config import DynamixelConfig
    from drivers.overload import Overload
    from drivers.packets.bus import Bus
    from drivers.packets.control_table import ControlTable
    from drivers.packets.wire import Wire
    from drivers.servo import Limits

_FIELDS = struct.Struct("<hHHBBBBBBHH16xH")  # position, speed, load, V, degC, 44 to 47, punch, tick, current
_MULTI_TURN = 4095  # in both angle limits
_LONGEST_POSITION = 28672
_NO_CURRENT = 2048
_CLOCKWISE = 1024  # bit 10 of a speed or a torque
_TICK_FIRMWARE = 40  # from which there is a Realtime Tick(50)


class MxSeries:
    """A servo of the MX series (`drivers.dynamixel.series.Series`)."""

    eeprom_end = 24
    block = (36, 34)
    off: tuple[str, ...] = ("torque_enable", "goal_torque", "torque_control")
    zero_after_off: tuple[str, ...] = ("goal_torque", "torque_control")  # the mode in which the servo starts
    velocity_lsb = 0.114 * math.tau / 60.0

    def __init__(self, model: DynamixelModel, config: DynamixelConfig, torque_lsb: float) -> None:
        self.wire: Wire = wire_1()
        self.registers: Mapping[str, DynamixelRegister] = registers(1)
        self._model = model
        self._torque_mode = config.effective_mode == "current"
        # the torque limit is in 1/1023 of what the supply allows, and the goal in current: whichever count is larger
        strongest = max(torque for _, _, torque in model.stall)
        self._limit_lsb = max(torque_lsb, strongest / model.current_max)
        self._has_tick = False
        self._raw: int | None = None
        self._position = 0

    def identity(self, bus: Bus) -> tuple[int, int]:
        """Read model number and firmware from the control table, because the reply to a ping does not hold them.

        Raises DriverError if the EEPROM is locked, so that no limit could be written.
        """
        bus.ping(0)
        data = bus.read(0, 3)
        if bus.read(self.registers["lock"].address, 1) != b"\0":
            raise DriverError(
                "the servo's EEPROM is locked (Lock(47) is 1), so its temperature and angle limits cannot be written: "
                "switch its power off and on"
            )
        self._has_tick = data[2] >= _TICK_FIRMWARE
        return int.from_bytes(data[:2], "little"), data[2]

    def state(self, raw: bytes) -> DynamixelState:
        """See `Series`."""
        position, speed, _, voltage, temperature, _, _, _, _, _, tick, current = _FIELDS.unpack(raw)
        return DynamixelState(
            tick if self._has_tick else None,
            self._unwrapped(position),
            _signed(speed) * self.velocity_lsb,
            (current - _NO_CURRENT) * self._model.current_lsb,
            voltage * 0.1,
            float(temperature),
        )

    def ceiling(self, torque: float) -> int:
        """Return `torque`, N m, in counts of Torque Limit(34) and Goal Torque(71)."""
        return min(math.floor(torque / self._limit_lsb + 1e-9), self._model.current_max)

    def choose_mode(self, table: ControlTable) -> None:
        """See `Series`. Nothing is written: the mode follows from the angle limits, which do not change the angle."""
        del table

    def prepare(self, table: ControlTable, limits: Limits, ceiling: int) -> None:
        """See `Series`."""
        table.settings.require("temperature_limit", min(math.floor(limits.temperature), self._model.temperature_max))
        table.settings.require("resolution_divider", 1)
        if not self._torque_mode:
            table.settings.require("cw_angle_limit", _MULTI_TURN)
            table.settings.require("ccw_angle_limit", _MULTI_TURN)
        table.settings.require("goal_acceleration", 0)
        velocity = math.floor(limits.velocity / self.velocity_lsb)
        table.settings.require("moving_speed", max(1, min(velocity, self._model.velocity_max)))
        table.settings.require("torque_limit", ceiling)

    def enable(self, bus: Bus, table: ControlTable, ceiling: int) -> None:
        """Write a set-point of zero torque, or of the present position in a position mode."""
        del ceiling
        table.settings.require("goal_torque", 0)
        table.settings.require("torque_control", int(self._torque_mode))
        self.state(bus.read(*self.block))  # other angle limits may have changed whether it counts turns
        if not self._torque_mode and self._raw is not None:
            table.put("goal_position", self._raw)

    def goal(self, counts: int, ceiling: int) -> tuple[int, bytes, int]:
        """See `Series`."""
        if self._torque_mode:
            clipped = max(-ceiling, min(ceiling, counts))
            register = self.registers["goal_torque"]
            return register.address, register.encoded(abs(clipped) | (_CLOCKWISE if clipped < 0 else 0)), clipped
        turns_off = self._position - (self._raw or 0)
        clipped = max(turns_off - _LONGEST_POSITION, min(turns_off + _LONGEST_POSITION, counts))
        register = self.registers["goal_position"]
        return register.address, register.encoded(clipped - turns_off), clipped

    def overload(self, table: ControlTable) -> Overload | None:
        """See `Series`. The manual does not say at which load a servo with protocol 1.0 switches its torque off."""
        del table
        return None

    def raise_latched(self, bus: Bus, table: ControlTable) -> None:
        """Raise DeviceFault if a reply carries hardware errors."""
        del table
        bus.ping(0)
        if bus.alert:
            raise shut_down(bus.alert)

    def raise_stopped(self, bus: Bus, table: ControlTable) -> None:
        """Raise DeviceFault if Torque Limit(34) is zero, as after a shutdown, or the torque is off, as after a
        restart.
        """
        if table.get("torque_limit") == 0:
            raise shut_down(bus.alert)
        if table.get("torque_enable") == 0 or table.get("torque_control") != int(self._torque_mode):
            raise reboot()

    def _unwrapped(self, raw: int) -> int:
        """Return the position over any number of turns, even if the servo's own position begins again after one
        turn.
        """
        if self._raw is None:
            self._position = raw
        else:
            self._position += (raw - self._raw + TURN // 2) % TURN - TURN // 2
        self._raw = raw
        return self._position


def _signed(value: int) -> int:
    """Return the signed value of a number in which bit 10 means clockwise (negative)."""
    return -(value & (_CLOCKWISE - 1)) if value & _CLOCKWISE else value & (_CLOCKWISE - 1)
