"""When a reading was taken: the board's own clock brought onto the host's, or the moment its line was found."""

from __future__ import annotations

_WRAP = 1 << 32  # microseconds; after 71.6 minutes a board's count begins anew
_OFF = 5e-3  # relative; a ceramic resonator may be off by this much
_SLACK = 0.5  # s by which the two clocks may part before the board must have been restarted


class BoardClock:
    """Brings the microseconds of a board onto the host's clock.

    A line can come late, never early: the line that came soonest after its time stamp tells where the board's clock is.
    That may move by as much as the board's clock may be off, so that it follows a board that runs slow.
    """

    def __init__(self) -> None:
        self._last: tuple[int, float] | None = None
        self._time = 0.0
        self._offset = 0.0

    def place(self, micros: int, seen: float) -> float | None:
        """When, s on the host's clock, the board's count was `micros`, of a line complete by `seen` s.

        None where it has gone back, or further than the time that has passed: the board was restarted, and the next
        line begins anew.
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
        """Whether the newest of the lines that were there at `seen` s is so old that the board was restarted.

        A board that had been up for as long as its restart takes counts on as if nothing had been.
        """
        if seen - taken <= _SLACK:
            return False
        self._last = None
        return True
