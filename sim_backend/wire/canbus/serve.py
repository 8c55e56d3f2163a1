"""Connect emulated drives to a real bus of python-can: in this process (`virtual`), across processes (`udp_multicast`),
or on an adapter.
"""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

import can

from sim_backend.wire.arrivals import Arrivals
from sim_backend.wire.canbus.at_frames import at_line
from sim_backend.wire.canbus.bus import CanBus, CanNode
from sim_backend.wire.canbus.damiao import damiao_line
from sim_backend.wire.canbus.frames import CanFrame
from sim_backend.wire.canbus.messages import from_message, to_message
from sim_backend.wire.canbus.slcan import slcan_line
from sim_backend.wire.faults import follow
from sim_backend.wire.life import Life

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sim_backend.fault_plan import FaultPlan
    from sim_backend.parameters import SimParameters
    from sim_backend.wire.canbus.bus import CanTiming
    from sim_backend.wire.torque_log import TorqueLog
    from sim_backend.wire.uart.pty_line import PtyLine

_STEP, _LONGEST_STEP = 0.02, 0.25
"""s by which the bus is simulated at a time while no client sends: at first, and after a longer silence."""


class CanServer:
    """Connects `bus` to the python-can bus `channel` of `interface`. A thread serves it inside the `with` block.

    lock: a lock held while the bus is simulated; whoever reads the bus's state must take it. Raises can.CanError if the
    python-can bus cannot be opened.
    """

    def __init__(self, interface: str, channel: str, bus: CanBus) -> None:
        self.lock = threading.Lock()
        self._bus = bus
        self._wire, self._is_heard = _opened(interface, channel)
        self._arrivals = Arrivals[CanFrame]()
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
        """The time on the bus's clock, s."""
        return time.monotonic()

    def stop(self) -> None:
        """Make `serve` return."""
        self._stopping.set()

    def serve(self) -> None:
        """Serve in this thread until `stop` is called, then close the python-can bus."""
        try:
            self._run()
        finally:
            self._wire.shutdown()

    def _run(self) -> None:
        """Serve. While nobody hears the bus, what the drives send is lost, as on a bus where nobody acknowledges it."""
        step, heard, looked = _STEP, True, -math.inf
        while not self._stopping.is_set() and not self._bus.unplugged:
            next_ = min(self._arrivals.next(), self._bus.due()) if heard else math.inf
            message = self._wire.recv(max(0.0, min(step, next_ - self.now())))
            step = _STEP if message is not None else min(2.0 * step, _LONGEST_STEP)
            with self.lock:
                if not heard:
                    self._bus.advance(self.now())  # what the drives sent until now is lost
                if message is not None or self.now() >= looked + _LONGEST_STEP:
                    heard, looked = message is not None or self._is_heard(), self.now()
                if message is not None and not message.is_error_frame:
                    self._arrivals.add(self._bus.receive(from_message(message), self.now()))
                self._arrivals.add(self._bus.advance(self.now()))
            for frame in self._arrivals.until(self.now()):
                if heard:
                    self._wire.send(to_message(frame))


def _opened(interface: str, channel: str) -> tuple[can.BusABC, Callable[[], bool]]:
    """Return the bus, and a function that returns whether another program has it open."""
    if interface == "udp_multicast":
        from drivers.canbus.multicast import MulticastBus

        bus = MulticastBus(channel)
        return bus, bus.is_heard
    return can.Bus(interface=interface, channel=channel, ignore_config=True), lambda: True


class CanDrive(CanNode, Protocol):
    """An emulated drive on a CAN bus with its life."""

    life: Life


@dataclass(frozen=True, slots=True)
class CanFamily:
    """A family of emulated drives on a CAN bus. Calling the object makes a bus of such drives, each with its own plant.

    noun: the kind of names in `known`: model or firmware. default: the name used if none is given. first: the id of a
    single drive. make: a function that makes a drive from its model, its id, its plant (None: the default joint)
    and the time at which it is powered, s on the monotonic clock.
    """

    noun: str
    known: tuple[str, ...]
    default: str
    make: Callable[[str, int, SimParameters | None, float], CanDrive]
    first: int = 1

    def __call__(
        self,
        channel: str | Path,
        model: str | None = None,
        idents: Iterable[int] = (),
        *,
        interface: str = "slcan",
        parameters: SimParameters | None = None,
        timing: CanTiming | None = None,
        log: TorqueLog | None = None,
        faults: FaultPlan | None = None,
    ) -> PtyLine | CanServer:
        """Return a bus of drives. Serve it with `with served:` in a thread, or with `served.serve()` in this thread.

        channel, interface: for "slcan", "damiao" and "robstride", `channel` becomes a symlink to a pty on which such
        an adapter answers; any other interface and channel are python-can's. timing: durations on the bus; None:
        nothing takes time. log: where the torque of each drive is logged. faults: the faults that will happen. Raises
        ValueError for a model that is not in `known` or an impossible id, FileExistsError if `channel` is a file,
        can.CanError if the interface cannot be opened.
        """
        model = model or self.default
        if model not in self.known:
            raise ValueError(f"{self.noun} {model!r} is not known: choose one of {', '.join(self.known)}")
        now = time.monotonic()
        drives = [self.make(model, ident, parameters, now) for ident in idents or (self.first,)]
        if log is not None:
            log.watch_all(drive.life for drive in drives)
        bus = CanBus(drives, timing=timing)
        if faults is not None:
            follow(faults, bus.faults, [drive.life.motor for drive in drives], now, can=True)
        line = {"slcan": slcan_line, "damiao": damiao_line, "robstride": at_line}.get(interface)
        return CanServer(interface, str(channel), bus) if line is None else line(Path(channel), bus)
