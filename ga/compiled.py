"""How this package compiles its hot functions: once, cached on disk, free of the interpreter lock.

No fast-math: a NaN stays a NaN, and sums keep the order they are written in, so a seed gives the same bits on every
machine.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, ParamSpec, TypeVar, cast

import numba

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
R = TypeVar("R")

_OPTIONS: Final[dict[str, Any]] = {"cache": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_LEAN: Final[dict[str, Any]] = {"_nrt": False}


def forget_stale(package: Path) -> None:
    """Drop the machine code of a package's folder that is older than any of its sources.

    numba renews the code of a function when its own file changes, not when a function of another file does that was
    compiled into it.
    """
    newest = max(source.stat().st_mtime_ns for source in package.rglob("*.py"))
    for index in package.rglob("__pycache__/*.nbi"):
        try:
            if index.stat().st_mtime_ns < newest:
                index.unlink()
        except OSError:  # another process was faster, or the folder is read-only and numba keeps its cache elsewhere
            continue


forget_stale(Path(__file__).parent)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The same function as machine code, compiled at its first call (numba)."""
    return cast("Callable[P, R]", numba.njit(**_options(function))(function))


def lean(function: Callable[P, R]) -> Callable[P, R]:
    """The same for a function of an inner loop that allocates nothing, inlined into its caller.

    The references of arrays are not counted: atomic counting costs ten times what such a function computes.
    """
    return cast("Callable[P, R]", numba.njit(**_options(function), **_LEAN, forceinline=True)(function))


def lean_apart(function: Callable[P, R]) -> Callable[P, R]:
    """As `lean`, but called: for what is large, or seldom done."""
    return cast("Callable[P, R]", numba.njit(**_options(function), **_LEAN)(function))


def _options(function: Callable[P, R]) -> dict[str, Any]:
    # what only compiled functions call needs no entry from Python, which is half of its compilation
    return {**_OPTIONS, "no_cpython_wrapper": function.__name__.startswith("_")}
