"""An emulated Feetech servo: its memory, the effect of each instruction, and the replies.

Sources: the vendor's protocol manual and memory tables (ftservo/ftservo-wiki, docs/reference: protocol/ft-scs.md,
parameter/memory-sts.md, memory-hls.md, memory-scscl.md). Owners of servos measured the following. A write of Goal
Position(42) switches the torque on (beam-bots/bb_servo_feetech; jakegibs617/robotic-arm-paint saw none for a goal that
equals the present position), and in speed mode a write of the speed does (a LeKiwi base), even of 0. Position
Offset(31) is subtracted from the encoder's position (huggingface/lerobot, motors/feetech), and the calibration
instruction stores it without unlocking (orcahand/orca_core).

The following is not in these sources and is assumed here. An instruction that the servo does not have gets no reply,
because no bit of the status means this. A write of a value out of range, or to a read-only address, is confirmed but
ignored. A read may span addresses without an item, which read as zero. A request with a wrong checksum gets no reply.
An error that is selected in Unloading Condition(19) switches the output off until the error has ended and Torque
Enable(40) is written again. An overload, Protection Time with more than Overload Torque in % of Torque Limit, only
reduces the output to Protective Torque, until a goal in the other direction is written. A write to the EEPROM while the
lock is 1 takes effect but is lost without power; so does a restored backup. Gains, dead zones, acceleration and the LED
have no effect.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from sim_backend.wire.feetech.tables import BAUD, CURRENT_LSB, EEPROM_END, MODELS
from sim_backend.wire.life import Life
from sim_backend.wire.loadcell.joint_torque import JointTorque
from sim_backend.wire.packets.bus import LineSettings
from sim_backend.wire.packets.frames import BROADCAST, Frame, Instruction
from sim_backend.wire.packets.registers import Item, Registers
from sim_backend.wire.packets.regulator import (
    CURRENT,
    CURRENT_POSITION,
    PWM,
    SPEED,
    Goals,
    Regulator,
    joint_at_horn,
)
from sim_backend.wire.plant_motor import PlantMotor

if TYPE_CHECKING:
    from sim_backend.parameters import SimParameters

BOOT = 0.3
"""s after power-on in which the servo does not reply; the manual gives no value."""
RESTART = 1.8
"""s after the instruction Reboot in which the servo does not reply."""
VOLTAGE, ENCODER, HEAT, OVER_CURRENT, ANGLE, OVERLOAD = 1, 2, 4, 8, 16, 32
"""Bits of Servo Status(65), which every reply carries."""
_TURN = 4096
_MIDDLE = 2048
_SINGLE_STEPS, _WHOLE_ANGLE = 0x04, 0x10  # Phase(18)
_RECENTRE = 128
_LOADED = {"torque_limit": "max_torque", "goal_torque": "protection_current"} | {
    f"{gain}_now": gain for gain in ("p_gain", "d_gain", "i_gain")
}
"""The items in RAM that begin with the value of another item when the servo is powered."""
_RESTORE, _REBOOT, _BACKUP, _FORGET_TURNS, _CALIBRATE = 0x06, 0x08, 0x09, 0x0A, 0x0B


class FeetechDevice:
    """An emulated servo of `model` (a key of `MODELS`). The plant of `parameters` is attached to its output.

    Times are s on the bus's clock. now: s, when the servo is powered. joint: record of the torque in the coupling.
    Raises KeyError for a model, and ValueError for a baud rate, that is not in the tables.
    """

    def __init__(
        self,
        model: str,
        ident: int = 1,
        *,
        baudrate: int = 1_000_000,
        firmware: tuple[int, int] | None = None,
        parameters: SimParameters | None = None,
        now: float = 0.0,
    ) -> None:
        self.model = MODELS[model]
        self.registers = Registers(self.model.items, big=self.model.big)
        self.get, self.put = self.registers.get, self.registers.put
        self._flash = bytearray(EEPROM_END)
        self.joint = JointTorque()
        plant = joint_at_horn(self.model, parameters)
        self.motor = PlantMotor(plant, Regulator(self.model), self.joint.note)
        self.errors = 0
        """The present errors, as bits of the status."""
        self.life = Life(self.motor, now)
        self._registered: tuple[int, bytes] | None = None
        self._resisted = 0.0
        self._limit = "torque_limit" if self.registers.has("torque_limit") else "max_torque"
        self._centre = 1023 // 2 if self.model.big else 0
        major, minor = firmware or self.model.firmware
        identity = {"firmware_major": major, "firmware_minor": minor, "id": ident, "baud_rate": BAUD.index(baudrate)}
        identity |= {"main_version": self.model.number[0], "sub_version": self.model.number[1]}
        for name, value in identity.items():
            self.put(name, value)
        self._flash[:] = self._backup = self.registers.memory[:EEPROM_END]
        self.put("goal_position", self._position())

    def mount_at_middle(self) -> None:
        """Set the encoder's zero such that the present position is the middle of the servo's turn."""
        self._centre += (511 if self.model.big else _MIDDLE) - self._position()
        self.put("goal_position", self._position())

    @property
    def line(self) -> LineSettings:
        """The servo's settings for the serial line. Pings and reads are always answered; a Sync Read is answered by all
        series except SCS.
        """
        get = self.get
        return LineSettings(
            get("id"),
            BAUD[get("baud_rate")],
            get("return_delay") * 2e-6,
            1 + get("response_level"),
            get("second_id") if self.registers.has("second_id") else None,
            frozenset({Instruction.SYNC_WRITE} if self.model.big else {Instruction.SYNC_WRITE, Instruction.SYNC_READ}),
        )

    def eeprom(self) -> bytes:
        """Return the bytes that survive a loss of power."""
        return bytes(self._flash)

    def mean(self, begin: float, end: float) -> float:
        """Return the mean torque at the joint from `begin` to `end`, s, in N m, which a torque cell at the joint
        measures.
        """
        self.advance(end)
        return self.joint.mean(begin - self.life.powered, end - self.life.powered)

    def advance(self, now: float) -> None:
        """Simulate the motor up to `now`. Over-temperature is an error only while it lasts."""
        while self.life.overloads(now, self._loaded, self.get("protection_time") * 0.01):
            self._resisted = math.copysign(1.0, self.motor.torque)
            self.fail(OVERLOAD)
        if self.motor.temperature > self.get("temperature_limit"):
            self.fail(HEAT)
        else:
            self.errors &= ~HEAT

    def _loaded(self) -> bool:
        """Return whether the torque is above Overload Torque, in % of Torque Limit."""
        most = self.get("overload_torque") / 100.0 * self.get(self._limit) / 1000.0 * self.model.stall[2]
        return self.registers.has("overload_torque") and abs(self.motor.torque) > most

    def fail(self, bits: int) -> None:
        """Report the errors `bits`. Errors that are selected in Unloading Condition(19) switch the output off."""
        self.errors |= bits
        if bits & self.get("unloading_condition") & ~OVERLOAD:
            self.motor.disable()
            self.put("torque_enable", 0)
        self._hand_over_goals()

    def reboot(self, now: float, lasting: float = BOOT) -> None:
        """Cut the servo's power for a moment: the torque goes off and the contents of the RAM are lost."""
        self.life.boot(now, lasting)
        self.errors = 0
        self._registered = None
        self.registers.reset(EEPROM_END)
        self.registers.memory[:EEPROM_END] = self._flash
        for name, stored in _LOADED.items():
            self.put(name, self.get(stored))
        self._forget_turns()

    def alerted(self, error: int) -> int:
        """Return the error byte of a reply: the servo's present errors. `error` is ignored, because instructions have
        no errors of their own.
        """
        del error
        return self.errors

    def answer(self, frame: Frame, now: float) -> tuple[int, bytes] | None:
        """Execute `frame`, which is sent to this id or to all. Return the error byte and the parameters of the reply,
        None if there is no reply.
        """
        if not frame.sound:
            return None
        if frame.instruction == Instruction.PING:
            return self.errors, b""
        if frame.instruction == Instruction.READ:
            p = frame.parameters
            return self.read(p[0], p[1], now) if len(p) == 2 else None
        done = self._execute(frame, now)
        return (self.errors, b"") if done and self.get("response_level") and frame.id != BROADCAST else None

    def read(self, address: int, size: int, now: float) -> tuple[int, bytes]:
        """Return the error byte and the bytes of a read at `now`. Addresses beyond the memory read as zero."""
        del now
        self._refresh()
        return self.errors, bytes(self.registers.memory[address : address + size]).ljust(size, b"\0")

    def write(self, address: int, data: bytes) -> int:
        """Write `data` as a write instruction does. Return the error byte."""
        written = set()
        for item, raw in self.registers.covered(address, data):
            if item is not None and item.writable and len(raw) == item.size and self._take(item, raw):
                written.add(item.name)
        if "id" in written:
            self.put("second_id", self.get("id"))
        if "goal_position" in written and self._resisted * (self._goal() - self._counts()) <= 0.0:
            self.errors &= ~OVERLOAD
        if "torque_enable" in written:
            self._torque()
        elif ("goal_velocity" if self._mode() == SPEED else "goal_position") in written:
            self.put("torque_enable", 1)
            self._torque()
        self._hand_over_goals()
        return self.errors

    def _take(self, item: Item, data: bytes) -> bool:
        """Store the bytes of `item` if they are in its range. Return whether they are."""
        value = self.registers.decoded(item, data)
        wanted = item.low <= value <= item.high
        if item.name == "torque_enable":  # only an STS sets its middle with it
            wanted = value < 3 or (value == _RECENTRE and self.model.family == "sts")
        if wanted:
            self.registers.memory[item.address : item.address + item.size] = data
            if item.address < EEPROM_END and not self.get("lock"):
                self._burn(item.name)
        return wanted

    def _burn(self, name: str) -> None:
        """Store the item `name` such that it survives a loss of power."""
        if (item := self.registers.item(name)) is not None:
            place = slice(item.address, item.address + item.size)
            self._flash[place] = self.registers.memory[place]

    def _execute(self, frame: Frame, now: float) -> bool:
        """Execute an instruction that changes the servo's state. Return whether the servo replies to it."""
        p = frame.parameters
        match frame.instruction:
            case Instruction.WRITE if len(p) > 1:
                self.write(p[0], p[1:])
            case Instruction.REG_WRITE if len(p) > 1:
                self._registered = (p[0], p[1:])
                self.put("registered", 1)
            case Instruction.ACTION:
                waiting, self._registered = self._registered, None
                self.put("registered", 0)
                if waiting is not None:
                    self.write(*waiting)
            case n if n == _RESTORE:
                self._restore()
            case n if n == _BACKUP:
                self._backup = self.registers.memory[:EEPROM_END]
            case n if n == _FORGET_TURNS:
                self._forget_turns()
            case n if n == _CALIBRATE:
                return self._calibrate(p)
            case n if n == _REBOOT:
                self.reboot(now, RESTART)
                return False
            case _:
                return False
        return True

    def _restore(self) -> None:
        """Set the EEPROM, except for the id, to the latest backup; before the first backup, to the values as
        delivered.
        """
        kept = self.get("id")
        self.registers.memory[:EEPROM_END] = self._backup
        self.put("id", kept)
        if not self.get("lock"):
            self._flash[:] = self.registers.memory[:EEPROM_END]
        self._hand_over_goals()

    def _calibrate(self, parameters: bytes) -> bool:
        """Set the present position to the one given in two bytes, or to the middle. Return whether this firmware
        supports it.
        """
        oldest = self.model.calibrates[bool(parameters)] if self.model.calibrates else (256, 0)
        if (self.get("firmware_major"), self.get("firmware_minor")) < oldest or len(parameters) not in {0, 2}:
            return False
        self._reads(int.from_bytes(parameters, "little") if parameters else _MIDDLE)
        return True

    def _reads(self, position: int) -> None:
        """Let the servo read `position` where it stands: change Position Offset(31) by at most half a turn, and forget
        whole turns. The servo does not move.
        """
        offset = self.get("position_offset") + self._counts() - position
        within = (offset + _TURN // 2) % _TURN - _TURN // 2
        self._centre += within - offset
        self.put("position_offset", within)
        self._burn("position_offset")
        self._stay()

    def _forget_turns(self) -> None:
        if not self.model.big:
            self._centre -= math.floor(self._counts() / _TURN) * _TURN
        self._stay()

    def _stay(self) -> None:
        self.put("goal_position", self._position())
        self._hand_over_goals()

    def _torque(self) -> None:
        wanted = self.get("torque_enable")
        if wanted == _RECENTRE:
            self.put("torque_enable", int(self.motor.enabled))
            self._reads(_MIDDLE)
        elif wanted == 1 and not self.errors & self.get("unloading_condition") & ~OVERLOAD:
            if not self.motor.enabled:
                self.motor.enable()
        elif wanted == 0 and self.life.ignores_off and self.motor.enabled:
            self.put("torque_enable", 1)
        else:
            self.motor.disable()
            self.put("torque_enable", 0 if wanted == 1 else wanted)

    def _hand_over_goals(self) -> None:
        """Pass the goals in the memory to the control loops, with the meaning that each mode number has in this
        series.
        """
        amperes = self.model.stall[1]
        mode = self._mode()
        ceiling = self.get(self._limit) / 1000.0 * amperes
        if self.errors & OVERLOAD and self.registers.has("protective_torque"):
            ceiling = min(ceiling, self.get("protective_torque") / 100.0 * amperes)
        current = 0.0
        if self.registers.has("goal_torque"):
            most = self.get("protection_current") * CURRENT_LSB
            current = max(-most, min(most, self.get("goal_torque") * CURRENT_LSB))
            ceiling = min(ceiling, abs(current))
        if mode == CURRENT:
            goals = Goals(mode=CURRENT, current=max(-ceiling, min(ceiling, current)))
        elif mode == SPEED:
            goals = Goals(mode=SPEED, current=ceiling, velocity=self.get("goal_velocity") * self._speed_unit())
        elif mode == PWM:
            duty = self.get("goal_torque" if self.registers.has("goal_torque") else "goal_time")
            goals = Goals(mode=PWM, duty=duty / 1000.0)
        else:
            goal = (self._goal() - self._zero()) * self.model.count
            goals = Goals(mode=CURRENT_POSITION, current=ceiling, position=goal)
        self.motor.law.goals = goals

    def _mode(self) -> int:
        if not self.registers.has("operating_mode"):
            return PWM if self.get("min_position_limit") == self.get("max_position_limit") == 0 else CURRENT_POSITION
        third, fourth = (CURRENT, PWM) if self.registers.has("goal_torque") else (PWM, CURRENT_POSITION)
        return (CURRENT_POSITION, SPEED, third, fourth)[self.get("operating_mode")]

    def _goal(self) -> int:
        """Return the goal position in counts: clamped to the position limits, in the servo's present turn. If both
        limits are 0, the goal counts over any number of turns and is not clamped.
        """
        goal, low, high = (self.get(n) for n in ("goal_position", "min_position_limit", "max_position_limit"))
        if low == high == 0:
            return goal
        present = self._counts()
        turn = 0 if self.model.big else math.floor(present / _TURN) * _TURN
        return turn + max(low, min(high, goal))

    def _speed_unit(self) -> float:
        """The speed in one count, rad/s."""
        single = self.model.big or (not self.registers.has("goal_torque") and self.get("phase") & _SINGLE_STEPS)
        return self.model.count * (1 if single else 50)

    def _zero(self) -> int:
        """Return the position, in counts, at which the motor's angle is zero."""
        return self._centre - self.get("position_offset")

    def _counts(self) -> int:
        return round(self.motor.position / self.model.count) + self._zero()

    def _position(self) -> int:
        """Return Present Position: over many turns if Phase(18) says so, else within one turn."""
        counts = self._counts()
        if self.model.big:
            return max(0, min(1023, counts))
        return counts if self.get("phase") & _WHOLE_ANGLE else counts % _TURN

    def _refresh(self) -> None:
        """Write the present values (position, current ...) to the memory."""
        motor, law = self.motor, self.motor.law
        speed = round(motor.velocity / self._speed_unit())
        self.put("present_position", self._position())
        self.put("present_speed", max(-32767, min(32767, speed)))
        self.put("target_position", self.get("goal_position"))
        self.put("present_load", round(law.duty(motor) * 1000.0))
        self.put("present_voltage", round(self.model.stall[0] * 10.0))
        self.put("present_temperature", round(motor.temperature))
        self.put("status", self.errors)
        self.put("moving", int(speed != 0))
        self.put("present_current", round(law.current(motor) / CURRENT_LSB))
