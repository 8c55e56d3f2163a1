"""A search for servos, for the case that the one of the stand file does not reply."""

from __future__ import annotations

import contextlib
from typing import get_args

from drivers.clock import Clock, MonotonicClock
from drivers.dynamixel.config import Baudrate, DynamixelConfig
from drivers.dynamixel.models import name_of
from drivers.dynamixel.wire import Wire2, wire_1
from drivers.packets.bus import Bus
from drivers.packets.port import SerialPort
from drivers.packets.wire import BROADCAST
from drivers.servo import DriverError


def search(config: DynamixelConfig, clock: Clock | None = None, port: SerialPort | None = None) -> list[str]:
    """Return a sentence for every servo that replies at any baud rate on the port; only pings are sent.

    Takes about two seconds for each baud rate. clock, port: those of the machine unless a test gives its own. Raises
    DriverError where the port cannot be opened.
    """
    clock = clock or MonotonicClock()
    sentences: list[str] = []
    for baudrate in get_args(Baudrate):
        line = port or SerialPort(config.port, baudrate, clock)
        line.baudrate = baudrate
        line.openPort()
        try:
            for wire in (Wire2(), wire_1()):
                with contextlib.suppress(DriverError):
                    pinged = Bus(line, BROADCAST, clock, 0.0, wire).ping_all()
                    sentences += [
                        f"{_named(number)} answers with id {ident} at {baudrate} baud" for ident, number in pinged
                    ]
        finally:
            line.closePort()
    return sentences


def _named(number: int) -> str:
    return f"a {name_of(number)}" if number else "a servo on protocol 1.0"
