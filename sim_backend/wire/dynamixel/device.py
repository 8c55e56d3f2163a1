"""An emulated DYNAMIXEL servo with protocol 2.0: the effect of each instruction on control table and motor, and the
replies.

Source: e-manual, "Protocol 2.0" for the instructions; "Bus Watchdog(98)", "Operating Mode(11)", "Shutdown(63)" and
"Hardware Error Status(70)" of the models' pages for the inner behaviour. The manual says only that with a tripped
watchdog "the DYNAMIXEL will stop". Here the current goes to zero in current mode, and the position is held in the other
modes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from sim_backend.wire.dynamixel.control_table import GOALS, ControlTable
from sim_backend.wire.dynamixel.tables import BAUD, MODELS, RPM
from sim_backend.wire.life import Life
from sim_backend.wire.packets.bus import LineSettings
from sim_backend.wire.packets.frames import BROADCAST, Error, Frame, Instruction
from sim_backend.wire.packets.regulator import (
    COUNT,
    CURRENT,
    CURRENT_POSITION,
    POSITION,
    Goals,
    Regulator,
    joint_at_horn,
)
from sim_backend.wire.plant_motor import PlantMotor

if TYPE_CHECKING:
    from sim_backend.parameters import SimParameters

BOOT = 0.3
"""s after a reboot in which the servo does not reply; the manual gives no value."""
ALERT = 0x80
VOLTAGE, OVERHEAT, ENCODER, SHOCK, OVERLOAD = 0x01, 0x04, 0x08, 0x10, 0x20
"""Bits of Hardware Error Status(70)."""

OVERLOADED = 2.0
"""s at the largest output after which a load is an overload; the manual says "persistent"."""
_PWM_LSB = 1.0 / 885.0
_ON_BY_GOAL = 0x08
"""The bit of Drive Mode(10) with which the write of a goal switches the torque on."""
_TOGETHER = frozenset({Instruction.SYNC_READ, Instruction.SYNC_WRITE, Instruction.BULK_READ, Instruction.BULK_WRITE})
_FAST = _TOGETHER | {Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ}


class DynamixelDevice:
    """An emulated servo of `model` (a key of `tables.MODELS`). The plant of `parameters` is attached to its horn.

    Times are s on the bus's clock. now: s, when the servo is powered. Raises KeyError for a model that is not in the
    table.
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
        self.model = MODELS[model]
        self._table = ControlTable(self.model)
        self.registers = self._table.registers
        self.registers.put("id", ident)
        self.registers.put("baud_rate", BAUD.index(baudrate))
        if firmware is not None:
            self.registers.put("firmware_version", firmware)
        self.motor = PlantMotor(joint_at_horn(self.model, parameters), Regulator(self.model))
        self._firmware = self.registers.get("firmware_version")
        self.life = Life(self.motor, now, self._watches, lambda: self.tripped)
        self._registered: tuple[int, bytes] | None = None
        self._turns_off = 0
        self.registers.put("goal_position", self._position())

    @property
    def line(self) -> LineSettings:
        """The servo's settings for the serial line: id, baud rate, return delay."""
        get = self.registers.get
        return LineSettings(
            get("id"),
            BAUD[get("baud_rate")],
            get("return_delay_time") * 2e-6,
            get("status_return_level"),
            get("secondary_id"),
            _FAST if self._newest else _TOGETHER,
        )

    @property
    def _newest(self) -> bool:
        """Return whether the servo's firmware has backups and fast reads; no MX servo has such firmware."""
        return self.registers.has("backup_ready") and self._firmware >= self.model.firmware

    @property
    def tripped(self) -> bool:
        """Return whether the bus watchdog has stopped the servo."""
        return self.registers.get("bus_watchdog") == -1

    def _watches(self) -> bool:
        return self.motor.enabled and self.registers.get("bus_watchdog") > 0

    def advance(self, now: float) -> None:
        """Simulate motor and watchdog up to `now`."""
        period = self.registers.get("bus_watchdog") * 0.02
        if self._watches() and now - self.life.heard > period:
            self.life.run(self.life.heard + period)
            self._trip()
        while self.life.overloads(now, self._loaded, OVERLOADED):
            self.fail(OVERLOAD)
        if self.motor.temperature > self.registers.get("temperature_limit"):
            self.fail(OVERHEAT)

    def _loaded(self) -> bool:
        """Return whether the output is at PWM Limit(36) with more than half of the stall torque."""
        law, motor = self.motor.law, self.motor
        full = abs(law.duty(motor)) >= self.registers.get("pwm_limit") * _PWM_LSB - 1e-3
        return full and abs(motor.torque) > 0.5 * self.model.stall[2]

    def fail(self, bits: int) -> None:
        """Latch the hardware errors `bits`. Errors that are selected in Shutdown(63) switch the torque off."""
        self.registers.put("hardware_error_status", self.registers.get("hardware_error_status") | bits)
        if bits & self.registers.get("shutdown"):
            self._torque(on=False)

    def reboot(self, now: float) -> None:
        """Switch the torque off, lose the contents of the RAM, and do not reply until the boot has ended."""
        self.life.boot(now, BOOT)
        self._table.power_up()
        self.registers.put("goal_position", self._position())
        self._registered = None

    def answer(self, frame: Frame, now: float) -> tuple[int, bytes] | None:
        """Execute `frame`, which is sent to this id or to all. Return the error byte and the parameters of the reply,
        None if there is no reply.
        """
        if frame.instruction == Instruction.PING and frame.sound:
            identity = self.registers.get("model_number").to_bytes(2, "little")
            return self.alerted(Error.NONE), identity + bytes([self._firmware])
        level = self.line.level
        if frame.instruction == Instruction.READ and frame.sound:
            p = frame.parameters
            error, data = self.read(*_words(p), now) if len(p) == 4 else (Error.DATA_LENGTH, b"")
            return (self.alerted(error), data) if level > 0 else None
        error = self._done(frame, now)
        return (self.alerted(error), b"") if level > 1 else None

    def _done(self, frame: Frame, now: float) -> Error:
        """Execute an instruction that changes the servo's state. Return its error."""
        if not frame.sound:
            return Error.CRC
        match frame.instruction:
            case Instruction.WRITE | Instruction.REG_WRITE:
                error = self._written(frame)
            case Instruction.ACTION:
                error = self._action()
            case Instruction.REBOOT:
                self.reboot(now)
                error = Error.NONE
            case Instruction.FACTORY_RESET:
                error = self._factory_reset(frame, now)
            case Instruction.CLEAR:
                error = self._clear(frame.parameters)
            case Instruction.BACKUP if self._newest:
                error = self._backed_up(frame.parameters, now)
            case _:
                error = Error.INSTRUCTION
        return error

    def read(self, address: int, size: int, now: float) -> tuple[int, bytes]:
        """Return the error and the bytes of a read of `size` bytes at `now`."""
        if address + size > 120:
            self._refresh(now)
        return self._table.read(address, size)

    def write(self, address: int, data: bytes) -> Error:
        """Write `data` as a write instruction does. Return the error."""
        mode = self.registers.get("operating_mode")
        error, changes = self._table.check(address, data, torque=self.motor.enabled, tripped=self.tripped)
        if error:
            return error
        for item, value in changes:
            self.registers.store(item, value)
        names = {item.name for item, _ in changes}
        if "operating_mode" in names and self.registers.get("operating_mode") != mode:
            self._mode_changed()
        if "torque_enable" in names:
            self._torque(on=bool(self.registers.get("torque_enable")))
        elif self.registers.get("drive_mode") & _ON_BY_GOAL and names.intersection(GOALS):
            self._torque(on=True)
        self._hand_over_goals()
        return Error.NONE

    def alerted(self, error: int) -> int:
        """Return the error byte: the error number, and the alert bit if a hardware error is latched."""
        return error | (ALERT if self.registers.get("hardware_error_status") else 0)

    def _written(self, frame: Frame) -> Error:
        if len(frame.parameters) < 3:
            return Error.DATA_LENGTH
        address, data = int.from_bytes(frame.parameters[:2], "little"), frame.parameters[2:]
        if frame.instruction == Instruction.WRITE:
            return self.write(address, data)
        error, _ = self._table.check(address, data, torque=self.motor.enabled, tripped=self.tripped)
        if not error:
            self._registered = (address, data)
            self.registers.put("registered_instruction", 1)
        return error

    def _action(self) -> Error:
        if self._registered is None:
            return Error.INSTRUCTION
        address, data = self._registered
        self._registered = None
        self.registers.put("registered_instruction", 0)
        return self.write(address, data)

    def _factory_reset(self, frame: Frame, now: float) -> Error:
        option = frame.parameters[0] if len(frame.parameters) == 1 else 0
        if option not in {0xFF, 0x01, 0x02} or (option == 0xFF and frame.id == BROADCAST):
            return Error.DATA_RANGE
        kept = {"firmware_version": self._firmware}
        if option != 0xFF:
            kept["id"] = self.registers.get("id")
        if option == 0x02:
            kept["baud_rate"] = self.registers.get("baud_rate")
        self.registers.reset()
        for name, value in kept.items():
            self.registers.put(name, value)
        self.reboot(now)
        return Error.NONE

    def _clear(self, parameters: bytes) -> Error:
        """Execute the instruction Clear (0x01 'D' 'X' 'L' 0x22): subtract whole turns from the position."""
        if parameters != b"\x01\x44\x58\x4c\x22":
            return Error.DATA_RANGE
        if abs(self.motor.velocity) > self.registers.get("moving_threshold") * RPM:
            return Error.RESULT_FAIL
        self._turns_off += math.floor(self._position() / 4096)
        return Error.NONE

    def _backed_up(self, parameters: bytes, now: float) -> Error:
        """Execute the instruction Control Table Backup: store a backup (0x01 'C' 'T' 'R' 'L'), or restore it and reboot
        (0x02).
        """
        if parameters not in {b"\x01CTRL", b"\x02CTRL"}:
            return Error.DATA_RANGE
        if self.motor.enabled:
            return Error.RESULT_FAIL
        if parameters[0] == 1:
            self._table.back_up()
            return Error.NONE
        if not self._table.restore():
            return Error.RESULT_FAIL
        self.reboot(now)
        return Error.NONE

    def _position(self) -> int:
        """Return Present Position in counts: the angle of the horn, reversed if the drive mode says so, plus the homing
        offset.
        """
        return round(self._sign() * self.motor.position / COUNT) + self._offset()

    def _offset(self) -> int:
        """Return what is added to the horn's counts: whole turns, and Homing Offset(20), of which position control mode
        ignores values beyond a quarter of a turn.
        """
        offset = self.registers.get("homing_offset")
        ignored = self.registers.get("operating_mode") == POSITION and abs(offset) > 1024
        return (0 if ignored else offset) - 4096 * self._turns_off

    def _lose_turns(self) -> None:
        """Bring the angle without Homing Offset(20) into one turn, as in position control mode the change of mode and
        switching on do (e-manual, "Present Position(132)").
        """
        if self.registers.get("operating_mode") == POSITION:
            self._turns_off = round(self._sign() * self.motor.position / COUNT) // 4096

    def _sign(self) -> int:
        return -1 if self.registers.get("drive_mode") & 1 else 1

    def _mode_changed(self) -> None:
        """Reset goals and profile when the operating mode changes, as the manual's note on Operating Mode(11) says."""
        r = self.registers
        self._lose_turns()
        r.put("goal_pwm", r.get("pwm_limit"))
        r.put("goal_current", r.get("current_limit"))
        r.put("goal_velocity", 0)
        r.put("goal_position", self._position())
        r.put("profile_velocity", 0)
        r.put("profile_acceleration", 0)

    def _torque(self, *, on: bool) -> None:
        if on and self.registers.get("hardware_error_status") & self.registers.get("shutdown"):
            on = False  # a servo that shut down stays off until it is rebooted
        if not on and self.life.ignores_off and self.motor.enabled:
            self.registers.put("torque_enable", 1)
            return
        if on and not self.motor.enabled:
            self._lose_turns()
            self.motor.enable()
        if not on:
            self.motor.disable()
        self.registers.put("torque_enable", int(on))

    def _trip(self) -> None:
        self.registers.put("bus_watchdog", -1)
        if self.motor.watchdog_broken:  # as seen on the 330 series, forum.robotis.com/t/4814
            return
        self.registers.put("goal_velocity", 0)
        self.registers.put("goal_position", self._position())
        self.registers.put("goal_pwm", 0)
        if self.registers.get("operating_mode") == CURRENT:
            self.registers.put("goal_current", 0)
        self._hand_over_goals()

    def _hand_over_goals(self) -> None:
        r, sign = self.registers, self._sign()
        mode = r.get("operating_mode")
        current = r.get("goal_current")
        limit = r.get("current_limit")
        if mode in {CURRENT, CURRENT_POSITION}:
            current = max(-limit, min(limit, current))
        position = r.get("goal_position") - self._offset()
        self.motor.law.goals = Goals(
            mode=mode,
            current=sign * current * self.model.current_lsb,
            velocity=sign * r.get("goal_velocity") * RPM,
            position=sign * position * COUNT,
            duty=sign * r.get("goal_pwm") * _PWM_LSB,
        )

    def _refresh(self, now: float) -> None:
        """Write the present values at `now` (position, current ...) to the control table."""
        r, motor, sign = self.registers, self.motor, self._sign()
        r.put("realtime_tick", int((now - self.life.booted) * 1e3) % 32768)
        velocity = round(sign * motor.velocity / RPM)
        r.put("moving", int(abs(velocity) > r.get("moving_threshold")))
        r.put("present_pwm", round(sign * motor.law.duty(motor) / _PWM_LSB))
        if self.model.current_lsb:
            r.put("present_current", round(sign * motor.law.current(motor) / self.model.current_lsb))
        else:
            r.put("present_load", round(sign * motor.law.duty(motor) * 1000.0))
        r.put("present_velocity", velocity)
        r.put("present_position", self._position())
        r.put("position_trajectory", r.get("goal_position"))
        r.put("velocity_trajectory", r.get("goal_velocity"))
        r.put("present_input_voltage", round(self.model.stall[0] * 10.0))
        r.put("present_temperature", round(motor.temperature))
        if r.get("operating_mode") != POSITION and not motor.enabled:
            r.put("position_trajectory", self._position())


def _words(parameters: bytes) -> tuple[int, int]:
    return int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little")
