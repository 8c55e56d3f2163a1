"""A udp_multicast bus of python-can that does not return the frames which this program sent.

A CAN controller does not receive its own frames, but a multicast socket does, and python-can returns these frames. All
sockets of a group share one port, so the sender's address does not show who sent a frame. Received frames are therefore
compared with the sent ones.
"""

from __future__ import annotations

import os
import socket
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from can.interfaces.udp_multicast import UdpMulticastBus

if TYPE_CHECKING:
    import can

PORT = 43113
"""The UDP port of the multicast group, which is python-can's default."""
_OWN_GROUP = ((socket.IPPROTO_IP, 49), (socket.IPPROTO_IPV6, 29))
"""IP_MULTICAST_ALL and IPV6_MULTICAST_ALL, linux/in.h and linux/in6.h."""
_SOCKETS = (Path("/proc/net/udp"), Path("/proc/net/udp6"))
"""Where Linux lists the UDP sockets of this computer: those of IPv4 and of IPv6."""
_LIFETIME = 1.0
"""s after which a sent frame that did not come back is forgotten."""

_Key = tuple[int, bytes, int, bool, bool, bool, bool]


class OwnFrames:
    """The frames that this program sent and has not received back yet.

    If another node sends an equal frame meanwhile, that frame may be dropped instead of ours. The frame that remains is
    equal, so the result is the same.
    """

    def __init__(self) -> None:
        self._sent: list[tuple[float, _Key]] = []

    def note(self, message: can.Message, now: float) -> None:
        """Remember a frame that this program sends at `now`, s."""
        self._sent = [(at, key) for at, key in self._sent if now - at < _LIFETIME]
        self._sent.append((now, _key(message)))

    def has(self, message: can.Message, now: float) -> bool:
        """Return whether a frame received at `now`, s, was sent by this program. If so, the frame is forgotten."""
        key = _key(message)
        for place, (at, sent) in enumerate(self._sent):
            if sent == key and now - at < _LIFETIME:
                del self._sent[place]
                return True
        return False


class MulticastBus(UdpMulticastBus):
    """A bus in the multicast group `channel`. Its frames do not leave this computer."""

    def __init__(self, channel: str) -> None:
        self._own = OwnFrames()
        self._sockets = _SOCKETS[":" in channel]
        super().__init__(channel, port=PORT, hop_limit=0, fd=True)  # a hop limit of 1, the default, leaves this machine
        if sys.platform == "linux":  # whose sockets receive every group that any program of this computer has joined
            level, option = _OWN_GROUP[":" in channel]
            with socket.socket(fileno=os.dup(self.fileno())) as same:
                same.setsockopt(level, option, 0)

    def is_heard(self) -> bool:
        """Return whether another program has a bus of this kind open; True if the system does not tell."""
        try:
            sockets = self._sockets.read_text(encoding="ascii").count(f":{PORT:04X} ")
        except OSError:
            return True
        return sockets != 1

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame. Raises can.CanError."""
        self._own.note(msg, time.monotonic())
        super().send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        end = time.monotonic() + (timeout or 0.0)
        while True:
            left = None if timeout is None else max(0.0, end - time.monotonic())
            message, filtered = super()._recv_internal(left)
            if message is None or not self._own.has(message, time.monotonic()):
                return message, filtered


def _key(message: can.Message) -> _Key:
    return (
        message.arbitration_id,
        bytes(message.data),
        message.dlc,
        message.is_extended_id,
        message.is_remote_frame,
        message.is_fd,
        message.is_error_frame,
    )
