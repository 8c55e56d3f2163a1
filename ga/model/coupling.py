"""The model of the coupling: a sum of terms (`ga.model.terms`).

torque = known + columns(nonlinear parameters) . genes. The model `linear` is the paper's equation 3. An effect that
exists but has no term in the model changes Bc, which is why the other terms exist. This module does not depend on how a
recording was made.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from ga.arrays import Array, Mask
from ga.model.columns import ColumnSource, reaches
from ga.model.memory import beginnings, without_beginnings
from ga.model.record import Parameter, Regressors, Term
from ga.model.sticking import beside_rest, slowest, smoothing, turns_unseen
from ga.model.terms import TERMS, canonical, lacking
from ga.model.trajectory import Motion

BESIDE: Final = 0.25
"""The change of the skew for a numerical derivative, as a fraction of the time between two samples."""

STEP: Final = 1e-4
SMALLEST: Final = 1e-3
"""STEP: the change of a nonlinear parameter for a numerical derivative, as a fraction of the parameter. For a parameter
that may be zero, SMALLEST, SI, replaces the parameter in this product if it is larger.
"""


@dataclass(frozen=True)
class CouplingModel:
    """A model of the coupling: a sum of terms.

    name: the model's name with the terms in the order of the table, such as "linear+offset+coulomb+skew". origin: the
    time at which the drift is zero, s. middle: the time after the origin, s, at which a drifting stiffness equals Kc.
    slowest: the rate, rad/s, below which friction may hold the joint. smoothing: v_s of friction, rad/s. Each call
    derives the values that are None from its own data. at_edge: whether the flanks of a gap part at its edge; False: as
    soon as they would pull; None: each fit decides.
    """

    name: str
    origin: float | None = None
    middle: float | None = None
    slowest: float | None = None
    smoothing: float | None = None
    at_edge: bool | None = None

    def __reduce__(self) -> tuple[type[CouplingModel], tuple[str | float | None, ...]]:
        """Return the instructions for pickling: the model's name, because the model's terms contain lambdas."""
        return CouplingModel, (self.name, self.origin, self.middle, self.slowest, self.smoothing, self.at_edge)

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """Return the records of the model's terms."""
        return tuple(TERMS[name] for name in self.name.split("+"))

    @cached_property
    def linear(self) -> tuple[Parameter, ...]:
        """Return the parameters (p,) of the columns, in their order."""
        return tuple(parameter for term in self.terms for parameter in term.parameters if not parameter.nonlinear)

    @cached_property
    def nonlinear(self) -> tuple[Parameter, ...]:
        """Return the parameters (q,) that the columns depend on."""
        return tuple(parameter for term in self.terms for parameter in term.parameters if parameter.nonlinear)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return all parameters: the linear ones, then the nonlinear ones."""
        return self.linear + self.nonlinear

    @property
    def sticks(self) -> bool:
        """Return whether friction may hold the joint; the torque of friction is then any value between -Fc and Fc."""
        return any(term.sticks for term in self.terms) and not self._smooths

    @cached_property
    def _smooths(self) -> bool:
        """Return whether friction reverses smoothly."""
        return any(term.smooths for term in self.terms)

    @property
    def needs_ratio(self) -> bool:
        """Return whether the columns depend on Bc/Kc: the sign of the torque decides on contact or friction."""
        return self._is_loaded or (self._has_flanks and not self.at_edge)

    @property
    def chooses_edge(self) -> bool:
        """Return whether a fit decides where the flanks of a gap part: both ways are tried."""
        return self._has_flanks and not self._is_loaded and self.at_edge is None

    @cached_property
    def _has_flanks(self) -> bool:
        return any(term.contact is not None for term in self.terms)

    @cached_property
    def _is_loaded(self) -> bool:
        return any(term.load is not None for term in self.terms)

    @cached_property
    def bends(self) -> tuple[bool, ...]:
        """Return for each term whether its torque is no linear filter of the motion."""
        beyond = self.needs_ratio or any(term.remaining is not None for term in self.terms)
        return tuple(term.bends or (beyond and term.pushed is not None) for term in self.terms)

    def _through_cell(self, motion: Motion, nonlinear: Array | None) -> Motion:
        """Return the motion for computing the torque: behind a torque cell with given parameters, the whole motion."""
        behind_cell = nonlinear is not None and any(term.cell is not None for term in self.terms)
        return motion.whole[0] if behind_cell else motion

    @cached_property
    def _load_remembers(self) -> bool:
        """Return whether the torque of spring and damper depends on earlier samples too."""
        return any(term.load is not None and term.forgets is not None for term in self.terms)

    def anchored(self, motion: Motion) -> CouplingModel:
        """Return the model with origin, middle, slowest rate and smoothing fixed from this motion.

        The model is then the same for every part of the motion. This is needed if a recording is read block by block,
        or if one part validates a fit to another.
        """
        origin = float(motion.time[0]) if len(motion) else 0.0
        middle = 0.5 * float(motion.time.min() + motion.time.max()) - origin if len(motion) else 0.0
        return replace(self, origin=origin, middle=middle, slowest=slowest(motion), smoothing=smoothing(motion))

    def described(self, motion: Motion, delay: float = 0.0) -> Mask:
        """Return which samples (n,) the model describes: all except those in which friction may hold the joint.

        delay: the age of the torque reading less that of the angle reading, s. If the model estimates the delay,
        further samples are left out: those next to a reversal, because the sign of their friction would determine the
        delay; those next to a rest, where a low-pass spreads friction of unknown size; and those in which the computed
        rate reverses before or after the joint.
        """
        if not self.sticks:
            return np.ones(len(motion), dtype=bool)
        least_rate = slowest(motion) if self.slowest is None else self.slowest
        delays = any(term.delays for term in self.terms)
        beside = BESIDE * motion.step if delays and len(motion) > 1 else 0.0
        rates = [motion.delayed(delay + shift).dtheta_dot for shift in (-beside, 0.0, beside)]
        least, most = np.min(rates, axis=0), np.max(rates, axis=0)
        held = (least < least_rate) & (most > -least_rate)
        unseen = turns_unseen(motion.delayed(delay) if delay else motion)
        return np.asarray(~(held | beside_rest(motion, held) | unseen))

    def delay(self, nonlinear: Array | None) -> float:
        """Return the age of the torque reading less that of the angle's, s; 0 without a term for it. nonlinear:
        (q,).
        """
        return next((float(values[0]) for term, values in self._valued(nonlinear) if term.delays), 0.0)

    def columns(self, motion: Motion, nonlinear: Array | None = None, lag: float = 0.0) -> Array:
        """Return the columns (n, p) of the linear parameters, SI.

        nonlinear (q,): the values of the nonlinear parameters; None leaves out the columns of terms that have such
        parameters. lag: Bc/Kc, s. In a gap, whose contact surfaces can push but not pull, Bc/Kc determines when the two
        surfaces separate.
        """
        model = self if self.smoothing is not None else self.anchored(motion)
        source = model._source(motion, nonlinear, lag)
        return model._as_measured(motion, model._stacked(source, nonlinear), nonlinear)

    def raw_columns(self, motion: Motion, nonlinear: Array, lag: float = 0.0) -> Array:
        """Return the columns (n, p) before the torque cell, including the part that unknown initial states can explain.

        nonlinear (q,): values of the nonlinear parameters. lag: Bc/Kc, s.
        """
        return self._stacked(self._source(motion, nonlinear, lag), nonlinear)

    def target(self, motion: Motion, torque: Array, nonlinear: Array | None = None) -> Array:
        """Return the torque (n,), N m, that the columns are fitted to: the measured torque less its known part.

        If the torque depends on earlier samples, the part that the unknown state at the beginning of a piece can
        explain is removed too.
        """
        if motion.whole[0].known.any():
            source = self._through_cell(motion, nonlinear)
            torque = torque - self._behind_cell(motion, source.delayed(self.delay(nonlinear)).known, nonlinear)
        return self._without_initial_states(motion, torque, nonlinear)

    def jacobian(
        self,
        motion: Motion,
        nonlinear: Array,
        genes: Array,
        lag: float = 0.0,
        torque: Array | None = None,
        *,
        changing: Motion | None = None,
    ) -> Array:
        """Return the derivative (n, q) of the torque with respect to each nonlinear parameter, N m per unit.

        nonlinear (q,) and genes (p,): the parameters. torque (n,): N m, as read; None: the model's own torque. If the
        torque depends on earlier samples, the part explained by the unknown states at the beginning of pieces changes
        too. changing: the time derivative of the motion, per second; None: computed by interpolation. Where the
        surfaces of a gap meet, the damping torque jumps, and where the joint reverses, friction jumps; the contribution
        of these jumps at single samples is left out.
        """
        model = self if self.smoothing is not None else self.anchored(motion)
        source = model._source(motion, nonlinear, lag)
        found: list[Array] = []
        for term, values in model._valued(nonlinear):
            if term.delays and not (model._load_remembers or model._smooths):
                rates = source.changing(self.delay(nonlinear)) if changing is None else (changing, changing)
                aged = -(model._stacked(source, nonlinear, rates) @ genes + rates[0].known)
                found.append(model._as_measured(motion, aged, nonlinear))
            elif term.shifts is not None:
                for shift in term.shifts(source.whole.angle):
                    pushed = -model._pushed(source.whole, nonlinear, genes, shift * source.whole.contact)
                    found.append(model._as_measured(motion, source.passed(pushed, bends=True), nonlinear))
            else:
                read = model._torque(motion, source, nonlinear, genes, lag=lag) if torque is None else torque
                same_delay = None if term.delays else source
                for _ in values:
                    ends = model._ends_of_difference(nonlinear, len(found))
                    low, high = (
                        model._without_initial_states(
                            motion, model._torque(motion, same_delay, end, genes, lag=lag) - read, end
                        )
                        for end in ends
                    )
                    found.append((high - low) / (ends[1] - ends[0])[len(found)])
        return np.stack(found, axis=1) if found else np.empty((len(motion), 0))

    def _ends_of_difference(self, nonlinear: Array, at: int) -> Array:
        """Return the nonlinear parameters (2, q) with the parameter `at` slightly lower, and slightly higher."""
        parameter = self.nonlinear[at]
        never_zero = parameter.positive and parameter.absent is None
        step = STEP * max(abs(nonlinear[at]), 0.0 if never_zero else SMALLEST)
        ends = nonlinear[at] + np.array([-step, step])
        beside = np.tile(nonlinear, (2, 1))
        beside[:, at] = np.maximum(ends, 0.0) if parameter.positive else ends
        return beside

    def _torque(
        self, motion: Motion, source: ColumnSource | None, nonlinear: Array, genes: Array, *, lag: float
    ) -> Array:
        """Return the torque (n,), N m, of a motion, including the part explained by unknown initial states.

        source: regressors with the same delay, if known.
        """
        moved = self._source(motion, nonlinear, lag, source)
        torque = self._stacked(moved, nonlinear) @ genes + moved.near.motion.known
        return self._behind_cell(motion, torque, nonlinear)

    def bounds(self, motion: Motion, highest: float) -> tuple[Array, Array]:
        """Return low (q,) and high (q,) of the nonlinear parameters, for motion up to `highest` Hz."""
        pairs = [pair for term in self.terms if term.bounds is not None for pair in term.bounds(motion, highest)]
        return np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])

    @cached_property
    def _places(self) -> tuple[tuple[Term, slice], ...]:
        """Return each term that has nonlinear parameters, with the slice of its parameters in the model's
        values (q,).
        """
        found, at = [], 0
        for term in self.terms:
            count = sum(parameter.nonlinear for parameter in term.parameters)
            found += [(term, slice(at, at + count))] if count else []
            at += count
        return tuple(found)

    def _valued(self, nonlinear: Array | None) -> list[tuple[Term, Array]]:
        """Return each term that has nonlinear parameters, with its own values from the model's values (q,)."""
        return [] if nonlinear is None else [(term, nonlinear[own]) for term, own in self._places]

    def _source(
        self, motion: Motion, nonlinear: Array | None, lag: float, delayed: ColumnSource | None = None
    ) -> ColumnSource:
        """Return the regressors for parameters (q,). delayed: regressors for other parameters with the same delay."""
        whole, delay = motion.whole[0], self.delay(nonlinear)
        motion = self._through_cell(motion, nonlinear)
        shown = delayed.near.motion if delayed else motion.delayed(delay)
        reach = (reaches(motion, term, bends=bends) for term, bends in zip(self.terms, self.bends, strict=True))
        if motion is whole or not any(reach):
            near = self._regressors(motion, shown, nonlinear, lag)
            return ColumnSource(motion, near, near)
        all_shown = delayed.whole.motion if delayed else whole.delayed(delay)
        every = self._regressors(whole, all_shown, nonlinear, lag)
        if self._load_remembers:
            return ColumnSource(motion, every.of(motion.whole[1], shown), every)
        return ColumnSource(motion, self._regressors(motion, shown, nonlinear, lag), every)

    def _behind_cell(self, motion: Motion, torque: Array, nonlinear: Array | None) -> Array:
        """Return a torque (m,) or columns (m, p) after the torque cell's filter, at the samples of the motion (n,).

        With a torque cell in the model, m is the number of samples of the whole motion.
        """
        cells = [(term.cell, values) for term, values in self._valued(nonlinear) if term.cell is not None]
        for number, (cell, values) in enumerate(cells, start=1):
            torque = cell(motion if number == len(cells) else motion.whole[0], torque, values)
        return torque

    def _as_measured(self, motion: Motion, torque: Array, nonlinear: Array | None) -> Array:
        """Return a torque (m,), N m, or columns (m, p) after the torque cell's filter, without the part that unknown
        states at the beginning of pieces explain: (n,) or (n, p), at the samples of the motion.
        """
        return self._without_initial_states(motion, self._behind_cell(motion, torque, nonlinear), nonlinear)

    def _without_initial_states(self, motion: Motion, values: Array, nonlinear: Array | None) -> Array:
        """Return values (n,) or (n, p) without the part that unknown states at the beginning of pieces can explain."""
        if nonlinear is None or not any(term.forgets is not None for term, _ in self._places):
            return values

        valued = [(term.forgets, own) for term, own in self._valued(nonlinear) if term.forgets is not None]
        return without_beginnings(values, beginnings(np.stack([f(motion, own) for f, own in valued]), motion.stretch))

    def _regressors(self, motion: Motion, source: Motion, nonlinear: Array | None, lag: float) -> Regressors:
        """Return the regressors of the delayed motion, before a gap or a slack is applied."""
        angle, contact, load, softness = source.dtheta, np.ones(len(motion)), None, self.smoothing or 0.0
        damped = not any(term.spares_dampers for term in self.terms)
        for term, values in self._valued(nonlinear):
            if term.remaining is not None:
                angle = term.remaining(angle, values)
            if term.smooths:
                softness = float(values[0])
        for term, values in self._valued(nonlinear):
            if term.contact is not None:
                own = term.contact(angle, source, lag)
                angle, contact = angle * own, contact * own
            if term.load is not None:
                load = term.load(angle, source, lag, softness, values)
        elapsed, middle = motion.time - (self.origin or 0.0), self.middle or 0.0
        return Regressors(elapsed, source, angle, contact, load, damped, softness, middle, np.empty(0))

    def _present(self, nonlinear: Array | None) -> Iterator[tuple[Term, bool, Array]]:
        """Yield each term, whether its torque is no linear filter of the motion, and its values from (q,).

        Without given parameters, only terms without nonlinear parameters are returned.
        """
        valued = {term.name: values for term, values in self._valued(nonlinear)}
        for term, bends in zip(self.terms, self.bends, strict=True):
            if term.linear or nonlinear is not None:
                yield term, bends, valued.get(term.name, np.empty(0))

    def _pushed(self, regressors: Regressors, nonlinear: Array | None, genes: Array, moved: Array) -> Array:
        """Return the change of the torque, N m, when the deflection changes by `moved` (n,), rad, for genes (p,).

        The derivative by the ends of a gap needs it. Terms without `pushed` do not change.
        """
        parts, at = [], 0
        for term, _, own in self._present(nonlinear):
            count = sum(not parameter.nonlinear for parameter in term.parameters)
            if term.pushed is not None:
                part = term.pushed(replace(regressors, own=own), genes[at : at + count], moved)
                parts.append(regressors.loaded(term, part))
            at += count
        return np.asarray(sum(parts[1:], start=parts[0]))

    def _stacked(
        self, source: ColumnSource, nonlinear: Array | None, motion_rates: tuple[Motion, Motion] | None = None
    ) -> Array:
        """Return the columns (n, p) of all terms; with `motion_rates`, their time derivatives."""
        columns = source.columns(self._present(nonlinear), motion_rates)
        return np.stack(columns, axis=1).astype(np.float64, copy=False)


def lag_of(stiffness: float, damping: float) -> float:
    """Return Bc/Kc, s; 0 if one of them is not positive."""
    return max(0.0, damping / stiffness) if stiffness > 0.0 else 0.0


def parse(name: str) -> CouplingModel:
    """Return the model of a name such as "linear+offset+coulomb"; the order of the terms does not matter.

    Raises ValueError for a wrong name, and for a term that changes a friction which the model lacks.
    """
    model = CouplingModel(canonical(name))
    for term in (term for term in model.terms if term.smooths and lacking(term.name, model.name.split("+"))):
        rubbing = f"{term.needs}, {' or '.join(term.or_needs)}"
        raise ValueError(f'model "{name}": {term.name} changes a friction, and the model has none: add {rubbing}')
    return model
