"""An emulated CAN bus as a bus of python-can's, in virtual time and without I/O: waiting is what makes time pass."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import can

from sim_backend.wire.canbus.frames import CanFrame

if TYPE_CHECKING:
    from drivers.clock import VirtualClock
    from sim_backend.wire.canbus.bus import CanBus, CanDelivery


class CanLoopback(can.BusABC):
    """What a program in the same process opens to speak with the drives of `bus`. sent: every frame, in order."""

    def __init__(self, bus: CanBus, clock: VirtualClock) -> None:
        super().__init__(channel="loopback")
        self.bus = bus
        self.sent: list[can.Message] = []
        self.closed = False
        self._clock = clock
        self._due: list[tuple[float, int, CanFrame]] = []
        self._count = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 - python-can's signature
        """Give a frame to the bus. Raises can.CanOperationError where the adapter is gone."""
        self._check()
        self.sent.append(msg)
        frame = CanFrame(
            msg.arbitration_id,
            bytes(msg.data),
            extended=msg.is_extended_id,
            remote=msg.is_remote_frame,
            fd=msg.is_fd,
            fast=msg.bitrate_switch,
        )
        self._plan(self.bus.receive(frame, self._clock.now()))

    def advance(self) -> None:
        """Carry the bus to the clock's time; what is said meanwhile waits to be read."""
        self._plan(self.bus.advance(self._clock.now()))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        end = self._clock.now() + (timeout or 0.0)
        while True:
            self._check()
            self.advance()
            if self._due and self._due[0][0] <= self._clock.now():
                return _message(heapq.heappop(self._due)[2]), False
            next_ = min([self.bus.due(), *(at for at, _, _ in self._due[:1])])
            if next_ > end:
                self._clock.sleep_until(end)
                return None, False
            self._clock.sleep_until(next_)

    def shutdown(self) -> None:
        """Let go of it."""
        if not self.closed:
            super().shutdown()
        self.closed = True

    def _check(self) -> None:
        if self.closed or self.bus.unplugged:
            raise can.CanOperationError("the adapter is gone")

    def _plan(self, deliveries: list[CanDelivery]) -> None:
        for at, frame in deliveries:
            self._count += 1
            heapq.heappush(self._due, (at, self._count, frame))


def _message(frame: CanFrame) -> can.Message:
    return can.Message(
        arbitration_id=frame.ident,
        data=frame.data,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        is_error_frame=frame.error,
        is_fd=frame.fd,
        bitrate_switch=frame.fast,
    )
