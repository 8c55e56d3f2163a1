"""Split received bytes into lines of text. No I/O."""

from __future__ import annotations

LONGEST = 160
"""Longest line in characters; no protocol here has a longer one."""


class TextLines:
    r"""Assembles lines from received bytes. Line ends (\n, \r or both) are removed and empty lines are dropped.

    A byte that is no ASCII becomes U+FFFD, so that a damaged line stays one bad line and does not become two good
    lines.
    """

    def __init__(self) -> None:
        self._partial = b""

    def feed(self, data: bytes) -> list[str]:
        """Add received bytes and return the lines that are now complete."""
        *whole, rest = (self._partial + data).replace(b"\r", b"\n").split(b"\n")
        if len(rest) > LONGEST:  # a line without end is a bad one too
            whole.append(rest)
            rest = b""
        self._partial = rest
        return [line.decode("ascii", "replace") for line in whole if line]

    def clear(self) -> None:
        """Discard an incomplete line."""
        self._partial = b""
