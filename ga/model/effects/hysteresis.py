"""The terms of friction that builds up over a deflection after a reversal: such a torque depends on earlier samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ga.model.effects.friction import CAPSTAN, MOST_FRICTION, capstan_bounds
from ga.model.record import SCALE, STRENGTH, Kind, Mark, Parameter, Regressors, Term, searched

if TYPE_CHECKING:
    from ga.arrays import Array
    from ga.model.trajectory import Motion

REACHES: Final = (0.002, 0.8)
"""The smallest and the largest deflection over which friction builds up, as fractions of the range of the
deflection.
"""

_LENGTHS: Final = (0.005, 0.02, 0.06, 0.2, 0.6)  # the starting values of that deflection


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


def _loaded(angle: Array, motion: Motion, lag: float, _smoothing: float, values: Array) -> Array:
    """Return the factor (n,) of the carried torque: long after a reversal 1 + mu if the load grows, and 1 - mu if it
    falls.

    values: the term's parameters, mu first and reach last.
    """
    import numpy as np

    level = motion.presliding(float(values[-1]))
    return np.asarray(1.0 + values[0] * level * np.sign(angle + lag * motion.dtheta_dot))


def _fading(motion: Motion, own: Array) -> Array:
    """Return the weight (n,), 1 to 0, that the initial state of its piece still has at each sample.

    own: the term's nonlinear parameters; the last is the deflection, rad, over which the friction builds up.
    """
    return motion.fading(motion.travelled, float(own[-1]))


def _loaded_at_first(motion: Motion, own: Array) -> Array:
    """Return the same weight (n,), in proportion to the load."""
    import numpy as np

    _, rest, _reach = own
    return np.asarray(np.abs(motion.dtheta - rest) * _fading(motion, own))


def _over(name: str, about: str, kind: Kind) -> Parameter:
    """Return the record of a parameter that is a deflection, rad, over which a torque builds up after a reversal.
    about: its meaning.
    """
    return searched(name, "rad", about, kind, **SCALE, starts=_LENGTHS)


_FRICTION: Final = Parameter("Fd", "N*m", "friction long after a reversal", "presliding friction", **STRENGTH)
_REACH: Final = _over("reach", "deflection after a reversal over which the friction builds up", "presliding length")
_MU, _REST = CAPSTAN.parameters

DAHL: Final = Term(
    "dahl",
    "dry friction that builds up over a deflection",
    (_FRICTION, _REACH),
    columns=_presliding,
    rates=_building_up,
    bounds=_dahl_bounds,
    forgets=_fading,
    role="friction",
    mark=Mark(
        "hysteresis",
        "friction that builds up over a distance (Dahl, Bouc-Wen)",
        "try --model {dahl} or {boucwen}, and record two amplitudes: Kc then falls with the larger one",
        again=True,
    ),
    excludes=("coulomb",),
    reason="coulomb is dahl without the build-up",
    example="Fd 2, 10, 40 % of torque; reach 5 % of stroke",
    equation="Fd*z, dz/dt = (v - |v|*z)/reach",
)

BOUC_WEN: Final = Term(
    "boucwen",
    "a spring beside Kc that yields, as in hysteresis",
    (
        Parameter(
            "Fy", "N*m", "torque of the spring that yields, long after a reversal", "yielding friction", **STRENGTH
        ),
        _over("yield", "deflection over which the spring yields", "yielding length"),
    ),
    columns=_yielding,
    rates=_yielding_on,
    bounds=_dahl_bounds,
    forgets=_fading,
    role="friction",
    excludes=("coulomb", "dahl"),
    reason="coulomb is boucwen without the build-up, and dahl is another law of it",
    example="Fy 2, 10, 40 % of torque; yield 5 % of stroke",
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
    excludes=(*CAPSTAN.excludes, "deadband", "capstan", "pulley", "dahl", "boucwen"),
    reason="sheath is capstan with one law of build-up, and beside a gap its name is gear",
    example="mu 0.03, 0.1, 0.3; rest 5 % of stroke; reach 5 % of stroke",
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
    forgets=_fading,
    role="load",
    needs="backlash",
    excludes=("coulomb", "dahl", "boucwen", "capstan", "pulley", "sheath"),
    reason="coulomb, dahl, capstan and sheath are parts of gear, and boucwen is another law of it",
    example="Fd 2, 10, 40 % of torque; mu 0.1; reach 5 % of stroke",
    equation="Fd*z, dz/dt = (v - |v|*z)/reach; springs and dampers are multiplied by 1 + mu*z*sign(tau)",
)
