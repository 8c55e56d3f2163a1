"""The start of a search: a cube around the least-squares solution that almost surely holds the optimum.

The least-squares solution of the data, moved towards the least absolute error by two steps of iterated weights
(Schlossmacher 1973), is its centre. Its half-width is four standard errors of the estimator that is sought, and as much
as the last step still moved, in coordinates in which the columns are orthogonal. The standard error is 1/(2 f sqrt(n))
for a density f of the residuals at zero (Koenker 2005, section 3.2), which is read off the share of small ones; it is
never taken to be less than what normal residuals have, pi/2 of their mean size over sqrt(n).

It is a place to begin at and no more: a search that begins there may go anywhere within its bounds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.samples import RESOLUTION

if TYPE_CHECKING:
    from ga.bounds import Bounds

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_ERRORS: Final = 4.0
"""Standard errors of half the cube's width."""

_NEAR: Final = 5.0
"""Residuals that count as small, in those that are taken to be of one size: half of the mean."""

_FEWEST: Final = 0.02
"""The least share of small residuals that is believed: without any, the cube would have no end."""

_PIVOT: Final = 1e-10
"""A column of which only this part, squared, is its own is taken to be a combination of others."""

_SMOOTH: Final = 0.1
"""Residuals below this part of the root mean square weigh no more than one of that size."""


class Start(NamedTuple):
    """The cube |forward (genes - centre)| <= reach in every coordinate.

    centre (p,), SI. forward and backward (p, p), upper triangular and each other's inverse: the columns times
    `backward` are orthogonal, of mean square 1. reach: N m.
    """

    centre: Vector
    forward: Matrix
    backward: Matrix
    reach: float


def start_of(columns: Matrix, torque: Vector, bounds: Bounds) -> Start | None:
    """The cube for columns (n, p) and torque (n,), N m.

    None where the data do not determine all parameters, or it would not lie well within the bounds: its centre must be
    inside, and it must be smaller than they are. Data that are not finite give None, too.
    """
    p = columns.shape[1]
    work = _Work(np.zeros(p), *(np.zeros((p, p)) for _ in range(3)), *(np.zeros(p) for _ in range(2)))
    with np.errstate(all="ignore"):  # data that are not finite
        reach = _locate(columns, torque, work)
    if not 0.0 < reach < np.inf:
        return None
    return within(Start(work.centre, work.forward, work.backward, reach), bounds)


class _Work(NamedTuple):
    """The start in the making, and working space for the normal equations gram (p, p) step (p,) = pull (p,)."""

    centre: Vector
    forward: Matrix
    backward: Matrix
    gram: Matrix
    pull: Vector
    step: Vector


def within(start: Start, bounds: Bounds) -> Start | None:
    """The start, if its centre is inside the bounds and it is smaller than they are."""
    extent = start.reach * np.abs(start.backward).sum(axis=1)
    inside = bool(np.all((start.centre > bounds.low) & (start.centre < bounds.high)))
    return start if inside and bool(np.all(2.0 * extent <= bounds.high - bounds.low)) else None


def _locate(columns: Matrix, torque: Vector, work: _Work) -> float:
    """Fill in centre and coordinates; returns the reach, 0 where there is none."""
    n, p = columns.shape
    size, power, _ = _equations(columns, torque, work, np.inf)
    if not _factor(work, n) or not _solve(work):
        return 0.0
    for k in range(p):
        power -= work.pull[k] * work.pull[k] / work.gram[k, k]  # what is left of the elimination
        work.centre[k] = work.step[k]
    least = RESOLUTION * size / n
    smooth = max(_SMOOTH * np.sqrt(max(power, 0.0) / n), least, 1e-300)
    moved = error = 0.0
    for _ in range(2):
        total, _, near = _equations(columns, torque, work, smooth)
        error = max(0.5 * np.pi * total / n, _NEAR * smooth / max(near / n, _FEWEST)) / np.sqrt(n)
        if not _solve(work):
            return 0.0
        smooth, moved = max(_SMOOTH * total / n, least, 1e-300), 0.0
        for k in range(p):
            along = 0.0
            for j in range(k, p):
                along += work.forward[k, j] * work.step[j]
            moved = max(moved, abs(along))
        for k in range(p):
            work.centre[k] += work.step[k]
    return float(max(_ERRORS * error + moved, least))


def _equations(columns: Matrix, torque: Vector, work: _Work, smooth: float) -> tuple[float, float, int]:
    """Fill in the normal equations of the residuals at the centre, each row weighted by one over its residual's size.

    smooth: the least size that counts, infinite for equal weights. Returns the sum of the sizes, N m, that of their
    squares, and how many are small.
    """
    left = torque.copy()
    for k, column in enumerate(columns.T):
        left -= column * work.centre[k]
    size = np.abs(left)
    weight = np.ones(len(left)) if smooth == np.inf else 1.0 / np.maximum(size, smooth)
    for k, column in enumerate(columns.T):
        weighted = weight * column
        work.pull[k] = _sum(weighted * left)
        for j in range(k + 1):
            work.gram[j, k] = _sum(weighted * columns[:, j])
    return _sum(size), _sum(size * size), int(np.count_nonzero(size <= _NEAR * smooth))


def _sum(terms: Vector) -> float:
    """Return the sum of terms (n,), added one after another: the same to the last bit on every machine."""
    return float(np.cumsum(terms)[-1])


def _factor(work: _Work, count: int) -> bool:
    """The triangle whose square is gram / count, and its inverse; False where a column is a combination of others."""
    gram, forward, backward = work.gram, work.forward, work.backward
    p = len(gram)
    for k in range(p):
        left = gram[k, k]
        for i in range(k):
            left -= count * (forward[i, k] * forward[i, k])
        if not left > _PIVOT * gram[k, k]:  # nor where it is not a number
            return False
        forward[k, k] = np.sqrt(left / count)
        for j in range(k + 1, p):
            left = gram[k, j] / count
            for i in range(k):
                left -= forward[i, k] * forward[i, j]
            forward[k, j] = left / forward[k, k]
    for j in range(p):
        backward[j, j] = 1.0 / forward[j, j]
        for k in range(j - 1, -1, -1):
            along = 0.0
            for i in range(k + 1, j + 1):
                along += forward[k, i] * backward[i, j]
            backward[k, j] = -along / forward[k, k]
    return True


def _solve(work: _Work) -> bool:
    """Solve the normal equations by elimination in place; False where a column is a combination of others."""
    gram, pull, step = work.gram, work.pull, work.step
    p = len(gram)
    for k in range(p):
        step[k] = gram[k, k]  # while pivots are judged by it
    for k in range(p):
        if not gram[k, k] > _PIVOT * step[k]:  # nor where it is not a number
            return False
        for j in range(k + 1, p):
            part = gram[k, j] / gram[k, k]
            for i in range(j, p):
                gram[j, i] -= part * gram[k, i]
            pull[j] -= part * pull[k]
    for k in range(p - 1, -1, -1):
        step[k] = pull[k] / gram[k, k]
        for j in range(k + 1, p):
            step[k] -= gram[k, j] / gram[k, k] * step[j]
    return True
