"""The sub-linear engine: a tree of cells, grown where the search looks, that knows the sign of most residuals.

The fitness is convex and piecewise linear. Inside a cell most residuals torque_i - columns_i . genes keep their sign
and collapse into p + 1 sums; only the undecided ones, whose zero plane crosses the cell, are looked at one by one. A
cell is split, 4^p ways at a time, until 16 or fewer are undecided, so a chromosome costs what its leaf costs, not n.

The cells are cubes of v = forward . (genes - origin), coordinates in which the columns are orthogonal, because in them
no direction needs finer cells than another. The numbers in a cell depend on the cell alone, never on the way the search
came: the tree is a cache of a pure function. It may be thrown away at any time, which is what bounds its memory, and
whoever asks gets the same bits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled, compiled_inline, compiled_no_refcount
from ga.fitness.dense import ROUNDING
from ga.samples import check, resolution

if TYPE_CHECKING:
    from ga.bounds import Bounds

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Whole = NDArray[np.int64]

_LEAF: Final = 16
"""Undecided rows up to which a cell is not split further."""

_LANES: Final = 8
"""Rows of a leaf summed side by side."""

_BITS: Final = 48
"""Binary digits of a place in the root cube; below, doubles are too coarse to separate two sides."""

_STEP: Final = 2
"""Binary digits that a cell is shorter than its parent, in each direction."""

_FINEST: Final = 1e-6
"""The least part of the largest direction's weight that a direction is given: collinear columns have one of none."""

_LISTED: Final = 1 << 25
"""Places for undecided rows, 128 MiB, beyond which no more are provided than are needed."""

_NODES: Final = 1 << 16
_RECENT: Final = 8

# columns of `nodes`; from _CELL on come the p coordinates of the cell in units of its own size
_PARENT, _CODE, _SHIFT, _START, _COUNT, _KIND, _CELL = range(7)
_INNER, _LEAVES, _LIST = range(
    3
)  # kinds: to be split; rows copied to `leaves`; too small to split, rows in `undecided`

# entries of `used`
_USED_NODES, _USED_UNDECIDED, _USED_LEAVES, _NEXT_RECENT = range(4)


class Tree(NamedTuple):
    """The data, and the cells grown so far. One thread at a time may use it; `another` makes one over the same data.

    rows: (n, p + 2), the residual at the origin, the columns, and how fast the residual can change as v moves in the
    largest of its coordinates. length: how many samples the mean is over. floor: N m, the least fitness that relative
    comparisons divide by. origin (p,), forward and backward (p, p), its inverse: the change of coordinates. corner (p,)
    and width: the root cube. blur: by how much cells overlap, against rounding.
    The rest is working space.
    """

    rows: Matrix
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
    carry: Vector


def grow(columns: Matrix, torque: Vector, bounds: Bounds) -> Tree:
    """A tree of one cell, the root, for columns (n, p) and torque (n,), N m, within the bounds.

    Outside them every sample is looked at. Raises ValueError as `check` does.
    """
    check(columns, torque)
    origin = _near_solution(columns, torque)
    half = (bounds.high - bounds.low) / 2.0
    forward = _orthogonal_coordinates(columns, half)
    backward = np.asarray(np.linalg.inv(forward), dtype=np.float64)
    extent = 1.001 * float((np.abs(forward) @ half).max())
    centre = forward @ (bounds.low + half - origin)
    rows = np.empty((len(torque), columns.shape[1] + 2))
    fill(columns, torque, origin, backward, rows)
    condition = float((np.abs(forward) @ np.abs(backward)).sum(axis=1).max())
    blur = 8.0 * float(np.finfo(np.float64).eps) * condition * (extent + float(np.abs(centre).max()))
    return _with_space(
        rows=rows,
        origin=origin,
        forward=forward,
        backward=backward,
        corner=centre - extent,
        width=2.0 * extent,
        blur=blur,
        floor=resolution(torque),
    )


def another(tree: Tree) -> Tree:
    """A tree over the same samples for another thread."""
    return _with_space(
        rows=tree.rows,
        origin=tree.origin,
        forward=tree.forward,
        backward=tree.backward,
        corner=tree.corner,
        width=tree.width,
        blur=tree.blur,
        floor=tree.floor,
    )


def _with_space(
    *,
    rows: Matrix,
    origin: Vector,
    forward: Matrix,
    backward: Matrix,
    corner: Vector,
    width: float,
    blur: float,
    floor: float,
) -> Tree:
    n, p = len(rows), len(origin)
    nodes = np.zeros((_NODES, _CELL + p), np.int64)
    nodes[0, _SHIFT], nodes[0, _START], nodes[0, _COUNT] = _BITS, -1, n  # a start of -1: all rows
    return Tree(
        rows=rows,
        length=n,
        floor=floor,
        origin=origin,
        forward=forward,
        backward=backward,
        corner=corner,
        width=width,
        blur=blur,
        nodes=nodes,
        sums=np.zeros((_NODES, p + 1)),
        # a path holds n at most: each list is half as long as the one before; and there is room for one under way
        undecided=np.empty(max(3 * n, min(max(20 * n, 1 << 19), _LISTED)), np.int32),
        leaves=np.empty((_NODES * _LEAF // _LANES, p + 1, _LANES)),
        table=np.full(2 * _NODES, -1, np.int32),
        recent=np.full(_RECENT, -1),
        used=np.array([1, 0, 0, 0]),
        place=np.empty(p),
        at=np.empty(p, np.int64),
        total=np.empty(_LANES),
        left=np.empty(_LANES),
        centre=np.empty(p),
        carry=np.empty(p + 1),
    )


def _near_solution(columns: Matrix, torque: Vector) -> Vector:
    """Genes (p,) near the optimum: residuals are kept relative to them, lest large sums cancel.

    Rounded to single precision, so that libraries that differ in the last bits give the same ones.
    """
    scale = np.abs(columns).max(axis=0)
    scale[scale == 0.0] = 1.0
    found = np.linalg.lstsq(columns / scale, torque, rcond=1e-10)[0] / scale
    return np.asarray(found.astype(np.float32).astype(np.float64))


def _orthogonal_coordinates(columns: Matrix, half: Vector) -> Matrix:
    """The triangular matrix (p, p) to coordinates in which the columns are orthogonal, of mean square 1.

    Rounded to single precision: any matrix near it serves, but it must be the same everywhere.
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
def fill(columns: Matrix, torque: Vector, origin: Vector, backward: Matrix, rows: Matrix) -> None:
    """Fill in the rows of a tree."""
    n, p = columns.shape
    for i in range(n):
        residual, speed = torque[i], 0.0
        for k in range(p):
            residual -= columns[i, k] * origin[k]
            rows[i, k + 1] = columns[i, k]
            along = 0.0
            for j in range(p):
                along += columns[i, j] * backward[j, k]
            speed += abs(along)
        rows[i, 0], rows[i, p + 1] = residual, speed


@compiled_inline
def tree_error(tree: Tree, genes: Vector, limit: float) -> float:
    """Equation 5 for one chromosome (p,), N m; infinite where that it exceeds the limit was seen on the way down."""
    node = _node_of(tree, genes, limit)
    if _is_on_the_way(tree, node):
        return np.inf
    error = tree.sums[node, 0]
    for k in range(genes.size):
        error -= tree.sums[node, k + 1] * tree.place[k]
    if tree.nodes[node, _KIND] != _LEAVES:
        return float((error + _list_error(tree, node)) / tree.length)
    return float((error + _leaf_error(tree, node)) / tree.length)


@compiled_inline
def _leaf_error(tree: Tree, node: int) -> float:
    """The sum of the absolute residuals of a leaf's rows, eight side by side."""
    lane, left, p = tree.total, tree.left, tree.place.size
    for j in range(_LANES):
        lane[j] = 0.0
    for b in range(tree.nodes[node, _START], tree.nodes[node, _START] + _blocks(tree, node)):
        # plain scalars and whole rows: an indexed gene or a computed index keeps the loop from the vector units
        gene, residual, column = tree.place[0], tree.leaves[b, 0], tree.leaves[b, 1]
        if p == 2:  # the paper's model, in one pass
            damping, rate = tree.place[1], tree.leaves[b, 2]
            for j in range(_LANES):
                lane[j] += abs(residual[j] - gene * column[j] - damping * rate[j])
            continue
        for j in range(_LANES):
            left[j] = residual[j] - gene * column[j]
        for k in range(1, p):
            gene, column = tree.place[k], tree.leaves[b, k + 1]
            for j in range(_LANES):
                left[j] -= gene * column[j]
        for j in range(_LANES):
            lane[j] += abs(left[j])
    total = 0.0
    for j in range(_LANES):
        total += lane[j]
    return total


@compiled_inline
def _blocks(tree: Tree, node: int) -> int:
    return (tree.nodes[node, _COUNT] + _LANES - 1) // _LANES  # type: ignore[no-any-return]  # int in numba


@compiled_inline
def _is_on_the_way(tree: Tree, node: int) -> bool:
    """Whether a cell is yet to be split. The root is where chromosomes out of bounds end."""
    return node > 0 and tree.nodes[node, _KIND] == _INNER


@compiled_no_refcount
def tree_tangent(tree: Tree, genes: Vector, limit: float, slope: Vector) -> float:
    """A plane below the fitness: its height, N m, at a chromosome (p,), and its slope (p,), written to `slope`.

    It touches the fitness there, unless that exceeds the limit: any plane that shows it will do.
    """
    node = _node_of(tree, genes, limit)
    height = tree.sums[node, 0]
    for k in range(genes.size):
        height -= tree.sums[node, k + 1] * tree.place[k]
        slope[k] = -tree.sums[node, k + 1]
    if not _is_on_the_way(tree, node):
        height += _leaf_error(tree, node) if tree.nodes[node, _KIND] == _LEAVES else _list_error(tree, node)
        _add_undecided(tree, node, slope)
    for k in range(genes.size):
        slope[k] /= tree.length
    return float(height / tree.length)


@compiled_no_refcount
def _add_undecided(tree: Tree, node: int, slope: Vector) -> None:
    """Add to n times the slope (p,) what the rows do that the cell has not decided."""
    p = slope.size
    if tree.nodes[node, _KIND] == _LEAVES:
        for i in range(tree.nodes[node, _COUNT]):
            rows, j = tree.leaves[tree.nodes[node, _START] + i // _LANES], i % _LANES
            residual = rows[0, j]
            for k in range(p):
                residual -= rows[k + 1, j] * tree.place[k]
            for k in range(p):
                slope[k] -= np.sign(residual) * rows[k + 1, j]
    else:
        for i in range(tree.nodes[node, _COUNT]):
            row = _row(tree, tree.nodes[node, _START], i)
            residual = _residual(tree.rows[row], tree.place)
            for k in range(p):
                slope[k] -= np.sign(residual) * tree.rows[row, k + 1]


@compiled_no_refcount
def _list_error(tree: Tree, node: int) -> float:
    """The sum of the absolute residuals of the rows that a cell without a leaf has not decided."""
    total = carry = 0.0
    for i in range(tree.nodes[node, _COUNT]):
        row = _row(tree, tree.nodes[node, _START], i)
        total, carry = _add(total, carry, abs(_residual(tree.rows[row], tree.place)))
    return total + carry


@compiled_inline
def _row(tree: Tree, start: int, i: int) -> int:
    return i if start < 0 else tree.undecided[start + i]


@compiled_inline
def _residual(row: Vector, place: Vector) -> float:
    residual = row[0]
    for k in range(place.size):
        residual -= row[k + 1] * place[k]
    return float(residual)


@compiled_inline
def _add(total: float, carry: float, term: float) -> tuple[float, float]:
    """Add a term; what rounding takes from the total goes to the carry (Neumaier 1974)."""
    raised = total + term
    lost = (total - raised) + term if abs(total) >= abs(term) else (term - raised) + total
    return raised, carry + lost


@compiled_inline
def _node_of(tree: Tree, genes: Vector, limit: float) -> int:
    """The leaf of a chromosome, grown if need be; the root where it is out of bounds. Sets place, genes - origin.

    Growing ends early in a cell whose settled rows alone put it above the limit.
    """
    inside = True
    scale = 2.0**_BITS / tree.width
    for k in range(genes.size):
        tree.place[k] = genes[k] - tree.origin[k]
    for k in range(genes.size):
        v = 0.0
        for j in range(k, genes.size):
            v += tree.forward[k, j] * tree.place[j]
        v = (v - tree.corner[k]) * scale
        if not 0.0 <= v < 2.0**_BITS:
            inside = False
        else:
            tree.at[k] = np.int64(v)
    if not inside:
        return 0
    for i in range(_RECENT):
        node = tree.recent[i]
        if node >= 0 and _holds(tree, node):
            return node  # type: ignore[no-any-return]  # int in numba
    return _descend(tree, limit)


@compiled_inline
def _holds(tree: Tree, node: int) -> bool:
    shift = tree.nodes[node, _SHIFT]
    for k in range(tree.at.size):  # noqa: SIM110 - numba compiles no generator expression
        if tree.at[k] >> shift != tree.nodes[node, _CELL + k]:
            return False
    return True


@compiled_no_refcount
def _descend(tree: Tree, limit: float) -> int:
    node: int = np.int64(0)  # type: ignore[assignment]  # with a plain 0 all below is compiled for that constant too
    if tree.nodes[0, _COUNT] <= _LEAF:
        return node
    while tree.nodes[node, _KIND] == _INNER:
        child = _child(tree, node)
        if child < 0:
            if _settled_exceed(tree, node, limit):
                return node
            child = _split(tree, node)
        node = child
    tree.recent[tree.used[_NEXT_RECENT]] = node
    tree.used[_NEXT_RECENT] = (tree.used[_NEXT_RECENT] + 1) % _RECENT
    return node


@compiled_inline
def _settled_exceed(tree: Tree, node: int, limit: float) -> bool:
    """Whether the rows whose sign a cell knows make an error above the limit, the others left out."""
    bound = extent = tree.sums[node, 0]
    for k in range(tree.place.size):
        rise = -tree.sums[node, k + 1] * tree.place[k]
        bound += rise
        extent += abs(rise)
    return node > 0 and bound - ROUNDING * extent > limit * tree.length


@compiled_inline
def _code(tree: Tree, node: int) -> int:
    """Which of the parent's parts the place is in."""
    shift = tree.nodes[node, _SHIFT] - _STEP
    code = 0
    for k in range(tree.at.size):
        code = (code << _STEP) | ((tree.at[k] >> shift) & ((1 << _STEP) - 1))
    return code


@compiled_no_refcount
def _slot(tree: Tree, node: int, code: int) -> int:
    """The place in the table of a node's child, or the free one where it belongs."""
    key = (np.uint64(node) * np.uint64(0x9E3779B97F4A7C15)) ^ (np.uint64(code) * np.uint64(0xC2B2AE3D27D4EB4F))
    slot = np.int64((key ^ (key >> np.uint64(29))) & np.uint64(tree.table.size - 1))
    while tree.table[slot] >= 0:
        child = tree.table[slot]
        if tree.nodes[child, _PARENT] == node and tree.nodes[child, _CODE] == code:
            break
        slot = (slot + 1) & (tree.table.size - 1)
    return slot  # type: ignore[return-value]  # int in numba


@compiled_no_refcount
def _child(tree: Tree, node: int) -> int:
    return np.int64(tree.table[_slot(tree, node, _code(tree, node))])  # type: ignore[return-value]  # int in numba


@compiled_no_refcount
def _split(tree: Tree, node: int) -> int:
    """Grow the part of a cell that the place is in; the root, all else forgotten, where there is no room."""
    count, p = tree.nodes[node, _COUNT], tree.at.size
    no_node = tree.used[_USED_NODES] == len(tree.nodes)
    no_list = tree.used[_USED_UNDECIDED] + count > tree.undecided.size
    no_leaf = tree.used[_USED_LEAVES] + _LEAF // _LANES > len(tree.leaves)
    if no_node or no_list or no_leaf:
        _forget(tree)
        return 0
    child, code = tree.used[_USED_NODES], _code(tree, node)
    tree.table[_slot(tree, node, code)] = child
    tree.used[_USED_NODES] += 1
    shift = tree.nodes[node, _SHIFT] - _STEP
    tree.nodes[child, _PARENT], tree.nodes[child, _CODE], tree.nodes[child, _SHIFT] = node, code, shift
    for k in range(p):
        tree.nodes[child, _CELL + k] = tree.at[k] >> shift
    left = _settle(tree, node, child)
    tree.nodes[child, _KIND], tree.nodes[child, _START] = _INNER, tree.used[_USED_UNDECIDED]
    tree.nodes[child, _COUNT] = left
    if left <= _LEAF:
        _copy_leaf(tree, child)
        return child  # type: ignore[no-any-return]  # int in numba
    if 2 * left > count:  # not worth a list of its own
        for k in range(p + 1):
            tree.sums[child, k] = tree.sums[node, k]
        tree.nodes[child, _START], tree.nodes[child, _COUNT] = tree.nodes[node, _START], count
    else:
        tree.used[_USED_UNDECIDED] += left
    if shift < _STEP:
        tree.nodes[child, _KIND] = _LIST
    return child  # type: ignore[no-any-return]  # int in numba


@compiled_no_refcount
def _forget(tree: Tree) -> None:
    tree.used[_USED_NODES] = 1
    tree.used[_USED_UNDECIDED] = tree.used[_USED_LEAVES] = 0
    for i in range(tree.table.size):
        tree.table[i] = -1
    for i in range(_RECENT):
        tree.recent[i] = -1


@compiled_no_refcount
def _settle(tree: Tree, node: int, child: int) -> int:
    """Sum up the parent's rows that have one sign throughout the child, list the others; returns how many those are."""
    p = tree.at.size
    half = tree.width * 2.0 ** (tree.nodes[child, _SHIFT] - _BITS - 1.0)
    centre, carry = tree.centre, tree.carry
    for j in range(p):
        centre[j] = 0.0
        for k in range(p):
            v = tree.corner[k] + half * (2.0 * tree.nodes[child, _CELL + k] + 1.0)
            centre[j] += tree.backward[j, k] * v
    reach = half * (1.0 + 1e-9) + tree.blur
    for k in range(p + 1):
        tree.sums[child, k], carry[k] = tree.sums[node, k], 0.0
    free, left = tree.used[_USED_UNDECIDED], 0
    for i in range(tree.nodes[node, _COUNT]):
        row = _row(tree, tree.nodes[node, _START], i)
        residual = _residual(tree.rows[row], centre)
        if abs(residual) < reach * tree.rows[row, p + 1]:
            tree.undecided[free + left] = row
            left += 1
            continue
        sign = 1.0 if residual >= 0.0 else -1.0
        for k in range(p + 1):
            tree.sums[child, k], carry[k] = _add(tree.sums[child, k], carry[k], sign * tree.rows[row, k])
    for k in range(p + 1):
        tree.sums[child, k] += carry[k]
    return left


@compiled_no_refcount
def _copy_leaf(tree: Tree, node: int) -> None:
    """Copy a leaf's rows side by side, in blocks of eight, filled up with rows of nothing."""
    p, count, listed = tree.at.size, tree.nodes[node, _COUNT], tree.nodes[node, _START]
    start, blocks = tree.used[_USED_LEAVES], _blocks(tree, node)
    for i in range(blocks * _LANES):
        for k in range(p + 1):
            number = tree.rows[tree.undecided[listed + i], k] if i < count else 0.0
            tree.leaves[start + i // _LANES, k, i % _LANES] = number
    tree.nodes[node, _KIND], tree.nodes[node, _START] = _LEAVES, start
    tree.used[_USED_LEAVES] += blocks
