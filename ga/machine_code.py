"""Find the folder in which machine code is kept, for the present sources of a package.

It is a folder that nobody else can write, because its files are run; `refused` says which folder was not used for that
reason.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any, Final

from ga.own_numba import appdirs, numba

if sys.platform != "win32":
    import grp
    import pwd

_numba: Any = numba.config  # set from the environment by name, unseen by a type checker
_appdirs: Any = appdirs
KEPT: Final = 20
"""The number of folders of machine code that are kept for each package, the most recently used first."""
refused: Final[list[Path]] = []
"""Folders and files that others can change, and through them the machine code."""


def package_of(source: Path) -> Path:
    """Return the top folder of the package that a source file belongs to, or the file itself if it is in no package."""
    top = source
    while (top.parent / "__init__.py").exists():
        top = top.parent
    return top


@cache
def cache_folder(package: Path) -> Path | None:
    """Return the folder for the machine code of the present sources of a package or single file.

    The first of these folders that can be written is used: `NUMBA_CACHE_DIR`, the user's cache folder, the package's
    `__pycache__`. None if none can be written, if others can write that folder, or if the sources cannot be read: then
    nothing is cached. A user without a home folder has no cache folder: a cache in the working directory could run code
    that somebody else put there.
    """
    try:
        name = f"{package.stem}-{_digest(package, Path(__file__).parent)}"
    except OSError:
        return None
    asked = [Path(_numba.CACHE_DIR)] if _numba.CACHE_DIR else []
    user = Path(_appdirs.user_cache_dir("hil", appauthor=False)) / "machine-code"
    for base in [*asked, *([user] if user.is_absolute() else []), package / "__pycache__"]:
        if _used(base / name):
            folder = (base / name).resolve()  # a symbolic link could point elsewhere later
            if (at_risk := changeable_by_others(folder)) is not None:
                refused.append(at_risk)
                return None
            _prune(base, package.stem)
            return folder
    return None


def changeable_by_others(folder: Path) -> Path | None:
    """Return the folder or file through which somebody other than this user and root can change the files in a folder;
    None if nobody else can.

    It is the folder itself, a file in it, or one of the folders above it. folder: an absolute path without links. In a
    folder with the sticky bit, such as /tmp, only the owner of an entry can rename it.
    """
    if sys.platform == "win32":  # the user's folders belong to the user alone
        return None
    if folder.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        return folder
    for place in (*reversed(folder.parents), folder, *folder.rglob("*")):
        try:
            found = place.lstat()
        except FileNotFoundError:  # another process has finished writing it
            continue
        above = place in folder.parents and not found.st_mode & stat.S_ISVTX
        if found.st_uid not in {0, os.geteuid()} or (above and _others_write(found)):
            return place
    return None


def _others_write(found: os.stat_result) -> bool:
    """Return whether somebody other than the owner can write a folder. A group that has no member but the user does not
    count.
    """
    if not found.st_mode & stat.S_IWGRP:
        return bool(found.st_mode & stat.S_IWOTH)
    try:
        user, group = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(found.st_gid)
    except KeyError:
        return True
    return bool(found.st_mode & stat.S_IWOTH) or group.gr_name != user or not {user}.issuperset(group.gr_mem)


def _digest(*packages: Path) -> str:
    """Return a hash of the names and contents of all sources of packages or single files, and of numba's version."""
    state = hashlib.blake2b(numba.__version__.encode(), digest_size=10)
    for package in packages:
        for source in sorted(package.rglob("*.py")) if package.is_dir() else [package]:
            state.update(f"{source.relative_to(package.parent)}:{source.stat().st_size}:".encode())
            state.update(source.read_bytes())
    return state.hexdigest()


def _used(folder: Path) -> bool:
    """Create a cache folder, or mark it as recently used; return False if the folder cannot be written."""
    try:
        for place in (*reversed(folder.parents), folder):
            if not place.exists():
                place.mkdir(mode=0o700, exist_ok=True)  # whatever the umask allows others
        tempfile.TemporaryFile(dir=folder).close()
        os.utime(folder)
    except OSError:
        return False
    return True


def _prune(base: Path, package: str) -> None:
    """Delete all but the most recently used folders of a package's machine code."""
    try:
        by_use = sorted(base.glob(f"{package}-*"), key=lambda folder: folder.stat().st_mtime_ns, reverse=True)
    except OSError:  # another process prunes at the same time
        return
    for folder in by_use[KEPT:]:
        shutil.rmtree(folder, ignore_errors=True)
