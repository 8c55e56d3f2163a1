"""Fit sets of terms in the band: least squares in all parameters, with the model's own columns.

The catalogue has nonlinear parameters at grid values, and changes of other columns as approximations; here both are
exact. A term that only made up for their errors no longer improves the score, and is removed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter

import numpy as np

from ga.arrays import Array
from ga.model.coupling import CouplingModel, lag_of
from ga.model.record import positive_among
from ga.model.separable import HALVINGS, STEPS
from ga.model.terms import TERMS
from hil.identification.candidates.band import Band
from hil.identification.candidates.catalogue import model_of
from hil.identification.candidates.search import Score, is_complete, odds
from hil.signals import constants as c


@dataclass(frozen=True, eq=False)
class BandFit:
    """The best linear parameters, `genes` (p,), for nonlinear ones (q,) and Bc/Kc = `lag`, s; SI.

    lag: 0 if the flanks of a gap part at its edge. columns (p + q, m), target (m,): of the problem linearised at the
    fit, whitened; those of the q nonlinear parameters follow once the fit has converged. residuals (rows,): N m, not
    whitened. terms: those besides the smallest model's. score: twice the log odds.
    """

    model: CouplingModel
    nonlinear: Array
    lag: float
    genes: Array
    columns: Array
    target: Array
    residuals: Array
    terms: tuple[str, ...] = ()
    score: float = -np.inf

    @property
    def values(self) -> dict[str, float]:
        """The nonlinear parameters, SI, by name."""
        return dict(zip((one.name for one in self.model.nonlinear), self.nonlinear.tolist(), strict=True))

    @cached_property
    def left(self) -> Array:
        """The whitened residuals (m,), N m."""
        return np.asarray(self.target - self.genes @ self.columns[: len(self.genes)])

    @cached_property
    def square(self) -> float:
        """The sum of squares of the whitened residuals."""
        return float(self.left @ self.left)


@dataclass(frozen=True, eq=False)
class BandFits:
    """The fits in a band; each model is fitted only once. size: standard deviation of the torque, N m."""

    band: Band
    score: Score
    size: float
    known: dict[frozenset[str], BandFit] = field(default_factory=dict)

    def fit(self, terms: tuple[str, ...], values: Mapping[str, float]) -> BandFit:
        """Return the fit of terms. values: approximate nonlinear parameters, SI, by name."""
        if (key := frozenset(terms)) not in self.known:
            self.known[key] = self._fit(terms, values)
        return self.known[key]

    def best(self) -> list[BandFit]:
        """Return the fits, the best one first; those without a spring or without a damper come last."""
        return sorted(self.known.values(), key=lambda one: (bool(np.min(one.genes[:2]) <= 0.0), -one.score))

    def may_win(self, fit: BandFit) -> bool:
        """Return whether a fit would be inside Occam's window of the best one if its terms had no cost.

        If it would not, none of the models that it contains is inside: they fit no better.
        """
        return self._score(fit.square, ()) > self.best()[0].score - c.OCCAM

    def pruned(self, fit: BandFit) -> BandFit:
        """Return the fit without the terms that do not improve the score, which are removed one after the other."""
        while True:
            free = (term for term in fit.terms if is_complete([one for one in fit.terms if one != term]))
            tried = [(self._without(fit, term), term) for term in free]
            likely = [term for score, term in sorted(tried, reverse=True) if score > fit.score - c.STRONG]
            smaller = (self.fit(tuple(one for one in fit.terms if one != term), fit.values) for term in likely)
            better = next((one for one in smaller if one.score >= fit.score), None)
            if better is None:
                return fit
            fit = better

    def _fit(self, terms: tuple[str, ...], values: Mapping[str, float]) -> BandFit:
        model = model_of(self.band.motion, terms)
        low, high = model.bounds(self.band.motion, self.band.highest)
        best = self._started(model, values, (low, high))
        if model.needs_ratio:
            pushing = self._solved(model, best.nonlinear, lag_of(*best.genes[:2]))
            best = min(pushing, best, key=_square) if model.chooses_edge else pushing
        jacobian = np.empty((0, len(best.target)))
        for _ in range(STEPS if len(low) else 0):
            jacobian = self._jacobian(best)
            better = self._stepped(best, jacobian, (low, high))
            if better is None:
                break
            gained, best = best.square - better.square, better
            if gained < c.CONVERGED * best.square:
                break
        columns = np.concatenate([best.columns, jacobian])
        return replace(best, columns=columns, terms=terms, score=self._score(best.square, terms))

    def _started(self, model: CouplingModel, values: Mapping[str, float], bounds: tuple[Array, Array]) -> BandFit:
        """Return the best fit of a few starts. A parameter without a given value starts at its absent value, or at the
        values of the grid.
        """
        low, high = bounds
        start = np.array([values.get(one.name, low[at]) for at, one in enumerate(model.nonlinear)])
        best = self._solved(model, np.clip(start, low, high), 0.0)
        for at, one in enumerate(model.nonlinear):
            grid = [low[at] + part * (high[at] - low[at]) for part in one.starts]
            for value in [one.absent] if one.name in values else grid:
                if value is not None:
                    moved = np.where(np.arange(len(low)) == at, value, best.nonlinear)
                    best = min(best, self._solved(model, moved, 0.0), key=_square)
        return best

    def _stepped(self, best: BandFit, jacobian: Array, bounds: tuple[Array, Array]) -> BandFit | None:
        """Return the fit after a Gauss-Newton step, halved until the fit is better; None if it never is."""
        model, columns = best.model, np.concatenate([best.columns, jacobian])
        target = best.target + best.nonlinear @ jacobian
        step = _least_squares(columns, target, positive_among(model.linear))[len(model.linear) :] - best.nonlinear
        for halving in range(HALVINGS):
            nonlinear = np.clip(best.nonlinear + step * 0.5**halving, *bounds)
            if np.array_equal(nonlinear, best.nonlinear):
                return None
            lags = {lag_of(*best.genes[:2]), *([0.0] if model.chooses_edge else [])}
            tried = min((self._solved(model, nonlinear, lag) for lag in lags), key=_square)
            if tried.square < best.square:
                return tried
        return None

    def _solved(self, model: CouplingModel, nonlinear: Array, lag: float) -> BandFit:
        motion, torque = self.band.motion, self.band.torque
        columns = model.columns(motion, nonlinear, lag).T
        lowered = self.band.lowered(np.concatenate([columns, model.target(motion, torque, nonlinear)[None]]))
        whitened = self.band.whitened(lowered)
        genes = _least_squares(whitened[:-1], whitened[-1], positive_among(model.linear))
        residuals = lowered[-1] - genes @ lowered[:-1]
        return BandFit(model, nonlinear, lag, genes, whitened[:-1], whitened[-1], residuals)

    def _jacobian(self, best: BandFit) -> Array:
        motion, torque = self.band.motion, self.band.torque
        changed = best.model.jacobian(motion, best.nonlinear, best.genes, best.lag, torque)
        return self.band.whitened(self.band.lowered(np.ascontiguousarray(changed.T)))

    def _without(self, fit: BandFit, term: str) -> float:
        """Return the score of a fit without a term, from the problem linearised at the fit with it."""
        parameters = fit.model.parameters
        own = np.array([one in TERMS[term].parameters for one in parameters])
        values = np.concatenate([fit.genes, fit.nonlinear])
        gone = [
            0.0 if one.absent is None else one.absent - value for one, value in zip(parameters, values, strict=True)
        ]
        target = fit.left - (np.array(gone) * own) @ fit.columns
        others = fit.columns[~own]
        left = target - _least_squares(others, target) @ others
        fewer = tuple(one for one in fit.terms if one != term)
        return self._score(float(left @ left), fewer)

    def _score(self, square: float, terms: tuple[str, ...]) -> float:
        parameters = sum(len(TERMS[term].parameters) for term in terms)
        return float(self.score.of(square / self.size**2, parameters)) + odds(terms)


_square = attrgetter("square")


def _least_squares(columns: Array, target: Array, positive: tuple[int, ...] = ()) -> Array:
    """Return the factors (k,) of columns (k, m) that fit a target (m,), those in `positive` not below zero."""
    free, found = np.ones(len(columns), dtype=bool), np.zeros(len(columns))
    size = np.sqrt((columns**2).mean(axis=1)) + np.finfo(float).tiny
    while True:
        scaled = columns[free] / size[free, None]
        found[:] = 0.0
        found[free] = np.linalg.lstsq(scaled.T, target, rcond=None)[0] / size[free]
        negative = [at for at in positive if found[at] < 0.0]
        if not negative:
            return found
        free[min(negative, key=lambda at: found[at] * size[at])] = False
