"""The record of a coupling term: all that models, fits, predictions and the command line know about it.

A linear parameter multiplies a column of the model, and is solved for exactly; a nonlinear one is searched. A term can
add columns, which may depend on its own nonlinear parameters, or change what all columns are made of: delay the motion,
subtract a part of the deflection, or filter the torque. No term imports numpy before a column is computed, because the
command line reads its help from the records.
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
"""Starting values, as fractions of the range, of a nonlinear parameter of which nothing is known."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a model: its name, its SI unit and its meaning.

    scales: whether it is proportional to the torque. absent: the value that removes it from the model, None if there is
    none. presence: whether its existence is in question, so that it is identifiable only if its interval excludes
    `absent`. friction: whether its torque changes sign with the direction of motion. damping: whether it is the torque
    of a damper. positive: whether physics allows no value below zero. nonlinear: whether it is searched and not solved
    for.

    For nonlinear parameters: starts, values to begin at, as fractions of the range; kinked, whether the torque has
    breaks where it ends; refined, whether breaks give the fitness many local minima along it; open_ended, whether its
    upper bound is no rejection, because larger values mean the same; about, the parameter that is the middle between
    the two ends that this one moves; place, whether it is a deflection, rad, with the same zero as the deflection.
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
    """The signals (n,) that columns are made of.

    time: since the model's origin, s. motion: as the torque reading saw it. angle: the deflection beyond gap or slack,
    times contact, rad. contact: 1, or 0 where flanks are apart. load: the factor by which friction in proportion to the
    load multiplies the torque of springs; None without such friction. damped: whether it multiplies that of dampers
    too. smoothing: v_s of friction, rad/s. middle: the time in the middle of the recording, s. own: the nonlinear
    parameters of the term whose columns are computed.
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
        """Return the regressors at some of the samples, whose motion is given."""
        load = None if self.load is None else self.load[rows]
        angle, contact = self.angle[rows], self.contact[rows]
        return replace(self, time=self.time[rows], motion=motion, angle=angle, contact=contact, load=load)

    def loaded(self, term: Term, column: Array, parameter: Parameter | None = None) -> Array:
        """Return a column (n,) of a term's parameter, or a spring's, including friction in proportion to its torque."""
        spared = parameter is not None and parameter.damping and not self.damped
        return column * self.load if term.carried and self.load is not None and not spared else column


@dataclass(frozen=True, slots=True)
class Term:
    """One term of the coupling: a record in `ga.model.terms.TERMS`.

    meaning: for the help.
    columns: functions that return (n,), N m per unit of each linear parameter, in order.
    rates: the time derivatives of these, per second, for the motion's time derivative (second argument).
    pushed: the change of its torque (n,), N m, when the deflection changes by the third argument (n,), rad, for
      given linear parameters.
    bounds: low and high of each nonlinear parameter, for motion up to a frequency, Hz.

    A term with bounds does one of these:
    - it delays the motion by its parameter;
    - cell: filters a torque (m,) or columns (m, p) of the whole motion as a torque cell does, at the samples of a
      motion;
    - remaining: returns the deflection (n,) that its parameters leave, and shifts, how much is subtracted per unit
      of each;
    - it only shapes its own columns.

    contact: whether flanks touch (n,), for remaining deflection, motion and Bc/Kc in s.
    load: the factor (n,) of the carried torque, for the same, v_s and the term's parameters.
    carried: whether the term is part of the carried torque.
    spares_dampers: whether dampers are not, because they act in parallel to what rubs.
    forgets: for a torque that depends on earlier samples, the remaining weight (n,) at each sample of the unknown
      state at the beginning of its piece, for a motion and the term's parameters.
    smooths: whether its parameter is v_s of all friction, rad/s, which else is so small that friction reverses at once.
    needs: the term without which it has no meaning; or_needs: others of which one is enough.
    excludes: the terms that it cannot be combined with, and why.
    bends: whether its torque is no linear filter of the motion, and so changes under a filter of torque and motion.
    breaks: whether its torque has breaks.
    confusable: terms beside which it must improve the score as much as one with breaks, because it resembles a part
      of them.
    sticks: whether friction holds the joint where it is slow.
    selection: whether it is in the smallest model of `auto`, considered always, considered only for a motor's
      torque or if other terms describe the recording badly, or never.
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

    @property
    def linear(self) -> bool:
        """Return whether the torque is linear in all its parameters."""
        return not any(parameter.nonlinear for parameter in self.parameters)
