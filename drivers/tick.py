"""The clock of a DYNAMIXEL servo, Realtime Tick(120): a count of milliseconds that wraps at 32768."""

from __future__ import annotations

from enum import Enum

WRAP = 32768
_LONGEST = 16.0  # s between samples, above which the wraps are counted by the host's clock
_DRIFT = 0.02  # relative, far above the error of a servo's oscillator
_SLACK = 2e-3  # s: two counts


class Freshness(Enum):
    """Result of comparing the servo's clock with the host's clock: whether a sample is new and possible."""

    FRESH = "fresh"
    STILL = "still"
    """The servo's clock has not advanced since the previous sample."""
    IMPOSSIBLE = "impossible"
    """The sample was taken before its request, or the servo has been restarted."""


class TickClock:
    """Counts the milliseconds of the servo's clock beyond its wrap, and compares them with the host's clock.

    The servo takes a sample between the start of the request and the end of the reply. From one sample to the next the
    servo's clock must therefore advance at least by the time from the end of the first reply to the start of the second
    request, and at most by the time from the start of the first request to the end of the second reply.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        """s on the servo's clock since the first sample."""
        self._last: tuple[int, float, float] | None = None

    def judge(self, tick: int, sent: float, received: float) -> Freshness:
        """Compare the tick of a sample with the times at which it was requested (`sent`) and complete (`received`), s.
        An impossible sample is not stored.
        """
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
        """Store the next sample without a comparison."""
        self._last = None
