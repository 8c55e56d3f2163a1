"""The diagnostic console of an emulated moteus: it receives and prints lines, and holds the configuration.

Source: mjbots/moteus docs/protocol/diagnostic.md and docs/reference/configuration.md. These commands exist: conf get,
set, enumerate, load, default and write; d stop, nearest, rezero, exact and cfg-set-output; tel list, schema, fmt, get
and stop, in the binary format. Any other command gets an error, as an unknown command does on a real moteus.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from drivers.tables import table
from sim_backend.wire.moteus.telemetry import Field, announced, data, schema

_DEFAULTS: dict[str, float] = table("moteus", "sim_backend.wire")["configuration"]
_WHOLE = {"id.id", "can.prefix", "servo.timeout_mode", "servo.enable_motor_temperature"}


class Console:
    """The console and configuration of the controller `ident`. values: the settings by the vendor's names.

    channels: for each telemetry channel, a function that returns its fields.
    """

    def __init__(self, ident: int, channels: Mapping[str, Callable[[], Sequence[Field]]]) -> None:
        self._channels = channels
        self._stored = {"id.id": float(ident), **_DEFAULTS}
        self.values = dict(self._stored)
        self.refused: set[str] = set()
        """Settings whose writes are acknowledged but not carried out: a fault for tests."""
        self._in = b""
        self._out = b""
        self._requests: list[tuple[str, float]] = []

    def load(self) -> None:
        """Set the configuration to the stored values, as at power-up."""
        self.values = dict(self._stored)
        self._in = self._out = b""

    def take(self, text: bytes) -> None:
        """Receive text from the host. Every complete line is executed and answered."""
        self._in += text
        *lines, self._in = self._in.replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            if line.strip():
                self._out += self._answer(line.decode("ascii", "replace").split())

    def give(self, most: int) -> bytes:
        """Return up to `most` bytes of the text that waits to be sent."""
        out, self._out = self._out[:most], self._out[most:]
        return out

    def requests(self) -> list[tuple[str, float]]:
        """Return the `d` commands received since the last call, each with its number (0 if it has none)."""
        requests, self._requests = self._requests, []
        return requests

    def _answer(self, words: list[str]) -> bytes:
        match words:
            case ["conf", *rest]:
                return self._configuration(rest)
            case ["tel", *rest]:
                return self._telemetry(rest)
            case ["d", "stop"]:
                self._requests.append(("stop", 0.0))
            case ["d", "nearest" | "rezero" | "exact" | "cfg-set-output" as name, *text]:
                self._requests.append((name, _number(text)))
            case _:
                return b"ERR unknown command\r\n"
        return b"OK\r\n"

    def _configuration(self, words: list[str]) -> bytes:
        match words:
            case ["get", name] if name in self.values:
                return f"{self._text(name)}\r\n".encode()
            case ["set", name, text] if name in self.values:
                return self._set(name, text)
            case ["enumerate"]:
                lines = "".join(f"{name} {self._text(name)}\r\n" for name in sorted(self.values))
                return f"{lines}OK\r\n".encode()
            case ["write"]:
                self._stored = dict(self.values)
            case ["load"]:
                self.values = dict(self._stored)
            case ["default"]:
                self.values |= _DEFAULTS
            case ["get" | "set", *_]:
                return b"ERR error reading\r\n"
            case _:
                return b"ERR unknown group\r\n"
        return b"OK\r\n"

    def _telemetry(self, words: list[str]) -> bytes:
        match words:
            case ["schema", name] if name in self._channels:
                return announced("schema", name, schema(self._channels[name]()))
            case ["get", name] if name in self._channels:
                return announced("emit", name, data(self._channels[name]()))
            case ["list"]:
                return "".join(f"{name}\r\n" for name in self._channels).encode() + b"OK\r\n"
            case ["fmt", name, "0"] if name in self._channels:
                return b"OK\r\n"
            case ["stop"]:
                return b"OK\r\n"
            case _:
                return b"ERR unknown name\r\n"

    def _set(self, name: str, text: str) -> bytes:
        try:
            value = float(text)
            if name in _WHOLE:
                value = float(int(value))
        except (ValueError, OverflowError):
            return b"ERR error setting\r\n"
        if name not in self.refused:
            self.values[name] = value
        return b"OK\r\n"

    def _text(self, name: str) -> str:
        value = self.values[name]
        return f"{int(value)}" if name in _WHOLE else f"{value:.6f}"


def _number(text: list[str]) -> float:
    try:
        return float(text[0])
    except (IndexError, ValueError):
        return 0.0
