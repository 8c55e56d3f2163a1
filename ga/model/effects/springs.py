"""The terms that store the coupling's energy: springs and Maxwell branches.

Kc is the relaxed stiffness: with Maxwell branches, the stiffness that remains long after a step.
"""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING, Any, Final

from ga.model.effects.gaps import GAPS, extent
from ga.model.effects.sensors import settling
from ga.model.record import STRENGTH, Mark, Parameter, Regressors, Term, searched

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from ga.arrays import Array
    from ga.model.trajectory import Motion

LONGEST_RELAXATION: Final = 10.0
"""The longest relaxation time of a Maxwell branch: in s, and as a fraction of the recording. See also
`LONGEST_ONCE`.
"""

LONGEST_ONCE: Final = 0.5
"""The longest relaxation time of a Maxwell branch, s, for a motion that does not repeat: there a slower branch looks
like friction or a drift.
"""

STEEPEST: Final = 6.0
"""The largest product of exponent and deflection: at that deflection the stiffness rises e^6 times as fast as at
rest.
"""

SHORTEST_RELAXATION: Final = 0.02
"""The shortest relaxation time of a Maxwell branch, in shortest periods of the motion: a branch with a shorter time
equals a damping.
"""

_TIMES: Final = (0.0002, 0.0007, 0.002, 0.007, 0.02, 0.07, 0.2, 0.6)  # the starting values of a relaxation time

_SMALL_STRETCH: Final = 1e-3  # below which the first powers of an exponential are enough


def _turn_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    least, span = extent(motion)
    return ((least, least + span),)


def _relaxation_bounds(motion: Motion, highest: float) -> tuple[tuple[float, float], ...]:
    longest, part = (LONGEST_RELAXATION, 0.5) if motion.repeats else (LONGEST_ONCE, 0.1)
    longest = min(longest, part * float(motion.time[-1] - motion.time[0]))
    shortest = min(SHORTEST_RELAXATION / highest, 0.5 * longest)
    return ((shortest, longest),)


def _furthest(motion: Motion) -> float:
    least, span = extent(motion)
    return max(abs(least), abs(least + span))


def _of_power(degree: int) -> dict[str, Any]:
    """Return `columns` and `pushed` of a spring whose torque is a power of the deflection, as keywords of its term."""

    def raised(angle: Array, power: int) -> Array:
        import numpy as np

        squares = [angle**2] * (power // 2)  # a cube takes thirty times as long as a square
        return np.asarray(prod([*squares, angle] if power % 2 else squares))

    def pushed(regressors: Regressors, genes: Array, moved: Array) -> Array:
        change: Array = degree * genes[0] * raised(regressors.angle, degree - 1) * moved
        return change

    return {"columns": lambda r: (raised(r.angle, degree),), "pushed": pushed}


def _rising(rise: Callable[[Regressors], Array]) -> Callable[[Regressors, Array, Array], Array]:
    """Return `pushed` of a stiffness that rises by twice the parameter times `rise`, rad."""
    return lambda regressors, genes, moved: 2.0 * genes[0] * rise(regressors) * moved


def _risen(angle: Array, own: Array) -> Array:
    """Return the rise of an exponential stiffness per unit: (e^u - 1)/exponent, rad, with u = exponent x angle, at
    angles (n,), rad. own (1,): the exponent, 1/rad.
    """
    import numpy as np

    (exponent,) = own.tolist()
    return angle if exponent == 0.0 else np.expm1(exponent * angle) / exponent


def _lifted(angle: Array, own: Array) -> Array:
    """Return the torque of an exponential stiffness per unit: 2 (e^u - 1 - u)/exponent^2 (n,), rad^2, which is angle^2
    for small u = exponent x angle. own (1,): the exponent, 1/rad.
    """
    import numpy as np

    (exponent,) = own.tolist()
    stretch = exponent * angle
    small = np.abs(stretch) < _SMALL_STRETCH
    whole = np.where(small, 1.0, stretch)
    ratio = np.where(small, 1.0 + stretch / 3.0 * (1.0 + stretch / 4.0), 2.0 * (np.expm1(whole) - whole) / whole**2)
    return np.asarray(ratio * angle**2)


def _exponential(regressors: Regressors) -> tuple[Array, ...]:
    import numpy as np

    angle = regressors.angle
    return (np.sign(angle) * _lifted(np.abs(angle), regressors.own),)


def _departing_by_square(parameter: Parameter) -> Callable[..., Array]:
    """Return `Term.deviation` of a spring, by which a real one departs from its law: the column of `parameter` times
    the deflection squared.
    """

    def deviation(motion: Motion, columns: Mapping[Parameter, Array], _values: Mapping[Parameter, float]) -> Array:
        return columns[parameter] * motion.dtheta**2

    return deviation


def _gapped(motion: Motion, _columns: Mapping[Parameter, Array], _values: Mapping[Parameter, float]) -> Array:
    """Return the sign (n,) of the deflection: what a gap narrower than the noise takes off the torque."""
    import numpy as np

    return np.sign(motion.dtheta)


def _turning(regressors: Regressors, changing: Motion) -> tuple[Array, ...]:
    import numpy as np

    return (np.sign(regressors.angle - regressors.own) * changing.dtheta * regressors.contact,)


def _unrelaxed(regressors: Regressors, values: Array) -> Array:
    """Return values (n,) computed from the deflection, less the part that a Maxwell branch has relaxed."""
    return values - regressors.motion.lagged(values, float(regressors.own[0]))


def _relaxing(regressors: Regressors, changing: Motion) -> tuple[Array, ...]:
    return (changing.dtheta * regressors.contact - _unrelaxed(regressors, regressors.angle) / regressors.own[0],)


_VISCOELASTIC: Final = Mark(
    "viscoelastic",
    "a viscoelastic coupling, whose stiffness rises with frequency",
    "try --model {maxwell}, read K'(f) and B'(f) with --verbose, or record the band that matters",
    again=True,
)


def _branch(number: int, needs: str, example: str) -> Term:
    """Return the term of one Maxwell branch: a spring and a damper in series, parallel to Kc and Bc."""
    return Term(
        "maxwell" if number == 1 else f"maxwell{number}",
        "a viscoelastic branch: a spring in series with a damper" if number == 1 else "another viscoelastic branch",
        (
            Parameter(f"K{number}", "N*m/rad", "stiffness that relaxes", "relaxing stiffness", **STRENGTH),
            searched(
                f"tau{number}",
                "s",
                "time in which it relaxes",
                "relaxation time",
                absent=None,
                positive=True,
                open_ended=True,
                starts=_TIMES,
            ),
        ),
        columns=lambda r: (_unrelaxed(r, r.angle),),
        rates=_relaxing,
        pushed=lambda r, genes, moved: genes[0] * _unrelaxed(r, moved),
        bounds=_relaxation_bounds,
        forgets=settling,
        role="branch",
        mark=None if needs else _VISCOELASTIC,
        needs=needs,
        bends=False,
        example=example,
        equation=f"K{number}*(x - y{number}), tau{number}*dy{number}/dt = x - y{number}",
    )


_KC: Final = Parameter("Kc", "N*m/rad", "stiffness of the coupling", positive=True)
_K5: Final = Parameter("K5", "N*m/rad^5", "quintic stiffness", presence=True)

LINEAR: Final = Term(
    "linear",
    "a spring Kc and a damper Bc in parallel",
    (
        _KC,
        Parameter("Bc", "N*m*s/rad", "damping of the coupling", "damping", positive=True),
    ),
    columns=lambda r: (r.angle, r.motion.dtheta_dot * r.contact),
    rates=lambda r, c: (c.dtheta * r.contact, c.dtheta_dot * r.contact),
    pushed=lambda _r, genes, moved: genes[0] * moved,
    role="coupling",
    selection="smallest",
    bends=False,
    example="Kc 0.01775 N*m/rad; Bc 0.06e-3, 0.19e-3, 0.6e-3 N*m*s/rad",
    equation="Kc*x + Bc*v",
)

CUBIC: Final = Term(
    "cubic",
    "a spring that stiffens",
    (Parameter("K3", "N*m/rad^3", "cubic stiffness", presence=True),),
    **_of_power(3),
    deviation=_gapped,
    confusable=GAPS,
    selection="considered",
    role="curve",
    mark=Mark("cubic", "a spring that stiffens", "try --model {cubic}, {exponential} or {toe}"),
    example="K3 2, 10, 40 % of torque",
    equation="K3*x^3",
)

QUINTIC: Final = Term(
    "quintic",
    "a spring that stiffens other than by a cubic",
    (_K5,),
    **_of_power(5),
    needs="cubic",
    role="curve",
    deviation=_departing_by_square(_K5),
    example="K5 2, 10, 40 % of torque",
    equation="K5*x^5",
)

_ASYMMETRY: Final = Mark(
    "asymmetry",
    "a stiffness that differs between the two directions",
    "try --model {asymmetric} or {progressive}; for a single tendon {slack}",
)

ASYMMETRIC: Final = Term(
    "asymmetric",
    "a spring that is stiffer in one direction",
    (
        Parameter("Ka", "N*m/rad", "half the difference of the two; Kc is their mean", "side stiffness", presence=True),
        searched("turn", "rad", "deflection at which the stiffness changes", "side place", absent=None),
    ),
    columns=lambda r: (abs(r.angle - r.own),),
    rates=_turning,
    bounds=_turn_bounds,
    role="curve",
    mark=_ASYMMETRY,
    needs="offset",
    excludes=GAPS,
    reason="a gap has its own flanks, whose stiffness is one (asymmetric)",
    breaks=True,
    example="Ka 2, 10, 40 % of torque; turn 0",
    equation="Ka*|x - turn|",
)

PROGRESSIVE: Final = Term(
    "progressive",
    "a stiffness that rises steadily in one direction",
    (Parameter("Kp", "N*m/rad^2", "half of what the stiffness rises by in a radian", presence=True),),
    **_of_power(2),
    role="curve",
    mark=_ASYMMETRY,
    needs="offset",
    example="Kp 2, 10, 40 % of torque",
    equation="Kp*x^2",
)

_RISE: Final = Parameter("Kh", "N*m/rad^2", "half of what the stiffness rises by in a radian", presence=True)

HARDENING: Final = Term(
    "hardening",
    "a stiffness that rises steadily in both directions",
    (_RISE,),
    columns=lambda r: (r.angle * abs(r.angle),),
    pushed=_rising(lambda r: abs(r.angle)),
    role="curve",
    seldom=True,  # it has a kink where the joint is unloaded
    example="Kh 2, 10, 40 % of torque",
    equation="Kh*x*|x|",
)

_EXPONENT: Final = searched("exponent", "1/rad", "in 1/exponent the rise of stiffness grows e-fold", "exponent")
_POWERS: Final = ("cubic", "quintic", "hardening")
_REASON: Final = "an exponential has all powers of the deflection, and begins with hardening or progressive"

EXPONENTIAL: Final = Term(
    "exponential",
    "a stiffness that rises exponentially in both directions",
    (_RISE, _EXPONENT),
    columns=_exponential,
    pushed=_rising(lambda r: _risen(abs(r.angle), r.own)),
    bounds=lambda m, _highest: ((0.0, STEEPEST / _furthest(m)),),
    role="curve",
    deviation=_departing_by_square(_KC),
    excludes=_POWERS,
    reason=_REASON,
    example="Kh 5, 20, 80 % of torque; exponent 4 1/rad",
    equation="2*Kh*sign(x)*(exp(u) - 1 - u)/exponent^2, u = exponent*|x|",
)

TOE: Final = Term(
    "toe",
    "a stiffness that rises exponentially in one direction, as that of a tendon at first",
    (*PROGRESSIVE.parameters, _EXPONENT),
    columns=lambda r: (_lifted(r.angle, r.own),),
    pushed=_rising(lambda r: _risen(r.angle, r.own)),
    bounds=lambda m, _highest: ((-STEEPEST / _furthest(m), STEEPEST / _furthest(m)),),
    role="curve",
    deviation=_departing_by_square(_KC),
    needs="offset",
    excludes=(*_POWERS, "progressive", "exponential"),
    reason=_REASON,
    example="Kp 5, 20, 80 % of torque; exponent 4 1/rad",
    equation="2*Kp*(exp(u) - 1 - u)/exponent^2, u = exponent*x",
)

SOFTENING: Final = Term(
    "softening",
    "a stiffness that drifts in time",
    (Parameter("Ks", "N*m/rad/s", "change of the stiffness in a second; Kc is its mean", presence=True),),
    columns=lambda r: ((r.time - r.middle) * r.angle,),
    pushed=lambda r, genes, moved: genes * (r.time - r.middle) * moved,
    role="change",
    repeats=True,
    mark=Mark(
        "stiffness-drift",
        "a stiffness that changes during the recording",
        "try --model {softening}, or record for longer at one temperature",
    ),
    example="Ks 2, 10, 30 % of torque",
    equation="Ks*(t - tm)*x, tm: the middle of the recording",
)

MAXWELL: Final = _branch(1, "", "K1 5, 20, 100 % of torque; tau1 0.02 s")
MAXWELL2: Final = _branch(2, "maxwell", "K2 5, 20, 100 % of torque; tau2 0.3 s")
