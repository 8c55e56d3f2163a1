"""Find the start of a search: a cube around the least-squares solution that almost surely contains the optimum.

The centre of the cube is the least-squares solution, moved towards the least absolute error by two steps of iterated
weights (Schlossmacher 1973). In coordinates in which the columns are orthogonal, half the cube's width is four standard
errors of the optimum plus the length of the last step. The standard error is 1/(2 f sqrt(n)) with the density f of the
residuals at zero (Koenker 2005, section 3.2), which is estimated from the fraction of small residuals. The standard
error is assumed to be at least that of normal residuals: pi/2 of their mean size over sqrt(n).

The search only begins in the cube, and may then go anywhere within its bounds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.samples import LANES, RESOLUTION, in_lanes

if TYPE_CHECKING:
    from ga.bounds import Bounds

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_AT_ONCE: Final = 64
"""Rows of 128 lanes that are computed at a time: the working space stays in the processor's cache."""

_ERRORS: Final = 4.0
"""Half the cube's width in standard errors."""

_NEAR: Final = 5.0
"""The limit up to which a residual is small, in multiples of the smallest size used in the weights: half of the mean
residual.
"""

_FEWEST: Final = 0.02
"""The smallest fraction of small residuals that is used: a fraction of zero would make the cube infinite."""

_PIVOT: Final = 1e-10
"""The fraction of a column's squared length, independent of the other columns, below which the column is treated as a
combination of these.
"""

_SMOOTH: Final = 0.1
"""The smallest size of a residual that is used in the weights, as a fraction of the root mean square residual."""


class Start(NamedTuple):
    """The region in which a search begins: the cube |forward (genes - centre)| <= reach in every coordinate.

    centre (p,): SI. forward and backward (p, p): upper triangular, each the inverse of the other; the columns times
    `backward` are orthogonal, of mean square 1. reach: half the cube's width, N m.
    """

    centre: Vector
    forward: Matrix
    backward: Matrix
    reach: float


def start_of(columns: Matrix, torque: Vector, bounds: Bounds) -> Start | None:
    """Return the cube for columns (n, p) and torque (n,), N m.

    None if the data are not finite or do not determine all parameters, and if the cube does not fit into the bounds:
    its centre must be inside, and the cube must be smaller than the bounds.
    """
    p = columns.shape[1]
    work = _Work(np.zeros(p), *(np.zeros((p, p)) for _ in range(3)), *(np.zeros(p) for _ in range(2)))
    with np.errstate(all="ignore"):  # data that are not finite
        reach = _locate(columns, torque, work)
    if not 0.0 < reach < np.inf:
        return None
    return within(Start(work.centre, work.forward, work.backward, reach), bounds)


class _Work(NamedTuple):
    """Working space for a start: its centre and coordinates, and the normal equations gram (p, p) step (p,) = pull
    (p,).
    """

    centre: Vector
    forward: Matrix
    backward: Matrix
    gram: Matrix
    pull: Vector
    step: Vector


def within(start: Start, bounds: Bounds) -> Start | None:
    """Return the start if its centre is inside the bounds and its cube is smaller than the bounds; else None."""
    extent = start.reach * np.abs(start.backward).sum(axis=1)
    inside = bool(np.all((start.centre > bounds.low) & (start.centre < bounds.high)))
    return start if inside and bool(np.all(2.0 * extent <= bounds.high - bounds.low)) else None


def _locate(columns: Matrix, torque: Vector, work: _Work) -> float:
    """Fill in centre and coordinates of the start; return half the cube's width, 0 if there is no start."""
    n, p = columns.shape
    rows = in_lanes(torque, *columns.T)
    size, power, _ = _equations(rows, work, np.inf)
    if not _factor(work, n) or not _solve(work):
        return 0.0
    for k in range(p):
        power -= work.pull[k] * work.pull[k] / work.gram[k, k]  # what is left of the elimination
        work.centre[k] = work.step[k]
    least = RESOLUTION * size / n
    smooth = max(_SMOOTH * np.sqrt(max(power, 0.0) / n), least, 1e-300)
    moved = error = 0.0
    for _ in range(2):
        total, _, near = _equations(rows, work, smooth)
        error = max(0.5 * np.pi * total / n, _NEAR * smooth / max((near - rows[0].size + n) / n, _FEWEST)) / np.sqrt(n)
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


def _equations(rows: NDArray[np.float64], work: _Work, smooth: float) -> tuple[float, float, int]:
    """Fill in the normal equations of the residuals at the centre, each row weighted by one over its residual's size.

    rows (p + 1, m, 128): torque and columns in lanes. smooth: the smallest size used in the weights, N m; infinite for
    equal weights. Returns the sum of the sizes, N m, the sum of their squares, and the number of small residuals, with
    the rows that fill the lanes up.
    """
    p, near = len(work.centre), 0
    upper = [(j, k) for k in range(p) for j in range(k + 1)]
    terms = np.empty((len(upper) + p + 2, min(_AT_ONCE, rows.shape[1]), LANES))
    total = np.zeros((len(terms), LANES))
    for begin in range(0, rows.shape[1], _AT_ONCE):
        torque, *columns = rows[:, begin : begin + _AT_ONCE]
        part = terms[:, : len(torque)]
        left = torque.copy()
        for gene, column in zip(work.centre, columns, strict=True):
            left -= gene * column
        size = np.abs(left, out=part[-2])
        np.multiply(size, size, out=part[-1])
        weight = np.ones_like(size) if smooth == np.inf else 1.0 / np.maximum(size, smooth)
        for k, column in enumerate(columns):
            weighted = weight * column
            np.multiply(weighted, left, out=part[len(upper) + k])
            for j in range(k + 1):
                np.multiply(columns[j], weighted, out=part[upper.index((j, k))])
        total += part.sum(axis=1)
        near += int(np.count_nonzero(size <= _NEAR * smooth))
    # added one after another: the same to the last bit on every machine
    *sums, absolute, power = total.cumsum(axis=1)[:, -1].tolist()
    for (j, k), value in zip(upper, sums, strict=False):
        work.gram[j, k] = value
    work.pull[:] = sums[len(upper) :]
    return absolute, power, near


def _factor(work: _Work, count: int) -> bool:
    """Fill in the Cholesky factor of gram / count, and the inverse of this factor; False if a column depends on
    others.
    """
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
    """Solve the normal equations in place, by elimination; return False if a column is a combination of others."""
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
