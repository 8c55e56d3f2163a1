"""Read blocks of rows in a thread while the previous ones are processed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
Progress = Callable[[str, float], None]
"""A function that is called with a phase in a few words, and the fraction done, 0 to 1; NaN: unknown."""


def ahead(items: Iterable[T]) -> Iterator[T]:
    """Yield the items in order; the next one is computed while the present one is used.

    Raises what computing an item raises, when that item is due.
    """
    iterator = iter(items)
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(_next, iterator)
        while found := coming.result():
            coming = pool.submit(_next, iterator)
            yield found[0]


def _next(iterator: Iterator[T]) -> tuple[T] | None:
    """Return the next item in a tuple; None at the end, because a future cannot hold StopIteration."""
    for item in iterator:
        return (item,)
    return None
