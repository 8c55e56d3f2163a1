"""The terms of friction, which dissipates energy in addition to Bc, and of inertia."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ga.model.record import Parameter, Regressors, Term

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ga.model.trajectory import Motion

    Array = NDArray[np.float64]

MOST_FRICTION: Final = 0.9
"""The largest fraction of the torque that a tendon may lose in its sheath."""

PRETENSION: Final = 2.0
"""The largest distance from the motion at which the deflection without torque may lie, for a tendon under tension, in
ranges of the motion.
"""

FALLS: Final = (0.02, 1.5)
"""The smallest and the largest rate over which friction falls from its value at rest, relative to the rate that
dominates damping (`felt`).
"""


TURNS: Final = (0.002, 0.6)
"""The smallest and the largest rate over which friction reverses smoothly, relative to the rate that dominates damping
(`felt`). Above the largest, such friction equals damping.
"""


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
    """Return the factor (n,) of the tendon's torque: 1 + mu while the tendon is pulled further, 1 - mu while it is
    released.
    """
    import numpy as np

    rate = motion.dtheta_dot
    moving = np.tanh(rate / smoothing) if smoothing > 0.0 else np.zeros_like(rate)
    return np.asarray(1.0 + values[0] * moving * np.sign(angle + lag * rate))


def capstan_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    """Return the bounds of two parameters: the fraction of the torque that is friction, and the deflection, rad,
    without torque.
    """
    least, most = float(motion.dtheta.min()), float(motion.dtheta.max())
    beyond = PRETENSION * (most - least)
    return (0.0, MOST_FRICTION), (least - beyond, most + beyond)


def felt(rate: Array) -> float:
    """Return the rate, rad/s, that dominates damping: the r.m.s. of rates (n,), weighted by their squares."""
    return float(((rate**4).sum() / (rate**2).sum()) ** 0.5) if rate.any() else 0.0


def stribeck_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    """Return the smallest and the largest rate, rad/s, over which friction falls."""
    usual = felt(motion.dtheta_dot)
    return ((FALLS[0] * usual, FALLS[1] * usual),)


def _falling(regressors: Regressors) -> tuple[Array, ...]:
    from ga.model.memory import falls

    (sign,) = _sign(regressors)
    return (sign * falls(regressors.motion.dtheta_dot, regressors.own[0]),)


def _falling_on(regressors: Regressors, changing: Motion) -> tuple[Array, ...]:
    (column,), rate = _falling(regressors), regressors.motion.dtheta_dot
    return (-2.0 * rate * changing.dtheta_dot / regressors.own[0] ** 2 * column,)


def turning_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    """Return the smallest and the largest rate, rad/s, over which friction reverses smoothly."""
    usual = felt(motion.dtheta_dot)
    return ((TURNS[0] * usual, TURNS[1] * usual),)


COULOMB: Final = Term(
    "coulomb",
    "dry friction",
    (Parameter("Fc", "N*m", "Coulomb friction", presence=True, friction=True, positive=True),),
    columns=_sign,
    rates=_still,
    sticks=True,
    equation="Fc*sign(v)",
)


def _rate_over(name: str, meaning: str, starts: tuple[float, ...]) -> Parameter:
    """Return the record of a parameter that is a rate, rad/s, over which friction changes.

    starts: its starting values, as fractions of its range.
    """
    return Parameter(name, "rad/s", meaning, scales=False, absent=None, positive=True, nonlinear=True, starts=starts)


FALLING: Final = _rate_over("vst", "rate over which it falls", (0.02, 0.1, 0.25, 0.5))

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
    equation="Fs*exp(-(v/vst)^2)*sign(v)",
)

SMOOTH: Final = Term(
    "smooth",
    "dry friction that turns smoothly with the rate, as of a lubricated joint",
    (_rate_over("vr", "rate over which friction turns", (0.005, 0.02, 0.1, 0.25, 0.5)),),
    bounds=turning_bounds,
    smooths=True,
    needs="coulomb",
    or_needs=("capstan", "pulley"),
    selection="misfit",
    equation="sign(v) is tanh(v/vr)",
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
    load=_loaded,
    needs="offset",
    excludes=("backlash", "slack"),
    reason="where a gap is open, the tendon carries no torque that could make friction",
    sticks=True,
    selection="misfit",
    equation="x counts from rest; springs and dampers are multiplied by 1 + mu*sign(v)*sign(tau)",
)

PULLEY: Final = Term(
    "pulley",
    "friction in proportion to the torque of the spring, with the damper beside it, as of a tendon over a pulley",
    CAPSTAN.parameters,
    bounds=capstan_bounds,
    remaining=CAPSTAN.remaining,
    load=lambda angle, motion, _lag, smoothing, values: _loaded(angle, motion, 0.0, smoothing, values),
    spares_dampers=True,
    needs="offset",
    excludes=(*CAPSTAN.excludes, "capstan"),
    reason="capstan is the same with a damper in the tendon, and where a gap is open nothing rubs",
    sticks=True,
    selection="misfit",
    equation="x counts from rest; springs are multiplied by 1 + mu*sign(v)*sign(x)",
)

QUADRATIC: Final = Term(
    "quadratic",
    "a damping that grows with the rate",
    (Parameter("B2", "N*m*s^2/rad^2", "quadratic damping", presence=True, positive=True, damping=True),),
    columns=_square,
    rates=_squaring,
    carried=True,
    selection="misfit",
    equation="B2*v*|v|",
)

INERTIA: Final = Term(
    "inertia",
    "an inertia that moves with the deflection",
    (Parameter("J", "kg*m^2", "inertia that moves with the deflection", presence=True, positive=True),),
    columns=lambda r: (r.motion.dtheta_ddot,),
    rates=lambda _r, c: (c.dtheta_ddot,),
    selection="motor torque",  # elsewhere it differs too little from skew
    bends=False,
    equation="J*dv/dt",
)
