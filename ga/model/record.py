"""The record of a coupling term, from which models, fits, predictions and the command line get all properties of the
term.

A linear parameter multiplies a column of the model, and is computed exactly; a nonlinear parameter is searched. A term
can add columns, which may depend on its own nonlinear parameters, or change the signals that all columns are computed
from: delay the motion, subtract a part of the deflection, or filter the torque. No term imports numpy before a column
is computed, because the command line reads its help from the records.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from ga.arrays import Array, Index
    from ga.model.trajectory import Motion

    Bounds = Callable[[Motion, float], tuple[tuple[float, float], ...]]

ANYWHERE: Final = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Starting values, as fractions of the range, of a nonlinear parameter about whose value nothing is known."""

Role = Literal[
    "coupling", "bias", "friction", "damping", "curve", "change", "branch", "mass", "play", "load", "channel", "other"
]
"""What a term is, in the order in which a model's name lists its terms."""

ROLES: Final[tuple[Role, ...]] = get_args(Role)

Kind = Literal[
    "", "torque at rest", "dry friction", "presliding friction", "yielding friction", "fall of friction",
    "presliding length", "yielding length", "turning rate", "load share", "unloaded place", "gap width", "gap middle",
    "slack end", "damping", "growth of damping", "exponent", "side stiffness", "side place", "relaxing stiffness",
    "relaxation time", "moment of inertia", "delay", "lag time", "mean time",
]  # fmt: skip
"""What a parameter is, for the places that need to know more than its torque."""

FRICTION: Final[tuple[Kind, ...]] = ("dry friction", "presliding friction", "yielding friction")
"""The kinds of parameters that are the torque of friction that slides, of which a model has one."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a model: its name, its SI unit and its meaning.

    kind: the kind of quantity. scales: whether it is proportional to the torque. absent: the value that removes it from
    the model, None if no value does. presence: whether its existence is in question, so that it is identifiable only if
    its interval excludes `absent`. positive: whether it cannot be negative for physical reasons. nonlinear: whether it
    is searched; a linear parameter is computed exactly.

    For nonlinear parameters. starts: starting values, as fractions of the range. kinked: whether the torque has breaks
    (kinks) at deflections that depend on this parameter. refined: whether breaks give the fitness many local minima
    along it. open_ended: whether a value at its upper bound does not reject the term, because larger values have the
    same effect. about: for a parameter such as a gap, which moves two ends: the parameter of the middle between the
    ends.
    """

    name: str
    unit: str
    meaning: str
    kind: Kind = ""
    scales: bool = True
    absent: float | None = 0.0
    presence: bool = False
    positive: bool = False
    nonlinear: bool = False
    starts: tuple[float, ...] = ANYWHERE
    kinked: bool = False
    refined: bool = False
    open_ended: bool = False
    about: str = ""

    @property
    def friction(self) -> bool:
        """Whether its torque changes sign with the direction of motion."""
        return self.kind in {*FRICTION, "fall of friction", "load share"}

    @property
    def damping(self) -> bool:
        """Whether it is the torque of a damper."""
        return self.kind in {"damping", "growth of damping"}

    @property
    def place(self) -> bool:
        """Whether it is a deflection, rad, with the same zero as the deflection."""
        return self.kind in {"unloaded place", "gap middle", "slack end", "side place"}


def searched(name: str, unit: str, meaning: str, kind: Kind = "", **properties: Any) -> Parameter:
    """Return the record of a nonlinear parameter, none of which is in proportion to the torque."""
    return Parameter(name, unit, meaning, kind, scales=False, nonlinear=True, **properties)


STRENGTH: Final[Mapping[str, Any]] = {"presence": True, "positive": True}
"""The properties of a parameter that is the strength of an effect, as keywords."""

SCALE: Final[Mapping[str, Any]] = {"absent": None, "positive": True}
"""Those of a time, a rate or a deflection over which an effect changes."""


def positive_among(parameters: Iterable[Parameter]) -> tuple[int, ...]:
    """Return the indices of the parameters that cannot be negative."""
    return tuple(at for at, parameter in enumerate(parameters) if parameter.positive)


@dataclass(frozen=True, slots=True)
class Regressors:
    """The signals (n,) from which columns are computed.

    time: since the model's origin, s. motion: the motion from which the torque is computed. angle: the deflection
    beyond a gap or slack, times contact, rad. contact: 1, or 0 where the surfaces of a gap do not touch. load: the
    factor by which friction in proportion to the load multiplies the torque of springs; None without such friction.
    damped: whether this factor multiplies the torque of dampers too. smoothing: v_s of friction, rad/s. middle: the
    time in the middle of the recording, s. own: the nonlinear parameters of the term whose columns are computed.
    """

    time: Array
    motion: Motion
    angle: Array
    contact: Array
    load: Array | None
    damped: bool
    smoothing: float
    middle: float
    own: Array

    def of(self, rows: Index | slice, motion: Motion) -> Regressors:
        """Return the regressors at the samples `rows`. motion: the motion at these samples."""
        load = None if self.load is None else self.load[rows]
        angle, contact = self.angle[rows], self.contact[rows]
        return replace(self, time=self.time[rows], motion=motion, angle=angle, contact=contact, load=load)

    def loaded(self, term: Term, column: Array, parameter: Parameter | None = None) -> Array:
        """Return a column (n,) of a parameter, multiplied by the friction that is in proportion to its torque.

        term: the term of the parameter. parameter: the index of the parameter in the term.
        """
        spared = parameter is not None and parameter.damping and not self.damped
        return column * self.load if term.carried and self.load is not None and not spared else column


@dataclass(frozen=True, slots=True)
class Mark:
    """The mark that an effect leaves in the residuals of a model without it: its code, its name in words, and what to
    try.

    advice: braces around a term's name stand for the model with that term. again: whether a model with the term may
    lack a further term for the same effect.
    """

    code: str
    name: str
    advice: str
    again: bool = False


@dataclass(frozen=True, slots=True)
class Term:
    """One effect that a model of the coupling can have: a record in `ga.model.terms.TERMS`.

    meaning: text for the help. role: the kind of effect.
    equation: the torque that the term adds, in the deflection x, its rate v and the time t; after a comma, where its
      other symbols come from. For a term without columns, what it changes.
    example: the parameters, in SI or as parts of the stroke or of the spring's torque, on a joint with the example of
      `linear`: of the size that a person would call small, plain and large.
    columns: functions that return (n,), N m per unit of each linear parameter, in order.
    rates: functions that return the time derivatives of the columns, per second, for the motion's time derivative
      (second argument); None: of one column that depends on the deflection alone, or not on the motion.
    pushed: the change of the term's torque (n,), N m, when the deflection changes by the third argument (n,), rad, for
      given linear parameters.
    bounds: low and high of each nonlinear parameter, for motion up to a frequency, Hz.

    A term with bounds does one of these:
    - it delays the motion by its parameter;
    - cell: filters a torque (m,) or columns (m, p) of the whole motion as a torque cell does, at the samples of a
      motion;
    - remaining: returns the deflection (n,) that remains beyond the gap, and shifts: the change of the subtracted part
      per unit of each parameter;
    - it only changes its own columns.

    contact: returns whether the surfaces of a gap touch (n,), for the remaining deflection, the motion and Bc/Kc in s.
    load: returns the factor (n,) of the carried torque, for the same arguments, v_s and the term's parameters.
    spares_dampers: whether dampers are not part of that torque, because they act in parallel to the parts that rub.
    forgets: for a torque that depends on earlier samples, returns the weight (n,) that the unknown state at the
      beginning of its piece still has at each sample, for a motion and the term's parameters.
    smooths: whether its parameter is v_s of all friction, rad/s; without such a term v_s is so small that friction
      reverses at once.
    needs: the term without which it has no meaning. or_needs: other terms, of which one is enough instead.
    excludes: the terms that it cannot be combined with, and why.
    bends: whether its torque is no linear filter of the motion, and so changes under a filter of torque and motion.
    breaks: whether its torque has breaks; such a term has small prior odds, because it fits much by chance.
    confusable: terms beside which this term must improve the score as much as one with breaks, because it resembles a
      part of them.
    sticks: whether friction of the term holds the joint where it is slow.
    open: returns the deflections, rad, between which a gap with the term's parameters is open.
    bench: whether every bench may have a little of the effect ("small"), or has it ("always"): such terms are in the
      average over models. A term that every bench has costs no prior odds.
    seldom: whether its prior odds are smaller than those of its class.
    repeats: whether only a motion that repeats shows the effect.
    deviation: returns the torque (n,), up to a factor, by which a real joint departs from the term's law, for a motion
      and the model's columns and values by parameter.
    mark: what the residuals show if the model lacks the term.
    selection: its prior class. Model selection begins with a "smallest" term, at no cost. It expects a "considered"
      (common) term in one joint of two, a "motor torque" or "misfit" (rare) term in one of ten. A "misfit" term must
      also have strong evidence. It never considers a "named" term.
    """

    name: str
    meaning: str
    parameters: tuple[Parameter, ...]
    columns: Callable[[Regressors], tuple[Array, ...]] | None = None
    rates: Callable[[Regressors, Motion], tuple[Array, ...]] | None = None
    pushed: Callable[[Regressors, Array, Array], Array] | None = None
    bounds: Bounds | None = None
    delays: bool = False
    cell: Callable[[Motion, Array, Array], Array] | None = None
    remaining: Callable[[Array, Array], Array] | None = None
    shifts: Callable[[Array], tuple[Array, ...]] | None = None
    contact: Callable[[Array, Motion, float], Array] | None = None
    load: Callable[[Array, Motion, float, float, Array], Array] | None = None
    spares_dampers: bool = False
    forgets: Callable[[Motion, Array], Array] | None = None
    smooths: bool = False
    needs: str = ""
    or_needs: tuple[str, ...] = ()
    excludes: tuple[str, ...] = ()
    reason: str = ""
    bends: bool = True
    breaks: bool = False
    confusable: tuple[str, ...] = ()
    sticks: bool = False
    role: Role = "other"
    open: Callable[[Array], tuple[float, float]] | None = None
    bench: Literal["", "small", "always"] = ""
    seldom: bool = False
    repeats: bool = False
    deviation: Callable[[Motion, Mapping[Parameter, Array], Mapping[Parameter, float]], Array] | None = None
    mark: Mark | None = None
    selection: Literal["smallest", "considered", "motor torque", "misfit", "named"] = "misfit"
    equation: str = ""
    example: str = ""

    @property
    def linear(self) -> bool:
        """Return whether the torque of the term is linear in all its parameters."""
        return not any(parameter.nonlinear for parameter in self.parameters)

    @property
    def carried(self) -> bool:
        """Return whether the torque of the term is part of the carried torque, which friction multiplies."""
        return self.role in {"coupling", "damping", "curve", "change", "branch"}
