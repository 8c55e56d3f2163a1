"""Values in counts, as motors send and receive them."""

from __future__ import annotations

import math

from drivers.servo import BadReply


class Counts:
    """A value from -`most` to `most` in counts of `bits` bits; zero lies between two counts. lsb: one count."""

    def __init__(self, most: float, bits: int) -> None:
        self.most, self.top = most, (1 << bits) - 1
        self.lsb = 2.0 * most / self.top
        self.middle = round(0.5 * self.top)

    def of(self, value: float) -> int:
        """Return the counts nearest to `value`, clamped to the range."""
        bounded = max(-self.most, min(self.most, value))
        return max(0, min(self.top, round((bounded + self.most) / self.lsb)))

    def value(self, counts: int) -> float:
        """Return the value of `counts`."""
        return counts * self.lsb - self.most

    def inside(self, counts: int) -> float:
        """Return the value of `counts`; NaN at the ends of the range, which a motor sends for every value beyond the
        range.
        """
        return math.nan if counts in {0, self.top} else self.value(counts)


def require_position(position: float) -> None:
    """Raise BadReply for a position that is NaN."""
    if math.isnan(position):
        raise BadReply("the position is at the end of its range: set the motor's zero near the middle of the travel")
