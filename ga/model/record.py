"""The record of a coupling term: all that the models, the fits, the predictions and the command line know of it.

A linear parameter is the factor of a column of the model, and is solved for exactly; a nonlinear one is searched. A
term may add columns, which may depend on nonlinear parameters of its own, or change what all columns are made of: delay
the motion, take a part of the deflection away, or pass the torque through a lag. Nothing in the terms imports numpy
before a column is computed, because the command line reads its help from them.
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
"""Starting values of a nonlinear parameter of which nothing is known, as parts of its range."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a model: its name, its SI unit and its meaning.

    scales: whether it is proportional to the torque. absent: the value that removes it from the model, None where none
    does. presence: whether its presence is in question, so that it is identifiable only if its interval excludes
    `absent`. friction: whether its torque turns with the motion. damping: whether its torque is that of a damper.
    positive: whether physics allows no value below zero. nonlinear: whether it is searched and not solved for. Of
    nonlinear parameters: starts, values to begin at as parts of the range; kinked, whether the torque has breaks where
    it ends; refined, whether breaks make the fitness rough along it; open_ended, whether its upper end is no rejection:
    it may be as much and more; about, the parameter that is the middle between the two ends that this one moves; place,
    whether it is a deflection, rad, that counts from where the deflection does.
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
    """Return the places of the parameters that physics allows no negative value of."""
    return tuple(at for at, parameter in enumerate(parameters) if parameter.positive)


@dataclass(frozen=True, slots=True)
class Regressors:
    """The signals (n,) that columns are made of.

    time: s since the model's origin. motion: as the torque reading saw it. angle: rad, the deflection beyond gap or
    slack, times contact. contact: 1, and 0 where flanks part. load: what friction in proportion to the load multiplies
    the torque of springs by; None without such friction; damped: whether that of dampers too.
    smoothing: rad/s, the v_s of friction. middle: s, the time in the middle of the recording. own: the nonlinear
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
        """Return those of some of the samples, of which the motion is given."""
        load = None if self.load is None else self.load[rows]
        angle, contact = self.angle[rows], self.contact[rows]
        return replace(self, time=self.time[rows], motion=motion, angle=angle, contact=contact, load=load)

    def loaded(self, term: Term, column: Array, parameter: Parameter | None = None) -> Array:
        """Return a column (n,) of a term's parameter, or a spring's, with the friction in proportion to its torque."""
        spared = parameter is not None and parameter.damping and not self.damped
        return column * self.load if term.carried and self.load is not None and not spared else column


@dataclass(frozen=True, slots=True)
class Term:
    """One term of the coupling: a record in `ga.model.terms.TERMS`.

    meaning: for the help. columns, each (n,), N m per unit of its linear parameters in their order; rates, how fast
    these change, per second, where the motion changes as the second argument says; pushed, (n,) N m, how its torque
    changes where the deflection changes by the third argument, (n,) rad, for given linear parameters.
    bounds, low and high of each nonlinear parameter for motion up to so many Hz. With them a term delays the motion by
    its parameter; or gives cell, what becomes of a torque (m,) or columns (m, p) of the whole motion in the torque
    cell, at the samples of a motion, for its parameters; or gives remaining, the deflection (n,) that its parameters
    leave, and shifts, how much of the deflection is taken away per unit of each; or only shapes its columns.
    contact, (n,), whether flanks touch, for remaining deflection, motion and Bc/Kc in s. load, (n,), multiplies the
    torque that is carried, for these, v_s and the term's parameters; carried: whether the term is part of that torque;
    spares_dampers: whether they are no part of it, because they act beside what rubs.
    forgets: where the torque depends on earlier samples too, what is left (n,) at each sample of the state
    that its stretch began with, which is unknown; for a motion and the term's parameters.
    smooths: whether its parameter is v_s of all friction, rad/s, in place of one so small that friction turns at once.
    needs: the term without which it means nothing; or_needs: others of which one is enough. excludes: the terms that it
    cannot stand beside, and why.
    bends: whether its torque is no linear filter of the motion, so that it changes in one that torque and motion pass.
    breaks: whether the torque has breaks in it. confusable: terms beside which it must pay as much as one with breaks,
    because it can pass for a part of them. sticks: whether friction holds the joint where it is slow.
    selection: in the smallest model that `auto` begins with, among the terms that it considers, among them only where
    the torque is the motor's or where the others describe the recording badly, or never.
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
        """Whether the torque is linear in all its parameters."""
        return not any(parameter.nonlinear for parameter in self.parameters)
