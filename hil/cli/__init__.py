"""The command line: the only package that prints, reads from the terminal, or exits."""

from __future__ import annotations

import os
import signal
from types import FrameType
from typing import NoReturn


def main() -> NoReturn:
    """Load the command line and run it. Ctrl-C ends the program with one line, also while it loads."""
    before = signal.signal(signal.SIGINT, _interrupted)
    try:
        from hil.cli import app
    except Exception as error:  # noqa: BLE001 - an incomplete installation raises anything
        os.write(2, f"hil: {error}\nhil cannot be loaded: close other programs, or install hil again\n".encode())
        os._exit(70)

    signal.signal(signal.SIGINT, before)
    app.main()


def _interrupted(_number: int, _frame: FrameType | None) -> NoReturn:
    """End at once: some modules turn an exception in their import into another one."""
    os.write(2, b"interrupted\n")
    os._exit(130)
