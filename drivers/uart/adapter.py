"""What a serial adapter does to replies: a USB adapter holds them back, and a half-duplex adapter may also return the
bytes that were sent. No I/O.
"""

from __future__ import annotations

from pathlib import Path

from drivers.servo import NoReply

HELD = 0.02
"""s by which replies may be late before the adapter is known: FTDI's latency timer is 16 ms as delivered."""


class Lateness:
    """How late the replies on one line are, in s beyond their time on the wire.

    port: the line's name. timeout: s by which a reply may be late. shortest: s of silence after which a line without a
    slow adapter has no more bytes. Until a reply was in time, `wait` is longer than `timeout`: so a reply that the
    adapter holds back is recognised as such, and is not taken for the reply to a later request.
    """

    def __init__(self, port: str, timeout: float, shortest: float) -> None:
        self._port, self._timeout, self._shortest = port, timeout, shortest
        self._late = 0.0
        self._known = False
        self.silence = HELD
        """s without a byte after which no late reply can arrive."""

    @property
    def wait(self) -> float:
        """The s to wait for a reply beyond its time on the wire."""
        return self._timeout if self._known else self._timeout + HELD

    @property
    def remedy(self) -> str:
        """What to do if every reply so far was too late, "" if this is not so."""
        if self._known or not self._late:
            return ""
        return (
            f"the replies on {self._port} come {1e3 * self._late:.3g} ms late, and reply_timeout is "
            f"{1e3 * self._timeout:.3g} ms: the USB adapter holds them back (FTDI: 16 ms as delivered), or this "
            "computer is busy; echo 1 | sudo tee /sys/bus/usb-serial/devices/"
            f"{Path(self._port).resolve().name}/latency_timer, or raise reply_timeout and lower the tick rate"
        )

    def note(self, late: float) -> None:
        """Note a reply that was `late`. Raises NoReply with the remedy if no reply was in time so far."""
        if self._known:
            return
        self._late = late
        if late > self._timeout:
            raise NoReply(self.remedy)
        self._known, self.silence = True, self._shortest + max(0.0, late)


class Echo:
    """Removes the sent bytes from the received ones, on a line that returns them.

    The first request shows whether the line does: its reply differs from it. Later a reply may equal its request (a
    ping of protocol 1.0 and its reply with error 1).
    """

    def __init__(self) -> None:
        self._returns: bool | None = None
        self._sent, self._held = b"", b""

    @property
    def due(self) -> int:
        """The number of sent bytes that are still to return."""
        return max(0, len(self._sent) - len(self._held)) if self._returns else 0

    def sent(self, data: bytes) -> None:
        """Expect the return of `data`, after which the reply begins. b"": take every byte for a part of a reply."""
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
