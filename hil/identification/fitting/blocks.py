"""Read the rows of a linear problem, columns and torque, in order, one block at a time, as often as needed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ga.arrays import Array, Index, Mask
from hil.signals.constants import ENOUGH

Block = tuple[Array, Array]
Keep = Callable[[Index], Mask]
"""A function that gets row numbers (m,) and returns which of these rows are kept."""


@dataclass(frozen=True, slots=True)
class Blocks:
    """The rows of a linear problem as blocks of columns (m, p) and torque (m,), N m; each call reads from the first row
    again.

    rows: the total number of rows. read: the function that starts reading the rows.
    """

    rows: int
    read: Callable[[], Iterable[Block]]

    def __call__(self) -> Iterable[Block]:
        """Read the rows from the first one on."""
        return self.read()

    @classmethod
    def of(cls, columns: Array, torque: Array) -> Blocks:
        """Return rows that are in memory, columns (n, p) and torque (n,) N m, as one block."""
        return cls(len(torque), lambda: [(columns, torque)])

    def where(self, keep: Keep) -> Blocks:
        """Return the rows whose numbers the function `keep` selects."""
        starts = range(0, self.rows, ENOUGH)
        rows = sum(int(keep(np.arange(at, min(at + ENOUGH, self.rows))).sum()) for at in starts)
        return Blocks(rows, lambda: self._selected(keep))

    def between(self, start: int, stop: int) -> Blocks:
        """Return the rows from `start` to `stop`, `stop` excluded."""

        def keep(number: Index) -> Mask:
            return np.asarray((number >= start) & (number < stop))

        return Blocks(stop - start, lambda: self._selected(keep))

    def searching(self, searched: Mask, values: Array) -> Blocks:
        """Return the rows with only the searched columns.

        searched (p,): which columns are searched. The torque of the other columns, at values (p,), SI, is subtracted.
        """
        return Blocks(
            self.rows,
            lambda: (
                (columns[:, searched], torque - columns[:, ~searched] @ values[~searched])
                for columns, torque in self.read()
            ),
        )

    def _selected(self, keep: Keep) -> Iterable[Block]:
        first = 0
        for columns, torque in self.read():
            kept = keep(np.arange(first, first + len(torque)))
            first += len(torque)
            if kept.all():  # mostly: what is kept are a few long stretches
                yield columns, torque
            elif kept.any():
                yield columns[kept], torque[kept]
