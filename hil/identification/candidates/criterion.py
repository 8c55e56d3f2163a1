"""Decide whether a term improves the score: its gain beyond chance, under the noise model of the recording.

The gain of a term is computed in three steps. The likelihood ratio of a median regression is 4 f(0) times the fall of
the sum of absolute residuals (Koenker and Machado 1999). It is divided by the factor by which the correlation of the
residuals raises the variance of the term's parameters (`residual_spectrum.py`). Then log n for each parameter (Schwarz
1978) and the cost of choosing among many terms (Chen and Chen 2008) are subtracted.

The term must also not predict held-out blocks clearly worse. A rare term, and a term with a break, whose likelihood
ratio has no known distribution, must predict them better and have a large gain. The density f(0) and the correlation
come from the residuals of the chosen model, because those of a smaller model contain the effects of missing terms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ga.arrays import Array, Mask
from ga.model.terms import TERMS
from hil.identification.candidates.fits import Candidate, Fits
from hil.identification.candidates.residual_spectrum import measure
from hil.signals import constants as c
from hil.signals.deflection_noise import smallest_step


@dataclass(frozen=True, eq=False)
class Criterion:
    """The noise model of a recording, and the score of a term under it.

    signs (n,): the signs of the chosen model's residuals, which are treated as noise. fitted: the number of lines of
    their spectrum that the fit has removed from each band. density: the probability density of the residuals at zero,
    1/(N m). size: mean |torque|, N m. smooth (n,): where the rate is right. choices: the number of terms to choose
    from.
    """

    signs: Array
    fitted: Array
    density: float
    size: float
    smooth: Mask
    choices: int
    _correlations: dict[tuple[Candidate, str], float] = field(default_factory=dict, init=False)

    def pays(self, smaller: Candidate, larger: Candidate, term: str, enough: float = 0.0) -> bool:
        """Return whether `term`, which only the larger model has, improves the score by more than `enough`."""
        if smaller.fit.fitness < c.GAIN_ERROR * self.size:
            return False
        if larger.is_at_end(term) or larger.is_impossible(term) or not _is_distinct(larger, term):
            return False
        if larger.stiffness <= 0.0 < smaller.stiffness:  # no coupling pushes: the term stands in for it
            return False
        record = TERMS[term]
        doubted = record.breaks or record.selection in {"misfit", "motor torque"}
        doubted |= any(other in larger.terms for other in record.confusable)
        enough += c.VERY_STRONG if doubted else 0.0
        if min(self.gain(smaller, larger, term), self._gain_where_smooth(smaller, larger, term)) <= enough:
            return False
        return predicts_better(larger, smaller) >= (c.BETTER if doubted else -c.CLEARLY)

    def gain(self, smaller: Candidate, larger: Candidate, term: str) -> float:
        """Return the gain beyond chance of `term`, which only the larger model has."""
        return self.weighed(smaller, larger, term)[0]

    def weighed(self, smaller: Candidate, larger: Candidate, term: str) -> tuple[float, float]:
        """Return the gain of a term, and its cost: the part subtracted from the likelihood ratio. Both are twice log
        odds.
        """
        alike = self.correlation(larger, term)
        cost = self._cost(len(self.signs), alike, _more_parameters(smaller, larger))
        return self.ratio(smaller, larger) / alike - cost, cost

    def ratio(self, one: Candidate, other: Candidate) -> float:
        """Return twice the log likelihood of the model `other` less that of the model `one`, for independent
        residuals.
        """
        return 4.0 * self.density * len(self.signs) * (one.fit.fitness - other.fit.fitness)

    def correlation(self, fitted: Candidate, term: str) -> float:
        """Return the factor by which the correlation of the residuals raises the variance of the term's parameters."""
        if (fitted, term) in self._correlations:
            return self._correlations[fitted, term]
        found = max((1.0, *(self._correlation(alone) for _, alone in fitted.own_columns(term))))
        self._correlations[fitted, term] = found
        return found

    def _correlation(self, alone: Array) -> float:
        """Return the factor by which correlated residuals raise the variance of one parameter; infinite if its column
        is zero.

        alone (n,): the part of the parameter's column that is orthogonal to all other columns.
        """
        power = float(alone @ alone)
        if power <= 0.0:
            return math.inf
        spectrum = replace(measure([(alone[:, None], self.signs)]), fitted=self.fitted)
        # in slow ramps the slowest lines hold most of what a gap does: by their power a real one would not be found
        return float(spectrum.by_bands[0, 0]) / power

    def _cost(self, count: float, alike: float, more: int) -> float:
        """Return the cost of `more` additional parameters. count: number of samples. alike: the factor by which
        correlated residuals reduce the number of independent samples.
        """
        chosen_from = math.log(self.choices)  # their gamma of 1/2
        return more * math.log(max(count / alike, math.e)) + chosen_from

    def _gain_where_smooth(self, smaller: Candidate, larger: Candidate, term: str) -> float:
        """Return the gain of a linear term without the samples with a wrong rate, which imitate a cubic spring."""
        if not TERMS[term].linear or self.smooth.all() or np.count_nonzero(self.smooth) < c.FEWEST:
            return math.inf
        share, alike = float(np.mean(self.smooth)), self.correlation(larger, term)
        ratio = share * self.ratio(smaller.on(self.smooth), larger.on(self.smooth))
        return ratio / alike - self._cost(share * len(self.signs), alike, _more_parameters(smaller, larger))


def by_rate(count: int, density: float, size: float) -> float:
    """Return the factor, beyond one, by which errors of the rate make the likelihood of `count` samples less certain.

    density: that of the residuals at zero, 1/(N m). size: mean |torque|, N m.
    """
    return count * (2.0 * density * c.GAIN_ERROR * size) ** 2


def density_at_zero(residuals: Array, least: float) -> float:
    """Return the probability density at zero, 1/(N m), of residuals (n,), N m.

    least: the step, N m, to which the residuals are rounded.
    """
    near = float(np.quantile(np.abs(residuals), min(0.5, 3.0 * len(residuals) ** (-1.0 / 3.0))))
    near = max(near, least)
    inside = np.count_nonzero(np.abs(residuals) <= near)
    return inside / (2.0 * near * len(residuals)) if near > 0.0 else np.inf


def criterion_of(fits: Fits, chosen: Candidate, choices: int) -> Criterion:
    """Return the criterion that treats the residuals of the model `chosen` as noise.

    choices: the number of terms to choose from.
    """
    columns, residuals = chosen.columns, chosen.residuals
    signs = np.sign(residuals)
    return Criterion(
        signs=signs,
        fitted=measure([(columns, signs)]).fitted,
        density=density_at_zero(residuals, 0.5 * smallest_step(fits.torque)),
        size=float(np.mean(np.abs(fits.torque))),
        smooth=fits.smooth,
        choices=choices,
    )


def _more_parameters(smaller: Candidate, larger: Candidate) -> int:
    """Return how many more parameters the larger model has than the smaller one, at least 1."""
    return max(1, len(larger.model.parameters) - len(smaller.model.parameters))


def predicts_better(one: Candidate, other: Candidate) -> float:
    """Return by how many standard errors model `one` predicts held-out blocks better than model `other`."""
    better = other.held_out - one.held_out
    mean, error = float(better.mean()), float(better.std(ddof=1)) / math.sqrt(c.FOLDS)
    return mean / error if error > 0.0 else math.copysign(math.inf, mean)


def _is_distinct(fitted: Candidate, term: str) -> bool:
    """Return whether the term can be distinguished from the others (in slow motion a skew cannot: it equals a damping).

    The term's own parameters need not be distinguishable from each other: the relaxation time of a branch may be
    visible while its stiffness is not.
    """
    return any(
        column @ column < c.CONFUSED * (alone @ alone) for column, alone in fitted.own_columns(term, together=True)
    )
