"""The command line that starts a module of hil in a process of its own."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[1]
_START = (
    "import os, runpy, sys; _, path, module, *words = sys.argv; sys.path[:] = path.split(os.pathsep); "
    "sys.argv = [module, *words]; runpy.run_module(module, run_name='__main__', alter_sys=True)"
)


def command(module: str, *words: str) -> list[str]:
    """Return the command line that runs `module` with `words` as its arguments.

    `python -m` searches the working directory first, and would run any `h5py.py` in that directory. The new process
    searches the absolute folders of this process's search path, in the same order. The working directory is not
    searched, unless hil itself is there.
    """
    return [sys.executable, "-I", "-c", _START, os.pathsep.join(_search_path()), module, *words]


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
