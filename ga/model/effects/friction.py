"""The terms of friction, which dissipates energy in addition to Bc, and of inertia."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from ga.model.record import SCALE, STRENGTH, Mark, Parameter, Regressors, Term, searched

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ga.arrays import Array
    from ga.model.record import Bounds
    from ga.model.trajectory import Motion

MOST_FRICTION: Final = 0.9
"""The largest fraction of the torque that a tendon may lose in its sheath."""

PRETENSION: Final = 2.0
"""The largest distance from the motion at which the deflection without torque may lie, for a tendon under tension, in
ranges of the motion.
"""

FALLS: Final = (0.02, 1.5)
"""The smallest and the largest rate over which friction falls from its value at rest, relative to the rate that
dominates damping (`rate_of_damping`).
"""

TURNS: Final = (0.002, 0.6)
"""The smallest and the largest rate over which friction reverses smoothly, relative to the rate that dominates damping
(`rate_of_damping`). Above the largest, such friction equals damping.
"""

_SLOW: Final = 1e-4  # rate over vr, below which both forms of friction are in proportion to it


def _moving(rate: Array, smoothing: float) -> Array:
    import numpy as np

    return np.tanh(rate / smoothing) if smoothing > 0.0 else np.zeros_like(rate)


def _sign(regressors: Regressors) -> tuple[Array, ...]:
    return (_moving(regressors.motion.dtheta_dot, regressors.smoothing),)


def _loaded(angle: Array, motion: Motion, lag: float, smoothing: float, values: Array) -> Array:
    """Return the factor (n,) of the tendon's torque: 1 + mu while the tendon is pulled further, 1 - mu while it is
    released. lag: Bc/Kc, s.
    """
    import numpy as np

    rate = motion.dtheta_dot
    return np.asarray(1.0 + values[0] * _moving(rate, smoothing) * np.sign(angle + lag * rate))


def capstan_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    """Return the bounds of two parameters: the fraction of the torque that is friction, and the deflection, rad,
    without torque.
    """
    least, most = float(motion.dtheta.min()), float(motion.dtheta.max())
    beyond = PRETENSION * (most - least)
    return (0.0, MOST_FRICTION), (least - beyond, most + beyond)


def rate_of_damping(rate: Array) -> float:
    """Return the rate, rad/s, that dominates damping: the r.m.s. of rates (n,), weighted by their squares."""
    return float(((rate**4).sum() / (rate**2).sum()) ** 0.5) if rate.any() else 0.0


def over_rates(least: float, most: float) -> Bounds:
    """Return the bounds of a rate, rad/s, over which friction changes. least, most: the bounds relative to the rate
    `rate_of_damping`.
    """
    return lambda motion, _highest: (
        (least * rate_of_damping(motion.dtheta_dot), most * rate_of_damping(motion.dtheta_dot)),
    )


def _rooted(motion: Motion, columns: Mapping[Parameter, Array], values: Mapping[Parameter, float]) -> Array:
    """Return the torque (n,) of friction of the form v/sqrt(v^2 + vr^2), less the torque of friction of the form
    tanh(v/vr).
    """
    import numpy as np

    turned = np.maximum(np.abs(motion.dtheta_dot / values[SMOOTH.parameters[0]]), _SLOW)
    rubs = [one for one in columns if one.friction]
    friction = np.stack([columns[one] for one in rubs], axis=1) @ np.array([values[one] for one in rubs])
    return np.asarray(friction * (turned / np.hypot(1.0, turned) / np.tanh(turned) - 1.0))


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
    (Parameter("Fc", "N*m", "Coulomb friction", "dry friction", **STRENGTH),),
    columns=_sign,
    sticks=True,
    selection="considered",
    role="friction",
    bench="small",
    mark=Mark("coulomb", "dry friction", "try --model {coulomb}, or {smooth} where it turns gradually with the rate"),
    example="Fc 2, 10, 40 % of torque",
    equation="Fc*sign(v)",
)

FALLING: Final = searched("vst", "rad/s", "rate over which it falls", **SCALE, starts=(0.02, 0.1, 0.25, 0.5))

STRIBECK: Final = Term(
    "stribeck",
    "dry friction that is higher at low rates",
    (
        Parameter("Fs", "N*m", "by how much friction at rest is higher than at speed", "fall of friction", **STRENGTH),
        FALLING,
    ),
    columns=_falling,
    rates=_falling_on,
    bounds=over_rates(*FALLS),
    role="friction",
    needs="coulomb",
    example="Fs 2, 10, 30 % of torque; vst 2 rad/s",
    equation="Fs*exp(-(v/vst)^2)*sign(v)",
)

CAPSTAN: Final = Term(
    "capstan",
    "friction in proportion to the torque, as of a tendon in its sheath",
    (
        searched(
            "mu", "1", "part of the torque that is friction", "load share", **STRENGTH, starts=(0.05, 0.15, 0.3, 0.6)
        ),
        searched(
            "rest",
            "rad",
            "deflection at which the tendon carries no torque",
            "unloaded place",
            absent=None,
            starts=(0.2, 0.45, 0.5, 0.55, 0.8),
        ),
    ),
    bounds=capstan_bounds,
    remaining=lambda angle, values: angle - values[1],
    load=_loaded,
    role="load",
    mark=Mark(
        "capstan",
        "friction in proportion to the torque, as of a tendon in its sheath",
        "try --model {capstan}, {pulley} or {sheath}, beyond a gap {gear}, and record at several amplitudes",
    ),
    needs="offset",
    excludes=("backlash", "slack"),
    reason="where a gap is open, the tendon carries no torque that could make friction",
    sticks=True,
    example="mu 0.03, 0.1, 0.3; rest 5 % of stroke",
    equation="x counts from rest; springs and dampers are multiplied by 1 + mu*sign(v)*sign(tau)",
)

PULLEY: Final = replace(
    CAPSTAN,
    name="pulley",
    meaning="friction in proportion to the torque of the spring, with the damper beside it, as of a tendon over a "
    "pulley",
    load=lambda angle, motion, _lag, smoothing, values: _loaded(angle, motion, 0.0, smoothing, values),
    spares_dampers=True,
    mark=None,
    excludes=(*CAPSTAN.excludes, "capstan"),
    reason="capstan is the same with a damper in the tendon, and where a gap is open nothing rubs",
    equation="x counts from rest; springs are multiplied by 1 + mu*sign(v)*sign(x)",
)

SMOOTH: Final = Term(
    "smooth",
    "dry friction that turns smoothly with the rate, as of a lubricated joint",
    (
        searched(
            "vr", "rad/s", "rate over which it turns", "turning rate", **SCALE, starts=(0.005, 0.02, 0.1, 0.25, 0.5)
        ),
    ),
    bounds=over_rates(*TURNS),
    smooths=True,
    role="load",
    deviation=_rooted,
    needs="coulomb",
    or_needs=("capstan", "pulley"),
    example="vr 0.1, 0.5, 2 rad/s",
    equation="sign(v) is tanh(v/vr)",
)

QUADRATIC: Final = Term(
    "quadratic",
    "a damping that grows with the rate",
    (Parameter("B2", "N*m*s^2/rad^2", "quadratic damping", "growth of damping", **STRENGTH),),
    columns=lambda r: (r.motion.dtheta_dot * abs(r.motion.dtheta_dot) * r.contact,),
    rates=lambda r, c: (2.0 * abs(r.motion.dtheta_dot) * c.dtheta_dot * r.contact,),
    role="damping",
    mark=Mark(
        "quadratic-damping",
        "damping that rises with the rate",
        "try --model {quadratic}, and record at several amplitudes: Bc then rises with them",
    ),
    example="B2 2, 10, 40 % of torque",
    equation="B2*v*|v|",
)

INERTIA: Final = Term(
    "inertia",
    "an inertia that moves with the deflection",
    (Parameter("J", "kg*m^2", "inertia that moves with the deflection", "moment of inertia", **STRENGTH),),
    columns=lambda r: (r.motion.dtheta_ddot,),
    rates=lambda _r, c: (c.dtheta_ddot,),
    role="mass",
    mark=Mark("inertia", "an inertia in the torque", "try --model {inertia}, or set motor_inertia in the stand"),
    selection="motor torque",  # elsewhere it differs too little from skew
    bends=False,
    example="J 2, 10, 40 % of torque",
    equation="J*dv/dt",
)
