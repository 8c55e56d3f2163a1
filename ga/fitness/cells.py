"""The cells of gene space that the sub-linear search divides: the coordinates in which they are cubes, and where they
are stored.

The cells are cubes of v = forward . (genes - origin). In these coordinates the model's columns are orthogonal, so that
no direction needs finer cells than another. `ga.fitness.splitting` grows the cells.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled
from ga.fitness.row_groups import arranged, group
from ga.samples import check, resolution

if TYPE_CHECKING:
    from ga.bounds import Bounds

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Whole = NDArray[np.int64]

LEAF: Final = 16
"""The number of undecided rows up to which a cell is not split further."""

LANES: Final = 8
"""The number of rows of a leaf that are summed in parallel."""

BITS: Final = 48
"""The binary digits of a coordinate in the root cube; with more digits, doubles are too coarse to separate two
sides.
"""

RECENT: Final = 8
"""The number of recently used leaves that are tried first."""

_FINEST: Final = 1e-6
"""The smallest weight of a direction, relative to the largest; collinear columns have a direction of zero weight."""

_LISTED: Final = 1 << 26
"""The number of undecided rows and groups for which memory is provided (256 MiB); the memory is larger only if
needed.
"""

_NODES: Final = 1 << 16

_WAITING: Final = 256  # groups: eight of each level

PARENT, CODE, SHIFT, START, COUNT, ROWS, KIND, CELL = range(8)
"""Columns of `nodes`. A cell's list of undecided rows and groups begins at START and has COUNT entries with ROWS rows
in all. From CELL on follow the p coordinates of the cell, in units of its own size.
"""

INNER, LEAVES, LIST = range(3)
"""Kinds of cells: INNER must be split; LEAVES has its rows copied to `leaves`; LIST is too small to split, and its rows
are in `undecided`.
"""

USED_NODES, USED_UNDECIDED, USED_LEAVES, NEXT_RECENT = range(4)
"""Entries of `used`: the numbers of used nodes, undecided entries and leaf blocks, and the next entry of `recent`."""


class Tree(NamedTuple):
    """The samples, and the cells grown so far. Only one thread at a time may use a tree; `another` makes a second tree
    over the same samples.

    rows (n, p + 2): the residual at the origin, the columns, and how fast the residual can change as v moves in the
    largest of its coordinates; similar rows are neighbours. groups (m, 2 p + 4) and contents (m, 4): groups of these
    rows, as `ga.fitness.row_groups.group` returns them. length: the number of samples that the mean is over. floor: the
    smallest divisor, N m, in relative comparisons of fitness. origin (p,), forward and its inverse backward (p, p): the
    change of coordinates. corner (p,) and width: the root cube. blur: the width by which cells overlap, because of
    rounding. The other fields are the cells' memory and working space.
    """

    rows: Matrix
    groups: Matrix
    contents: NDArray[np.int32]
    length: int
    floor: float
    origin: Vector
    forward: Matrix
    backward: Matrix
    corner: Vector
    width: float
    blur: float
    nodes: Whole
    sums: Matrix
    undecided: NDArray[np.int32]
    leaves: NDArray[np.float64]
    table: NDArray[np.int32]
    recent: Whole
    used: Whole
    place: Vector
    at: Whole
    total: Vector
    left: Vector
    centre: Vector
    middle: Vector
    carry: Vector
    part: Vector
    stack: Whole


def grow(columns: Matrix, torque: Vector, bounds: Bounds) -> Tree:
    """Return a tree with one cell, the root, for columns (n, p) and torque (n,), N m, within the bounds.

    For chromosomes outside the bounds every sample is computed. Raises ValueError if the data are not finite, not of
    equal length or empty.
    """
    check(columns, torque)
    origin = _near_solution(columns, torque)
    half = (bounds.high - bounds.low) / 2.0
    forward = _orthogonal_coordinates(columns, half)
    backward = np.asarray(np.linalg.inv(forward), dtype=np.float64)
    extent = 1.001 * float((np.abs(forward) @ half).max())
    centre = forward @ (bounds.low + half - origin)
    order = arranged(torque - columns @ origin, columns @ backward)
    rows = np.empty((len(torque), columns.shape[1] + 2))
    fill(columns, torque, origin, backward, order, rows)
    groups, contents = group(rows, backward)
    condition = float((np.abs(forward) @ np.abs(backward)).sum(axis=1).max())
    blur = 8.0 * float(np.finfo(np.float64).eps) * condition * (extent + float(np.abs(centre).max()))
    return Tree(
        rows=rows,
        groups=groups,
        contents=contents,
        length=len(torque),
        floor=resolution(torque),
        origin=origin,
        forward=forward,
        backward=backward,
        corner=centre - extent,
        width=2.0 * extent,
        blur=blur,
        **_space(*columns.shape),
    )


def another(tree: Tree) -> Tree:
    """Return a tree over the same samples for another thread."""
    return tree._replace(**_space(len(tree.rows), len(tree.origin)))


def _space(n: int, p: int) -> dict[str, Any]:
    """Return the memory and working space of a tree over n samples of p columns, with only the root cell."""
    nodes = np.zeros((_NODES, CELL + p), np.int64)
    nodes[0, SHIFT], nodes[0, START], nodes[0, COUNT], nodes[0, ROWS] = BITS, -1, 1, n  # a start of -1: the last group
    return {
        "nodes": nodes,
        "sums": np.zeros((_NODES, p + 1)),
        # a path holds n at most: each list is half as long as the one before; and there is room for one under way
        "undecided": np.empty(max(3 * n, min(max(60 * n, 1 << 19), _LISTED)), np.int32),
        "leaves": np.empty((_NODES * LEAF // LANES, p + 1, LANES)),
        "table": np.full(2 * _NODES, -1, np.int32),
        "recent": np.full(RECENT, -1),
        "used": np.array([1, 0, 0, 0]),
        "place": np.empty(p),
        "at": np.empty(p, np.int64),
        "total": np.empty(LANES),
        "left": np.empty(LANES),
        "centre": np.empty(p),
        "middle": np.empty(p),
        "carry": np.empty(p + 1),
        "part": np.empty(p + 1),
        "stack": np.empty(_WAITING, np.int64),
    }


def _near_solution(columns: Matrix, torque: Vector) -> Vector:
    """Return genes (p,) near the optimum. Residuals are stored relative to these genes, so that large sums do not
    cancel.

    The genes are rounded to single precision, so that libraries that differ in the last bits give the same genes.
    """
    scale = np.abs(columns).max(axis=0)
    scale[scale == 0.0] = 1.0
    found = np.linalg.lstsq(columns / scale, torque, rcond=1e-10)[0] / scale
    return np.asarray(found.astype(np.float32).astype(np.float64))


def _orthogonal_coordinates(columns: Matrix, half: Vector) -> Matrix:
    """Return the triangular matrix (p, p) to coordinates in which the columns are orthogonal, of mean square 1. half:
    half the bounds' width.

    The matrix is rounded to single precision: any similar matrix serves, but it must be equal on every machine.
    """
    p = columns.shape[1]
    live = np.flatnonzero(np.abs(columns).max(axis=0) > 0.0)
    matrix = np.zeros((p, p))
    if live.size:
        scale = np.abs(columns[:, live]).max(axis=0)
        triangle = np.linalg.qr(columns[:, live] / scale, mode="r") * scale / np.sqrt(len(columns))
        matrix[np.ix_(live[: len(triangle)], live)] = triangle
    weight = np.abs(matrix) @ half
    least = _FINEST * (float(weight.max()) or 1.0) / half
    diagonal = np.abs(np.diag(matrix))
    matrix[np.diag_indices(p)] = np.where(diagonal > least, np.diag(matrix), least)
    return np.asarray(matrix.astype(np.float32).astype(np.float64))


@compiled
def fill(  # noqa: PLR0917 - compiled functions take their parts by position
    columns: Matrix, torque: Vector, origin: Vector, backward: Matrix, order: Whole, rows: Matrix
) -> None:
    """Fill in the rows of a tree, in an order (n,). origin, backward: its change of coordinates."""
    n, p = columns.shape
    for i in range(n):
        column = columns[order[i]]
        residual, speed = torque[order[i]], 0.0
        for k in range(p):
            residual -= column[k] * origin[k]
            rows[i, k + 1] = column[k]
            along = 0.0
            for j in range(p):
                along += column[j] * backward[j, k]
            speed += abs(along)
        rows[i, 0], rows[i, p + 1] = residual, speed
