"""Search for servos on a serial port, in case the servo of the stand file does not reply."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from drivers.clock import MonotonicClock
from drivers.packets.bus import Bus
from drivers.packets.port import SerialPort
from drivers.packets.wire import BROADCAST
from drivers.servo import DriverError

if TYPE_CHECKING:
    from drivers.clock import Clock
    from drivers.packets.wire import Wire


def search_every_rate(
    path: str,
    rates: Iterable[int],
    wires: Iterable[Wire],
    *,
    name: Callable[[SerialPort, int, int], str],
    clock: Clock | None,
    port: SerialPort | None,
) -> list[str]:
    """Return a sentence for every servo that replies to a ping at any baud rate on the port `path`.

    rates: the baud rates to try, bit/s. wires: the protocols to try. name: a function that returns the name of a servo
    from the open port, its id and its model number. clock, port: given by tests; None uses the real clock and opens the
    port. Raises DriverError if the port cannot be opened.
    """
    clock = clock or MonotonicClock()
    sentences: list[str] = []
    for baudrate in rates:
        line = port or SerialPort(path, baudrate, clock)
        line.baudrate = baudrate
        line.openPort()
        try:
            for wire in wires:
                with contextlib.suppress(DriverError):
                    for ident, number in Bus(line, BROADCAST, clock, 0.0, wire).ping_all():
                        sentences.append(f"{name(line, ident, number)} answers with id {ident} at {baudrate} baud")
        finally:
            line.closePort()
    return sentences
