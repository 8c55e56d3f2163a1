"""Splitting of received bytes into lines of text, without I/O."""

from __future__ import annotations

LONGEST = 160
"""Longest line in characters; no protocol here has a longer one."""


class TextLines:
    """Assembles lines from received pieces, without line ends (\\n, \\r or both) and empty lines.

    A byte that is no ASCII becomes U+FFFD, so that a damaged line is one bad line and not two good ones.
    """

    def __init__(self) -> None:
        self._partial = b""

    def feed(self, data: bytes) -> list[str]:
        """Return the lines that `data` completes."""
        *whole, rest = (self._partial + data).replace(b"\r", b"\n").split(b"\n")
        if len(rest) > LONGEST:  # a line without end is a bad one too
            whole.append(rest)
            rest = b""
        self._partial = rest
        return [line.decode("ascii", "replace") for line in whole if line]

    def clear(self) -> None:
        """Discard an incomplete line."""
        self._partial = b""
