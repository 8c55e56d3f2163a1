"""An emulated MX servo with protocol 1.0: its control table, the effect of each instruction, and the replies.

Source: e-manual, "Protocol 1.0" and the pages of MX-64 and MX-106. The following is not in the manual and is assumed
here. A write to an address without an item, to a read-only item, or to the EEPROM while it is locked, is a range error.
A read may span addresses without an item, which read as zero. A positive current turns counter-clockwise, in which the
position grows. In torque control mode the position is within one turn, as in wheel mode. Speeds and gains in the
position modes have no effect.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim_backend.wire.dynamixel.tables import MX_BAUD, MX_EEPROM_END, MX_MODELS, MX_RPM
from sim_backend.wire.life import Life
from sim_backend.wire.packets.bus import LineSettings
from sim_backend.wire.packets.frames import BROADCAST, Frame, Instruction
from sim_backend.wire.packets.registers import Registers
from sim_backend.wire.packets.regulator import COUNT, CURRENT, CURRENT_POSITION, SPEED, Goals, Regulator, joint_at_horn
from sim_backend.wire.plant_motor import PlantMotor

if TYPE_CHECKING:
    from sim_backend.parameters import SimParameters
    from sim_backend.wire.packets.registers import Item

BOOT = 0.3
"""s after power-on in which the servo does not reply; the manual gives no value."""
MX_VOLTAGE, MX_ANGLE, MX_HEAT, MX_RANGE, MX_CHECKSUM, MX_OVERLOAD, MX_INSTRUCTION = 1, 2, 4, 8, 16, 32, 64
"""Bits of the error byte."""
_REBOOTS = 40
"""The first firmware version that has the instruction Reboot."""
_TURN, _MULTI_TURN, _CW = 4096, 4095, 1024


class MxDevice:
    """An emulated servo of `model` (a key of `MX_MODELS`). The plant of `parameters` is attached to its horn.

    Times are s on the bus's clock. now: s, when the servo is powered. Raises KeyError for a model, or StopIteration for
    a baud rate, that is not in the tables.
    """

    def __init__(
        self,
        model: str,
        ident: int = 1,
        *,
        baudrate: int = 1_000_000,
        firmware: int | None = None,
        parameters: SimParameters | None = None,
        now: float = 0.0,
    ) -> None:
        self.model = MX_MODELS[model]
        self.registers = Registers(self.model.items)
        self.get, self.put = self.registers.get, self.registers.put
        self.motor = PlantMotor(joint_at_horn(self.model, parameters), Regulator(self.model))
        self.errors = 0
        """The present hardware errors, as bits of the error byte."""
        self.life = Life(self.motor, now)
        self._registered: tuple[int, bytes] | None = None
        self.put("id", ident)
        self.put("baud_rate", next(code for code, rate in MX_BAUD.items() if rate == baudrate))
        if firmware is not None:
            self.put("firmware_version", firmware)
        self.put("goal_position", self._position())

    @property
    def line(self) -> LineSettings:
        """The servo's settings for the serial line. A baud rate that is not in the manual's table is 2 Mbit/s /
        (register value + 1).
        """
        get = self.get
        code = get("baud_rate")
        baudrate = MX_BAUD.get(code, 2_000_000 // (code + 1))
        together = frozenset({Instruction.SYNC_WRITE, Instruction.BULK_READ})
        delay = get("return_delay_time") * 2e-6
        return LineSettings(get("id"), baudrate, delay, get("status_return_level"), together=together)

    def advance(self, now: float) -> None:
        """Simulate the motor up to `now`. Over-temperature is an error only while it lasts."""
        self.life.run(now)
        hot = self.motor.temperature > self.get("temperature_limit")
        if hot:
            self.fail(MX_HEAT)
        elif self.errors & MX_HEAT:
            self.errors &= ~MX_HEAT

    def fail(self, bits: int) -> None:
        """Report the hardware errors `bits`. Errors that are selected in Shutdown(18) set Torque Limit(34) to zero."""
        self.errors |= bits
        if bits & self.get("shutdown"):
            self.put("torque_limit", 0)
            self._hand_over_goals()

    def reboot(self, now: float) -> None:
        """Cut the servo's power for a moment: the torque goes off and the contents of the RAM are lost."""
        self.life.boot(now, BOOT)
        self.errors = 0
        self._registered = None
        self.registers.reset(MX_EEPROM_END)
        self.put("torque_limit", self.get("max_torque"))
        self.put("goal_position", self._position())

    def alerted(self, error: int) -> int:
        """Return the error byte: the error of the instruction together with the hardware errors."""
        return error | self.errors

    def answer(self, frame: Frame, now: float) -> tuple[int, bytes] | None:
        """Execute `frame`, which is sent to this id or to all. Return the error byte and the parameters of the reply,
        None if there is no reply.
        """
        if frame.instruction == Instruction.PING and frame.sound:
            return self.alerted(0), b""
        if frame.instruction == Instruction.READ and frame.sound:
            p = frame.parameters
            error, data = self.read(p[0], p[1], now) if len(p) == 2 else (MX_RANGE, b"")
            return (self.alerted(error), data) if self.line.level > 0 else None
        error = self._done(frame, now)
        return (self.alerted(error), b"") if self.line.level > 1 else None

    def read(self, address: int, size: int, now: float) -> tuple[int, bytes]:
        """Return the error and the bytes of a read of `size` bytes at `now`."""
        if size == 0 or address + size > len(self.registers.memory):
            return MX_RANGE, b""
        self._refresh(now)
        return 0, bytes(self.registers.memory[address : address + size])

    def write(self, address: int, data: bytes) -> int:
        """Write `data` as a write instruction does. Return the error."""
        error, changes = self._checked(address, data)
        if error:
            return error
        for item, value in changes:
            self.registers.store(item, value)
        if any(item.name == "torque_enable" for item, _ in changes):
            self._torque(on=bool(self.get("torque_enable")))
        self._hand_over_goals()
        return 0

    def _done(self, frame: Frame, now: float) -> int:
        if not frame.sound:
            return MX_CHECKSUM
        if frame.instruction in {Instruction.WRITE, Instruction.REG_WRITE} and len(frame.parameters) > 1:
            address, data = frame.parameters[0], frame.parameters[1:]
            if frame.instruction == Instruction.WRITE:
                return self.write(address, data)
            error, _ = self._checked(address, data)
            if not error:
                self._registered = (address, data)
                self.put("registered", 1)
            return error
        if frame.instruction == Instruction.ACTION and self._registered is not None:
            waiting, self._registered = self._registered, None
            self.put("registered", 0)
            return self.write(*waiting)
        if frame.instruction == Instruction.FACTORY_RESET and frame.id != BROADCAST:
            firmware = self.get("firmware_version")
            self.registers.reset()
            self.put("firmware_version", firmware)
        elif frame.instruction != Instruction.REBOOT or self.get("firmware_version") < _REBOOTS:
            return MX_INSTRUCTION
        self.reboot(now)
        return 0

    def _checked(self, address: int, data: bytes) -> tuple[int, list[tuple[Item, int]]]:
        """Return the error of a write of `data`; without an error, also the items with their new values. Nothing is
        changed.
        """
        changes: list[tuple[Item, int]] = []
        for item, raw in self.registers.covered(address, data):
            # the lock is among what it locks: only a loss of power clears it
            kept = item is not None and (item.address < MX_EEPROM_END or item.name == "lock")
            locked = kept and self.get("lock") == 1
            if item is None or not item.writable or locked or len(raw) < item.size:
                return MX_RANGE, []
            value = self.registers.decoded(item, raw)
            if not item.low <= value <= item.high:
                return MX_RANGE, []
            if item.name == "goal_position" and not self._reachable(value):
                return MX_ANGLE, []
            changes.append((item, value))
        return 0, changes

    def _reachable(self, goal: int) -> bool:
        low, high = self.get("cw_angle_limit"), self.get("ccw_angle_limit")
        return self._multi_turn or (low, high) == (0, 0) or low <= goal <= high

    @property
    def _multi_turn(self) -> bool:
        return self.get("cw_angle_limit") == self.get("ccw_angle_limit") == _MULTI_TURN

    def _torque(self, *, on: bool) -> None:
        if not on and self.life.ignores_off and self.motor.enabled:
            self.put("torque_enable", 1)
        elif on and not self.motor.enabled:
            self.motor.enable()
        elif not on:
            self.motor.disable()

    def _hand_over_goals(self) -> None:
        limit = self.get("torque_limit")
        share = limit / 1023.0 * self.model.stall[1]
        if self.get("torque_control"):
            wanted = max(-limit, min(limit, _signed(self.get("goal_torque"))))
            self.motor.law.goals = Goals(mode=CURRENT, current=wanted * self.model.current_lsb)
        elif self.get("cw_angle_limit") == self.get("ccw_angle_limit") == 0:
            self.motor.law.goals = Goals(mode=SPEED, current=share, velocity=_signed(self.get("moving_speed")) * MX_RPM)
        else:
            goal = self.get("goal_position") - (self.get("multi_turn_offset") if self._multi_turn else 0)
            self.motor.law.goals = Goals(mode=CURRENT_POSITION, current=share, position=goal * COUNT)

    def _position(self) -> int:
        """Return Present Position in counts: over many turns in multi-turn mode, else within one turn."""
        counts = round(self.motor.position / COUNT)
        if self._multi_turn and not self.get("torque_control"):
            return counts + self.get("multi_turn_offset")
        return counts % _TURN

    def _refresh(self, now: float) -> None:
        """Write the present values at `now` (position, current ...) to the control table."""
        motor = self.motor
        self.put("realtime_tick", int((now - self.life.booted) * 1e3) % 32768)
        self.put("present_position", self._position())
        speed = round(motor.velocity / MX_RPM)
        self.put("present_speed", _directed(speed))
        self.put("moving", int(abs(speed) > 0))
        self.put("present_load", _directed(round(motor.law.duty(motor) * 1000.0)))
        self.put("current", 2048 + round(motor.law.current(motor) / self.model.current_lsb))
        self.put("present_voltage", round(self.model.stall[0] * 10.0))
        self.put("present_temperature", round(motor.temperature))


def _signed(value: int) -> int:
    return -(value - _CW) if value >= _CW else value


def _directed(value: int) -> int:
    """Return a number encoded in 10 bits with the direction in bit 10, which is set for clockwise (negative)."""
    return min(1023, abs(value)) | (_CW if value < 0 else 0)
