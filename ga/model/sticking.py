"""Find the samples in which friction may hold the joint, and the motions in which its torque looks like that of a
spring.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from ga.arrays import Array, Index, Mask
from ga.model.trajectory import Motion

STUCK: Final = 0.075
"""The fraction of the samples, the slowest ones, in which friction may hold the joint, so that the sign of friction is
unknown.
"""

RESTS: Final = 10.0
QUIET: Final = 0.05
"""The joint rests if many samples are slower than RESTS times the rate's noise, provided that this rate is below QUIET
times the r.m.s. rate. In motion through zero at most 4 % of the samples are so slow.
"""

AT_REST: Final = 0.9
FROM_REST: Final = 0.01
"""Limits for the weight, in a low-passed sample, of samples in which friction may hold the joint.

Above AT_REST the joint rests; below FROM_REST the friction of these samples is negligible.
"""

_UNSURE: Final = 0.005
_UNLIKE: Final = 8.0
"""Two windows' slopes agree if they differ by less than _UNSURE times the r.m.s. value, or _UNLIKE times the usual
difference or noise.
"""

OFTEN: Final = 0.1
FROM_ONE_SIDE: Final = 0.8
"""Limits above which friction at rest has the torque of a spring.

OFTEN: for the fraction of each move (median) that is a rest. FROM_ONE_SIDE: for the correlation of the deflection at
rest with the direction of arrival.
"""

LATER: Final = 2
HIDDEN: Final = (125.0, 50.0)
OF_SPRING: Final = 0.5
"""Limits above which friction cannot be distinguished from a function of the deflections at several times.

LATER: the number of samples between two such deflections. HIDDEN: for two and for three deflections, the variance
inflation of friction above which friction is not distinguishable. OF_SPRING: the fraction of friction that is then
stiffness, at the ends of the range. With two deflections the inflation is 190 or more behind first-order drives
(filtering of the angle rounds the start of each move) and 90 or less behind second-order ones. With three it is 120 or
more behind second-order drives that hardly overshoot, and 17 or less in other motions.
"""

NOISY: Final = 0.5
FINEST: Final = 0.001
"""v_s of the Coulomb term is NOISY times the rate's noise, but at least FINEST and at most QUIET times the r.m.s. rate.

While friction slides, the term must equal the sign of the rate: if it is too small by 1.3 %, Bc is too small by 1.3 %.
"""

SIGNED: Final = 3.0
FULL: Final = 0.02
"""Friction has its full size above SIGNED times v_s, where the Coulomb term equals the sign of the rate (0.995 of it),
and above FULL times the r.m.s. rate.
"""


def slowest(motion: Motion) -> float:
    """Return the rate, rad/s, below which friction may hold the joint; 0 if noise hides which samples are so slow.

    At rest the sign of the measured rate is that of its noise, and as the joint comes to rest the Coulomb term falls
    earlier than friction does. The rate is derived from the data because rates differ by four decades between stands.
    """
    if not len(motion):
        return 0.0
    least, noise = float(np.quantile(np.abs(motion.dtheta_dot), STUCK)), motion.rate_noise or 0.0
    softest, quiet = max(SIGNED * smoothing(motion), FULL * _usual(motion)), QUIET * _usual(motion)
    if least > noise:
        return max(least, softest)
    return max(min(RESTS * noise, quiet), softest) if quiet > SIGNED * noise else 0.0


def smoothing(motion: Motion) -> float:
    """Return v_s of the Coulomb term, rad/s, for a motion: the rate over which the term changes its sign."""
    if not len(motion):
        return 0.0
    usual = _usual(motion)
    return float(np.clip(NOISY * (motion.rate_noise or 0.0), FINEST * usual, QUIET * usual))


def beyond_noise(apart: Array, values: Array, noise: float = 0.0) -> float:
    """Return the difference above which a motion is not smooth in a window, in the values' unit.

    apart (n,): the differences between derivatives of the deflection in two windows. values (n,): the derivative in one
    of them. noise: its standard deviation. Unknown values are NaN.
    """
    usual = float(np.sqrt(np.nanmean(values**2)))
    return max(_UNSURE * usual, _UNLIKE * max(float(np.nanmedian(apart)), noise))


def turns_unseen(motion: Motion) -> Mask:
    """Return the samples (n,) for which the computed rate has the wrong direction, because the joint reverses nearby.

    The rate is computed with a window. Where the acceleration jumps, the computed rate reverses before the joint does,
    and the friction of the samples between has the wrong sign. The slope from the previous to the next sample shows the
    true direction, if it is larger than noise.
    """
    whole, rows = motion.whole
    rate, near = whole.dtheta_dot, whole.dtheta_dot.copy()
    if len(whole) < 3:
        return np.zeros(len(motion), dtype=bool)
    inside = whole.stretch[2:] == whole.stretch[:-2]
    with np.errstate(divide="ignore", invalid="ignore"):  # stamps may be alike
        slope = (whole.dtheta[2:] - whole.dtheta[:-2]) / (whole.time[2:] - whole.time[:-2])
    near[1:-1] = np.where(inside & np.isfinite(slope), slope, near[1:-1])
    apart = np.abs(near - rate)
    sure = apart > beyond_noise(apart, rate, motion.rate_noise or 0.0)
    return np.asarray((near * rate < 0.0) & sure)[rows]


def beside_rest(motion: Motion, held: Mask) -> Mask:
    """Return the samples (n,) that contain friction from samples in which the joint rests, spread by the torque's
    filter.

    held (n,): whether friction may hold the joint. A reversal is short compared with the filter, and the size of
    friction is known on both sides of it.
    """
    if motion.behind is None or not held.any():
        return np.zeros(len(motion), dtype=bool)
    whole, rows = motion.whole
    still = np.zeros(len(whole))
    still[rows] = held
    run = np.cumsum(np.diff(still, prepend=0.0) != 0.0)
    resting = still * np.isin(run, run[whole.filtered(still) > AT_REST])
    return np.asarray(np.abs(whole.filtered(resting)) > FROM_REST)[rows]


def looks_like_spring(motion: Motion) -> bool:
    """Return whether friction at rest would have the torque of a spring in this motion.

    It would if the joint reaches one deflection from one side and another deflection from the other, as in a binary
    sequence. A chirp is slow only at the turning points of its slow end.
    """
    resting = _resting(motion)
    sign = _holding(motion, resting)
    move = _moves(sign)
    if not len(motion) or np.median(np.bincount(move, weights=resting) / np.bincount(move)) < OFTEN:
        return False
    side, place = sign[resting], motion.dtheta[resting]
    return bool(side.std() > 0.0 and place.std() > 0.0 and np.corrcoef(side, place)[0, 1] > FROM_ONE_SIDE)


def is_hidden(motion: Motion, *, inertia: bool = False) -> bool:
    """Return whether friction has, in the whole motion, the torque of stiffness and damping, or of these and an
    inertia.

    inertia: whether the model has an inertia or an early torque reading, which has the torque of damping and inertia.

    Friction has this torque behind a first-order drive that moves between two deflections: the rate is proportional to
    the remaining distance, and friction keeps its direction until the next step. The direction is then a linear
    function of the deflection, and of the deflection a few samples later. The rate itself is not used, because beside a
    step it depends on the window. Behind a second-order drive that hardly overshoots, the deflection after a few more
    samples is needed too.
    """
    whole, _ = motion.whole
    places = 3 if inertia else 2
    last = LATER * (places - 1)
    if len(whole) <= last or np.ptp(whole.dtheta) == 0.0:
        return False
    sign = _holding(whole, _resting(whole))
    move = _moves(sign) + whole.stretch
    alike = move[last:] == move[:-last]
    alike[:-1] &= alike[1:]  # when it turned is known to a sample
    if not alike.any():
        return False
    place, friction = whole.dtheta / (0.5 * np.ptp(whole.dtheta)), whole.filtered(sign)[:-last][alike]
    ways = [place]
    for _ in range(1, places):
        way = ways[-1][LATER:] - ways[-1][:-LATER]
        ways.append(way / max(float(way.std()), np.finfo(float).tiny))
    columns = np.stack([np.ones(len(place) - last), *(way[: len(place) - last] for way in ways)], axis=1)[alike]
    parts = np.linalg.lstsq(columns, friction, rcond=None)[0]
    return bool(parts[1] > OF_SPRING and HIDDEN[inertia] * np.var(friction - columns @ parts) < np.var(friction))


def _resting(motion: Motion) -> Mask:
    """Return the samples (n,) in which the joint is as slow as at rest."""
    return np.asarray(np.abs(motion.dtheta_dot) < max(slowest(motion), QUIET * _usual(motion)))


def _holding(motion: Motion, resting: Mask) -> Array:
    """Return the sign (n,) of friction, which keeps its direction while the joint rests. resting (n,): whether the
    joint rests.
    """
    last = np.maximum.accumulate(np.where(resting, 0, np.arange(len(motion))))  # the sample that moved before
    return np.asarray(np.sign(motion.dtheta_dot)[last])


def _moves(sign: Array) -> Index:
    """Return the number of the move (n,) that each sample belongs to; a rest belongs to the move before it. sign (n,):
    the direction of the move.
    """
    return np.cumsum(np.diff(sign, prepend=sign[:1]) != 0.0)


def _usual(motion: Motion) -> float:
    """Return the r.m.s. rate, rad/s."""
    return float(np.linalg.norm(motion.dtheta_dot) / np.sqrt(len(motion)))
