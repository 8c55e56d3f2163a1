"""A servo on a serial line with packets: what is the same in all families of such servos."""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from drivers.gate import DriveServo, Gate
from drivers.off_path import OffPath, descriptor_of, serial_interval
from drivers.packets.bus import Bus
from drivers.packets.control_table import ControlTable
from drivers.packets.hand import HandBus
from drivers.packets.port import SerialPort
from drivers.servo import DriverError, Quantity

if TYPE_CHECKING:
    from drivers.clock import Clock
    from drivers.packets.control_table import Register
    from drivers.packets.wire import Wire

_RESYNC = bytes(32)
"""Zero bytes, more than any packet sent here has. They end a packet that was cut off (its checksum is then wrong) and
begin none.
"""


class RegisterServo(DriveServo):
    """A servo with registers whose port is open, and the other servos of its hand on the same line.

    config: the table of stand.toml, with port, id, baudrate, sign and reply_timeout. quantity: what the set-points
    command. mode_key: see `Gate`. wire: its protocol. registers, eeprom_end: see `ControlTable`. position: address and
    size of the present position, which `counts` decodes. turn: counts of a turn, see `HandBus`.

    _off: the registers to which zero is written to switch the torque off, in the order in which another process writes
    them. _zero_after: registers to set to zero afterwards. _kept: registers that another process does not restore.
    """

    _off: tuple[str, ...]
    _zero_after: tuple[str, ...] = ()
    _kept: tuple[str, ...] = ()

    def __init__(
        self,
        config: Any,
        clock: Clock | None,
        port: SerialPort | None,
        *,
        quantity: Quantity,
        mode_key: str,
        wire: Wire,
        registers: Mapping[str, Register],
        eeprom_end: int,
        position: tuple[int, int],
        counts: Callable[[bytes], int],
        turn: int,
    ) -> None:
        super().__init__(config.sign, clock)
        self._port = port or SerialPort(config.port, config.baudrate, self.clock)
        self._bus = Bus(self._port, config.id, self.clock, config.reply_timeout, wire)
        self._table = ControlTable(self._bus, registers, eeprom_end)
        self._settings = self._table.settings
        torque = registers["torque_enable"]
        self._hand = HandBus(self._bus, config.id, torque=torque, position=position, counts=counts, turn=turn)
        self._gate = Gate(
            config.port,
            frozenset({quantity}),
            torque_off=self._torque_off,
            release=self._port.closePort,
            clock=self.clock,
            repeats=self._bus.repeats,
            mode_key=mode_key,
        )
        self._port.openPort()

    def join_hand(self, joints: Mapping[str, int]) -> None:
        """See `drivers.neighbours.JoinsHand`."""
        self._hand.join(joints)

    def turned(self) -> dict[str, float]:
        """See `drivers.neighbours.SeesNeighbours`."""
        return self._hand.turned(self.info.position_lsb)

    def off_path(self) -> OffPath:
        """See `drivers.off_path.HasOffPath`. The packets that switch the torque off reach every servo of the hand."""
        table, beside = self._table, self._hand.neighbours
        off = tuple(table.unanswered(name, 0, beside if name == "torque_enable" else ()) for name in self._off)
        changed = [(name, value) for name, value in table.settings.changed() if name not in self._kept]
        restore = [*((name, 0) for name in self._zero_after), *changed]
        return OffPath(
            off=off,
            restore=tuple(table.unanswered(name, value) for name, value in restore),
            resync=_RESYNC,
            descriptor=descriptor_of(self._port.ser),
            interval=serial_interval((_RESYNC, *off), self._port.baudrate),
            name=self._port.port_name,
        )

    @abstractmethod
    def _confirm_off(self) -> None:
        """Switch this servo off and read it back. Raises DriverError if it is not off."""

    def _torque_off(self, _request: int) -> None:
        self._hand.switch_off(self._switch_off)
        with contextlib.suppress(DriverError):
            for name in self._zero_after:
                self._table.put(name, 0)

    def _switch_off(self) -> None:
        try:
            self._confirm_off()
        except DriverError:
            with contextlib.suppress(DriverError):  # a servo that cannot reply may still receive
                for name in self._off:
                    register = self._table.registers[name]
                    self._bus.send(register.address, bytes(register.size))
            raise
