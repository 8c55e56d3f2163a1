"""The guard ends a run early if a limit is exceeded, a sensor is missing or implausible, or the link is silent."""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.servo import BadReply, NoReply, Sample, Status
from hil.acquisition.limits import (
    AtJoint,
    Level,
    Limit,
    LimitReached,
    Lock,
    Supply,
    Temperature,
)
from hil.acquisition.sensor_limits import ImplausibleEncoder, StuckCell, StuckEncoder
from hil.stand.file import LimitsTable

_REPEATS = 3  # lost or stale replies in a row
_SILENCE = 0.02  # s without a reply, and at least _REPEATS of them, before a run is ended
_STALE = 0.05  # s of replies that repeat the drive's own clock, and at least _REPEATS of them
_STALE_FLAG, _GOOD = int(Status.STALE), Status(0)
_UNKNOWN_COUNTS = AtJoint()
_LATE_RAMP, _LATE_OFF = 0.01, 0.05  # s by which a tick may be late before the run is ramped down, is ended at once


def longest_silence() -> float:
    """Return the time without a set-point, s, after which the guardian acts. It is slightly shorter than the lateness
    of a tick that ends a run.
    """
    return 0.9 * _LATE_OFF


class Guard:
    """Checks every sample of a run against the limits.

    limits: of the stand. moves: the smallest change of torque at the joint, N m, that is impossible unless the motor
    turns. more: further limits of this run. counts: the values of one count of the readings.
    """

    def __init__(
        self, limits: LimitsTable, moves: float, more: Sequence[Limit] = (), counts: AtJoint = _UNKNOWN_COUNTS
    ) -> None:
        self._levels = (
            Level("torque", 0, "N m", limits.torque, counts.torque),
            Level("deflection", 1, "rad", limits.deflection, counts.dtheta),
            Level("velocity", 2, "rad/s", limits.velocity, counts.dtheta_dot),
        )
        self.limits: tuple[Limit, ...] = (
            *self._levels,
            Temperature(limits.temperature, limits.torque),
            Supply(),
            StuckEncoder(moves),
            ImplausibleEncoder(limits.deflection, limits.velocity),
            StuckCell(limits.torque),
            Lock(limits.deflection),
            *more,
        )
        self._checks = tuple(limit.check for limit in self.limits)
        self._last_reply = math.nan
        self._fresh_reply = math.nan
        self._stale_in_row = 0
        self._lost_in_row = 0

    def check_start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Give each limit the readings at rest. Raises LimitReached if the run must not begin."""
        for limit in self.limits:
            limit.start(samples, at_joint)

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check one reply. Raises LimitReached, and BadReply if the readings are no longer reliable."""
        self._last_reply = sample.t
        self._lost_in_row = 0
        for check in self._checks:
            check(sample, at_joint)
        if sample.status is _GOOD or not int(sample.status) & _STALE_FLAG:
            self._fresh_reply, self._stale_in_row = sample.t, 0
        else:
            self._check_fresh(sample)

    def exceeded(self, start: float) -> list[str]:
        """Return a sentence for each quantity that was above its limit, beyond its noise. start: of the run, s."""
        return [said for level in self._levels if (said := level.exceeded(start))]

    def _check_fresh(self, sample: Sample) -> None:
        self._stale_in_row += 1
        if self._stale_in_row >= _REPEATS and not sample.t - self._fresh_reply < _STALE:
            raise BadReply(
                f"the drive's own clock did not advance in {self._stale_in_row} replies: "
                "its readings are old; switch the drive off and on again"
            )

    def check_late(self, late: float, waited: float) -> str:
        """Return the reason to ramp the torque down for a tick that is `late` s behind its time, "" if there is no
        reason.

        late: the time since the previous tick, less one period, s. waited: the part of `late`, s, that was spent
        waiting for the drive's reply to the previous tick. The link causes this part, not this computer, and
        `check_silence` limits it. Raises LimitReached if the tick is so late that the torque must be switched off at
        once.
        """
        if late <= _LATE_RAMP or late <= min(_SILENCE, _LATE_RAMP + waited):
            return ""
        cause = "the drive was slow to answer: see its reply_timeout" if waited > 0.5 * late else ""
        message = (
            f"a tick came {late * 1e3:.0f} ms late, and the motor kept its last set-point for so long: "
            f"{cause or 'lower --rate, or free the computer of other work'}"
        )
        if late > _LATE_OFF:
            raise LimitReached(message)
        return message

    def check_silence(self, now: float) -> None:
        """Count a reply that was lost at time `now`, s. Raises NoReply if the link has been silent for too long."""
        self._lost_in_row += 1
        silent = now - self._last_reply
        if self._lost_in_row >= _REPEATS and not silent < _SILENCE:
            raise NoReply(
                f"no reply for {self._lost_in_row} ticks in a row: check the drive's power and its cable before "
                "touching it, since its torque could not be read back"
            )
