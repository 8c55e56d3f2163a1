"""An emulated SimpleFOC board: Commander's parser, character for character, with the emulated motor. No I/O.

Source: Arduino-FOC, src/communication/Commander.cpp, commands.h, src/BLDCMotor.cpp and base_classes/FOCMotor.cpp of
library 2.3.5 and 2.4.0, and docs.simplefoc.com. Gains, filters and modulation are stored and printed but have no
effect. In the open-loop modes the motor carries no current. Measuring and tuning (`F`) fail. The board's program calls
`motor.monitor()` in its loop, as the library's examples do; nothing is printed until a downsample is set.
"""

from __future__ import annotations

import re

import numpy as np

from sim_backend.parameters import SimParameters
from sim_backend.wire.commander.motion import (
    ANGLE_MODE,
    ANGLE_NOCASCADE_MODE,
    TORQUE_MODE,
    VELOCITY_MODE,
    MotionControl,
)
from sim_backend.wire.commander.printer import FRIENDLY, MACHINE, NOTHING, Printer
from sim_backend.wire.loadcell.joint_torque import JointTorque
from sim_backend.wire.plant_motor import PlantMotor

BUFFER = 20
"""Most characters of a command. A longer command is thrown away at this length, and the rest is read as a new
command.
"""

_MOTION = ("torque", "vel", "angle", "vel open", "angle open", "angle nocascade", "custom")
_TORQUE = ("volt", "dc curr", "foc curr", "est. curr")
_PIDS = {"Q": "PID curr q| ", "D": "PID curr d| ", "V": "PID vel| ", "A": "PID angle| "}
_TERMS = {"P": "P: ", "I": "I: ", "D": "D: ", "R": "ramp: ", "L": "limit: ", "F": "Tf: "}
_WATCHED = ("target", "Vq", "Vd", "Cq", "Cd", "vel", "angle")
_LIMITS = {"U": ("volt: ", "voltage_limit"), "C": ("curr: ", "current_limit"), "V": ("vel: ", "velocity_limit")}
_PLAIN = {"R": "R phase: ", "I": "L phase: ", "K": "Motor KV: "}
_OFFSETS = {"M": "offset: ", "E": "el. offset: "}
_SHOWN = 7
_VOLTAGE = 0
"""The torque type (T) for which a limit given with a target is a voltage limit."""


def number(text: str) -> float:
    """Return the number at the beginning of `text`, as C's `atof` reads it, rounded to a 32 bit float; 0 if there is
    none.
    """
    found = re.match(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text)
    with np.errstate(over="ignore"):
        return float(np.float32(found[0])) if found else 0.0


def whole(value: float) -> int:
    """Return `value` truncated to an integer of 32 bits; one that has no such value becomes the largest or lowest."""
    return int(max(-(2.0**31), min(2.0**31 - 1.0, value)))


def _decimals(value: float) -> int:
    """Return a number of decimals, 0 to 60, which is more than the board's numbers have."""
    return max(0, min(60, whole(value)))


class CommanderDevice:
    """The emulated board after its start, with the plant of `parameters` at its motor.

    letter: the letter under which its program added the motor. version: version of the library. joint: the record of
    the torque at the joint.
    """

    def __init__(self, parameters: SimParameters, letter: str = "M", version: tuple[int, int] = (2, 4)) -> None:
        parameters = parameters.resolved()
        self.joint = JointTorque()
        self.modern = version >= (2, 4)
        self.motor = PlantMotor(parameters, MotionControl(parameters, clamps=self.modern), self.joint.note)
        self.letter = letter
        self.echo = False
        """Whether the board's program sets Commander's `echo`: it returns each character that it receives."""
        self.program_downsample = 0
        """The downsample of the monitor that the board's program sets at its start."""
        self.restart()

    @property
    def motion(self) -> MotionControl:
        """The settings and control loops of the motor."""
        return self.motor.law

    def restart(self) -> None:
        """Set everything as the board's program does at its start: the motor is enabled, its target is zero."""
        self.printer = Printer()
        self.torque_type = 0
        self.watched = "1100011"
        self.downsample = self.program_downsample
        self._motion_downsample = 0
        self._monitor_decimals = 4
        self._typed = ""
        self._kept = {"VP": 0.2, "VI": 20.0, "AP": 20.0, "QP": 3.0, "QI": 300.0, "DP": 3.0, "DI": 300.0, "VF": 0.005}
        self._plain: dict[str, float] = {}
        self._centered = 1
        self.motor.disable()
        motion = self.motion
        motion.mode, motion.target = TORQUE_MODE, 0.0
        motion.voltage_limit, motion.current_limit, motion.velocity_limit = 12.0, 2.0, 20.0
        self.motor.enable()

    def monitored(self) -> str:
        """Return a line of `motor.monitor()`: the selected variables, with currents in mA."""
        target, vq, vd, iq, id_, velocity, angle = self._state()
        shown = (target, vq, vd, iq * 1e3, id_ * 1e3, velocity, angle)
        words = [f"{v:.{self._monitor_decimals}f}" for v, on in zip(shown, self.watched, strict=True) if on == "1"]
        return "\t".join(words) + "\r\n" if words else ""

    def type(self, character: str) -> str:
        """Receive one character. Return the text that the board prints in response."""
        returned = character if self.echo else ""
        self._typed += character
        if self.printer.ends(character):
            command, self._typed = self._typed, ""
            self._run(command)
        if len(self._typed) >= BUFFER:
            self._typed = ""
        return returned + self.printer.taken()

    def forget(self) -> None:
        """Discard the command that is being received."""
        self._typed = ""

    def _run(self, command: str) -> None:
        """Execute a command. command: its characters, with the one that ends it."""
        head, rest, out = command[0], command[1:], self.printer
        if head == "?":
            out.machine("?")
            out.say(f"{self.letter}:")
            out.line("motor")
        elif head == "@":
            self._set_verbose(rest)
        elif head == "#":
            if not out.ends(rest[0]):
                out.decimals = _decimals(number(rest))
            out.friendly("Decimal:")
            out.machine("#")
            out.line(out.decimals)
        elif head == self.letter:
            out.machine(head)
            self._command(rest)

    def _set_verbose(self, rest: str) -> None:
        out = self.printer
        if not out.ends(rest[0]):
            out.verbose = whole(number(rest))
        out.friendly("Verb:")
        out.machine("@")
        if out.verbose in {NOTHING, MACHINE}:
            out.line({NOTHING: "off!", MACHINE: "machine"}[out.verbose])
        elif out.verbose <= FRIENDLY:
            out.line("on!")

    def _command(self, text: str) -> None:
        """Execute a command to the motor. text: the characters after the motor's letter."""
        out = self.printer
        if text[0].isdigit() or text[0] in "+-" or out.ends(text[0]):
            self._target(text)
            return
        head, sub = text[0], text[1]
        lettered = "A" <= sub <= "Z"
        rest = text[2:] if lettered or sub == "#" else text[1:]
        value = None if out.ends(rest[0]) else number(rest)
        out.machine(head + (sub if lettered else ""))
        match head:
            case "E" | "C" | "T":
                self._motion(head, sub, text)
            case "L":
                self._limit(sub, value)
            case "M":
                out.friendly("Monitor | ")
                self._monitor(sub, value, rest)
            case "Q" | "D" | "V" | "A":
                self._gain(head, sub, text[2:])
            case "R" | "I" | "K":
                self._rating(head, sub, value)
            case "S":
                out.friendly("Sensor | ")
                self._kept_number(_OFFSETS.get(sub), head + sub, value)
            case "W":
                self._modulation(sub, value)
            case "F" if self.modern:
                self._measurement(sub)
            case _:
                out.friendly("unknown cmd ")
                out.error()

    def _target(self, text: str) -> None:
        motion, out = self.motion, self.printer
        if out.ends(text[0]):
            if out.verbose == MACHINE:
                out.line(motion.target)
            return
        words = [number(word) for word in text.split(" ") if word]
        motion.target = words.pop(0)
        if motion.mode in {ANGLE_MODE, 4} and words:
            motion.velocity_limit = words.pop(0)
        if motion.mode not in {TORQUE_MODE, ANGLE_NOCASCADE_MODE} and words:
            setattr(motion, "voltage_limit" if self.torque_type == _VOLTAGE else "current_limit", words[0])
        out.friendly("Target: ")
        out.line(motion.target)

    def _motion(self, head: str, sub: str, text: str) -> None:
        """Set or print the motion type (C), the torque type (T), or whether the motor is enabled (E)."""
        motor, out = self.motor, self.printer
        asked = out.ends(text[2 if sub == "D" and self.modern else 1])
        value = number(text[2:] if "A" <= sub <= "Z" else text[1:])
        if head == "E":
            out.friendly("Status: ")
            if not asked:
                motor.enable() if value else motor.disable()
            out.line(int(motor.enabled))
            return
        out.friendly("Motion:" if head == "C" else "Torque: ")
        if sub == "T" and self.modern:
            out.friendly(" time: ")
            out.line(100)  # us, of the loop
        elif head == "C" and sub == "D":
            out.friendly(" downsample: ")
            self._motion_downsample = self._motion_downsample if asked else whole(value)
            out.line(self._motion_downsample)
        elif head == "C":
            if not asked and 0 <= value < (len(_MOTION) if self.modern else 5):
                self._change_motion(whole(value))
            out.line(_MOTION[self.motion.mode])
        else:
            if not asked and 0 <= whole(value) < (len(_TORQUE) if self.modern else 3):
                self.torque_type = whole(value)
            out.line(_TORQUE[self.torque_type])

    def _change_motion(self, mode: int) -> None:
        """Change the motion type. Since library 2.4 this sets the target to zero."""
        motion = self.motion
        turning, angular = {VELOCITY_MODE, 3}, {ANGLE_MODE, 4, ANGLE_NOCASCADE_MODE}
        same = mode == motion.mode or {mode, motion.mode} <= turning or {mode, motion.mode} <= angular
        if self.modern and not same:
            motion.target = motion.angle(self.motor) if mode in angular else 0.0
        motion.mode = mode

    def _limit(self, sub: str, value: float | None) -> None:
        out, motion = self.printer, self.motion
        out.friendly("Limits| ")
        if sub not in _LIMITS:
            out.error()
            return
        said, name = _LIMITS[sub]
        out.friendly(said)
        if value is not None:
            setattr(motion, name, value)
        out.line(float(getattr(motion, name)))

    def _gain(self, head: str, sub: str, rest: str) -> None:
        self.printer.friendly(_PIDS[head])
        asked = self.printer.ends(rest[:1] or "\n")
        self._kept_number(_TERMS.get(sub), head + sub, None if asked else number(rest))

    def _rating(self, head: str, sub: str, value: float | None) -> None:
        out = self.printer
        out.friendly(_PLAIN[head])
        axis = sub if head == "I" and self.modern and sub in {"D", "Q"} else ""
        if axis:
            out.friendly(f"{axis.lower()}: ")
        if value is not None:
            both = ("ID", "IQ", "I") if head == "I" and not axis else (head + axis,)
            self._plain |= dict.fromkeys(both, value)
        out.line(self._plain.get(head + axis, 0))

    def _modulation(self, sub: str, value: float | None) -> None:
        out = self.printer
        out.friendly("PWM Mod | ")
        if sub == "T":
            out.friendly("type: ")
            out.line("SinePWM")
        elif sub == "C":
            out.friendly("center: ")
            self._centered = self._centered if value is None else int(bool(value))
            out.line(self._centered)
        else:
            out.error()

    def _measurement(self, sub: str) -> None:
        out = self.printer
        out.friendly("MOT | ")
        if sub == "R":
            out.friendly("Reinit!")
            self.motion.target = 0.0
            out.line("done")
        elif sub in {"P", "C"}:
            out.friendly("Meas motor params!" if sub == "P" else "PI tune curr.| ")
            out.friendly("failed, err code: ")
            out.line(1)
        else:
            out.error()

    def _monitor(self, sub: str, value: float | None, rest: str) -> None:
        out = self.printer
        if sub == "G":
            self._show(whole(value or 0.0))
        elif sub == "C":
            self.watched = "0" * _SHOWN
            out.line("clear")
        elif sub == "S":
            if value is not None:
                self.watched = self._bits(rest)
            out.line(self.watched)
        elif sub == "D":
            out.friendly("downsample: ")
            self.downsample = self.downsample if value is None else whole(value)
            out.line(self.downsample)
        elif sub == "#":
            out.friendly("decimal: ")
            self._monitor_decimals = _decimals(value or 0.0)
            out.line(self._monitor_decimals)
        else:
            out.error()

    def _bits(self, rest: str) -> str:
        bits = ""
        for character in rest[:_SHOWN]:
            if self.printer.ends(character):
                break
            bits += str(ord(character) - ord("0") & 1)
        return bits.ljust(_SHOWN, "0")

    def _show(self, which: int) -> None:
        values, out = self._state(), self.printer
        if which == _SHOWN:
            out.friendly("all: ")
            for value in values[:-1]:
                out.say(value)
                out.say(";")
            out.line(values[-1])
        elif 0 <= which < _SHOWN:
            out.friendly(f"{_WATCHED[which]}: ")
            out.line(values[which])
        else:
            out.error()

    def _state(self) -> tuple[float, float, float, float, float, float, float]:
        """Return target, Vq, Vd (V), Iq, Id (A), velocity (rad/s) and angle (rad)."""
        motor, motion = self.motor, self.motion
        return (
            motion.target,
            motion.voltage(motor),
            0.0,
            motion.current(motor),
            0.0,
            motor.velocity,
            motion.angle(motor),
        )

    def _kept_number(self, said: str | None, name: str, value: float | None) -> None:
        """Store the number `value` as `name` and print it; it has no effect on the motor. With `value` None, only print
        the stored number.

        said: text to print before it in the user-friendly mode; None: the command is unknown, and an error is printed
        instead.
        """
        if said is None:
            self.printer.error()
            return
        self.printer.friendly(said)
        if value is not None:
            self._kept[name] = value
        self.printer.line(self._kept.get(name, 0.0))
