"""Whether a term pays: its gain beyond chance, by the noise of the recording.

The gain of a term is the likelihood ratio of a median regression (Koenker and Machado 1999, 4 f(0) times the fall of
the sum of absolute residuals), divided by the factor by which the residuals' correlation raises the variance of its
parameters (`hil.uncertainty.residual_spectrum`), less log n for each (Schwarz 1978) and the cost of choosing from so
many terms (Chen and Chen 2008). Held-out blocks must not be predicted clearly worse. A term with a break, whose
likelihood ratio has no known law, must predict them better and gain much. The density f(0) and the correlation are
those of the richest model's residuals, because a missing term must not be taken for noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ga.model.terms import RARER, TERMS, is_addable, with_another
from hil.identification.selection.fits import FOLDS, Candidate, Fits
from hil.signals.defects import FEWEST
from hil.signals.deflection_noise import smallest_step
from hil.uncertainty.model_average import AKAIKE
from hil.uncertainty.residual_spectrum import measure

Array = NDArray[np.float64]

STRONG = 10.0
"""The gain of a term with a break, whose chance is not known to be that of others; of one that is rejected with more
than that, the gain is not the reason.
"""

PLAINEST_FIRST = (*(term for term in TERMS if term not in RARER), *RARER)
"""All terms, a usual one before a rarer one, and then as in the table."""

_WORSE, _BETTER = 2.0, 1.0  # standard errors over the blocks: clearly worse, and better
_CONFUSED = 1000.0  # variance inflation from which a term's parameter cannot be distinguished from others
_EXPLAINED = 3e-4  # of the mean torque, to which the rate is accurate: what explains it so far needs no further term


@dataclass(frozen=True, eq=False)
class Criterion:
    """The noise of a recording, and by it whether a term pays.

    richest: terms of the model whose residuals are taken for the noise; signs: (n,), of these; fitted: lines of their
    spectrum that the fit has removed from each band; density: 1/(N m), of these at zero. size: N m, the mean torque.
    smooth: (n,), where the rate is right. choices: from how many terms one is chosen. doubted: whether the usual terms
    do not describe the recording.
    """

    richest: tuple[str, ...]
    signs: Array
    fitted: Array
    density: float
    size: float
    smooth: NDArray[np.bool_]
    choices: int
    doubted: bool = False
    _correlations: dict[tuple[Candidate, str], float] = field(default_factory=dict, init=False)

    def pays(self, smaller: Candidate, larger: Candidate, term: str, *, nearly: bool = False) -> bool:
        """Return whether the term pays that the larger model has and the smaller has not.

        nearly: Akaike's criterion is enough where held-out blocks are predicted clearly better. These follow it (Stone
        1977): where they do not, their difference is small, or chance.
        """
        if smaller.fit.fitness < _EXPLAINED * self.size:
            return False
        if larger.is_at_end(term) or larger.is_impossible(term) or not _is_distinct(larger, term):
            return False
        if larger.stiffness <= 0.0 < smaller.stiffness:  # no coupling pushes: the term stands in for it
            return False
        breaks = TERMS[term].breaks or any(other in larger.terms for other in TERMS[term].confusable) or term in RARER
        least, enough = (_BETTER, STRONG) if breaks else (-_WORSE, 0.0)
        if _predicts_better(larger, smaller) < (_WORSE if nearly else least):
            return False
        gain, cost = self.weighed(smaller, larger, term)
        if nearly:
            return gain + cost > AKAIKE * _more_parameters(smaller, larger)
        return gain > enough and self._pays_where_smooth(smaller, larger, term)

    def gain(self, smaller: Candidate, larger: Candidate, term: str) -> float:
        """Return the gain beyond chance of the term that the larger model has and the smaller has not."""
        return self.weighed(smaller, larger, term)[0]

    def weighed(self, smaller: Candidate, larger: Candidate, term: str) -> tuple[float, float]:
        """Return the gain of a term, and its cost: what of the likelihood ratio is no gain, twice the log odds."""
        alike, count = self.correlation(larger, term), len(self.signs)
        more = _more_parameters(smaller, larger)
        return self._gain(self.ratio(smaller, larger), count, alike, more), self._cost(count, alike, more)

    def ratio(self, one: Candidate, other: Candidate) -> float:
        """Return twice by how much the other model's logarithmic likelihood is higher, for independent residuals."""
        return self.gained(one.fit.fitness - other.fit.fitness)

    def gained(self, better: float) -> float:
        """Return the same for a fitness that is better by so much, N m."""
        return 4.0 * self.density * len(self.signs) * better

    def correlation(self, fitted: Candidate, term: str) -> float:
        """Return the factor by which the residuals' correlation raises the variance of the term's parameters.

        What no term describes comes a few times in a recording, however many samples see it. Where such a thing may be
        there, the factor is the largest of all parameters: the residuals may be quiet at what one term alone moves.
        """
        if (fitted, term) in self._correlations:
            return self._correlations[fitted, term]
        found = max((1.0, *(self._correlation(alone) for _, alone in fitted.own_columns(term))))
        if self.doubted:
            # a term that the new one makes idle may have a column of zeros, which says nothing about the new one
            others = fitted.own_columns(*(other for other in fitted.terms if other != term))
            found = max((found, *(self._correlation(alone) for _, alone in others if alone.any())))
        self._correlations[fitted, term] = found
        return found

    def _correlation(self, alone: Array) -> float:
        """The same of one parameter: its column (n,), as far as no other has it; infinite where nothing is left."""
        power = float(alone @ alone)
        if power <= 0.0:
            return math.inf
        spectrum = replace(measure([(alone[:, None], self.signs)]), fitted=self.fitted)
        # in slow ramps the slowest lines hold most of what a gap does: by their power a real one would not be found
        return float(spectrum.by_bands[0, 0]) / power

    def blurred(self, fitted: Candidate, term: str) -> float:
        """Return the factor by which a likelihood ratio is less certain: of correlation, and of the rate.

        What the rate is wrong by lasts as long as the recording, however many samples see it: two models that differ by
        less cannot be ranked.
        """
        return self.correlation(fitted, term) + by_rate(len(self.signs), self.density, self.size)

    def likeliest(self, smaller: Candidate, paying: list[Candidate]) -> Candidate:
        """Return the plainest of some larger models, the last term of each paying, that the data cannot rank.

        By Schwarz's criterion for as many samples as count, within what is strong for terms whose law is not known. A
        usual term is plainer than a rarer one, and an earlier one in the table plainer than a later one; of usual ones
        held-out blocks may rank two that the likelihood cannot.
        """
        alike = max(self.correlation(one, one.terms[-1]) for one in paying)
        count = max(len(self.signs) / alike, math.e)
        found = [len(one.model.parameters) * math.log(count) - self.ratio(smaller, one) / alike for one in paying]
        near = [one for one, value in zip(paying, found, strict=True) if value <= min(found) + STRONG]
        plainest, *others = sorted(near, key=lambda one: PLAINEST_FIRST.index(one.terms[-1]))
        for one in (one for one in others if one.terms[-1] not in RARER):
            plainest = one if _predicts_better(one, plainest) >= _WORSE else plainest
        return plainest

    def is_as_likely(self, plainer: Candidate, other: Candidate) -> bool:
        """Return whether the data cannot rank a plainer model below another one, by the same criterion."""
        alike = max(self.correlation(one, one.terms[-1]) for one in (plainer, other))
        if math.isinf(alike):  # a term that does nothing says nothing of the others
            return False
        count = max(len(self.signs) / alike, math.e)
        more = len(plainer.model.parameters) - len(other.model.parameters)
        return more * math.log(count) + self.ratio(plainer, other) / alike <= STRONG and plainer.stiffness > 0.0

    def _gain(self, ratio: float, count: float, alike: float, more: int) -> float:
        """The gain of `more` parameters by the likelihood ratio of so many samples, alike: their correlation factor."""
        return ratio / alike - self._cost(count, alike, more)

    def _cost(self, count: float, alike: float, more: int) -> float:
        chosen_from = math.log(self.choices)  # their gamma of 1/2
        return more * math.log(max(count / alike, math.e)) + chosen_from

    def _pays_where_smooth(self, smaller: Candidate, larger: Candidate, term: str) -> bool:
        """Whether a linear term pays without the samples in which the rate is wrong too: those make a cubic."""
        if not TERMS[term].linear or self.smooth.all() or np.count_nonzero(self.smooth) < FEWEST:
            return True
        share, alike = float(np.mean(self.smooth)), self.correlation(larger, term)
        ratio = share * self.ratio(smaller.on(self.smooth), larger.on(self.smooth))
        return self._gain(ratio, share * len(self.signs), alike, _more_parameters(smaller, larger)) > 0.0


def by_rate(count: int, density: float, size: float) -> float:
    """Return by how much errors of the rate blur the likelihood of `count` samples; arguments as of `Criterion`."""
    return count * (2.0 * density * _EXPLAINED * size) ** 2


def density_at_zero(residuals: Array, least: float) -> float:
    """Return the density of residuals (n,), N m, at zero, 1/(N m); least: N m, within which they are rounded."""
    near = float(np.quantile(np.abs(residuals), min(0.5, 3.0 * len(residuals) ** (-1.0 / 3.0))))
    near = max(near, least)
    inside = np.count_nonzero(np.abs(residuals) <= near)
    return inside / (2.0 * near * len(residuals)) if near > 0.0 else np.inf


def criterion_of(
    fits: Fits, considered: tuple[str, ...], start: tuple[str, ...], *, doubted: bool = False
) -> Criterion:
    """Return the criterion by which terms are chosen from those considered; start: terms that the richest model has.

    The residuals of the richest model are taken for the noise: those of a smaller one would hold missing terms.
    """
    richest = _richest(fits, considered, start)
    columns, residuals = fits.linearised(richest)
    signs = np.sign(residuals)
    return Criterion(
        richest,
        signs=signs,
        fitted=measure([(columns, signs)]).fitted,
        density=density_at_zero(residuals, 0.5 * smallest_step(fits.torque)),  # a joint at rest repeats one count
        size=float(np.mean(np.abs(fits.torque))),
        smooth=fits.smooth,
        choices=len(considered),
        doubted=doubted,
    )


def _more_parameters(smaller: Candidate, larger: Candidate) -> int:
    """How many parameters a model has more than another; a law in the place of a plainer one has the others already."""
    return max(1, len(larger.model.parameters) - len(smaller.model.parameters))


def _predicts_better(one: Candidate, other: Candidate) -> float:
    """By how many standard errors over the blocks one model predicts held-out blocks better than another."""
    better = other.held_out - one.held_out
    mean, error = float(better.mean()), float(better.std(ddof=1)) / math.sqrt(FOLDS)
    return mean / error if error > 0.0 else math.copysign(math.inf, mean)


def _richest(fits: Fits, considered: tuple[str, ...], start: tuple[str, ...]) -> tuple[str, ...]:
    """All terms that lower the fitness one after the other, the better of two that exclude each other."""
    found = [start]  # in an order that does not depend on hashes: some fits are equally good
    for term in considered:
        for terms in tuple(found):
            more = with_another(terms, term)
            if term not in terms and is_addable(term, more[:-1]) and fits.fitness(more) < fits.fitness(terms):
                found.append(more)
                if not _has_rivals(term, considered):
                    found.remove(terms)
    return min(found, key=fits.fitness)


def _has_rivals(term: str, considered: tuple[str, ...]) -> bool:
    """Whether there is a term considered that the term cannot stand beside."""
    return bool(TERMS[term].excludes) or any(term in TERMS[other].excludes for other in considered)


def _is_distinct(fitted: Candidate, term: str) -> bool:
    """Whether the term can be distinguished from the others: where the joint moves slowly a skew is a damping.

    Its own parameters need not be distinguishable: how slowly a branch relaxes may show, and not how stiff it is.
    """
    return any(column @ column < _CONFUSED * (alone @ alone) for column, alone in fitted.columns_of(term))
