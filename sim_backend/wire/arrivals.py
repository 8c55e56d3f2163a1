"""The messages that are on their way on an emulated link, in the order of their arrival."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator
from typing import Generic, TypeVar

Part = TypeVar("Part")


class Arrivals(Generic[Part]):
    """A queue of messages, each with its time of arrival. Messages with the same time keep the order in which they were
    added.
    """

    def __init__(self) -> None:
        self._due: list[tuple[float, int, Part]] = []
        self._count = 0

    def __bool__(self) -> bool:
        return bool(self._due)

    def add(self, parts: Iterable[tuple[float, Part]]) -> None:
        """Add messages, each with its time of arrival, s."""
        for at, part in parts:
            self._count += 1
            heapq.heappush(self._due, (at, self._count, part))

    def next(self) -> float:
        """Return the time of the next arrival, s; infinity if no message is on its way."""
        return self._due[0][0] if self._due else math.inf

    def until(self, now: float) -> Iterator[Part]:
        """Yield and remove the messages that have arrived by `now`, s."""
        while self.next() <= now:
            yield heapq.heappop(self._due)[2]
