"""Model selection by forward steps: a term is included as long as the data pay for it.

Each step includes the term that predicts held-out blocks best, of those that pay; terms that do not pay any more are
removed. The gain of a term is the likelihood ratio of a median regression (Koenker and Machado 1999, 4 f(0) times the
fall of the sum of absolute residuals), divided by the factor by which the residuals' correlation raises the variance of
its parameters (`hil.uncertainty.residual_spectrum`), less log n for each (Schwarz 1978) and the cost of choosing from
so many terms (Chen and Chen 2008). Held-out blocks must not be predicted clearly worse. A term with a break, whose
likelihood ratio has no known law, must predict them better and gain much. The density f(0) and the correlation are
those of the richest model's residuals, because a missing term must not be taken for noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ga.model.coupling import CouplingModel, parse
from ga.model.polishing import polished
from ga.model.separable import Fit, Problem, best_start, descend, fit, local_minimum
from ga.model.terms import CONSIDERED, RARER, TERMS, is_addable
from ga.model.trajectory import Motion
from hil.signals.windows import is_smooth
from hil.uncertainty.residual_spectrum import measure

Array = NDArray[np.float64]

_FOLDS = 10  # blocks in time, two of which at a time are held out
_RIVAL = 1.1  # a term that makes the fitness worse than by this factor is none
_WORSE, _BETTER = 2.0, 1.0  # standard errors over the blocks: clearly worse, and better
_STRONG = 10.0  # gain of a term with a break, whose chance is not known to be that of others
_CONFUSED = 1000.0  # variance inflation from which a term's parameter cannot be distinguished from others
_EXPLAINED = 3e-4  # of the mean torque, to which the rate is accurate: what explains it so far needs no further term
_LATE = ("skew", "lag")  # why a torque reading may be late
_EARLIER = (*_LATE, "inertia")  # and why it may seem to be early
_STIFFEST, _FELT = 2.0, 0.1  # times Kc, what relaxes at most; part of Bc that a late reading hides, which matters
_RARE = 2.0 * math.log(10.0)  # in Akaike's criterion: one joint in ten relaxes faster than it moves
_LIKELY = 3  # rarer terms that are considered, of those that lower the fitness most
_MARGIN = 1e-4  # of a range, within which a value is at its end


@dataclass(frozen=True, slots=True)
class Step:
    """One model of the selection, and the gain of its last term.

    fitness: N m, of all samples; held_out: N m, of blocks that the fit did not see. gain: by how much the criterion
    falls for `term`, in units in which chance gives less than zero; NaN for the first. Kc, Bc: SI. included: whether
    the term is in the model selected, or was rejected.
    """

    model: str
    term: str
    fitness: float
    held_out: float
    gain: float
    Kc: float
    Bc: float
    included: bool


@dataclass(frozen=True, slots=True)
class Alternative:
    """A model that may stand in place of the one selected, its nonlinear parameters (q,), SI, and Akaike's criterion of
    it less that of the one selected.
    """

    model: CouplingModel
    nonlinear: Array
    criterion: float


@dataclass(frozen=True, slots=True)
class Selection:
    """The model selected, anchored, and the steps: up to it, then one for each rejected term on top of it.

    residuals: (n,) N m, of its fit; columns: (n, p + q), of the problem linearised there, and values (p + q,), SI.
    delay: s, how much older the torque reading is, 0 where no term of the model says. alternatives: models with another
    account of why the torque reading is late.
    """

    model: CouplingModel
    steps: tuple[Step, ...]
    residuals: Array
    columns: Array
    values: Array
    delay: float
    alternatives: tuple[Alternative, ...] = ()


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A model's fit to all the samples; held_out: (_FOLDS,) N m, of blocks that fits to the others did not see."""

    terms: tuple[str, ...]
    model: CouplingModel
    problem: Problem
    fit: Fit
    held_out: Array


def select(
    motion: Motion,
    torque: Array,
    highest: float,
    terms: tuple[str, ...] = CONSIDERED,
    *,
    rarer: tuple[str, ...] = (),
    like_skew: tuple[str, ...] = (),
    describes: Callable[[Selection], bool] = lambda _selection: True,
) -> Selection:
    """Return the model for motion (n,) and torque (n,), N m; highest: Hz, up to where the joint moved.

    describes: whether a model describes the recording; where it does not, rarer terms are considered too. like_skew:
    terms that may be in the torque where a skew seems to be.
    Raises RuntimeError where not even the smallest model can be fitted.
    """
    selector = _Selector(motion, torque, highest, terms, like_skew)
    selector.measure_noise()
    usual = _climbed(selector, selector.candidate(selector.smallest))
    if not rarer:
        return selector.explained(usual)
    if describes(selector.selection(usual)):
        return selector.explained(selector.instead_of_skew(usual))
    selector.consider(selector.likeliest(rarer, usual.terms))
    selector.measure_noise()
    richer = _climbed(selector, selector.candidate(selector.smallest))
    return selector.explained(richer if set(rarer).intersection(richer.terms) else usual)


def _climbed(selector: _Selector, chosen: _Candidate) -> _Candidate:
    """Return the model after the steps from one chosen, each with the term that pays most, and those that do not."""
    seen: set[frozenset[str]] = set()
    while (larger := selector.larger(chosen)) is not None:
        seen.add(frozenset(chosen.terms))
        larger = selector.pruned(larger)
        if frozenset(larger.terms) in seen:
            break  # the new term replaced one that it needs: this would repeat for ever
        chosen = larger
    return selector.pruned(chosen)


class _Selector:
    """A recording, the models fitted to it so far, and the properties of its noise."""

    def __init__(
        self, motion: Motion, torque: Array, highest: float, terms: tuple[str, ...], like_skew: tuple[str, ...] = ()
    ) -> None:
        self._motion, self._torque, self._highest, self._candidates = motion, torque, highest, terms
        self._like_skew = like_skew
        self._fitted: dict[tuple[str, ...], _Candidate] = {}
        self._previews: dict[tuple[str, ...], Fit | None] = {}
        self._size, self._smooth = (
            float(np.mean(np.abs(torque))),
            is_smooth(motion.time, motion.dtheta, motion.dtheta_dot),
        )
        smallest = [name for name, term in TERMS.items() if term.selection == "smallest"]
        self.smallest = tuple(name for name in smallest if name == "linear" or name in terms)
        self._rich, self._compared = self.smallest, 1

    def consider(self, terms: tuple[str, ...]) -> None:
        """Consider some more terms, which may be much alike."""
        self._candidates, self._compared = (*self._candidates, *terms), _LIKELY

    def instead_of_skew(self, chosen: _Candidate) -> _Candidate:
        """Return the model with a lag or an inertia in place of its skew where that fits clearly better."""
        gains = {}
        for one in self._like_skew if "skew" in chosen.terms else ():
            terms = _replaced(chosen.terms, one)
            if self._fitness(terms) < np.inf:
                other = self.candidate(terms)
                impossible = self._ends(other, one) or _damping(other) < 0.0 or _is_impossible(other, one)
                gains[one] = 0.0 if impossible else float(self.ratio(chosen, other) / self._correlation(other, one))
        best = max(gains, key=lambda one: gains[one], default="")
        return self.candidate(_replaced(chosen.terms, best)) if gains.get(best, 0.0) > _STRONG else chosen

    def _alternatives(self, chosen: _Candidate) -> tuple[Alternative, ...]:
        """The models with a skew, a lag of the cell, both, an inertia or a branch, in place of its own."""
        if not {*_LATE, *self._like_skew}.intersection(chosen.terms) or "mean" in chosen.terms:
            return ()
        others = tuple(term for term in chosen.terms if term not in {*_LATE, *self._like_skew})
        alone = [one for term in _LATE if (one := self._late((*others, term))) is not None]
        nearest = min(alone, key=lambda one: one.fit.fitness, default=chosen)
        both = self._late((*others, *_LATE), beside=nearest)
        moved = self._late((*others, "inertia")) if "inertia" in self._like_skew else None
        found = alone + [one for one in (both, moved, self._relaxing(chosen, others)) if one is not None]
        alike = max(self._correlation(one, term) for one in (chosen, *found) for term in _EARLIER if term in one.terms)
        return tuple(
            Alternative(
                one.model.anchored(self._motion),
                one.fit.nonlinear,
                2.0 * (len(one.model.parameters) - len(chosen.model.parameters))
                - self.ratio(chosen, one) / alike
                + (_RARE if "maxwell" in one.terms and "maxwell" not in chosen.terms else 0.0),
            )
            for one in found
            if set(one.terms) != set(chosen.terms)
        )

    def _relaxing(self, chosen: _Candidate, others: tuple[str, ...]) -> _Candidate | None:
        """The model with a branch that relaxes faster than the joint moved, in place of a late torque reading.

        Both stiffen fast motion, and the branch is a damper besides. None is much stiffer than Kc.
        """
        values = _values(chosen)
        late = sum(abs(values.get(term, 0.0)) for term in _LATE)
        if not is_addable("maxwell", others) or late * values["Kc"] < _FELT * values["Bc"]:
            return None
        terms = (*others, "maxwell")
        if self._fitness(terms) == np.inf:
            return None
        found = self.candidate(terms)
        branch = _values(found)
        possible = not _is_impossible(found, "maxwell") and _damping(found) >= 0.0 and not self._ends(found, "maxwell")
        return found if possible and branch["K1"] <= _STIFFEST * branch["Kc"] else None

    def _late(self, terms: tuple[str, ...], beside: _Candidate | None = None) -> _Candidate | None:
        """The model of these terms, where its skew and lag are within their bounds and no damping is negative."""
        if self._fitness(terms) == np.inf:
            return None
        found = self.candidate(terms, beside)
        if beside is not None:
            # much alike: roughly on some of the samples, then on all
            rough = polished(found.problem.thinned(), found.fit)
            near = polished(found.problem, descend(found.problem, rough.nonlinear), reach=1.0)
            found = replace(found, fit=min(found.fit, near, key=lambda fit: fit.fitness))
        late = [term for term in _EARLIER if term in terms]
        impossible = any(self._ends(found, term) or _is_impossible(found, term) for term in late)
        return None if impossible or _damping(found) < 0.0 else found

    def _criterion(self, reference: _Candidate, one: _Candidate) -> float:
        """Schwarz's criterion of a model, less that of the reference without its parameters."""
        return len(one.model.parameters) * float(np.log(len(self._torque))) - self.ratio(reference, one)

    def likeliest(self, terms: tuple[str, ...], chosen: tuple[str, ...]) -> tuple[str, ...]:
        """Return the terms that lower the fitness most, alone or beside those of the model chosen."""
        lowest = {}
        for term in terms:
            larger = [(*less, term) for less in (self.smallest, chosen) if is_addable(term, less)]
            lowest[term] = min((self._fitness(more) for more in larger), default=np.inf)
        return tuple(sorted((term for term in terms if lowest[term] < np.inf), key=lambda term: lowest[term])[:_LIKELY])

    def measure_noise(self) -> None:
        """Take the residuals of the richest model for the noise: those of a smaller one would hold missing terms."""
        terms = self._rich = self._richest()
        problem, seen = self._problem(terms), self._preview(terms)
        residuals = problem.residuals(descend(problem, seen.nonlinear if seen else problem.low))
        self._signs = np.sign(residuals)
        near = float(np.quantile(np.abs(residuals), min(0.5, 3.0 * len(residuals) ** (-1.0 / 3.0))))
        inside = np.count_nonzero(np.abs(residuals) <= near)
        self._density = inside / (2.0 * near * len(residuals)) if near > 0.0 else np.inf

    def _richest(self) -> tuple[str, ...]:
        """All terms that lower the fitness one after the other, the better of two that exclude each other."""
        found = {self._rich}
        for term in self._candidates:
            for terms in tuple(found):
                more = (*terms, term)
                if is_addable(term, terms) and self._fitness(more) < self._fitness(terms):
                    found.add(more)
                    found -= set() if self._has_rivals(term) else {terms}
        return min(found, key=self._fitness)

    def _has_rivals(self, term: str) -> bool:
        """Whether there is a candidate that the term cannot stand beside."""
        return bool(TERMS[term].excludes) or any(term in TERMS[other].excludes for other in self._candidates)

    def _fitness(self, terms: tuple[str, ...]) -> float:
        seen = self._preview(terms)
        return seen.fitness if seen else np.inf

    def _beyond(self, terms: tuple[str, ...]) -> dict[str, Fit]:
        """The terms that lower the fitness on some of the samples, each with its fit to these."""
        less, found = self._preview(terms), {}
        for term in self._candidates:
            more = self._preview((*terms, term)) if is_addable(term, terms) else None
            if less is not None and more is not None and more.fitness < less.fitness:
                found[term] = more
        return found

    def _preview(self, terms: tuple[str, ...]) -> Fit | None:
        """The fit to some of the samples; None where the columns are too much alike."""
        if terms not in self._previews:
            less = self._preview(terms[:-1]) if len(terms) > 1 else None
            near = {} if less is None else _named(_model(terms[:-1]), less)
            try:
                self._previews[terms] = best_start(self._problem(terms).thinned(), near)
            except RuntimeError:
                self._previews[terms] = None
        return self._previews[terms]

    def larger(self, smaller: _Candidate) -> _Candidate | None:
        """Return the model with one more term that pays, the one that predicts held-out blocks best; None if none."""
        errors = {
            term: self._held_out(self._problem((*smaller.terms, term)), found).mean()
            for term, found in self._beyond(smaller.terms).items()
        }
        paying: list[_Candidate] = []
        for term in sorted(errors, key=lambda term: errors[term]):
            larger = self.candidate((*smaller.terms, term), beside=smaller)
            if self.pays(smaller, larger, term):
                paying.append(larger)
            if len(paying) == self._compared:
                break
        # held-out blocks cannot distinguish terms that are much alike: all samples may
        return min(paying, key=lambda larger: self._criterion(smaller, larger)) if paying else None

    def candidate(self, terms: tuple[str, ...], beside: _Candidate | None = None) -> _Candidate:
        """Return the model of these terms, fitted to all samples; beside: a fit with similar nonlinear parameters."""
        if terms not in self._fitted:
            problem, seen = self._problem(terms), self._previews.get(terms)
            near = _named(beside.model, beside.fit) if beside else {}
            found = fit(problem, near) if seen is None else local_minimum(problem, seen.nonlinear, near)
            self._fitted[terms] = _Candidate(terms, _model(terms), problem, found, self._held_out(problem, found))
        return self._fitted[terms]

    def _held_out(self, problem: Problem, found: Fit) -> Array:
        """The mean error, N m, of each block in time under a fit to the others with all's nonlinear parameters."""
        thin = problem.thinned()
        block = np.arange(len(thin.torque)) * _FOLDS // len(thin.torque)
        errors = np.empty(_FOLDS)
        for first in range(_FOLDS // 2):
            out = block % (_FOLDS // 2) == first
            left = np.abs(thin.of(out).residuals(thin.of(~out).solve(found.nonlinear)))
            for number in (first, first + _FOLDS // 2):
                errors[number] = left[block[out] == number].mean()
        return errors

    def gain(self, smaller: _Candidate, larger: _Candidate, term: str, share: float = 1.0) -> float:
        """Return the gain beyond chance of the term that the larger model has and the smaller has not.

        share: of the samples, to which both are fitted.
        """
        count, ratio = share * len(self._torque), share * self.ratio(smaller, larger)
        alike = self._correlation(self._fitted[larger.terms], term)
        chosen_from = np.log(len(self._candidates))  # their gamma of 1/2
        return float(ratio / alike - len(_own(term)) * np.log(max(count / alike, math.e)) - chosen_from)

    def ratio(self, one: _Candidate, other: _Candidate) -> float:
        """Return twice by how much the other model's logarithmic likelihood is higher, for independent residuals."""
        return 4.0 * self._density * len(self._torque) * (one.fit.fitness - other.fit.fitness)

    def pays(self, smaller: _Candidate, larger: _Candidate, term: str) -> bool:
        """Return whether the term pays that the larger model has and the smaller has not."""
        if smaller.fit.fitness < _EXPLAINED * self._size:
            return False
        if self._ends(larger, term) or not self._is_distinct(larger, term):
            return False
        if _stiffness(larger) <= 0.0 < _stiffness(smaller):  # no coupling pushes: the term stands in for it
            return False
        if _is_impossible(larger, term) or (_damping(larger) < 0.0 <= _damping(smaller)):
            return False
        better = smaller.held_out - larger.held_out
        breaks = TERMS[term].breaks or any(other in larger.terms for other in TERMS[term].confusable) or term in RARER
        least, gain = (_BETTER, _STRONG) if breaks else (-_WORSE, 0.0)
        if better.mean() < least * better.std(ddof=1) / np.sqrt(_FOLDS):
            return False
        return self.gain(smaller, larger, term) > gain and self._pays_where_smooth(smaller, larger, term)

    def _pays_where_smooth(self, smaller: _Candidate, larger: _Candidate, term: str) -> bool:
        """Whether a linear term pays without the samples in which the rate is wrong too: those make a cubic."""
        if not TERMS[term].linear or self._smooth.all():
            return True
        less, more = (self._where_smooth(one) for one in (smaller, larger))
        return self.gain(less, more, term, float(np.mean(self._smooth))) > 0.0

    def _where_smooth(self, one: _Candidate) -> _Candidate:
        part = one.problem.of(self._smooth)
        return replace(one, problem=part, fit=part.solve(one.fit.nonlinear, one.fit))

    def _own_columns(self, fitted: _Candidate, term: str) -> Iterator[tuple[Array, Array]]:
        """For each parameter of the term: its column (n,), and the part of it orthogonal to all other columns."""
        columns = fitted.problem.linearised(fitted.fit)[0]
        names = [parameter.name for parameter in fitted.model.parameters]
        for name in _own(term):
            at = names.index(name)
            others = np.delete(columns, at, axis=1)
            yield columns[:, at], columns[:, at] - others @ np.linalg.lstsq(others, columns[:, at], rcond=None)[0]

    def _correlation(self, fitted: _Candidate, term: str) -> float:
        """The factor by which the residuals' correlation raises the variance of the term's parameters."""
        found = 1.0
        for _, alone in self._own_columns(fitted, term):
            power = float(alone @ alone)
            spectrum = measure([(alone[:, None], self._signs)])
            found = max(found, float(spectrum.covariance[0, 0]) / power) if power > 0.0 else np.inf
        return found

    def _is_distinct(self, fitted: _Candidate, term: str) -> bool:
        """Whether the term can be distinguished from the others: where the joint moves slowly a skew is a damping."""
        return all(column @ column < _CONFUSED * (alone @ alone) for column, alone in self._own_columns(fitted, term))

    def _ends(self, fitted: _Candidate, term: str) -> bool:
        """Whether a parameter of the term came to an end of its bounds: the data reject it."""
        problem, values = fitted.problem, fitted.fit.nonlinear
        near = _MARGIN * (problem.high - problem.low)
        ends = (values <= problem.low + near) | (values >= problem.high - near)
        return any(end and p.name in _own(term) for end, p in zip(ends, fitted.model.nonlinear, strict=True))

    def pruned(self, larger: _Candidate) -> _Candidate:
        """Return the model without the terms that, now that all are there, do not pay."""
        idle = []
        for term in larger.terms[1:]:
            if term not in (TERMS[other].needs for other in larger.terms):
                smaller = self.candidate(tuple(other for other in larger.terms if other != term), beside=larger)
                if not self.pays(smaller, larger, term):
                    idle.append((self.gain(smaller, larger, term), smaller))
        return self.pruned(min(idle, key=lambda pair: pair[0])[1]) if idle else larger

    def explained(self, chosen: _Candidate) -> Selection:
        """Return the model selected, with the steps to it, the terms rejected and the alternatives."""
        steps, alternatives = self._steps(chosen), self._alternatives(chosen)
        return replace(self.selection(chosen), steps=steps, alternatives=alternatives)

    def selection(self, chosen: _Candidate) -> Selection:
        """Return the model selected, without steps."""
        model, residuals = chosen.model.anchored(self._motion), chosen.problem.residuals(chosen.fit)
        columns, _ = chosen.problem.linearised(chosen.fit)
        delay = model.delay(chosen.fit.nonlinear)
        return Selection(model, (), residuals, columns, chosen.fit.values, delay)

    def _steps(self, chosen: _Candidate) -> tuple[Step, ...]:
        """The steps up to the chosen model, then one with each rejected term on top of it."""
        nested = [self.candidate(chosen.terms[: i + 1], beside=chosen) for i in range(len(chosen.terms))]
        found = [_step(nested[0], float("nan"), included=True)]
        found += [_step(b, self.gain(a, b, b.terms[-1]), included=True) for a, b in pairwise(nested)]
        for term in self._candidates:
            seen = self._preview((*chosen.terms, term)) if is_addable(term, chosen.terms) else None
            if seen is not None and seen.fitness < _RIVAL * chosen.fit.fitness:
                more = self.candidate((*chosen.terms, term), beside=chosen)
                found.append(_step(more, self.gain(chosen, more, term), included=False))
        return tuple(found)

    def _problem(self, terms: tuple[str, ...]) -> Problem:
        model = _model(terms).anchored(self._motion)
        return Problem(model, self._motion, self._torque, *model.bounds(self._motion, self._highest))


def _replaced(terms: tuple[str, ...], one: str) -> tuple[str, ...]:
    """The terms with another one in place of a skew."""
    return tuple(one if term == "skew" else term for term in terms)


def _model(terms: tuple[str, ...]) -> CouplingModel:
    return parse("+".join(terms))


def _named(model: CouplingModel, found: Fit) -> dict[str, float]:
    """The nonlinear parameters of a fit by name."""
    return dict(zip((parameter.name for parameter in model.nonlinear), found.nonlinear.tolist(), strict=True))


def _own(term: str) -> tuple[str, ...]:
    """The names of a term's own parameters."""
    return tuple(parameter.name for parameter in TERMS[term].parameters)


def _stiffness(fitted: _Candidate) -> float:
    return float(fitted.fit.optimum.genes[0])


def _is_impossible(fitted: _Candidate, term: str) -> bool:
    """Whether a parameter of the term is negative that nature has no negative one of, as a friction.

    A skew may be negative, but not to undo a part of the lag beside it.
    """
    values = _values(fitted)
    negative = any(parameter.positive and values[parameter.name] < 0.0 for parameter in TERMS[term].parameters)
    return negative or (term in _LATE and "lag" in values and values.get("skew", 0.0) < 0.0)


def _values(fitted: _Candidate) -> dict[str, float]:
    """All parameters, SI, by name."""
    return dict(zip((one.name for one in fitted.model.parameters), fitted.fit.values.tolist(), strict=True))


def _damping(fitted: _Candidate) -> float:
    return float(fitted.fit.optimum.genes[1])


def _step(fitted: _Candidate, gain: float, *, included: bool) -> Step:
    kc, bc = fitted.fit.optimum.genes[:2]
    return Step(
        fitted.model.name,
        fitted.terms[-1],
        fitted.fit.fitness,
        float(fitted.held_out.mean()),
        gain,
        float(kc),
        float(bc),
        included,
    )
