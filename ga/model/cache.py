"""Keep results that a search needs again, up to a limit of memory."""

from __future__ import annotations

import threading
from collections import defaultdict
from typing import TYPE_CHECKING, Any, Final, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

V = TypeVar("V")

ALTERNATING: Final = 2
PARTS: Final = 16
SMALL: Final = 5000
ROOM: Final = 2_000_000
"""ALTERNATING: the number of results kept for two alternating searches. PARTS: the number of small parts of a motion
that are kept; up to SMALL samples a part is small. ROOM: the number of values, 16 MB, that the kept columns of a motion
have together.
"""


class Kept(threading.local):
    """Results by kind and key, for the thread that uses them. Searches in other threads have their own, so that none
    takes out a result that another one is about to use.
    """

    def __init__(self) -> None:
        """Keep nothing at first, in each thread."""
        self._kinds: defaultdict[str, dict[Hashable, Any]] = defaultdict(dict)

    def recalled(self, kind: str, key: Hashable) -> Any:
        """Return the kept result, None without one, and mark it as the most recently used."""
        found = self._kinds[kind]
        value = found.pop(key, None)
        if value is not None:
            found[key] = value
        return value

    def keep(self, kind: str, key: Hashable, value: V, most: int) -> V:
        """Keep a result, and drop the least recently used results of its kind, so that at most `most` are kept."""
        found = self._kinds[kind]
        found[key] = value
        for longest_ago in list(found)[: len(found) - most]:
            del found[longest_ago]
        return value

    def get(self, kind: str, key: Hashable, make: Callable[[], V], most: int) -> V:
        """Return the kept result; the first time, compute it by `make` and keep it."""
        value: V | None = self.recalled(kind, key)
        return self.keep(kind, key, make(), most) if value is None else value
