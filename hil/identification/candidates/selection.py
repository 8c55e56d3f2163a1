"""Select a model: the search proposes it, then the criterion of the exact fit removes or adds terms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

from ga.arrays import Mask
from ga.model.coupling import CouplingModel
from ga.model.terms import SMALLEST, TERMS, is_addable, lacking
from hil.identification.candidates.band_fit import BandFit
from hil.identification.candidates.criterion import Criterion, criterion_of
from hil.identification.candidates.fits import Candidate, Fits, own, with_flanks
from hil.identification.candidates.proposal import proposed
from hil.identification.result import Step
from hil.signals import constants as c
from hil.signals.prepare import Signals


@dataclass(frozen=True, eq=False)
class Selection:
    """The selected model and, computed on demand, the gain of each of its terms and of each rejected term."""

    chosen: Candidate
    beside: Beside

    @cached_property
    def model(self) -> CouplingModel:
        """Return the selected model, anchored to the recording; the flanks of its gap part as in the fit."""
        return with_flanks(self.chosen.model.anchored(self.chosen.problem.motion), self.chosen.fit)

    @property
    def delay(self) -> float:
        """Return the age of the torque reading less that of the angle reading, s; 0 if the model has no term for a
        delay.
        """
        return self.model.delay(self.chosen.fit.nonlinear)

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """Return a step for each term of the model, then a step for each rejected term, added to the model."""
        return self.beside.steps(self.chosen)


def select(signals: Signals, seen: Mask, terms: tuple[str, ...]) -> Selection:
    """Return the model selected from the samples in `seen` (n,).

    terms: those considered besides the smallest model's. Raises RuntimeError if not even the smallest model can be
    fitted.
    """
    motion = signals.motion if seen.all() else signals.motion.of(seen)
    fits = Fits(motion, signals.torque[seen], signals.band[1], signals.window)
    models, values = proposed(signals, seen, terms)
    chosen = _first_possible(fits, models)
    for _ in range(c.EXCHANGES):
        beside = Beside(fits, criterion_of(fits, chosen, len(terms)), terms, values)
        better = beside.better(chosen)
        if better is chosen:
            break
        chosen = better
    chosen = fits.deeper(chosen)
    return Selection(chosen, beside)


def _first_possible(fits: Fits, models: Sequence[BandFit]) -> Candidate:
    """Return the exact fit of the first model with physically possible parameters; else that of the smallest model."""
    for model in models:
        terms = tuple(term for term in TERMS if term in {*SMALLEST.split("+"), *model.terms})
        found = fits.candidate_or_none(terms, model.values)
        if found and found.is_possible(*model.terms):
            return found
    return fits.candidate(tuple(SMALLEST.split("+")), {})


@dataclass(frozen=True, eq=False)
class Beside:
    """The models that have one term more, or one term less, than a chosen model.

    considered: the terms that may be added. values: for each term that the search found, nonlinear parameters, SI, by
    name.
    """

    fits: Fits
    criterion: Criterion
    considered: tuple[str, ...]
    values: Mapping[str, Mapping[str, float]]

    def better(self, chosen: Candidate) -> Candidate:
        """Return the model without its term of least gain, if that gain is too small.

        Otherwise return the model with the new term of largest gain, if that gain is large enough; otherwise the chosen
        model.
        """
        idle = [one for one in self._smaller(chosen) if not self.criterion.pays(one[1], chosen, one[0], _least(one[0]))]
        if idle:
            return min(idle, key=lambda one: self.criterion.gain(one[1], chosen, one[0]))[1]
        paying = [one for one in self._larger(chosen) if self.criterion.pays(chosen, one, one.terms[-1])]
        return max(paying, key=lambda one: self.criterion.gain(chosen, one, one.terms[-1]), default=chosen)

    def steps(self, chosen: Candidate) -> tuple[Step, ...]:
        """Return one step for each term of the chosen model, then one for each rejected term.

        A rejected term is added to the model, or replaces a plainer law that it contains.
        """
        nested = [self.fits.candidate(chosen.terms[: i + 1], chosen.values) for i in range(len(chosen.terms))]
        nested[-1] = chosen
        found = [_step(nested[0], (float("nan"), float("nan")), included=True)]
        found += [_step(b, self.criterion.weighed(a, b, b.terms[-1]), included=True) for a, b in pairwise(nested)]
        for more in self._larger(chosen):
            found.append(_step(more, self.criterion.weighed(chosen, more, more.terms[-1]), included=False))
        return tuple(found)

    def _smaller(self, chosen: Candidate) -> Iterator[tuple[str, Candidate]]:
        for term in chosen.terms:
            fewer = tuple(one for one in chosen.terms if one != term)
            if TERMS[term].role != "coupling" and not any(lacking(one, fewer) for one in fewer):
                yield term, self.fits.candidate(fewer, chosen.values)

    def _larger(self, chosen: Candidate) -> Iterator[Candidate]:
        for term in (*SMALLEST.split("+"), *self.considered):
            others = tuple(one for one in chosen.terms if not set(own(one)) < set(own(term)))
            if is_addable(term, others) and (term in self.values or TERMS[term].linear):
                near = {**self.values.get(term, {}), **chosen.values}
                more = self.fits.candidate_or_none((*others, term), near)
                if more and more.fit.fitness < c.RIVAL * chosen.fit.fitness:
                    yield more


def _least(term: str) -> float:
    """Return the gain that a term must have to stay: a skew, which every recorder has, goes on strong evidence only."""
    record = TERMS[term]
    return -c.VERY_STRONG if record.bench == "always" and record.selection != "smallest" else 0.0


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
