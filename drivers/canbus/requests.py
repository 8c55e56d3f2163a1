"""Requests to one drive on a CAN bus, and which of the frames that arrive are the answers.

A CAN reply carries no number of its own. A reply that comes after its deadline would be taken for the answer to the
next request, so after one went missing the drive is listened to, and not asked, until what it owes has come or `LATE`
has passed; then everything that waits is thrown away.

Frames do not overtake each other. A drive may also send some kinds on its own, and of those the last before the end of
the exchange counts; the kind that is asked for last should be one that it sends only when asked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from typing import TYPE_CHECKING

from drivers.servo import BadReply, NoReply

if TYPE_CHECKING:
    import can

    from drivers.canbus.link import CanLink
    from drivers.clock import Clock

LATE = 0.02
"""s after its deadline that a reply may still come; beyond it it is lost."""

Classify = Callable[["can.Message"], Hashable | None]
"""The kind of a frame from our drive; None where it is from another node or not for us."""


class Requests:
    """The conversation with one drive called `name`. timeout: s that a reply may take.

    overhear: given every frame of the drive's that nobody waits for: heartbeats and the like. only_asked: the kinds
    that it sends only when asked; unasked: how many of each came all the same, old answers or a second drive's.
    """

    def __init__(
        self,
        link: CanLink,
        clock: Clock,
        *,
        name: str,
        timeout: float,
        classify: Classify,
        overhear: Callable[[Hashable, bytes], None],
        only_asked: frozenset[Hashable],
    ) -> None:
        self._link = link
        self._clock = clock
        self._name = name
        self._timeout = timeout
        self._classify = classify
        self._overhear = overhear
        self._owed: Counter[Hashable] = Counter()
        self.only_asked = only_asked
        self.unasked: Counter[Hashable] = Counter()

    def ask(self, frames: Iterable[can.Message], wanted: Iterable[Hashable]) -> dict[Hashable, bytes]:
        """Send `frames` and return the data of one reply of each wanted kind.

        Raises NoReply, BadReply where a reply is cut short, LinkLost.
        """
        self._settle()
        self.listen()
        missing = Counter(wanted)
        self._owed.update(missing)
        for message in frames:
            self._link.send(message)
        deadline = self._clock.now() + self._timeout
        got: dict[Hashable, bytes] = {}
        while missing:
            reply = self._link.receive(deadline)
            if reply is None:
                raise NoReply(f"{self._name} did not answer within {self._timeout * 1e3:.3g} ms")
            kind = self._classify(reply)
            if kind in self._owed:
                self._credit(kind)
                del missing[kind]
                got[kind] = bytes(reply.data)
            elif kind in got:
                got[kind] = bytes(reply.data)
            elif kind is not None:
                self._hear(kind, bytes(reply.data))
        return got

    def refuse_unasked(self) -> None:
        """Raise BadReply where an answer came that nobody asked for, once no more has come for `LATE`."""
        self.listen()
        if self.unasked:
            self.await_change(LATE, lambda: False)
            self.unasked.clear()
            raise BadReply(
                f"{self._name} answered what nobody asked: an old answer, so that samples before may be old too, or a "
                "second drive with the same id; the sample is dropped"
            )

    def fire(self, frames: Iterable[can.Message], wanted: Iterable[Hashable]) -> None:
        """Send `frames` at once, whatever is still owed, and leave the answers for later: what stops a drive must not
        wait. Raises NoReply where the bus takes no frame, LinkLost.
        """
        self._owed.update(wanted)
        for message in frames:
            self._link.send(message)

    def tell(self, frames: Iterable[can.Message]) -> None:
        """Send what has no answer. Raises NoReply where the bus takes no frame, LinkLost."""
        for message in frames:
            self._link.send(message)

    def listen(self) -> None:
        """Take in what has arrived. Raises LinkLost, BadReply where the bus never falls silent."""
        for message in self._link.waiting():
            self._take(message)

    def await_change(self, seconds: float, done: Callable[[], bool]) -> bool:
        """Listen until `done`, for `seconds` at most; whether it is. Raises LinkLost."""
        end = self._clock.now() + seconds
        self.listen()
        while not done() and self._clock.now() < end:
            try:
                message = self._link.receive(end)
            except BadReply:
                continue
            if message is not None:
                self._take(message)
        return done()

    def _settle(self) -> None:
        """Wait for what is still owed; give it up after `LATE`."""
        if self._owed:
            self.await_change(LATE, lambda: not self._owed)
            self._owed.clear()

    def _take(self, message: can.Message) -> None:
        kind = self._classify(message)
        if kind in self._owed:
            self._credit(kind)
        elif kind is not None:
            self._hear(kind, bytes(message.data))

    def _hear(self, kind: Hashable, data: bytes) -> None:
        if kind in self.only_asked:
            self.unasked[kind] += 1
        else:
            self._overhear(kind, data)

    def _credit(self, kind: Hashable) -> None:
        self._owed[kind] -= 1
        if self._owed[kind] <= 0:
            del self._owed[kind]
