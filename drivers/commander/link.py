"""Send commands to a SimpleFOC board with Commander, and find the replies among the received lines."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from drivers.clock import no_later
from drivers.off_path import OffPath, descriptor_of, serial_interval
from drivers.retry import Repeats
from drivers.servo import BadReply, NoReply, link_lost
from drivers.uart.adapter import Lateness
from drivers.uart.lines import TextLines
from drivers.uart.port import GONE, OpenPort

if TYPE_CHECKING:
    from drivers.clock import Clock

LONGEST = 20
"""Most characters of a command, with its line end, that fit the library's buffer."""
_REPLY = 100  # bytes of the longest reply, for its time on the wire
_SILENT_FOR = 5e-3  # s without a byte after which the line counts as silent, if the adapter holds no bytes back
_PATIENCE = 0.1  # s until the line must be silent
_AT_ONCE = 4096
_SHOWN = 40  # characters of an unexpected line in a message

T = TypeVar("T")


class CommanderLink:
    """A board on a serial port. timeout: s to wait for a reply, in addition to its time on the wire."""

    def __init__(self, port: OpenPort, name: str, baudrate: int, clock: Clock, timeout: float) -> None:
        self.name = name
        self._port = port
        self._baudrate = baudrate
        self._clock = clock
        self._late = Lateness(name, timeout, _SILENT_FOR)
        self._lines = TextLines()
        self._quarantined = True
        self._own: list[str] = []
        self.echoes = False
        """Whether the board returns each command before its reply."""
        self.repeats = Repeats()

    def send(self, *commands: str) -> None:
        """Write each command as a line, without waiting. A line end is sent first, to end a command that was cut
        off.
        """
        if self.echoes:
            self._own += commands
            self._quarantined = True  # the next reply must not be taken for what is returned of these
        self._put("\n" + "".join(f"{command}\n" for command in commands))

    def ask(self, command: str, head: str) -> str:
        """Send a command and return its reply without the leading `head`. Raises NoReply, BadReply, LinkLost.

        A board prints its replies in order. If the line was silent before, the first line that begins with `head` is
        the reply.
        """
        return self.exchange([command], lambda line: line[len(head) :] if line.startswith(head) else None, command)

    def exchange(self, commands: list[str], wanted: Callable[[str], T | None], what: str) -> T:
        """Send `commands` and apply `wanted` to each received line. Return the first result that is not None.

        what: name of the wanted reply in messages. Raises NoReply if nothing arrived, BadReply if only other lines
        arrived, LinkLost.
        """
        return self.repeats(lambda: self._exchange_once(commands, wanted, what))

    def _exchange_once(self, commands: list[str], wanted: Callable[[str], T | None], what: str) -> T:
        self._settle()
        self._quarantined = True  # until the reply arrives, whatever interrupts the wait
        self._begin()
        self._own = list(commands)
        text = "".join(f"{command}\n" for command in commands)
        self._put(text)
        due = self._clock.now() + 10.0 * (len(text) + _REPLY) / self._baudrate
        deadline = no_later(due + self._late.wait)
        other = ""
        while True:
            for line in self._take():
                result = wanted(line)
                if result is not None:
                    self._quarantined = False
                    self._late.note(self._clock.now() - due)
                    return result
                other = line
            if self._clock.now() >= deadline:
                break
        if other:
            raise BadReply(f"only other lines than the reply to {what} arrived ({shown(other)}): the sample is dropped")
        raise NoReply(f"no reply to {what} within {self._late.wait * 1e3:.3g} ms beyond the wire's time")

    def listen(self, seconds: float, last: str = "") -> list[str]:
        """Return the lines that arrive within `seconds`; end earlier when the line `last` arrives."""
        end = self._clock.now() + seconds
        lines: list[str] = []
        while self._clock.now() < end and last not in lines:
            lines += self._take()
        return lines

    def off_path(self, commands: list[str]) -> OffPath:
        """Return the data with which another process can send `commands` on this port. A line end is sent first, to end
        a command that was cut off.
        """
        off = tuple(f"{command}\n".encode("ascii") for command in commands)
        return OffPath(
            off=off,
            resync=b"\n",
            descriptor=descriptor_of(self._port),
            interval=serial_interval(off, self._baudrate),
            name=self.name,
        )

    def quarantine(self) -> None:
        """Make the next request wait until the line is silent."""
        self._quarantined = True

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _settle(self) -> None:
        """Wait for late replies. Raises BadReply if the line does not fall silent."""
        if not self._quarantined:
            return
        end = no_later(self._clock.now() + _PATIENCE)
        quiet_since = self._clock.now()
        while self._clock.now() - quiet_since < self._late.silence:
            if self._receive():
                quiet_since = self._clock.now()
            if self._clock.now() >= end:
                raise BadReply(
                    "the line never falls silent: the board's program prints by itself; remove motor.monitor() from it"
                )

    def _begin(self) -> None:
        self._lines.clear()
        try:
            if self._port.in_waiting:
                self._port.reset_input_buffer()
        except GONE as error:
            raise link_lost(self.name, error) from None

    def _take(self) -> list[str]:
        return [line for line in self._lines.feed(self._receive()) if not (self.echoes and self._is_own(line))]

    def _is_own(self, line: str) -> bool:
        """Return whether `line` is a command that the board has returned (an echo). Each sent command is
        returned once.
        """
        own = line in self._own
        if own:
            del self._own[: self._own.index(line) + 1]
        return own

    def _receive(self) -> bytes:
        """Return the bytes that have arrived. If there are none, wait for a moment first."""
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
            raise link_lost(self.name, "it accepted only a part of a request")


def shown(line: str) -> str:
    """Return an unexpected line in the form in which a message quotes it."""
    return repr(line if len(line) <= _SHOWN else line[:_SHOWN] + "...")
