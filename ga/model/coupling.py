"""The model of the coupling: a sum of terms (`ga.model.terms`).

torque = known + columns(nonlinear parameters) . genes. `linear` is the paper's equation 3. A term that is left out but
present lands in Bc, which is why the others exist. Nothing here knows how a recording came about.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from ga.model.memory import without_beginnings
from ga.model.record import Parameter, Regressors, Term
from ga.model.terms import TERMS, canonical

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from ga.model.trajectory import Motion, Rows

    Array = NDArray[np.float64]

STUCK: Final = 0.075

RESTS: Final = 10.0
QUIET: Final = 0.05
"""Times the rate's noise, below which the joint rests where many samples are as slow, and part of the r.m.s. rate up to
which so much noise is little: a motion that passes through zero is that slow in 4 % of the samples or fewer."""
"""Part of the samples, the slowest, in which friction may hold the joint and its sign is not known."""

BESIDE: Final = 0.25
"""Part of the time between two samples by which the skew may be wrong when those are determined."""

NOISY: Final = 0.5
FINEST: Final = 0.001
SMOOTHEST: Final = 0.05
"""v_s of the Coulomb term as a part of the rate's noise, at least and at most these parts of the r.m.s. rate: a sign
where friction slides, for 1.3 % of softness takes as much off Bc."""

STEP: Final = 1e-4
SMALLEST: Final = 1e-3
"""A difference is taken over this part of a nonlinear parameter, or of this much, SI, where it is less."""


@dataclass(frozen=True)
class CouplingModel:
    """A sum of terms. name: canonical, such as "linear+offset+coulomb+skew".

    origin: s, where the drift begins; middle: s after it, where a stiffness that drifts is Kc; slowest: rad/s, below
    which friction may hold the joint; smoothing: v_s of friction, rad/s. None: each call takes its own data's.
    """

    name: str
    origin: float | None = None
    middle: float | None = None
    slowest: float | None = None
    smoothing: float | None = None

    def __reduce__(self) -> tuple[type[CouplingModel], tuple[str | float | None, ...]]:
        """Return what another process makes the model from: the records of its terms have functions without a name."""
        return CouplingModel, (self.name, self.origin, self.middle, self.slowest, self.smoothing)

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """The records of its terms."""
        return tuple(TERMS[name] for name in self.name.split("+"))

    @cached_property
    def linear(self) -> tuple[Parameter, ...]:
        """The parameters (p,) of the columns, in their order."""
        return tuple(parameter for term in self.terms for parameter in term.parameters if not parameter.nonlinear)

    @cached_property
    def nonlinear(self) -> tuple[Parameter, ...]:
        """The parameters (q,) that the columns depend on."""
        return tuple(parameter for term in self.terms for parameter in term.parameters if parameter.nonlinear)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters: the linear, then the nonlinear ones."""
        return self.linear + self.nonlinear

    @property
    def sticks(self) -> bool:
        """Whether friction may hold the joint: then its torque is anything between -Fc and Fc."""
        return any(term.sticks for term in self.terms)

    @property
    def needs_ratio(self) -> bool:
        """Whether the columns depend on Bc/Kc: where flanks part and how friction acts, the torque's sign says."""
        return any(term.contact is not None for term in self.terms)

    @cached_property
    def bends(self) -> tuple[bool, ...]:
        """Whether each term's torque is no linear filter of the motion."""
        beyond = any(term.remaining is not None or term.contact is not None for term in self.terms)
        return tuple(term.bends or (beyond and term.pushed is not None) for term in self.terms)

    @property
    def remembers(self) -> bool:
        """Whether the torque depends on other samples too."""
        return any(term.forgets is not None or term.cell is not None for term in self.terms)

    def anchored(self, motion: Motion) -> CouplingModel:
        """Return the model with origin and slowest rate of this motion, so that it is one model for every part of it.

        Needed where a recording is taken block by block, or where one part is validated by a fit to another.
        """
        slowest = _slowest(motion)
        origin = float(motion.time[0]) if len(motion) else 0.0
        middle = 0.5 * float(motion.time.min() + motion.time.max()) - origin if len(motion) else 0.0
        return replace(self, origin=origin, middle=middle, slowest=slowest, smoothing=_smoothing(motion))

    def described(self, motion: Motion, delay: float = 0.0) -> NDArray[np.bool_]:
        """Return which samples (n,) the model describes: all but those that friction may hold the joint in.

        delay: s, how much older the torque reading is. If the model estimates it, samples next to a reversal are left
        out as well, because the sign of their friction would decide it.
        """
        if not self.sticks:
            return np.ones(len(motion), dtype=bool)
        slowest = _slowest(motion) if self.slowest is None else self.slowest
        delays = any(term.delays for term in self.terms)
        beside = BESIDE * float(np.median(np.diff(motion.time))) if delays and len(motion) > 1 else 0.0
        rates = [motion.delayed(delay + shift).dtheta_dot for shift in (-beside, 0.0, beside)]
        least, most = np.min(rates, axis=0), np.max(rates, axis=0)
        return np.asarray((least >= slowest) | (most <= -slowest))

    def delay(self, nonlinear: Array | None) -> float:
        """Return how much older the torque reading is, s, for nonlinear parameters (q,); 0 if no term says."""
        return next((float(values[0]) for term, values in self._valued(nonlinear) if term.delays), 0.0)

    def columns(self, motion: Motion, nonlinear: Array | None = None, lag: float = 0.0) -> Array:
        """Return the columns (n, p) for nonlinear parameters (q,), SI; None: for those terms left out.

        lag: Bc/Kc, s, which decides when flanks that can only push part.
        """
        model = self if self.smoothing is not None else self.anchored(motion)
        whole, rows = model._needed(motion)
        seen = whole.delayed(model.delay(nonlinear))
        stacked = model._stacked(model._regressors(whole, seen, nonlinear, lag), rows, nonlinear)
        return model._known(whole, rows, model._behind_cell(whole, rows, stacked, nonlinear), nonlinear)

    def target(self, motion: Motion, torque: Array, nonlinear: Array | None = None) -> Array:
        """Return what the columns are to make up, (n,) N m: the torque (n,) without what is known of it.

        Where the model remembers, neither has the part that the unknown state at the beginning of a stretch can make.
        """
        whole, rows = self._needed(motion)
        if whole.known.any():
            known = whole.delayed(self.delay(nonlinear)).known[self._before_cell(rows)]
            torque = torque - self._behind_cell(whole, rows, known, nonlinear)
        return self._known(whole, rows, torque, nonlinear)

    def jacobian(
        self, motion: Motion, nonlinear: Array, genes: Array, lag: float = 0.0, *, changing: Motion | None = None
    ) -> Array:
        """Return how the torque changes with each nonlinear parameter: (n, q), N m per unit, at (q,) and genes (p,).

        changing: how fast the motion changes, per second; None: interpolated. Where flanks meet, the damping torque
        jumps, and where the joint turns, its friction; what that adds at single samples is left out.
        """
        model = self if self.smoothing is not None else self.anchored(motion)
        whole, rows = model._needed(motion)
        seen = whole.delayed(model.delay(nonlinear))
        regressors = model._regressors(whole, seen, nonlinear, lag)
        found: list[Array] = []
        for term, values in model._valued(nonlinear):
            if term.delays:
                rates = whole.changing(self.delay(nonlinear)) if changing is None else changing
                known = rates.known[model._before_cell(rows)]
                aged = -(model._stacked(regressors, rows, nonlinear, rates) @ genes + known)
                found.append(model._known(whole, rows, model._behind_cell(whole, rows, aged, nonlinear), nonlinear))
            elif term.shifts is not None:
                for shift in term.shifts(regressors.angle):
                    pushed = -model._pushed(regressors, nonlinear, genes, shift * regressors.contact)
                    pushed = whole.filtered(pushed, model._before_cell(rows))
                    behind = model._behind_cell(whole, rows, pushed, nonlinear)
                    found.append(model._known(whole, rows, behind, nonlinear))
            else:
                for _ in values:
                    ends = model._beside(nonlinear, len(found))
                    low, high = (model._torque(whole, rows, seen, end, genes, lag=lag) for end in ends)
                    found.append((high - low) / (ends[1] - ends[0])[len(found)])
        return np.stack(found, axis=1) if found else np.empty((len(motion), 0))

    def _beside(self, nonlinear: Array, at: int) -> Array:
        """The nonlinear parameters (2, q) a little below and above, of one of them."""
        step = STEP * max(abs(nonlinear[at]), SMALLEST)
        ends = nonlinear[at] + np.array([-step, step])
        beside = np.tile(nonlinear, (2, 1))
        beside[:, at] = np.maximum(ends, 0.0) if self.nonlinear[at].positive else ends
        return beside

    def _torque(
        self,
        motion: Motion,
        rows: Rows,
        seen: Motion,
        nonlinear: Array,
        genes: Array,
        *,
        lag: float,
    ) -> Array:
        """The torque (m,), N m, of some rows, for a motion seen with its delay, without what the beginnings make."""
        stacked = self._stacked(self._regressors(motion, seen, nonlinear, lag), rows, nonlinear)
        torque = stacked @ genes + seen.known[self._before_cell(rows)]
        return self._known(motion, rows, self._behind_cell(motion, rows, torque, nonlinear), nonlinear)

    def bounds(self, motion: Motion, highest: float) -> tuple[Array, Array]:
        """Return low (q,) and high (q,) of the nonlinear parameters, for motion up to `highest` Hz."""
        pairs = [pair for term in self.terms if term.bounds is not None for pair in term.bounds(motion, highest)]
        return np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])

    @cached_property
    def _places(self) -> tuple[tuple[Term, slice], ...]:
        """Each term that has nonlinear parameters, and which of the model's (q,) they are."""
        found, at = [], 0
        for term in self.terms:
            count = sum(parameter.nonlinear for parameter in term.parameters)
            found += [(term, slice(at, at + count))] if count else []
            at += count
        return tuple(found)

    def _valued(self, nonlinear: Array | None) -> list[tuple[Term, Array]]:
        """Each term that has nonlinear parameters, with its own of these (q,)."""
        return [] if nonlinear is None else [(term, nonlinear[own]) for term, own in self._places]

    def _needed(self, motion: Motion) -> tuple[Motion, Rows]:
        """The samples that the torque is computed of, and the rows that the motion is of these."""
        is_filtered = motion.behind is not None and any(self.bends)
        return motion.whole if self.remembers or is_filtered else (motion, slice(None))

    def _before_cell(self, rows: Rows) -> Rows:
        """The rows in front of the torque cell, which remembers, that some rows behind it need."""
        return slice(None) if any(term.cell is not None for term in self.terms) else rows

    def _behind_cell(self, motion: Motion, rows: Rows, torque: Array, nonlinear: Array | None) -> Array:
        """What a torque or columns of it, of `_before_cell(rows)`, become behind the torque cell: (m,) or (m, p)."""
        for term, values in self._valued(nonlinear):
            torque = torque if term.cell is None else term.cell(motion, torque, values)
        return torque if self._before_cell(rows) is rows else torque[rows]

    def _known(self, motion: Motion, rows: Rows, values: Array, nonlinear: Array | None) -> Array:
        """Values (m,) or (m, p) of some rows without what the unknown state at the beginning of a stretch can make."""
        valued = self._valued(nonlinear)
        left = [term.forgets(motion, own)[rows] for term, own in valued if term.forgets is not None]
        return without_beginnings(values, np.stack(left, axis=1), motion.stretch[rows]) if left else values

    def _regressors(self, motion: Motion, seen: Motion, nonlinear: Array | None, lag: float) -> Regressors:
        """The motion, seen as it was the delay before, beyond the gap or slack."""
        angle, contact, smoothing = seen.dtheta, np.ones(len(motion)), self.smoothing or 0.0
        for term, values in self._valued(nonlinear):
            if term.remaining is not None:
                angle = term.remaining(angle, values)
        for term, values in self._valued(nonlinear):
            if term.contact is not None:
                contact = term.contact(angle, seen.dtheta_dot, lag, smoothing, values)
                angle = angle * contact
        elapsed = motion.time - (self.origin or 0.0)
        return Regressors(elapsed, seen, angle, contact, smoothing, self.middle or 0.0, np.empty(0))

    def _own(self, regressors: Regressors, nonlinear: Array | None) -> Iterator[tuple[Term, Regressors]]:
        """Each term with the regressors for it; without nonlinear parameters only those that have none."""
        valued = {term.name: values for term, values in self._valued(nonlinear)}
        for term in self.terms:
            if term.linear or nonlinear is not None:
                yield term, replace(regressors, own=valued[term.name]) if term.name in valued else regressors

    def _pushed(self, regressors: Regressors, nonlinear: Array | None, genes: Array, moved: Array) -> Array:
        """How the torque, N m, changes where the deflection changes by `moved` (n,) rad, for genes (p,)."""
        parts, at = [], 0
        for term, own in self._own(regressors, nonlinear):
            count = sum(not parameter.nonlinear for parameter in term.parameters)
            if term.pushed is not None:
                parts.append(term.pushed(own, genes[at : at + count], moved))
            at += count
        return np.asarray(sum(parts[1:], start=parts[0]))

    def _stacked(
        self, regressors: Regressors, rows: Rows, nonlinear: Array | None, changing: Motion | None = None
    ) -> Array:
        """The columns, or how fast they change in time, of `_before_cell(rows)`."""
        columns: list[Array] = []
        first = self._before_cell(rows)
        bends = dict(zip((term.name for term in self.terms), self.bends, strict=True))
        for term, own in self._own(regressors, nonlinear):
            found: tuple[Array, ...] = ()
            if term.columns is not None and changing is None:
                found = term.columns(own)
            elif term.rates is not None and changing is not None:
                found = term.rates(own, changing)
            columns += [regressors.motion.filtered(of, first) if bends[term.name] else of[first] for of in found]
        return np.stack(columns, axis=1).astype(np.float64, copy=False)


def parse(name: str) -> CouplingModel:
    """Return the model of a name such as "linear+offset+coulomb"; the order of the terms does not matter.

    Raises ValueError as `ga.model.terms.canonical`.
    """
    return CouplingModel(canonical(name))


def _slowest(motion: Motion) -> float:
    """The rate, rad/s, below which friction may hold the joint; zero where the rate's noise hides which samples are.

    Where it rests, the sign of the rate is that of the noise. It is taken from the data because rates differ by four
    decades between stands.
    """
    if not len(motion):
        return 0.0
    slowest, noise = float(np.quantile(np.abs(motion.dtheta_dot), STUCK)), motion.rate_noise or 0.0
    if slowest > noise:
        return slowest
    usual = float(np.linalg.norm(motion.dtheta_dot) / np.sqrt(len(motion)))
    return RESTS * noise if RESTS * noise < QUIET * usual else 0.0


def _smoothing(motion: Motion) -> float:
    """v_s, rad/s, of the Coulomb term."""
    if not len(motion):
        return 0.0
    usual = float(np.linalg.norm(motion.dtheta_dot) / np.sqrt(len(motion)))
    return float(np.clip(NOISY * (motion.rate_noise or 0.0), FINEST * usual, SMOOTHEST * usual))
