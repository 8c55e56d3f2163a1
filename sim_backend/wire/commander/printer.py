"""Commander's print functions: the text that is printed in each verbose mode.

Source: Arduino-FOC, the lower half of src/communication/Commander.cpp.
"""

from __future__ import annotations

import numpy as np

NOTHING, ON_REQUEST, FRIENDLY, MACHINE = range(4)


class Printer:
    """Collects the printed text until `taken` returns it. decimals: number of decimals of every number."""

    def __init__(self) -> None:
        self.verbose = FRIENDLY
        self.decimals = 3
        self._said: list[str] = []

    def taken(self) -> str:
        """Return the text printed since the last call."""
        text = "".join(self._said)
        self._said.clear()
        return text

    def say(self, text: str | float) -> None:
        """Print text or a number. An int is printed without decimals."""
        if self.verbose != NOTHING:
            self._said.append(f"{np.float32(text):.{self.decimals}f}" if isinstance(text, float) else str(text))

    def line(self, text: str | float = "") -> None:
        """Print text or a number, and end the line."""
        self.say(text)
        self.say("\r\n")

    def friendly(self, text: str) -> None:
        """Print `text` only in the user-friendly mode."""
        if self.verbose == FRIENDLY:
            self.say(text)

    def machine(self, text: str) -> None:
        """Print `text` only in the machine readable mode."""
        if self.verbose == MACHINE:
            self.say(text)

    def error(self) -> None:
        """Print that a command is unknown."""
        self.line("err")

    def ends(self, character: str) -> bool:
        """Return whether `character` ends a command. In the user-friendly mode every test of a CR prints a warning."""
        if character == "\r":
            self.friendly("Warn: \\r detected! \n")
        return character in "\n\r"
