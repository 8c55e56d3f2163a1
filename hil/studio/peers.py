"""The connections to the page that have not shown its key: few, for a short time, and of this user only.

So another user of the computer cannot use up the connections that a page needs for STOP.
"""

from __future__ import annotations

import asyncio
import os
import socket
import struct
from contextlib import suppress
from typing import Any, Final

_MOST: Final = 256  # connections that wait; one more ends the oldest
_PATIENCE: Final = 10.0  # s until the key must have come
_DIAGNOSIS: Final = 4  # the netlink family that describes sockets
_BY_FAMILY: Final = 20  # its request, and the type of its answer
_USER: Final = 80  # the place of the user id in the answer

Address = tuple[str, int]


class Strangers:
    """The connections that have not shown the key."""

    def __init__(self) -> None:
        self._waiting: dict[Address, asyncio.BaseTransport] = {}

    def add(self, transport: asyncio.Transport) -> None:
        """Take in a new connection, or end it if it is another user's. It ends after a time, or as the oldest of many.

        root is let in: the relay of a virtual machine runs as root, and nothing keeps root out.
        """
        peer = transport.get_extra_info("peername")
        if user_of(peer, transport.get_extra_info("sockname")) not in {None, 0, _our_user()}:
            transport.abort()
            return
        self._waiting[peer] = transport
        if len(self._waiting) > _MOST:
            self._end(*next(iter(self._waiting.items())))
        asyncio.get_running_loop().call_later(_PATIENCE, self._end, peer, transport)

    def remove(self, peer: Any) -> None:
        """Forget a connection that has shown the key or has ended. peer: its address."""
        self._waiting.pop(peer, None)

    def _end(self, peer: Address, transport: asyncio.BaseTransport) -> None:
        if self._waiting.get(peer) is transport:  # not a later one from the same port
            del self._waiting[peer]
            transport.abort()  # type: ignore[attr-defined]


def user_of(peer: Address, here: Address) -> int | None:
    """Return the user id of the program at the other end of a TCP connection within this computer; None where the
    system does not tell.

    peer: address of the other end. here: address of our end.
    """
    with suppress(OSError, AttributeError, struct.error):
        ends = struct.pack("!HH16s16s", peer[1], here[1], socket.inet_aton(peer[0]), socket.inet_aton(here[0]))
        asked = struct.pack("=BBBxI", socket.AF_INET, socket.IPPROTO_TCP, 0, 0xFFFFFFFF) + ends
        asked += struct.pack("=IQ", 0, 2**64 - 1)
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _DIAGNOSIS) as kernel:
            kernel.setblocking(False)
            kernel.send(struct.pack("=IHHII", 16 + len(asked), _BY_FAMILY, 1, 0, 0) + asked)
            answer = kernel.recv(4096)
        if struct.unpack_from("=H", answer, 4)[0] == _BY_FAMILY:
            return int(struct.unpack_from("=I", answer, _USER)[0])
    return None


def _our_user() -> int | None:
    return os.getuid() if hasattr(os, "getuid") else None
