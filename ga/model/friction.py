"""The terms that lose the coupling's energy at once, beside Bc, and inertia."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ga.model.record import Parameter, Regressors, Term

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ga.model.trajectory import Motion

    Array = NDArray[np.float64]

MOST_FRICTION: Final = 0.9
"""Part of the torque that a tendon may lose in its sheath."""

PRETENSION: Final = 2.0
"""Times the range of the motion, by which a tendon under tension may be pulled beyond where it carries no torque."""

FALLS: Final = (0.02, 1.5)
"""Rate over which friction falls from its value at rest, as a part of the rate of which damping is felt, at least and
at most."""

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
HIDDEN: Final = 125.0
OF_SPRING: Final = 0.5
"""Samples between two places, the variance inflation from which friction cannot be distinguished from a function of the
two, and the part of it that is then stiffness: of that at the ends of the range. Behind drives of first order it is
190 or more (what the angle went through rounds the start of each move), behind those of second order 90 or less. With
a third place it is 147 or more behind those of second order that hardly overshoot, and 17 or less in other motions."""

NOISY: Final = 0.5
FINEST: Final = 0.001
SMOOTHEST: Final = 0.05
"""v_s of the Coulomb term as a part of the rate's noise, at least and at most these parts of the r.m.s. rate: a sign
where friction slides, for 1.3 % of softness takes as much off Bc."""

SIGNED: Final = 3.0
"""Times v_s, from which the Coulomb term is the sign of the rate: 0.995 of it."""


def slowest(motion: Motion) -> float:
    """Return the rate, rad/s, below which friction may hold the joint; zero where its noise hides which samples are.

    Where it rests, the sign of the rate is that of the noise, and where it comes to rest, the term is softer than
    friction. It is taken from the data because rates differ by four decades between stands.
    """
    import numpy as np

    if not len(motion):
        return 0.0
    least, noise = float(np.quantile(np.abs(motion.dtheta_dot), STUCK)), motion.rate_noise or 0.0
    softest, quiet = SIGNED * smoothing(motion), QUIET * _usual(motion)
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
    return bool(parts[1] > OF_SPRING and HIDDEN * np.var(friction - columns @ parts) < np.var(friction))


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


def _sign(regressors: Regressors) -> tuple[Array, ...]:
    import numpy as np

    rate, smoothing = regressors.motion.dtheta_dot, regressors.smoothing
    return (np.tanh(rate / smoothing) if smoothing > 0.0 else np.zeros_like(rate),)


def _still(regressors: Regressors, _changing: Motion) -> tuple[Array, ...]:
    import numpy as np

    return (np.zeros_like(regressors.angle),)


def _square(regressors: Regressors) -> tuple[Array, ...]:
    import numpy as np

    rate = regressors.motion.dtheta_dot
    return (rate * np.abs(rate) * regressors.contact,)


def _squaring(regressors: Regressors, changing: Motion) -> tuple[Array, ...]:
    import numpy as np

    return (2.0 * np.abs(regressors.motion.dtheta_dot) * changing.dtheta_dot * regressors.contact,)


def _loaded(angle: Array, motion: Motion, lag: float, smoothing: float, values: Array) -> Array:
    """1 + mu where the tendon is pulled further, 1 - mu where it is let back."""
    import numpy as np

    rate = motion.dtheta_dot
    moving = np.tanh(rate / smoothing) if smoothing > 0.0 else np.zeros_like(rate)
    return np.asarray(1.0 + values[0] * moving * np.sign(angle + lag * rate))


def capstan_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    """Return the least and the largest part of the torque that is friction, and place, rad, that carries none."""
    least, most = float(motion.dtheta.min()), float(motion.dtheta.max())
    beyond = PRETENSION * (most - least)
    return (0.0, MOST_FRICTION), (least - beyond, most + beyond)


def felt(rate: Array) -> float:
    """Return the rate, rad/s, of which damping is felt: the r.m.s. of rates (n,), weighed by their squares."""
    return float(((rate**4).sum() / (rate**2).sum()) ** 0.5) if rate.any() else 0.0


def stribeck_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    """Return the least and the largest rate, rad/s, over which friction falls."""
    usual = felt(motion.dtheta_dot)
    return ((FALLS[0] * usual, FALLS[1] * usual),)


def _falling(regressors: Regressors) -> tuple[Array, ...]:
    from ga.model.memory import falls

    (sign,) = _sign(regressors)
    return (sign * falls(regressors.motion.dtheta_dot, regressors.own[0]),)


def _falling_on(regressors: Regressors, changing: Motion) -> tuple[Array, ...]:
    (column,), rate = _falling(regressors), regressors.motion.dtheta_dot
    return (-2.0 * rate * changing.dtheta_dot / regressors.own[0] ** 2 * column,)


COULOMB: Final = Term(
    "coulomb",
    "dry friction",
    (Parameter("Fc", "N*m", "Coulomb friction", presence=True, friction=True, positive=True),),
    columns=_sign,
    rates=_still,
    sticks=True,
)

FALLING: Final = Parameter(
    "vst",
    "rad/s",
    "rate over which it falls",
    scales=False,
    absent=None,
    positive=True,
    nonlinear=True,
    starts=(0.02, 0.1, 0.25, 0.5),
)

STRIBECK: Final = Term(
    "stribeck",
    "dry friction that is higher at low rates",
    (
        Parameter(
            "Fs",
            "N*m",
            "by how much friction at rest is higher than at speed",
            presence=True,
            friction=True,
            positive=True,
        ),
        FALLING,
    ),
    columns=_falling,
    rates=_falling_on,
    bounds=stribeck_bounds,
    needs="coulomb",
    selection="misfit",
)

CAPSTAN: Final = Term(
    "capstan",
    "friction in proportion to the torque, as of a tendon in its sheath",
    (
        Parameter(
            "mu",
            "1",
            "part of the torque that is friction",
            scales=False,
            presence=True,
            friction=True,
            positive=True,
            nonlinear=True,
            starts=(0.05, 0.15, 0.3, 0.6),
        ),
        Parameter(
            "rest",
            "rad",
            "deflection at which the tendon carries no torque",
            scales=False,
            absent=None,
            nonlinear=True,
            starts=(0.2, 0.45, 0.5, 0.55, 0.8),
            place=True,
        ),
    ),
    bounds=capstan_bounds,
    remaining=lambda angle, values: angle - values[1],
    contact=_loaded,
    needs="offset",
    excludes=("backlash", "deadband", "slack"),
    reason="where a gap is open, the tendon carries no torque that could make friction",
    sticks=True,
    selection="misfit",
)

QUADRATIC: Final = Term(
    "quadratic",
    "a damping that grows with the rate",
    (Parameter("B2", "N*m*s^2/rad^2", "quadratic damping", presence=True, positive=True),),
    columns=_square,
    rates=_squaring,
    selection="misfit",
)

INERTIA: Final = Term(
    "inertia",
    "an inertia that moves with the deflection",
    (Parameter("J", "kg*m^2", "inertia that moves with the deflection", presence=True, positive=True),),
    columns=lambda r: (r.motion.dtheta_ddot,),
    rates=lambda _r, c: (c.dtheta_ddot,),
    selection="motor torque",  # elsewhere it differs too little from skew
    bends=False,
)
