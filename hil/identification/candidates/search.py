"""Search the candidates, which are sets of points of the catalogue, best first, inside Occam's window.

A candidate is inside this window if it is not much less likely than the best one (Madigan and Raftery 1994). Its score
is twice the log odds for it: the evidence of a least-squares fit with unit information (Schwarz 1978), for the number
of independent samples that its residuals are worth, plus the prior odds of its terms. All scores are computed from one
Gram matrix, so their cost does not depend on the number of samples.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ga.arrays import Array, Index, Mask
from ga.model.record import Term
from ga.model.terms import SMALLEST, TERMS, lacking
from hil.identification.candidates.catalogue import Catalogue, Point
from hil.signals import constants as c

Points = tuple[int, ...]
"""The indices of a candidate's points in the catalogue, ascending."""


@dataclass(frozen=True, slots=True)
class Score:
    """The score of fits to `count` rows. spread: the number of rows that count as one independent sample."""

    count: int
    spread: float = 1.0

    def of(self, square: Array | float, parameters: Array | int) -> Array:
        """Return twice the log evidence for fits.

        square: the sums of their squared residuals, relative to the torque's variance. parameters: how many they have
        besides those of the smallest model.
        """
        samples = self.count / self.spread
        left = np.maximum(square, 0.0) / self.count + c.ACCURATE**2
        return np.asarray(-samples * np.log(left) - np.asarray(parameters) * math.log(max(samples, math.e)))

    @classmethod
    def measured(cls, table: Array, residuals: Array) -> Score:
        """Return the score with the spread estimated from a fit with columns (k, m) and residuals (m,).

        The products of columns and residuals, summed over blocks in time, vary more than those of independent samples
        would. The spread is the ratio of the two variances.
        """
        table = table / (np.sqrt((table**2).mean(axis=1, keepdims=True)) + np.finfo(float).tiny)
        parts = np.array_split(table * residuals, c.SEARCH_BLOCKS, axis=1)
        scores = np.array([part.sum(axis=1) for part in parts])
        scores -= scores.mean(axis=0)
        power = float(residuals @ residuals) / len(residuals)
        inverse = np.linalg.pinv(table @ table.T, rcond=1e-9, hermitian=True)
        varied = float(np.trace(inverse @ scores.T @ scores)) / (len(table) * max(power, np.finfo(float).tiny))
        return cls(len(residuals), max(1.0, varied * c.SEARCH_BLOCKS / (c.SEARCH_BLOCKS - 1)))


def odds(terms: Iterable[str]) -> float:
    """Return twice the log prior odds of terms."""
    return sum(2.0 * math.log(_chance(TERMS[term])) for term in terms)


def _chance(record: Term) -> float:
    if record.bench == "always":
        return 1.0
    if record.seldom or record.breaks:
        return c.SELDOM
    return c.COMMON if record.selection == "considered" else c.RARE


class PointSearch:
    """The search among the points of a catalogue, for one noise model."""

    def __init__(self, catalogue: Catalogue) -> None:
        self.catalogue, self.points = catalogue, catalogue.points
        self._columns, self._target = catalogue.whitened()
        self.score = Score(len(self._target))
        self._gram, self._products = self._columns @ self._columns.T, self._columns @ self._target
        self._power = float(self._target @ self._target)
        self._seen = dict[Points, float]()
        kinds = [point.terms for point in self.points]
        self._kinds = {kind: np.array([at for at, one in enumerate(kinds) if one == kind]) for kind in kinds}
        self._odds = np.array([odds(kind) - 2.0 * math.log(len(self._kinds[kind])) for kind in kinds])
        self._parameters = np.array([point.parameters for point in self.points])
        self._conflicts = _conflicts(self.points)
        self._needy = [at for at, kind in enumerate(kinds) if not is_complete(kind)]
        widths = np.array([len(point.at) for point in self.points], dtype=np.int64)
        self._wide = {
            width: (numbers := np.flatnonzero(widths == width), np.array([self.points[one].at for one in numbers]))
            for width in np.unique(widths).tolist()
            if width
        }

    def terms(self, candidate: Points) -> tuple[str, ...]:
        """Return the terms of a candidate besides those of the smallest model."""
        return tuple(term for number in candidate for term in self.points[number].terms)

    def values(self, candidate: Points) -> dict[str, float]:
        """Return the nonlinear parameters of a candidate, SI, by name."""
        found = {name: value for number in candidate for name, value in self.points[number].values.items()}
        at = self._at(candidate)
        _, _, factors = self._solved(at)
        unit = self.catalogue.size / self.catalogue.scale[at]
        size = dict(zip(at, (factors * unit).tolist(), strict=True))
        for point in (self.points[number] for number in candidate):
            for one in TERMS[point.terms[-1]].parameters:
                if one.kind == "delay":
                    found[one.name] = size[point.at[0]]
                elif one.kind == "load share" and point.changed in size:
                    found[one.name] *= max(size[point.changed], 0.0)
        return found

    def rated(self, candidate: Points) -> float:
        """Return the score of a candidate. A negative factor that must not be negative counts as zero."""
        if candidate in self._seen:
            return self._seen[candidate]
        at = self._at(candidate)
        try:
            square, errors, factors = self._solved(at)
        except np.linalg.LinAlgError:
            return self._seen.setdefault(candidate, -math.inf)
        held = {*self.catalogue.base[:2], *(one for number in candidate for one in self.points[number].positive)}
        below = np.array([one in held for one in at]) & (factors < 0.0)
        variance = max(square, np.finfo(float).tiny) / self.score.count * self.score.spread
        lost = float((factors[below] ** 2 / errors[below]).sum()) / variance
        chosen = list(candidate)
        found = self.score.of(square, self._parameters[chosen].sum()) + self._odds[chosen].sum() - lost
        return self._seen.setdefault(candidate, float(found))

    def beside(self, candidate: Points) -> Array:
        """Return the scores (points,) of the candidates with one more point, -inf for impossible ones."""
        at, scores = self._at(candidate), np.full(len(self.points), -np.inf)
        try:
            root = np.linalg.cholesky(self._stable(at))
        except np.linalg.LinAlgError:
            return scores
        across, along = np.linalg.solve(root, self._gram[at]), np.linalg.solve(root, self._products[at])
        square, left = self._power - float(along @ along), self._products - across.T @ along
        free = np.ones(len(self._gram), dtype=bool)
        free[at] = False
        chosen, terms = list(candidate), self.terms(candidate)
        may: Mask = np.logical_not(self._conflicts[chosen].any(axis=0))
        may[[one for one in self._needy if not is_complete((*terms, *self.points[one].terms))]] = False
        for numbers, columns in self._wide.values():
            possible = numbers[may[numbers]]
            adds, gains = self._gains(columns[may[numbers]], across, left, free)
            parameters = self._parameters[chosen].sum() + self._parameters[possible]
            found = self.score.of(square - gains, parameters) + self._odds[chosen].sum() + self._odds[possible]
            scores[possible] = np.where(adds, found, -np.inf)
        return scores

    def first(self) -> Points:
        """Return the candidate of a forward selection, each step of which adds the best point."""
        best: Points = ()
        while True:
            scores = self.beside(best)
            likely = np.argsort(-scores)[: 2 * c.GRID_POINTS]
            larger = (_with(best, number) for number in likely.tolist() if scores[number] > -np.inf)
            better = next((one for one in larger if self.rated(one) > self.rated(best)), None)
            if better is None:
                return best
            best = better

    def found(self) -> list[tuple[float, Points]]:
        """Search best first; return the candidates inside Occam's window with their scores, the best one first."""
        start = self.first()
        best, queue, done = self.rated(start), [(-self.rated(one), one) for one in {(), start}], set[Points]()
        heapq.heapify(queue)
        while queue and len(done) < c.EXPANDED:
            against, candidate = heapq.heappop(queue)
            if candidate in done or (done and -against < best - c.OCCAM):
                continue
            done.add(candidate)
            for one in self._neighbours(candidate, best):
                if one not in self._seen:
                    best = max(best, self.rated(one))
                    if self.rated(one) > best - c.OCCAM:
                        heapq.heappush(queue, (-self.rated(one), one))
        inside = [(score, one) for one, score in self._seen.items() if score > best - c.OCCAM]
        return sorted(inside, reverse=True)

    def learn_spread(self) -> None:
        """Estimate the spread of the score from the residuals of the first candidate."""
        at = self._at(self.first())
        _, _, factors = self._solved(at)
        self.score = Score.measured(self._columns[at], self._target - factors @ self._columns[at])
        self._seen.clear()

    def helping_alone(self) -> list[Points]:
        """Return candidates of one point: the best of each term that has nonlinear parameters and may help alone."""
        likely = self._best_of_kinds(self.beside(()), self.rated(()) + c.STRONG, 1)
        return [(number,) for number in likely if self.points[number].values]

    def _neighbours(self, candidate: Points, best: float) -> Iterator[Points]:
        """Yield the candidates with one point more, one point less, or one point replaced by another."""
        least = best - c.OCCAM - c.STRONG
        for number in self._best_of_kinds(self.beside(candidate), least, c.GRID_POINTS):
            yield _with(candidate, number)
        for number in candidate:
            rest = tuple(one for one in candidate if one != number)
            if is_complete(self.terms(rest)):
                yield rest
            others = np.where(self._conflicts[number], self.beside(rest), -np.inf)
            for other in self._best_of_kinds(others, least, c.GRID_POINTS):
                yield _with(rest, other)

    def _best_of_kinds(self, scores: Array, least: float, count: int) -> list[int]:
        """Return, for each term, the `count` best of its points whose scores are above `least`."""
        found = list[int]()
        for numbers in self._kinds.values():
            likely = numbers[np.argsort(-scores[numbers])[:count]]
            found += likely[scores[likely] > least].tolist()
        return found

    def _at(self, candidate: Points) -> list[int]:
        own = (at for number in candidate for at in self.points[number].at)
        return list(dict.fromkeys((*self.catalogue.base, *own)))

    def _stable(self, at: list[int]) -> Array:
        gram = self._gram[np.ix_(at, at)]
        return np.asarray(gram + np.diag(1e-9 * np.diag(gram) + np.finfo(float).tiny))

    def _solved(self, at: list[int]) -> tuple[float, Array, Array]:
        """Return the sum of squared residuals of a fit with columns, the diagonal (k,) of the inverse Gram matrix, and
        the factors (k,).

        Raises LinAlgError if the columns are collinear.
        """
        root = np.linalg.cholesky(self._stable(at))
        inverse = np.linalg.inv(root)
        along = inverse @ self._products[at]
        return self._power - float(along @ along), (inverse**2).sum(axis=0), inverse.T @ along

    def _gains(self, columns: Index, across: Array, left: Array, free: Mask) -> tuple[Mask, Array]:
        """Return which points (p,), with columns (p, k), are independent of a candidate's columns, and by how much each
        lowers the sum of squares.

        across (b, c), left (c,): the projections of all columns on the candidate's b columns, and their products with
        its residuals. free (c,): which columns the candidate does not have.
        """
        own = self._gram[columns[:, :, None], columns[:, None, :]]
        own = own - np.einsum("kpi,kpj->pij", across[:, columns], across[:, columns])
        power = np.diagonal(self._gram)[columns]
        alone = free[columns] & (np.einsum("pii->pi", own) > c.NEW_COLUMN * power)
        own = np.where(alone[:, :, None] & alone[:, None, :], own, 0.0)
        own += np.eye(columns.shape[1]) * np.where(alone, 1e-9 * power, 1.0)[:, None, :]
        towards = np.where(alone, left[columns], 0.0)
        gains = (towards * np.linalg.solve(own, towards[:, :, None])[:, :, 0]).sum(axis=1)
        return alone.any(axis=1), gains


def _with(candidate: Points, number: int) -> Points:
    return tuple(sorted((*candidate, number)))


def is_complete(terms: Sequence[str]) -> bool:
    """Return whether none of the terms lacks one that it needs."""
    all_terms = {*SMALLEST.split("+"), *terms}
    return not any(lacking(term, all_terms) for term in all_terms)


def _conflicts(points: Sequence[Point]) -> Mask:
    """Return which points (p, p) cannot be in one candidate: they share a term, or their terms exclude each other."""
    names = {term: at for at, term in enumerate(TERMS)}
    covered, excluded = np.zeros((2, len(points), len(names)), dtype=np.float32)
    for number, point in enumerate(points):
        covered[number, [names[term] for term in point.terms]] = 1.0
        excluded[number, [names[other] for term in point.terms for other in TERMS[term].excludes]] = 1.0
    return np.asarray(covered @ covered.T + covered @ excluded.T + excluded @ covered.T > 0.0)
