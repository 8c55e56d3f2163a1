"""A CAN bus with several emulated drives: who receives a frame, who replies, and when the replies arrive. No I/O.

Two drives with the same identifier behave as on a real bus. They begin to send at the same moment; equal frames become
one frame; different frames are destroyed at the first bit that differs, at every attempt.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

from sim_backend.wire.canbus.frames import BUS_OFF, PROTOCOL_ERROR, CanFrame, duration, error_frame
from sim_backend.wire.faults import BusOff, CanFault, Reboots, Unplug, WireFaults


class CanNode(Protocol):
    """The interface of an emulated drive on a CAN bus. Times are s on the bus's clock."""

    def handle(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """Return the replies to a frame whose last bit was sent at `now`. Every node receives every frame."""

    def due(self) -> float:
        """Return the time at which the drive next sends a frame without a request; infinity if it never does."""

    def unasked(self, now: float) -> list[CanFrame]:
        """Return the frames that the drive sends without a request at `now`, the time that `due` returned."""

    def advance(self, now: float) -> None:
        """Simulate the drive up to the time `now`."""

    def reboot(self, now: float) -> None:
        """Cut the drive's power for a moment at `now`."""


class CanDelivery(NamedTuple):
    """A frame that reaches the host, and the time of its arrival, s."""

    at: float
    frame: CanFrame


@dataclass(frozen=True, slots=True)
class CanTiming:
    """The durations on the bus. bitrate, data_bitrate: bit/s. turnaround: s from a request to its reply in the drive.
    latency: s by which the host's adapter delays a received frame.
    """

    bitrate: float = 1_000_000.0
    data_bitrate: float = 5_000_000.0
    turnaround: float = 5e-5
    latency: float = 1e-4


class CanBus:
    """A CAN bus with its drives. timing: the durations; None: nothing takes time."""

    def __init__(self, nodes: Iterable[CanNode], *, timing: CanTiming | None = None) -> None:
        self.nodes: list[CanNode] = list(nodes)
        self.unplugged = False
        self.off = False
        """Whether the host's CAN controller is bus-off."""
        self._timing = timing
        self._free = 0.0
        self._last = 0.0
        self.faults = WireFaults[CanFault]()

    def due(self) -> float:
        """Return the time at which a drive next sends a frame without a request, s."""
        return min((node.due() for node in self.nodes), default=math.inf)

    def advance(self, now: float) -> list[CanDelivery]:
        """Simulate every drive up to `now` and return the frames that the drives sent without a request meanwhile."""
        out: list[CanDelivery] = []
        while (at := self.due()) <= now:
            for node in self.nodes:
                if node.due() <= at:
                    out += [delivery for frame in node.unasked(at) for delivery in self._sent(frame, at)]
        for node in self.nodes:
            node.advance(now)
        return out

    def receive(self, frame: CanFrame, now: float) -> list[CanDelivery]:
        """Deliver `frame`, which the host sends at `now`. Return the drives' replies, and the frames that they sent
        without a request before.
        """
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
        """Return what arrives when drives begin to send `frames` at the same moment: the frame with the lowest
        identifier goes first.
        """
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
        """Return what arrives at the host for a reply that is sent at `now`, with the injected faults."""
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
        """Return the frame as it arrives at the host at the time `at`. In the adapter no frame overtakes another, so a
        delayed frame delays all later ones.
        """
        if self.unplugged or self.off:
            return []
        self._last = max(self._last, at)
        return [CanDelivery(self._last, frame)]

    @property
    def _latency(self) -> float:
        return self._timing.latency if self._timing is not None else 0.0

    def _occupy(self, frame: CanFrame, now: float) -> float:
        """Return the time at which a frame has ended that wants to begin at `now` and waits until the bus is free."""
        if self._timing is None:
            return now
        begin = max(now, self._free)
        self._free = begin + duration(frame, self._timing.bitrate, self._timing.data_bitrate)
        return self._free
