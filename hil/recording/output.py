"""Where a file goes: the next free name, what must not be overwritten, and how a name is taken."""

from __future__ import annotations

import os
import re
import shutil
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from hil.errors import WrongUse
from hil.recording.posix import claim, is_at, open_binary, remove, sync_folder


class Taken(WrongUse):
    """Another recording has the name."""


def part_path(path: Path) -> Path:
    """Where the recording that will be `path` lives while it is made."""
    return path.with_name(path.name + ".part")


def next_free(folder: Path) -> Path:
    """The next `runN.h5` of `folder` that no finished or unfinished recording has. Makes the folder."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        taken = [name.name.removesuffix(".part") for name in folder.glob("run*.h5*")]
    numbers = [int(stem) for stem in (name[3:-3] for name in taken if name.endswith(".h5")) if stem.isdecimal()]
    return folder / f"run{max(numbers, default=0) + 1}.h5"


def check_target(path: Path, *, force: bool, inputs: Sequence[Path] = ()) -> None:
    """Raise WrongUse where writing `path` would overwrite something, or where there is no folder for it.

    inputs: what the command reads, which not even `force` overwrites. Only looks.
    """
    with writing(path):
        if path.is_dir():
            raise WrongUse(f"{path} is a folder: name a file, such as {path / 'run1.h5'}")
        if not path.parent.is_dir():
            raise WrongUse(f"{path.parent} is not a folder: make it first, or name another output with -o")
        if any(_is_same(path, given) for given in inputs):
            raise WrongUse(f"{path} is also what is read: name another output")
        if path.exists() and not force:
            raise WrongUse(f"{path} exists: choose another name with -o, or overwrite it with --force")


def check_part(path: Path) -> None:
    """Raise WrongUse where there is an unfinished recording that would become `path`. Only looks."""
    part = part_path(path)
    with writing(path):
        if part.exists():
            raise WrongUse(
                f"{part} is a recording that never ended: keep it with `hil recover {part}`, choose another name with "
                "-o, or give it up with `hil record --force`"
            )


def give_up(path: Path) -> None:
    """Remove the unfinished recording that would become `path`, where there is one. Raises WrongUse for a live one."""
    part = part_path(path)
    with writing(path):
        try:
            file = open_binary(part, os.O_RDWR)
        except FileNotFoundError:
            return
        try:
            claim(file)
        except BlockingIOError:
            os.close(file)
            raise WrongUse(
                f"{part} is being recorded or read at this moment: wait for it, or choose another name with -o"
            ) from None
        except OSError:
            pass  # the filesystem knows no locks, so nobody can hold one
        if is_at(file, part):
            remove(file, part)
        else:
            os.close(file)


def check_space(path: Path, size: int) -> None:
    """Raise WrongUse where fewer than `size` bytes are free beside `path`.

    HDF5 does not survive a disk that fills up under it (it ends in a segmentation fault), so it is never let near one.
    """
    free = shutil.disk_usage(path.parent).free
    if free < size:
        raise WrongUse(
            f"{path} needs up to {size / 1e6:.1f} MB while it is made and the disk has {free / 1e6:.1f} MB free: "
            "make room, or choose another folder with -o"
        )


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """A name beside `target` to write to, which then takes its place: it appears whole or not at all.

    Raises WrongUse where that cannot be done.
    """
    temporary = target.with_name(f".hil-{uuid.uuid4().hex}.tmp")
    with writing(target):
        try:
            yield temporary
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            temporary.replace(target)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise
        sync_folder(target.parent)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what the operating system says of a target that cannot be written into a WrongUse."""
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:  # HDF5 reports a full disk as any of the three
        raise WrongUse(f"{path} cannot be written ({_reason(error)}): choose another folder with -o") from error


def _is_same(path: Path, other: Path) -> bool:
    with suppress(OSError):
        return path.samefile(other)
    return path.absolute() == other.absolute()


def _reason(error: Exception) -> str:
    """The system's own words, where HDF5 has wrapped its jargon around them."""
    number = getattr(error, "errno", None)
    if number:
        return os.strerror(number)
    inner = re.search(r"error message = '([^']+)'", str(error))
    return inner[1] if inner else str(error).splitlines()[0]
