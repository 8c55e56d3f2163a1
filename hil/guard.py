"""What ends a run early: a limit that was passed, silence on the link, a request to stop.

The thresholds follow the stand's limits (all at the joint, SI). A single reading far beyond a limit ends the run; a
reading a little beyond it must repeat, so that one bad count does not throw a recording away.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NamedTuple

from drivers.servo import NoReply, Sample
from hil.stand import LimitsTable

_REPEATS = 3  # readings in a row beyond 1.1 of a limit
_BEYOND, _FAR_BEYOND = 1.1, 1.5
_COOL_START, _COOL_RUN = 15.0, 5.0  # degC below the limit: refuse to start, stop
_SILENCE = 0.02  # s without a reply, and at least _REPEATS of them, before a run is given up


class LimitReached(Exception):
    """A safety limit ended the run (exit status 4)."""


class AtJoint(NamedTuple):
    """One reply seen from the joint: N m, rad, rad/s; NaN where there is no such reading."""

    torque: float = math.nan
    dtheta: float = math.nan
    dtheta_dot: float = math.nan


class Guard:
    """Judges every sample of a run against the limits."""

    def __init__(self, limits: LimitsTable) -> None:
        self._limits = limits
        self._beyond = {"torque": 0, "deflection": 0, "velocity": 0}
        self._last_reply = math.nan
        self._lost_in_row = 0

    def check_start(self, sample: Sample) -> None:
        """Raise LimitReached where the winding is too warm to begin."""
        limit = self._limits.temperature
        if sample.temperature > limit - _COOL_START:
            raise LimitReached(
                f"the winding is at {sample.temperature:.0f} degC, within {_COOL_START:.0f} of its limit of "
                f"{limit:.0f}: let it cool down first"
            )

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Judge one reply. Raises LimitReached."""
        self._last_reply = sample.t
        self._lost_in_row = 0
        self._check_one("torque", at_joint.torque, self._limits.torque, "N m")
        self._check_one("deflection", at_joint.dtheta, self._limits.deflection, "rad")
        self._check_one("velocity", at_joint.dtheta_dot, self._limits.velocity, "rad/s")
        limit = self._limits.temperature
        if sample.temperature > limit - _COOL_RUN:
            raise LimitReached(f"the winding reached {sample.temperature:.0f} degC; its limit is {limit:.0f}")

    def _check_one(self, name: str, value: float, limit: float, unit: str) -> None:
        self._beyond[name] = self._beyond[name] + 1 if abs(value) > _BEYOND * limit else 0
        if self._beyond[name] >= _REPEATS or abs(value) > _FAR_BEYOND * limit:
            raise LimitReached(
                f"the {name} reached {abs(value):.3g} {unit}; its limit is {limit:g}: "
                "lower --amplitude or change --band"
            )

    def check_silence(self, now: float) -> None:
        """Count a lost reply at `now` s. Raises NoReply once the link has been silent for too long."""
        self._lost_in_row += 1
        silent = now - self._last_reply
        if self._lost_in_row >= _REPEATS and not silent < _SILENCE:
            raise NoReply(
                f"no reply for {self._lost_in_row} ticks in a row: check the drive's power and its cable before "
                "touching it, since its torque could not be read back"
            )


class StopRequest:
    """Ctrl-C, a closed terminal or a kill, turned into a flag: no signal can skip the torque-off."""

    def __init__(self) -> None:
        self.count = 0
        self.number = 0

    def _note(self, number: int, frame: FrameType | None) -> None:
        del frame
        self.count += 1
        self.number = self.number or number

    @contextmanager
    def listening(self) -> Iterator[StopRequest]:
        """Take the signals that end a process, until the recording is on disk."""
        names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
        before = {name: signal.signal(getattr(signal, name), self._note) for name in names}
        try:
            yield self
        finally:
            for name, handler in before.items():
                signal.signal(getattr(signal, name), handler)
