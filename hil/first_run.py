"""The first run: the search is compiled by a second process while this one prepares the recording."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from ga.trials.ahead import is_worthwhile
from hil.child import command


@contextmanager
def compiled_ahead() -> Iterator[None]:
    """Let a process compile the search where it is not compiled yet and there is a second core; it ends with this."""
    process = None
    if (os.cpu_count() or 1) > 1 and is_worthwhile():
        with suppress(OSError):  # without it the search is compiled when it is needed
            process = subprocess.Popen(  # noqa: S603 - our own module
                command("ga.trials.ahead"),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
    try:
        yield
    finally:
        if process is not None:
            process.kill()
            process.wait()
