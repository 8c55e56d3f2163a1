"""The growth of a cell: the part of it that a search enters becomes a cell of its own, with the rows it leaves open."""

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

_FEW: Final = 256
_MANY: Final = 16
"""Rows that show whether a cell is worth its own list, where there are many times as many to go through for one."""

_TOGETHER: Final = 64
"""Rows that are added up before their sum is added with what its rounding takes."""

_STEP: Final = 2
"""Binary digits that a cell is shorter than its parent, in each direction."""


@compiled_inline
def blocks_of(tree: Tree, node: int) -> int:
    """The blocks of eight rows that a leaf has."""
    return (tree.nodes[node, COUNT] + LANES - 1) // LANES  # type: ignore[no-any-return]  # int in numba


@compiled_inline
def row_of(tree: Tree, start: int, i: int) -> int:
    """The row that is number i of a list; a list that starts before 0 is of all rows."""
    return i if start < 0 else tree.undecided[start + i]


@compiled_inline
def residual_at(row: Vector, place: Vector) -> float:
    """The residual of a row at a place, N m."""
    residual = row[0]
    for k in range(place.size):
        residual -= row[k + 1] * place[k]
    return float(residual)


@compiled_inline
def add_carrying(total: float, carry: float, term: float) -> tuple[float, float]:
    """Add a term; what rounding takes from the total goes to the carry (Neumaier 1974)."""
    raised = total + term
    lost = (total - raised) + term if abs(total) >= abs(term) else (term - raised) + total
    return raised, carry + lost


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
def child_of(tree: Tree, node: int) -> int:
    """The part of a cell that the place is in; negative where it is not grown."""
    return np.int64(tree.table[_slot(tree, node, _code(tree, node))])  # type: ignore[return-value]  # int in numba


@compiled_no_refcount
def split(tree: Tree, node: int) -> int:
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
        row = row_of(tree, tree.nodes[node, START], i * (count // _FEW))
        if abs(residual_at(tree.rows[row], tree.centre)) < reach * tree.rows[row, tree.at.size + 1]:
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
        row = row_of(tree, tree.nodes[node, START], i)
        residual = residual_at(tree.rows[row], tree.centre)
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
        tree.sums[node, k], tree.carry[k] = add_carrying(tree.sums[node, k], tree.carry[k], tree.part[k])
        tree.part[k] = 0.0


@compiled_no_refcount
def _copy_leaf(tree: Tree, node: int) -> None:
    """Copy a leaf's rows side by side, in blocks of eight, filled up with rows of nothing."""
    p, count, listed = tree.at.size, tree.nodes[node, COUNT], tree.nodes[node, START]
    start, blocks = tree.used[USED_LEAVES], blocks_of(tree, node)
    for i in range(blocks * LANES):
        for k in range(p + 1):
            number = tree.rows[tree.undecided[listed + i], k] if i < count else 0.0
            tree.leaves[start + i // LANES, k, i % LANES] = number
    tree.nodes[node, KIND], tree.nodes[node, START] = LEAVES, start
    tree.used[USED_LEAVES] += blocks
