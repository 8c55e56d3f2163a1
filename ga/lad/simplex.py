"""The simplex descent behind ga.lad.exact: vertex to vertex of sum |torque - rows . z| - pull . z, always downhill.

Rows are of full column rank and roughly orthonormal, r <= 8 or so. They stand column by column in arrays (r, n), as
a processor computes several neighbours at once. A vertex is where r independent rows, the basis, have no residual. Each
step removes one of them and follows the edge to the lowest point on it, a weighted median of the n places where a
residual changes sign (Bloomfield and Steiger 1983, Barrodale and Roberts 1973).
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
"""Many steps of no length one after another: more residuals than a basis vanish together. Perturb the torque."""
UNBOUNDED: Final = 2
"""The pull is stronger than all rows together: they are too few."""

_MOST: Final = 1000
"""Steps, of which tens are usual: columns that are all but collinear can lead in circles by rounding."""

_SLACK: Final = 1e-11
"""How far beyond 1 a multiplier may be by rounding."""

_SPARSE: Final = 8
"""One row in so many shows up to where on a ray the others need be looked at."""

_FLAT: Final = 1e-13
"""A row that changes along the ray by no more than this, where rows are of the order 1, does not change; times the
length of the direction, to which rounding grows where the rows of the basis are nearly dependent."""


class Room(NamedTuple):
    """Working space of a descent over n rows of r columns: vectors (n,) and (r,), matrices (r, r).

    weight (n,) is that of each place, and before it the sign of each residual.
    """

    residual: Vector
    along: Vector
    place: Vector
    weight: Vector
    row: Basis
    point: Vector
    direction: Vector
    downhill: Vector
    multiplier: Vector
    inverse: Matrix
    met: Matrix


def room_for(n: int, r: int) -> Room:
    """Return working space for n rows of r columns."""
    residual, along, place, weight = np.empty((4, n))
    point, direction, downhill, multiplier = np.zeros((4, r))
    return Room(
        residual=residual,
        along=along,
        place=place,
        weight=weight,
        row=np.empty(n, np.int64),
        point=point,
        direction=direction,
        downhill=downhill,
        multiplier=multiplier,
        inverse=np.empty((r, r)),
        met=np.zeros((r, r)),
    )


def descend(rows: Matrix, torque: Vector, pull: Vector, start: Vector) -> tuple[int, Basis]:
    """Find the optimal basis (r,) of rows (r, n) from the point start (r,).

    Returns OPTIMAL, STALLED or UNBOUNDED, and the basis, which is of no use unless it is OPTIMAL.
    """
    basis = np.zeros(len(rows), np.int64)
    return step_down(rows, torque, pull, start, basis, room_for(len(torque), len(rows))), basis


@compiled_no_refcount
def step_down(  # noqa: PLR0917 - compiled functions take their parts by position
    rows: Matrix, torque: Vector, pull: Vector, start: Vector, basis: Basis, room: Room
) -> int:
    """Do what `descend` does: downhill along rays until r rows are met, the first vertex, then from vertex to vertex.

    One loop for both, because what it calls is compiled once more for every place that it is called from.
    """
    r, short_steps = basis.size, 0
    met: int = np.int64(0)  # type: ignore[assignment]  # for a plain 0 what it is passed to is compiled once more
    for k in range(r):
        room.point[k] = start[k]
    for _ in range(_MOST):
        if met == r and (short_steps >= 4 * r + 8 or not _to_vertex(rows, torque, basis, room)):
            return STALLED
        _residuals(rows, torque, room.point, room.residual)
        for i in range(met):
            room.residual[basis[i]] = np.nan  # neither sign: the row is in the basis
        _gradient(rows, room.residual, room.weight, pull, room.downhill)
        leaving, slope = met, 0.0
        if met < r:
            slope = _free_direction(room.met, met, room.downhill, room.direction)
        else:
            leaving = _leave(room)
            if leaving < 0:
                return OPTIMAL
            slope = abs(room.multiplier[leaving]) - 1.0
        _project(rows, room.direction, room.along)
        entering, step = lowest_crossing(room, slope)
        if entering < 0:
            return UNBOUNDED
        basis[leaving] = entering
        if met < r:
            _meet(rows, entering, met, step, room)
            met += 1
        else:
            is_short = step * _length(room.direction) < 1e-13 * (1.0 + _length(room.point))
            short_steps = short_steps + 1 if is_short else 0
    return STALLED


@compiled_within
def _to_vertex(rows: Matrix, torque: Vector, basis: Basis, room: Room) -> bool:
    """Invert the rows of the basis and go to where they have no residual; False where they are dependent."""
    r, inverse = basis.size, room.inverse
    for i in range(r):
        for k in range(r):
            room.met[i, k] = rows[k, basis[i]]
            inverse[i, k] = 1.0 if i == k else 0.0
    if not invert(room.met, inverse):
        return False
    for k in range(r):
        room.point[k] = 0.0
        for j in range(r):
            room.point[k] += inverse[k, j] * torque[basis[j]]
    return True


@compiled_within
def invert(left: Matrix, inverse: Matrix) -> bool:
    """Apply to `inverse` what makes `left` the identity (Gauss and Jordan, pivoted); False if it is singular."""
    r = len(left)
    for k in range(r):
        pivot = k
        for i in range(k + 1, r):
            if abs(left[i, k]) > abs(left[pivot, k]):
                pivot = i
        size = left[pivot, k]
        if not abs(size) > 0.0:
            return False
        for j in range(r):
            left[pivot, j], left[k, j] = left[k, j], left[pivot, j] / size
            inverse[pivot, j], inverse[k, j] = inverse[k, j], inverse[pivot, j] / size
        for i in range(r):
            part = 0.0 if i == k else left[i, k]
            for j in range(r):
                left[i, j] -= part * left[k, j]
                inverse[i, j] -= part * inverse[k, j]
    return True


@compiled_within
def _leave(room: Room) -> int:
    """Choose the basis row whose edge goes down most steeply, and set the direction along it; -1 where none does.

    Its multiplier makes the subgradient zero; the vertex is optimal where all are within -1 ... 1.
    """
    best, steepest, r = -1, 0.0, room.point.size
    for j in range(r):
        multiplier = length = 0.0
        for k in range(r):
            multiplier -= room.inverse[k, j] * room.downhill[k]
            length += room.inverse[k, j] * room.inverse[k, j]
        room.multiplier[j] = multiplier
        excess = abs(multiplier) - 1.0
        if excess > _SLACK and excess > steepest * np.sqrt(length):
            best, steepest = j, excess / np.sqrt(length)
    if best >= 0:
        sign = -1.0 if room.multiplier[best] > 0.0 else 1.0
        for k in range(r):
            room.direction[k] = sign * room.inverse[k, best]
    return best


@compiled_within
def _meet(rows: Matrix, entering: int, count: int, step: float, room: Room) -> None:
    """Go to where the entering row has no residual, and keep it so: its unit normal joins the rows met."""
    for k in range(room.point.size):
        room.point[k] += step * room.direction[k]
        room.met[count, k] = rows[k, entering]
    normal = room.met[count]
    _remove(room.met, count, normal)
    size = _length(normal)
    for k in range(normal.size):
        normal[k] /= size


@compiled_within
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
    """Add a column (n,) so many times to a total (n,)."""
    for i in range(total.size):
        total[i] += factor * column[i]


@compiled_within
def _gradient(rows: Matrix, residual: Vector, sign: Vector, pull: Vector, downhill: Vector) -> None:
    """The direction of descent: the sum of rows by the sign of their residual (n,), written over, and the pull.

    Two columns at a time, because a processor adds two sums up in the time of one; the last of an odd number twice.
    """
    for i in range(residual.size):
        # a residual of zero counts as just above it, here and on the ray; one of the basis, NaN, has no sign
        sign[i] = 1.0 if residual[i] >= 0.0 else -1.0 if residual[i] < 0.0 else 0.0
    for k in range(0, pull.size, 2):
        following = min(k + 1, pull.size - 1)
        one, other = pull[k], pull[following]
        for i in range(residual.size):
            one += sign[i] * rows[k, i]
            other += sign[i] * rows[following, i]
        downhill[k], downhill[following] = one, other


@compiled_within
def lowest_crossing(room: Room, slope: float) -> tuple[int, float]:
    """Where on the ray the sum is lowest: the row that changes sign there, and how far it is; (-1, 0) if nowhere.

    residual (n,) at the start; along (n,) how fast each falls; slope: how fast the sum falls at the start. The slope
    flattens by 2 |along| at each row's change of sign, so the place is a weighted median: quickselect, O(n), among the
    rows that change no later than where some of them alone have it.
    """
    residual, along, row, place, weight = room.residual, room.along, room.row, room.place, room.weight
    count, first, farthest = 0, 0, np.inf
    flat = _FLAT * max(1.0, _length(room.direction))
    # where some of the rows have flattened the slope, all of them have: that settles most rows at a glance
    for stride in (_SPARSE, 1):
        count = first = 0
        for i in range(0, residual.size, stride):
            # every row is written, and the next one over it unless it counts: to guess which do costs more
            falling = along[i] if residual[i] >= 0.0 else -along[i]
            row[count], place[count], weight[count] = i, abs(residual[i]) / falling, falling
            count += int((falling > flat) & (abs(residual[i]) / falling <= farthest))
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
    """Sort the places from first to last into those less than, equal to and more than the median of three of them.

    Returns where the equal ones and where the greater ones begin, and the weights of the lesser and the equal ones.
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
