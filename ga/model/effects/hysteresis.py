"""The terms of friction that builds up over a deflection after a reversal: such a torque depends on earlier samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ga.model.effects.friction import CAPSTAN, FALLING, FALLS, MOST_FRICTION, capstan_bounds, over_rates
from ga.model.record import Kind, Mark, Parameter, Regressors, Term, searched

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ga.model.trajectory import Motion

    Array = NDArray[np.float64]

REACHES: Final = (0.002, 0.8)
"""The smallest and the largest deflection over which friction builds up, as fractions of the range of the
deflection.
"""

MOST_RISE: Final = 2.0
"""The largest excess of friction at rest over friction at speed, as a fraction of friction at speed."""


def _dahl_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    span = float(motion.dtheta.max() - motion.dtheta.min())
    return ((REACHES[0] * span, REACHES[1] * span),)


def _building_up(regressors: Regressors, _changing: Motion) -> tuple[Array, ...]:
    import numpy as np

    (level,), reach = _presliding(regressors), float(regressors.own[-1])
    rate = regressors.motion.dtheta_dot
    return ((rate - np.abs(rate) * level) / reach,)


def _presliding(regressors: Regressors) -> tuple[Array, ...]:
    return (regressors.motion.presliding(float(regressors.own[-1])),)


def _yielding(regressors: Regressors) -> tuple[Array, ...]:
    return (regressors.motion.yielding(float(regressors.own[0])),)


def _yielding_on(regressors: Regressors, _changing: Motion) -> tuple[Array, ...]:
    import numpy as np

    (load,), length = _yielding(regressors), float(regressors.own[0])
    rate = regressors.motion.dtheta_dot
    return (rate * (1.0 - np.where(rate * load > 0.0, np.abs(load), 0.0)) / length,)


def _bristles(regressors: Regressors) -> tuple[Array, ...]:
    reach, rise, over = (float(value) for value in regressors.own)
    return (regressors.motion.bristles(reach, rise, over),)


def _bristles_on(regressors: Regressors, _changing: Motion) -> tuple[Array, ...]:
    import numpy as np

    from ga.model.memory import falls

    (load,), rate = _bristles(regressors), regressors.motion.dtheta_dot
    reach, rise, over = (float(value) for value in regressors.own)
    return ((rate - np.abs(rate) * load / (1.0 + rise * falls(rate, over))) / reach,)


def _loaded(angle: Array, motion: Motion, lag: float, _smoothing: float, values: Array) -> Array:
    """Return the factor (n,) of the carried torque: long after a reversal 1 + mu if the load grows, and 1 - mu if it
    falls.

    values: the term's parameters, mu first and reach last.
    """
    import numpy as np

    level = motion.presliding(float(values[-1]))
    return np.asarray(1.0 + values[0] * level * np.sign(angle + lag * motion.dtheta_dot))


def _loaded_at_first(motion: Motion, own: Array) -> Array:
    """Return the weight (n,) that the initial state of a piece still has at each sample, in proportion to the load.

    own: the term's parameters.
    """
    import numpy as np

    _, rest, reach = own
    return np.asarray(np.abs(motion.dtheta - rest) * motion.fading(motion.travelled, float(reach)))


def _over(name: str, about: str, kind: Kind) -> Parameter:
    """Return the record of a parameter that is a deflection, rad, over which a torque builds up after a reversal.
    about: its meaning.
    """
    starts = (0.005, 0.02, 0.06, 0.2, 0.6)
    return searched(name, "rad", about, kind, absent=None, positive=True, starts=starts)


_FRICTION: Final = Parameter(
    "Fd", "N*m", "friction long after a reversal", "presliding friction", presence=True, positive=True
)
_REACH: Final = _over("reach", "deflection after a reversal over which the friction builds up", "presliding length")
_MU, _REST = CAPSTAN.parameters

DAHL: Final = Term(
    "dahl",
    "dry friction that builds up over a deflection",
    (_FRICTION, _REACH),
    columns=_presliding,
    rates=_building_up,
    bounds=_dahl_bounds,
    forgets=lambda m, own: m.fading(m.travelled, float(own[0])),
    role="friction",
    mark=Mark(
        "hysteresis",
        "friction that builds up over a distance (LuGre, Bouc-Wen)",
        "try --model {dahl} or {boucwen}, and record two amplitudes: Kc then falls with the larger one",
        again=True,
    ),
    excludes=("coulomb",),
    reason="coulomb is dahl without the build-up",
    equation="Fd*z, dz/dt = (v - |v|*z)/reach",
)

LUGRE: Final = Term(
    "lugre",
    "dry friction that builds up over a deflection and is higher at low rates",
    (
        _FRICTION,
        _REACH,
        searched(
            "rise",
            "1",
            "part of the friction at speed by which it is higher at rest",
            "fall of friction",
            presence=True,
            positive=True,
            starts=(0.1, 0.4),
        ),
        FALLING,
    ),
    columns=_bristles,
    rates=_bristles_on,
    bounds=lambda m, highest: (*_dahl_bounds(m, highest), (0.0, MOST_RISE), *over_rates(*FALLS)(m, highest)),
    forgets=lambda m, own: m.fading(m.travelled, float(own[0])),
    role="friction",
    excludes=("coulomb", "dahl"),
    reason="coulomb and dahl are lugre without its fall or its build-up",
    equation="Fd*z, dz/dt = (v - |v|*z/(1 + rise*exp(-(v/vst)^2)))/reach",
)

BOUC_WEN: Final = Term(
    "boucwen",
    "a spring beside Kc that yields, as in hysteresis",
    (
        Parameter(
            "Fy",
            "N*m",
            "torque of the spring that yields, long after a reversal",
            "yielding friction",
            presence=True,
            positive=True,
        ),
        _over("yield", "deflection over which the spring yields", "yielding length"),
    ),
    columns=_yielding,
    rates=_yielding_on,
    bounds=_dahl_bounds,
    forgets=lambda m, own: m.fading(m.travelled, float(own[0])),
    role="friction",
    excludes=("coulomb", "dahl", "lugre"),
    reason="coulomb is boucwen without the build-up, and dahl and lugre are other laws of it",
    equation="Fy*z, dz/dt = v*(1 - |z| where z and v have one sign)/yield",
)

SHEATH: Final = Term(
    "sheath",
    "friction in proportion to the torque that builds up over a deflection, as of a tendon in its sheath",
    (_MU, _REST, _REACH),
    bounds=lambda m, highest: (*capstan_bounds(m, highest), *_dahl_bounds(m, highest)),
    remaining=CAPSTAN.remaining,
    load=_loaded,
    forgets=_loaded_at_first,
    role="load",
    repeats=True,
    needs="offset",
    excludes=(*CAPSTAN.excludes, "deadband", "capstan", "pulley", "dahl", "lugre", "boucwen"),
    reason="sheath is capstan with one law of build-up, and beside a gap its name is gear",
    equation="x counts from rest; springs and dampers are multiplied by 1 + mu*z*sign(tau), dz/dt = (v - |v|*z)/reach",
)

GEAR: Final = Term(
    "gear",
    "dry friction that builds up over a deflection and grows with the torque beyond a gap, as of a gear with play",
    (_FRICTION, _MU, _REACH),
    columns=_presliding,
    rates=_building_up,
    bounds=lambda m, highest: ((0.0, MOST_FRICTION), *_dahl_bounds(m, highest)),
    load=_loaded,
    forgets=lambda m, own: m.fading(m.travelled, float(own[-1])),
    role="load",
    needs="backlash",
    excludes=("coulomb", "dahl", "lugre", "boucwen", "capstan", "pulley", "sheath"),
    reason="coulomb, dahl, capstan and sheath are parts of gear, and lugre and boucwen are other laws of it",
    equation="Fd*z, dz/dt = (v - |v|*z)/reach; springs and dampers are multiplied by 1 + mu*z*sign(tau)",
)
