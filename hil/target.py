"""Where a recording goes: the next free name, and what must not be overwritten."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hil.errors import WrongUse


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


def check_target(path: Path, *, force: bool) -> None:
    """Raise WrongUse where writing `path` would overwrite something, or where there is no folder for it.

    With `force` an unfinished recording of that name is given up, so that a new one can be made in its place.
    """
    if path.is_dir():
        raise WrongUse(f"{path} is a folder: name a file, such as {path / 'run1.h5'}")
    if not path.parent.is_dir():
        raise WrongUse(f"{path.parent} is not a folder: make it first, or name another output with -o")
    if force:
        with writing(path):
            part_path(path).unlink(missing_ok=True)
        return
    if path.exists():
        raise WrongUse(f"{path} exists: choose another name with -o, or overwrite it with --force")
    if part_path(path).exists():
        raise WrongUse(
            f"{part_path(path)} is a recording that never ended: keep it with `hil recover {part_path(path)}`, "
            "choose another name with -o, or give it up with --force"
        )


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
def writing(path: Path) -> Iterator[None]:
    """Turn what the operating system says of a target that cannot be written into a WrongUse."""
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:  # HDF5 reports a full disk as any of the three
        raise WrongUse(f"{path} cannot be written ({_reason(error)}): choose another folder with -o") from error


def _reason(error: Exception) -> str:
    """The system's own words, where HDF5 has wrapped its jargon around them."""
    number = getattr(error, "errno", None)
    if number:
        return os.strerror(number)
    inner = re.search(r"error message = '([^']+)'", str(error))
    return inner[1] if inner else str(error).splitlines()[0]
