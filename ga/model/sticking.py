"""Where friction may hold the joint, and where it then cannot be distinguished from a spring."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ga.model.trajectory import Motion

    Array = NDArray[np.float64]

STUCK: Final = 0.075
"""Part of the samples, the slowest, in which friction may hold the joint and its sign is not known."""

RESTS: Final = 10.0
QUIET: Final = 0.05
"""Times the rate's noise, below which the joint rests where many samples are as slow, and part of the r.m.s. rate up to
which so much noise is little: a motion that passes through zero is that slow in 4 % of the samples or fewer."""

AT_REST: Final = 0.9
FROM_REST: Final = 0.01
"""Of what a low-pass makes of a sample, the part that comes from samples in which friction may hold the joint: from
which on the joint rests there, and up to which their friction does not matter."""

OFTEN: Final = 0.1
FROM_ONE_SIDE: Final = 0.8
"""Part of each move (the median) in which a joint rests, and the correlation of the place with the direction that it
came from, from which on the friction that holds it there has the torque of a spring."""

LATER: Final = 2
HIDDEN: Final = {2: 125.0, 3: 50.0}
OF_SPRING: Final = 0.5
"""Samples between two places; the variance inflation, by the number of places, from which friction cannot be
distinguished from a function of these; and the part of it that is then stiffness: of that at the ends of the range.
With two places it is 190 or more behind drives of first order (what the angle went through rounds the start of each
move), and 90 or less behind those of second order. With three it is 120 or more behind those of second order that
hardly overshoot, and 17 or less in other motions."""

NOISY: Final = 0.5
FINEST: Final = 0.001
SMOOTHEST: Final = 0.05
"""v_s of the Coulomb term as a part of the rate's noise, at least and at most these parts of the r.m.s. rate: a sign
where friction slides, for 1.3 % of softness takes as much off Bc."""

SIGNED: Final = 3.0
FULL: Final = 0.02
"""Times v_s, from which the Coulomb term is the sign of the rate: 0.995 of it; and part of the r.m.s. rate, from which
friction has its full size, however it comes to it."""


def slowest(motion: Motion) -> float:
    """Return the rate, rad/s, below which friction may hold the joint; zero where its noise hides which samples are.

    Where it rests, the sign of the rate is that of the noise, and where it comes to rest, the term is softer than
    friction. It is taken from the data because rates differ by four decades between stands.
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
    """Return v_s, rad/s, of the Coulomb term."""
    import numpy as np

    if not len(motion):
        return 0.0
    usual = _usual(motion)
    return float(np.clip(NOISY * (motion.rate_noise or 0.0), FINEST * usual, SMOOTHEST * usual))


def turns_unseen(motion: Motion) -> NDArray[np.bool_]:
    """Return whether (n,) the joint has turned already, or has not yet, where the rate says otherwise.

    The rate is that of a window. Where the acceleration jumps, the window turns before the joint does, and with it the
    friction of the samples between. The slope from one neighbour to the other tells, as far as noise does not make it.
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
    """Return whether (n,) what the torque went through brings a sample friction from where the joint rests.

    held (n,): whether friction may hold the joint. A reversal passes within what the low-pass resolves, and the size
    of friction is known on both sides of it.
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
    """Return whether friction that holds the joint where it rests would have the torque of a spring there.

    So it has where the joint comes to one place from one side and to another from the other, as in a binary sequence.
    A chirp is slow at the turning points of its slow end only.
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
    """Return whether friction has the torque of more stiffness and damping, or of these and an inertia, in all of it.

    inertia: or a torque that is read early, whose difference has the torque of damping and an inertia.

    So it has behind a drive of first order between two places: its rate is in proportion to the way that is left, and
    friction holds the direction until the next step. The direction is then a linear function of where the joint is, and
    where it is a few samples later. The rate would not do: beside a step it depends on the window. Behind a drive of
    second order that hardly overshoots, where it is another few samples later belongs to it.
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
    """In which samples (n,) the joint is as slow as where it rests."""
    import numpy as np

    return np.asarray(np.abs(motion.dtheta_dot) < max(slowest(motion), QUIET * _usual(motion)))


def _holding(motion: Motion, resting: NDArray[np.bool_]) -> Array:
    """The sign (n,) of friction that keeps its direction while the joint is resting (n,)."""
    import numpy as np

    last = np.maximum.accumulate(np.where(resting, 0, np.arange(len(motion))))  # the sample that moved before
    return np.asarray(np.sign(motion.dtheta_dot)[last])


def _moves(sign: Array) -> NDArray[np.int64]:
    """The number of the move (n,) that each sample is in; a rest belongs to the move before it."""
    import numpy as np

    return np.cumsum(np.diff(sign, prepend=sign[:1]) != 0.0)


def _usual(motion: Motion) -> float:
    """The r.m.s. rate, rad/s."""
    import numpy as np

    return float(np.linalg.norm(motion.dtheta_dot) / np.sqrt(len(motion)))
