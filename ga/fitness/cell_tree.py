"""The sub-linear engine: a tree of cells, grown where the search looks, that knows the sign of most residuals.

The fitness is convex and piecewise linear. Inside a cell most residuals torque_i - columns_i . genes keep their sign
and collapse into p + 1 sums; only the undecided ones, whose zero plane crosses the cell, are looked at one by one. A
cell is split, 4^p ways at a time, until 16 or fewer are undecided, so a chromosome costs what its leaf costs, not n.

The numbers in a cell depend on the cell alone, never on the way the search came: the tree is a cache of a pure
function. It may be thrown away at any time, which is what bounds its memory, and whoever asks gets the same bits.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from ga.compiled import compiled_inline, compiled_no_refcount
from ga.fitness.cells import (
    BITS,
    CELL,
    CODE,
    COUNT,
    INNER,
    KIND,
    LANES,
    LEAF,
    LEAVES,
    LIST,
    NEXT_RECENT,
    PARENT,
    RECENT,
    SHIFT,
    START,
    USED_LEAVES,
    USED_NODES,
    USED_UNDECIDED,
    Tree,
    Vector,
)
from ga.fitness.dense import ROUNDING

_FEW: Final = 256
_MANY: Final = 16
"""Rows that show whether a cell is worth its own list, where there are many times as many to go through for one."""

_TOGETHER: Final = 64
"""Rows that are added up before their sum is added with what its rounding takes."""

_STEP: Final = 2
"""Binary digits that a cell is shorter than its parent, in each direction."""


@compiled_inline
def tree_error(tree: Tree, genes: Vector, limit: float) -> float:
    """Equation 5 for one chromosome (p,), N m; infinite where that it exceeds the limit was seen on the way down."""
    node = _node_of(tree, genes, limit)
    if _is_on_the_way(tree, node):
        return np.inf
    error = tree.sums[node, 0]
    for k in range(genes.size):
        error -= tree.sums[node, k + 1] * tree.place[k]
    if tree.nodes[node, KIND] != LEAVES:
        return float((error + _list_error(tree, node)) / tree.length)
    return float((error + _leaf_error(tree, node)) / tree.length)


@compiled_inline
def _leaf_error(tree: Tree, node: int) -> float:
    """The sum of the absolute residuals of a leaf's rows, eight side by side."""
    lane, left, p = tree.total, tree.left, tree.place.size
    for j in range(LANES):
        lane[j] = 0.0
    for b in range(tree.nodes[node, START], tree.nodes[node, START] + _blocks(tree, node)):
        # plain scalars and whole rows: an indexed gene or a computed index keeps the loop from the vector units
        gene, residual, column = tree.place[0], tree.leaves[b, 0], tree.leaves[b, 1]
        if p == 2:  # the paper's model, in one pass
            damping, rate = tree.place[1], tree.leaves[b, 2]
            for j in range(LANES):
                lane[j] += abs(residual[j] - gene * column[j] - damping * rate[j])
            continue
        for j in range(LANES):
            left[j] = residual[j] - gene * column[j]
        for k in range(1, p):
            gene, column = tree.place[k], tree.leaves[b, k + 1]
            for j in range(LANES):
                left[j] -= gene * column[j]
        for j in range(LANES):
            lane[j] += abs(left[j])
    total = 0.0
    for j in range(LANES):
        total += lane[j]
    return total


@compiled_inline
def _blocks(tree: Tree, node: int) -> int:
    return (tree.nodes[node, COUNT] + LANES - 1) // LANES  # type: ignore[no-any-return]  # int in numba


@compiled_inline
def _is_on_the_way(tree: Tree, node: int) -> bool:
    """Whether a cell is yet to be split. The root is where chromosomes out of bounds end."""
    return node > 0 and tree.nodes[node, KIND] == INNER


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
        height += _leaf_error(tree, node) if tree.nodes[node, KIND] == LEAVES else _list_error(tree, node)
        _add_undecided(tree, node, slope)
    for k in range(genes.size):
        slope[k] /= tree.length
    return float(height / tree.length)


@compiled_no_refcount
def _add_undecided(tree: Tree, node: int, slope: Vector) -> None:
    """Add to n times the slope (p,) what the rows do that the cell has not decided."""
    p = slope.size
    if tree.nodes[node, KIND] == LEAVES:
        for i in range(tree.nodes[node, COUNT]):
            rows, j = tree.leaves[tree.nodes[node, START] + i // LANES], i % LANES
            residual = rows[0, j]
            for k in range(p):
                residual -= rows[k + 1, j] * tree.place[k]
            for k in range(p):
                slope[k] -= np.sign(residual) * rows[k + 1, j]
    else:
        for i in range(tree.nodes[node, COUNT]):
            row = _row(tree, tree.nodes[node, START], i)
            residual = _residual(tree.rows[row], tree.place)
            for k in range(p):
                slope[k] -= np.sign(residual) * tree.rows[row, k + 1]


@compiled_no_refcount
def _list_error(tree: Tree, node: int) -> float:
    """The sum of the absolute residuals of the rows that a cell without a leaf has not decided."""
    total = carry = 0.0
    for i in range(tree.nodes[node, COUNT]):
        row = _row(tree, tree.nodes[node, START], i)
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
    scale = 2.0**BITS / tree.width
    for k in range(genes.size):
        tree.place[k] = genes[k] - tree.origin[k]
    for k in range(genes.size):
        v = 0.0
        for j in range(k, genes.size):
            v += tree.forward[k, j] * tree.place[j]
        v = (v - tree.corner[k]) * scale
        if not 0.0 <= v < 2.0**BITS:
            inside = False
        else:
            tree.at[k] = np.int64(v)
    if not inside:
        return 0
    for i in range(RECENT):
        node = tree.recent[i]
        if node >= 0 and _holds(tree, node):
            return node  # type: ignore[no-any-return]  # int in numba
    return _descend(tree, limit)


@compiled_inline
def _holds(tree: Tree, node: int) -> bool:
    shift = tree.nodes[node, SHIFT]
    for k in range(tree.at.size):  # noqa: SIM110 - numba compiles no generator expression
        if tree.at[k] >> shift != tree.nodes[node, CELL + k]:
            return False
    return True


@compiled_no_refcount
def _descend(tree: Tree, limit: float) -> int:
    node: int = np.int64(0)  # type: ignore[assignment]  # with a plain 0 all below is compiled for that constant too
    if tree.nodes[0, COUNT] <= LEAF:
        return node
    while tree.nodes[node, KIND] == INNER:
        child = _child(tree, node)
        if child < 0:
            if _settled_exceed(tree, node, limit):
                return node
            child = _split(tree, node)
        node = child
    tree.recent[tree.used[NEXT_RECENT]] = node
    tree.used[NEXT_RECENT] = (tree.used[NEXT_RECENT] + 1) % RECENT
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
    shift = tree.nodes[node, SHIFT] - _STEP
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
        if tree.nodes[child, PARENT] == node and tree.nodes[child, CODE] == code:
            break
        slot = (slot + 1) & (tree.table.size - 1)
    return slot  # type: ignore[return-value]  # int in numba


@compiled_no_refcount
def _child(tree: Tree, node: int) -> int:
    return np.int64(tree.table[_slot(tree, node, _code(tree, node))])  # type: ignore[return-value]  # int in numba


@compiled_no_refcount
def _split(tree: Tree, node: int) -> int:
    """Grow the part of a cell that the place is in; the root, all else forgotten, where there is no room."""
    count, p = tree.nodes[node, COUNT], tree.at.size
    no_node = tree.used[USED_NODES] == len(tree.nodes)
    no_list = tree.used[USED_UNDECIDED] + count > tree.undecided.size
    no_leaf = tree.used[USED_LEAVES] + LEAF // LANES > len(tree.leaves)
    if no_node or no_list or no_leaf:
        _forget(tree)
        return 0
    child, code = tree.used[USED_NODES], _code(tree, node)
    tree.table[_slot(tree, node, code)] = child
    tree.used[USED_NODES] += 1
    shift = tree.nodes[node, SHIFT] - _STEP
    tree.nodes[child, PARENT], tree.nodes[child, CODE], tree.nodes[child, SHIFT] = node, code, shift
    for k in range(p):
        tree.nodes[child, CELL + k] = tree.at[k] >> shift
    reach = _enter(tree, child)
    left = count if _is_wide(tree, node, reach) else _settle(tree, node, child, reach)
    tree.nodes[child, KIND], tree.nodes[child, START] = INNER, tree.used[USED_UNDECIDED]
    tree.nodes[child, COUNT] = left
    if left <= LEAF:
        _copy_leaf(tree, child)
        return child  # type: ignore[no-any-return]  # int in numba
    if 2 * left > count:  # not worth a list of its own
        for k in range(p + 1):
            tree.sums[child, k] = tree.sums[node, k]
        tree.nodes[child, START], tree.nodes[child, COUNT] = tree.nodes[node, START], count
    else:
        tree.used[USED_UNDECIDED] += left
    if shift < _STEP:
        tree.nodes[child, KIND] = LIST
    return child  # type: ignore[no-any-return]  # int in numba


@compiled_no_refcount
def _forget(tree: Tree) -> None:
    tree.used[USED_NODES] = 1
    tree.used[USED_UNDECIDED] = tree.used[USED_LEAVES] = 0
    for i in range(tree.table.size):
        tree.table[i] = -1
    for i in range(RECENT):
        tree.recent[i] = -1


@compiled_no_refcount
def _enter(tree: Tree, child: int) -> float:
    """Set `centre` to a cell's; returns how far v may be from it in each coordinate."""
    p = tree.at.size
    half = tree.width * 2.0 ** (tree.nodes[child, SHIFT] - BITS - 1.0)
    for j in range(p):
        tree.centre[j] = 0.0
        for k in range(p):
            v = tree.corner[k] + half * (2.0 * tree.nodes[child, CELL + k] + 1.0)
            tree.centre[j] += tree.backward[j, k] * v
    return half * (1.0 + 1e-9) + tree.blur  # type: ignore[no-any-return]  # float in numba


@compiled_inline
def _is_wide(tree: Tree, node: int, reach: float) -> bool:
    """Whether most of a few of the parent's rows may have either sign within reach: then so may most of all."""
    count, wide = tree.nodes[node, COUNT], 0
    if count < _MANY * _FEW:
        return False
    for i in range(_FEW):
        row = _row(tree, tree.nodes[node, START], i * (count // _FEW))
        if abs(_residual(tree.rows[row], tree.centre)) < reach * tree.rows[row, tree.at.size + 1]:
            wide += 1
    return 2 * wide > _FEW


@compiled_no_refcount
def _settle(tree: Tree, node: int, child: int, reach: float) -> int:
    """Sum up the parent's rows that have one sign throughout the child, list the others; returns how many those are.

    centre, reach: where the child is, as `_enter` gives.
    """
    p, part = tree.at.size, tree.part
    for k in range(p + 1):
        tree.sums[child, k], tree.carry[k], part[k] = tree.sums[node, k], 0.0, 0.0
    free, left = tree.used[USED_UNDECIDED], 0
    for i in range(tree.nodes[node, COUNT]):
        row = _row(tree, tree.nodes[node, START], i)
        residual = _residual(tree.rows[row], tree.centre)
        if abs(residual) < reach * tree.rows[row, p + 1]:
            tree.undecided[free + left] = row
            left += 1
        else:
            sign = 1.0 if residual >= 0.0 else -1.0
            for k in range(p + 1):
                part[k] += sign * tree.rows[row, k]
        if i % _TOGETHER == _TOGETHER - 1:
            _add_part(tree, child)
    _add_part(tree, child)
    for k in range(p + 1):
        tree.sums[child, k] += tree.carry[k]
    return left


@compiled_no_refcount
def _add_part(tree: Tree, node: int) -> None:
    """Add the sums of a few rows to those of a cell, and begin new ones."""
    for k in range(tree.part.size):
        tree.sums[node, k], tree.carry[k] = _add(tree.sums[node, k], tree.carry[k], tree.part[k])
        tree.part[k] = 0.0


@compiled_no_refcount
def _copy_leaf(tree: Tree, node: int) -> None:
    """Copy a leaf's rows side by side, in blocks of eight, filled up with rows of nothing."""
    p, count, listed = tree.at.size, tree.nodes[node, COUNT], tree.nodes[node, START]
    start, blocks = tree.used[USED_LEAVES], _blocks(tree, node)
    for i in range(blocks * LANES):
        for k in range(p + 1):
            number = tree.rows[tree.undecided[listed + i], k] if i < count else 0.0
            tree.leaves[start + i // LANES, k, i % LANES] = number
    tree.nodes[node, KIND], tree.nodes[node, START] = LEAVES, start
    tree.used[USED_LEAVES] += blocks
