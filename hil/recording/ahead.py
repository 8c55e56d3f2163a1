"""Blocks of rows, read in a thread while the ones before are worked on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
Progress = Callable[[str, float], None]
"""Called with what is being done, in a few words, and the share of it that is done, 0 to 1; NaN: not known."""


def ahead(items: Iterable[T]) -> Iterator[T]:
    """Yield the items in order, each of them computed while the one before is used. One more than that is in memory.

    Raises what computing an item raises, when its turn comes.
    """
    iterator = iter(items)
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(_next, iterator)
        while found := coming.result():
            coming = pool.submit(_next, iterator)
            yield found[0]


def _next(iterator: Iterator[T]) -> tuple[T] | None:
    """Return the next item, in a tuple; None at the end: a future cannot hold StopIteration."""
    for item in iterator:
        return (item,)
    return None
