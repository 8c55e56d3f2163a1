"""Encode CAN frames as bytes, so that another process can send them to the CAN interface (`drivers.off_path`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import can

if TYPE_CHECKING:
    from collections.abc import Iterable

_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)

Encode = Callable[[can.Message], bytes]


def slcan_text(message: can.Message) -> bytes:
    """Return the text with which a serial CAN adapter (slcan) sends the frame, with the line end."""
    letter = ("b" if message.bitrate_switch else "d") if message.is_fd else "r" if message.is_remote_frame else "t"
    head = (
        f"{letter.upper()}{message.arbitration_id:08X}"
        if message.is_extended_id
        else f"{letter}{message.arbitration_id:03X}"
    )
    data = "" if message.is_remote_frame else message.data.hex().upper()
    return f"{head}{_LENGTHS.index(message.dlc):X}{data}\r".encode("ascii")


def from_slcan_text(text: bytes) -> can.Message:
    """Decode the text that `slcan_text` returns to a frame."""
    letter = chr(text[0])
    end = 9 if letter.isupper() else 4
    return can.Message(
        arbitration_id=int(text[1:end], 16),
        is_extended_id=letter.isupper(),
        is_remote_frame=letter in "rR",
        is_fd=letter in "dDbB",
        bitrate_switch=letter in "bB",
        data=bytes.fromhex(text[end + 1 :].decode("ascii")),
    )


def socketcan_bytes(message: can.Message) -> bytes:
    """Return the bytes that a SocketCAN socket of Linux takes for the frame."""
    from can.interfaces.socketcan.socketcan import build_can_frame

    return bytes(build_can_frame(message))


def datagram(message: can.Message) -> bytes:
    """Return the datagram in which python-can's udp_multicast sends the frame."""
    from can.interfaces.udp_multicast.utils import pack_message

    return bytes(pack_message(message))


def encoded(messages: Iterable[can.Message], encode: Encode) -> tuple[bytes, ...]:
    """Return each frame as bytes, encoded by the function `encode`."""
    return tuple(encode(message) for message in messages)
