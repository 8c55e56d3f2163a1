"""Compute the next block of rows in a thread while the present block is processed."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
Progress = Callable[[str, float], None]
"""A callback: it gets the name of a phase and the completed fraction, 0 to 1, or NaN if that is unknown."""


def ahead(items: Iterable[T]) -> Generator[T, None, None]:
    """Yield the items in order. The next item is computed in a thread while the present item is used.

    An exception of computing an item is raised when that item would be yielded.
    """
    iterator, pool = iter(items), ThreadPoolExecutor(1)
    coming = pool.submit(_next, iterator)
    try:
        while found := coming.result():
            coming = pool.submit(_next, iterator)
            yield found[0]
    except BaseException as error:
        # after Ctrl-C the item that is being computed is not waited for: it may wait for something itself
        pool.shutdown(wait=coming.done() or isinstance(error, GeneratorExit))
        raise
    pool.shutdown()


def _next(iterator: Iterator[T]) -> tuple[T] | None:
    """Return the next item in a tuple; None at the end, because a future cannot hold StopIteration."""
    for item in iterator:
        return (item,)
    return None
