"""Announces the compilation of the first run to whoever shows progress.

numba is not imported here: a command that shows progress need not wait for it.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_listeners: list[Callable[[int], None]] = []


@contextmanager
def announced_to(listener: Callable[[int], None]) -> Iterator[None]:
    """Call `listener` while functions are compiled, with how many were finished since: 0 where one goes on."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def announce(compiled: int) -> None:
    """Tell every listener that so many functions were finished."""
    for listener in tuple(_listeners):
        listener(compiled)
