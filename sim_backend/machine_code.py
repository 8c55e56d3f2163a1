"""How the inner loops become machine code, kept on disk between runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

Compiled = TypeVar("Compiled", bound="Callable[..., Any]")


def _forget_stale() -> None:
    """Drop machine code older than any source of this package.

    numba looks only at the file a function stands in, so a function of another module that was compiled into it
    would live on in its old form.
    """
    package = Path(__file__).parent
    newest = max(source.stat().st_mtime for source in package.rglob("*.py"))
    for index in package.rglob("__pycache__/*.nbi"):
        try:
            if index.stat().st_mtime < newest:
                index.unlink()
        except OSError:  # another process was faster, or the folder is read-only and numba keeps its cache elsewhere
            continue


_forget_stale()


def compiled(function: Compiled) -> Compiled:
    """`function` as machine code; no fast-math, so that NaN and rounding stay as written.

    Division follows IEEE 754 and raises nothing: no divisor here can be zero, and the check costs time.
    """
    return cast("Compiled", njit(cache=True, error_model="numpy")(function))


def packed(values: tuple[float, ...], names: tuple[str, ...]) -> NDArray[np.void]:
    """Named numbers as one record, shape (1,): numba takes it over in a tenth of the time a named tuple costs."""
    return np.array([values], dtype=[(name, np.float64) for name in names])
