"""Lets emulated drives answer on a real bus of python-can's: in this process (`virtual`), across processes
(`udp_multicast`), or on an adapter.
"""

from __future__ import annotations

import heapq
import math
import threading
import time
from typing import TYPE_CHECKING, Protocol, Self

import can

from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.canbus.slcan import SlcanLine

if TYPE_CHECKING:
    from pathlib import Path

    from sim_backend.wire.canbus.bus import CanBus, CanDelivery

_IDLE = 0.02
"""s between two looks at whether it is to stop."""


class Served(Protocol):
    """An emulated bus that somebody can connect to."""

    lock: threading.Lock
    """Held while the bus is at work; whoever looks at it takes it."""

    def __enter__(self) -> Self:
        """Answer from a thread from now on."""
        ...

    def __exit__(self, *_: object) -> None:
        """Answer no more, and clean up."""
        ...

    def now(self) -> float:
        """The time the bus lives in, s."""
        ...

    def serve(self) -> None:
        """Answer from this thread until `stop` is called from another or from a signal, then clean up."""
        ...

    def stop(self) -> None:
        """Let `serve` return."""
        ...


class CanServer:
    """Serves `bus` on the python-can bus `channel` of `interface`. Raises can.CanError where that cannot be opened."""

    def __init__(self, interface: str, channel: str, bus: CanBus) -> None:
        self.lock = threading.Lock()
        self._bus = bus
        options = {"hop_limit": 0} if interface == "udp_multicast" else {}
        self._wire: can.BusABC = can.Bus(interface=interface, channel=channel, ignore_config=True, **options)  # type: ignore[arg-type]  # each interface has options of its own
        self._due: list[tuple[float, int, CanFrame]] = []
        self._count = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"CAN {channel}")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._thread.join()
        self._wire.shutdown()

    def now(self) -> float:
        """The time the bus lives in, s."""
        return time.monotonic()

    def stop(self) -> None:
        """Let `serve` return."""
        self._stopping.set()

    def serve(self) -> None:
        """Answer from this thread until `stop`, then clean up."""
        try:
            self._run()
        finally:
            self._wire.shutdown()

    def _run(self) -> None:
        while not self._stopping.is_set() and not self._bus.unplugged:
            next_ = min(self._due[0][0] if self._due else math.inf, self._bus.due())
            message = self._wire.recv(max(0.0, min(_IDLE, next_ - self.now())))
            with self.lock:
                if message is not None and not message.is_error_frame:
                    self._plan(self._bus.receive(_heard(message), self.now()))
                self._plan(self._bus.advance(self.now()))
            while self._due and self._due[0][0] <= self.now():
                self._wire.send(_said(heapq.heappop(self._due)[2]))

    def _plan(self, deliveries: list[CanDelivery]) -> None:
        for at, frame in deliveries:
            self._count += 1
            heapq.heappush(self._due, (at, self._count, frame))


def served(bus: CanBus, interface: str, channel: str | Path) -> Served:
    """`bus` where a client can reach it: at `channel`, a link to a pty, where `interface` is slcan; otherwise on the
    python-can bus of that name.
    """
    if interface == "slcan":
        from pathlib import Path as Path_

        return SlcanLine(Path_(channel), bus)
    return CanServer(interface, str(channel), bus)


def _heard(message: can.Message) -> CanFrame:
    return CanFrame(
        message.arbitration_id,
        bytes(message.data),
        extended=message.is_extended_id,
        remote=message.is_remote_frame,
        fd=message.is_fd,
        fast=message.bitrate_switch,
    )


def _said(frame: CanFrame) -> can.Message:
    return can.Message(
        arbitration_id=frame.ident,
        data=frame.data,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        is_error_frame=frame.error,
        is_fd=frame.fd,
        bitrate_switch=frame.fast,
    )
