"""Open the files that a command reads: only regular files of limited size."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

from hil.errors import WrongUse
from hil.recording.posix import open_binary


def open_input(path: Path, *, largest: int) -> BufferedReader:
    """Open a regular file of at most `largest` bytes for reading.

    A FIFO or a device would block or never end. Raises WrongUse.
    """
    try:
        file = open_binary(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except (OSError, ValueError) as error:
        raise WrongUse(f"{path} cannot be read ({getattr(error, 'strerror', error)}): check the name") from None
    try:
        found = os.fstat(file)
        if not stat.S_ISREG(found.st_mode):
            raise WrongUse(f"{path} is not a file, but a folder, a pipe or a device: name an ordinary file")
        if not found.st_size:
            raise WrongUse(f"{path} is empty: check that it was written to the end, or name another file")
        if found.st_size > largest:
            raise WrongUse(
                f"{path} has {found.st_size / 1e6:.0f} MB and may have {largest / 1e6:.0f} MB: check the name"
            )
        return os.fdopen(file, "rb")
    except BaseException:
        os.close(file)
        raise


def read_text(path: Path, *, largest: int) -> str:
    """Return the text of a file in UTF-8, with or without a byte-order mark. Raises WrongUse as `open_input` does."""
    with open_input(path, largest=largest) as file:
        data = file.read()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise WrongUse(f"{path} cannot be read as text (byte {error.start} is not UTF-8): save it in UTF-8") from None


@contextmanager
def bounded_memory(size: int) -> Iterator[None]:
    """Limit the memory of this process to `size` bytes more than at present: a larger allocation raises MemoryError.

    This protects from a library that unpacks as much data as a file declares. On a system without such limits nothing
    is done.
    """
    try:
        import resource

        used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        before = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (used + size, before[1]))
    except (ImportError, OSError, ValueError):
        yield
        return
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
