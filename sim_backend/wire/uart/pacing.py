"""The bytes of a reply as they reach the host: one after the other on the line, in pieces from the adapter."""

from __future__ import annotations

from collections.abc import Iterable


def paced(parts: Iterable[tuple[float, bytes]], byte: float, held: float) -> list[tuple[float, bytes]]:
    """Return `parts`, each with the time at which its last byte has left the device, s, as pieces with their arrival.

    byte: s that one takes on the line. held: s for which the adapter holds received bytes back; it hands them over in
    pieces, each `held` after its last byte. With `byte` 0 a part arrives whole.
    """
    out: list[tuple[float, bytes]] = []
    for end, data in parts:
        size = int(held / byte) + 1 if byte > 0.0 else max(1, len(data))
        for at in range(0, len(data), size):
            piece = data[at : at + size]
            out.append((end - byte * (len(data) - at - len(piece)) + held, piece))
    return out
