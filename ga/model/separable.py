"""Fit models by variable projection: nonlinear parameters are searched, the linear ones are computed exactly.

For given nonlinear parameters (such as skew, gap, slack) the fit is a least-absolute-deviations problem, and its exact
minimum is the fitness of these parameters. `best_start` looks for the lowest local minimum from a few starting values.
`descend` goes to the local minimum next to any point (Gauss-Newton with the exact solver as its step; Osborne and
Watson 1971). `compass_search` goes further down if breaks make the fitness too rough for Gauss-Newton.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from operator import attrgetter
from types import MappingProxyType
from typing import Final, Protocol

import numpy as np

from ga.arrays import Array, Mask
from ga.lad.exact import Optimum, not_negative
from ga.model.coupling import lag_of
from ga.model.record import Parameter, positive_among
from ga.model.trajectory import Motion
from ga.samples import resolution

FEW: Final = 600
ENOUGH: Final = 2500
"""FEW: the number of rows on which local minima are compared. ENOUGH: the number of rows on which a minimum is located
before all rows are used.
"""

_AGREEMENTS: Final = 8
_AGREED: Final = 1e-3
"""_AGREEMENTS: the largest number of times that the contact of a gap's surfaces is recomputed from the resulting fit.
_AGREED: the precision of Bc/Kc at which contact and fit agree.
"""

_ALIKE: Final = 1.0 - 1e-6  # of a fitness: what differs by less has the same columns
_STARTS: Final = 300
STEPS: Final = 20
HALVINGS: Final = 4
_CONVERGED: Final = 1e-7
_NEARLY: Final = 1e-5
"""_STARTS, STEPS: the largest numbers of starting values, and of steps of a descent. HALVINGS: how often a step is
shortened. _CONVERGED: a descent ends when a step gains less than this fraction of the fitness, or is shorter than this
fraction of the bounds' width. _NEARLY: the same for a minimum that is a starting point, or rough.
"""

_FIRST: Final = 8e-3
_FINE: Final = 1e-3
"""The steps of a compass search, as fractions of the bounds' width. _FIRST: the first step. _FINE: the step from which
the steps shrink faster; _NEARLY is the last one.
"""

_fitness: Final = attrgetter("fitness")
_FEW_STEPS: Final = 8  # of a compass, after which their common direction is known


class SeparableModel(Protocol):
    """A model that can be fitted: `ga.model.coupling.CouplingModel`, or a user's own."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def sticks(self) -> bool: ...  # noqa: D102
    @property
    def linear(self) -> tuple[Parameter, ...]: ...  # noqa: D102
    @property
    def nonlinear(self) -> tuple[Parameter, ...]: ...  # noqa: D102
    @property
    def needs_ratio(self) -> bool: ...  # noqa: D102
    @property
    def chooses_edge(self) -> bool: ...  # noqa: D102
    def columns(self, motion: Motion, nonlinear: Array | None = None, lag: float = 0.0) -> Array: ...  # noqa: D102
    def target(self, motion: Motion, torque: Array, nonlinear: Array | None = None) -> Array: ...  # noqa: D102
    def jacobian(  # noqa: D102
        self, motion: Motion, nonlinear: Array, genes: Array, lag: float = 0.0, torque: Array | None = None
    ) -> Array: ...
    def anchored(self, motion: Motion) -> SeparableModel: ...  # noqa: D102
    def bounds(self, motion: Motion, highest: float) -> tuple[Array, Array]: ...  # noqa: D102
    def described(self, motion: Motion, delay: float = 0.0) -> Mask: ...  # noqa: D102
    def delay(self, nonlinear: Array | None) -> float: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class Fit:
    """A local minimum: nonlinear parameters (q,), and genes (p,): the linear parameters that are optimal for these.

    lag: Bc/Kc of these genes, s, if the model has surfaces that can only push; 0 if they part at the gap's edge.
    """

    nonlinear: Array
    optimum: Optimum
    lag: float = 0.0

    @property
    def fitness(self) -> float:
        """The mean absolute error, N m."""
        return self.optimum.fitness

    @property
    def values(self) -> Array:
        """All parameters, (p + q,): genes, then nonlinear parameters."""
        return np.concatenate([self.optimum.genes, self.nonlinear])


@dataclass(frozen=True, eq=False)
class _Solved:
    """A fit with columns (n, p) and target (n,) of its linear problem; too large to be stored."""

    fit: Fit
    columns: Array
    target: Array


@dataclass(frozen=True, eq=False)
class Problem:
    """A model to be fitted to a recording.

    motion (n,) and torque (n,), N m: the recording. low and high (q,): bounds of the nonlinear parameters.
    """

    model: SeparableModel
    motion: Motion
    torque: Array
    low: Array
    high: Array

    @cached_property
    def positive(self) -> tuple[int, ...]:
        """Return the indices of the linear parameters that cannot be negative."""
        return positive_among(self.model.linear)

    def solve(self, nonlinear: Array, near: Fit | None = None, agreements: int = _AGREEMENTS) -> Fit:
        """Return the exact minimum for nonlinear parameters (q,); genes that cannot be negative are constrained.

        near: the fit for similar values, from which the solver starts. If contact depends on Bc/Kc, which the minimum
        determines, both are recomputed until they agree, at most `agreements` times; the fit whose surfaces part at the
        gap's edge is returned if it is better. Raises RuntimeError if no optimum can be proven.
        """
        return self._solved(nonlinear, near, agreements).fit

    def _solved(self, nonlinear: Array, near: Fit | None = None, agreements: int = _AGREEMENTS) -> _Solved:
        """Return the exact minimum, as `solve` does, together with its linear problem."""
        target, lag = self.model.target(self.motion, self.torque, nonlinear), near.lag if near else 0.0
        if not self.model.linear:
            optimum = Optimum(np.empty(0), float(np.mean(np.abs(target))), 0.0, True, resolution(self.torque))
            return _Solved(Fit(nonlinear, optimum), self.model.columns(self.motion, nonlinear, 0.0), target)
        best = self._parting(nonlinear, target, lag, near)
        at_edge = [self._parting(nonlinear, target, 0.0, near)] if agreements and self.model.chooses_edge else []
        for _ in range(agreements if self.model.needs_ratio else 0):
            next_lag = lag_of(*best.fit.optimum.genes[:2].tolist())
            if abs(next_lag - lag) <= _AGREED * lag:
                break
            lag = next_lag
            best = self._parting(nonlinear, target, lag, best.fit)
        return min([best, *at_edge], key=lambda solved: solved.fit.fitness)

    def _parting(self, nonlinear: Array, target: Array, lag: float, near: Fit | None) -> _Solved:
        """Return the minimum for surfaces that part as Bc/Kc = `lag`, s, has it."""
        columns = self.model.columns(self.motion, nonlinear, lag)
        optimum = not_negative(columns, target, self.positive, near.optimum.genes if near else None)
        return _Solved(Fit(nonlinear, optimum, lag), columns, target)

    def of(self, rows: Mask | slice) -> Problem:
        """Return the problem on the samples `rows` only."""
        return replace(self, motion=self.motion.of(rows), torque=self.torque[rows])

    def thinned(self, rows: int = ENOUGH) -> Problem:
        """Return the problem on about `rows` samples, evenly spaced; a part of all would compute everything twice."""
        return self.of(slice(None, None, every)) if (every := len(self.torque) // rows) > 1 else self

    def sketched(self, rows: int = ENOUGH) -> Problem:
        """Return the problem on about `rows` samples of a coarser motion, enough to find a starting point."""
        motion, kept = self.motion.coarser(rows)
        return replace(self, motion=motion, torque=self.torque[kept]).thinned(rows)

    def residuals(self, fit: Fit) -> Array:
        """Return the residuals of the fit, (n,) N m."""
        target = self.model.target(self.motion, self.torque, fit.nonlinear)
        return np.asarray(target - self.model.columns(self.motion, fit.nonlinear, fit.lag) @ fit.optimum.genes)

    def linearised(self, fit: Fit) -> tuple[Array, Array]:
        """Return columns (n, p + q) and torque (n,) of the problem linearised at the fit.

        At `fit.values` the linearised problem has the residuals of the fit.
        """
        columns = self.model.columns(self.motion, fit.nonlinear, fit.lag)
        return self._around(_Solved(fit, columns, self.model.target(self.motion, self.torque, fit.nonlinear)))

    def _around(self, solved: _Solved) -> tuple[Array, Array]:
        """Return the result of `linearised` for a fit whose linear problem is known."""
        fit = solved.fit
        jacobian = self.model.jacobian(self.motion, fit.nonlinear, fit.optimum.genes, fit.lag, self.torque)
        return np.concatenate([solved.columns, jacobian], axis=1), solved.target + jacobian @ fit.nonlinear


def fit(problem: Problem) -> Fit:
    """Return the lowest local minimum found. Raises RuntimeError if no optimum can be proven."""
    if not problem.low.size:
        return problem.solve(problem.low)
    return compass_search(problem, descend(problem, best_start(problem.sketched()).nonlinear))


def best_start(problem: Problem, near: Mapping[str, float] = MappingProxyType({})) -> Fit:
    """Return the local minimum reached from the best of at most _STARTS starting values, drawn from the grid of all.

    near: approximate values of some nonlinear parameters, by name.
    """
    tried = []
    for parameter, low, high in zip(problem.model.nonlinear, problem.low, problem.high, strict=True):
        parts, name = np.array(parameter.starts), parameter.name
        tried.append(np.array([near[name]]) if name in near else low + (high - low) * parts)
    thin, found = problem.thinned(FEW), list[Fit]()
    sizes = tuple(map(len, tried))
    drawn = np.random.default_rng(0).choice(prod(sizes), min(prod(sizes), _STARTS), replace=False)
    for place in np.transpose(np.unravel_index(np.sort(drawn), sizes)):
        chosen = np.array([values[at] for values, at in zip(tried, place, strict=True)])
        seen = solve_or_none(thin, chosen, min(found, key=_fitness, default=None))
        found += [] if seen is None else [seen]
    if not found:
        raise RuntimeError("for no nonlinear parameters were the columns different enough")
    found.sort(key=_fitness)
    first, best = _descent(problem, found[0].nonlinear, _NEARLY)
    for other in _other_starts(problem, first, best, found):
        best = min(best, descend(problem, other.nonlinear, _NEARLY), key=_fitness)
    return best


def _other_starts(problem: Problem, first: Fit, best: Fit, starts: list[Fit]) -> list[Fit]:
    """Return further starting fits: the next one if the descent from the first gained nothing, and the best one inside
    the bounds.

    first and best: the fits at the beginning and at the end of that descent. Starts with equal fits, such as those of a
    zero gap wherever its middle is, are treated as one start. A delay and a damping can replace each other, one of them
    negative: if a descent ends at a bound, the optimum may be reached from a start that is at no bound.
    """
    if problem.model.needs_ratio:  # with the ratio at the end
        first = problem.solve(first.nonlinear, best)
    is_stuck = best.fitness > _ALIKE * first.fitness
    others = [one for one in starts if _ALIKE * one.fitness > starts[0].fitness][:1] if is_stuck else []
    best_inside, *inside = (all(one.optimum.genes[at] > 0.0 for at in problem.positive) for one in (best, *starts[1:]))
    next_inside = [one for one, is_inside in zip(starts[1:], inside, strict=True) if is_inside][:1]
    return others if best_inside or next_inside == others else others + next_inside


def solve_or_none(problem: Problem, nonlinear: Array, near: Fit | None) -> Fit | None:
    """Return the minimum for nonlinear parameters (q,); None if the columns are nearly collinear. near: a fit whose
    contact of surfaces is used, if given; that is enough to compare local minima.
    """
    solved = _solved_or_none(problem, nonlinear, near, 0 if near else _AGREEMENTS)
    return None if solved is None else solved.fit


def descend(problem: Problem, start: Array, converged: float = _CONVERGED) -> Fit:
    """Return the local minimum next to the nonlinear parameters `start` (q,), within the bounds.

    converged: the limits at which the descent ends, as _CONVERGED.
    """
    return _descent(problem, start, converged)[1]


def _descent(problem: Problem, start: Array, converged: float) -> tuple[Fit, Fit]:
    """Return two fits: the fit at the start, and the result of `descend`."""
    solved = problem._solved(np.clip(start, problem.low, problem.high))
    first, count = solved.fit, problem.low.size
    for _ in range(STEPS if count else 0):
        best = solved.fit
        try:
            step = not_negative(*problem._around(solved), problem.positive, best.values).genes[-count:] - best.nonlinear
        except RuntimeError:  # the Jacobian is a combination of the columns: no direction of descent
            break
        arrived = bool(np.all(np.abs(step) <= converged * (problem.high - problem.low)))
        better = None if arrived else _shortened(problem, best, step)
        if better is None:
            break
        solved, gained = better, best.fitness - better.fit.fitness
        if gained <= converged * solved.fit.fitness:
            break
    return first, solved.fit


def _shortened(problem: Problem, best: Fit, step: Array) -> _Solved | None:
    """Return the first fit of lower fitness among ever shorter steps from `best`, with its linear problem; or None."""
    for halving in range(HALVINGS):
        nonlinear = np.clip(best.nonlinear + step * 0.5**halving, problem.low, problem.high)
        if np.array_equal(nonlinear, best.nonlinear):
            return None
        tried = _solved_or_none(problem, nonlinear, best)
        if tried is not None and tried.fit.fitness < best.fitness:
            return tried
    return None


def _solved_or_none(
    problem: Problem, nonlinear: Array, near: Fit | None, agreements: int = _AGREEMENTS
) -> _Solved | None:
    """Return the fit for nonlinear parameters (q,), together with its linear problem; None if no optimum is proven: it
    counts as no improvement, and does not end a search.
    """
    try:
        return problem._solved(nonlinear, near, agreements)
    except RuntimeError:
        return None


def compass_search(problem: Problem, best: Fit) -> Fit:
    """Return the local minimum of a fitness made rough by breaks, by shrinking steps both ways along each parameter.

    If the minimum is long and narrow, a few steps show its direction, and growing steps follow (Hooke and Jeeves 1961).
    """
    steps, length, path = _rough(problem), _FIRST, [best]
    while len(steps) and length > _NEARLY:
        points = [best.nonlinear + sign * length * step for step in steps for sign in (1.0, -1.0)]
        tried = [_solved_or_none(problem, np.clip(point, problem.low, problem.high), best) for point in points]
        found = min((one.fit for one in tried if one is not None), key=_fitness, default=best)
        if found.fitness < best.fitness:
            path.append(found)
            if len(path) > _FEW_STEPS:
                path = [_further(problem, path[0], found)]
            best = path[-1]
        else:
            path, length = [best], length / (2.0 if length > _FINE else 4.0)
    return best


def _further(problem: Problem, first: Fit, best: Fit) -> Fit:
    """Return the lowest fit on the line from the fit `first` through the fit `best`, with doubling steps."""
    step = best.nonlinear - first.nonlinear
    while True:
        tried = _solved_or_none(problem, np.clip(best.nonlinear + step, problem.low, problem.high), best)
        if tried is None or tried.fit.fitness >= best.fitness:
            return best
        best, step = tried.fit, 2.0 * step


def _rough(problem: Problem) -> Array:
    """Return the directions of nonlinear parameters along which the fitness has many local minima, as (k, q).

    They are scaled to the bounds, and move one end of a gap each: the two ends have separate effects.
    """
    nonlinear = problem.model.nonlinear
    names = [parameter.name for parameter in nonlinear]
    if not any(parameter.kinked or parameter.friction for parameter in (*problem.model.linear, *nonlinear)):
        return np.empty((0, len(names)))
    steps = dict(zip(names, np.diag(problem.high - problem.low), strict=True))
    for width in nonlinear:
        if width.about in names:
            half = 0.5 * steps[width.name].sum() * np.eye(len(names))[names.index(width.about)]
            steps[width.name], steps[width.about] = steps[width.name] + half, steps[width.name] - half
    return np.array([steps[p.name] for p in nonlinear if p.refined]).reshape(-1, len(names))
