"""Frames on a CAN bus as an emulated drive receives and sends them, and their durations on the wire.

Sources: ISO 11898-1 for the lengths; include/uapi/linux/can/error.h for error frames, which have the format that Linux
hands to a program.
"""

from __future__ import annotations

from dataclasses import dataclass

PROTOCOL_ERROR = 0x008
BUS_OFF = 0x040
"""Classes of error frames, as Linux writes them in the place of the identifier."""

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One frame. extended: whether the identifier has 29 bits. remote: whether it requests data. fast: whether the
    second bit rate of CAN FD is used.
    """

    ident: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    fd: bool = False
    fast: bool = False
    error: bool = False


def error_frame(kind: int) -> CanFrame:
    """Return the error frame of `kind`: `PROTOCOL_ERROR` or `BUS_OFF`."""
    return CanFrame(kind, bytes(8), error=True)


def padded(data: bytes, filler: int = 0x50) -> bytes:
    """Return `data` padded with the byte `filler` to the next length that CAN FD has."""
    length = next(size for size in FD_LENGTHS if size >= len(data))
    return data + bytes([filler]) * (length - len(data))


def duration(frame: CanFrame, bitrate: float, data_bitrate: float) -> float:
    """Return the time, s, that a frame takes on the wire, with the largest possible number of stuff bits, up to the
    first bit of the next frame.
    """
    size = 0 if frame.remote else len(frame.data)
    if not frame.fd:
        stuffed = (54 if frame.extended else 34) + 8 * size
        return (stuffed + (stuffed - 1) // 4 + 13) / bitrate
    arbitration = (50 if frame.extended else 29) * 1.25 + 12.0
    checksum = 21 if size > 16 else 17
    fast = (5 + 8 * size) * 1.25 + 1.25 * checksum + 5.0
    return arbitration / bitrate + fast / (data_bitrate if frame.fast else bitrate)
