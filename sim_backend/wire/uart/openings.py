"""Wake up a `select` when a program opens or closes a file, with Linux's inotify, which Python's library does not
offer.
"""

from __future__ import annotations

import contextlib
import ctypes
import os

_OPEN, _CLOSED_AFTER_WRITING, _CLOSED = 0x20, 0x08, 0x10
"""Events of inotify(7)."""


class Openings:
    """Watches the file `path` for being opened or closed.

    files: file descriptors for `select`, readable after such an event; empty if the system has no inotify.
    """

    def __init__(self, path: str) -> None:
        self.files: list[int] = []
        with contextlib.suppress(OSError, AttributeError):
            system = ctypes.CDLL(None, use_errno=True)
            descriptor = system.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
            if descriptor >= 0:
                self.files = [descriptor]
                if system.inotify_add_watch(descriptor, os.fsencode(path), _OPEN | _CLOSED_AFTER_WRITING | _CLOSED) < 0:
                    self.close()

    def seen(self) -> bool:
        """Return whether the file was opened or closed since the last call."""
        try:
            return any(os.read(file, 65536) for file in self.files)
        except BlockingIOError:
            return False

    def close(self) -> None:
        """Stop watching."""
        for file in self.files:
            os.close(file)
        self.files = []
