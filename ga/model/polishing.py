"""The last stage of a fit of nonlinear parameters: a search along the directions in which descents end too early."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from ga.lad.exact import not_negative
from ga.model.separable import descend

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from ga.model.separable import Fit, Problem

    Array = NDArray[np.float64]

_REACH: Final = 12.0
_NARROWER: Final = 0.25
_NEAREST: Final = 0.5
_ROUNDS: Final = 12
_POLISHED: Final = 1e-5
_PLACES: Final = 10
_CLOSE: Final = 0.01
_DEPENDENT: Final = 1e-6
"""The settings of the search in `polished`.

_REACH: the distance of the search at first, in standard errors. _NARROWER: the factor of this distance after a round,
unless the minimum lies at an end of the searched range and the round has lowered the fitness by more than the fraction
_POLISHED. _NEAREST: the distance, in standard errors, at which the search ends. _ROUNDS: the largest number of rounds.
_PLACES: the largest number of points on a line. _CLOSE: the smallest distance of these points, in standard errors.
_DEPENDENT: the fraction of a column that must be independent of the others.
"""


def polished(problem: Problem, best: Fit, reach: float = _REACH) -> Fit:
    """Return the local minimum near a fit, for parameters in which descents end too early.

    Two nearly collinear parameters, such as a skew and a lag, make a long, bent trough of the fitness. The search
    follows the trough along each direction, from well to badly determined ones, as far as the data leave that direction
    uncertain, with steps back to the floor of the trough in the better determined directions. reach: the distance of
    the search, in standard errors.
    """
    for _ in range(_ROUNDS if problem.low.size else 0):
        if reach < _NEAREST:
            break
        before, outside, directions = best.fitness, False, _weak_directions(problem, best)
        for at, direction in enumerate(directions):
            best, is_end = _lowest_along(problem, best, direction, directions[:at], reach)
            outside |= is_end
        best = min(best, descend(problem, best.nonlinear), key=lambda fit: fit.fitness)
        reach *= 1.0 if outside and before - best.fitness > _POLISHED * before else _NARROWER
    return best


def _weak_directions(problem: Problem, best: Fit) -> Array:
    """Return the directions (k, q), best determined first, each one standard error of independent residuals long. best:
    the fit.
    """
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


def _lowest_along(problem: Problem, best: Fit, direction: Array, across: Array, reach: float) -> tuple[Fit, bool]:
    """Return the lowest fit found along a direction, and whether that fit lies at an end of the searched range.

    across: better determined directions, in which each point is improved. reach: half the searched range, in standard
    errors. Each next point is the minimum of the parabola through the lowest point so far and its neighbours.
    """
    start, seen = best.nonlinear, {0.0: best}
    tried = [-reach, reach]
    while tried:
        for part in tried:
            near = seen[min(seen, key=lambda other: abs(other - part))]
            seen[part] = _floor(problem, start + part * direction, near, across)
        lowest = min(seen, key=lambda part: seen[part].fitness)
        tried = [] if len(seen) >= _PLACES else _next_places(seen, lowest)
    return seen[lowest], abs(lowest) == reach


def _next_places(seen: Mapping[float, Fit], lowest: float) -> list[float]:
    """Return the next points to try; [] if the lowest point is at an end or close to points already tried. seen: the
    fit at each point.
    """
    parts = sorted(seen)
    at = parts.index(lowest)
    if at in (0, len(parts) - 1):
        return []
    left, right = lowest - parts[at - 1], parts[at + 1] - lowest
    rise, fall = (seen[parts[k]].fitness - seen[lowest].fitness for k in (at - 1, at + 1))
    bend = rise * right + fall * left
    place = lowest + 0.5 * (rise * right**2 - fall * left**2) / bend if bend > 0.0 else lowest
    return [place] if min(abs(place - part) for part in parts) > _CLOSE else []


def _floor(problem: Problem, nonlinear: Array, near: Fit, across: Array) -> Fit:
    """Return the fit after a Gauss-Newton step from nonlinear parameters (q,), in the directions `across` (k, q).

    If no optimum can be proven after the step, the fit before the step is returned; if none can be proven there either,
    the fit `near`, so that the search continues.
    """
    best = near
    try:
        best = problem.solve(np.clip(nonlinear, problem.low, problem.high), near)
        return min(best, _stepped(problem, best, across), key=lambda fit: fit.fitness) if len(across) else best
    except RuntimeError:  # columns that are too nearly collinear
        return best


def _stepped(problem: Problem, best: Fit, across: Array) -> Fit:
    """Return the fit `best` after a Gauss-Newton step in the directions `across` (k, q)."""
    columns, target = problem.linearised(best)
    count = len(best.nonlinear)
    linear, jacobian = columns[:, :-count], columns[:, -count:]
    known = np.concatenate([best.optimum.genes, np.zeros(len(across))])
    table = np.concatenate([linear, jacobian @ across.T], axis=1)
    target = target - jacobian @ best.nonlinear
    step = not_negative(table, target, problem.positive, known).genes[-len(across) :] @ across
    return problem.solve(np.clip(best.nonlinear + step, problem.low, problem.high), best)
