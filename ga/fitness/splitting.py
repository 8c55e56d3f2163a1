"""Grow the cells of a tree: the part of a cell that a search enters becomes a cell with its own undecided rows."""

from __future__ import annotations

from typing import Final

import numpy as np

from ga.compiled import compiled_inline, compiled_no_refcount, compiled_within
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
    ROWS,
    SHIFT,
    START,
    USED_LEAVES,
    USED_NODES,
    USED_UNDECIDED,
    Tree,
    Vector,
)
from ga.fitness.row_groups import END_ROW, FAN, FIRST_PART, FIRST_ROW, PARTS

_TOGETHER: Final = 64
"""The number of rows that are summed before the sum is added with compensation for rounding."""

_RESOLVED: Final = 500
"""The fraction of a cell's rows below which a partly decided group is listed as a whole."""

_STEP: Final = 2
"""The number of binary digits by which a cell is smaller than its parent in each direction: each digit halves the
width.
"""


@compiled_inline
def blocks_of(tree: Tree, node: int) -> int:
    """Return the number of blocks of eight rows that the leaf `node` has."""
    return (tree.nodes[node, COUNT] + LANES - 1) // LANES  # type: ignore[no-any-return]  # int in numba


@compiled_inline
def item_of(tree: Tree, node: int, i: int) -> int:
    """Return the row or group at position i in the list of the cell `node`."""
    start = tree.nodes[node, START]
    return len(tree.rows) + len(tree.contents) - 1 if start < 0 else tree.undecided[start + i]


@compiled_inline
def rows_of(tree: Tree, item: int) -> tuple[int, int]:
    """Return the first row of an item (a row or a group), and the row after its last."""
    group = item - len(tree.rows)
    if group < 0:
        return item, item + 1
    return tree.contents[group, FIRST_ROW], tree.contents[group, END_ROW]


@compiled_inline
def residual_at(row: Vector, place: Vector) -> float:
    """Return the residual of a row, N m. place: genes - origin."""
    residual = row[0]
    for k in range(place.size):
        residual -= row[k + 1] * place[k]
    return float(residual)


@compiled_inline
def add_carrying(total: float, carry: float, term: float) -> tuple[float, float]:
    """Return the total after adding a term, and the carry with the rounding error of the sum added (Neumaier 1974)."""
    raised = total + term
    lost = (total - raised) + term if abs(total) >= abs(term) else (term - raised) + total
    return raised, carry + lost


@compiled_inline
def _code(tree: Tree, node: int) -> int:
    """Return the number of the part of the parent cell `node` that contains the tree's `place`."""
    shift = tree.nodes[node, SHIFT] - _STEP
    code = 0
    for k in range(tree.at.size):
        code = (code << _STEP) | ((tree.at[k] >> shift) & ((1 << _STEP) - 1))
    return code


@compiled_no_refcount
def _slot(tree: Tree, node: int, code: int) -> int:
    """Return the position in the hash table of the child number `code` of a node, or the free position for it."""
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
    """Return the child of the cell `node` that contains the tree's `place`; negative if that child is not grown."""
    return np.int64(tree.table[_slot(tree, node, _code(tree, node))])  # type: ignore[return-value]  # int in numba


@compiled_within
def split(tree: Tree, node: int) -> int:
    """Grow the child of a cell that contains the tree's `place`, and return it. If memory is full, delete all cells but
    the root and return the root.
    """
    rows, p = tree.nodes[node, ROWS], tree.at.size
    no_node = tree.used[USED_NODES] == len(tree.nodes)
    no_list = tree.used[USED_UNDECIDED] + rows > tree.undecided.size
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
    tree.nodes[child, KIND], tree.nodes[child, START] = INNER, tree.used[USED_UNDECIDED]
    reach, small = _enter(tree, child), rows // _RESOLVED
    while _settle(tree, node, child, reach, small) > rows // 4:  # smaller groups would decide more
        small //= FAN
    left = tree.nodes[child, ROWS]
    if left <= LEAF:
        _copy_leaf(tree, child)
        return child  # type: ignore[no-any-return]  # int in numba
    if 2 * left > rows:  # not worth a list of its own
        for k in range(p + 1):
            tree.sums[child, k] = tree.sums[node, k]
        for k in (START, COUNT, ROWS):
            tree.nodes[child, k] = tree.nodes[node, k]
    else:
        tree.used[USED_UNDECIDED] += tree.nodes[child, COUNT]
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
    """Set the tree's `middle` (in v) and `centre` (in genes) to the centre of a cell; return half the cell's width in
    v, with a margin for rounding.
    """
    p = tree.at.size
    half = tree.width * 2.0 ** (tree.nodes[child, SHIFT] - BITS - 1.0)
    for k in range(p):
        tree.middle[k] = tree.corner[k] + half * (2.0 * tree.nodes[child, CELL + k] + 1.0)
    for j in range(p):
        tree.centre[j] = 0.0
        for k in range(p):
            tree.centre[j] += tree.backward[j, k] * tree.middle[k]
    return half * (1.0 + 1e-9) + tree.blur  # type: ignore[no-any-return]  # float in numba


@compiled_no_refcount
def _settle(tree: Tree, node: int, child: int, reach: float, small: int) -> int:
    """Sum the parent's rows that have one sign throughout the child, and list the other rows.

    reach: half the child's width, from `_enter`, which has also set its centre. A group in which only some rows may
    have one sign is examined part by part, unless it has no more rows than `small`: then it is listed as a whole.
    Returns the number of rows in such small groups.
    """
    p, free, listed, rows, added, unsure = tree.at.size, tree.used[USED_UNDECIDED], 0, 0, 0, 0
    for k in range(p + 1):
        tree.sums[child, k], tree.carry[k], tree.part[k] = tree.sums[node, k], 0.0, 0.0
    for i in range(tree.nodes[node, COUNT]):
        tree.stack[0], waiting = item_of(tree, node, i), 1
        while waiting > 0:
            waiting -= 1
            item = tree.stack[waiting]
            group = item - len(tree.rows)
            sign = _sign_of(tree, item, reach)
            if sign != 0.0:
                values = tree.rows[item] if group < 0 else tree.groups[group]
                for k in range(p + 1):
                    tree.part[k] += sign * values[k]
                added += 1
                if added % _TOGETHER == 0:
                    _add_part(tree, child)
                continue
            first, end = rows_of(tree, item)
            is_open = group < 0 or _is_open(tree, group, reach)
            if is_open or end - first <= small:
                tree.undecided[free + listed] = item
                listed += 1
                rows += end - first
                unsure += 0 if is_open else end - first
            else:
                for part in range(tree.contents[group, PARTS]):
                    tree.stack[waiting] = tree.contents[group, FIRST_PART] + part
                    waiting += 1
    _add_part(tree, child)
    for k in range(p + 1):
        tree.sums[child, k] += tree.carry[k]
    tree.nodes[child, COUNT], tree.nodes[child, ROWS] = listed, rows
    return unsure


@compiled_inline
def _sign_of(tree: Tree, item: int, reach: float) -> float:
    """Return the sign that all residuals of an item (a row or a group) have throughout a cell, 0 if it is not known.
    reach: half the cell's width.
    """
    group, p = item - len(tree.rows), tree.at.size
    if group < 0:
        residual, needed = residual_at(tree.rows[item], tree.centre), reach * tree.rows[item, p + 1]
    else:
        residual, needed = _mean_at(tree, group), reach * tree.groups[group, 2 * p + 3] + _spread_at(tree, group)
    if abs(residual) < needed:
        return 0.0
    return 1.0 if residual >= 0.0 else -1.0


@compiled_inline
def _is_open(tree: Tree, group: int, reach: float) -> bool:
    """Return whether every row of a group may have either sign in a cell. reach: half the cell's width."""
    return abs(_mean_at(tree, group)) + _spread_at(tree, group) < reach * tree.groups[group, 2 * tree.at.size + 2]  # type: ignore[no-any-return]  # bool in numba


@compiled_inline
def _mean_at(tree: Tree, group: int) -> float:
    """Return the mean residual of a group's rows at the centre of a cell, N m."""
    size = tree.contents[group, END_ROW] - tree.contents[group, FIRST_ROW]
    return residual_at(tree.groups[group], tree.centre) / size  # type: ignore[no-any-return]  # float in numba


@compiled_inline
def _spread_at(tree: Tree, group: int) -> float:
    """Return the largest difference, N m, between a row's residual and the mean of its group at the centre of a
    cell.
    """
    p = tree.at.size
    spread = tree.groups[group, p + 1]
    for k in range(p):
        spread += tree.groups[group, p + 2 + k] * abs(tree.middle[k])
    return spread  # type: ignore[no-any-return]  # float in numba


@compiled_no_refcount
def _add_part(tree: Tree, node: int) -> None:
    """Add the sums of a few rows to the sums of the cell `node`, and reset the sums of the few rows to zero."""
    for k in range(tree.part.size):
        tree.sums[node, k], tree.carry[k] = add_carrying(tree.sums[node, k], tree.carry[k], tree.part[k])
        tree.part[k] = 0.0


@compiled_no_refcount
def _copy_leaf(tree: Tree, node: int) -> None:
    """Copy the rows of the leaf `node` side by side, in blocks of eight; the last block is filled up with zero rows."""
    p, items, rows = tree.at.size, tree.nodes[node, COUNT], tree.nodes[node, ROWS]
    start, blocks = tree.used[USED_LEAVES], (rows + LANES - 1) // LANES
    for i in range(rows, blocks * LANES):
        for k in range(p + 1):
            tree.leaves[start + i // LANES, k, i % LANES] = 0.0
    at = 0
    for i in range(items):
        first, end = rows_of(tree, item_of(tree, node, i))
        for row in range(first, end):
            for k in range(p + 1):
                tree.leaves[start + at // LANES, k, at % LANES] = tree.rows[row, k]
            at += 1
    tree.nodes[node, KIND], tree.nodes[node, START], tree.nodes[node, COUNT] = LEAVES, start, rows
    tree.used[USED_LEAVES] += blocks
