"""Compute when the bytes of a reply reach the host: they are sent one after the other, and the adapter passes them on
in pieces.
"""

from __future__ import annotations

from collections.abc import Iterable


def paced(parts: Iterable[tuple[float, bytes]], byte: float, held: float) -> list[tuple[float, bytes]]:
    """Split each part into the pieces that reach the host, and return the pieces with their times of arrival, s.

    parts: (time, bytes); the time, s, is when the last byte has left the device. byte: s that one byte takes on the
    line; with 0 a part arrives whole. held: s that the adapter holds received bytes back: it passes on a piece `held`
    after the last byte of that piece.
    """
    out: list[tuple[float, bytes]] = []
    for end, data in parts:
        size = int(held / byte) + 1 if byte > 0.0 else max(1, len(data))
        for at in range(0, len(data), size):
            piece = data[at : at + size]
            out.append((end - byte * (len(data) - at - len(piece)) + held, piece))
    return out
