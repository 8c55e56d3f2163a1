"""An emulated moteus on a CAN FD bus. The plant is attached to its motor.

Source: mjbots/moteus docs/protocol/registers.md, can.md, diagnostic.md and docs/reference/configuration.md. These
documents do not state the following, which is assumed here: a motor that is switched on follows set-points from the
third command on; the error number of a refused register is 1; a boot takes 0.1 s; torque is reported in steps of 2 mN
m, the resolution of an analogue converter. Ki has no effect. Modes that drive the phases directly (PWM, voltage,
voltage FOC, inductance) need a model of the rotor, which the plant lacks: they end in the fault "motor not configured".
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

from sim_backend.wire.canbus.frames import CanFrame, padded
from sim_backend.wire.canbus.impedance import Impedance
from sim_backend.wire.default_joint import fitting_joint
from sim_backend.wire.life import Life
from sim_backend.wire.moteus.channels import CHANNELS
from sim_backend.wire.moteus.command import (
    BRAKE,
    POSITION,
    RESISTANCE,
    RUNNING,
    TIMED,
    TIMEOUT,
    TORQUE_CONSTANT,
    TURN,
    ZERO_VELOCITY,
    Command,
    arrived,
)
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
from sim_backend.wire.moteus.registers import COMMANDS, READABLE, UNITS
from sim_backend.wire.plant_motor import PlantMotor

if TYPE_CHECKING:
    from sim_backend.parameters import SimParameters

COUNTS = 16384
TORQUE_LSB = 2e-3
BOOT = 0.1

STOPPED, FAULT, PREPARING = 0, 1, 4
_PHASES = frozenset({5, 6, 7, 14})
"""The modes that drive the phases directly: PWM, voltage, voltage FOC, inductance."""
_ALIASES = {0x042: 0x022, 0x043: 0x023, 0x044: 0x024, 0x045: 0x025, 0x046: 0x027, 0x047: 0x02B, 0x048: 0x02D}
"""Registers of the mode "stay within bounds" that are the same as registers of the position mode."""
DRIVER_FAULT, NOT_CONFIGURED, OVER_TEMPERATURE, OUTSIDE_LIMIT = 33, 36, 38, 39
_PREPARATION = 3
_LONGEST_REPLY = 64


class MoteusDevice:
    """An emulated controller with id `ident`. Times are s on the bus's clock. firmware: major, minor and micro
    version.
    """

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
        channels = {name: partial(channel, self) for name, channel in CHANNELS.items()}
        self.console = Console(ident, channels)
        most = self.console.values["servo.max_current_A"] * TORQUE_CONSTANT
        plant = parameters or fitting_joint(most, TORQUE_CONSTANT, RESISTANCE)
        self.motor: PlantMotor[Any] = PlantMotor(plant, Impedance())
        self.command = Command(self.console)
        self.identity = {0x100: 0x20, 0x102: register_map, 0x110: ident, 0x158: 1}
        self.identity[0x101] = firmware[0] << 16 | firmware[1] << 8 | firmware[2]
        self.identity |= {0x120 + i: word for i, word in enumerate(serial)}
        self.identity |= {0x150 + i: 0x01020304 * (i + 1) for i in range(4)}
        self.unknown: set[int] = set()
        """Registers that the emulated firmware does not have."""
        self.life = Life(self.motor, now, self._watches, lambda: self.mode == TIMEOUT)
        self._offset = 0.0
        self._restart()

    def _restart(self) -> None:
        self.mode, self.fault = STOPPED, 0
        self.command.clear()
        self.command.forget()
        self._steps = 0

    @property
    def ident(self) -> int:
        """The id on the bus."""
        return int(self.console.values["id.id"])

    @property
    def turns(self) -> float:
        """The position at the output, rev, rounded to encoder counts."""
        return round((self.motor.position - self._offset) / TURN * COUNTS) / COUNTS

    def _watches(self) -> bool:
        return self.mode in TIMED and math.isfinite(self._timeout())

    def due(self) -> float:
        """Return infinity: the controller sends nothing without a request."""
        return math.inf

    def unasked(self, now: float) -> list[CanFrame]:
        """Return no frame: the controller sends nothing without a request."""
        self.advance(now)
        return []

    def reboot(self, now: float) -> None:
        """Switch the torque off, lose the contents of the RAM, and do not reply until the boot has ended."""
        self.life.boot(now, BOOT)
        self.console.load()
        self._restart()
        self._offset = self.motor.position - (self.motor.position % TURN)

    def fail(self, code: int) -> None:
        """Enter the fault mode with the fault `code`; the torque goes off."""
        self.mode, self.fault = FAULT, code
        self.motor.disable()

    def advance(self, now: float) -> None:
        """Simulate the motor up to `now` and check for faults."""
        if self.life.lapses(now, self._timeout()):
            self._time_out()
        self.life.run(now)
        get = self.console.values.get
        hottest = (get("servo.fault_temperature", math.inf), get("servo.motor_fault_temperature", math.inf))
        if self.mode not in {STOPPED, FAULT} and any(self.motor.temperature > limit for limit in hottest):
            self.fail(OVER_TEMPERATURE)

    def handle(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """Return the replies to a frame."""
        source, target = frame.ident >> 8 & 0xFF, frame.ident & 0x7F
        if frame.remote or frame.error or now < self.life.ready or target not in {self.ident, 0x7F}:
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
                    for name, value in self.console.requests():
                        self._asked(name, value)
                return b""
            case Poll():
                return console(subframe.channel, self.console.give(subframe.most) if subframe.channel == 1 else b"")

    # -- registers --------------------------------------------------------------------------------------------------

    def _read(self, subframe: Read, now: float) -> bytes:
        """Return the reply to a read: the values of the registers that exist, and a refusal for each register that does
        not.
        """
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
        """Return the value of register `number`; None if it does not exist."""
        live = {
            0x000: float(self.mode),
            0x001: self.turns,
            0x002: self.motor.velocity / TURN,
            0x003: round(self.motor.torque / TORQUE_LSB) * TORQUE_LSB,
            0x004: self.motor.torque / TORQUE_CONSTANT,
            0x007: self.motor.torque * self.motor.velocity,
            0x00A: self.motor.temperature if self.console.values["servo.enable_motor_temperature"] else math.nan,
            0x00B: float(arrived(self.motor)),
            0x00C: 1.0,
            0x00D: 24.0,
            0x00E: self.motor.temperature,
            0x00F: float(self.fault or self._limiting()),
            0x03A: self.motor.demand,
            0x070: math.floor((now - self.life.booted) * 1e3 + 1e-9),
        }
        if number in live:
            return live[number]
        if number in self.identity:
            return float(self.identity[number])
        if _ALIASES.get(number, number) in COMMANDS:
            return self.command.values[_ALIASES.get(number, number)]
        return 0.0 if number in READABLE else None

    def _write(self, number: int, kind: int, raw: float, now: float) -> bytes:
        if number == 0 and 0 <= raw <= BRAKE:
            self._enter(int(raw), now)
        elif _ALIASES.get(number, number) in COMMANDS and number not in self.unknown:
            self.command.values[_ALIASES.get(number, number)] = valued(raw, UNITS.get(number), kind)
        elif number in {0x130, 0x131}:
            self._asked("exact", valued(raw, UNITS[0x001], kind))
        else:
            return refusal(True, number)
        return b""

    # -- modes ------------------------------------------------------------------------------------------------------

    def _enter(self, mode: int, now: float) -> None:
        """Execute a mode command. It first resets all command registers to the values that they have when a frame does
        not write them. A stop clears a fault and a timeout.
        """
        self.command.clear()
        if mode == STOPPED:
            self._stop()
        elif mode in RUNNING | _PHASES and self.mode not in {FAULT, TIMEOUT}:
            self.life.heard = now
            self._steps += 1
            if self.mode == STOPPED and mode in TIMED and self._outside():
                self.fail(OUTSIDE_LIMIT)
            elif self._steps < _PREPARATION:
                self.mode = PREPARING
            elif mode in _PHASES:
                self.fail(NOT_CONFIGURED)
            elif self.mode != mode:
                self.mode = mode
                self.command.forget()
                self.motor.enable()

    def _outside(self) -> bool:
        low, high = self.console.values["servopos.position_min"], self.console.values["servopos.position_max"]
        return self.turns < low or self.turns > high

    def _stop(self) -> None:
        if self.life.ignores_off:
            return
        self.mode, self.fault, self._steps = STOPPED, 0, 0
        self.motor.disable()

    def _timeout(self) -> float:
        asked = self.command.values[0x027]
        seconds = self.console.values["servo.default_timeout_s"] if asked == 0.0 else asked
        return math.inf if math.isnan(seconds) else seconds

    def _time_out(self) -> None:
        """React to the tripped watchdog as servo.timeout_mode says: switch off, hold the position, damp or brake."""
        self.mode = TIMEOUT
        self.command.clear()
        mode = int(self.console.values["servo.timeout_mode"])
        if mode in {POSITION, ZERO_VELOCITY, BRAKE}:
            self.command.forget()
            self.motor.follow(self._law(mode))
        else:
            self.motor.disable()

    def _follow(self) -> None:
        """Set the motor's demand law from mode and command registers."""
        if self.mode in RUNNING:
            self.motor.follow(self._law(self.mode))

    def _law(self, mode: int) -> Any:
        return self.command.law(mode, self.motor, self._offset)

    def _asked(self, name: str, value: float) -> None:
        """Execute a `d` command: stop, or set the position to `value`, rev. "nearest" shifts the position by whole
        turns only.
        """
        if name == "stop":
            self._stop()
        if name == "stop" or not math.isfinite(value):
            return
        error = self.turns - value
        self._offset += (round(error) if name in {"nearest", "rezero"} else error) * TURN

    def _limiting(self) -> int:
        """Return the code of the limit that acts on the torque; 0 if no limit acts."""
        if self.mode not in TIMED:
            return 0
        if self.command.derated(self.motor) < 1.0:
            return 96
        return 102 if abs(self.motor.demand) >= self.command.ceiling() > 0.0 else 0
