"""The effects of a serial adapter on replies: a USB adapter delays them, and a half-duplex adapter may also return the
sent bytes. No I/O.
"""

from __future__ import annotations

from pathlib import Path

from drivers.retry import ATTEMPTS
from drivers.servo import DriverError, NoReply

HELD = 0.02
"""s by which replies may be late before the adapter is known: FTDI's latency timer is 16 ms as delivered."""


class Lateness:
    """Measures how late the replies on one line are, in s after the time when they were due.

    name: of the line; its last word is the port. timeout: s by which a reply may be late. shortest: s of silence after
    which a line without a slow adapter has no more bytes. Until one reply was in time, `wait` is longer than `timeout`,
    so that a reply that the adapter delays is recognised, and not taken for the reply to a later request.
    """

    def __init__(self, name: str, timeout: float, shortest: float = 0.0) -> None:
        self._name, self._timeout, self._shortest = name, timeout, shortest
        self._late_ones = 0
        self._known = False
        self.silence = HELD
        """s without a byte after which no late reply can arrive."""

    @property
    def wait(self) -> float:
        """The time, s, to wait for a reply."""
        return self._timeout if self._known else self._timeout + HELD

    def note(self, late: float) -> None:
        """Note that a reply was `late` s late. As long as no reply was in time, a late one raises NoReply, so that the
        request is repeated; the last of `ATTEMPTS` late ones raises DriverError with the remedy.
        """
        if self._known:
            return
        if late <= self._timeout:
            self._known, self.silence = True, self._shortest + max(0.0, late)
            return
        self._late_ones += 1
        words = f"the replies on {self._name} come {1e3 * late:.3g} ms late, and reply_timeout is "
        words += f"{1e3 * self._timeout:.3g} ms: "
        if self._late_ones < ATTEMPTS:
            raise NoReply(f"{words}the sample is dropped")
        port = Path(self._name.split()[-1])
        timer = f"/sys/bus/usb-serial/devices/{port.resolve().name}/latency_timer"
        remedy = f"echo 1 | sudo tee {timer}, or " if port.name != str(port) else ""
        raise DriverError(
            f"{words}the adapter holds them back (FTDI: 16 ms as delivered), or this computer is busy; {remedy}raise "
            "reply_timeout and lower the tick rate"
        )


class Echo:
    """Removes the sent bytes from the received bytes, on a line that returns sent bytes.

    The first request, whose reply differs from it, shows whether the line returns sent bytes. Later a reply may equal
    its request (a ping of protocol 1.0 and its reply with error 1).
    """

    def __init__(self) -> None:
        self._returns: bool | None = None
        self._sent, self._held = b"", b""

    @property
    def returns(self) -> bool:
        """Return whether the line returns sent bytes, as far as is known."""
        return bool(self._returns)

    @property
    def due(self) -> int:
        """The number of sent bytes that the line has not returned yet."""
        return max(0, len(self._sent) - len(self._held)) if self._returns else 0

    def sent(self, data: bytes) -> None:
        """Expect that the line returns `data` before the reply. b"": every byte is a part of a reply."""
        self._sent, self._held = (b"" if self._returns is False else data), b""

    def without(self, data: bytes) -> bytes:
        """Return the received bytes `data` without those that were sent."""
        if not self._sent:
            return data
        self._held += data
        if self._returns is None and not self._sent.startswith(self._held[: len(self._sent)]):
            self._returns, self._sent = False, b""
            return self._held
        _, whole, reply = self._held.partition(self._sent)
        if not whole:
            return b""
        self._returns, self._sent = True, b""
        return reply
