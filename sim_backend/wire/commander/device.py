"""An emulated SimpleFOC board: Commander's parser and printer, character for character, over the emulated motor.

Source: Arduino-FOC, src/communication/Commander.cpp, commands.h, src/BLDCMotor.cpp and base_classes/FOCMotor.cpp of
library 2.3 and 2.4, and docs.simplefoc.com. Gains, filters and modulation are kept and printed and have no effect. No
I/O: characters in, text out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from sim_backend.parameters import SimParameters
from sim_backend.wire.commander.motion import MotionControl
from sim_backend.wire.loadcell.joint_torque import JointTorque
from sim_backend.wire.plant_motor import PlantMotor

BUFFER = 20
"""Characters of a command; a longer one is thrown away at that length, and what follows is read as another."""
NOTHING, ON_REQUEST, FRIENDLY, MACHINE = range(4)

_MOTION = ("torque", "vel", "angle", "vel open", "angle open", "angle nocascade", "custom")
_TORQUE = ("volt", "dc curr", "foc curr", "est. curr")
_PIDS = {"Q": "PID curr q| ", "D": "PID curr d| ", "V": "PID vel| ", "A": "PID angle| "}
_TERMS = {"P": "P: ", "I": "I: ", "D": "D: ", "R": "ramp: ", "L": "limit: ", "F": "Tf: "}
_WATCHED = ("target", "Vq", "Vd", "Cq", "Cd", "vel", "angle")
_LIMITS = {"U": "volt: ", "C": "curr: ", "V": "vel: "}
_PLAIN = {"R": "R phase: ", "I": "L phase: ", "K": "Motor KV: "}
_BOOT = ("Monitor enabled!", "Init", "Enable driver.", "Align sensor.", "sensor dir: CW", "PP check: OK!", "Ready.")


def number(text: str) -> float:
    """Return the number at the beginning of `text` as `atof` does, 0 where there is none; a 32 bit float."""
    found = re.match(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text)
    with np.errstate(over="ignore"):
        return float(np.float32(found[0])) if found else 0.0


class CommanderDevice:
    """The board after its start, with the plant of `parameters` at its motor.

    letter: under which its program added the motor. version: of the library. joint: the torque at the joint's side.
    """

    def __init__(self, parameters: SimParameters, letter: str = "M", version: tuple[int, int] = (2, 4)) -> None:
        parameters = parameters.resolved()
        self.joint = JointTorque()
        self.motor = PlantMotor(parameters, MotionControl(parameters, clamps=version >= (2, 4)), self.joint.note)
        self.letter = letter
        self.restart()

    @property
    def motion(self) -> MotionControl:
        """The settings and loops of the motor."""
        return self.motor.law

    def restart(self) -> None:
        """Set everything as the program does when it begins: the motor is enabled, its target zero."""
        self.verbose = FRIENDLY
        self.decimals = 3
        self.torque_type = 0
        self.watched = "1100011"
        self.downsample = 0
        self._typed = ""
        self._kept = {"VP": 0.2, "VI": 20.0, "AP": 20.0, "QP": 3.0, "QI": 300.0, "DP": 3.0, "DI": 300.0, "VF": 0.005}
        self.motor.disable()
        motion = self.motion
        motion.mode, motion.target = 0, 0.0
        motion.voltage_limit, motion.current_limit, motion.velocity_limit = 12.0, 2.0, 20.0
        self.motor.enable()

    @property
    def greeting(self) -> str:
        """The text that it prints while it starts."""
        return "".join(f"MOT: {line}\r\n" for line in _BOOT)

    def monitored(self) -> str:
        """Return a line of `motor.monitor()`: the variables that are watched, four digits, currents in mA with two."""
        target, vq, vd, iq, id_, velocity, angle = self._state()
        shown = (target, vq, vd, iq * 1e3, id_ * 1e3, velocity, angle)
        digits = (4, 4, 4, 2, 2, 4, 4)
        words = [f"{v:.{d}f}" for v, d, on in zip(shown, digits, self.watched, strict=True) if on == "1"]
        return "\t".join(words) + "\r\n" if words else ""

    def type(self, character: str) -> str:
        """Return the text that it prints after one character."""
        self._typed += character
        if character in "\n\r":
            command, self._typed = self._typed[:-1], ""
            return self._run(command)
        if len(self._typed) >= BUFFER:
            self._typed = ""
        return ""

    def forget(self) -> None:
        """Lose the command that is being typed."""
        self._typed = ""

    def _run(self, command: str) -> str:
        head, rest = command[:1], command[1:]
        if head == "?":
            return self._shown(f"{self._machine('?')}{self.letter}:motor\r\n")
        if head == "@":
            if rest:
                self.verbose = int(number(rest))
            said = {NOTHING: "off!", MACHINE: "machine"}.get(self.verbose, "on!")
            return self._shown(f"{self._friendly('Verb:')}{self._machine('@')}{said}\r\n")
        if head == "#":
            if rest:
                self.decimals = int(number(rest))
            return self._shown(f"{self._friendly('Decimal:')}{self._machine('#')}{self.decimals}\r\n")
        if head != self.letter:
            return ""
        return self._shown(self._machine(head) + "".join(self._ask_motor(rest)) + "\r\n")

    def _ask_motor(self, text: str) -> Iterator[str]:
        """The pieces of the reply to what follows the motor's letter."""
        if not text or text[0].isdigit() or text[0] in "+-":
            yield from self._target(text)
            return
        head, sub = text[0], text[1:2]
        has_sub = "A" <= sub <= "Z" if sub else False
        rest = text[2:] if has_sub or sub == "#" else text[1:]
        yield self._machine(head + (sub if has_sub else ""))
        value = number(rest) if rest else None
        match head:
            case "E" | "C" | "T":
                yield from self._motion(head, sub, text[1:])
            case "L" if sub in _LIMITS:
                yield self._friendly(f"Limits| {_LIMITS[sub]}") + self._limit(sub, value)
            case "M":
                yield self._friendly("Monitor | ")
                yield from self._monitor(sub, rest)
            case "Q" | "D" | "V" | "A" if sub in _TERMS:
                yield self._friendly(_PIDS[head] + _TERMS[sub]) + self._keep(head + sub, value)
            case "S" if sub in {"M", "E"}:
                words = {"M": "offset: ", "E": "el. offset: "}
                yield self._friendly("Sensor | " + words[sub]) + self._keep(head + sub, value)
            case "R" | "I" | "K":
                yield self._friendly(_PLAIN[head]) + self._keep(head, value)
            case "W" if sub in {"T", "C"}:
                yield self._friendly("PWM Mod | " + ("type: " if sub == "T" else "center: "))
                yield "SinePWM" if sub == "T" else str(int(value or 0))
            case _:
                yield self._friendly("unknown cmd ") + "err"

    def _target(self, text: str) -> Iterator[str]:
        motion = self.motion
        if text:
            motion.target = number(text)
            more = [number(word) for word in text.split(" ")[1:] if word]
            if motion.mode == 2 and more:
                motion.velocity_limit = more.pop(0)
            if motion.mode in {1, 2} and more:
                motion.current_limit = more[0]
            yield self._friendly("Target: ")
        elif self.verbose != MACHINE:
            return
        yield self._printed(motion.target)

    def _motion(self, head: str, sub: str, rest: str) -> Iterator[str]:
        motor, value = self.motor, number(rest)
        if head == "E":
            if rest:
                motor.enable() if value else motor.disable()
            yield self._friendly("Status: ") + str(int(motor.enabled))
        elif sub == "D":
            yield self._friendly("Motion: downsample: ") + "0"
        elif head == "C":
            if rest and 0 <= value < 3:  # the open-loop modes turn nothing here
                self.motion.mode = int(value)
            yield self._friendly("Motion:") + _MOTION[self.motion.mode]
        else:
            if rest and 0 <= value < len(_TORQUE):
                self.torque_type = int(value)
            yield self._friendly("Torque: ") + _TORQUE[self.torque_type]

    def _limit(self, sub: str, value: float | None) -> str:
        name = {"U": "voltage_limit", "C": "current_limit", "V": "velocity_limit"}[sub]
        if value is not None:
            setattr(self.motion, name, value)
        return self._printed(getattr(self.motion, name))

    def _monitor(self, sub: str, rest: str) -> Iterator[str]:
        if sub == "G":
            values = self._state()
            which = int(number(rest))
            if which == 7:
                yield self._friendly("all: ") + ";".join(self._printed(value) for value in values)
            elif 0 <= which < 7:
                yield self._friendly(f"{_WATCHED[which]}: ") + self._printed(values[which])
            else:
                yield "err"
        elif sub == "C":
            self.watched = "0000000"
            yield "clear"
        elif sub == "S":
            self.watched = (rest + "0000000")[:7] if rest else self.watched
            yield self.watched
        elif sub == "D":
            self.downsample = int(number(rest)) if rest else self.downsample
            yield self._friendly("downsample: ") + str(self.downsample)
        else:
            yield "err"

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

    def _keep(self, name: str, value: float | None) -> str:
        if value is not None:
            self._kept[name] = value
        return self._printed(self._kept.get(name, 0.0))

    def _printed(self, value: float) -> str:
        return f"{np.float32(value):.{self.decimals}f}"

    def _shown(self, text: str) -> str:
        return "" if self.verbose == NOTHING else text

    def _friendly(self, text: str) -> str:
        return text if self.verbose == FRIENDLY else ""

    def _machine(self, text: str) -> str:
        return text if self.verbose == MACHINE else ""
