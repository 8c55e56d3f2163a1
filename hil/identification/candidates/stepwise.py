"""Select a model by forward steps: a term is included as long as it improves the score.

Each step compares the terms that improve the score (`hil.identification.candidates.criterion`) and adds the one that
predicts held-out blocks best. Terms that no longer improve the score are removed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ga.model.coupling import CouplingModel
from ga.model.separable import Fit
from ga.model.terms import CONSIDERED, TERMS, is_addable, lacking, with_another
from ga.model.trajectory import Motion
from hil.identification.candidates.criterion import PLAINEST_FIRST, Criterion, criterion_of
from hil.identification.candidates.fits import Candidate, Fits, own
from hil.identification.candidates.late import Alternative, Lateness, LateReading
from hil.identification.result import Step
from hil.signals.rate.windows import Window
from hil.uncertainty.model_average import AKAIKE

Array = NDArray[np.float64]

_RIVAL = 1.1  # a term that makes the fitness worse than by this factor is none
_LIKELY = 3  # rarer terms that are considered, of those that lower the fitness most
_STIFFER = 2.0  # times Kc, with which errors of the deflection show in the torque beside a branch or friction


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
        """Return the residuals (n,) of the selected model's fit, N m."""
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
        """Return the age of the torque reading less that of the angle reading, s; 0 if the model has no term for a
        delay.
        """
        return self.model.delay(self.chosen.fit.nonlinear)

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """Return the steps that led to the model, then a step for each rejected term, added to the model."""
        return self.searched.to(self.chosen) if self.searched else ()

    @cached_property
    def alternatives(self) -> tuple[Alternative, ...]:
        """Return the models with another cause of the delayed torque reading."""
        return self.late.alternatives(self.chosen) if self.late else ()

    @cached_property
    def lateness(self) -> tuple[Lateness, ...]:
        """Return Kc and Bc for each likely delay of the torque reading; see `LateReading.lateness`."""
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
    """Return the model for motion (n,) and torque (n,), N m.

    highest: the frequency up to which the joint moved, Hz. terms: the common terms. rarer: rare terms, which are
    considered only if no model of common terms describes the recording. accounts: the terms that may make the torque
    reading late or early. describes: a function that returns whether a model describes the recording; its second
    argument allows the model to lack the small effects of every bench. sticks: whether friction holds the joint in some
    samples; then no rare terms are considered, because a model will be selected from the other samples. window: the
    window from which the rate was computed, if known. Raises RuntimeError if not even the smallest model can be fitted.
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
    likely = _likeliest(fits, rarer, (smallest, usual.terms))
    steps = steps.with_rarer(likely, rarer)
    richer = steps.forward(fits.candidate(smallest))
    if set(rarer).intersection(richer.terms) and not describes(Selection(richer), True):
        # another effect may show only beside the one found
        more = steps.with_rarer((*likely, *_likeliest(fits, rarer, (richer.terms,))), rarer)
        found = more.forward(fits.candidate(smallest))
        steps, richer = (more, found) if describes(Selection(found), True) else (steps, richer)
    chosen = richer if set(rarer).intersection(richer.terms) else usual
    late = LateReading(fits, steps.criterion, accounts)
    return Selection(late.instead_of_branch(chosen), steps, late)


@dataclass(frozen=True, eq=False)
class _Steps:
    """The search for a model by steps among the terms considered.

    compared: the number of terms from which each step chooses the best one. rare: rare terms, considered because no
    model without them describes the recording. is_enough: a function that returns whether a model with a rare term
    describes the recording. If it does, a further term must be common and explain more torque than all errors of
    deflection and rate, to which the term would otherwise be fitted. beside: terms that no step includes, but with
    which the chosen model is compared.
    """

    fits: Fits
    criterion: Criterion
    considered: tuple[str, ...]
    compared: int = 1
    rare: tuple[str, ...] = ()
    is_enough: Callable[[Selection], bool] = lambda _selection: False
    beside: tuple[str, ...] = ()
    _enough: dict[Candidate, bool] = field(default_factory=dict, init=False)

    def with_rarer(self, likely: tuple[str, ...], rarer: tuple[str, ...]) -> _Steps:
        """Return the steps among the common terms and those of the rare terms that are likely.

        likely: these rare terms. rarer: all rare terms; the linear ones among them are compared with the chosen model,
        because a linear term costs no time to fit.
        """
        likely = tuple(dict.fromkeys(likely))
        considered = (*(term for term in self.considered if term not in self.rare), *likely)
        # the common terms of the richest model were found before
        noise = criterion_of(self.fits, likely, self.criterion.richest, doubted=True)
        noise = replace(noise, choices=len(considered))
        small = tuple(term for term in rarer if term not in likely and TERMS[term].linear)
        return _Steps(self.fits, noise, considered, _LIKELY, likely, self.is_enough, small)

    def forward(self, chosen: Candidate) -> Candidate:
        """Return the model reached from a chosen one when each step adds the best term and removes terms that no longer
        help.
        """
        seen: set[frozenset[str]] = set()
        while (larger := self._larger(chosen)) is not None:
            seen.add(frozenset(chosen.terms))
            larger = self._pruned(larger)
            if frozenset(larger.terms) in seen:
                break  # the new term replaced one that it needs: this would repeat for ever
            chosen = larger
        return self._predicting(self._pruned(chosen))

    def to(self, chosen: Candidate) -> tuple[Step, ...]:
        """Return the steps that led to the chosen model, then one step for each rejected term.

        A rejected term is added to the model, or replaces a plainer law that it contains.
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
        """Return whether the preview `seen` fits better than the chosen model by as much as Akaike's criterion
        requires.
        """
        return self._gains(self.fits.fitness(chosen.terms), seen)

    def _gains(self, fitness: float, seen: Fit) -> bool:
        return self.criterion.gained(fitness - seen.fitness) > AKAIKE

    def _larger(self, smaller: Candidate) -> Candidate | None:
        """Return the model with one more term; None if no term improves the score.

        Of the terms that improve the score, it has the one that predicts held-out blocks best.
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
        """Return the models with one more term, in the last place, that may improve the score, each with its preview.

        One that gains less in its preview than Akaike's criterion asks would be fitted to all samples in vain.
        A rare term may replace the terms that it excludes. If rare terms are considered, a term is added together with
        the terms that it needs: a gap without an offset shows little of either.
        """
        less, found = self.fits.preview(terms), {}
        for term in self.considered:
            larger = with_another(terms, term, complete=bool(self.rare))
            more = self.fits.preview(larger) if term not in terms and is_addable(term, larger[:-1]) else None
            if less is not None and more is not None and self._gains(less.fitness, more):
                found[larger] = more
        return found

    def _is_described(self, one: Candidate) -> bool:
        """Return whether a model describes the recording. The answer is stored, because the tests take long and are
        needed twice.
        """
        if one not in self._enough:
            self._enough[one] = self.is_enough(Selection(one))
        return self._enough[one]

    def _is_no_error(self, smaller: Candidate, terms: tuple[str, ...]) -> bool:
        """Return whether the last of these terms, a common one, explains more torque than all errors of deflection and
        rate.
        """
        if terms[-1] in self.rare or not set(smaller.terms) < set(terms):
            return False
        larger = self.fits.candidate(terms, beside=smaller)
        of_deflection, of_rate, _ = self.fits.errors
        errors = (_STIFFER * smaller.stiffness * of_deflection) ** 2 + (smaller.damping * of_rate) ** 2
        return 0.5 * math.pi * (smaller.fit.fitness**2 - larger.fit.fitness**2) > errors

    def _predicting(self, smaller: Candidate) -> Candidate:
        """Return the smaller model or, if rare terms are considered, a model with one more term that predicts held-out
        blocks clearly better.

        With few independent samples the likelihood may not be able to rank the two models.
        """
        beyond = self._beyond(smaller.terms) if self.rare and not self._is_described(smaller) else {}
        larger = (self.fits.candidate(terms, beside=smaller) for terms in beyond if set(smaller.terms) < set(terms))
        clear = [one for one in larger if self.criterion.pays(smaller, one, one.terms[-1], nearly=True)]
        return min(clear, key=lambda one: float(one.held_out.mean()), default=smaller)

    def _pruned(self, larger: Candidate) -> Candidate:
        """Return the model without the terms that no longer improve the score when all others are present."""
        idle = []
        for term in larger.terms[1:]:
            fewer = tuple(sorted((o for o in larger.terms if o != term), key=lambda o: TERMS[o].smooths))
            if not any(lacking(other, fewer) for other in fewer):
                smaller = self.fits.candidate(fewer, beside=larger)
                if not self.criterion.pays(smaller, larger, term):
                    idle.append((self.criterion.gain(smaller, larger, term), smaller))
        return self._pruned(min(idle, key=lambda pair: pair[0])[1]) if idle else larger


def _smallest(terms: tuple[str, ...]) -> tuple[str, ...]:
    """Return the terms of the smallest model that are among the given terms."""
    smallest = [name for name, term in TERMS.items() if term.selection == "smallest"]
    return tuple(name for name in smallest if TERMS[name].role == "coupling" or name in terms)


def _likeliest(fits: Fits, terms: tuple[str, ...], models: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """Return the few terms that lower the fitness most in any of the models, within their bounds, and other laws of the
    same effects.

    A law of the same effect fits nearly as well, and must not take the place of another kind of term. Nor must a law
    that only smooths friction.
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
    """Return whether a term has all parameters of another; of two terms with equal parameters, the later one in the
    table does.
    """
    mine, others = set(own(term)), set(own(other))
    return others < mine or (others == mine and PLAINEST_FIRST.index(other) < PLAINEST_FIRST.index(term))


def _is_richer_law(term: str, contained: list[str], likely: list[str]) -> bool:
    """Return whether a term contains a likely term, or is a law of the same effect and therefore excludes it."""
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
