"""Requests and replies of a Commander: lines that are waited for, and what else is on the line passed over."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from drivers.servo import BadReply, NoReply, link_lost
from drivers.uart.lines import TextLines
from drivers.uart.port import GONE, Port

if TYPE_CHECKING:
    from drivers.clock import Clock

LONGEST = 20
"""Characters of a command, its end included, that the library's buffer takes."""
_REPLY = 100  # bytes that are allowed for on the wire
_SILENT_FOR = 5e-3  # s without a byte after which the line counts as silent
_PATIENCE = 0.1  # s that it may take to fall silent
_AT_ONCE = 4096
_SHOWN = 40  # characters of a foreign line in a message

T = TypeVar("T")


class CommanderLink:
    """One board on one port. timeout: s that a reply may take beyond its time on the wire."""

    def __init__(self, port: Port, name: str, baudrate: int, clock: Clock, timeout: float) -> None:
        self.name = name
        self._port = port
        self._baudrate = baudrate
        self._clock = clock
        self._timeout = timeout
        self._lines = TextLines()
        self._quarantined = True

    def send(self, *commands: str) -> None:
        """Write `commands` in one piece, each on a line, without waiting; what was being typed before them is ended."""
        self._put("\n" + "".join(f"{command}\n" for command in commands))

    def ask(self, command: str, head: str) -> str:
        """Send one command; what follows `head` in the reply that begins with it. Raises NoReply, BadReply, LinkLost.

        A board prints its replies in order, so that on a line that had fallen silent the first that fits is it.
        """
        return self.exchange([command], lambda line: line[len(head) :] if line.startswith(head) else None, command)

    def exchange(self, commands: list[str], wanted: Callable[[str], T | None], what: str) -> T:
        """Send `commands`, and wait for the line of which `wanted` makes something; any other is passed over.

        Raises NoReply where nothing came, BadReply where only other lines came, LinkLost.
        """
        self._settle()
        self._quarantined = True  # until the reply has come, whatever interrupts the wait
        self._begin()
        text = "".join(f"{command}\n" for command in commands)
        self._put(text)
        line_time = 10.0 * (len(text) + _REPLY) / self._baudrate
        deadline = self._clock.now() + line_time + self._timeout
        foreign = ""
        while True:
            for line in self._take():
                found = wanted(line)
                if found is not None:
                    self._quarantined = False
                    return found
                foreign = line
            if self._clock.now() >= deadline:
                break
        if foreign:
            raise BadReply(f"the reply to {what} is not among what came ({shown(foreign)}): the sample is dropped")
        raise NoReply(f"no reply to {what} within {self._timeout * 1e3:.3g} ms beyond the wire's time")

    def listen(self, seconds: float, last: str = "") -> list[str]:
        """The lines that come within `seconds`, or until `last` has come."""
        end = self._clock.now() + seconds
        heard: list[str] = []
        while self._clock.now() < end and last not in heard:
            heard += self._take()
        return heard

    def quarantine(self) -> None:
        """Let the line fall silent before the next request."""
        self._quarantined = True

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()

    def _settle(self) -> None:
        """Let late replies arrive. Raises BadReply where the line does not fall silent."""
        if not self._quarantined:
            return
        end = self._clock.now() + _PATIENCE
        quiet_since = self._clock.now()
        while self._clock.now() - quiet_since < _SILENT_FOR:
            if self._hear():
                quiet_since = self._clock.now()
            if self._clock.now() >= end:
                raise BadReply(
                    "the line never falls silent: the board's program prints by itself; take motor.monitor() out of it"
                )

    def _begin(self) -> None:
        self._lines.clear()
        try:
            if self._port.in_waiting:
                self._port.reset_input_buffer()
        except GONE as error:
            raise link_lost(self.name, error) from None

    def _take(self) -> list[str]:
        return self._lines.feed(self._hear())

    def _hear(self) -> bytes:
        """What has come; waits a moment where nothing has."""
        try:
            return self._port.read(min(max(1, self._port.in_waiting), _AT_ONCE))
        except GONE as error:
            raise link_lost(self.name, error) from None

    def _put(self, text: str) -> None:
        data = text.encode("ascii")
        try:
            written = self._port.write(data)
        except GONE as error:
            raise link_lost(self.name, error) from None
        if written != len(data):
            raise link_lost(self.name, "it took only a part of a request")


def shown(line: str) -> str:
    """A foreign line for a message."""
    return repr(line if len(line) <= _SHOWN else line[:_SHOWN] + "...")
