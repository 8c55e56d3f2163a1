"""The first run: a second process compiles the search of hil identify while this process prepares the recording."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from ga.trials.ahead import is_worthwhile
from hil.child import command

_processes: Final[list[subprocess.Popen[bytes]]] = []
"""The running process that compiles, as a list of one element; an empty list if no process compiles."""


@contextmanager
def compiled_ahead() -> Iterator[None]:
    """While the block runs, compile the search in a second process, which is ended with the block.

    No process is started if the search is compiled already, or if the computer has one core. Inside another
    `compiled_ahead`, whose process compiles already, nothing is done.
    """
    process = None
    if not _processes and (os.cpu_count() or 1) > 1 and is_worthwhile():
        with suppress(OSError):  # without it the search is compiled when it is needed
            process = subprocess.Popen(  # noqa: S603 - our own module
                command("ga.trials.ahead"),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            _processes.append(process)
    try:
        yield
    finally:
        if process is not None:
            process.kill()
            process.wait()
            _processes.remove(process)
