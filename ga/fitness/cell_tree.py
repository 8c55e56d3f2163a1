"""The sub-linear engine: a tree of cells in parameter space, in each of which the sign of most residuals is known.

The fitness is convex and piecewise linear. Inside a cell most residuals torque_i - columns_i . genes keep their sign
and are replaced by p + 1 sums; only the undecided ones, whose zero plane crosses the cell, are computed one by one.
Cells are grown where the search goes. A cell is split, 4^p ways at a time, until 16 or fewer residuals are undecided,
so the cost of a chromosome depends on its leaf, not on n. Similar rows are decided and listed in groups
(`ga.fitness.row_groups`), so that the cost of a split does not depend on n either.

The numbers in a cell depend on the cell alone, never on the path of the search: the tree is a cache of a pure function.
It may be deleted at any time, which bounds its memory, and the results stay the same to the last bit.
"""

from __future__ import annotations

import numpy as np

from ga.compiled import compiled_inline, compiled_no_refcount, compiled_within
from ga.fitness.cells import (
    BITS,
    CELL,
    COUNT,
    INNER,
    KIND,
    LANES,
    LEAF,
    LEAVES,
    NEXT_RECENT,
    RECENT,
    ROWS,
    SHIFT,
    START,
    Tree,
    Vector,
)
from ga.fitness.dense import ROUNDING
from ga.fitness.splitting import add_carrying, blocks_of, child_of, item_of, residual_at, rows_of, split


@compiled_inline
def tree_error(tree: Tree, genes: Vector, limit: float) -> float:
    """Return equation 5 for one chromosome (p,), N m; infinite if the error was found to exceed the limit."""
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
    """Return the sum of the absolute residuals of the rows of the leaf `node`, computed eight at a time."""
    lane, left, p = tree.total, tree.left, tree.place.size
    for j in range(LANES):
        lane[j] = 0.0
    for b in range(tree.nodes[node, START], tree.nodes[node, START] + blocks_of(tree, node)):
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
def _is_on_the_way(tree: Tree, node: int) -> bool:
    """Return whether the cell `node` must still be split. False for the root, which stands for chromosomes out of
    bounds.
    """
    return node > 0 and tree.nodes[node, KIND] == INNER


@compiled_no_refcount
def tree_tangent(tree: Tree, genes: Vector, limit: float, slope: Vector) -> float:
    """Return the height, N m, at a chromosome (p,) of a plane below the fitness; its slope (p,) is written to `slope`.

    The plane touches the fitness at the chromosome, unless the fitness exceeds the limit; then any plane above the
    limit is returned.
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
    """Add the contribution of the rows of the cell `node` with undecided sign to n times the slope (p,)."""
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
            first, end = rows_of(tree, item_of(tree, node, i))
            for row in range(first, end):
                sign = np.sign(residual_at(tree.rows[row], tree.place))
                for k in range(p):
                    slope[k] -= sign * tree.rows[row, k + 1]


@compiled_no_refcount
def _list_error(tree: Tree, node: int) -> float:
    """Return the sum of the absolute residuals of the undecided rows of the cell `node`, which is no leaf."""
    total = carry = 0.0
    for i in range(tree.nodes[node, COUNT]):
        first, end = rows_of(tree, item_of(tree, node, i))
        for row in range(first, end):
            total, carry = add_carrying(total, carry, abs(residual_at(tree.rows[row], tree.place)))
    return total + carry


@compiled_within
def _node_of(tree: Tree, genes: Vector, limit: float) -> int:
    """Return the leaf of a chromosome, grown if necessary; the root if the chromosome is out of bounds.

    Sets the tree's `place` to genes - origin. Growing ends early in a cell whose decided rows alone exceed the limit.
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
    if tree.nodes[0, ROWS] <= LEAF:
        return node
    while tree.nodes[node, KIND] == INNER:
        child = child_of(tree, node)
        if child < 0:
            if _settled_exceed(tree, node, limit):
                return node
            child = split(tree, node)
        node = child
    tree.recent[tree.used[NEXT_RECENT]] = node
    tree.used[NEXT_RECENT] = (tree.used[NEXT_RECENT] + 1) % RECENT
    return node


@compiled_inline
def _settled_exceed(tree: Tree, node: int, limit: float) -> bool:
    """Return whether the rows whose sign is known in the cell `node` alone make an error above the limit, N m."""
    bound = extent = tree.sums[node, 0]
    for k in range(tree.place.size):
        rise = -tree.sums[node, k + 1] * tree.place[k]
        bound += rise
        extent += abs(rise)
    return node > 0 and bound - ROUNDING * extent > limit * tree.length
