"""Several emulated drives on one CAN bus: who hears what, who answers, and when it arrives. No I/O.

What two drives with one identifier do is the bus's physics: they begin to send at the same moment, equal frames are one
frame, and different ones break at the first bit that differs, every time they try.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from sim_backend.wire.canbus.faults import BusOff, DropRequests, Fault, Reboots, Unplug, spoiled
from sim_backend.wire.canbus.frames import BUS_OFF, PROTOCOL_ERROR, CanFrame, duration, error_frame


class Node(Protocol):
    """An emulated drive. Times are s on the bus's clock."""

    def hear(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """What it answers to a frame that ended at `now`; every node hears every frame."""
        ...

    def due(self) -> float:
        """When it next sends something unasked; infinite where it does not."""
        ...

    def speak(self, now: float) -> list[CanFrame]:
        """What it sends unasked at `now`, which is the time that `due` gave."""
        ...

    def advance(self, now: float) -> None:
        """Let time pass for it."""
        ...

    def reboot(self, now: float) -> None:
        """Lose power for a moment."""
        ...


class Delivery(NamedTuple):
    """A frame that reaches the host, and when, s."""

    at: float
    frame: CanFrame


@dataclass(frozen=True, slots=True)
class Timing:
    """How long the bus takes. Bit rates in bit/s; turnaround: s from a request to its answer in the drive; latency: s
    that the host's adapter holds a frame back.
    """

    bitrate: float = 1_000_000.0
    data_bitrate: float = 5_000_000.0
    turnaround: float = 5e-5
    latency: float = 1e-4


class Bus:
    """The bus with its drives. timing: None where everything happens at once."""

    def __init__(self, nodes: Iterable[Node], *, timing: Timing | None = None) -> None:
        self.nodes: list[Node] = list(nodes)
        self.unplugged = False
        self.off = False
        """Whether the host's controller has left the bus."""
        self._timing = timing
        self._free = 0.0
        self._last = 0.0
        self._replies = 0
        self._requests = 0
        self._faults: list[tuple[int, Fault]] = []

    def inject(self, fault: Fault) -> None:
        """Let `fault` happen, counted from now."""
        seen = self._requests if isinstance(fault, DropRequests) else self._replies
        self._faults.append((seen + fault.after, fault))

    def clear_faults(self) -> None:
        """Let nothing of what was injected happen any more."""
        self._faults.clear()

    @property
    def replies(self) -> int:
        """Replies sent so far."""
        return self._replies

    def due(self) -> float:
        """When a drive next sends something unasked, s."""
        return min((node.due() for node in self.nodes), default=math.inf)

    def advance(self, now: float) -> list[Delivery]:
        """Carry every drive to `now`; what arrived unasked in between."""
        out: list[Delivery] = []
        while self.due() <= now:
            at = self.due()
            for node in self.nodes:
                if node.due() <= at:
                    out += [delivery for frame in node.speak(at) for delivery in self._sent(frame, at)]
        for node in self.nodes:
            node.advance(now)
        return out

    def receive(self, frame: CanFrame, now: float) -> list[Delivery]:
        """What `frame`, given to the host's adapter at `now`, makes the drives send, and what they sent before it."""
        arrival = self._occupy(frame, now)
        out = self.advance(arrival)
        self._requests += 1
        if self.off or self._hit(DropRequests, self._requests):
            return out
        answers = [answer for node in self.nodes for answer in [node.hear(frame, arrival)] if answer]
        if not answers:
            return out
        ready = arrival + (self._timing.turnaround if self._timing is not None else 0.0)
        for place in range(max(len(answer) for answer in answers)):
            frames = [answer[place] for answer in answers if place < len(answer)]
            out += self._together(frames, ready)
        return sorted(out, key=lambda delivery: delivery.at)

    def _together(self, frames: list[CanFrame], now: float) -> list[Delivery]:
        """Frames that drives begin to send at the same moment: the lower identifier goes first."""
        out: list[Delivery] = []
        for ident in sorted({frame.ident for frame in frames}):
            same = {frame for frame in frames if frame.ident == ident}
            reply = same.pop()
            if same:
                out.append(Delivery(self._occupy(reply, now), error_frame(PROTOCOL_ERROR)))
            else:
                out += self._answered(reply, now)
        return out

    def _answered(self, frame: CanFrame, now: float) -> list[Delivery]:
        """A reply at the host, spoiled as planned."""
        at = self._occupy(frame, now)
        self._replies += 1
        if self._hit(Unplug, self._replies):
            self.unplugged = True
        if self._hit(BusOff, self._replies):
            self.off = True
            return [Delivery(at, error_frame(BUS_OFF))]
        if self._hit(Reboots, self._replies):
            for node in self.nodes:
                node.reboot(now)
            return []
        arriving = [(at + self._latency, frame)]
        for first, fault in self._faults:
            if not isinstance(fault, DropRequests) and first < self._replies <= first + fault.count:
                arriving = [piece for when, part in arriving for piece in spoiled(fault, part, when)]
        return [delivery for when, part in arriving for delivery in self._delivered(when, part)]

    def _sent(self, frame: CanFrame, now: float) -> list[Delivery]:
        return self._delivered(self._occupy(frame, now) + self._latency, frame)

    def _delivered(self, at: float, frame: CanFrame) -> list[Delivery]:
        """The frame at the host; none overtakes another in the adapter, so one held up holds up what is behind it."""
        if self.unplugged or self.off:
            return []
        self._last = max(self._last, at)
        return [Delivery(self._last, frame)]

    @property
    def _latency(self) -> float:
        return self._timing.latency if self._timing is not None else 0.0

    def _occupy(self, frame: CanFrame, now: float) -> float:
        """When a frame that may begin at `now` has ended."""
        if self._timing is None:
            return now
        begin = max(now, self._free)
        self._free = begin + duration(frame, self._timing.bitrate, self._timing.data_bitrate)
        return self._free

    def _hit(self, kind: type[Fault], number: int) -> bool:
        return any(isinstance(f, kind) and first < number <= first + f.count for first, f in self._faults)
