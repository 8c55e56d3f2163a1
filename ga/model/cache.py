"""Keep results that a search needs again, up to a limit of memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

K = TypeVar("K")
V = TypeVar("V")

ALTERNATING: Final = 2
PARTS: Final = 16
"""ALTERNATING: the number of results kept for two alternating searches. PARTS: the number of small parts of a motion
that are kept.
"""

SMALL: Final = 5000
_ROOM: Final = 2_000_000
"""SMALL: the number of samples up to which a part of a motion is small. _ROOM: the number of values, 16 MB, that the
kept columns of a motion have together.
"""


def columns_of(samples: int) -> int:
    """Return how many columns (samples,) are kept at most."""
    return 1 + _ROOM // (samples + SMALL)


def recalled(found: dict[K, V], key: K) -> V | None:
    """Return the kept value for a key, None without one, and mark the value as the most recently used."""
    value = found.pop(key, None)
    if value is not None:
        found[key] = value
    return value


def keep(found: dict[K, V], key: K, value: V, most: int) -> V:
    """Keep a value, and drop the least recently used values, so that at most `most` are kept."""
    for longest_ago in list(found)[: max(0, len(found) - most + 1)]:
        del found[longest_ago]
    found[key] = value
    return value


def kept(found: dict[K, V], key: K, make: Callable[[], V], most: int = ALTERNATING) -> V:
    """Return the kept value for a key; the first time, compute it by `make` and keep it."""
    value = recalled(found, key)
    return keep(found, key, make(), most) if value is None else value
