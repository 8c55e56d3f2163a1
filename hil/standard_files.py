"""Keep the file descriptors 0, 1 and 2 for standard input, output and error, also where somebody has closed them."""

from __future__ import annotations

import os
import sys


def open_standard_files() -> None:
    """Open the null device for each of the descriptors 0, 1 and 2 that is closed.

    The system gives a new port, pipe or recording the lowest free descriptor. With 0, 1 or 2 the guardian could not
    inherit the port, because these three are replaced in a child process, and messages could go to the drive or into
    the recording. Called when hil is imported, and again before a servo is opened: a program may close them in between.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # takes the lowest descriptor that is free
        stream = getattr(sys, name)
        if stream is None or getattr(stream, "closed", False):
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115 - stays open
