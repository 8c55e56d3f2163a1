"""The control table of an emulated DYNAMIXEL servo: which registers may be read or written, when, and with which error.

Source: e-manual, "Protocol 2.0", table of errors, and the notes above each control table ("Data in the EEPROM Area can
only be written when the value of Torque Enable(64) is cleared to 0"). The manual does not say whether a read may span
addresses without an item. Here it may, if it begins at an item; such addresses read as zero.
"""

from __future__ import annotations

from collections.abc import Callable

from sim_backend.wire.dynamixel.tables import BAUD, MODES, DynamixelModel
from sim_backend.wire.packets.frames import Error
from sim_backend.wire.packets.registers import Item, Registers
from sim_backend.wire.packets.regulator import POSITION

EEPROM_END = 64
_BACKED_UP = frozenset(
    {
        "velocity_i_gain",
        "velocity_p_gain",
        "position_d_gain",
        "position_i_gain",
        "position_p_gain",
        "feedforward_2nd_gain",
        "feedforward_1st_gain",
        "profile_acceleration",
        "profile_velocity",
        "indirect_address",
    }
)
"""The items in RAM that a backup stores in addition to the whole EEPROM ("Control Table Backup")."""
_RESTORES_RAM = 0x02
"""The bit of Startup Configuration(60) with which a start restores the RAM items of the backup."""
GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")


class ControlTable:
    """The rules of one servo's control table. registers: the memory of the servo."""

    def __init__(self, model: DynamixelModel) -> None:
        self.registers = Registers(model.items)
        self._defined = {a for item in model.items for a in range(item.address, item.address + item.size)}
        self._indirect = {
            data + slot: address + 2 * slot for address, data, slots in model.indirect for slot in range(slots)
        }
        self._backup: dict[int, int] = {}

    def power_up(self) -> None:
        """Set the items in RAM to their initial values, or to those of the backup. The EEPROM and the backup do not
        change.
        """
        self.registers.reset(EEPROM_END)
        if self.registers.get("startup_configuration") & _RESTORES_RAM:
            self._copy_back(lambda address: address >= EEPROM_END)
        self.registers.put("backup_ready", int(bool(self._backup)))

    def back_up(self) -> None:
        """Store a backup of the EEPROM and of the settings in RAM."""
        items = self.registers.items.values()
        kept = [item for item in items if item.address < EEPROM_END or item.name in _BACKED_UP]
        self._backup = {item.address: self.registers.value(item) for item in kept}
        self.registers.put("backup_ready", 1)

    def restore(self) -> bool:
        """Set the EEPROM to the backup. Return False if there is no backup."""
        self._copy_back(lambda address: address < EEPROM_END)
        return bool(self._backup)

    def read(self, address: int, size: int) -> tuple[Error, bytes]:
        """Return the error and the bytes of a read of `size` bytes."""
        memory = self.registers.memory
        if size == 0 or address not in self._defined or address + size > len(memory):
            return Error.ACCESS, b""
        first, last = min(self._indirect), max(self._indirect)
        if address > last or address + size <= first:
            return Error.NONE, bytes(memory[address : address + size])
        return Error.NONE, bytes(memory[self._behind(a)] for a in range(address, address + size))

    def check(self, address: int, data: bytes, *, torque: bool, tripped: bool) -> tuple[Error, list[tuple[Item, int]]]:
        """Return the error of a write of `data`; without an error, also the items with their new values. Nothing is
        changed.

        torque: whether the torque is on. tripped: whether the bus watchdog has stopped the servo.
        """
        changes: list[tuple[Item, int]] = []
        for item, raw in self.registers.covered(address, data, self._behind):
            if item is None or not item.writable or (item.address < EEPROM_END and torque):
                return Error.ACCESS, []
            if len(raw) < item.size:
                return Error.DATA_LENGTH, []
            value = self.registers.decoded(item, raw)
            error = self._judge(item, value, tripped=tripped)
            if error:
                return error, []
            changes.append((item, value))
        return (Error.NONE, changes) if data else (Error.DATA_LENGTH, [])

    def _copy_back(self, wanted: Callable[[int], bool]) -> None:
        """Set the items at the addresses `wanted` to their values in the backup."""
        for address, value in self._backup.items():
            if wanted(address):
                self.registers.store(self.registers.items[address], value)

    def _behind(self, address: int) -> int:
        """Return the address that is accessed through `address`: for an indirect data item, the address that its
        address item holds.
        """
        pointer = self._indirect.get(address)
        if pointer is None:
            return address
        target = int.from_bytes(self.registers.memory[pointer : pointer + 2], "little")
        return address if target in self._indirect else target

    def _judge(self, item: Item, value: int, *, tripped: bool) -> Error:
        low, high = item.low, item.high
        if item.name == "operating_mode":
            allowed = MODES if self.registers.has("goal_current") else tuple(m for m in MODES if m not in {0, 5})
            return Error.NONE if value in allowed else Error.DATA_RANGE
        if item.name == "baud_rate":
            return Error.NONE if value < min(len(BAUD), high + 1) else Error.DATA_RANGE
        if item.name == "bus_watchdog":
            low = 0
        if item.name in GOALS and tripped:
            return Error.DATA_RANGE
        if not low <= value <= high:
            return Error.DATA_RANGE
        return Error.NONE if self._within_limits(item.name, value) else Error.DATA_LIMIT

    def _within_limits(self, name: str, value: int) -> bool:
        if name == "goal_position":
            if self.registers.get("operating_mode") == POSITION:
                return self.registers.get("min_position_limit") <= value <= self.registers.get("max_position_limit")
            return abs(value) <= 256 * 4096
        limit = {"goal_pwm": "pwm_limit", "goal_current": "current_limit", "goal_velocity": "velocity_limit"}.get(name)
        return limit is None or abs(value) <= self.registers.get(limit)
