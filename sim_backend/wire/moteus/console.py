"""The diagnostic console of a moteus: lines in, lines out, and the configuration behind them.

Source: mjbots/moteus docs/protocol/diagnostic.md and docs/reference/configuration.md; defaults are those of the
reference where it names them. Of the commands there are conf get, set, enumerate, load, default and write, d stop, and
tel stop; others are answered with an error, as unknown ones are.
"""

from __future__ import annotations

import math

_DEFAULTS: dict[str, float] = {
    "can.prefix": 0,
    "servopos.position_min": math.nan,
    "servopos.position_max": math.nan,
    "servo.pid_position.kp": 4.0,
    "servo.pid_position.ki": 1.0,
    "servo.pid_position.kd": 0.05,
    "servo.pid_position.ilimit": 0.0,
    "servo.default_velocity_limit": math.nan,
    "servo.default_accel_limit": math.nan,
    "servo.max_voltage": 46.0,
    "servo.max_power_W": 450.0,
    "servo.temperature_margin": 20.0,
    "servo.fault_temperature": 75.0,
    "servo.enable_motor_temperature": 0,
    "servo.motor_temperature_margin": 20.0,
    "servo.motor_fault_temperature": math.nan,
    "servo.fault_position_error": math.nan,
    "servo.fault_velocity_error": math.nan,
    "servo.max_current_A": 100.0,
    "servo.max_velocity": 500.0,
    "servo.max_velocity_derate": 2.0,
    "servo.default_timeout_s": 0.1,
    "servo.timeout_max_torque_Nm": 5.0,
    "servo.timeout_mode": 12,
}
_WHOLE = {"id.id", "can.prefix", "servo.timeout_mode", "servo.enable_motor_temperature"}


class Console:
    """The console and configuration of the controller `ident`. values: by the vendor's names."""

    def __init__(self, ident: int) -> None:
        self._stored = {"id.id": float(ident), **_DEFAULTS}
        self.values = dict(self._stored)
        self.refused: set[str] = set()
        """Names whose setting is acknowledged and not done."""
        self._in = b""
        self._out = b""
        self._stop = False

    def load(self) -> None:
        """Back to what is stored, as at power-up."""
        self.values = dict(self._stored)
        self._in = self._out = b""

    def take(self, text: bytes) -> None:
        """Text from the host; every whole line is answered."""
        self._in += text
        *lines, self._in = self._in.replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            if line.strip():
                self._out += self._answer(line.decode("ascii", "replace").split())

    def give(self, most: int) -> bytes:
        """Up to `most` bytes of what there is to say."""
        out, self._out = self._out[:most], self._out[most:]
        return out

    def stop_asked(self) -> bool:
        """Whether `d stop` came since this was last asked."""
        asked, self._stop = self._stop, False
        return asked

    def _answer(self, words: list[str]) -> bytes:
        match words:
            case ["conf", "get", name] if name in self.values:
                return f"{self._text(name)}\r\n".encode()
            case ["conf", "set", name, text] if name in self.values:
                return self._set(name, text)
            case ["conf", "enumerate"]:
                lines = "".join(f"{name} {self._text(name)}\r\n" for name in sorted(self.values))
                return f"{lines}OK\r\n".encode()
            case ["conf", "write"]:
                self._stored = dict(self.values)
            case ["conf", "load"]:
                self.values = dict(self._stored)
            case ["conf", "default"]:
                self.values |= _DEFAULTS
            case ["d", "stop"]:
                self._stop = True
            case ["tel", "stop"]:
                pass
            case ["conf", "get" | "set", *_]:
                return b"ERR error reading\r\n"
            case _:
                return b"ERR unknown command\r\n"
        return b"OK\r\n"

    def _set(self, name: str, text: str) -> bytes:
        try:
            value = float(text)
        except ValueError:
            return b"ERR error setting\r\n"
        if name not in self.refused:
            self.values[name] = value
        return b"OK\r\n"

    def _text(self, name: str) -> str:
        value = self.values[name]
        return f"{int(value)}" if name in _WHOLE else f"{value:.6f}"
