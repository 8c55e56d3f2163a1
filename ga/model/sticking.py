"""Where friction may hold the joint, and where its torque cannot be distinguished from that of a spring."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ga.model.trajectory import Motion

    Array = NDArray[np.float64]

STUCK: Final = 0.075
"""The fraction of the samples, the slowest, in which friction may hold the joint, so that its sign is unknown."""

RESTS: Final = 10.0
QUIET: Final = 0.05
"""The joint rests where many samples are slower than this many times the rate's noise, if that is below this fraction
of the r.m.s. rate. In motion through zero at most 4 % of the samples are so slow.
"""

AT_REST: Final = 0.9
FROM_REST: Final = 0.01
"""The weight, in a low-passed sample, of samples in which friction may hold the joint: above the first the joint rests,
below the second their friction is negligible.
"""

OFTEN: Final = 0.1
FROM_ONE_SIDE: Final = 0.8
"""The fraction of each move (median) that is a rest, and the correlation of the place with the direction of arrival,
above which friction at rest has the torque of a spring.
"""

LATER: Final = 2
HIDDEN: Final = {2: 125.0, 3: 50.0}
OF_SPRING: Final = 0.5
"""Samples between two places; and for each number of places the variance inflation above which friction cannot be
distinguished from a function of them, and the fraction of it that is then stiffness, at the ends of the range. With
two places the inflation is 190 or more behind first-order drives (filtering of the angle rounds the start of each
move) and 90 or less behind second-order ones. With three it is 120 or more behind second-order drives that hardly
overshoot, and 17 or less in other motions.
"""

NOISY: Final = 0.5
FINEST: Final = 0.001
SMOOTHEST: Final = 0.05
"""v_s of the Coulomb term, relative to the rate's noise, and its limits relative to the r.m.s. rate. It must be a sign
where friction slides: 1.3 % of softness takes 1.3 % off Bc.
"""

SIGNED: Final = 3.0
FULL: Final = 0.02
"""The rate, in multiples of v_s, from which the Coulomb term equals the sign of the rate (0.995 of it); and the
fraction of the r.m.s. rate above which friction has its full size.
"""


def slowest(motion: Motion) -> float:
    """Return the rate, rad/s, below which friction may hold the joint; 0 if noise hides which samples these are.

    At rest the sign of the rate is that of its noise, and as the joint comes to rest the term is softer than friction.
    The rate is taken from the data because rates differ by four decades between stands.
    """
    import numpy as np

    if not len(motion):
        return 0.0
    least, noise = float(np.quantile(np.abs(motion.dtheta_dot), STUCK)), motion.rate_noise or 0.0
    softest, quiet = max(SIGNED * smoothing(motion), FULL * _usual(motion)), QUIET * _usual(motion)
    if least > noise:
        return max(least, softest)
    return max(min(RESTS * noise, quiet), softest) if quiet > SIGNED * noise else 0.0


def smoothing(motion: Motion) -> float:
    """Return v_s of the Coulomb term, rad/s."""
    import numpy as np

    if not len(motion):
        return 0.0
    usual = _usual(motion)
    return float(np.clip(NOISY * (motion.rate_noise or 0.0), FINEST * usual, SMOOTHEST * usual))


def turns_unseen(motion: Motion) -> NDArray[np.bool_]:
    """Return for which samples (n,) the computed rate has the wrong direction, because the joint reverses there.

    The rate is that of a window. Where the acceleration jumps, the window reverses before the joint does, and the
    friction of the samples between has the wrong sign. The slope from one neighbour to the other shows it, as far as
    noise allows.
    """
    import numpy as np

    from ga.model.trajectory import beyond_noise

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


def beside_rest(motion: Motion, held: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which samples (n,) contain friction from where the joint rests, spread by the torque's filter.

    held (n,): whether friction may hold the joint. A reversal is short compared with the filter, and the size of
    friction is known on both sides of it.
    """
    import numpy as np

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

    It does if the joint reaches one place from one side and another place from the other, as in a binary sequence. A
    chirp is slow only at the turning points of its slow end.
    """
    import numpy as np

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

    inertia: whether the model has one, or an early torque reading, which differs by the torque of damping and inertia.

    It does behind a first-order drive that moves between two places: the rate is proportional to the remaining way, and
    friction keeps its direction until the next step. The direction is then a linear function of the place, and of the
    place a few samples later. The rate itself is not used, because beside a step it depends on the window. Behind a
    second-order drive that hardly overshoots, the place after a few more samples is needed too.
    """
    import numpy as np

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
    return bool(parts[1] > OF_SPRING and HIDDEN[places] * np.var(friction - columns @ parts) < np.var(friction))


def _resting(motion: Motion) -> NDArray[np.bool_]:
    """Return the samples (n,) in which the joint is as slow as at rest."""
    import numpy as np

    return np.asarray(np.abs(motion.dtheta_dot) < max(slowest(motion), QUIET * _usual(motion)))


def _holding(motion: Motion, resting: NDArray[np.bool_]) -> Array:
    """Return the sign (n,) of friction that keeps its direction while the joint rests (n,)."""
    import numpy as np

    last = np.maximum.accumulate(np.where(resting, 0, np.arange(len(motion))))  # the sample that moved before
    return np.asarray(np.sign(motion.dtheta_dot)[last])


def _moves(sign: Array) -> NDArray[np.int64]:
    """Return the number of the move (n,) that each sample belongs to; a rest belongs to the move before it."""
    import numpy as np

    return np.cumsum(np.diff(sign, prepend=sign[:1]) != 0.0)


def _usual(motion: Motion) -> float:
    """Return the r.m.s. rate, rad/s."""
    import numpy as np

    return float(np.linalg.norm(motion.dtheta_dot) / np.sqrt(len(motion)))
