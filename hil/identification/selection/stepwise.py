"""Model selection by forward steps: a term is included as long as it improves the score.

Each step adds, of the terms that improve the score (`hil.identification.selection.criterion`), the one that predicts
held-out blocks best. Terms that no longer improve it are removed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ga.model.coupling import CouplingModel
from ga.model.separable import Fit
from ga.model.terms import CONSIDERED, TERMS, is_addable, lacking, with_another
from ga.model.trajectory import Motion
from hil.identification.selection.criterion import PLAINEST_FIRST, Criterion, criterion_of
from hil.identification.selection.fits import Candidate, Fits, own
from hil.identification.selection.late import Alternative, Lateness, LateReading
from hil.signals.rate.windows import Window
from hil.uncertainty.model_average import AKAIKE

Array = NDArray[np.float64]

_RIVAL = 1.1  # a term that makes the fitness worse than by this factor is none
_LIKELY = 3  # rarer terms that are considered, of those that lower the fitness most
_STIFFER = 2.0  # times Kc, with which errors of the deflection show in the torque beside a branch or friction


@dataclass(frozen=True, slots=True)
class Step:
    """One model of the selection, and the gain of its last term.

    fitness: N m, of all samples. held_out: N m, of blocks that the fit did not see. gain: by how much the criterion
    falls for `term`, in units in which chance gives less than zero; NaN for the first. Kc, Bc: SI. included: whether
    the term is in the selected model. cost: twice the log odds against the term before the data are seen.
    """

    model: str
    term: str
    fitness: float
    held_out: float
    gain: float
    Kc: float
    Bc: float
    included: bool
    cost: float


@dataclass(frozen=True, eq=False)
class Selection:
    """The selected model and, computed on demand, the steps that led to it."""

    chosen: Candidate
    searched: _Steps | None = None
    late: LateReading | None = None

    @cached_property
    def model(self) -> CouplingModel:
        """Return the selected model, anchored to the recording."""
        return self.chosen.anchored

    @cached_property
    def residuals(self) -> Array:
        """Return the residuals (n,) of its fit, N m."""
        return self.chosen.problem.residuals(self.chosen.fit)

    @cached_property
    def columns(self) -> Array:
        """Return the columns (n, p + q) of the problem linearised at the fit."""
        return self.chosen.columns

    @property
    def values(self) -> Array:
        """Return all parameters (p + q,), SI."""
        return self.chosen.fit.values

    @property
    def delay(self) -> float:
        """Return by how much the torque reading is older than that of the angle, s; 0 without a term for it."""
        return self.model.delay(self.chosen.fit.nonlinear)

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """Return the steps up to the model, then one for each rejected term on top of it."""
        return self.searched.to(self.chosen) if self.searched else ()

    @cached_property
    def alternatives(self) -> tuple[Alternative, ...]:
        """Return the models with another cause of the delayed torque reading."""
        return self.late.alternatives(self.chosen) if self.late else ()

    @cached_property
    def lateness(self) -> tuple[Lateness, ...]:
        """Return Kc and Bc for each likely delay of the torque reading, if the model has none."""
        return self.late.lateness(self.chosen) if self.late else ()


def select(
    motion: Motion,
    torque: Array,
    highest: float,
    terms: tuple[str, ...] = CONSIDERED,
    *,
    rarer: tuple[str, ...] = (),
    accounts: tuple[str, ...] = (),
    describes: Callable[[Selection, bool], bool] = lambda _selection, _averaged: True,
    sticks: Callable[[Selection], bool] = lambda _selection: False,
    window: Window | None = None,
) -> Selection:
    """Return the model for motion (n,) and torque (n,), N m. highest: the frequency up to which the joint moved, Hz.

    describes: a function that says whether a model describes the recording; its second argument allows it to lack the
    small effects of every bench. If no model of common terms does, rare terms are considered too. sticks: whether
    friction holds the joint in some samples; then no rare terms are considered, because a model will be selected from
    the other samples. accounts: the terms by which the torque may be delayed or seem to be. window: that the rate was
    computed in, if known. Raises RuntimeError if not even the smallest model can be fitted.
    """
    fits, smallest = Fits(motion, torque, highest, window), _smallest(terms)
    noise = criterion_of(fits, terms, smallest)
    steps = _Steps(fits, noise, terms, is_enough=lambda one: describes(one, False))
    usual = steps.forward(fits.candidate(smallest))
    late = LateReading(fits, steps.criterion, accounts)
    if not rarer or sticks(Selection(usual)):
        return Selection(usual, steps, late)
    if describes(Selection(usual), True):
        return Selection(late.instead_of_skew(usual), steps, late)
    likely = _likeliest(fits, rarer, tuple(dict.fromkeys(steps.passed)))
    steps = steps.with_rarer(likely, rarer)
    richer = steps.plainest(steps.forward(fits.candidate(smallest)))
    if set(rarer).intersection(richer.terms) and not describes(Selection(richer), True):
        # another effect may show only beside the one found
        more = steps.with_rarer((*likely, *_likeliest(fits, rarer, (richer.terms,))), rarer)
        found = more.plainest(more.forward(fits.candidate(smallest)))
        steps, richer = (more, found) if describes(Selection(found), True) else (steps, richer)
    chosen = richer if set(rarer).intersection(richer.terms) else usual
    late = LateReading(fits, steps.criterion, accounts)
    return Selection(late.instead_of_branch(chosen), steps, late)


@dataclass(frozen=True, eq=False)
class _Steps:
    """The steps among the terms considered; compared: the number of terms from which the best is chosen.

    rare: those of them that are considered because no model without them describes the recording. is_enough: whether a
    model with one of them does. Further terms would then be fitted to errors of the deflection, rad, and rate, rad/s,
    which a filter or a delay removes, and the lack-of-fit tests leave out samples that could show others. beside: terms
    that no step includes, and that the chosen model is compared with. passed: the models that the steps passed.
    """

    fits: Fits
    criterion: Criterion
    considered: tuple[str, ...]
    compared: int = 1
    rare: tuple[str, ...] = ()
    is_enough: Callable[[Selection], bool] = lambda _selection: False
    beside: tuple[str, ...] = ()
    passed: list[tuple[str, ...]] = field(default_factory=list, init=False)
    _enough: dict[Candidate, bool] = field(default_factory=dict, init=False)

    def with_rarer(self, likely: tuple[str, ...], rarer: tuple[str, ...]) -> _Steps:
        """Return the steps among the common terms and the likely ones of the rare terms.

        The included terms may have hidden a small common one, and a linear term costs no time to fit.
        """
        likely = tuple(dict.fromkeys(likely))
        considered = (*(term for term in self.considered if term not in self.rare), *likely)
        noise = criterion_of(self.fits, considered, self.criterion.richest, doubted=True)
        small = tuple(term for term in rarer if term not in likely and TERMS[term].linear)
        return _Steps(self.fits, noise, considered, _LIKELY, likely, self.is_enough, small)

    def forward(self, chosen: Candidate) -> Candidate:
        """Return the model after the steps from a chosen one, each adding the best term, without terms that no longer
        help.
        """
        seen: set[frozenset[str]] = set()
        self.passed.append(chosen.terms)
        while (larger := self._larger(chosen)) is not None:
            seen.add(frozenset(chosen.terms))
            larger = self._pruned(larger)
            if frozenset(larger.terms) in seen:
                break  # the new term replaced one that it needs: this would repeat for ever
            chosen = larger
            self.passed.append(chosen.terms)
        chosen = self._predicting(self._pruned(chosen))
        self.passed.append(chosen.terms)
        return chosen

    def plainest(self, chosen: Candidate) -> Candidate:
        """Return the model with a plainer law of the same effect in place of a rare one, if the data cannot rank the
        two.

        The steps include the law that a smaller model needs; beside the terms added later, another may fit equally
        well.
        """
        for term in (term for term in chosen.terms if term in self.rare):
            chosen = next(self._plainer(chosen, term), chosen)
        return chosen

    def _plainer(self, chosen: Candidate, term: str) -> Iterator[Candidate]:
        """Yield the models with a plainer law than the term that are as likely as the chosen one, the plainest first.

        Each is compared with the chosen one: of three laws, the data may rank only the first and the last.
        """
        others = tuple(other for other in chosen.terms if other != term)
        for law in PLAINEST_FIRST[: PLAINEST_FIRST.index(term)]:
            terms = tuple(law if other == term else other for other in chosen.terms)
            complete = is_addable(law, others) and not any(lacking(other, terms) for other in others)
            if self._is_plainer(term, law) and complete and self.fits.fitness(terms) < np.inf:
                plainer = self.fits.candidate(terms, beside=chosen)
                if plainer.is_possible(*terms[1:]) and self.criterion.is_as_likely(plainer, chosen):
                    yield plainer

    def _is_plainer(self, term: str, law: str) -> bool:
        """Return whether a term considered is a plainer law of the same effect: contained, common, or earlier in the
        table.

        Two such terms exclude each other. A law with fewer parameters that is not contained describes another effect.
        """
        beside = law in self.considered and (law in TERMS[term].excludes or term in TERMS[law].excludes)
        fewer = len(own(term)) - len(own(law))
        return beside and (law not in self.rare or fewer == 0 or set(own(law)) < set(own(term)))

    def to(self, chosen: Candidate) -> tuple[Step, ...]:
        """Return the steps up to the chosen model, then one for each rejected term.

        A rejected term stands on top of the model, or as a richer law in the place of one that it contains.
        """
        nested = [self.fits.candidate(chosen.terms[: i + 1], beside=chosen) for i in range(len(chosen.terms))]
        found = [_step(nested[0], (float("nan"), float("nan")), included=True)]
        found += [_step(b, self.criterion.weighed(a, b, b.terms[-1]), included=True) for a, b in pairwise(nested)]
        for term in (*self.considered, *self.beside):
            others = tuple(other for other in chosen.terms if not set(own(other)) < set(own(term)))
            seen = self.fits.preview((*others, term)) if is_addable(term, others) else None
            if seen is None or not seen.fitness < _RIVAL * chosen.fit.fitness:
                continue
            if term in self.considered or self._may_pay(chosen, seen):
                more = self.fits.candidate((*others, term), beside=chosen)
                found.append(_step(more, self.criterion.weighed(chosen, more, term), included=False))
        return tuple(found)

    def _may_pay(self, chosen: Candidate, seen: Fit) -> bool:
        """Return whether a preview fits better than the chosen model by as much as Akaike's criterion needs."""
        return self.criterion.gained(self.fits.fitness(chosen.terms) - seen.fitness) > AKAIKE

    def _larger(self, smaller: Candidate) -> Candidate | None:
        """Return the model with one more term that improves the score and predicts held-out blocks best; None if
        none.
        """
        beyond = self._beyond(smaller.terms)
        if set(self.rare).intersection(smaller.terms) and self._is_described(smaller):
            beyond = {terms: found for terms, found in beyond.items() if self._is_no_error(smaller, terms)}
        errors = {terms: self.fits.held_out(terms, found).mean() for terms, found in beyond.items()}
        paying: list[Candidate] = []
        for terms in sorted(errors, key=lambda terms: errors[terms]):
            larger = self.fits.candidate(terms, beside=smaller)
            if self.criterion.pays(smaller, larger, terms[-1]):
                paying.append(larger)
            if len(paying) == self.compared:
                break
        # held-out blocks cannot distinguish terms that are much alike: all samples may, or the plainest is taken
        return self.criterion.likeliest(smaller, paying) if paying else None

    def _beyond(self, terms: tuple[str, ...]) -> dict[tuple[str, ...], Fit]:
        """Return the models with another term, last, that fit the preview better, each with that fit.

        A rare term may replace the terms that it excludes. Where rare terms are considered, a term brings the terms
        that it needs: a gap without an offset shows little of either.
        """
        less, found = self.fits.preview(terms), {}
        for term in self.considered:
            larger = with_another(terms, term, complete=bool(self.rare))
            more = self.fits.preview(larger) if term not in terms and is_addable(term, larger[:-1]) else None
            if less is not None and more is not None and more.fitness < less.fitness:
                found[larger] = more
        return found

    def _is_described(self, one: Candidate) -> bool:
        """Return whether a model describes the recording; the tests take as long as some steps and are asked for
        twice.
        """
        if one not in self._enough:
            self._enough[one] = self.is_enough(Selection(one))
        return self._enough[one]

    def _is_no_error(self, smaller: Candidate, terms: tuple[str, ...]) -> bool:
        """Return whether the last of these terms, a common one, explains more than all errors of deflection and
        rate.
        """
        if terms[-1] in self.rare or not set(smaller.terms) < set(terms):
            return False
        larger = self.fits.candidate(terms, beside=smaller)
        of_deflection, of_rate, _ = self.fits.errors
        errors = (_STIFFER * smaller.stiffness * of_deflection) ** 2 + (smaller.damping * of_rate) ** 2
        return 0.5 * math.pi * (smaller.fit.fitness**2 - larger.fit.fitness**2) > errors

    def _predicting(self, smaller: Candidate) -> Candidate:
        """Return the model, or if rare terms are considered, with one more that predicts held-out blocks clearly
        better.

        With few independent samples the likelihood may not rank the two.
        """
        beyond = self._beyond(smaller.terms) if self.rare and not self._is_described(smaller) else {}
        larger = (self.fits.candidate(terms, beside=smaller) for terms in beyond if set(smaller.terms) < set(terms))
        clear = [one for one in larger if self.criterion.pays(smaller, one, one.terms[-1], nearly=True)]
        return min(clear, key=lambda one: float(one.held_out.mean()), default=smaller)

    def _pruned(self, larger: Candidate) -> Candidate:
        """Return the model without the terms that no longer improve the score beside all others."""
        idle = []
        for term in larger.terms[1:]:
            fewer = tuple(sorted((o for o in larger.terms if o != term), key=lambda o: TERMS[o].smooths))
            if not any(lacking(other, fewer) for other in fewer):
                smaller = self.fits.candidate(fewer, beside=larger)
                if not self.criterion.pays(smaller, larger, term):
                    idle.append((self.criterion.gain(smaller, larger, term), smaller))
        return self._pruned(min(idle, key=lambda pair: pair[0])[1]) if idle else larger


def _smallest(terms: tuple[str, ...]) -> tuple[str, ...]:
    """Return the terms of the smallest model, as far as they are considered."""
    smallest = [name for name, term in TERMS.items() if term.selection == "smallest"]
    return tuple(name for name in smallest if name == "linear" or name in terms)


def _likeliest(fits: Fits, terms: tuple[str, ...], models: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """Return the terms that lower the fitness most, in any of the models, within their bounds, with other laws of the
    same effect.

    A law with the parameters of another fits hardly worse, and one with more never does; it must not take the place of
    another kind of term. Neither must a law that only smooths friction.
    """
    lowest = {}
    containing = {term: [other for other in terms if _contains(term, other)] for term in terms}
    for term in (term for term in terms if not containing[term]):
        larger = [with_another(less, term, complete=True) for less in models]
        larger = [more for more in larger if term not in more[:-1] and is_addable(term, more[:-1])]
        lowest[term] = min((fits.fitness(more) for more in larger if not fits.is_rejected(more)), default=np.inf)
    ranked = sorted((term for term in lowest if lowest[term] < np.inf), key=lambda term: lowest[term])
    kinds = [term for term in ranked if not TERMS[term].smooths][:_LIKELY]
    likely = ranked[: ranked.index(kinds[-1]) + 1] if kinds else ranked
    return (*likely, *(term for term in terms if containing[term] and _is_richer_law(term, containing[term], likely)))


def _contains(term: str, other: str) -> bool:
    """Return whether a term has all parameters of another; of two with equal parameters, the later one in the table."""
    mine, others = set(own(term)), set(own(other))
    return others < mine or (others == mine and PLAINEST_FIRST.index(other) < PLAINEST_FIRST.index(term))


def _is_richer_law(term: str, contained: list[str], likely: list[str]) -> bool:
    """Return whether a term contains a likely one, or is a law of the same effect, which excludes it."""
    return bool(set(likely).intersection((*contained, *TERMS[term].excludes)))


def _step(fitted: Candidate, weighed: tuple[float, float], *, included: bool) -> Step:
    gain, cost = weighed
    return Step(
        fitted.model.name,
        fitted.terms[-1],
        fitted.fit.fitness,
        float(fitted.held_out.mean()),
        gain,
        fitted.stiffness,
        fitted.damping,
        included,
        cost,
    )
