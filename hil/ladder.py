"""Which model a recording asks for: from `linear` upwards, a term at a time, as long as the data pay for it.

The path up is greedy: each step takes the term that lowers the fitness most. How far up it is followed is decided by
what each term gains against what a term of no meaning would: the likelihood ratio of a median regression (Koenker and
Machado 1999, 4 f(0) times the fall of the sum of absolute residuals), divided by how much more the residuals' own
correlation makes its parameter vary (blocks in time), less log n (Schwarz 1978); and by held-out blocks of the
recording, which must be told better too. What the density f(0) and the correlation are is read from the top of the
path, lest what a term leaves out is taken for noise. On a tie the simpler model stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ga.curved import Fit, Problem, descend, fit, valley
from ga.models import Model, parse
from ga.motion import Motion

Array = NDArray[np.float64]

TERMS = ("offset", "drift", "coulomb", "cubic", "backlash", "slack", "skew")
"""What `auto` tries. `inertia` only where the torque is the motor's: from skew it differs too little to be told."""

SHAPING = frozenset({"backlash", "slack", "skew"})
"""Those of them that a model is not linear in."""

_FOLDS = 10  # blocks in time; every fifth is held out
_BLOCKS = 40  # blocks over which correlated residuals are counted
_RIVAL = 1.1  # a term that makes the fitness worse than by this factor is none
_EXPLAINED = 3e-4  # of the mean torque, to which the rate is accurate: what explains it so far needs no further term
_EXCLUDES = {"slack": "backlash", "backlash": "slack"}
_NEEDS = {"drift": "offset"}


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
    """model: the one chosen, anchored. rungs: up to it, then one for each term that was not taken, on top of it."""

    model: Model
    rungs: tuple[Rung, ...]


@dataclass(frozen=True, eq=False)
class _Step:
    """A model's fit to all the samples; held_out: N m, of the blocks that a fit to the others did not see."""

    terms: tuple[str, ...]
    model: Model
    problem: Problem
    fit: Fit
    held_out: float


def climb(motion: Motion, torque: Array, highest: float, terms: tuple[str, ...] = TERMS) -> Ladder:
    """The model that motion (n,) and torque (n,), N m, ask for; highest: Hz, up to where the joint moved.

    Raises RuntimeError where not even the lowest rung can be fitted.
    """
    climber = _Climber(motion, torque, highest)
    path: list[tuple[str, ...]] = [("linear",)]
    while (term := climber.next(path[-1], terms)) is not None:
        path.append((*path[-1], term))
        climber.step(path[-1], beside=path[-2])
    steps = [climber.step(rung) for rung in path]
    climber.look_from(steps[-1])
    top = max((i for i in range(1, len(steps)) if climber.pays(steps[i - 1], steps[i], path[i][-1])), default=0)
    chosen = climber.pruned(steps[top])
    return Ladder(chosen.model, climber.rungs(chosen, terms))


class _Climber:
    """A recording, the models fitted to it so far, and what its noise is like."""

    def __init__(self, motion: Motion, torque: Array, highest: float) -> None:
        self._motion, self._torque, self._highest = motion, torque, highest
        self._steps: dict[tuple[str, ...], _Step] = {}
        self._size = float(np.mean(np.abs(torque)))
        number = np.arange(len(torque)) * _FOLDS // len(torque)
        self._out = number % 5 == 2

    def _shape(self, terms: tuple[str, ...]) -> dict[str, float]:
        """What the fit of these terms found for its shape, by name."""
        step = self.step(terms)
        return dict(zip((p.name for p in step.model.shape), step.fit.shape.tolist(), strict=True))

    def next(self, terms: tuple[str, ...], candidates: tuple[str, ...]) -> str | None:
        """The candidate that lowers the fitness most, as every so many-th sample shows; None where none does."""
        tried = {term: self._glimpse(terms, term) for term in candidates if _fits_in(term, terms)}
        best = min(tried, key=lambda term: tried[term], default=None)
        return best if best is not None and tried[best] < 1.0 else None

    def _glimpse(self, terms: tuple[str, ...], term: str) -> float:
        """The fitness with the term over that without, on every so many-th sample."""
        with_it, without = self._problem((*terms, term)).thinned(), self._problem(terms).thinned()
        try:
            return valley(with_it, self._shape(terms)).fitness / without.solve(self.step(terms).fit.shape).fitness
        except RuntimeError:  # too much like the other columns to be solved for
            return np.inf

    def step(self, terms: tuple[str, ...], beside: tuple[str, ...] = ()) -> _Step:
        """The model of these terms, fitted to all samples; beside: those of a model that its shape may be like."""
        if terms not in self._steps:
            problem = self._problem(terms)
            found = fit(problem, self._shape(beside) if beside else {})
            seen = descend(problem.of(~self._out), found.shape)
            left = np.abs(problem.of(self._out).residuals(seen))
            self._steps[terms] = _Step(terms, _model(terms), problem, found, float(left.mean()))
        return self._steps[terms]

    def look_from(self, top: _Step) -> None:
        """Take what the richest model leaves for the noise."""
        residuals = top.problem.residuals(top.fit)
        self._signs = np.sign(residuals)
        near = float(np.quantile(np.abs(residuals), min(0.5, 3.0 * len(residuals) ** (-1.0 / 3.0))))
        inside = np.count_nonzero(np.abs(residuals) <= near)
        self._density = inside / (2.0 * near * len(residuals)) if near > 0.0 else np.inf

    def gain(self, smaller: _Step, larger: _Step, term: str) -> float:
        """What the term gains beyond chance that the larger model has and the smaller has not."""
        count = len(self._torque)
        ratio = 4.0 * self._density * count * (smaller.fit.fitness - larger.fit.fitness)
        return float(ratio / self._correlation(larger, term) - np.log(count))

    def pays(self, smaller: _Step, larger: _Step, term: str) -> bool:
        """Whether the larger model is worth the term."""
        if smaller.fit.fitness < _EXPLAINED * self._size:
            return False
        return self.gain(smaller, larger, term) > 0.0 and larger.held_out < smaller.held_out

    def _correlation(self, step: _Step, term: str) -> float:
        """How many times more the term's parameter varies than if the residuals did not follow each other."""
        columns = step.problem.linearised(step.fit)[0]
        at = _place(step.model, term)
        others = np.delete(columns, at, axis=1)
        score = (columns[:, at] - others @ np.linalg.lstsq(others, columns[:, at], rcond=None)[0]) * self._signs
        edges = np.arange(_BLOCKS) * len(score) // _BLOCKS
        blocks = np.add.reduceat(score, edges)
        return max(1.0, float(blocks @ blocks / (score @ score)))

    def pruned(self, step: _Step) -> _Step:
        """The same without the terms that, now that all are there, do not pay."""
        idle = []
        for term in step.terms[1:]:
            if term not in (_NEEDS.get(other) for other in step.terms):
                smaller = self.step(tuple(other for other in step.terms if other != term), beside=step.terms)
                if not self.pays(smaller, step, term):
                    idle.append((self.gain(smaller, step, term), smaller))
        return self.pruned(min(idle, key=lambda pair: pair[0])[1]) if idle else step

    def rungs(self, chosen: _Step, candidates: tuple[str, ...]) -> tuple[Rung, ...]:
        """Up to the chosen model a term at a time, then what each other term would do to it."""
        steps = [self.step(chosen.terms[: i + 1], beside=chosen.terms) for i in range(len(chosen.terms))]
        found = [_rung(steps[0], float("nan"), taken=True)]
        found += [_rung(b, self.gain(a, b, b.terms[-1]), taken=True) for a, b in pairwise(steps)]
        for term in candidates:
            if _fits_in(term, chosen.terms) and self._glimpse(chosen.terms, term) < _RIVAL:
                more = self.step((*chosen.terms, term), beside=chosen.terms)
                found.append(_rung(more, self.gain(chosen, more, term), taken=False))
        return tuple(found)

    def _problem(self, terms: tuple[str, ...]) -> Problem:
        model = _model(terms).anchored(self._motion)
        return Problem(model, self._motion, self._torque, *model.bounds(self._motion, self._highest))


def _model(terms: tuple[str, ...]) -> Model:
    return parse("+".join(terms))


def _fits_in(term: str, terms: tuple[str, ...]) -> bool:
    return term not in terms and _EXCLUDES.get(term) not in terms and (_NEEDS.get(term) or "linear") in terms


def _place(model: Model, term: str) -> int:
    """The place of a term's first parameter among all."""
    own = _model(("linear", term)).parameters[2 if term != "linear" else 0].name
    return [parameter.name for parameter in model.parameters].index(own)


def _rung(step: _Step, gain: float, *, taken: bool) -> Rung:
    kc, bc = step.fit.optimum.genes[:2]
    return Rung(step.model.name, step.terms[-1], step.fit.fitness, step.held_out, gain, float(kc), float(bc), taken)
