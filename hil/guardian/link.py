"""The guardian's access to the link: a descriptor inherited from the guarded process, or a bus opened a second time."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import time
from collections.abc import Callable
from typing import Any

_PATIENCE = 0.05  # s for one packet that the link does not accept

Send = Callable[[bytes], None]
"""A function that sends one complete packet. Raises OSError if the packet cannot be sent."""


def opened(way: dict[str, Any]) -> Send:
    """Return a function that sends over the link that `way` describes. way: the fields of `drivers.off_path.OffPath`.

    Raises OSError if the bus cannot be opened a second time.
    """
    if way["bus"] is not None:
        from drivers.canbus.link import sender

        return sender(way["bus"])
    if way["to"] is not None:
        datagrams = socket.socket(fileno=way["descriptor"])
        address = (way["to"][0], way["to"][1])
        return lambda packet: _check(datagrams.sendto(packet, address), packet)
    return lambda packet: _write(way["descriptor"], packet)


def discard_unsent(descriptor: int) -> None:
    """Discard the bytes that the guarded process wrote to a serial port and that the port has not sent yet."""
    with contextlib.suppress(ImportError, OSError):
        import termios

        with contextlib.suppress(termios.error):
            termios.tcflush(descriptor, termios.TCOFLUSH)


def _check(sent: int, packet: bytes) -> None:
    if sent != len(packet):
        raise OSError("the link accepted a part of a packet")


def _write(descriptor: int, packet: bytes) -> None:
    end = time.monotonic() + _PATIENCE
    while packet:
        try:
            packet = packet[os.write(descriptor, packet) :]
        except BlockingIOError:
            left = end - time.monotonic()
            if left <= 0.0 or not select.select([], [descriptor], [], left)[1]:
                raise
