"""The table of coupling terms: all that the models, the fits, the predictions and the command line know of each.

A linear term adds columns to the model, whose factors are solved for exactly. A nonlinear term changes the motion that
all columns are made of: it delays it, or takes a part of the deflection away. Nothing here imports numpy before a
column is computed, because the command line reads its help from this table.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np
    from numpy.typing import NDArray

    from ga.model.trajectory import Motion

    Array = NDArray[np.float64]

LONGEST_SKEW: Final = 0.02
"""s between two readings of one tick, at most."""

WIDEST_GAP: Final = 0.95
"""Part of the whole deflection that a gap or slack may take."""

ANYWHERE: Final = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Starting values of a nonlinear parameter of which nothing is known, as parts of its range."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a model: its name, its SI unit and its meaning.

    scales: whether it is proportional to the torque. absent: the value that removes it from the model, None where none
    does. presence: whether its presence is in question, so that it is identifiable only if its interval excludes
    `absent`. friction: whether its torque turns with the motion.
    Of nonlinear parameters: starts, values to begin at as parts of the range; kinked, whether the torque has breaks
    where it ends; refined, whether breaks make the fitness rough along it; about, the parameter that is the middle
    between the two ends that this one moves.
    """

    name: str
    unit: str
    meaning: str
    scales: bool = True
    absent: float | None = 0.0
    presence: bool = False
    friction: bool = False
    starts: tuple[float, ...] = ANYWHERE
    kinked: bool = False
    refined: bool = False
    about: str = ""


@dataclass(frozen=True, slots=True)
class Regressors:
    """The signals (n,) that columns are made of.

    time: s since the model's origin. motion: as the torque reading saw it. angle: rad, the deflection beyond gap or
    slack, 0 out of contact. contact: 1 or 0. smoothing: rad/s, the v_s of friction.
    """

    time: Array
    motion: Motion
    angle: Array
    contact: Array
    smoothing: float


@dataclass(frozen=True, slots=True)
class Term:
    """One term of the coupling: a record in `TERMS`.

    meaning: for the help. A linear term gives columns, each (n,), N m per unit of its parameters in their order; rates,
    how fast these change, per second, where the motion changes as the second argument says; and stiffness, N m/rad, how
    its torque changes with the deflection for given parameters, None where it does not.
    A nonlinear term gives bounds, low and high of each parameter for motion up to so many Hz; and either delays the
    motion by its parameter, or gives remaining, the deflection (n,) that its parameters leave, and shifts, how much of
    the deflection is taken away per unit of each.
    needs: the term without which it means nothing. excludes: the term that it cannot stand beside, and why.
    breaks: whether the torque has breaks in it. confusable: terms beside which it must pay as much as one with breaks,
    because it can pass for a part of them. sticks: whether friction holds the joint where it is slow.
    unilateral: whether the flanks can only push. selection: in the smallest model that `auto` begins with, among the
    terms that it considers, or among them only where the torque is the motor's.
    """

    name: str
    meaning: str
    parameters: tuple[Parameter, ...]
    columns: Callable[[Regressors], tuple[Array, ...]] | None = None
    rates: Callable[[Regressors, Motion], tuple[Array, ...]] | None = None
    stiffness: Callable[[Regressors, Array], Array] | None = None
    bounds: Callable[[Motion, float], tuple[tuple[float, float], ...]] | None = None
    delays: bool = False
    remaining: Callable[[Array, Array], Array] | None = None
    shifts: Callable[[Array], tuple[Array, ...]] | None = None
    needs: str = ""
    excludes: str = ""
    reason: str = ""
    breaks: bool = False
    confusable: tuple[str, ...] = ()
    sticks: bool = False
    unilateral: bool = False
    selection: Literal["smallest", "considered", "motor torque"] = "considered"

    @property
    def linear(self) -> bool:
        """Whether the torque is linear in its parameters."""
        return self.columns is not None


class UnknownTerm(ValueError):
    """A model names a term that there is none of; the message lists those there are."""


def _zero(regressors: Regressors, _changing: Motion) -> tuple[Array, ...]:
    import numpy as np

    return (np.zeros_like(regressors.angle),)


def _one(regressors: Regressors) -> tuple[Array, ...]:
    import numpy as np

    return (np.ones_like(regressors.angle),)


def _sign(regressors: Regressors) -> tuple[Array, ...]:
    import numpy as np

    rate, smoothing = regressors.motion.dtheta_dot, regressors.smoothing
    return (np.tanh(rate / smoothing) if smoothing > 0.0 else np.zeros_like(rate),)


def _beyond_gap(angle: Array, values: Array) -> Array:
    import numpy as np

    gap, centre = values
    from_centre = angle - centre
    return np.asarray(np.sign(from_centre) * np.maximum(np.abs(from_centre) - 0.5 * gap, 0.0))


def _gap_shifts(angle: Array) -> tuple[Array, ...]:
    import numpy as np

    return 0.5 * np.sign(angle), np.ones_like(angle)


def _beyond_slack(angle: Array, values: Array) -> Array:
    import numpy as np

    return np.asarray(np.maximum(angle - values[0], 0.0))


def _slack_shifts(angle: Array) -> tuple[Array, ...]:
    import numpy as np

    return (np.ones_like(angle),)


def _gap_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    least, span = _extent(motion)
    return (0.0, WIDEST_GAP * span), (least, least + span)


def _slack_bounds(motion: Motion, _highest: float) -> tuple[tuple[float, float], ...]:
    least, span = _extent(motion)
    return ((least, least + WIDEST_GAP * span),)


def _extent(motion: Motion) -> tuple[float, float]:
    least = float(motion.dtheta.min())
    return least, float(motion.dtheta.max() - motion.dtheta.min())


def _skew_bounds(_motion: Motion, highest: float) -> tuple[tuple[float, float], ...]:
    longest = min(LONGEST_SKEW, 0.25 / highest)  # beyond a quarter of the shortest period it cannot be identified
    return ((-longest, longest),)


_RECORDS: Final = (
    Term(
        "linear",
        "a spring Kc and a damper Bc, the paper's equation 3",
        (
            Parameter("Kc", "N*m/rad", "stiffness of the coupling"),
            Parameter("Bc", "N*m*s/rad", "damping of the coupling"),
        ),
        columns=lambda r: (r.angle, r.motion.dtheta_dot * r.contact),
        rates=lambda r, c: (c.dtheta * r.contact, c.dtheta_dot * r.contact),
        stiffness=lambda _r, genes: genes[0],
        selection="smallest",
    ),
    Term(
        "offset",
        "a constant torque",
        (Parameter("tau0", "N*m", "torque at rest, at the first sample"),),
        columns=_one,
        rates=_zero,
        selection="smallest",  # no reading's zero is quite the coupling's: other terms would stand in for it on the way
    ),
    Term(
        "drift",
        "a torque that grows in time",
        (Parameter("drift", "N*m/s", "slope of the torque reading in time"),),
        # from the first sample on: an absolute time would be nearly collinear with the offset
        columns=lambda r: (r.time,),
        rates=_zero,
        needs="offset",
    ),
    Term(
        "coulomb",
        "dry friction",
        (Parameter("Fc", "N*m", "Coulomb friction", presence=True, friction=True),),
        columns=_sign,
        rates=_zero,
        sticks=True,
    ),
    Term(
        "cubic",
        "a spring that stiffens",
        (Parameter("K3", "N*m/rad^3", "cubic stiffness", presence=True),),
        columns=lambda r: (r.angle**3,),
        rates=lambda r, c: (3.0 * r.angle**2 * c.dtheta,),
        stiffness=lambda r, genes: 3.0 * genes[0] * r.angle**2,
        confusable=("backlash", "slack"),
    ),
    Term(
        "inertia",
        "an inertia that moves with the deflection",
        (Parameter("J", "kg*m^2", "inertia that moves with the deflection", presence=True),),
        columns=lambda r: (r.motion.dtheta_ddot,),
        rates=lambda _r, c: (c.dtheta_ddot,),
        selection="motor torque",  # elsewhere it differs too little from skew
    ),
    Term(
        "backlash",
        "a gap with a flank on both sides",
        (
            Parameter(
                "gap",
                "rad",
                "play of the coupling, its whole width",
                scales=False,
                presence=True,
                starts=(0.0, 0.03, 0.1, 0.25, 0.5),
                kinked=True,
                refined=True,
                about="centre",
            ),
            Parameter(
                "centre",
                "rad",
                "deflection in the middle of the play",
                scales=False,
                absent=None,
                starts=(0.3, 0.5, 0.7),
                kinked=True,
                refined=True,
            ),
        ),
        bounds=_gap_bounds,
        remaining=_beyond_gap,
        shifts=_gap_shifts,
        needs="offset",
        excludes="slack",
        reason="a single tendon (slack) has no second flank (backlash)",
        breaks=True,
        unilateral=True,
    ),
    Term(
        "slack",
        "a tendon that only pulls",
        (
            Parameter(
                "slack",
                "rad",
                "deflection before the tendon pulls",
                scales=False,
                absent=None,
                starts=(0.05, 0.2, 0.4, 0.6, 0.8),
                kinked=True,
                refined=True,
            ),
        ),
        bounds=_slack_bounds,
        remaining=_beyond_slack,
        shifts=_slack_shifts,
        needs="offset",
        excludes="backlash",
        reason="a single tendon (slack) has no second flank (backlash)",
        breaks=True,
        unilateral=True,
    ),
    Term(
        "skew",
        "a torque reading older than the angle's",
        (
            Parameter(
                "skew",
                "s",
                "how much older the torque reading is than that of the angle",
                scales=False,
                starts=(0.25, 0.5, 0.75),
                refined=True,
            ),
        ),
        bounds=_skew_bounds,
        delays=True,
        confusable=("coulomb",),  # it moves the breaks that friction makes at every reversal
    ),
)

TERMS: Final[Mapping[str, Term]] = MappingProxyType({term.name: term for term in _RECORDS})
"""Every term by its name, in the order in which a model names them."""

PARAMETERS: Final[Mapping[str, Parameter]] = MappingProxyType({p.name: p for t in _RECORDS for p in t.parameters})
"""Every parameter by its name."""

CONSIDERED: Final = tuple(t.name for t in _RECORDS if t.name != "linear" and t.selection != "motor torque")
"""The terms that model selection considers for every recording."""

SYNTAX: Final = "linear" + "".join(f"[+{name}]" for name in TERMS if name != "linear")
"""How a model is written."""

MEANINGS: Final = "; ".join(f"{term.name}: {term.meaning}" for term in _RECORDS)
"""What each term adds, for the help."""


def canonical(name: str) -> str:
    """Return the name of a model, such as "linear+offset+coulomb", with its terms in the order of the table.

    Raises UnknownTerm for a term there is none of, ValueError for one named twice, where `linear` is missing or where
    two exclude each other.
    """
    names = [term.strip() for term in name.split("+")]
    for term in names:
        _refuse_unknown(term)
        if names.count(term) > 1:
            raise ValueError(f'model "{name}": {term} is named twice')
        if TERMS[term].excludes in names:
            raise ValueError(f'model "{name}": {TERMS[term].reason}: leave one out')
    if "linear" not in names:
        raise ValueError(f'model "{name}": every model begins with linear, as in "linear+{name}"')
    return "+".join(term for term in TERMS if term in names)


def _refuse_unknown(term: str) -> None:
    if term not in TERMS:
        near = difflib.get_close_matches(term, TERMS, n=1)
        hint = f' - did you mean "{near[0]}"?' if near else ""
        raise UnknownTerm(f'no model term "{term}"; there are {", ".join(TERMS)}{hint}')
