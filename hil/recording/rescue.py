"""Save the rows of a recording whose file was removed, renamed or replaced, or whose folder became read-only."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path

from hil.errors import WrongUse
from hil.recording.output import new_temporary, part_path
from hil.recording.posix import sync_folder, take_name

_BLOCK = 1 << 20  # bytes copied at a time


def rescue(file: int, final: Path) -> tuple[int, Path]:
    """Copy an open `.part` that has no name any more to a new file. Return the descriptor of the copy, open and locked,
    and its path.

    final: the planned path of the finished file. The copy is put in the folder of `final`; if that fails, in the
    working directory, the home folder or the system's temporary folder. Raises WrongUse if the copy fits in none of
    these.
    """
    reasons = []
    for folder in _folders(final):
        try:
            return _copy(file, folder / final.name)
        except OSError as error:
            reasons.append(f"{folder}: {error.strerror or error}")
    raise WrongUse(
        f"{part_path(final)} was removed or replaced while it was recorded, and its rows could not be copied to "
        f"another place ({'; '.join(reasons)})"
    )


def place_for(final: Path) -> Path:
    """Return the path of a recovered file: `final`, or its name in the working directory, the home folder or the
    system's temporary folder, if the folder of `final` cannot be written.
    """
    folders = (folder for folder in _folders(final) if os.access(folder, os.W_OK | os.X_OK))
    return next(folders, final.parent) / final.name


def _folders(final: Path) -> Iterator[Path]:
    yield final.parent
    for folder in (Path.cwd, Path.home, lambda: Path(tempfile.gettempdir())):
        with suppress(OSError, RuntimeError):  # a working directory that is gone, an unknown home
            yield folder()


def _copy(file: int, final: Path) -> tuple[int, Path]:
    copy, temporary = new_temporary(part_path(final))
    try:
        os.lseek(file, 0, os.SEEK_SET)
        with open(copy, "wb", closefd=False) as target:
            while data := os.read(file, _BLOCK):
                target.write(data)
        os.fsync(copy)
        for path in _names(part_path(final)):
            with suppress(FileExistsError):
                copy = take_name(copy, temporary, path, replace=False)
                sync_folder(path.parent)
                return copy, path
        raise AssertionError("there are names without end")
    except BaseException:
        os.close(copy)
        raise
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


def _names(part: Path) -> Iterator[Path]:
    """Yield names for the copied `.part` whose finished file does not exist: the old name, a-rescued.h5.part,
    a-rescued2.h5.part and so on.
    """
    stem, dot, rest = part.name.partition(".")
    for number in count():
        name = f"{stem}-rescued{number if number > 1 else ''}{dot}{rest}" if number else part.name
        if not os.path.lexists(part.with_name(name).with_suffix("")):
            yield part.with_name(name)
