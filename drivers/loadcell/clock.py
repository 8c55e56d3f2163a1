"""Convert time stamps of a board's clock to the host's clock."""

from __future__ import annotations

_WRAP = 1 << 32  # microseconds; a board's count wraps after 71.6 minutes
_OFF = 5e-3  # relative error of a ceramic resonator
_SLACK = 0.5  # s of difference between the clocks from which the board counts as restarted


class BoardClock:
    """Converts the microsecond counts of a board to times on the host's clock.

    A line can arrive late, but never early. So the line with the smallest delay gives the offset between the two
    clocks. The offset may grow by the largest relative error of the board's clock, so that a slow board clock is
    followed too.
    """

    def __init__(self) -> None:
        self._last: tuple[int, float] | None = None
        self._time = 0.0
        self._offset = 0.0

    def place(self, micros: int, seen: float) -> float | None:
        """Return the time on the host's clock, s, at which the board's clock showed `micros`. seen: s, when the line
        was received.

        Returns None if the count went back, or advanced by more than the time between the lines: the board was
        restarted. The next line then starts a new conversion.
        """
        if self._last is None:
            self._last = (micros, seen)
            self._time, self._offset = 0.0, seen
            return seen
        before, last_seen = self._last
        moved = ((micros - before) % _WRAP) * 1e-6
        if moved > (seen - last_seen) * (1.0 + _OFF) + _SLACK:
            self._last = None
            return None
        self._last = (micros, seen)
        self._time += moved
        self._offset = min(self._offset + _OFF * moved, seen - self._time)
        return self._time + self._offset

    def late(self, taken: float, seen: float) -> bool:
        """Return whether the newest reading is so old that the board must have been restarted. taken: its time, s;
        seen: s, when it was received.

        If a board restarts soon after its start, its count does not go back, so `place` cannot detect the restart.
        """
        if seen - taken <= _SLACK:
            return False
        self._last = None
        return True
