"""Limits that end a run if the encoder or the torque cell is not credible: stuck, jumping, noisy, or at the end of its
range.

They have the interface `hil.acquisition.limits.Limit`; all values are at the joint in SI.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from drivers.servo import BadReply, Sample
from hil.acquisition.limits import AtJoint, Persistence

_STUCK = 20  # replies in a row with the same motor angle, to the last bit
_CELL_STUCK, _CELL_STUCK_FOR, _CELL_MOVES = 50, 0.2, 0.25  # replies, s, share of the deflection's range so far
_CELL_ZERO = 0.05  # of the torque limit; a torque below may stay the same in the play of a gear or a slack cable
_JUMP, _JUMP_WITHIN = 0.1, 5e-3  # of the deflection limit, in one tick of at most so many s
_NOISE_OVER, _NOISE_SIZE, _ROUGH = 100, 0.02, 1.45  # replies; of the deflection limit; second over first differences


class StuckEncoder:
    """Check that the motor's angle changes while the torque changes.

    moves: the smallest change of torque, N m, that is impossible unless the motor turns.
    """

    name = "encoder"

    def __init__(self, moves: float) -> None:
        self._moves = moves
        self._angle = math.nan
        self._same = 0
        self._low = self._high = math.nan

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Do nothing: this check needs no readings at rest."""

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check one reply. Raises BadReply if the angle is stuck."""
        torque = at_joint.torque
        if sample.motor_position != self._angle:
            self._angle, self._same = sample.motor_position, 0
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


class ImplausibleEncoder:
    """Check that the deflection neither jumps nor is noisy, as the reading of a broken encoder is.

    limit: largest allowed deflection, rad. velocity: largest allowed velocity, rad/s. A deflection jumps if it changes
    between two readings by more than a tenth of `limit` plus three times the change that its reported velocity allows.
    A deflection is noisy if its second differences are not smaller than its first differences. In a motion that is
    sampled fast enough, the second differences are smaller.
    """

    name = "encoder"

    def __init__(self, limit: float, velocity: float) -> None:
        self._jump, self._rough, self._velocity = _JUMP * limit, _NOISE_SIZE * limit, velocity
        self._t = self._trusted = self._rate = math.nan
        self._untrusted = Persistence()
        self._angles: list[float] = []

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Do nothing: this check needs no readings at rest."""

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check the deflection in one reply. Raises BadReply if the deflection jumps or is noisy."""
        angle, rate, t = at_joint.dtheta, abs(at_joint.dtheta_dot), sample.t
        if not math.isfinite(angle):
            return
        if not math.isfinite(rate):
            rate = self._velocity
        passed, fastest = t - self._t, self._rate if self._rate > rate else rate
        self._t, self._rate = t, rate
        moved = abs(angle - self._trusted)
        jumped = passed <= _JUMP_WITHIN and moved > self._jump + 3.0 * passed * fastest
        if jumped or self._untrusted.seen:
            self._check_repeated(jumped, moved)
        if not jumped:
            self._trusted = angle
        self._angles.append(angle)
        if len(self._angles) > _NOISE_OVER + 1:
            self._check_noise()

    def _check_repeated(self, jumped: bool, moved: float) -> None:
        if self._untrusted(jumped):
            raise BadReply(f"the deflection jumped by {moved:.3g} rad between two readings: check the encoder")

    def _check_noise(self) -> None:
        steps = [after - before for before, after in pairwise(self._angles)]
        size = sum(abs(after - before) for before, after in pairwise(steps)) / _NOISE_OVER
        ratio = size * _NOISE_OVER / (sum(map(abs, steps[1:])) or 1.0)
        del self._angles[:-2]
        if size > self._rough and ratio > _ROUGH:
            raise BadReply(
                f"the deflection changes to and fro by {size:.3g} rad from reading to reading: check the encoder, its "
                "magnet and its cable, or raise --rate"
            )


class StuckCell:
    """Check that the torque reading, N m, changes while the deflection changes. limit: largest allowed torque, N m."""

    name = "torque"

    def __init__(self, limit: float) -> None:
        self._zero = _CELL_ZERO * limit
        self._low = self._high = 0.0
        self._torque, self._since, self._same = math.nan, math.nan, 0
        self._from, self._to = math.nan, math.nan

    def start(self, samples: Sequence[Sample], at_joint: Sequence[AtJoint]) -> None:
        """Do nothing: this check needs no readings at rest."""

    def check(self, sample: Sample, at_joint: AtJoint) -> None:
        """Check the torque in one reply. Raises BadReply if the torque reading is stuck."""
        torque, angle = at_joint.torque, at_joint.dtheta
        if not (math.isfinite(torque) and math.isfinite(angle)):
            return
        if torque != self._torque:
            if not self._low <= angle <= self._high:
                self._low, self._high = min(angle, self._low), max(angle, self._high)
            self._torque, self._since, self._same = torque, sample.t, 0
            self._from = self._to = angle
            return
        self._same += 1
        self._from, self._to = min(angle, self._from), max(angle, self._to)
        if self._same < _CELL_STUCK or sample.t - self._since < _CELL_STUCK_FOR or abs(torque) < self._zero:
            return
        if self._to - self._from > _CELL_MOVES * (self._high - self._low) > 0.0:
            raise BadReply(
                f"the torque stayed at {torque:.3g} N m in {self._same} replies while the deflection changed by "
                f"{self._to - self._from:.3g} rad: the sensor is stuck, at the end of its range, or the cable is off"
            )
