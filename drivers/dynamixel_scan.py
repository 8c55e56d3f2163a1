"""Who is on the line at all: asked where nobody answered as the stand file says."""

from __future__ import annotations

import contextlib
from typing import get_args

from drivers.dynamixel_bus import BROADCAST, Bus
from drivers.dynamixel_config import Baudrate, DynamixelConfig
from drivers.dynamixel_models import name_of
from drivers.dynamixel_port import SerialPort
from drivers.servo import Clock, DriverError, MonotonicClock


def search(config: DynamixelConfig, clock: Clock | None = None, port: SerialPort | None = None) -> list[str]:
    """A sentence for every servo that answers at any baud rate on the port; nothing but pings is sent.

    Takes about a second a baud rate. clock and port are the machine's unless a test brings its own. Raises DriverError
    where the port cannot be opened.
    """
    clock = clock or MonotonicClock()
    found = []
    for baudrate in get_args(Baudrate):
        line = port or SerialPort(config.port, baudrate, clock)
        line.baudrate = baudrate
        line.openPort()
        try:
            with contextlib.suppress(DriverError):
                for ident, number in Bus(line, BROADCAST, clock, 0.0).everyone():
                    found.append(f"a {name_of(number)} answers with id {ident} at {baudrate} baud")
        finally:
            line.closePort()
    return found
