"""A search for servos, for the case that the one of the stand file does not reply."""

from __future__ import annotations

import contextlib
from typing import get_args

from drivers.clock import Clock, MonotonicClock
from drivers.feetech.config import Baudrate, FeetechConfig
from drivers.feetech.faults import ALERTS
from drivers.feetech.models import name_of
from drivers.packets.bus import Bus
from drivers.packets.port import SerialPort
from drivers.packets.wire import BROADCAST, Wire1
from drivers.servo import DriverError

_PATIENCE = 0.02  # s


def search(config: FeetechConfig, clock: Clock | None = None, port: SerialPort | None = None) -> list[str]:
    """Return a sentence for every servo that replies at any baud rate on the port; nothing is written.

    Takes about a second for each baud rate. clock, port: those of the machine unless a test gives its own. Raises
    DriverError where the port cannot be opened.
    """
    clock = clock or MonotonicClock()
    sentences: list[str] = []
    for baudrate in get_args(Baudrate):
        line = port or SerialPort(config.port, baudrate, clock)
        line.baudrate = baudrate
        line.openPort()
        try:
            with contextlib.suppress(DriverError):
                for ident, _ in Bus(line, BROADCAST, clock, 0.0, Wire1(ALERTS)).ping_all():
                    kind = _kind(Bus(line, ident, clock, _PATIENCE, Wire1(ALERTS)))
                    sentences.append(f"a {kind} answers with id {ident} at {baudrate} baud")
        finally:
            line.closePort()
    return sentences


def _kind(bus: Bus) -> str:
    try:
        head = bus.read(0, 5)
    except DriverError:
        return "servo of a kind that it does not tell"
    return name_of((head[3], head[4])) or f"servo of a kind not known here (version {head[3]}.{head[4]})"
