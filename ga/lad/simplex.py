"""The simplex descent behind ga.lad.exact: vertex to vertex of sum |torque - rows . z| - pull . z, always downhill.

Rows (n, r) are of full column rank and roughly orthonormal, r <= 8 or so. A vertex is where r independent rows, the
basis, have no residual. Each step removes one of them and follows the edge to the lowest point on it, a weighted
median of the n places where a residual changes sign (Bloomfield and Steiger 1983, Barrodale and Roberts 1973).
"""

from __future__ import annotations

from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled, compiled_no_refcount

Vector: TypeAlias = NDArray[np.float64]
Matrix: TypeAlias = NDArray[np.float64]
Basis: TypeAlias = NDArray[np.int64]

OPTIMAL: Final = 0
STALLED: Final = 1
"""Many steps of no length one after another: more residuals than a basis vanish together. Perturb the torque."""
UNBOUNDED: Final = 2
"""The pull is stronger than all rows together: they are too few."""

_MOST: Final = 1000
"""Steps, of which tens are usual: columns that are all but collinear can lead in circles by rounding."""

_SLACK: Final = 1e-11
"""How far beyond 1 a multiplier may be by rounding."""

_FLAT: Final = 1e-13
"""A row that changes along the ray by no more than this, where rows are of the order 1, does not change."""


@compiled
def descend(rows: Matrix, torque: Vector, pull: Vector, start: Vector, basis: Basis) -> int:
    """Find the optimal basis (r,), written to `basis`, from the point start (r,).

    Returns OPTIMAL, STALLED or UNBOUNDED. Raises LinAlgError where rows of a basis are not independent.
    """
    n, r = rows.shape
    residual, along = np.empty(n), np.empty(n)
    if not _first_vertex(rows, torque, pull, start, basis):
        return UNBOUNDED
    point, direction, downhill, multiplier = np.empty(r), np.empty(r), np.empty(r), np.empty(r)
    short_steps = 0
    for _ in range(_MOST):
        if short_steps >= 4 * r + 8:
            break
        inverse: Matrix = np.linalg.inv(rows[basis])  # type: ignore[assignment]  # numba keeps the 64 bits
        _solve(inverse, torque, basis, point)
        _residuals(rows, torque, point, residual)
        for b in basis:
            residual[b] = np.nan  # neither sign: the row is in the basis
        _gradient(rows, residual, pull, downhill)
        _multipliers(inverse, downhill, multiplier)
        leaving = _steepest(multiplier, inverse)
        if leaving < 0:
            return OPTIMAL
        sign = -1.0 if multiplier[leaving] > 0.0 else 1.0
        for k in range(r):
            direction[k] = sign * inverse[k, leaving]
        _project(rows, direction, along)
        entering, step = lowest_crossing(residual, along, abs(multiplier[leaving]) - 1.0)
        if entering < 0:
            return UNBOUNDED
        basis[leaving] = entering
        short_steps = short_steps + 1 if step * _length(direction) < 1e-13 * (1.0 + _length(point)) else 0
    return STALLED


@compiled
def product(rows: Matrix, matrix: Matrix) -> Matrix:
    """rows (n, p) times matrix (p, r), in one thread: for so few columns a linear-algebra library's threads cost more
    than they bring, and on a busy machine many times more.
    """
    result = np.zeros((rows.shape[0], matrix.shape[1]))
    for i in range(rows.shape[0]):
        for k in range(rows.shape[1]):
            for j in range(matrix.shape[1]):
                result[i, j] += rows[i, k] * matrix[k, j]
    return result


@compiled
def weighted_sum(rows: Matrix, weights: Vector) -> Vector:
    """The sum (p,) of rows (n, p), each times its weight (n,), in one thread."""
    result = np.zeros(rows.shape[1])
    for i in range(rows.shape[0]):
        for k in range(rows.shape[1]):
            result[k] += weights[i] * rows[i, k]
    return result


@compiled
def _first_vertex(rows: Matrix, torque: Vector, pull: Vector, start: Vector, basis: Basis) -> bool:
    """Go downhill from any point, keeping the residual of each row that is met at zero, until r rows make a vertex."""
    n, r = rows.shape
    residual, along = np.empty(n), np.empty(n)
    met, point, direction, downhill = np.zeros((r, r)), np.empty(r), np.empty(r), np.empty(r)
    for k in range(r):
        point[k] = start[k]
    for count in range(r):
        _residuals(rows, torque, point, residual)
        for i in range(count):
            residual[basis[i]] = np.nan
        _gradient(rows, residual, pull, downhill)
        slope = _free_direction(met, count, downhill, direction)
        _project(rows, direction, along)
        entering, step = lowest_crossing(residual, along, slope)
        if entering < 0:
            return False
        basis[count] = entering
        for k in range(r):
            point[k] += step * direction[k]
            met[count, k] = rows[entering, k]
        _orthonormalise(met, count)
    return True


@compiled_no_refcount
def _free_direction(met: Matrix, count: int, downhill: Vector, direction: Vector) -> float:
    """The steepest direction, a unit vector, in which the rows met do not change; returns how steep it is.

    Where none goes down, any that is free.
    """
    r = direction.size
    for k in range(r):
        direction[k] = downhill[k]
    least = 1e-9 * _length(downhill)
    _remove(met, count, direction)
    axis = 0
    while not _length(direction) > least:
        least = 1e-3  # of r axes, one at least has more than that outside the span of fewer than r rows
        for k in range(r):
            direction[k] = 1.0 if k == axis else 0.0
        _remove(met, count, direction)
        axis += 1
    size, slope = _length(direction), 0.0
    for k in range(r):
        direction[k] /= size
        slope += downhill[k] * direction[k]
    if slope < 0.0:
        for k in range(r):
            direction[k] = -direction[k]
    return abs(slope)


@compiled_no_refcount
def _remove(met: Matrix, count: int, vector: Vector) -> None:
    """Take out of the vector, twice for rounding's sake, what lies along the first `count` unit rows."""
    for _ in range(2):
        for i in range(count):
            part = 0.0
            for k in range(vector.size):
                part += met[i, k] * vector[k]
            for k in range(vector.size):
                vector[k] -= part * met[i, k]


@compiled_no_refcount
def _orthonormalise(met: Matrix, last: int) -> None:
    _remove(met, last, met[last])
    size = _length(met[last])
    for k in range(met.shape[1]):
        met[last, k] /= size


@compiled_no_refcount
def _length(vector: Vector) -> float:
    total = 0.0
    for k in range(vector.size):
        total += vector[k] * vector[k]
    return float(np.sqrt(total))


@compiled_no_refcount
def _residuals(rows: Matrix, torque: Vector, point: Vector, residual: Vector) -> None:
    for i in range(torque.size):
        value = torque[i]
        for k in range(point.size):
            value -= rows[i, k] * point[k]
        residual[i] = value


@compiled_no_refcount
def _project(rows: Matrix, direction: Vector, along: Vector) -> None:
    for i in range(along.size):
        value = 0.0
        for k in range(direction.size):
            value += rows[i, k] * direction[k]
        along[i] = value


@compiled_no_refcount
def _gradient(rows: Matrix, residual: Vector, pull: Vector, downhill: Vector) -> None:
    """The direction of descent: the sum of rows by the sign of their residual, and the pull."""
    for k in range(pull.size):
        downhill[k] = pull[k]
    for i in range(residual.size):
        # a residual of zero counts as just above it, here and on the ray; one of the basis, NaN, has no sign
        sign = 1.0 if residual[i] >= 0.0 else -1.0 if residual[i] < 0.0 else 0.0
        for k in range(pull.size):
            downhill[k] += sign * rows[i, k]


@compiled_no_refcount
def _multipliers(inverse: Matrix, downhill: Vector, multiplier: Vector) -> None:
    """Compute the multiplier of each basis row for a zero subgradient; optimal where all are within -1 ... 1."""
    for j in range(multiplier.size):
        multiplier[j] = 0.0
        for k in range(downhill.size):
            multiplier[j] -= inverse[k, j] * downhill[k]


@compiled_no_refcount
def _steepest(multiplier: Vector, inverse: Matrix) -> int:
    """The basis row whose edge goes down most steeply, -1 where none does."""
    best, steepest = -1, 0.0
    for j in range(multiplier.size):
        excess = abs(multiplier[j]) - 1.0
        if excess <= _SLACK:
            continue
        slope = excess / _length(inverse[:, j])
        if slope > steepest:
            best, steepest = j, slope
    return best


@compiled_no_refcount
def _solve(inverse: Matrix, torque: Vector, basis: Basis, point: Vector) -> None:
    for k in range(point.size):
        point[k] = 0.0
        for j in range(basis.size):
            point[k] += inverse[k, j] * torque[basis[j]]


@compiled
def lowest_crossing(residual: Vector, along: Vector, slope: float) -> tuple[int, float]:
    """Where on the ray the sum is lowest: the row that changes sign there, and how far it is; (-1, 0) if nowhere.

    residual (n,) at the start; along (n,) how fast each falls; slope: how fast the sum falls at the start. The slope
    flattens by 2 |along| at each row's change of sign, so the place is a weighted median: quickselect, O(n).
    """
    row, place, weight = np.empty(residual.size, np.int64), np.empty(residual.size), np.empty(residual.size)
    count = 0
    for i in range(residual.size):
        if (residual[i] >= 0.0 and along[i] > _FLAT) or (residual[i] < 0.0 and along[i] < -_FLAT):
            row[count], place[count], weight[count] = i, residual[i] / along[i], abs(along[i])
            count += 1
    first, last, left = 0, count - 1, 0.5 * slope
    while first < last:
        pivot = _median_of_three(place[first], place[(first + last) // 2], place[last])
        part = slice(first, last + 1)
        less, more, below, equal = _partition(row[part], place[part], weight[part], pivot)
        less, more = first + less, first + more
        if less > first and below >= left:
            last = less - 1
        elif below + equal >= left or more > last:
            first = last = less
        else:
            left -= below + equal
            first = more
    return (row[first], place[first]) if count else (-1, 0.0)


@compiled_no_refcount
def _partition(row: Basis, place: Vector, weight: Vector, pivot: float) -> tuple[int, int, float, float]:
    """Sort the rows by their place into less than, equal to and more than the pivot.

    Returns where the equal ones and where the greater ones begin, and the weights of the lesser and the equal ones.
    """
    less, more, i = 0, place.size, 0
    below = equal = 0.0
    while i < more:
        if place[i] < pivot:
            below += weight[i]
            _swap(row, place, weight, i, less)
            less += 1
            i += 1
        elif place[i] > pivot:
            more -= 1
            _swap(row, place, weight, i, more)
        else:
            equal += weight[i]
            i += 1
    return less, more, below, equal


@compiled_no_refcount
def _swap(row: Basis, place: Vector, weight: Vector, i: int, j: int) -> None:
    row[i], row[j] = row[j], row[i]
    place[i], place[j] = place[j], place[i]
    weight[i], weight[j] = weight[j], weight[i]


@compiled_no_refcount
def _median_of_three(a: float, b: float, c: float) -> float:
    return max(min(a, b), min(max(a, b), c))
