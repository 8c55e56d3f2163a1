"""One moteus on the bus: its registers, and its configuration through the diagnostic console."""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import TYPE_CHECKING

from drivers.canbus.link import frame
from drivers.canbus.requests import Requests
from drivers.moteus.frames import INT32, answers, console_text, filled, hear, is_console, read, say
from drivers.servo import BadReply, DriverError, NoReply

if TYPE_CHECKING:
    import can

    from drivers.canbus.link import CanLink
    from drivers.clock import Clock
    from drivers.moteus.config import MoteusConfig

_REPLY_WANTED = 0x80
_TRIES = 3
_POLLS = 40
"""Times the console is asked for the rest of a line."""
_SECOND_ANSWER = 0.004
"""s in which a second controller with the same id would have answered."""
_WRITE_PIECE = 61


class Controller:
    """The conversation with one controller. Every method raises what `Requests.ask` does."""

    def __init__(self, config: MoteusConfig, link: CanLink, clock: Clock) -> None:
        self._config = config
        self._link = link
        self._requests = Requests(
            link,
            clock,
            name=f"moteus {config.id}",
            timeout=config.reply_timeout,
            classify=self._kind,
            overhear=lambda _kind, _data: None,
            only_asked=frozenset({"registers"}),
        )
        self._found: dict[str, float] = {}

    def exchange(self, *subframes: bytes) -> dict[str, float]:
        """Send subframes and return the registers in the answer. Raises DriverError for one that is refused."""
        return answers(self._requests.ask([self._frame(*subframes)], ["registers"])["registers"])

    def send(self, *subframes: bytes) -> None:
        """Send subframes at once, without an answer."""
        self._requests.tell([self._frame(*subframes, asking=False)])

    def identify(self) -> dict[str, float]:
        """Model, firmware, register map and serial number.

        Raises NoReply where nobody answers, BadReply where several do.
        """
        ask = (read("model", INT32, 3), read("serial_low", INT32, 3))
        for attempt in range(_TRIES):
            try:
                found = self.exchange(*ask)
                break
            except (NoReply, BadReply) as error:
                if attempt == _TRIES - 1:
                    raise self._nobody(error) from None
        if self._requests.await_change(_SECOND_ANSWER, lambda: bool(self._requests.unasked)):
            raise BadReply(self._garbled("it answers twice"))
        return found

    def get(self, name: str) -> float:
        """A number of the configuration. Raises DriverError where the controller does not know it."""
        text = self._console(f"conf get {name}")
        try:
            return float(text)
        except ValueError:
            raise DriverError(
                f"the moteus answers {text!r} when asked for {name}: bring its firmware up to date"
            ) from None

    def require(self, name: str, value: float) -> None:
        """Make a number of the configuration hold `value`, and read it back; what was found is kept for `restore`.
        It is not stored, so that the controller forgets it without power.

        Raises DriverError where the controller keeps another value.
        """
        found = self.get(name)
        if _same(found, value):
            return
        self._found.setdefault(name, found)
        self._set(name, value)
        kept = self.get(name)
        if not _same(kept, value):
            raise DriverError(
                f"the moteus keeps {kept:g} in {name} where {value:g} was written: it is not safe to go on"
            )

    def restore(self) -> None:
        """Put the configuration back as it was found, as far as the controller lets us."""
        while self._found:
            name, value = self._found.popitem()
            try:
                self._set(name, value)
            except DriverError:
                continue  # one that cannot be put back must not keep the others from it

    def _set(self, name: str, value: float) -> None:
        text = f"{value:.0f}" if value == int(value if math.isfinite(value) else 0) else f"{value:.9g}"
        answer = self._console(f"conf set {name} {text}")
        if answer != "OK":
            raise DriverError(f"the moteus answers {answer!r} when told {name} = {text}: it is not safe to go on")

    def _console(self, line: str) -> str:
        """Say a line and return the first line of the answer. A reply that is lost may take a part of it along, so the
        whole is said again.
        """
        for attempt in range(_TRIES):
            try:
                self._hear_out()
                self._requests.tell([self._frame(say(line.encode("ascii") + b"\n"), asking=False)])
                return self._first_line()
            except (NoReply, BadReply):
                if attempt == _TRIES - 1:
                    raise
        raise NoReply(f"the console says nothing to {line!r}")

    def _hear_out(self) -> None:
        """Take what the console still had to say."""
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
        return console_text(self._requests.ask([self._frame(hear())], ["console"])["console"])

    def _frame(self, *subframes: bytes, asking: bool = True) -> can.Message:
        ident = (self._config.source | (_REPLY_WANTED if asking else 0)) << 8 | self._config.id
        return frame(ident, filled(subframes), extended=ident > 0x7FF, fd=True)

    def _kind(self, message: can.Message) -> Hashable | None:
        expected = self._config.id << 8 | self._config.source
        if message.is_remote_frame or message.arbitration_id & 0xFFFF != expected:
            return None
        return "console" if is_console(bytes(message.data)) else "registers"

    def _nobody(self, error: DriverError) -> DriverError:
        if isinstance(error, BadReply) or self._link.error_frames:
            return BadReply(self._garbled(str(error)))
        return NoReply(
            f"no moteus {self._config.id} answers on {self._link.name} at {self._config.bitrate} and "
            f"{self._config.data_bitrate} bit/s: check its power, the wiring and its termination, the id, and that the "
            "adapter carries CAN FD with bit rate switching"
        )

    def _garbled(self, reason: str) -> str:
        return (
            f"what answers as moteus {self._config.id} cannot be understood ({reason}): two controllers with that id, "
            "or a bit rate that is off; connect one controller alone and give each its own id"
        )


def _same(a: float, b: float) -> bool:
    return a == b or (math.isnan(a) and math.isnan(b)) or math.isclose(a, b, rel_tol=1e-5, abs_tol=1e-6)
