"""The name of an output file: the next free name, protection of existing files, and atomic writing."""

from __future__ import annotations

import errno
import os
import re
import shutil
import stat
import tempfile
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from unicodedata import category

from hil.errors import WrongUse
from hil.printable import quoted
from hil.recording.posix import is_at, lock, open_binary, remove, sync_folder, take_name

_OTHERS = frozenset(
    {
        ".csv",
        ".db3",
        ".gz",
        ".htm",
        ".html",
        ".json",
        ".mat",
        ".mcap",
        ".parquet",
        ".part",
        ".pdf",
        ".png",
        ".toml",
        ".txt",
        ".xml",
    }
)
"""Suffixes that a recording must not have: those of other formats, and that of a recording in progress."""
_RECORDING = frozenset({".h5", ".hdf5", ".hdf", ".he5"})
_READ_ONLY = frozenset({errno.EACCES, errno.EPERM, errno.EROFS})
_FULL = frozenset(os.strerror(number) for number in (errno.ENOSPC, errno.EDQUOT))
_TEMPORARY = re.compile(r"\.hil-[0-9a-f]{32}")


class NameTaken(WrongUse):
    """The error that another recording already has the name."""


def part_path(path: Path) -> Path:
    """Return the path of the recording in progress whose finished file will be `path`."""
    return path.with_name(path.name + ".part")


def next_free(folder: Path) -> Path:
    """Return the first name `runN.h5` in `folder` that no finished or unfinished recording has. Creates the folder."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        names = [path.name.removesuffix(".part") for path in folder.glob("run*.h5*")]
    numbers = [int(stem) for stem in (name[3:-3] for name in names if name.endswith(".h5")) if stem.isdecimal()]
    return folder / f"run{max(numbers, default=0) + 1}.h5"


def check_output(path: Path, *, force: bool, inputs: Sequence[Path] = ()) -> None:
    """Raise WrongUse if writing `path` would overwrite a file, or if its folder does not exist or cannot be written.

    inputs: the files that the command reads, which not even `force` overwrites. Changes nothing.
    """
    if any(category(character) == "Cc" for character in path.name):
        raise WrongUse(f"{path.name!r} has a line break or another control character in it: choose another name")
    with writing(path):
        if path.is_dir():
            raise WrongUse(f"{path} is a folder: name a file, such as {path / 'run1.h5'}")
        if not path.parent.is_dir():
            raise WrongUse(f"{path.parent} is not a folder: make it first, or name another place")
        if any(_is_same(path, given) for given in inputs):
            raise WrongUse(f"{path} is also an input: name another output")
        _check_replaceable(path, force=force)
        _check_writable(path.parent)


def check_folder(folder: Path) -> None:
    """Raise WrongUse if the output folder `folder` cannot be made, or cannot be written. Changes nothing."""
    with writing(folder):
        _check_writable(next(one for one in (folder, *folder.absolute().parents) if os.path.lexists(one)))


def _check_writable(folder: Path) -> None:
    """Raise OSError if no file can be made in `folder`. This is tried, because root's permissions, or some disks, do
    not show it.
    """
    with tempfile.TemporaryFile(dir=folder):
        pass


def check_recording_name(path: Path) -> Path:
    """Return `path` as the path of a recording. Raises WrongUse if its suffix is that of another format."""
    if path.suffix.lower() in _OTHERS:
        stem = path.with_suffix("")
        better = stem if stem.suffix == ".h5" else path.with_suffix(".h5")
        raise WrongUse(f"{path} is no name of a recording, which is HDF5: name it {better}")
    return path


def recording_path(path: Path) -> Path:
    """Return `path`, with .h5 appended if it has no suffix of a known format."""
    known = not path.name or path.suffix.lower() in _RECORDING | _OTHERS
    return path if known else path.with_name(f"{path.name}.h5")


def check_unfinished(path: Path, *, force: bool = False) -> None:
    """Raise WrongUse if there is an unfinished recording whose finished file would be `path`; with `force`, only if it
    is in progress or is another program's file. Changes nothing.
    """
    part = part_path(path)
    with writing(path):
        _refuse_foreign(part)
        check_ended(part)
        if part.exists() and not force:
            raise WrongUse(
                f"{part} is a recording that never ended: keep it with `hil recover {quoted(part)}`, choose another "
                "name with --output, or remove it with `hil record --force`"
            )


def check_ended(part: Path) -> None:
    """Raise WrongUse if the recording `part` is still in progress, because then it cannot be recovered yet."""
    with writing(part):
        _unlock(_locked_alone(part))


def _refuse_foreign(part: Path) -> None:
    from hil.recording.integrity import is_unfinished

    if part.exists() and not is_unfinished(part):
        raise WrongUse(
            f"{part} is no recording that hil began, such as a download, or it is damaged beyond recognition: hil does "
            "not remove it. Choose another name with --output, or move that file"
        )


def remove_unfinished(path: Path) -> None:
    """Remove the unfinished recording whose finished file would be `path`, if there is one. Raises WrongUse if the
    recording is in progress, or if it is another program's file.
    """
    part = part_path(path)
    with writing(path):
        _refuse_foreign(part)
        file = _locked_alone(part)
        if file is not None and is_at(file, part):
            remove(file, part)
        else:
            _unlock(file)


def _locked_alone(part: Path) -> int | None:
    """Open and lock the file `part`, and return its descriptor; None if the file does not exist. Raises WrongUse if
    another process has locked it.
    """
    try:
        file = open_binary(part, os.O_RDWR)
    except FileNotFoundError:
        return None
    except OSError as error:
        if error.errno not in _READ_ONLY:
            raise
        file = open_binary(part, os.O_RDONLY)
    try:
        lock(file, shared=False)
    except BlockingIOError:
        os.close(file)
        raise WrongUse(
            f"{part} is being recorded or read at this moment: wait for it, or choose another name with --output"
        ) from None
    except OSError:
        pass  # the filesystem knows no locks, so nobody can have one
    return file


def _unlock(file: int | None) -> None:
    if file is not None:
        os.close(file)


def check_space(path: Path, size: int) -> None:
    """Raise WrongUse if fewer than `size` bytes are free in the folder of `path`.

    HDF5 ends in a segmentation fault when a disk becomes full, so the space is checked before HDF5 writes.
    """
    free = shutil.disk_usage(path.parent).free
    if free < size:
        raise WrongUse(
            f"{path} needs up to {size / 1e6:.1f} MB while it is made and the disk has {free / 1e6:.1f} MB free: "
            "make room, or name another folder"
        )


def new_temporary(path: Path) -> tuple[int, Path]:
    """Create a file with an unpredictable name in the folder of `path`; return its descriptor and its path. The file is
    locked while it is open.

    The name has the last suffixes of `path`. Temporary files of killed processes in the folder are removed.
    """
    _remove_abandoned(path.parent)
    while True:
        temporary = path.with_name(f".hil-{uuid.uuid4().hex}{''.join(path.suffixes[-2:])}")
        file = open_binary(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR)
        try:
            lock(file, shared=True)  # as HDF5 does when it reads: watching stays possible
        except BlockingIOError:
            pass  # another process takes it for abandoned and removes it
        except OSError:
            return file, temporary  # the filesystem knows no locks, and nobody removes anything there
        else:
            if is_at(file, temporary):
                return file, temporary
        os.close(file)


def _remove_abandoned(folder: Path) -> None:
    """Remove the temporary files of processes that have ended: nobody holds their lock."""
    for path in [path for path in folder.iterdir() if _TEMPORARY.match(path.name)]:
        with suppress(OSError):  # another process may remove it too, or may be using it
            file = open_binary(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
            try:
                lock(file, shared=False)
                if stat.S_ISREG(os.fstat(file).st_mode) and is_at(file, path):
                    path.unlink()
            finally:
                os.close(file)


@contextmanager
def atomic_write(path: Path, *, force: bool) -> Iterator[Path]:
    """Yield the path of a new file in the folder of `path`. After the block, the new file is renamed to `path`, so that
    a result appears complete or not at all.

    The new file is locked until then. force: whether an existing regular file at `path` is replaced; anything else is
    never replaced. Raises WrongUse if the file may not be replaced, or if `path` cannot be written.
    """
    with writing(path):
        locked, temporary = new_temporary(path)
        try:
            yield temporary
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            _check_replaceable(path, force=force)
            locked = take_name(locked, temporary, path, replace=force)
        except FileExistsError:
            raise WrongUse(_exists(path)) from None
        finally:
            os.close(locked)
            with suppress(OSError):
                temporary.unlink()
        sync_folder(path.parent)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Convert an OSError in the block, which means that an output cannot be written, to a WrongUse."""
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:  # HDF5 reports a full disk as any of the three
        reason = _reason(error)
        room = "make room, or " if reason in _FULL else ""
        raise WrongUse(f"{path} cannot be written ({reason}): {room}name another folder") from error


def _check_replaceable(path: Path, *, force: bool) -> None:
    """Raise WrongUse if there is a file at `path`; with `force`, only if that file is not regular."""
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not force:
        raise WrongUse(_exists(path))
    if not stat.S_ISREG(mode):
        raise WrongUse(f"{path} is a link or a device, which is never overwritten: name an ordinary file")


def _exists(path: Path) -> str:
    return f"{path} exists: choose another name, or overwrite it with --force"


def _is_same(path: Path, other: Path) -> bool:
    with suppress(OSError):
        return path.samefile(other)
    return path.absolute() == other.absolute()


def _reason(error: Exception) -> str:
    """Return the system's error text from an error that HDF5 has wrapped."""
    number = getattr(error, "errno", None)
    if number:
        return os.strerror(number)
    inner = re.search(r"error message = '([^']+)'", str(error))
    return inner[1] if inner else str(error).splitlines()[0]
