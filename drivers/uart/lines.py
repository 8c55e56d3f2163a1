"""Bytes of a serial line, cut into lines of text; no I/O."""

from __future__ import annotations

LONGEST = 160
"""Characters that a line may have; what is longer is no line of any protocol here."""


class TextLines:
    """Puts lines together from whatever pieces they come in, without their ends (\\n, \\r or both) and empty lines.

    What is no ASCII stays in as U+FFFD, so that a damaged line is a bad line and not two good ones.
    """

    def __init__(self) -> None:
        self._partial = b""

    def feed(self, data: bytes) -> list[str]:
        """The lines that `data` completes."""
        *whole, rest = (self._partial + data).replace(b"\r", b"\n").split(b"\n")
        if len(rest) > LONGEST:  # a line that never ends is a bad one too
            whole.append(rest)
            rest = b""
        self._partial = rest
        return [line.decode("ascii", "replace") for line in whole if line]

    def clear(self) -> None:
        """Forget the beginning of a line."""
        self._partial = b""
