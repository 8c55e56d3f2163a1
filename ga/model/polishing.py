"""The last part of a fit of nonlinear parameters: along the troughs in which descents in all of them end early."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from ga.lad.exact import least_absolute_deviations
from ga.model.separable import descend

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ga.model.separable import Fit, Problem

    Array = NDArray[np.float64]

_REACH: Final = 12.0
_NEAREST: Final = 0.5
_ROUNDS: Final = 12
_POLISHED: Final = 1e-5
_SECTIONS: Final = 9
_CROSSINGS: Final = 2
_DEPENDENT: Final = 1e-6
_GOLDEN: Final = 0.5 * (np.sqrt(5.0) - 1.0)
_INNER: Final = 2.0 * _GOLDEN - 1.0
"""Of a polish: how far it looks, in standard errors, at first and at last; rounds at most; the part of the fitness that
one must gain for the next to look as far; golden sections of a line; steps back to the floor; the part of a column that
must be its own; the ratio of the sections, and where on a line from -1 to 1 the first two points are."""


def polished(problem: Problem, best: Fit, reach: float = _REACH) -> Fit:
    """Return the local minimum near a fit, where descents in all parameters at once end early.

    Two parameters that are much alike, as a skew and a lag, make a long, bent trough. It is followed by a search along
    each direction in which the data determine the parameters well or badly, as far as they leave them uncertain, with
    steps back to the floor in the directions that are determined better. reach: how far, in standard errors.
    """
    for _ in range(_ROUNDS if problem.low.size else 0):
        if reach < _NEAREST:
            break
        before, directions = best.fitness, reach * _weak_directions(problem, best)
        for at, direction in enumerate(directions):
            best = _lowest_along(problem, best, direction, directions[:at])
        best = min(best, descend(problem, best.nonlinear), key=lambda fit: fit.fitness)
        reach *= 1.0 if before - best.fitness > _POLISHED * before else 0.25
    return best


def _weak_directions(problem: Problem, best: Fit) -> Array:
    """The directions (k, q), the best determined first, each one standard error of independent residuals long."""
    columns, _ = problem.linearised(best)
    count = problem.low.size
    linear, jacobian = columns[:, :-count], columns[:, -count:]
    alone = jacobian - linear @ np.linalg.lstsq(linear, jacobian, rcond=None)[0]
    size = np.linalg.norm(alone, axis=0)
    free = np.flatnonzero(size > _DEPENDENT * np.linalg.norm(jacobian, axis=0))
    found = np.zeros((len(free), count))
    if free.size:
        _, strengths, directions = np.linalg.svd(alone[:, free] / size[free], full_matrices=False)
        found[:, free] = directions / strengths[:, None].clip(_DEPENDENT) / size[free]
    return best.fitness * found


def _lowest_along(problem: Problem, best: Fit, direction: Array, across: Array) -> Fit:
    """Return the lowest fit seen on a way through another one, which is searched by golden sections."""

    def beside(part: float, near: Fit) -> Fit:
        return _floor(problem, start + part * direction, near, across)

    start, low, high = best.nonlinear, -1.0, 1.0
    left, right = beside(-_INNER, best), beside(_INNER, best)
    for _ in range(_SECTIONS):
        if left.fitness < right.fitness:
            high, right = low + _GOLDEN * (high - low), left
            left = beside(high - _GOLDEN * (high - low), right)
        else:
            low, left = high - _GOLDEN * (high - low), right
            right = beside(low + _GOLDEN * (high - low), left)
        best = min(best, left, right, key=lambda fit: fit.fitness)
    return best


def _floor(problem: Problem, nonlinear: Array, near: Fit, across: Array) -> Fit:
    """Return the fit after a few Gauss-Newton steps from nonlinear parameters (q,), in directions `across` (k, q)."""
    best = problem.solve(np.clip(nonlinear, problem.low, problem.high), near)
    for _ in range(_CROSSINGS if len(across) else 0):
        columns, target = problem.linearised(best)
        linear, jacobian = columns[:, : -len(nonlinear)], columns[:, -len(nonlinear) :]
        known = np.concatenate([best.optimum.genes, np.zeros(len(across))])
        table = np.concatenate([linear, jacobian @ across.T], axis=1)
        step = (
            least_absolute_deviations(table, target - jacobian @ best.nonlinear, known).genes[-len(across) :] @ across
        )
        tried = problem.solve(np.clip(best.nonlinear + step, problem.low, problem.high), best)
        if tried.fitness >= best.fitness:
            break
        best = tried
    return best
