"""Conversion of time stamps from a board's clock to the host's."""

from __future__ import annotations

_WRAP = 1 << 32  # microseconds; a board's count wraps after 71.6 minutes
_OFF = 5e-3  # relative error of a ceramic resonator
_SLACK = 0.5  # s of difference between the clocks from which the board counts as restarted


class BoardClock:
    """Converts the microseconds of a board to the host's clock.

    A line can arrive late, never early, so the line with the smallest delay gives the offset between the clocks. The
    offset may grow by the relative error of the board's clock, so that it follows a board that runs slow.
    """

    def __init__(self) -> None:
        self._last: tuple[int, float] | None = None
        self._time = 0.0
        self._offset = 0.0

    def place(self, micros: int, seen: float) -> float | None:
        """Return the time on the host's clock, s, of the board's count `micros` in a line received by `seen` s.

        None where the count went back, or further than the time that has passed: the board was restarted, and the next
        line starts a new conversion.
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
        """Return whether the newest line at `seen` s, `taken` s, is so old that the board was restarted.

        The count of a board that restarts soon after its start does not show the restart otherwise.
        """
        if seen - taken <= _SLACK:
            return False
        self._last = None
        return True
