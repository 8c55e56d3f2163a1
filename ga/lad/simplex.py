"""The simplex descent behind ga.lad.exact: from vertex to vertex of sum |torque - rows . z| - pull . z, always
downhill.

Rows are of full column rank and roughly orthonormal, r <= 8 or so. They are stored column by column in arrays (r, n),
because a processor computes several neighbours at once. At a vertex r independent rows, the basis, have a residual of
zero. Each step removes one row from the basis and follows the edge to the lowest point on the edge, a weighted median
of the n points at which a residual changes sign (Bloomfield and Steiger 1983, Barrodale and Roberts 1973).
"""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_no_refcount, compiled_within

Vector: TypeAlias = NDArray[np.float64]
Matrix: TypeAlias = NDArray[np.float64]
Basis: TypeAlias = NDArray[np.int64]

OPTIMAL: Final = 0
STALLED: Final = 1
"""The result of a descent with many steps of zero length in a row: more residuals than those of a basis are zero.
Perturb the torque.
"""
UNBOUNDED: Final = 2
"""The result of a descent in which the pull is stronger than all rows together: there are too few rows."""

_MOST: Final = 1000
"""The largest number of steps, of which tens are usual: with nearly collinear columns, rounding can make the steps go
in circles.
"""

_SLACK: Final = 1e-11
"""The amount by which rounding may make a multiplier exceed 1."""

_SPARSE: Final = 8
"""The step between rows that are examined first; they show how far along the ray the other rows must be examined."""

_FLAT: Final = 1e-13
"""The change along the ray below which a row is treated as constant, for rows of the order 1. It is multiplied by the
length of the direction, because rounding grows with this length if the rows of the basis are nearly dependent.
"""


class Room(NamedTuple):
    """Working space of a descent over n rows of r columns: vectors (n,) and (r,), a matrix (r, r).

    weight (n,): at first the sign of each residual, later the weight of each point at which a residual changes sign.
    """

    residual: Vector
    along: Vector
    place: Vector
    weight: Vector
    row: Basis
    point: Vector
    direction: Vector
    downhill: Vector
    inverse: Matrix


def room_for(n: int, r: int) -> Room:
    """Return working space for n rows of r columns."""
    residual, along, place, weight = np.empty((4, n))
    point, direction, downhill = np.zeros((3, r))
    return Room(
        residual=residual,
        along=along,
        place=place,
        weight=weight,
        row=np.empty(n, np.int64),
        point=point,
        direction=direction,
        downhill=downhill,
        inverse=np.empty((r, r)),
    )


def descend(rows: Matrix, torque: Vector, pull: Vector, start: Vector) -> tuple[int, Basis]:
    """Find the optimal basis (r,) of rows (r, n) from the point start (r,). pull (r,): the linear term of the sum.

    Returns OPTIMAL, STALLED or UNBOUNDED, and the basis, which is valid only with OPTIMAL.
    """
    basis = np.zeros(len(rows), np.int64)
    return step_down(rows, torque, pull, start, basis, room_for(len(torque), len(rows))), basis


@compiled_no_refcount
def step_down(  # noqa: PLR0917 - compiled functions take their parts by position
    rows: Matrix, torque: Vector, pull: Vector, start: Vector, basis: Basis, room: Room
) -> int:
    """Fill in the optimal basis (r,), beginning with r artificial rows that have no residual at the start.

    The artificial rows are the unit vectors, have the number -1 and no weight in the sum: they leave the basis first,
    one by one, until the first vertex is reached.
    """
    r, short_steps = basis.size, 0
    for i in range(r):
        basis[i], room.point[i] = -1, start[i]
        for k in range(r):
            room.inverse[i, k] = 1.0 if i == k else 0.0
    for _ in range(_MOST):
        _residuals(rows, torque, room.point, room.residual)
        for i in range(r):
            if basis[i] >= 0:
                room.residual[basis[i]] = np.nan  # neither sign: the row is in the basis
        _gradient(rows, room.residual, room.weight, pull, room.downhill)
        leaving, slope = _leave(basis, room)
        if leaving < 0:
            return OPTIMAL
        _project(rows, room.direction, room.along)
        length = _length(room.direction)
        entering, step = lowest_crossing(room, slope, length)
        if entering < 0:
            return UNBOUNDED
        is_short = basis[leaving] >= 0 and step * length < 1e-13 * (1.0 + _length(room.point))
        short_steps = short_steps + 1 if is_short else 0
        basis[leaving] = entering
        if short_steps >= 4 * r + 8 or not _exchange(rows, torque, start, basis, leaving, room):
            return STALLED
    return STALLED


@compiled_within
def _exchange(rows: Matrix, torque: Vector, start: Vector, basis: Basis, new: int, room: Room) -> bool:  # noqa: PLR0917 - compiled functions take their parts by position
    """Update the inverse of the basis, whose row with the index `new` is another one now, and move to the point where
    the residuals of its rows are zero; return False if the rows are dependent.
    """
    r, inverse, point, entered = basis.size, room.inverse, room.point, basis[new]
    pivot = 0.0
    for k in range(r):
        pivot += rows[k, entered] * inverse[k, new]
    if not abs(pivot) > 0.0:
        return False
    for k in range(r):
        inverse[k, new] /= pivot
    for j in range(r):
        part = 0.0
        for k in range(r):
            part += rows[k, entered] * inverse[k, j]
        for k in range(r):
            inverse[k, j] -= part * inverse[k, new] if j != new else 0.0
    for k in range(r):
        point[k] = 0.0
        for j in range(r):
            point[k] += inverse[k, j] * (torque[basis[j]] if basis[j] >= 0 else start[j])
    return True


@compiled_within
def _leave(basis: Basis, room: Room) -> tuple[int, float]:
    """Choose the basis row whose edge goes down most steeply, and set the direction along the edge.

    Returns the row's index in the basis, and how fast the sum falls along the edge; -1 if no edge goes down. The
    multipliers of the basis rows make the subgradient zero; the vertex is optimal if all are within -1 ... 1. If the
    basis has artificial rows, whose multipliers should be zero, an artificial row leaves in any case.
    """
    inverse, downhill, direction, r = room.inverse, room.downhill, room.direction, basis.size
    best, steepest, slope, sign, allowed = -1, 0.0, 0.0, 1.0, 1.0
    for j in range(r):
        if basis[j] < 0:
            steepest, allowed = -1.0, 0.0
    for j in range(r):
        multiplier = square = 0.0
        for k in range(r):
            multiplier -= inverse[k, j] * downhill[k]
            square += inverse[k, j] * inverse[k, j]
        excess, length = abs(multiplier) - allowed, np.sqrt(square)
        may_leave = basis[j] < 0 if allowed == 0.0 else excess > _SLACK
        if may_leave and excess > steepest * length:
            best, steepest, slope, sign = j, excess / length, excess, -1.0 if multiplier > 0.0 else 1.0
    if best >= 0:
        for k in range(r):
            direction[k] = sign * inverse[k, best]
    return best, slope


@compiled_within
def _length(vector: Vector) -> float:
    total = 0.0
    for k in range(vector.size):
        total += vector[k] * vector[k]
    return float(np.sqrt(total))


@compiled_within
def _residuals(rows: Matrix, torque: Vector, point: Vector, residual: Vector) -> None:
    for i in range(torque.size):
        residual[i] = torque[i]
    for k in range(point.size):
        _add(-point[k], rows[k], residual)


@compiled_within
def _project(rows: Matrix, direction: Vector, along: Vector) -> None:
    for i in range(along.size):
        along[i] = 0.0
    for k in range(direction.size):
        _add(direction[k], rows[k], along)


@compiled_no_refcount
def _add(factor: float, column: Vector, total: Vector) -> None:
    """Add a column (n,), multiplied by a factor, to a total (n,)."""
    for i in range(total.size):
        total[i] += factor * column[i]


@compiled_within
def _gradient(rows: Matrix, residual: Vector, sign: Vector, pull: Vector, downhill: Vector) -> None:
    """Fill in the direction of descent: the sum of the rows, multiplied by the signs of their residuals (n,), plus the
    pull.

    sign (n,): overwritten by the signs. Two columns are summed at a time, because a processor computes two sums in the
    time of one; the last of an odd number of columns is summed twice.
    """
    for i in range(residual.size):
        # a residual of zero counts as just above it, here and on the ray; one of the basis, NaN, has no sign
        sign[i] = 1.0 if residual[i] >= 0.0 else -1.0 if residual[i] < 0.0 else 0.0
    for k in range(0, pull.size, 2):
        following = k + 1 if k + 1 < pull.size else k
        one, other = pull[k], pull[following]
        for i in range(residual.size):
            one += sign[i] * rows[k, i]
            other += sign[i] * rows[following, i]
        downhill[k], downhill[following] = one, other


@compiled_within
def lowest_crossing(room: Room, slope: float, length: float) -> tuple[int, float]:
    """Return the row that changes sign at the lowest point on the ray, and the distance of that point; (-1, 0) if there
    is none.

    The residuals (n,) are those at the start of the ray, along (n,) their rates of fall along it. slope: the rate at
    which the sum falls at the start. length: the length of the direction. The slope flattens by 2 |along| where a row
    changes sign, so the lowest point is a weighted median. It is found by quickselect, O(n), among the rows that change
    sign no later than the weighted median of every eighth row.
    """
    residual, along, row, place, weight = room.residual, room.along, room.row, room.place, room.weight
    count, first, farthest = 0, 0, np.inf
    flat = _FLAT * (length if length > 1.0 else 1.0)
    # where some of the rows have flattened the slope, all of them have: that settles most rows at a glance
    for stride in (_SPARSE, 1):
        count = first = 0
        for i in range(0, residual.size, stride):
            # every row is written, and the next one over it unless it counts: to guess which do costs more
            falling = along[i] if residual[i] >= 0.0 else -along[i]
            row[count], place[count], weight[count] = i, abs(residual[i]) / falling, falling
            count += 1 if (falling > flat) & (abs(residual[i]) / falling <= farthest) else 0
        last, left = count - 1, 0.5 * slope
        while first < last:
            less, more, below, equal = _partition(room, first, last)
            if less > first and below >= left:
                last = less - 1
            elif below + equal >= left or more > last:
                first, last, left = less, less, left - below
            else:
                left -= below + equal
                first = more
        if count and weight[first] >= left:
            farthest = place[first]
    return (row[first], place[first]) if count else (-1, 0.0)


@compiled_within
def _partition(room: Room, first: int, last: int) -> tuple[int, int, float, float]:
    """Sort the points from `first` to `last` into those less than, equal to and greater than the median of three of
    them.

    Returns where the equal and where the greater points begin, and the total weights of the lesser and of the equal
    points.
    """
    row, place, weight = room.row, room.place, room.weight
    a, pivot, c = place[first], place[(first + last) // 2], place[last]
    if (a - pivot) * (c - a) >= 0.0:
        pivot = a
    elif (c - pivot) * (a - c) >= 0.0:
        pivot = c
    less, more, i = first, last + 1, first
    below = equal = 0.0
    while i < more:
        if place[i] == pivot:
            equal += weight[i]
            i += 1
            continue
        other = less
        if place[i] < pivot:
            below += weight[i]
            less += 1
        else:
            more -= 1
            other = more
        row[i], row[other] = row[other], row[i]
        place[i], place[other] = place[other], place[i]
        weight[i], weight[other] = weight[other], weight[i]
        if other < more:
            i += 1
    return less, more, below, equal
