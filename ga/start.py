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

from ga.compiled import compiled_as, compiled_too, compiled_when_worth, compiled_within
from ga.samples import AT_ONCE, LANES, RESOLUTION, carry, in_lanes, in_order, load_block

if TYPE_CHECKING:
    from ga.bounds import Bounds

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

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

_SOME: Final = 128
_PART: Final = 16
"""The first estimates use about `_SOME` blocks of rows, or one block in `_PART` if that is more."""

_GOLDEN: Final = 0.6180339887498949
"""Multiples of it are spread evenly over the fractions of one, and do not repeat."""

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
    columns, torque = (np.require(array, np.float64, ["C", "W"]) for array in (columns, torque))  # as is compiled for
    work = _work_for(p)
    with np.errstate(all="ignore"):  # data that are not finite
        reach = locate(columns, torque, *_some_of(columns, torque), work)
    if not 0.0 < reach < np.inf:
        return None
    return within(Start(work.centre, work.forward, work.backward, reach), bounds)


def _some_of(columns: Matrix, torque: Vector) -> tuple[Matrix, Vector]:
    """Return the rows from which the first estimates are computed: of many rows a part, one block out of every few.

    The blocks are at irregular distances, because a fixed stride could beat with a periodic excitation.
    """
    blocks = len(torque) // LANES
    step = blocks // max(_SOME, blocks // _PART, 1)
    if step < 2:
        return columns, torque
    first = np.arange(blocks // step)
    drawn = first * step + (step * (first * _GOLDEN % 1.0)).astype(np.int64)
    some = [array[: blocks * LANES].reshape(blocks, -1)[drawn] for array in (columns, torque)]
    return some[0].reshape(-1, columns.shape[1]), some[1].reshape(-1)


class _Work(NamedTuple):
    """Working space for a start: its centre and coordinates, the normal equations gram (p, p) step (p,) = pull (p,),
    and in lanes the columns, the residuals and the weights of a block (p + 2, 128), the sums of some blocks and of all
    (terms, 128).
    """

    centre: Vector
    forward: Matrix
    backward: Matrix
    gram: Matrix
    pull: Vector
    step: Vector
    block: Matrix
    part: Matrix
    total: Matrix


def _work_for(p: int) -> _Work:
    terms = p * (p + 1) // 2 + p + 2
    shapes = ((p,), (p, p), (p, p), (p, p), (p,), (p,), (p + 2, LANES), (terms, LANES), (terms, LANES))
    return _Work(*(np.zeros(shape) for shape in shapes))


def within(start: Start, bounds: Bounds) -> Start | None:
    """Return the start if its centre is inside the bounds and its cube is smaller than the bounds; else None."""
    extent = start.reach * np.abs(start.backward).sum(axis=1)
    inside = bool(np.all((start.centre > bounds.low) & (start.centre < bounds.high)))
    return start if inside and bool(np.all(2.0 * extent <= bounds.high - bounds.low)) else None


@compiled_when_worth
def locate(columns: Matrix, torque: Vector, some_columns: Matrix, some_torque: Vector, work: _Work) -> float:
    """Fill in centre and coordinates of the start; return half the cube's width, 0 if there is no start."""
    n, p = some_columns.shape
    size, power, _ = _equations(some_columns, some_torque, work, np.inf)
    if not _factor(work, n) or not _solve(work):
        return 0.0
    for k in range(p):
        power -= work.pull[k] * work.pull[k] / work.gram[k, k]  # what is left of the elimination
        work.centre[k] = work.step[k]
    least = RESOLUTION * size / n
    smooth = max(_SMOOTH * np.sqrt(max(power, 0.0) / n), least, 1e-300)
    moved = error = 0.0
    for last in range(2):
        if last:
            n, some_columns, some_torque = len(torque), columns, torque
        total, _, near = _equations(some_columns, some_torque, work, smooth)
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

    smooth: the smallest size used in the weights, N m; infinite for equal weights. Returns the sum of the sizes, N m,
    the sum of their squares, and the number of small residuals.
    """
    p, near = len(work.centre), 0
    upper = [(j, k) for k in range(p) for j in range(k + 1)]
    total = work.total
    total[:] = 0.0
    for begin in range(0, len(torque), AT_ONCE):
        measured, *rows = in_lanes(torque[begin : begin + AT_ONCE], *columns[begin : begin + AT_ONCE].T)
        left, terms = measured, np.empty((len(total), *measured.shape))
        for gene, column in zip(work.centre, rows, strict=True):
            left -= gene * column
        size = np.abs(left, out=terms[-2])
        np.multiply(size, size, out=terms[-1])
        weight = np.ones_like(size) if smooth == np.inf else 1.0 / np.maximum(size, smooth)
        for k, column in enumerate(rows):
            weighted = weight * column
            np.multiply(weighted, left, out=terms[len(upper) + k])
            for j in range(k + 1):
                np.multiply(rows[j], weighted, out=terms[upper.index((j, k))])
        total += terms.sum(axis=1)
        near += int(np.count_nonzero(size.ravel()[: len(torque) - begin] <= _NEAR * smooth))
    return (*_fold(work), near)


@compiled_as(_equations)
def _equations_compiled(columns: Matrix, torque: Vector, work: _Work, smooth: float) -> tuple[float, float, int]:
    """Do the same, to the last bit."""
    n, near = len(torque), 0
    work.total[:] = 0.0
    work.part[:] = 0.0
    for begin in range(0, n, LANES):
        end = min(begin + LANES, n)
        load_block(columns[begin:end], torque[begin:end], work.centre, work.block)
        near += _weigh(end - begin, smooth, work)
        _multiply(work)
        if end % AT_ONCE == 0 or end == n:
            carry(work.part, work.total)
    size, power = _fold(work)
    return size, power, near


@compiled_within
def _weigh(count: int, smooth: float, work: _Work) -> int:
    """Fill in the weights of a block of `count` rows, add the residuals' sizes, and return how many are small."""
    left, weight, sizes, powers = work.block[-2], work.block[-1], work.part[-2], work.part[-1]
    for i in range(LANES):
        size = abs(left[i])
        sizes[i] += size
        powers[i] += size * size
        weight[i] = 1.0 if smooth == np.inf else 1.0 / (smooth if size <= smooth else size)
    near = 0
    for i in range(count):
        near += abs(left[i]) <= _NEAR * smooth
    return near


@compiled_within
def _multiply(work: _Work) -> None:
    """Add the products of a block's columns and residuals."""
    p, weight, left, t = work.centre.size, work.block[-1], work.block[-2], 0
    for k in range(p):
        column = work.block[k]
        for j in range(k + 1):
            before, sums = work.block[j], work.part[t]
            for i in range(LANES):
                sums[i] += before[i] * (weight[i] * column[i])
            t += 1
    for k in range(p):
        column, sums = work.block[k], work.part[t + k]
        for i in range(LANES):
            sums[i] += weight[i] * column[i] * left[i]


@compiled_too
def _fold(work: _Work) -> tuple[float, float]:
    """Fill in the normal equations from the sums in lanes; return the sum of the sizes, N m, and of their squares."""
    p, t = work.centre.size, 0
    for k in range(p):
        for j in range(k + 1):
            work.gram[j, k] = in_order(work.total[t])
            t += 1
    for k in range(p):
        work.pull[k] = in_order(work.total[t + k])
    return in_order(work.total[t + p]), in_order(work.total[t + p + 1])


@compiled_too
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


@compiled_too
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
