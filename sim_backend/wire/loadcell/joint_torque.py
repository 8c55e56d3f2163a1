"""A record of the torque at a motor's joint. It connects two emulators: a drive simulates the joint, and a torque cell
on another wire measures it.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from typing import Protocol

_KEPT = 4096  # steps


class Felt(Protocol):
    """The interface of a joint whose torque a torque cell can read."""

    def mean(self, begin: float, end: float) -> float:
        """Return the mean torque at the joint from `begin` to `end`, s, in N m."""


class AtRest:
    """A joint without torque."""

    def mean(self, begin: float, end: float) -> float:  # noqa: ARG002 - see `Felt`
        """Return 0."""
        return 0.0


class JointTorque:
    """A record of the recent torque at a joint: its integral over time, from which means are computed."""

    def __init__(self) -> None:
        self._times: deque[float] = deque([0.0], maxlen=_KEPT)
        self._sums: deque[float] = deque([0.0], maxlen=_KEPT)
        self._torque = 0.0

    def note(self, t: float, torque: float) -> None:
        """Record the torque `torque`, N m, at `t`, s. Between two records the torque is linear."""
        step = t - self._times[-1]
        if step > 0.0:
            self._sums.append(self._sums[-1] + 0.5 * step * (self._torque + torque))
            self._times.append(t)
        self._torque = torque

    def mean(self, begin: float, end: float) -> float:
        """Return the mean torque from `begin` to `end`, s, in N m. The torque counts as 0 before the first record, and
        as constant after the last.
        """
        return (self._sum(end) - self._sum(begin)) / (end - begin)

    def _sum(self, t: float) -> float:
        """Return the integral of the torque up to `t`, s, in N m s."""
        after = bisect_left(self._times, t)
        if after == 0:
            return self._sums[0]
        if after == len(self._times):
            return self._sums[-1] + (t - self._times[-1]) * self._torque
        t0, t1 = self._times[after - 1], self._times[after]
        s0, s1 = self._sums[after - 1], self._sums[after]
        return s0 + (s1 - s0) * (t - t0) / (t1 - t0)
