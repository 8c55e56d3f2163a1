"""Find the exact minimum of the usual case in a few compiled steps: distinct columns, no ties, not too many rows.

A search and a model selection solve ten thousand such problems, most of some hundred rows, for which the calls of
dozens of array functions take longer than the computation itself. `ga.lad.exact` solves all other cases.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_no_refcount, compiled_within
from ga.lad.simplex import OPTIMAL, Basis, Matrix, Room, Vector, invert, room_for, step_down

DISTINCT: Final = 1e-3
"""The fraction of a column's length, independent of the other columns, above which orthogonalisation once is precise
enough.
"""

ROUNDING: Final = 64.0 * float(np.finfo(np.float64).eps)
PROVEN: Final = 1e-9
ALONE: Final = 1.0 - 1e-9
"""PROVEN: the certificate below which an optimum is proven. ALONE: the multipliers below which the optimum is
unique.
"""

MANY: Final = 40_000
"""The largest number of rows for which about `_SOME` of them give a good enough estimate of the optimum of all."""

_SOME: Final = 2000
_ALL: Final = 4000
"""The largest number of rows for which a descent over all rows takes less time than to select the rows that matter."""

_FEWEST: Final = 1000
"""The largest number of rows for which a descent over all rows takes less time even if genes close to the optimum are
given.
"""

_SPREAD: Final = 4.0
"""The distance from given genes within which the optimum is searched, in approximate standard errors of the optimum."""


def solve_few(
    columns: NDArray[np.float64], torque: NDArray[np.float64], near: NDArray[np.float64] | None
) -> tuple[NDArray[np.float64], float, bool] | None:
    """Return the genes (p,) of the optimum, its certificate (the proof in `ga.lad.exact.Optimum`) and whether it is
    unique.

    columns (n, p) and torque (n,), N m: the data, finite. near (p,): genes that are probably close to the optimum. None
    if the problem is not the usual case, so that another solver is needed.
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


@lru_cache(maxsize=8)  # a search asks for it thousands of times, and drawing takes as long as a descent
def _sample(n: int) -> Basis:
    """Return the indices of about `_SOME` of n rows: one at random out of every few, because a fixed stride could beat
    with a periodic excitation.
    """
    step = n // _SOME
    return np.arange(n // step) * step + np.random.default_rng(1).integers(0, step, n // step)


def _descended(rows: Matrix, target: Vector, start: Vector, spread: float) -> tuple[Basis, Room] | None:
    """Return the optimal basis (r,), searched with those of the rows (r, n) that may change sign near the start (r,).

    spread: the distance from the start within which the optimum is searched, in approximate standard errors of an
    estimate from all rows. None if the optimum is not within this distance.
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
    """List the rows whose residual may change its sign near the start in `open_rows`, and add the others, by sign, to
    `pull`.

    Within the returned distance of the start the other rows keep their sign (Cauchy-Schwarz): together they are one
    linear term. The number of listed rows is returned too. residual (n,): working space.
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
    """Fill in the largest (`scale`) and the sum (`extent`) of the absolute values of each column (p,), and scaled data.

    The scaled data are columns of largest value 1, the torque (`target`) of mean size 1, and the products of the
    columns (`gram`). Returns the mean absolute torque; 0 if the torque or a column is zero. Arrays are passed one by
    one, because a tuple of many takes several times as long to compile.
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
    """Replace `gram` by its Cholesky triangle, and fill `into` with the inverse of the triangle's transpose.

    Returns False if two columns are too similar.
    """
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
    """Fill in the orthogonal columns `rows` (p, n) and the start of the descent.

    The start is the scaled genes `near` (p,), or the least-squares solution if `near` is empty, in the new coordinates.
    """
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
    """Fill `sums` (p,) with the scaled columns, each row multiplied by the sign of its residual outside the basis;
    return False if a residual is zero to rounding.
    """
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
    """Return the smallest row number in the basis that is at least `first`; n if there is none."""
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
    """Fill in the multipliers (`needed`) and the scaled genes (p,), from the inverse of the basis; return the
    certificate.
    """
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
