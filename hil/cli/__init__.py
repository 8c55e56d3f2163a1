"""The command line: the only package that prints, reads from the terminal, or exits."""

from __future__ import annotations

import os
import signal
from types import FrameType
from typing import NoReturn


def main() -> NoReturn:
    """Load the command line and run it. Ctrl-C ends the program with one line, also while it loads."""
    before = signal.signal(signal.SIGINT, _interrupted)
    from hil.cli import app

    signal.signal(signal.SIGINT, before)
    app.main()


def _interrupted(_number: int, _frame: FrameType | None) -> NoReturn:
    """End at once: some modules turn an exception in their import into another one."""
    os.write(2, b"interrupted\n")
    os._exit(130)
