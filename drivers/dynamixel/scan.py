"""Who is on the line at all: asked where nobody answered as the stand file says."""

from __future__ import annotations

import contextlib
from typing import get_args

from drivers.clock import Clock, MonotonicClock
from drivers.dynamixel.bus import Bus
from drivers.dynamixel.config import Baudrate, DynamixelConfig
from drivers.dynamixel.models import name_of
from drivers.dynamixel.port import SerialPort
from drivers.dynamixel.wire import BROADCAST, Wire1, Wire2
from drivers.servo import DriverError


def search(config: DynamixelConfig, clock: Clock | None = None, port: SerialPort | None = None) -> list[str]:
    """A sentence for every servo that answers at any baud rate on the port; nothing but pings is sent.

    Takes about two seconds a baud rate. clock and port are the machine's unless a test brings its own. Raises
    DriverError where the port cannot be opened.
    """
    clock = clock or MonotonicClock()
    found: list[str] = []
    for baudrate in get_args(Baudrate):
        line = port or SerialPort(config.port, baudrate, clock)
        line.baudrate = baudrate
        line.openPort()
        try:
            for wire in (Wire2(), Wire1()):
                with contextlib.suppress(DriverError):
                    heard = Bus(line, BROADCAST, clock, 0.0, wire).everyone()
                    found += [f"{_named(number)} answers with id {ident} at {baudrate} baud" for ident, number in heard]
        finally:
            line.closePort()
    return found


def _named(number: int) -> str:
    return f"a {name_of(number)}" if number else "a servo on protocol 1.0"
