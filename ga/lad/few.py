"""The exact minimum of the usual case in a few compiled steps: distinct columns, nothing tied, not too many rows.

A search and a model selection solve ten thousand such problems, most of some hundred rows, where the calls of dozens of
array functions cost more than what they compute. All other cases are left to `ga.lad.exact`.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_no_refcount, compiled_within
from ga.lad.simplex import OPTIMAL, Basis, Matrix, Room, Vector, invert, room_for, step_down

DISTINCT: Final = 1e-3
"""A column of which this part of its length is its own, and more, needs no cleaning from the others."""

ROUNDING: Final = 64.0 * float(np.finfo(np.float64).eps)
PROVEN: Final = 1e-9
ALONE: Final = 1.0 - 1e-9
"""The certificate up to which an optimum is proven, and the multipliers below which it is the only one."""

MANY: Final = 40_000
"""Rows up to which about `_SOME` of them show well enough where the optimum of all is."""

_SOME: Final = 2000
_ALL: Final = 4000
"""Rows up to which a descent over all of them costs less than to find out which ones decide."""

_FEWEST: Final = 1000
"""Rows up to which it does so even with genes that are close."""

_SPREAD: Final = 4.0
"""How far from genes that are thought close the optimum is looked for, in about standard errors of it."""


def solve_few(
    columns: NDArray[np.float64], torque: NDArray[np.float64], near: NDArray[np.float64] | None
) -> tuple[NDArray[np.float64], float, bool] | None:
    """Return genes (p,), certificate and whether they are unique, as `ga.lad.exact.Optimum` has them.

    columns (n, p) and torque (n,), finite, and near (p,): as there. None where the case is not the usual one.
    """
    n, p = columns.shape
    genes, scale, extent, start, needed, sums = np.zeros((6, p))
    gram, into = np.zeros((2, p, p))
    scaled, rows = np.empty((n, p)), np.empty((p, n))
    target, found = np.empty(n), None
    columns, begin = np.ascontiguousarray(columns), np.array([] if near is None else near, dtype=np.float64)
    size = measure(columns, np.ascontiguousarray(torque), scale, extent, scaled, target, gram)
    if not (size > 0.0 and factor(gram, into)):
        return None
    turn(begin * scale[: begin.size] / size, scaled, into, rows, target, start)
    if begin.size and n > _FEWEST:
        found = _descended(rows, target, start, _SPREAD)
    if found is None and n <= _ALL:
        found = _descended(rows, target, start, np.inf)
    elif found is None and n <= MANY:
        some = _sample(n)
        rough = _descended(rows.take(some, axis=1), target[some], start, np.inf)
        found = rough and _descended(rows, target, rough[1].point, _SPREAD * np.sqrt(n / len(some)))
    if found is None:
        return None
    basis, room = found
    if not sum_by_sign(scaled, rows, target, room.point, room.inverse, basis, sums):
        return None
    certificate = conclude(scaled, target, basis, extent / scale, sums, needed, genes, room.met, room.inverse)
    genes *= size / scale
    return (genes, certificate, bool(np.abs(needed).max() < ALONE)) if certificate <= PROVEN else None


def _sample(n: int) -> Basis:
    """One row at random out of every so many: a fixed stride could beat with a periodic excitation."""
    step = n // _SOME
    return np.arange(n // step) * step + np.random.default_rng(1).integers(0, step, n // step)


def _descended(rows: Matrix, target: Vector, start: Vector, spread: float) -> tuple[Basis, Room] | None:
    """Return the optimal basis (r,), looked for among the rows (r, n) that decide near the start (r,); None: not there.

    spread: in about standard errors of an estimate from all rows, how far it may be away.
    """
    r, n = rows.shape
    pull, reach, open_rows, near = np.zeros(r), np.inf, None, rows
    if spread < np.inf:
        open_rows = np.empty(n, np.int64)
        reach, count = settle(rows, target, start, spread, np.empty(n), pull, open_rows)
        open_rows = open_rows[:count]
        near, target = rows.take(open_rows, axis=1), target[open_rows]
    basis, room = np.zeros(r, np.int64), room_for(len(target), r)
    if step_down(near, target, pull, start, basis, room) != OPTIMAL:
        return None
    basis = basis if open_rows is None else open_rows[basis]
    return (basis, room) if np.linalg.norm(room.point - start) <= reach else None


@compiled_no_refcount
def settle(  # noqa: PLR0917 - compiled functions take their parts by position
    rows: Matrix, target: Vector, start: Vector, spread: float, residual: Vector, pull: Vector, open_rows: Basis
) -> tuple[float, int]:
    """Fill in the rows whose residual may change its sign near the start, and add up those of the others by theirs.

    Within the distance returned the others keep their sign (Cauchy-Schwarz): together they are one linear term. Also
    returned: how many may change it. residual (n,): working space.
    """
    r, n = rows.shape
    total, count = 0.0, 0
    for i in range(n):
        met = 0.0
        for k in range(r):
            met += rows[k, i] * start[k]
        residual[i] = target[i] - met
        total += abs(residual[i])
    reach = spread * total / n * np.sqrt(r / n)
    for i in range(n):
        power = 0.0
        for k in range(r):
            power += rows[k, i] * rows[k, i]
        if abs(residual[i]) > reach * np.sqrt(power):
            sign = 1.0 if residual[i] > 0.0 else -1.0
            for k in range(r):
                pull[k] += sign * rows[k, i]
        else:
            open_rows[count] = i
            count += 1
    return reach, count


@compiled_no_refcount
def measure(  # noqa: PLR0917 - compiled functions take their parts by position
    columns: Matrix, torque: Vector, scale: Vector, extent: Vector, scaled: Matrix, target: Vector, gram: Matrix
) -> float:
    """Fill in the largest and the sum of each column's sizes (p,), the scaled columns, the torque of size 1, products.

    Arrays are passed one by one: a tuple of many takes several times as long to compile. Returns the mean size of the
    torque; 0 where it or a column is zero.
    """
    n, p = columns.shape
    size = 0.0
    for i in range(n):
        size += abs(torque[i]) / n
        for k in range(p):
            extent[k] += abs(columns[i, k])
            scale[k] = abs(columns[i, k]) if abs(columns[i, k]) > scale[k] else scale[k]
    for k in range(p):
        size = size if scale[k] > 0.0 else 0.0
    for i in range(n if size > 0.0 else 0):
        target[i] = torque[i] / size
        for k in range(p):
            part = columns[i, k] / scale[k]
            scaled[i, k] = part
            for j in range(k + 1):
                gram[k, j] += part * scaled[i, j] / n
    return size


@compiled_no_refcount
def factor(gram: Matrix, into: Matrix) -> bool:
    """Do the Cholesky decomposition in place, and find what makes its triangle the identity; False if too alike."""
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
def turn(near: Vector, scaled: Matrix, into: Matrix, rows: Matrix, target: Vector, start: Vector) -> None:  # noqa: PLR0917 - compiled functions take their parts by position
    """Fill in the orthogonal columns (p, n) and the start: the scaled genes `near`, (p,), or least squares if empty."""
    p, n = rows.shape
    for i in range(n):
        value = 0.0 if near.size else target[i]
        for k in range(near.size):
            value += scaled[i, k] * near[k]
        for k in range(p):
            part = 0.0
            for j in range(k + 1):
                part += scaled[i, j] * into[j, k]
            rows[k, i] = part
            start[k] += part * value / n


@compiled_no_refcount
def sum_by_sign(  # noqa: PLR0917 - compiled functions take their parts by position
    scaled: Matrix, rows: Matrix, target: Vector, point: Vector, inverse: Matrix, basis: Basis, sums: Vector
) -> bool:
    """Add up the scaled columns by the signs of the residuals outside the basis; False if one is zero to rounding."""
    p, n = rows.shape
    most, met = 0.0, _next_met(basis, 0, n)
    for k in range(p):
        entry = 0.0
        for j in range(p):
            entry += abs(inverse[k, j] * target[basis[j]])
        most = entry if entry > most else most  # entries of the point that cancel have an error too
    largest = 2.0 * p * np.sqrt(n) * most  # no entry of a column whose squares are 1 on average is above sqrt(n)
    for i in range(n):
        if i == met:
            met = _next_met(basis, i + 1, n)
            continue
        left = target[i]
        for k in range(p):
            left -= rows[k, i] * point[k]
        if abs(left) <= ROUNDING * (abs(target[i]) + largest):
            reach = abs(target[i])
            for k in range(p):
                reach += abs(rows[k, i]) * most
            if abs(left) <= ROUNDING * reach:
                return False
        sign = 1.0 if left > 0.0 else -1.0
        for k in range(p):
            sums[k] += sign * scaled[i, k]
    return True


@compiled_within
def _next_met(basis: Basis, first: int, n: int) -> int:
    """The first of the rows of the basis that is not before another one; n where there is none."""
    found = n
    for k in range(basis.size):
        if first <= basis[k] < found:
            found = basis[k]
    return found


@compiled_no_refcount
def conclude(  # noqa: PLR0917 - compiled functions take their parts by position
    scaled: Matrix,
    target: Vector,
    basis: Basis,
    extent: Vector,
    sums: Vector,
    needed: Vector,
    genes: Vector,
    met: Matrix,
    inverse: Matrix,
) -> float:
    """Fill in the multipliers and the scaled genes, (p,), by the inverse of the basis; return the certificate."""
    p, worst = basis.size, 0.0
    for j in range(p):
        for k in range(p):
            met[j, k] = scaled[basis[j], k]
            inverse[j, k] = 1.0 if j == k else 0.0
    if not invert(met, inverse):
        return np.inf
    for k in range(p):
        for j in range(p):
            genes[k] += inverse[k, j] * target[basis[j]]
            needed[k] -= inverse[j, k] * sums[j]
    for k in range(p):
        total = sums[k]
        for j in range(p):
            sign = 1.0 if needed[j] > 1.0 else -1.0 if needed[j] < -1.0 else needed[j]
            total += sign * scaled[basis[j], k]
        if not abs(total) / extent[k] <= worst:  # nor where it is not a number
            worst = abs(total) / extent[k]
    return worst
