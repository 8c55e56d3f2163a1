"""File operations that only POSIX has, each with its equivalent elsewhere."""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress
from pathlib import Path

if sys.platform == "win32":
    import msvcrt

    _FAR = 1 << 62  # a byte that no file has: locking it keeps nobody from reading

    def write_at(file: int, data: bytes, offset: int) -> int:
        """Write `data` at `offset` of an open file; the number of bytes written. One writer only."""
        os.lseek(file, offset, os.SEEK_SET)
        return os.write(file, data)

    def lock(file: int, *, shared: bool) -> None:
        """Lock an open file until it is closed. Raises BlockingIOError where somebody else has locked it."""
        del shared  # there is one kind of lock only
        os.lseek(file, _FAR, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(*error.args) from None

    def remove(file: int, path: Path) -> None:
        """Close the open file at `path` and remove it."""
        os.close(file)
        path.unlink()

    def rename_new(source: Path, path: Path) -> None:
        """Rename a file. Raises FileExistsError where the new name is taken."""
        source.rename(path)

    def sync_folder(folder: Path) -> None:
        """Make a new name in `folder` durable: the system does so by itself."""

else:
    import fcntl

    def write_at(file: int, data: bytes, offset: int) -> int:
        """Write `data` at `offset` of an open file; the number of bytes written."""
        return os.pwrite(file, data, offset)

    def lock(file: int, *, shared: bool) -> None:
        """Lock an open file until it is closed, shared with HDF5's readers or for oneself alone.

        Raises BlockingIOError where somebody else has a lock that does not allow it.
        """
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)

    def remove(file: int, path: Path) -> None:
        """Close the open file at `path` and remove it, with nobody in between."""
        try:
            path.unlink()
        finally:
            os.close(file)

    def rename_new(source: Path, path: Path) -> None:
        """Rename a file. Raises FileExistsError where the new name is taken."""
        try:
            os.link(source, path)
        except FileExistsError:
            raise
        except OSError:  # a filesystem without hard links
            if os.path.lexists(path):
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST)) from None
            source.rename(path)
        else:
            source.unlink()

    def sync_folder(folder: Path) -> None:
        """Make a new name in `folder` durable."""
        opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


def is_at(file: int, path: Path) -> bool:
    """Return whether `path` is still the open file."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(file), path.stat())
    return False


def open_binary(path: Path, flags: int) -> int:
    """Open a file for bytes as they are."""
    return os.open(path, flags | getattr(os, "O_BINARY", 0), 0o666)
