"""Arrange the rows of a cell tree in groups of similar rows, and these in larger groups: most signs are decided for a
whole group.

Rows are similar if their residuals at the origin and their columns are: then their residuals are similar everywhere
nearby. All rows of a group have the same sign throughout a cell if the mean of their residuals is further from zero
than any of them can be from that mean. The cost of growing a cell then depends on the boundary between the signs, and
little on the number of rows. The idea is that of a ball tree (Omohundro 1989).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from ga.compiled import compiled, compiled_no_refcount

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Vector = NDArray[np.float64]
    Matrix = NDArray[np.float64]
    Whole = NDArray[np.int64]

FAN: Final = 8
"""The number of groups in a larger group, and of rows in a smallest group."""

FIRST_PART, PARTS, FIRST_ROW, END_ROW = range(4)
"""Columns of `contents`; see `group`."""

_LEVELS: Final = 64  # ranges that wait to be divided: one a level


def arranged(residuals: Vector, along: Matrix) -> Whole:
    """Return an order (n,) of the rows in which similar rows are neighbours, so that `group` can use ranges of rows as
    groups.

    residuals (n,): N m, at the origin. along (n, p): the columns in the coordinates of the cells, of mean square one.
    The mean residual is the unit of the residuals, because a fit is searched in cells of that size.
    """
    size = float(np.mean(np.abs(residuals))) or 1.0
    points = np.column_stack([residuals / size, along, np.arange(len(along), dtype=np.float64)])
    sort(points, np.empty((_LEVELS, 2), np.int64))
    return points[:, -1].astype(np.int64)


def group(rows: Matrix, backward: Matrix) -> tuple[Matrix, NDArray[np.int32]]:
    """Return the groups of arranged rows (n, p + 2) of a tree; each group follows its parts, and the last group has all
    rows.

    Rows are numbered from 0, groups from n on. The first result, values (m, 2 p + 4), has for each group the sum of the
    rows, the largest deviations from the group's mean of the residual at the origin and of the columns in the
    coordinates of the cells, and the smallest and the largest speed. The second result, contents (m, 4), has the first
    part and the number of parts, the first row and the row after the last.
    """
    n, p = len(rows), rows.shape[1] - 2
    counts = [-(-n // FAN)]
    while counts[-1] > 1:
        counts.append(-(-counts[-1] // FAN))
    contents = np.empty((sum(counts), 4), np.int32)
    first, below, below_at, reach = 0, n, 0, FAN
    for count in counts:
        number, level = np.arange(count), contents[first : first + count]
        level[:, FIRST_PART] = below_at + number * FAN
        level[:, PARTS] = np.minimum(FAN, below - number * FAN)
        level[:, FIRST_ROW], level[:, END_ROW] = number * reach, np.minimum(number * reach + reach, n)
        first, below, below_at, reach = first + count, count, n + first, reach * FAN
    values = np.zeros((len(contents), 2 * p + 4))
    measure(rows, backward, contents, values)
    return values, contents


@compiled_no_refcount
def sort(points: Matrix, waiting: Whole) -> None:
    """Order points (n, d + 1) by repeatedly halving them along the direction in which they are longest.

    The last number of a point is only carried along. Ranges are cut at multiples of a power of FAN, so that every group
    is a range. waiting: working space.
    """
    waiting[0, 0], waiting[0, 1], left = 0, len(points), 1
    while left > 0:
        left -= 1
        begin, end = waiting[left, 0], waiting[left, 1]
        unit = FAN
        while unit * FAN < end - begin:
            unit *= FAN
        blocks = (end - begin + unit - 1) // unit
        if blocks < 2:
            continue
        middle = begin + unit * (blocks // 2)
        _part(points, begin, end, middle, _longest(points, begin, end))
        waiting[left, 0], waiting[left, 1] = begin, middle
        waiting[left + 1, 0], waiting[left + 1, 1] = middle, end
        left += 2


@compiled_no_refcount
def _longest(points: Matrix, begin: int, end: int) -> int:
    """Return the direction in which the points from `begin` to `end` are furthest apart."""
    longest, found = -1.0, 0
    for k in range(points.shape[1] - 1):
        low = high = points[begin, k]
        for i in range(begin, end):
            low, high = min(low, points[i, k]), max(high, points[i, k])
        if high - low > longest:
            longest, found = high - low, k
    return found


@compiled_no_refcount
def _part(points: Matrix, begin: int, end: int, middle: int, k: int) -> None:
    """Bring the points with the smallest coordinate k among those from `begin` to `end` before `middle` (Hoare
    1961).
    """
    low, high = begin, end - 1
    while low < high:
        pivot, i, j = points[(low + high) // 2, k], low, high
        while i <= j:
            while points[i, k] < pivot:
                i += 1
            while points[j, k] > pivot:
                j -= 1
            if i <= j:
                for m in range(points.shape[1]):
                    points[i, m], points[j, m] = points[j, m], points[i, m]
                i += 1
                j -= 1
        if j < middle:
            low = i
        if i > middle:
            high = j


@compiled
def measure(rows: Matrix, backward: Matrix, contents: NDArray[np.int32], values: Matrix) -> None:
    """Fill in the `values` (m, 2 p + 4) of groups from their `contents` (m, 4), as `group` returns both."""
    n, p = rows.shape[0], rows.shape[1] - 2
    mean = np.empty(p + 1)
    for g in range(len(contents)):
        value, at, size = values[g], contents[g, FIRST_PART], contents[g, END_ROW] - contents[g, FIRST_ROW]
        for part in range(at, at + contents[g, PARTS]):
            for k in range(p + 1):
                value[k] += rows[part, k] if part < n else values[part - n, k]
        for k in range(p + 1):
            mean[k] = value[k] / size
        value[2 * p + 2] = np.inf
        for i in range(contents[g, FIRST_ROW], contents[g, END_ROW]):
            value[p + 1] = max(value[p + 1], abs(rows[i, 0] - mean[0]))
            for k in range(p):
                off = 0.0
                for j in range(p):
                    off += (rows[i, j + 1] - mean[j + 1]) * backward[j, k]
                value[p + 2 + k] = max(value[p + 2 + k], abs(off))
            value[2 * p + 2] = min(value[2 * p + 2], rows[i, p + 1])
            value[2 * p + 3] = max(value[2 * p + 3], rows[i, p + 1])
