"""The first run: a second process compiles the search while this one prepares the recording."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from ga.trials.ahead import is_worthwhile
from hil.child import command

_processes: Final[list[subprocess.Popen[bytes]]] = []
"""The process that compiles, while it does."""


@contextmanager
def compiled_ahead() -> Iterator[None]:
    """Start a process that compiles the search, if it is not compiled yet and there is a second core; it ends with this
    one.

    Inside another `compiled_ahead`, whose process already compiles, nothing is done.
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
