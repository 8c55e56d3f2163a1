"""One moteus on a CAN FD bus, with the plant behind its motor.

Source: mjbots/moteus docs/protocol/registers.md, can.md, diagnostic.md and docs/reference/configuration.md. What they
leave open: getting ready takes three commands; a refused register's error number is 1; a boot takes 0.1 s; torque is
reported in steps of 2 mN m, the resolution of an analogue converter. Ki and the generated trajectories have no effect.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from sim_backend.wire.canbus.frames import CanFrame, padded
from sim_backend.wire.canbus.impedance import CanMotor, Impedance, scaled_joint
from sim_backend.wire.moteus.console import Console
from sim_backend.wire.moteus.frames import (
    Poll,
    Read,
    Reader,
    Say,
    Subframe,
    Write,
    console,
    counted,
    refusal,
    reply,
    valued,
)
from sim_backend.wire.moteus.registers import COMMANDS, READABLE, UNITS, UNSET

if TYPE_CHECKING:
    from sim_backend.parameters import SimParameters

TURN = 2.0 * math.pi
COUNTS = 16384
TORQUE_LSB = 2e-3
TORQUE_CONSTANT = 0.05
SCALE = 20.0
"""The paper's joint with torques as large as suit the motor."""
BOOT = 0.1

STOPPED, FAULT, PREPARING, POSITION, TIMEOUT = 0, 1, 4, 10, 11
DRIVER_FAULT, OVER_TEMPERATURE, OUTSIDE_LIMIT = 33, 38, 39
_LONGEST_REPLY = 64


class MoteusDevice:
    """A controller with id `ident`. Times are s on the bus's clock. firmware: major, minor, micro."""

    def __init__(
        self,
        ident: int = 1,
        *,
        firmware: tuple[int, int, int] = (1, 1, 0),
        register_map: int = 5,
        serial: tuple[int, int, int] = (0x12345678, 0x23456789, 0x3456789A),
        parameters: SimParameters | None = None,
        now: float = 0.0,
    ) -> None:
        self.motor = CanMotor(parameters or scaled_joint(SCALE, TORQUE_CONSTANT, 0.1), Impedance())
        self.console = Console(ident)
        self._identity = {0x100: 0x20, 0x102: register_map, 0x110: ident, 0x158: 1}
        self._identity[0x101] = firmware[0] << 16 | firmware[1] << 8 | firmware[2]
        self._identity |= {0x120 + i: word for i, word in enumerate(serial)}
        self._identity |= {0x150 + i: 0x01020304 * (i + 1) for i in range(4)}
        self.unknown: set[int] = set()
        """Registers that this firmware does not have."""
        self.ignores_stop = False
        """A stop is taken and not done."""
        self._powered = now
        self._offset = 0.0
        self._restart(now)

    def _restart(self, now: float) -> None:
        self.mode, self.fault = STOPPED, 0
        self._booted = self._heard = now
        self._ready = now
        self._commands = dict(UNSET)
        self._held = math.nan
        self._steps = 0

    @property
    def ident(self) -> int:
        """The id on the bus."""
        return int(self.console.values["id.id"])

    @property
    def turns(self) -> float:
        """rev at the output, in whole counts."""
        return round((self.motor.position - self._offset) / TURN * COUNTS) / COUNTS

    def due(self) -> float:
        """Return infinity: it sends nothing unasked."""
        return math.inf

    def unasked(self, now: float) -> list[CanFrame]:
        """Return no frame."""
        self.advance(now)
        return []

    def reboot(self, now: float) -> None:
        """Lose what is in RAM, the torque first, and be silent for a while."""
        self.motor.disable()
        self.console.load()
        self._restart(now)
        self._offset = self.motor.position - (self.motor.position % TURN)
        self._ready = now + BOOT

    def fail(self, code: int) -> None:
        """Go into fault."""
        self.mode, self.fault = FAULT, code
        self.motor.disable()

    def advance(self, now: float) -> None:
        """Carry the motor to `now` and look for faults."""
        timeout = self._timeout()
        if self.mode == POSITION and now - self._heard > timeout:
            self.motor.run(self._heard + timeout - self._powered)
            self._time_out()
        self.motor.run(now - self._powered)
        get = self.console.values.get
        hottest = (get("servo.fault_temperature", math.inf), get("servo.motor_fault_temperature", math.inf))
        if self.mode not in {STOPPED, FAULT} and any(self.motor.temperature > limit for limit in hottest):
            self.fail(OVER_TEMPERATURE)

    def handle(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """Return the replies to a frame."""
        source, target = frame.ident >> 8 & 0xFF, frame.ident & 0x7F
        if frame.remote or frame.error or now < self._ready or target not in {self.ident, 0x7F}:
            return []
        self.advance(now)
        out = b"".join(self._done(subframe, now) for subframe in Reader(frame.data).subframes())
        self._follow()
        if not source & 0x80 or not out:
            return []
        ident = self.ident << 8 | source & 0x7F
        return [CanFrame(ident, padded(out[:_LONGEST_REPLY]), extended=ident > 0x7FF, fd=True, fast=frame.fast)]

    def _done(self, subframe: Subframe, now: float) -> bytes:
        match subframe:
            case Write():
                return b"".join(
                    self._write(subframe.start + i, subframe.kind, raw, now) for i, raw in enumerate(subframe.values)
                )
            case Read():
                self._follow()
                return self._read(subframe, now)
            case Say():
                if subframe.channel == 1:
                    self.console.take(subframe.text)
                    if self.console.stop_asked():
                        self._stop()
                return b""
            case Poll():
                return console(subframe.channel, self.console.give(subframe.most) if subframe.channel == 1 else b"")

    # -- registers --------------------------------------------------------------------------------------------------

    def _read(self, subframe: Read, now: float) -> bytes:
        """Runs of registers that there are, and refusals of those that there are not."""
        out, start = b"", subframe.start
        run: list[float] = []
        for number in range(subframe.start, subframe.start + min(subframe.count, _LONGEST_REPLY)):
            value = None if number in self.unknown else self._value(number, now)
            if value is None:
                out += (reply(subframe.kind, start, run) if run else b"") + refusal(False, number)
                run, start = [], number + 1
            else:
                run.append(counted(value, UNITS.get(number), subframe.kind))
        return out + (reply(subframe.kind, start, run) if run else b"")

    def _value(self, number: int, now: float) -> float | None:
        """A register; None where there is none."""
        live = {
            0x000: float(self.mode),
            0x001: self.turns,
            0x002: self.motor.velocity / TURN,
            0x003: round(self.motor.torque / TORQUE_LSB) * TORQUE_LSB,
            0x004: self.motor.torque / TORQUE_CONSTANT,
            0x007: self.motor.torque * self.motor.velocity,
            0x00A: self.motor.temperature if self.console.values["servo.enable_motor_temperature"] else math.nan,
            0x00B: 1.0,
            0x00C: 1.0,
            0x00D: 24.0,
            0x00E: self.motor.temperature,
            0x00F: float(self.fault or self._limiting()),
            0x03A: self.motor.demand,
            0x070: math.floor((now - self._booted) * 1e3 + 1e-9),
        }
        if number in live:
            return live[number]
        if number in self._identity:
            return float(self._identity[number])
        if number in COMMANDS:
            return self._commands[number]
        return 0.0 if number in READABLE else None

    def _write(self, number: int, kind: int, raw: float, now: float) -> bytes:
        if number == 0:
            self._enter(int(raw), now)
        elif number in COMMANDS and number not in self.unknown:
            self._commands[number] = valued(raw, UNITS.get(number), kind)
        elif number in {0x130, 0x131}:
            self._offset = self.motor.position - valued(raw, UNITS[0x001], kind) * TURN
        else:
            return refusal(True, number)
        return b""

    # -- modes ------------------------------------------------------------------------------------------------------

    def _enter(self, mode: int, now: float) -> None:
        """Every mode command begins with the commands unset; a stop clears a fault and a timeout."""
        self._commands = dict(UNSET)
        if mode == STOPPED:
            self._stop()
        elif mode == POSITION and self.mode not in {FAULT, TIMEOUT}:
            self._heard = now
            self._steps += 1
            if self.mode == STOPPED and self._outside():
                self.fail(OUTSIDE_LIMIT)
            elif self._steps >= 3 and self.mode != POSITION:
                self.mode, self._held = POSITION, math.nan
                self.motor.enable()
            elif self.mode != POSITION:
                self.mode = PREPARING

    def _outside(self) -> bool:
        low, high = self.console.values["servopos.position_min"], self.console.values["servopos.position_max"]
        return self.turns < low or self.turns > high

    def _stop(self) -> None:
        if self.ignores_stop:
            return
        self.mode, self.fault, self._steps = STOPPED, 0, 0
        self.motor.disable()

    def _timeout(self) -> float:
        asked = self._commands[0x027]
        seconds = self.console.values["servo.default_timeout_s"] if asked == 0.0 else asked
        return math.inf if math.isnan(seconds) else seconds

    def _time_out(self) -> None:
        """Disengage or damp, as servo.timeout_mode is set."""
        self.mode = TIMEOUT
        if int(self.console.values["servo.timeout_mode"]) == 0:
            self.motor.disable()
        else:
            kd = self.console.values["servo.pid_position.kd"] / TURN
            self.motor.follow(Impedance(kd=kd, ceiling=self.console.values["servo.timeout_max_torque_Nm"]))

    def _follow(self) -> None:
        """Set the motor's law from the commands of the position mode."""
        if self.mode != POSITION:
            return
        values, commands = self.console.values, self._commands
        if not math.isnan(commands[0x020]):
            self._held = commands[0x020]
        elif math.isnan(self._held):
            self._held = self.turns
        kp_scale = commands[0x023]
        self.motor.follow(
            Impedance(
                feedforward=commands[0x022],
                kp=values["servo.pid_position.kp"] * kp_scale / TURN,
                kd=values["servo.pid_position.kd"] * min(kp_scale, commands[0x024]) / TURN,
                position=self._held * TURN + self._offset,
                velocity=commands[0x021] * TURN if math.isfinite(commands[0x021]) else 0.0,
                ceiling=self._ceiling() * self._derated(),
            )
        )

    def _ceiling(self) -> float:
        most = self.console.values["servo.max_current_A"] * TORQUE_CONSTANT
        asked = self._commands[0x025]
        return most if math.isnan(asked) else min(most, asked)

    def _derated(self) -> float:
        """Share of the torque that is left above servo.max_velocity."""
        over = abs(self.motor.velocity) / TURN - self.console.values["servo.max_velocity"]
        return max(0.0, min(1.0, 1.0 - over / self.console.values["servo.max_velocity_derate"]))

    def _limiting(self) -> int:
        """The code for what limits the torque."""
        if self.mode != POSITION:
            return 0
        if self._derated() < 1.0:
            return 96
        return 102 if abs(self.motor.demand) >= self._ceiling() > 0.0 else 0
