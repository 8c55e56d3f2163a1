"""Several emulated drives on one CAN bus: who receives a frame, who replies, and when replies arrive. No I/O.

Two drives with one identifier behave as the bus makes them: they begin to send at the same moment; equal frames are one
frame, and different ones break at the first bit that differs, every time they try.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

from sim_backend.wire.canbus.frames import BUS_OFF, PROTOCOL_ERROR, CanFrame, duration, error_frame
from sim_backend.wire.faults import BusOff, CanFault, Reboots, Unplug, WireFaults


class CanNode(Protocol):
    """An emulated drive. Times are s on the bus's clock."""

    def handle(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """Return the replies to a frame that ended at `now`; every node receives every frame."""

    def due(self) -> float:
        """Return the time at which it next sends something unasked; infinity where it does not."""

    def unasked(self, now: float) -> list[CanFrame]:
        """Return the frames that it sends unasked at `now`, which is the time that `due` gave."""

    def advance(self, now: float) -> None:
        """Carry it to `now`."""

    def reboot(self, now: float) -> None:
        """Lose power for a moment."""


class CanDelivery(NamedTuple):
    """A frame that reaches the host, and when, s."""

    at: float
    frame: CanFrame


@dataclass(frozen=True, slots=True)
class CanTiming:
    """The durations on the bus. Bit rates in bit/s; turnaround: s from a request to its answer in the drive; latency: s
    that the host's adapter holds a frame back.
    """

    bitrate: float = 1_000_000.0
    data_bitrate: float = 5_000_000.0
    turnaround: float = 5e-5
    latency: float = 1e-4


class CanBus:
    """The bus with its drives. timing: None where everything happens at once."""

    def __init__(self, nodes: Iterable[CanNode], *, timing: CanTiming | None = None) -> None:
        self.nodes: list[CanNode] = list(nodes)
        self.unplugged = False
        self.off = False
        """Whether the host's controller has left the bus."""
        self._timing = timing
        self._free = 0.0
        self._last = 0.0
        self.faults = WireFaults[CanFault]()

    def due(self) -> float:
        """Return the time at which a drive next sends something unasked, s."""
        return min((node.due() for node in self.nodes), default=math.inf)

    def advance(self, now: float) -> list[CanDelivery]:
        """Carry every drive to `now` and return what they sent unasked meanwhile."""
        out: list[CanDelivery] = []
        while self.due() <= now:
            at = self.due()
            for node in self.nodes:
                if node.due() <= at:
                    out += [delivery for frame in node.unasked(at) for delivery in self._sent(frame, at)]
        for node in self.nodes:
            node.advance(now)
        return out

    def receive(self, frame: CanFrame, now: float) -> list[CanDelivery]:
        """Return what the drives send unasked until `frame`, sent by the host at `now`, arrives, and in reply to it."""
        arrival = self._occupy(frame, now)
        out = self.advance(arrival)
        if self.faults.loses_request(arrival) or self.off:
            return out
        answers = [answer for node in self.nodes for answer in [node.handle(frame, arrival)] if answer]
        if not answers:
            return out
        ready = arrival + (self._timing.turnaround if self._timing is not None else 0.0)
        for place in range(max(len(answer) for answer in answers)):
            frames = [answer[place] for answer in answers if place < len(answer)]
            out += self._together(frames, ready)
        return sorted(out, key=lambda delivery: delivery.at)

    def _together(self, frames: list[CanFrame], now: float) -> list[CanDelivery]:
        """Frames that drives begin to send at the same moment: the lower identifier goes first."""
        out: list[CanDelivery] = []
        for ident in sorted({frame.ident for frame in frames}):
            same = {frame for frame in frames if frame.ident == ident}
            reply = same.pop()
            if same:
                out.append(CanDelivery(self._occupy(reply, now), error_frame(PROTOCOL_ERROR)))
            else:
                out += self._answered(reply, now)
        return out

    def _answered(self, frame: CanFrame, now: float) -> list[CanDelivery]:
        """Return a reply as it arrives at the host, with the faults that were injected."""
        at = self._occupy(frame, now)
        match self.faults.interrupts_reply(now):
            case Unplug():
                self.unplugged = True
            case BusOff():
                self.off = True
                return [CanDelivery(at, error_frame(BUS_OFF))]
            case Reboots():
                for node in self.nodes:
                    node.reboot(now)
                return []
        arriving = self.faults.arriving(frame.data, at + self._latency)
        return [delivery for when, data in arriving for delivery in self._delivered(when, replace(frame, data=data))]

    def _sent(self, frame: CanFrame, now: float) -> list[CanDelivery]:
        return self._delivered(self._occupy(frame, now) + self._latency, frame)

    def _delivered(self, at: float, frame: CanFrame) -> list[CanDelivery]:
        """Return the frame at the host. None overtakes another in the adapter: a delayed one delays all behind it."""
        if self.unplugged or self.off:
            return []
        self._last = max(self._last, at)
        return [CanDelivery(self._last, frame)]

    @property
    def _latency(self) -> float:
        return self._timing.latency if self._timing is not None else 0.0

    def _occupy(self, frame: CanFrame, now: float) -> float:
        """Return the time at which a frame that may begin at `now` has ended."""
        if self._timing is None:
            return now
        begin = max(now, self._free)
        self._free = begin + duration(frame, self._timing.bitrate, self._timing.data_bitrate)
        return self._free
