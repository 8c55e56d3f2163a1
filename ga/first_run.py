"""Announce the compilation in a first run to the functions that show progress.

numba is not imported here, so that a command that shows progress need not wait for the import.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_listeners: list[Callable[[int], None]] = []


@contextmanager
def announced_to(listener: Callable[[int], None]) -> Iterator[None]:
    """Call `listener` in a `with` block while functions are compiled.

    Its argument is the number of functions finished since the last call: 0 when a compilation begins.
    """
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def announce(compiled: int) -> None:
    """Call every listener with the number of functions that were finished."""
    for listener in tuple(_listeners):
        listener(compiled)
