"""Requests to one drive on a CAN bus. The module finds the replies among the received frames.

A CAN reply carries no sequence number, so a reply that arrives after its deadline would be taken for the reply to the
next request. After a lost reply nothing is requested until the missing replies have arrived or `LATE` has passed; then
all received frames are discarded.

Frames do not overtake each other. A drive may also send some kinds of frames cyclically; of these the last frame before
the end of the exchange is used. The last request should be for a kind that the drive sends only on request.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from typing import TYPE_CHECKING

from drivers.clock import no_later
from drivers.gate import Gate
from drivers.retry import Repeats
from drivers.servo import BadReply, NoReply
from drivers.uart.adapter import Lateness

if TYPE_CHECKING:
    import can

    from drivers.canbus.link import CanLink
    from drivers.clock import Clock
    from drivers.servo import Quantity

LATE = 0.02
"""s after the deadline in which a reply may still arrive; a reply that has not arrived then is lost."""
SECOND_REPLY = 0.004
"""s to wait for the reply of a second drive with the same id."""

Classify = Callable[["can.Message"], Hashable | None]
"""A function that returns the kind of a frame if our drive sent the frame, and None if another node did."""


class Requests:
    """Send requests to the drive `name` and return its replies. timeout: s to wait for the replies to a request.

    classify: returns the kind of a frame. on_cyclic: called with every frame of the drive that is no reply, such as a
    heartbeat. only_on_request: the kinds that the drive sends only on request. unrequested: number of frames of each
    such kind that arrived without a request: late replies, or replies of a second drive. repeats: whether `ask` repeats
    a request whose reply is lost.
    """

    def __init__(
        self,
        link: CanLink,
        clock: Clock,
        *,
        name: str,
        timeout: float,
        classify: Classify,
        on_cyclic: Callable[[Hashable, bytes], None] = lambda _kind, _data: None,
        only_on_request: frozenset[Hashable],
    ) -> None:
        self._link = link
        self._clock = clock
        self.name = name
        self._late = Lateness(link.name, timeout)
        self._classify = classify
        self._on_cyclic = on_cyclic
        self._due: Counter[Hashable] = Counter()
        self.repeats = Repeats()
        self.only_on_request = only_on_request
        self.unrequested: Counter[Hashable] = Counter()

    def gate(self, quantities: frozenset[Quantity], torque_off: Callable[[int], None], mode_key: str = "") -> Gate:
        """Return the gate of the servo, whose link it closes. The arguments are those of `Gate`."""
        return Gate(
            self._link.name,
            quantities,
            torque_off=torque_off,
            release=self._link.close,
            mode_key=mode_key,
            repeats=self.repeats,
            clock=self._clock,
        )

    def ask(self, frames: Iterable[can.Message], wanted: Iterable[Hashable]) -> dict[Hashable, bytes]:
        """Send `frames` and return the data of one reply of each kind in `wanted`.

        Raises NoReply, LinkLost, and BadReply if a reply is shorter than its length code says.
        """
        frames, wanted = list(frames), list(wanted)
        return self.repeats(lambda: self.ask_once(frames, wanted))

    def ask_once(self, frames: Iterable[can.Message], wanted: Iterable[Hashable]) -> dict[Hashable, bytes]:
        """Send `frames` once, and return the data of one reply of each kind in `wanted`. If a reply is lost, the
        request is not sent again.
        """
        self._settle()
        self.process()
        missing = Counter(wanted)
        self._due.update(missing)
        for message in frames:
            self._link.send(message)
        begun = self._clock.now()
        got: dict[Hashable, bytes] = {}
        while missing:
            reply = self._link.receive(begun + self._late.wait)
            if reply is None:
                raise NoReply(f"{self.name} did not answer within {self._late.wait * 1e3:.3g} ms")
            kind = self._classify(reply)
            if kind in self._due:
                self._credit(kind)
                del missing[kind]
                got[kind] = bytes(reply.data)
            elif kind in got:
                got[kind] = bytes(reply.data)
            elif kind is not None:
                self._unawaited(kind, bytes(reply.data))
        self._late.note(self._clock.now() - begun)
        return got

    def refuse_unrequested(self) -> None:
        """Raise BadReply if a reply arrived without a request. Before that, discard the frames that arrive within
        `LATE`.
        """
        self.process()
        if self.unrequested:
            self.wait_until(LATE, lambda: False)
            self.unrequested.clear()
            raise BadReply(
                f"{self.name} sent a reply without a request: a late reply, so that earlier samples may be late too, "
                "or a second drive with the same id; the sample is dropped"
            )

    def check_alone(self, kind: Hashable) -> None:
        """Raise BadReply if a second drive replies to the last request, which was for `kind`."""
        if self.wait_until(SECOND_REPLY, lambda: kind in self.unrequested):
            raise garbled(self.name, "it answers twice")

    def send_now(self, frames: Iterable[can.Message], wanted: Iterable[Hashable]) -> None:
        """Send `frames` at once, without waiting for the replies to earlier requests: torque-off must not wait.

        wanted: the kinds of the replies that the drive will send. Raises LinkLost, and NoReply if the bus accepts no
        frame.
        """
        self._due.update(wanted)
        for message in frames:
            self._link.send(message)

    def send(self, frames: Iterable[can.Message]) -> None:
        """Send frames that have no reply. Raises NoReply if the bus accepts no frame, LinkLost."""
        for message in frames:
            self._link.send(message)

    def process(self) -> None:
        """Process all received frames. Raises LinkLost, BadReply if the bus never falls silent."""
        for message in self._link.waiting():
            self._take(message)

    def wait_until(self, seconds: float, done: Callable[[], bool]) -> bool:
        """Process frames until `done()` is true, for at most `seconds`. Return whether `done()` is true. Raises
        LinkLost.
        """
        end = no_later(self._clock.now() + seconds)
        self.process()
        while not done() and self._clock.now() < end:
            try:
                message = self._link.receive(end)
            except BadReply:
                continue
            if message is not None:
                self._take(message)
        return done()

    def _settle(self) -> None:
        """Wait for the missing replies to earlier requests, for at most `LATE` s."""
        if self._due:
            self.wait_until(LATE, lambda: not self._due)
            self._due.clear()

    def _take(self, message: can.Message) -> None:
        kind = self._classify(message)
        if kind in self._due:
            self._credit(kind)
        elif kind is not None:
            self._unawaited(kind, bytes(message.data))

    def _unawaited(self, kind: Hashable, data: bytes) -> None:
        if kind in self.only_on_request:
            self.unrequested[kind] += 1
        else:
            self._on_cyclic(kind, data)

    def _credit(self, kind: Hashable) -> None:
        self._due[kind] -= 1
        if self._due[kind] <= 0:
            del self._due[kind]


def garbled(name: str, reason: object) -> BadReply:
    """Return the error for the case that the replies of the drive `name` cannot be decoded during identification."""
    return BadReply(
        f"the replies of {name} cannot be understood ({reason}): two drives with that id, or a wrong bit rate; connect "
        "one drive alone and give each its own id"
    )
