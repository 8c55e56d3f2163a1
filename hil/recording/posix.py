"""What only POSIX has, each with what does the same elsewhere."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

if sys.platform == "win32":
    import msvcrt

    _FAR = 1 << 62  # a byte no file has: locking it keeps nobody from reading

    def write_at(file: int, data: bytes, offset: int) -> int:
        """Write `data` at `offset` of an open file; the number of bytes written. One writer only."""
        os.lseek(file, offset, os.SEEK_SET)
        return os.write(file, data)

    def hold(file: int) -> None:
        """Mark an open file as in use until it is closed. Raises BlockingIOError where somebody else has."""
        os.lseek(file, _FAR, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(*error.args) from None

    def claim(file: int) -> None:
        """Take an open file for oneself. Raises BlockingIOError where somebody holds it."""
        hold(file)

    def remove(file: int, path: Path) -> None:
        """Close the open file at `path` and remove it."""
        os.close(file)
        path.unlink()

    def sync_folder(folder: Path) -> None:
        """Make a new name in `folder` durable: the system does so by itself."""

else:
    import fcntl

    def write_at(file: int, data: bytes, offset: int) -> int:
        """Write `data` at `offset` of an open file; the number of bytes written."""
        return os.pwrite(file, data, offset)

    def hold(file: int) -> None:
        """Mark an open file as in use until it is closed. Raises BlockingIOError where somebody claims it."""
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)  # shared, as HDF5's own when it reads: watching stays possible

    def claim(file: int) -> None:
        """Take an open file for oneself. Raises BlockingIOError where somebody holds it."""
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def remove(file: int, path: Path) -> None:
        """Close the open file at `path` and remove it, with nobody in between."""
        try:
            path.unlink()
        finally:
            os.close(file)

    def sync_folder(folder: Path) -> None:
        """Make a new name in `folder` durable."""
        opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


def is_at(file: int, path: Path) -> bool:
    """Whether `path` is still the open file."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(file), path.stat())
    return False


def open_binary(path: Path, flags: int) -> int:
    """Open a file for bytes as they are."""
    return os.open(path, flags | getattr(os, "O_BINARY", 0), 0o666)
