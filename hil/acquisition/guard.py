"""The guard ends a run early: a limit is exceeded, a sensor is missing or stuck, or the link is silent.

The thresholds follow the stand's limits (all at the joint, SI). A single reading far beyond a limit ends the run; a
reading slightly beyond it must repeat, so that one bad count does not end a recording.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from drivers.servo import BadReply, NoReply, Sample, Status
from hil.stand.file import LimitsTable

_REPEATS = 3  # readings in a row beyond 1.1 of a limit, or missing
_BEYOND, _FAR_BEYOND = 1.1, 1.5
_COOL_START, _COOL_RUN = 15.0, 5.0  # degC below the limit: refuse to start, stop
_SILENCE = 0.02  # s without a reply, and at least _REPEATS of them, before a run is ended
_STALE = 0.05  # s of replies that repeat the drive's own clock, and at least _REPEATS of them
_STALE_FLAG = int(Status.STALE)
_LATE_RAMP, _LATE_OFF = 0.01, 0.05  # s by which a tick may be late before the run is ramped down, is ended at once
_STUCK = 20  # replies in a row with the same motor angle, to the last bit


class LimitReached(Exception):
    """A safety limit ended the run (exit status 4)."""


class AtJoint(NamedTuple):
    """One reply converted to the joint: N m, rad, rad/s; NaN where there is no such reading."""

    torque: float = math.nan
    dtheta: float = math.nan
    dtheta_dot: float = math.nan


class _Channel:
    """One channel of a run and its limit."""

    def __init__(self, name: str, unit: str, limit: float) -> None:
        self._name, self._unit, self._limit = name, unit, limit
        self._beyond = 0
        self._missing = 0
        self.expected = False

    def check(self, value: float) -> None:
        """Raise LimitReached, or BadReply where a reading that was present at rest is missing."""
        if not math.isfinite(value):  # before any comparison: a NaN exceeds no limit
            self._missing += 1
            if self.expected and self._missing >= _REPEATS:
                raise BadReply(
                    f"the {self._name} was missing from {self._missing} replies in a row: check its sensor and cable"
                )
            return
        self._missing = 0
        self._beyond = self._beyond + 1 if abs(value) > _BEYOND * self._limit else 0
        if self._beyond >= _REPEATS or abs(value) > _FAR_BEYOND * self._limit:
            raise LimitReached(
                f"the {self._name} reached {abs(value):.3g} {self._unit}; its limit is {self._limit:g}: "
                "lower --amplitude or change --band"
            )


class _Encoder:
    """The motor's angle, which must change while the torque does."""

    def __init__(self, moves: float) -> None:
        self._moves = moves
        self._angle = math.nan
        self._same = 0
        self._low = self._high = math.nan

    def check(self, angle: float, torque: float) -> None:
        """Raise BadReply where the angle, rad, stays the same while the torque, N m, changes."""
        if angle != self._angle:
            self._angle, self._same = angle, 0
            self._low = self._high = torque
            return
        self._same += 1
        if math.isfinite(torque):
            self._low, self._high = min(torque, self._low), max(torque, self._high)
        if self._same >= _STUCK and self._high - self._low > self._moves:
            raise BadReply(
                f"the motor's angle did not change in {self._same} replies while the torque changed by "
                f"{self._high - self._low:.3g} N m: check the encoder, and that nothing blocks the motor"
            )


class Guard:
    """The check of every sample of a run against the limits.

    moves: N m at the joint by which the torque cannot change without the motor turning.
    """

    def __init__(self, limits: LimitsTable, moves: float) -> None:
        self._temperature_limit = limits.temperature
        self._channels = (
            _Channel("torque", "N m", limits.torque),
            _Channel("deflection", "rad", limits.deflection),
            _Channel("velocity", "rad/s", limits.velocity),
        )
        self._temperature = _Channel("temperature", "degC", math.inf)
        self._encoder = _Encoder(moves)
        self._last_reply = math.nan
        self._fresh_reply = math.nan
        self._stale_in_row = 0
        self._lost_in_row = 0

    def check_start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Register the channels that can be read at rest. Raises LimitReached where the winding is too warm."""
        for channel, values in zip(self._channels, zip(*at_joint, strict=True), strict=True):
            channel.expected = any(math.isfinite(value) for value in values)
        temperatures = [sample.temperature for sample in samples if math.isfinite(sample.temperature)]
        self._temperature.expected = bool(temperatures)
        limit = self._temperature_limit
        if temperatures and temperatures[-1] > limit - _COOL_START:
            raise LimitReached(
                f"the winding is at {temperatures[-1]:.0f} degC, within {_COOL_START:.0f} of its limit of "
                f"{limit:.0f}: let it cool down first"
            )

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check one reply. Raises LimitReached, and BadReply where the readings are not reliable any more."""
        self._last_reply = sample.t
        self._lost_in_row = 0
        for channel, value in zip(self._channels, at_joint, strict=True):
            channel.check(value)
        self._temperature.check(sample.temperature)
        if sample.temperature > self._temperature_limit - _COOL_RUN:
            raise LimitReached(
                f"the winding reached {sample.temperature:.0f} degC; its limit is {self._temperature_limit:.0f}"
            )
        self._check_fresh(sample)
        self._encoder.check(sample.motor_position, at_joint.torque)

    def _check_fresh(self, sample: Sample) -> None:
        if not int(sample.status) & _STALE_FLAG:
            self._fresh_reply, self._stale_in_row = sample.t, 0
            return
        self._stale_in_row += 1
        if self._stale_in_row >= _REPEATS and not sample.t - self._fresh_reply < _STALE:
            raise BadReply(
                f"the drive's own clock did not advance in {self._stale_in_row} replies: "
                "its readings are old; switch it off and on"
            )

    def check_late(self, late: float) -> str:
        """Return the reason to ramp down for a tick that begins `late` s after its time, "" without one.

        Raises LimitReached where it is so late that the torque must go off at once.
        """
        if late <= _LATE_RAMP:
            return ""
        message = (
            f"a tick came {late * 1e3:.0f} ms late, and the motor kept its last set-point for so long: lower --rate, "
            "or free the computer of other work"
        )
        if late > _LATE_OFF:
            raise LimitReached(message)
        return message

    def check_silence(self, now: float) -> None:
        """Count a lost reply at `now` s. Raises NoReply once the link has been silent for too long."""
        self._lost_in_row += 1
        silent = now - self._last_reply
        if self._lost_in_row >= _REPEATS and not silent < _SILENCE:
            raise NoReply(
                f"no reply for {self._lost_in_row} ticks in a row: check the drive's power and its cable before "
                "touching it, since its torque could not be read back"
            )
