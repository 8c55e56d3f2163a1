"""python-can's udp_multicast without the frames that this program sent itself.

A CAN controller does not receive its own frames, but a multicast socket does, and python-can hands them on. All sockets
of the group share one port, so that the sender's address does not distinguish them: frames are compared.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from can.interfaces.udp_multicast import UdpMulticastBus

if TYPE_CHECKING:
    import can

PORT = 43113
"""The port of the group: python-can's own."""
_LIFETIME = 1.0
"""s after which a frame that did not come back is forgotten."""

_Key = tuple[int, bytes, int, bool, bool, bool, bool]


class OwnFrames:
    """The frames that were sent and have not come back yet.

    Where another node sends an equal frame meanwhile, either may be taken for the own one: what remains is equal.
    """

    def __init__(self) -> None:
        self._sent: list[tuple[float, _Key]] = []

    def note(self, message: can.Message, now: float) -> None:
        """Note a frame that is sent at `now`, s."""
        self._sent = [(at, key) for at, key in self._sent if now - at < _LIFETIME]
        self._sent.append((now, _key(message)))

    def has(self, message: can.Message, now: float) -> bool:
        """Return whether a frame received at `now`, s, is one of them, which is forgotten then."""
        key = _key(message)
        for place, (at, sent) in enumerate(self._sent):
            if sent == key and now - at < _LIFETIME:
                del self._sent[place]
                return True
        return False


class MulticastBus(UdpMulticastBus):
    """A bus in the multicast group `channel` that stays on this machine."""

    def __init__(self, channel: str) -> None:
        self._own = OwnFrames()
        super().__init__(channel, port=PORT, hop_limit=0, fd=True)  # a hop limit of 1, the default, leaves this machine

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
