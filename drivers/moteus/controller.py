"""One moteus controller on the bus: its registers, and its configuration through the diagnostic console."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Hashable
from functools import partial
from typing import TYPE_CHECKING

from drivers.canbus.link import frame
from drivers.canbus.neighbours import ask_each
from drivers.canbus.requests import Requests, garbled
from drivers.moteus.frames import (
    FAULT,
    INT8,
    INT32,
    STOPPED,
    Registers,
    answers,
    console_read,
    console_text,
    console_write,
    filled,
    is_console,
    read,
)
from drivers.neighbours import Neighbour
from drivers.retry import retry
from drivers.servo import BadReply, DriverError, NoReply
from drivers.settings import Settings

if TYPE_CHECKING:
    import can

    from drivers.canbus.link import CanLink
    from drivers.clock import Clock
    from drivers.moteus.config import MoteusConfig

_REPLY_WANTED = 0x80
_HIGHEST = 126
_POLLS = 40
"""How many times the console is asked for the rest of a line."""


class Controller:
    """One moteus controller. Every method raises NoReply, BadReply, LinkLost.

    settings: numbers of the controller's configuration. They are not stored, so the controller loses changes without
    power.
    """

    def __init__(self, config: MoteusConfig, link: CanLink, clock: Clock) -> None:
        self._config = config
        self._link, self._clock = link, clock
        self.requests = Requests(
            link,
            clock,
            name=f"moteus {config.id}",
            timeout=config.reply_timeout,
            classify=self._kind,
            only_on_request=frozenset({"registers"}),
        )
        self.settings: Settings[str, float] = Settings(self.get, self._set, same=_same)

    def exchange(self, *subframes: bytes) -> Registers:
        """Send subframes and return the registers of the reply. Raises DriverError if the controller refuses a
        register.
        """
        return answers(self.requests.ask([self._frame(*subframes)], ["registers"])["registers"])

    def send(self, *subframes: bytes) -> None:
        """Send subframes without waiting for a reply."""
        self.requests.send([self.unanswered(*subframes)])

    def unanswered(self, *subframes: bytes) -> can.Message:
        """Return the frame that sends `subframes` and requests no reply."""
        return self._frame(*subframes, asking=False)

    def restoring(self) -> list[can.Message]:
        """Return the frames that restore the changed settings."""
        return [self._line(_setting(name, value)) for name, value in self.settings.changed()]

    def identify(self) -> Registers:
        """Read model, firmware, register map and serial number.

        Raises NoReply if no controller replies, BadReply if several controllers reply.
        """
        ask = (read("model", INT32, 3), read("serial_low", INT32, 3))
        try:
            registers = retry(partial(self.exchange, *ask))
        except (NoReply, BadReply) as error:
            raise self._no_reply(error) from None
        self.requests.check_alone("registers")
        return registers

    def neighbours(self) -> list[Neighbour]:
        """Return the other controllers whose mode is neither stopped nor fault. Only reads are sent. Raises LinkLost,
        and NoReply if the bus accepts no frame.
        """
        modes: dict[int, int] = {}

        def take(message: can.Message) -> None:
            ident = message.arbitration_id >> 8
            if message.arbitration_id & 0xFF == self._config.source and 1 <= ident <= _HIGHEST:
                with contextlib.suppress(DriverError):
                    modes[ident] = int(answers(bytes(message.data)).get("mode", STOPPED))

        others = (ident for ident in range(1, _HIGHEST + 1) if ident not in {self._config.id, self._config.source})
        asked = (self._frame(read("mode", INT8), to=ident) for ident in others)
        ask_each(self._link, self._clock, self._config.bitrate, asked, take)
        return [
            Neighbour(
                ident,
                "a moteus",
                f"its mode is {mode}, and 0 is stopped",
                f"stop it, with the CAN FD frame {self._config.source << 8 | ident:03X}#010000 (`d stop` in tview)",
            )
            for ident, mode in sorted(modes.items())
            if mode not in {STOPPED, FAULT}
        ]

    def get(self, name: str) -> float:
        """Return the number `name` of the configuration. Raises DriverError if the controller has no such number."""
        text = self._console(f"conf get {name}")
        try:
            return float(text)
        except ValueError:
            raise DriverError(f"the moteus replies {text!r} to a request for {name}: update its firmware") from None

    def _set(self, name: str, value: float) -> None:
        line = _setting(name, value)
        answer = self._console(line)
        if answer != "OK":
            raise DriverError(f"the moteus replies {answer!r} to {line}: the setting was refused")

    def _console(self, line: str) -> str:
        """Send a line to the console and return the first line of its reply.

        A lost reply may have contained a part of that first line, so the whole command is sent again.
        """

        def converse() -> str:
            self._drain()
            self.requests.send([self._line(line)])
            return self._first_line()

        return retry(converse)

    def _line(self, line: str) -> can.Message:
        return self.unanswered(console_write(line.encode("ascii") + b"\n"))

    def _drain(self) -> None:
        """Discard the text that the console still holds from earlier commands."""
        for _ in range(_POLLS):
            if not self._poll():
                return
        raise BadReply("the console never falls silent: switch its telemetry off with `tel stop`")

    def _first_line(self) -> str:
        text = b""
        for _ in range(_POLLS):
            text += self._poll()
            if b"\n" in text:
                return text.splitlines()[0].decode("ascii", "replace").strip()
        raise NoReply("the console does not finish its line")

    def _poll(self) -> bytes:
        return console_text(self.requests.ask_once([self._frame(console_read())], ["console"])["console"])

    def _frame(self, *subframes: bytes, asking: bool = True, to: int | None = None) -> can.Message:
        ident = (self._config.source | (_REPLY_WANTED if asking else 0)) << 8 | (self._config.id if to is None else to)
        return frame(ident, filled(subframes), extended=ident > 0x7FF, fd=True)

    def _kind(self, message: can.Message) -> Hashable | None:
        expected = self._config.id << 8 | self._config.source
        if message.is_remote_frame or message.arbitration_id & 0xFFFF != expected:
            return None
        return "console" if is_console(bytes(message.data)) else "registers"

    def _no_reply(self, error: DriverError) -> DriverError:
        if isinstance(error, BadReply) or self._link.error_frames:
            return garbled(self.requests.name, str(error))
        return NoReply(
            f"no moteus {self._config.id} answers on {self._link.name} at {self._config.bitrate} and "
            f"{self._config.data_bitrate} bit/s: check its power, the wiring and its termination, the id, and that the "
            "adapter carries CAN FD with bit rate switching"
        )


def _setting(name: str, value: float) -> str:
    """Return the console command that sets the number `name` of the configuration to `value`."""
    text = f"{value:.0f}" if value == int(value if math.isfinite(value) else 0) else f"{value:.9g}"
    return f"conf set {name} {text}"


def _same(a: float, b: float) -> bool:
    return a == b or (math.isnan(a) and math.isnan(b)) or math.isclose(a, b, rel_tol=1e-5, abs_tol=1e-6)
