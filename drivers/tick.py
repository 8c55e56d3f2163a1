"""The servo's own clock: Realtime Tick(120), a count of milliseconds that wraps at 32768."""

from __future__ import annotations

from enum import Enum

WRAP = 32768
_LONGEST = 16.0  # s between samples, above which the wraps are counted by the host's clock
_DRIFT = 0.02  # relative, far above the error of a servo's oscillator
_SLACK = 2e-3  # s: two counts


class Freshness(Enum):
    """Whether a tick agrees with the time that has passed on the host."""

    FRESH = "fresh"
    STILL = "still"
    """The tick has not changed."""
    IMPOSSIBLE = "impossible"
    """The sample was taken before its request, or the servo has been restarted."""


class TickClock:
    """Unwraps the tick and compares it with the host's clock.

    A sample is taken between the sending of its request and the end of its reply, so between two samples the servo's
    clock must move at least from the end of the one to the start of the next, and at most from start to end.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        """s on the servo's clock since the first sample."""
        self._last: tuple[int, float, float] | None = None

    def judge(self, tick: int, sent: float, received: float) -> Freshness:
        """Judge a sample requested at `sent` and complete at `received`, s; an impossible one is not stored."""
        if self._last is None:
            self._last = (tick, sent, received)
            return Freshness.FRESH
        before, last_sent, last_received = self._last
        moved = ((tick - before) % WRAP) * 1e-3
        shortest, longest = sent - last_received, received - last_sent
        if longest > _LONGEST:
            whole = WRAP * 1e-3
            moved += whole * max(0, round((0.5 * (shortest + longest) - moved) / whole))
        elif not shortest * (1.0 - _DRIFT) - _SLACK <= moved <= longest * (1.0 + _DRIFT) + _SLACK:
            return Freshness.IMPOSSIBLE
        self._last = (tick, sent, received)
        self.seconds += moved
        return Freshness.FRESH if moved > 0.0 else Freshness.STILL

    def restart(self) -> None:
        """Accept the next sample without a comparison."""
        self._last = None
