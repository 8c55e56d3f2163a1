"""Find the exact minimum of the fitness: the least-absolute-deviations problem, solved to a vertex and proven optimal.

The result of the search is compared with this minimum: the difference is the optimiser gap. The remaining error is due
to the data.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from ga.lad.simplex import OPTIMAL, STALLED, descend
from ga.samples import check, resolution

if TYPE_CHECKING:
    from numpy.typing import NDArray

_RANK: Final = 1e-10
"""The fraction of a column's length that must be independent of the other columns; a column with less is ignored."""

_PERTURBATIONS: Final = (0.0, 1e-11, 1e-9, 1e-7)
"""Perturbations of the torque, relative to the mean torque, tried in turn until one gives a certificate; the second
already resolves ties.
"""

_ATTEMPTS: Final = (*((amount, False) for amount in _PERTURBATIONS), *((amount, True) for amount in _PERTURBATIONS))
"""The attempts to solve a problem: the perturbation, and whether a stalled descent is repeated with more rows.

The repetition concerns a descent that used only the rows near an estimate; it takes longer than another perturbation.
"""

_ALL: Final = 4000
"""The largest number of rows for which a descent over all rows takes less time than to select the rows that matter."""

_FEWEST: Final = 1000
"""The same if genes close to the optimum are given."""

_SOME: Final = 2000
_PART: Final = 16
"""An estimate of the optimum needs about `_SOME` of the rows, or one row in `_PART` if that is more."""

_SPREAD: Final = 4.0
"""The distance from an estimate within which the optimum is searched, in approximate standard errors of the
estimate.
"""

_DISTINCT: Final = 1e-3
"""The fraction of a column's length, independent of the other columns, above which orthogonalisation once is precise
enough.
"""

_ROUNDING: Final = 64.0 * float(np.finfo(np.float64).eps)
_PROVEN: Final = 1e-9
_ALONE: Final = 1.0 - 1e-9
"""_PROVEN: the certificate below which an optimum is proven. _ALONE: the multipliers below which the optimum is
unique.
"""


@dataclass(frozen=True, eq=False)
class Optimum:
    """The least mean absolute error, and the chromosome that has it.

    genes: (p,), SI; a parameter whose column adds nothing (zero, or a combination of others) is zero.
    fitness: the mean absolute error, N m.
    certificate: the proof that the error is the least. With signs s in -1 ... 1, equal to the sign of every residual
        that is not zero, the subgradient is columns^T s. The certificate is the largest component of the subgradient,
        divided by sum |column|. If it is zero to rounding, the genes are optimal.
    unique: whether no other chromosome is as good; False also if that could not be proven.
    floor: the smallest divisor of `relative_gap`, N m.
    """

    genes: NDArray[np.float64]
    fitness: float
    certificate: float
    unique: bool
    floor: float

    def relative_gap(self, fitness: float) -> float:
        """Return how much worse `fitness`, N m, is than the optimum, relative to the optimum. fitness: a result of
        `fitness_of`.
        """
        return (fitness - self.fitness) / max(self.fitness, self.floor)


def least_absolute_deviations(
    columns: NDArray[np.float64], torque: NDArray[np.float64], near: NDArray[np.float64] | None = None
) -> Optimum:
    """Return the chromosome of least mean absolute error for columns (n, p) and torque (n,), N m, without bounds.

    Any n, any p up to about 8; rows may be tied or repeated, columns zero or collinear, n less than p. near: genes
    (p,), SI, that are probably close to the optimum: the closer, the faster the solution. Raises ValueError if the data
    are not finite, not of equal length or empty, RuntimeError if no certificate could be reached.
    """
    check(columns, torque)
    scaled = columns.T.copy()  # each column contiguous, because a processor computes several neighbours at once
    sizes = np.abs(scaled)
    scale, extent = sizes.max(axis=1), sizes.sum(axis=1)
    scale[scale == 0.0] = extent[extent == 0.0] = 1.0
    size = float(np.mean(np.abs(torque))) or 1.0
    scaled /= scale[:, None]
    rows, kept = _whiten(scaled)
    if not kept.size:
        return Optimum(np.zeros(len(scale)), float(np.mean(np.abs(torque))), 0.0, False, resolution(torque))
    target = torque / size
    start = _weighted_sum(rows, target if near is None else _times(scaled, near * scale / size)) / len(target)
    best: Optimum | None = None
    for amount, patient in _ATTEMPTS:
        if best is not None and patient:
            break
        moved = target + amount * np.random.default_rng(0).uniform(-1.0, 1.0, len(torque)) if amount else target
        basis = _solve(rows, moved, start, is_near=near is not None, patient=patient)
        if basis is None:
            continue
        # the perturbation ends here: the vertex is that of the data as they are
        genes = np.zeros(len(scale))
        genes[kept] = np.linalg.solve(scaled[:, basis][kept].T, target[basis])
        certificate, unique = _certify(scaled, basis, _signs(rows, target, moved, basis), extent / scale)
        if best is None or certificate < best.certificate:
            genes *= size / scale
            best = Optimum(genes, fitness_of(columns, torque, genes), certificate, unique, resolution(torque))
        if best.certificate <= _PROVEN:
            break
    if best is None:
        raise RuntimeError("no optimal vertex was found: the columns are too nearly collinear")
    return best


def not_negative(
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    positive: tuple[int, ...],
    near: NDArray[np.float64] | None = None,
) -> Optimum:
    """Return the chromosome of least mean absolute error in which no gene with an index in `positive` is negative.

    The error is convex, so it falls on the way from the bounded optimum to the unbounded one. If the unbounded optimum
    has negative genes, at least one of these genes is zero in the bounded optimum. Each of them is set to zero in turn,
    until no gene is negative. Genes that are zero in `near` are tried as zeros first. If columns are dependent and rows
    few, the best may be missed (5 of 47,000 random problems of up to 13 rows). The fields `unique` and `certificate` of
    the result assume that the genes at zero are zero. Raises ValueError, RuntimeError.
    """
    if near is not None and (held := _as_nearby(columns, torque, positive, near)) is not None:
        return held
    found = least_absolute_deviations(columns, torque, near)
    if not any(found.genes[k] < 0.0 for k in positive):
        return found
    best, left, seen = None, [(frozenset[int](), found)], set[frozenset[int]]()
    while left:
        zero, found = left.pop()
        below = [k for k in positive if found.genes[k] < 0.0]
        if best is not None and found.fitness >= best.fitness:
            continue
        best = best if below else found
        for more in (zero | {k} for k in below):
            if more not in seen:
                seen.add(more)
                left.append((more, _without(columns, torque, sorted(more), found.genes)))
    return best or found  # the last to be left out are all of them, and then none is below zero


def _as_nearby(
    columns: NDArray[np.float64], torque: NDArray[np.float64], positive: tuple[int, ...], near: NDArray[np.float64]
) -> Optimum | None:
    """Return the optimum in which the genes that are zero in `near` are zero, if it is the bounded optimum; else None.

    It is the bounded optimum if the error does not fall when one of these genes rises; the multipliers of the active
    rows show this.
    """
    zero = [k for k in positive if near[k] == 0.0]
    if not zero:
        return None
    others = np.setdiff1d(np.arange(columns.shape[1]), zero)
    if not 0 < len(others) <= len(torque):
        return None
    found = _without(columns, torque, zero, near)
    residuals = torque - columns @ found.genes
    if any(found.genes[k] < 0.0 for k in positive):
        return None
    met = np.argpartition(np.abs(residuals), len(others) - 1)[: len(others)]
    signs = np.sign(residuals)
    signs[met] = 0.0
    rest = signs @ columns
    try:
        signs[met] = np.linalg.solve(columns[np.ix_(met, others)].T, -rest[others])
    except np.linalg.LinAlgError:
        return None
    falls = rest[zero] + columns[met][:, zero].T @ signs[met]
    return found if np.all(np.abs(signs[met]) <= 1.0) and np.all(falls <= 0.0) else None


def _without(
    columns: NDArray[np.float64], torque: NDArray[np.float64], zero: list[int], near: NDArray[np.float64]
) -> Optimum:
    """Return the optimum among the chromosomes in which the genes with the indices `zero` are zero."""
    kept = np.setdiff1d(np.arange(columns.shape[1]), zero)
    genes = np.zeros(columns.shape[1])
    if not kept.size:
        return Optimum(genes, fitness_of(columns, torque, genes), 0.0, True, resolution(torque))
    found = least_absolute_deviations(np.ascontiguousarray(columns[:, kept]), torque, near[kept])
    genes[kept] = found.genes
    return replace(found, genes=genes)


def fitness_of(columns: NDArray[np.float64], torque: NDArray[np.float64], genes: NDArray[np.float64]) -> float:
    """Return the mean absolute error, N m, of genes (p,), summed in the same order as that of the optimum.

    Sums in another order differ by rounding, which is a large part of the optimum if the data are free of noise.
    """
    return float(np.mean(np.abs(torque - np.einsum("nk,k->n", columns, genes))))


def _signs(
    rows: NDArray[np.float64], torque: NDArray[np.float64], moved: NDArray[np.float64], basis: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the sign (n,) of each residual, 0 for rows of the basis.

    If a residual is zero to rounding, its sign is that of the residual with the perturbed torque `moved`.
    """
    inverse = np.linalg.inv(rows[:, basis].T)
    point, extent = inverse @ torque[basis], np.abs(inverse) @ np.abs(torque[basis])
    residual = torque - _times(rows, point)
    signs, sizes = np.sign(residual), np.abs(residual)
    # no row is longer than all columns together, so that few rows need a closer look
    most = float(np.abs(torque).max()) + float(np.sqrt(rows.size) * extent.max())
    close = np.flatnonzero(sizes <= _ROUNDING * most)
    # entries that cancel to zero have an error too: bounded by the rows' length, not by the entries
    rounding = _ROUNDING * (np.abs(torque[close]) + np.abs(rows[:, close]).sum(axis=0) * float(extent.max()))
    tied = close[sizes[close] <= rounding]
    signs[tied] = np.sign(moved[tied] - _times(rows[:, tied], inverse @ moved[basis]))
    signs[basis] = 0.0
    return signs


def _certify(
    scaled: NDArray[np.float64], basis: NDArray[np.int64], signs: NDArray[np.float64], extent: NDArray[np.float64]
) -> tuple[float, bool]:
    """Return the certificate of an optimum, and whether it is unique, from the signs (n,) of the residuals outside the
    basis.

    scaled (p, n): the columns, of largest value 1. extent (p,): the sums of their absolute values, not zero.
    """
    full = len(basis) == len(scaled)
    met, rest = scaled[:, basis], _weighted_sum(scaled, signs)
    needed = -(np.linalg.solve(met, rest) if full else np.linalg.lstsq(met, rest, rcond=None)[0])
    violation = np.abs(rest + met @ needed.clip(-1.0, 1.0)) / extent
    return float(violation.max()), full and bool(np.all(np.abs(needed) < _ALONE))


def _whiten(scaled: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the independent ones (r, n) of columns (p, n), made orthogonal and of length sqrt(n), and their indices.

    Clearly distinct columns need one Cholesky decomposition, others are treated one by one.
    """
    gram = scaled @ scaled.T
    lengths = np.sqrt(gram.diagonal())
    if (lengths > 0.0).all():
        try:
            triangle = np.linalg.cholesky(gram / np.outer(lengths, lengths))
        except np.linalg.LinAlgError:
            return _orthogonal(scaled)
        if triangle.diagonal().min() > _DISTINCT:
            into = np.sqrt(scaled.shape[1]) * np.linalg.inv(triangle) / lengths
            return into @ scaled, np.arange(len(scaled))
    return _orthogonal(scaled)


def _orthogonal(scaled: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return what `_whiten` returns, computed by Gram-Schmidt with column exchange; each column is orthogonalised
    twice.

    The rank follows from the length of a column that remains after this.
    """
    work = scaled.copy()
    lengths = np.sqrt(np.einsum("kn,kn->k", work, work))
    work /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    order = np.arange(len(work))
    rank = 0
    while rank < min(scaled.shape):
        left = np.einsum("kn,kn->k", work[rank:], work[rank:])
        pivot = rank + int(np.argmax(left))
        if not np.sqrt(left.max()) > _RANK:
            break
        if pivot != rank:
            work[[rank, pivot]], order[[rank, pivot]] = work[[pivot, rank]], order[[pivot, rank]]
        for j in range(rank):
            work[rank] -= np.einsum("n,n", work[j], work[rank]) * work[j]
        work[rank] /= np.sqrt(np.einsum("n,n", work[rank], work[rank]))
        for j in range(rank + 1, len(work)):
            work[j] -= np.einsum("n,n", work[rank], work[j]) * work[rank]
        rank += 1
    return work[:rank] * np.sqrt(scaled.shape[1]), order[:rank]


def _solve(
    rows: NDArray[np.float64], torque: NDArray[np.float64], start: NDArray[np.float64], *, is_near: bool, patient: bool
) -> NDArray[np.int64] | None:
    """Return the optimal basis (r,) of all rows (r, n), searched from the point start (r,); None if the descent stalls.

    is_near: whether the start is probably close to the optimum. patient: whether a descent that stalls with a part of
    the rows is repeated with more rows, up to all.
    """
    r, n = rows.shape
    if is_near and n > _FEWEST and (basis := _bracketed(rows, torque, start, n, once=True)) is not None:
        return basis
    if n <= _ALL:
        status, basis = descend(rows, torque, np.zeros(r), start)
        return basis if status == OPTIMAL else None
    some = _sample(n, max(_SOME, n // _PART))
    basis = _solve(rows.take(some, axis=1), torque[some], start, is_near=False, patient=patient)
    if basis is None:
        return None
    centre = np.asarray(np.linalg.solve(rows[:, some[basis]].T, torque[some[basis]]), np.float64)
    return _bracketed(rows, torque, centre, len(some), patient=patient)


@lru_cache(maxsize=8)  # a search asks for it thousands of times, and drawing takes as long as a descent
def _sample(n: int, count: int) -> NDArray[np.int64]:
    """Return the indices of about `count` of n rows: one at random out of every few, because a fixed stride could beat
    with a periodic excitation.
    """
    step = n // count
    return np.arange(n // step) * step + np.random.default_rng(1).integers(0, step, n // step)


def _bracketed(
    rows: NDArray[np.float64],
    torque: NDArray[np.float64],
    centre: NDArray[np.float64],
    count: int,
    *,
    once: bool = False,
    patient: bool = False,
) -> NDArray[np.int64] | None:
    """Return the optimal basis, searched with the rows that can change sign around the centre (r,), in growing regions.

    centre: an estimate of the optimum, as good as one from `count` rows. once: whether only the first region is
    searched. patient: whether a stalled descent is repeated with more rows.
    """
    residual = torque - _times(rows, centre)
    sizes, lengths = np.abs(residual), np.sqrt(np.einsum("kn,kn->n", rows, rows))
    reach = _SPREAD * float(np.mean(sizes)) * np.sqrt(len(centre) / count)
    while True:
        # within `reach` of the centre these rows keep their sign (Cauchy-Schwarz): together they are one linear term
        settled = sizes > reach * lengths
        pull = _weighted_sum(rows, np.where(settled, np.sign(residual), 0.0))
        open_rows = np.flatnonzero(~settled)
        status, found = descend(rows.take(open_rows, axis=1), torque[open_rows], pull, centre)
        if status == STALLED and not patient:
            return None
        if status == OPTIMAL:
            basis = open_rows[found]
            met = rows[:, basis].T
            if _is_vertex(met) and np.linalg.norm(np.linalg.solve(met, torque[basis]) - centre) <= reach:
                return basis
        if once or not settled.any():
            return None
        reach = 4.0 * max(reach, 1e-300)


def _is_vertex(basis: NDArray[np.float64]) -> bool:
    """Return whether the rows (r, r) of a basis are independent; the few rows used in `_bracketed` may not be."""
    return bool(np.linalg.cond(basis) < 1.0 / _RANK)


def _times(rows: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the product (n,) of a vector (r,) and rows (r, n), computed in one thread.

    For so few columns the threads of a linear-algebra library take more time than they save, and on a busy machine many
    times more.
    """
    return np.asarray(np.einsum("k,kn->n", vector, rows))


def _weighted_sum(rows: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum (r,) of rows (r, n), each multiplied by its weight (n,), computed in one thread."""
    return np.asarray(np.einsum("kn,n->k", rows, weights))
