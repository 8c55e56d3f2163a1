"""Commander's print functions: what is said in each verbose mode.

Source: Arduino-FOC, the lower half of src/communication/Commander.cpp.
"""

from __future__ import annotations

import numpy as np

NOTHING, ON_REQUEST, FRIENDLY, MACHINE = range(4)


class Printer:
    """The text that is printed until it is taken. decimals: of every number."""

    def __init__(self) -> None:
        self.verbose = FRIENDLY
        self.decimals = 3
        self._said: list[str] = []

    def taken(self) -> str:
        """Return the text printed since this was last called."""
        text = "".join(self._said)
        self._said.clear()
        return text

    def say(self, text: str | float) -> None:
        """Print text or a number; a whole number (int) has no decimals."""
        if self.verbose != NOTHING:
            self._said.append(f"{np.float32(text):.{self.decimals}f}" if isinstance(text, float) else str(text))

    def line(self, text: str | float = "") -> None:
        """Print text or a number, and end the line."""
        self.say(text)
        self.say("\r\n")

    def friendly(self, text: str) -> None:
        """Print `text` in the friendly mode only."""
        if self.verbose == FRIENDLY:
            self.say(text)

    def machine(self, text: str) -> None:
        """Print `text` in the machine readable mode only."""
        if self.verbose == MACHINE:
            self.say(text)

    def error(self) -> None:
        """Print that a command is not known."""
        self.line("err")

    def ends(self, character: str) -> bool:
        """Return whether `character` ends a command. Every look at a CR prints a warning in the friendly mode."""
        if character == "\r":
            self.friendly("Warn: \\r detected! \n")
        return character in "\n\r"
