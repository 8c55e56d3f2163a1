"""Which model a recording asks for: from `linear` upwards, a term at a time, as long as the data pay for it.

Each step up takes the term that tells held-out blocks best, of those that pay; terms that do not pay any more are let
go. What a term gains is held against what one of no meaning would: the likelihood ratio of a median regression (Koenker
and Machado 1999, 4 f(0) times the fall of the sum of absolute residuals), divided by how much more the residuals' own
correlation makes its parameters vary (`hil.uncertainty.residual_spectrum`), less log n for each (Schwarz 1978) and
what it costs to choose from so many terms (Chen and Chen 2008). Held-out blocks must not be told clearly worse.
A term with a break, whose likelihood ratio has no known law, must tell them better and gain much.
What the density f(0) and the correlation are is read from the richest model, lest what a term leaves out is taken for
noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ga.model.separable import Curved, Fit, Problem, descend, fit, settled, valley
from ga.model.terms import Model, parse
from ga.model.trajectory import Motion
from hil.uncertainty.residual_spectrum import measure

Array = NDArray[np.float64]

TERMS = ("offset", "drift", "coulomb", "cubic", "backlash", "slack", "skew")
"""What `auto` tries. `inertia` only where the torque is the motor's: from skew it differs too little to be told."""

SHAPING = frozenset({"backlash", "slack", "skew"})
"""Those of them that a model is not linear in."""

_FOLDS = 10  # blocks in time, two of which at a time are held out
_RIVAL = 1.1  # a term that makes the fitness worse than by this factor is none
_BROKEN = frozenset({"backlash", "slack"})
"""Terms with a break."""

_WORSE, _BETTER = 2.0, 1.0  # standard errors over the blocks: clearly worse, and better
_STRONG = 10.0  # gain of a term with a break, whose chance is not known to be that of others
_CONFUSED = 1000.0  # variance inflation from which a term's parameter is another's as much as its own
_EXPLAINED = 3e-4  # of the mean torque, to which the rate is accurate: what explains it so far needs no further term
_MARGIN = 1e-4  # of a range, within which a value is at its end
_EXCLUDES = {"slack": "backlash", "backlash": "slack"}
_NEEDS = {"drift": "offset", "backlash": "offset", "slack": "offset"}


@dataclass(frozen=True, slots=True)
class Rung:
    """One model of the ladder, and what its last term brought.

    fitness: N m, of all samples; held_out: N m, of blocks that the fit did not see. gain: by how much the criterion
    falls for `term`, in units in which chance gives less than zero; NaN for the lowest. Kc, Bc: SI. taken: whether the
    term is in the model that was chosen.
    """

    model: str
    term: str
    fitness: float
    held_out: float
    gain: float
    Kc: float
    Bc: float
    taken: bool


@dataclass(frozen=True, slots=True)
class Ladder:
    """model: the one chosen, anchored. rungs: up to it, then one for each term that was not taken, on top of it.

    residuals: (n,) N m, of its fit. skew: s, how much older the torque reading is, 0 where the model has no such term.
    """

    model: Model
    rungs: tuple[Rung, ...]
    residuals: Array
    skew: float


@dataclass(frozen=True, eq=False)
class _Step:
    """A model's fit to all the samples; held_out: (_FOLDS,) N m, of blocks that fits to the others did not see."""

    terms: tuple[str, ...]
    model: Model
    problem: Problem
    fit: Fit
    held_out: Array


def climb(motion: Motion, torque: Array, highest: float, terms: tuple[str, ...] = TERMS) -> Ladder:
    """The model that motion (n,) and torque (n,), N m, ask for; highest: Hz, up to where the joint moved.

    Raises RuntimeError where not even the lowest rung can be fitted.
    """
    climber = _Climber(motion, torque, highest, terms)
    climber.listen()
    chosen, seen = climber.step(climber.lowest), set[frozenset[str]]()
    while (larger := climber.higher(chosen)) is not None:
        seen.add(frozenset(chosen.terms))
        larger = climber.pruned(larger)
        if frozenset(larger.terms) in seen:
            break  # the new term took the place of one that it needs: round and round
        chosen = larger
    return climber.ladder(climber.pruned(chosen))


class _Climber:
    """A recording, the models fitted to it so far, and what its noise is like."""

    def __init__(self, motion: Motion, torque: Array, highest: float, terms: tuple[str, ...]) -> None:
        self._motion, self._torque, self._highest, self._candidates = motion, torque, highest, terms
        self._steps: dict[tuple[str, ...], _Step] = {}
        self._glimpses: dict[tuple[str, ...], Fit | None] = {}
        self._size = float(np.mean(np.abs(torque)))
        # no reading's zero is quite where the coupling's is: other terms would stand in for it on the way
        self.lowest = ("linear", "offset") if "offset" in terms else ("linear",)

    def listen(self) -> None:
        """Take what the richest model leaves of the torque for the noise: less would take missing terms for noise."""
        terms = self._richest()
        problem, seen = self._problem(terms), self._glimpse(terms)
        residuals = problem.residuals(descend(problem, seen.shape if seen else problem.low))
        self._signs = np.sign(residuals)
        near = float(np.quantile(np.abs(residuals), min(0.5, 3.0 * len(residuals) ** (-1.0 / 3.0))))
        inside = np.count_nonzero(np.abs(residuals) <= near)
        self._density = inside / (2.0 * near * len(residuals)) if near > 0.0 else np.inf

    def _richest(self) -> tuple[str, ...]:
        """All terms that lower the fitness one after the other, the better of two that exclude each other."""
        found = {self.lowest}
        for term in self._candidates:
            for terms in tuple(found):
                more = (*terms, term)
                if _fits_in(term, terms) and self._fitness(more) < self._fitness(terms):
                    found.add(more)
                    found -= set() if term in _EXCLUDES else {terms}
        return min(found, key=self._fitness)

    def _fitness(self, terms: tuple[str, ...]) -> float:
        seen = self._glimpse(terms)
        return seen.fitness if seen else np.inf

    def _beyond(self, terms: tuple[str, ...]) -> dict[str, Fit]:
        """The terms that lower the fitness, as some of the samples show, and what is then seen of them."""
        less, found = self._glimpse(terms), {}
        for term in self._candidates:
            more = self._glimpse((*terms, term)) if _fits_in(term, terms) else None
            if less is not None and more is not None and more.fitness < less.fitness:
                found[term] = more
        return found

    def _glimpse(self, terms: tuple[str, ...]) -> Fit | None:
        """The fit to some of the samples; None where the columns are too much alike."""
        if terms not in self._glimpses:
            less = self._glimpse(terms[:-1]) if len(terms) > 1 else None
            near = {} if less is None else _shape(_model(terms[:-1]), less)
            try:
                self._glimpses[terms] = valley(self._problem(terms).thinned(), near)
            except RuntimeError:
                self._glimpses[terms] = None
        return self._glimpses[terms]

    def higher(self, step: _Step) -> _Step | None:
        """With one more term: of those that pay, the one that tells held-out blocks best; None where none pays."""
        errors = {
            term: self._held_out(self._problem((*step.terms, term)), found).mean()
            for term, found in self._beyond(step.terms).items()
        }
        for term in sorted(errors, key=lambda term: errors[term]):
            larger = self.step((*step.terms, term), beside=step)
            if self.pays(step, larger, term):
                return larger
        return None

    def step(self, terms: tuple[str, ...], beside: _Step | None = None) -> _Step:
        """The model of these terms, fitted to all samples; beside: a fit that its shape may be like."""
        if terms not in self._steps:
            problem, seen = self._problem(terms), self._glimpses.get(terms)
            near = _shape(beside.model, beside.fit) if beside else {}
            found = fit(problem, near) if seen is None else settled(problem, seen.shape)
            self._steps[terms] = _Step(terms, _model(terms), problem, found, self._held_out(problem, found))
        return self._steps[terms]

    def _held_out(self, problem: Problem, found: Fit) -> Array:
        """The mean error, N m, of each block in time, left out of the fit that judges it; the shape is that of all."""
        thin = problem.thinned()
        block = np.arange(len(thin.torque)) * _FOLDS // len(thin.torque)
        errors = np.empty(_FOLDS)
        for first in range(_FOLDS // 2):
            out = block % (_FOLDS // 2) == first
            left = np.abs(thin.of(out).residuals(thin.of(~out).solve(found.shape)))
            for number in (first, first + _FOLDS // 2):
                errors[number] = left[block[out] == number].mean()
        return errors

    def gain(self, smaller: _Step, larger: _Step, term: str) -> float:
        """What the term gains beyond chance that the larger model has and the smaller has not."""
        count = len(self._torque)
        ratio = 4.0 * self._density * count * (smaller.fit.fitness - larger.fit.fitness)
        alike = self._correlation(larger, term)
        chosen_from = np.log(len(self._candidates))  # their gamma of 1/2
        return float(ratio / alike - len(_own(term)) * np.log(max(count / alike, np.e)) - chosen_from)

    def pays(self, smaller: _Step, larger: _Step, term: str) -> bool:
        """Whether the larger model is worth the term."""
        if smaller.fit.fitness < _EXPLAINED * self._size:
            return False
        if self._ends(larger, term) or not self._is_told(larger, term):
            return False
        if _stiffness(larger) <= 0.0 < _stiffness(smaller):  # no coupling pushes: the term stands in for it
            return False
        better = smaller.held_out - larger.held_out
        # a skew moves the breaks that friction makes at every reversal, and a spring that stiffens looks like a gap
        beside = {"skew": {"coulomb"}, "cubic": _BROKEN}.get(term, set())
        broken = term in _BROKEN or bool(beside & set(larger.terms))
        least, gain = (_BETTER, _STRONG) if broken else (-_WORSE, 0.0)
        if better.mean() < least * better.std(ddof=1) / np.sqrt(_FOLDS):
            return False
        return self.gain(smaller, larger, term) > gain

    def _own_columns(self, step: _Step, term: str) -> Iterator[tuple[Array, Array]]:
        """For each parameter of the term: its column (n,), and what of that no other parameter's column can make."""
        columns = step.problem.linearised(step.fit)[0]
        names = [parameter.name for parameter in step.model.parameters]
        for name in _own(term):
            at = names.index(name)
            others = np.delete(columns, at, axis=1)
            yield columns[:, at], columns[:, at] - others @ np.linalg.lstsq(others, columns[:, at], rcond=None)[0]

    def _correlation(self, step: _Step, term: str) -> float:
        """How many times more the term's parameters vary than if the residuals did not follow each other."""
        found = 1.0
        for _, alone in self._own_columns(step, term):
            power = float(alone @ alone)
            spectrum = measure([(alone[:, None], self._signs)])
            found = max(found, float(spectrum.covariance[0, 0]) / power) if power > 0.0 else np.inf
        return found

    def _is_told(self, step: _Step, term: str) -> bool:
        """Whether the term does what no other does: a skew is a damping where the joint moves slowly."""
        return all(column @ column < _CONFUSED * (alone @ alone) for column, alone in self._own_columns(step, term))

    def _ends(self, step: _Step, term: str) -> bool:
        """Whether a parameter of the term came to an end of its bounds: the data do not want it at all."""
        problem = step.problem
        near = _MARGIN * (problem.high - problem.low)
        ends = (step.fit.shape <= problem.low + near) | (step.fit.shape >= problem.high - near)
        return any(end and p.name in _own(term) for end, p in zip(ends, step.model.shape, strict=True))

    def pruned(self, step: _Step) -> _Step:
        """The same without the terms that, now that all are there, do not pay."""
        idle = []
        for term in step.terms[1:]:
            if term not in (_NEEDS.get(other) for other in step.terms):
                smaller = self.step(tuple(other for other in step.terms if other != term), beside=step)
                if not self.pays(smaller, step, term):
                    idle.append((self.gain(smaller, step, term), smaller))
        return self.pruned(min(idle, key=lambda pair: pair[0])[1]) if idle else step

    def ladder(self, chosen: _Step) -> Ladder:
        """What was chosen and why."""
        model = chosen.model.anchored(self._motion)
        return Ladder(model, self._rungs(chosen), chosen.problem.residuals(chosen.fit), skew_of(model, chosen.fit))

    def _rungs(self, chosen: _Step) -> tuple[Rung, ...]:
        """Up to the chosen model a term at a time, then what each other term would do to it."""
        steps = [self.step(chosen.terms[: i + 1], beside=chosen) for i in range(len(chosen.terms))]
        found = [_rung(steps[0], float("nan"), taken=True)]
        found += [_rung(b, self.gain(a, b, b.terms[-1]), taken=True) for a, b in pairwise(steps)]
        for term in self._candidates:
            glimpsed = self._glimpse((*chosen.terms, term)) if _fits_in(term, chosen.terms) else None
            if glimpsed is not None and glimpsed.fitness < _RIVAL * chosen.fit.fitness:
                more = self.step((*chosen.terms, term), beside=chosen)
                found.append(_rung(more, self.gain(chosen, more, term), taken=False))
        return tuple(found)

    def _problem(self, terms: tuple[str, ...]) -> Problem:
        model = _model(terms).anchored(self._motion)
        return Problem(model, self._motion, self._torque, *model.bounds(self._motion, self._highest))


def _model(terms: tuple[str, ...]) -> Model:
    return parse("+".join(terms))


def skew_of(model: Curved, fit: Fit) -> float:
    """The skew, s, that a fit found; 0 where the model has none."""
    return _shape(model, fit).get("skew", 0.0)


def _shape(model: Curved, fit: Fit) -> dict[str, float]:
    """What a fit found for the shape, by name."""
    return dict(zip((parameter.name for parameter in model.shape), fit.shape.tolist(), strict=True))


def _fits_in(term: str, terms: tuple[str, ...]) -> bool:
    return term not in terms and _EXCLUDES.get(term) not in terms and (_NEEDS.get(term) or "linear") in terms


def _own(term: str) -> tuple[str, ...]:
    """The names of a term's own parameters."""
    return tuple(p.name for p in _model(("linear", term)).parameters if p.name not in {"Kc", "Bc"})


def _stiffness(step: _Step) -> float:
    return float(step.fit.optimum.genes[0])


def _rung(step: _Step, gain: float, *, taken: bool) -> Rung:
    kc, bc = step.fit.optimum.genes[:2]
    return Rung(
        step.model.name,
        step.terms[-1],
        step.fit.fitness,
        float(step.held_out.mean()),
        gain,
        float(kc),
        float(bc),
        taken,
    )
