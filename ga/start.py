"""Where a search may begin: a cube around the least-squares solution that all but surely holds the optimum.

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

from ga.compiled import compiled
from ga.dense import RESOLUTION

if TYPE_CHECKING:
    from ga.space import Bounds

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
    centre, forward, backward = np.zeros(p), np.zeros((p, p)), np.zeros((p, p))
    reach = _locate(columns, torque, centre, forward, backward)
    if not 0.0 < reach < np.inf:
        return None
    return within(Start(centre, forward, backward, reach), bounds)


def within(start: Start, bounds: Bounds) -> Start | None:
    """The start, if its centre is inside the bounds and it is smaller than they are."""
    extent = start.reach * np.abs(start.backward).sum(axis=1)
    inside = bool(np.all((start.centre > bounds.low) & (start.centre < bounds.high)))
    return start if inside and bool(np.all(2.0 * extent <= bounds.high - bounds.low)) else None


@compiled
def _locate(columns: Matrix, torque: Vector, centre: Vector, forward: Matrix, backward: Matrix) -> float:
    """Fill in centre and coordinates; returns the reach, 0 where there is none."""
    n, p = columns.shape
    gram, pull, step = np.empty((p, p)), np.empty(p), np.empty(p)
    size, power = _normal_equations(columns, torque, gram, pull)
    if not _factor(gram, n, forward, backward):
        return 0.0
    _solve(gram, pull, centre)
    for k in range(p):
        power -= pull[k] * centre[k]
    least = RESOLUTION * size / n
    smooth = max(_SMOOTH * np.sqrt(max(power, 0.0) / n), least, 1e-300)
    moved = error = 0.0
    for _ in range(2):
        total, near = _weighted_equations(columns, torque, centre, smooth, gram, pull)
        mean = total / n
        error = max(0.5 * np.pi * mean, _NEAR * smooth / max(near / n, _FEWEST)) / np.sqrt(n)
        if not _solve(gram, pull, step):
            return 0.0
        smooth, moved = max(_SMOOTH * mean, least, 1e-300), 0.0
        for k in range(p):
            along = 0.0
            for j in range(k, p):
                along += forward[k, j] * step[j]
            moved = max(moved, abs(along))
        for k in range(p):
            centre[k] += step[k]
    return max(_ERRORS * error + moved, least)  # type: ignore[no-any-return]  # float in numba


@compiled
def _normal_equations(columns: Matrix, torque: Vector, gram: Matrix, pull: Vector) -> tuple[float, float]:
    """Sums of x x' and of x times torque; returns those of |torque| and of its square."""
    n, p = columns.shape
    gram[:], pull[:] = 0.0, 0.0
    size = power = 0.0
    if p == 2:  # the paper's model, in registers
        aa = ab = bb = ta = tb = 0.0
        for i in range(n):
            a, b, t = columns[i, 0], columns[i, 1], torque[i]
            aa, ab, bb = aa + a * a, ab + a * b, bb + b * b
            ta, tb = ta + t * a, tb + t * b
            size, power = size + abs(t), power + t * t
        gram[0, 0], gram[0, 1], gram[1, 0], gram[1, 1] = aa, ab, ab, bb
        pull[0], pull[1] = ta, tb
        return size, power
    for i in range(n):
        t = torque[i]
        size, power = size + abs(t), power + t * t
        _add_row(columns[i], 1.0, t, gram, pull)
    _mirror(gram)
    return size, power


@compiled
def _weighted_equations(  # noqa: PLR0917 - compiled functions take their parts by position
    columns: Matrix, torque: Vector, centre: Vector, smooth: float, gram: Matrix, pull: Vector
) -> tuple[float, int]:
    """The same sums of the residuals, each divided by the residual's size; returns the sum of the sizes.

    And how many residuals are small.
    """
    n, p = columns.shape
    gram[:], pull[:] = 0.0, 0.0
    total, near = 0.0, 0
    if p == 2:
        aa = ab = bb = ta = tb = 0.0
        for i in range(n):
            a, b = columns[i, 0], columns[i, 1]
            left = torque[i] - a * centre[0] - b * centre[1]
            total += abs(left)
            near += abs(left) <= _NEAR * smooth
            weight = 1.0 / max(abs(left), smooth)
            left *= weight
            aa, ab, bb = aa + weight * a * a, ab + weight * a * b, bb + weight * b * b
            ta, tb = ta + left * a, tb + left * b
        gram[0, 0], gram[0, 1], gram[1, 0], gram[1, 1] = aa, ab, ab, bb
        pull[0], pull[1] = ta, tb
        return total, near
    for i in range(n):
        left = torque[i]
        for k in range(p):
            left -= columns[i, k] * centre[k]
        total += abs(left)
        near += abs(left) <= _NEAR * smooth
        _add_row(columns[i], 1.0 / max(abs(left), smooth), left, gram, pull)
    _mirror(gram)
    return total, near


@compiled
def _add_row(row: Vector, weight: float, target: float, gram: Matrix, pull: Vector) -> None:
    for k in range(row.size):
        weighted = weight * row[k]
        pull[k] += weighted * target
        for j in range(k + 1):
            gram[k, j] += weighted * row[j]


@compiled
def _mirror(gram: Matrix) -> None:
    for k in range(len(gram)):
        for j in range(k):
            gram[j, k] = gram[k, j]


@compiled
def _factor(gram: Matrix, count: int, forward: Matrix, backward: Matrix) -> bool:
    """The triangle whose square is gram / count, and its inverse; False where a column is a combination of others."""
    p = len(gram)
    forward[:], backward[:] = 0.0, 0.0
    for k in range(p):
        left = gram[k, k]
        for i in range(k):
            left -= count * forward[i, k] ** 2
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


@compiled
def _solve(gram: Matrix, pull: Vector, found: Vector) -> bool:
    """The solution of gram found = pull."""
    p = len(gram)
    triangle, inverse = np.empty((p, p)), np.empty((p, p))
    if not _factor(gram, 1, triangle, inverse):
        return False
    for k in range(p):
        found[k] = 0.0
        for j in range(k, p):
            along = 0.0
            for i in range(j + 1):
                along += inverse[i, j] * pull[i]
            found[k] += inverse[k, j] * along
    return True
