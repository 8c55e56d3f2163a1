"""The record of a coupling term, from which models, fits, predictions and the command line get all properties of the
term.

A linear parameter multiplies a column of the model, and is computed exactly; a nonlinear parameter is searched. A term
can add columns, which may depend on its own nonlinear parameters, or change the signals that all columns are computed
from: delay the motion, subtract a part of the deflection, or filter the torque. No term imports numpy before a column
is computed, because the command line reads its help from the records.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import numpy as np
    from numpy.typing import NDArray

    from ga.model.trajectory import Motion

    Array = NDArray[np.float64]

ANYWHERE: Final = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Starting values, as fractions of the range, of a nonlinear parameter about whose value nothing is known."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a model: its name, its SI unit and its meaning.

    scales: whether it is proportional to the torque. absent: the value that removes it from the model, None if no value
    does. presence: whether its existence is in question, so that it is identifiable only if its interval excludes
    `absent`. friction: whether its torque changes sign with the direction of motion. damping: whether it is the torque
    of a damper. positive: whether it cannot be negative for physical reasons. nonlinear: whether it is searched; a
    linear parameter is computed exactly.

    For nonlinear parameters. starts: starting values, as fractions of the range. kinked: whether the torque has breaks
    at deflections that this parameter moves. refined: whether breaks give the fitness many local minima along it.
    open_ended: whether a value at its upper bound does not reject the term, because larger values have the same effect.
    about: the parameter that is the middle between the two ends that this parameter moves. place: whether it is a
    deflection, rad, with the same zero as the deflection.
    """

    name: str
    unit: str
    meaning: str
    scales: bool = True
    absent: float | None = 0.0
    presence: bool = False
    friction: bool = False
    damping: bool = False
    positive: bool = False
    nonlinear: bool = False
    starts: tuple[float, ...] = ANYWHERE
    kinked: bool = False
    refined: bool = False
    open_ended: bool = False
    about: str = ""
    place: bool = False


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

    def of(self, rows: NDArray[np.int64] | slice, motion: Motion) -> Regressors:
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
class Term:
    """One term of the coupling: a record in `ga.model.terms.TERMS`.

    meaning: text for the help.
    equation: the torque that the term adds, in the deflection x, its rate v and the time t; after a comma, where its
      other symbols come from. For a term without columns, what it changes.
    columns: functions that return (n,), N m per unit of each linear parameter, in order.
    rates: functions that return the time derivatives of the columns, per second, for the motion's time derivative
      (second argument).
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
    carried: whether the torque of the term is part of the carried torque, which friction multiplies.
    spares_dampers: whether dampers are not part of it, because they act in parallel to the parts that rub.
    forgets: for a torque that depends on earlier samples, returns the weight (n,) that the unknown state at the
      beginning of its piece still has at each sample, for a motion and the term's parameters.
    smooths: whether its parameter is v_s of all friction, rad/s; without such a term v_s is so small that friction
      reverses at once.
    needs: the term without which it has no meaning. or_needs: other terms, of which one is enough instead.
    excludes: the terms that it cannot be combined with, and why.
    bends: whether its torque is no linear filter of the motion, and so changes under a filter of torque and motion.
    breaks: whether its torque has breaks.
    confusable: terms beside which this term must improve the score as much as one with breaks, because it resembles a
      part of them.
    sticks: whether friction of the term holds the joint where it is slow.
    selection: whether model selection has it in the smallest model, considers it always, considers it only for a
      motor's torque or if other terms describe the recording badly, or never considers it.
    """

    name: str
    meaning: str
    parameters: tuple[Parameter, ...]
    columns: Callable[[Regressors], tuple[Array, ...]] | None = None
    rates: Callable[[Regressors, Motion], tuple[Array, ...]] | None = None
    pushed: Callable[[Regressors, Array, Array], Array] | None = None
    bounds: Callable[[Motion, float], tuple[tuple[float, float], ...]] | None = None
    delays: bool = False
    cell: Callable[[Motion, Array, Array], Array] | None = None
    remaining: Callable[[Array, Array], Array] | None = None
    shifts: Callable[[Array], tuple[Array, ...]] | None = None
    contact: Callable[[Array, Motion, float], Array] | None = None
    load: Callable[[Array, Motion, float, float, Array], Array] | None = None
    carried: bool = False
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
    selection: Literal["smallest", "considered", "motor torque", "misfit", "named"] = "considered"
    equation: str = ""

    @property
    def linear(self) -> bool:
        """Return whether the torque of the term is linear in all its parameters."""
        return not any(parameter.nonlinear for parameter in self.parameters)
