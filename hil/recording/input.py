"""Open the files that a command reads: only regular files of limited size."""

from __future__ import annotations

import gzip
import os
import stat
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from io import BufferedReader
from pathlib import Path

from hil.errors import Untrustworthy, WrongUse
from hil.printable import quoted
from hil.recording.posix import Answer, in_child, open_binary

_MEMORY, _PER_BYTE = 1 << 29, 16  # bytes that reading a file may take, and more for each of its bytes
_PROCESSOR, _PER_SECOND = 6, 250_000  # s that reading may take, and bytes of the file for each further s
_SMALL, _COMPRESSION = 1 << 26, 100  # bytes that any file may unpack to; a larger one: for each of its bytes
_GZIP, _PIECE = b"\x1f\x8b", 1 << 20
_LARGEST = 1 << 36  # bytes of a file of which no more is read than is needed
_LONGEST = 200  # characters of a library's message


def open_input(path: Path, *, largest: int) -> BufferedReader:
    """Open a regular file of at most `largest` bytes for reading.

    A FIFO or a device would block or never end. Raises WrongUse.
    """
    try:
        file = open_binary(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except (OSError, ValueError) as error:
        raise WrongUse(f"{path} cannot be read ({getattr(error, 'strerror', error)}): {missing(path)}") from None
    try:
        found = os.fstat(file)
        if not stat.S_ISREG(found.st_mode):
            raise WrongUse(f"{path} is not a file, but a folder, a pipe or a device: name an ordinary file")
        if not found.st_size:
            raise WrongUse(f"{path} is empty: check that it was written to the end, or name another file")
        if found.st_size > largest:
            raise WrongUse(
                f"{path} has {found.st_size / 1e6:.0f} MB, more than the allowed {largest / 1e6:.0f} MB: check the name"
            )
        return os.fdopen(file, "rb")
    except BaseException:
        os.close(file)
        raise


def missing(path: Path) -> str:
    """Return advice about a file that cannot be opened: if a run left its `.part` there, how to read the `.part`."""
    part = path.with_name(path.name + ".part") if path.name else path
    with suppress(OSError, ValueError):
        if part.is_file() and not path.exists():
            recover = f"hil recover {quoted(part)}"
            return f"{part} holds the rows of a run that has not ended; finish it with `{recover}`, or read it"
    return "check the name"


def read_text(path: Path, *, largest: int) -> str:
    """Return the text of a file in UTF-8, with or without a byte-order mark. Raises WrongUse if the file is too large
    or is no regular file.
    """
    with open_input(path, largest=largest) as file:
        data = file.read()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise WrongUse(f"{path} cannot be read as text (byte {error.start} is not UTF-8): save it in UTF-8") from None


def bounded(source: Path, work: Callable[[], Answer]) -> Answer:
    """Return the result of `work`, a function that reads the file or folder `source` with a library. It runs in a copy
    of this process.

    A small file may unpack to any size, and a damaged one may crash a library or keep it busy for ever. The copy has
    512 MiB of memory and 6 s of processor time, and more in proportion to the size of the file. Raises WrongUse if that
    is not enough, if the library crashes, if `work` raises any error, and for a file of gzip or zip that unpacks to 100
    times its size.
    """
    size = _size(source)
    _check_packed(source, size)
    processor, memory = _PROCESSOR + size // _PER_SECOND, _MEMORY + _PER_BYTE * size

    def read() -> Answer:
        try:
            return work()
        except (WrongUse, Untrustworthy, MemoryError):
            raise
        except Exception as error:  # noqa: BLE001 - a damaged file makes a library raise anything
            raise WrongUse(
                f"{source} is damaged, or not what its name says ({_reason(error)}): use another copy of the file, or "
                "save it as CSV"
            ) from None

    answer = None
    with suppress(MemoryError):  # where there is no copy of a process
        answer = in_child(read, processor=processor, memory=memory)
    if answer is None:
        raise WrongUse(
            f"{source} has {size / 1e6:.3g} MB, and reading it crashes, or takes more than {processor} s of processor "
            f"time or {memory >> 20} MiB of memory, so nothing was read: check the file, or save it as CSV"
        )
    return answer


def _check_packed(source: Path, size: int) -> None:
    """Raise WrongUse for a file of gzip or zip that unpacks to too many bytes. Any other or damaged file passes."""
    most = max(_SMALL, _COMPRESSION * size)
    unpacked = 0
    if source.is_dir():
        return
    with open_input(source, largest=_LARGEST) as file, suppress(OSError, EOFError, zlib.error, zipfile.BadZipFile):
        if file.peek(2).startswith(_GZIP):
            with gzip.open(file) as inside:
                while unpacked <= most and (piece := len(inside.read(_PIECE))):
                    unpacked += piece
        elif zipfile.is_zipfile(file):
            with zipfile.ZipFile(file) as archive:
                unpacked = sum(one.file_size for one in archive.infolist())
    if unpacked > most:
        raise WrongUse(
            f"{source} has {size / 1e6:.3g} MB and unpacks to more than {most / 1e6:.3g} MB, as no table of readings "
            "does, so nothing was read: check the file, or unpack it and save it as CSV"
        )


def _size(source: Path) -> int:
    with suppress(OSError):
        files = source.iterdir() if source.is_dir() else [source]
        return sum(path.stat().st_size for path in files)
    return 0


def _reason(error: Exception) -> str:
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    first = (text.splitlines() or [""])[0][:_LONGEST]
    return first if first and not isinstance(error, KeyError | AssertionError) else "it cannot be parsed"
