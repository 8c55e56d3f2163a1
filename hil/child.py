"""Helpers for a second process of hil: the command line that starts a module of hil, and memory that both share."""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[1]
_START = (
    "import os, runpy, sys; _, module, *words, path = sys.argv; sys.path[:] = path.split(os.pathsep); "
    "sys.argv = [module, *words]; runpy.run_module(module, run_name='__main__', alter_sys=True)"
)


def command(module: str, *words: str) -> list[str]:
    """Return the command line that runs `module` with `words` as its arguments.

    `python -m` searches the working directory first, and would run any `h5py.py` in that directory. The new process
    searches the absolute folders of this process's search path, in the same order. The working directory is not
    searched, unless hil itself is there. The search path is the last word, so that `ps` shows the command first.
    """
    return [sys.executable, "-I", "-c", _START, module, *words, os.pathsep.join(_search_path())]


def shared_memory(size: int) -> int:
    """Return the descriptor of `size` bytes of memory, all zero, which a child process can inherit and map.

    The memory is an open file without a name: it is in no folder, and it is released with the last process that has it
    open. Raises OSError if there is no room for it.
    """
    descriptor = _nameless()
    if os.write(descriptor, bytes(size)) != size:  # all of it now: memory that is full would end the process later
        os.close(descriptor)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    return descriptor


def _nameless() -> int:
    with suppress(AttributeError, OSError):  # not Linux, or forbidden there
        return os.memfd_create("hil")
    import tempfile

    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _search_path() -> list[str]:
    try:
        here = Path.cwd()
    except OSError:  # it was removed, and nothing lies there
        here = None
    folders = [Path(entry) for entry in sys.path if Path(entry).is_absolute()]
    kept = [folder for folder in folders if (place := folder.resolve()) != here or place == _ROOT]
    if _ROOT not in [folder.resolve() for folder in kept]:  # a checkout that is run from within by `python -m hil`
        kept.append(_ROOT)
    return [str(folder) for folder in kept]
