"""The torque at a motor's joint, for a torque cell on another wire: the past of one plant, shared by two emulators."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from typing import Protocol

_KEPT = 4096  # steps


class Felt(Protocol):
    """A joint whose torque can be asked for."""

    def mean(self, begin: float, end: float) -> float:
        """N m at the joint, the mean from `begin` to `end`, s."""


class AtRest:
    """A joint without torque."""

    def mean(self, begin: float, end: float) -> float:  # noqa: ARG002 - see `Felt`
        """No torque."""
        return 0.0


class JointTorque:
    """The torque's integral over time, from which the mean of any stretch of the recent past follows."""

    def __init__(self) -> None:
        self._times: deque[float] = deque([0.0], maxlen=_KEPT)
        self._sums: deque[float] = deque([0.0], maxlen=_KEPT)
        self._torque = 0.0

    def note(self, t: float, torque: float) -> None:
        """The torque is `torque` N m at `t` s; it changed evenly since the time before."""
        step = t - self._times[-1]
        if step > 0.0:
            self._sums.append(self._sums[-1] + 0.5 * step * (self._torque + torque))
            self._times.append(t)
        self._torque = torque

    def mean(self, begin: float, end: float) -> float:
        """N m, the mean from `begin` to `end`, s; before and behind what is known it stays as it was."""
        return (self._sum(end) - self._sum(begin)) / (end - begin)

    def _sum(self, t: float) -> float:
        """N m s up to `t`."""
        after = bisect_left(self._times, t)
        if after == 0:
            return self._sums[0]
        if after == len(self._times):
            return self._sums[-1] + (t - self._times[-1]) * self._torque
        t0, t1 = self._times[after - 1], self._times[after]
        s0, s1 = self._sums[after - 1], self._sums[after]
        return s0 + (s1 - s0) * (t - t0) / (t1 - t0)
