"""How this package compiles its hot functions: once, cached on disk, free of the interpreter lock.

No fast-math: a NaN stays a NaN, and sums keep the order they are written in, so a seed gives the same bits on every
machine.

The cache of a function is renewed when its own file changes, not when a file it calls into does: after editing one
module of this package remove `ga/__pycache__`, or the old machine code of the others runs on.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ParamSpec, TypeVar, cast

import numba

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The same function as machine code, compiled at its first call (numba)."""
    return cast("Callable[P, R]", numba.njit(cache=True, nogil=True, error_model="numpy")(function))
