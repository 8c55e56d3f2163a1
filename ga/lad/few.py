"""The exact minimum of the usual case in three compiled steps: few rows, clearly distinct columns, nothing tied.

A search and a model selection solve ten thousand such problems of some hundred rows, where the calls of dozens of array
functions cost more than what they compute. All other cases are left to `ga.lad.exact`.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_no_refcount
from ga.lad.simplex import OPTIMAL, Basis, Matrix, Room, Vector, invert, room_for, step_down

DISTINCT: Final = 1e-3
"""A column of which this part of its length is its own, and more, needs no cleaning from the others."""

ROUNDING: Final = 64.0 * float(np.finfo(np.float64).eps)
PROVEN: Final = 1e-9
ALONE: Final = 1.0 - 1e-9
"""The certificate up to which an optimum is proven, and the multipliers below which it is the only one."""


class Work(NamedTuple):
    """Working space for n rows of p columns: the scaled and the orthogonal ones (n, p), vectors, matrices (p, p)."""

    scaled: Matrix
    rows: Matrix
    target: Vector
    genes: Vector
    scale: Vector
    extent: Vector
    start: Vector
    pull: Vector
    needed: Vector
    sums: Vector
    gram: Matrix
    into: Matrix
    basis: Basis
    descent: Room


def solve_few(
    columns: NDArray[np.float64], torque: NDArray[np.float64], near: NDArray[np.float64] | None
) -> tuple[NDArray[np.float64], float, bool] | None:
    """Return genes (p,), certificate and whether they are unique, as `ga.lad.exact.Optimum` has them.

    columns (n, p) and torque (n,), finite, and near (p,): as there. None where the case is not the usual one.
    """
    n, p = columns.shape
    genes, scale, extent, start, pull, needed, sums = np.zeros((7, p))
    gram, into = np.zeros((2, p, p))
    work = Work(
        np.empty((n, p)),
        np.empty((n, p)),
        np.empty(n),
        genes,
        scale,
        extent,
        start,
        pull,
        needed,
        sums,
        gram,
        into,
        np.zeros(p, np.int64),
        room_for(n, p),
    )
    columns, begin = np.ascontiguousarray(columns), np.array([] if near is None else near, dtype=np.float64)
    size = whiten(columns, np.ascontiguousarray(torque), begin, work)
    if not size > 0.0:
        return None
    if step_down(work.rows, work.target, pull, start, work.basis, work.descent) != OPTIMAL:
        return None
    certificate = certify(columns, size, work)
    return (genes, certificate, bool(np.abs(needed).max() < ALONE)) if certificate <= PROVEN else None


@compiled_no_refcount
def whiten(columns: Matrix, torque: Vector, near: Vector, work: Work) -> float:
    """Make the columns orthogonal and the torque of size 1, and begin at genes `near`, at least squares if empty.

    Returns the mean torque; 0 where it or a column is zero, or the columns are too much alike.
    """
    size = _measure(columns, torque, work)
    if not (size > 0.0 and _factor(work)):
        return 0.0
    _turn(near, size, work)
    return size


@compiled_no_refcount
def _measure(columns: Matrix, torque: Vector, work: Work) -> float:
    """The mean torque, 0 if a column is zero; and the scaled columns with their products."""
    n, p = columns.shape
    size = 0.0
    for k in range(p):
        for i in range(n):
            work.extent[k] += abs(columns[i, k])
            work.scale[k] = max(work.scale[k], abs(columns[i, k]))
        if not work.scale[k] > 0.0:
            return 0.0
    for i in range(n):
        work.target[i] = torque[i]
        size += abs(torque[i]) / n
        for k in range(p):
            work.scaled[i, k] = columns[i, k] / work.scale[k]
            for j in range(k + 1):
                work.gram[k, j] += work.scaled[i, k] * work.scaled[i, j] / n
    return size


@compiled_no_refcount
def _factor(work: Work) -> bool:
    """Do the Cholesky decomposition in place, and find what makes its triangle the identity; False if too alike."""
    gram, into = work.gram, work.into
    p = len(gram)
    for k in range(p):
        least = DISTINCT * DISTINCT * gram[k, k]
        for j in range(k + 1):
            part = gram[k, j]
            for i in range(j):
                part -= gram[k, i] * gram[j, i]
            if j == k and not part > least:
                return False
            gram[k, j] = np.sqrt(part) if j == k else part / gram[j, j]
        into[k, k] = 1.0 / gram[k, k]
        for j in range(k):
            part = 0.0
            for i in range(j, k):
                part += gram[k, i] * into[j, i]
            into[j, k] = -part / gram[k, k]
    return True


@compiled_no_refcount
def _turn(near: Vector, size: float, work: Work) -> None:
    """Fill in the orthogonal columns, the target, and the start in their coordinates."""
    n, p = work.rows.shape
    for i in range(n):
        work.target[i] /= size
        value = 0.0 if near.size else work.target[i]
        for k in range(near.size):
            value += work.scaled[i, k] * near[k] * work.scale[k] / size
        for k in range(p):
            part = 0.0
            for j in range(k + 1):
                part += work.scaled[i, j] * work.into[j, k]
            work.rows[i, k] = part
            work.start[k] += part * value / n


@compiled_no_refcount
def certify(columns: Matrix, size: float, work: Work) -> float:
    """Fill in the genes and the multipliers of the vertex that the descent ended at.

    Returns the certificate; infinite where a row outside the basis has no residual either.
    """
    room = work.descent
    if not _sum_by_sign(work):
        return np.inf
    p = work.basis.size
    for j in range(p):
        for k in range(p):
            room.met[j, k] = work.scaled[work.basis[j], k]
            room.inverse[j, k] = 1.0 if j == k else 0.0
    return _conclude(columns, size, work) if invert(room.met, room.inverse) else np.inf


@compiled_no_refcount
def _sum_by_sign(work: Work) -> bool:
    """Add up the scaled columns by the signs of the residuals outside the basis; False if one is zero to rounding."""
    n, p = work.rows.shape
    room, basis, most = work.descent, work.basis, 0.0
    for k in range(p):
        entry = 0.0
        for j in range(p):
            entry += abs(room.inverse[k, j] * work.target[basis[j]])
        most = max(most, entry)  # no entry of the point is larger
    for i in range(n):
        left, reach, is_met = work.target[i], abs(work.target[i]), False
        for k in range(p):
            left -= work.rows[i, k] * room.point[k]
            reach += abs(work.rows[i, k]) * most
            is_met |= basis[k] == i
        if not is_met and abs(left) <= ROUNDING * reach:
            return False
        sign = 0.0 if is_met else 1.0 if left > 0.0 else -1.0
        for k in range(p):
            work.sums[k] += sign * work.scaled[i, k]
    return True


@compiled_no_refcount
def _conclude(columns: Matrix, size: float, work: Work) -> float:
    """The certificate, by the inverse of the basis of the scaled columns."""
    inverse, basis, worst = work.descent.inverse, work.basis, 0.0
    p = basis.size
    for k in range(p):
        for j in range(p):
            work.genes[k] += inverse[k, j] * work.target[basis[j]] * size / work.scale[k]
            work.needed[k] -= inverse[j, k] * work.sums[j]
    for k in range(p):
        total = work.sums[k] * work.scale[k]
        for j in range(p):
            total += min(max(work.needed[j], -1.0), 1.0) * columns[basis[j], k]
        worst = max(worst, abs(total) / work.extent[k])
    return worst
