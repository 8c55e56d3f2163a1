"""Find the exact minimum of the fitness: the least-absolute-deviations problem, solved to a vertex and proven optimal.

The result of the search is compared with this minimum: the difference is the optimiser gap. The remaining error is due
to the data.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from ga.lad.few import ALONE, DISTINCT, MANY, PROVEN, ROUNDING, solve_few
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

_DIRECT: Final = 6000
"""The largest number of rows with which a descent begins; for more rows, an estimate from a subsample selects some of
them first.
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
    if (len(torque) <= MANY or near is not None) and (found := solve_few(columns, torque, near)) is not None:
        genes, certificate, unique = found
        return Optimum(genes, fitness_of(columns, torque, genes), certificate, unique, resolution(torque))
    sizes = np.abs(columns.T, order="C")
    scale, extent = sizes.max(axis=1), sizes.sum(axis=1)
    scale[scale == 0.0] = extent[extent == 0.0] = 1.0
    size = float(np.mean(np.abs(torque))) or 1.0
    rows, kept = _whiten(columns, scale)
    if not kept.size:
        return Optimum(np.zeros(len(scale)), float(np.mean(np.abs(torque))), 0.0, False, resolution(torque))
    target = torque / size
    start = target if near is None else _times(columns, near) / size
    best: Optimum | None = None
    for amount, patient in _ATTEMPTS:
        if best is not None and patient:
            break
        moved = target + amount * np.random.default_rng(0).uniform(-1.0, 1.0, len(torque)) if amount else target
        basis = _solve(rows, moved, _weighted_sum(rows, start) / len(rows), patient=patient)
        if basis is None:
            continue
        # the perturbation ends here: the vertex is that of the data as they are
        genes = np.zeros(len(scale))
        genes[kept] = np.linalg.solve(columns[np.ix_(basis, kept)] / scale[kept], target[basis])
        signs = _signs(rows, target, moved, basis)
        optimum = _certify(columns, torque, genes * size / scale, basis, signs, scale=scale, extent=extent)
        if best is None or optimum.certificate < best.certificate:
            best = optimum
        if best.certificate <= PROVEN:
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
    return float(np.mean(np.abs(torque - _times(columns, genes))))


def _signs(
    rows: NDArray[np.float64], torque: NDArray[np.float64], moved: NDArray[np.float64], basis: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the sign (n,) of each residual, 0 for rows of the basis.

    If a residual is zero to rounding, its sign is that of the residual with the perturbed torque `moved`.
    """
    inverse = np.linalg.inv(rows[basis])
    point, extent = inverse @ torque[basis], np.abs(inverse) @ np.abs(torque[basis])
    residual = torque - _times(rows, point)
    signs, sizes = np.sign(residual), np.abs(residual)
    # no row is longer than all columns together, so that few rows need a closer look
    most = float(np.abs(torque).max()) + float(np.sqrt(rows.size) * extent.max())
    close = np.flatnonzero(sizes <= ROUNDING * most)
    # entries that cancel to zero have an error too: bounded by the rows' length, not by the entries
    rounding = ROUNDING * (np.abs(torque[close]) + np.abs(rows[close]).sum(axis=1) * float(extent.max()))
    tied = close[sizes[close] <= rounding]
    signs[tied] = np.sign(moved[tied] - _times(rows[tied], inverse @ moved[basis]))
    signs[basis] = 0.0
    return signs


def _certify(
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    genes: NDArray[np.float64],
    basis: NDArray[np.int64],
    signs: NDArray[np.float64],
    *,
    scale: NDArray[np.float64],
    extent: NDArray[np.float64],
) -> Optimum:
    """Return the optimum with its proof, from the signs (n,) of the residuals outside the basis.

    scale and extent (p,): the largest and the sum of the absolute values of each column, 1 for a column of zeros.
    """
    full = len(basis) == columns.shape[1]
    met, rest = (columns[basis] / scale).T, _weighted_sum(columns, signs) / scale
    needed = -(np.linalg.solve(met, rest) if full else np.linalg.lstsq(met, rest, rcond=None)[0])
    signs[basis] = needed.clip(-1.0, 1.0)
    violation = np.abs(_weighted_sum(columns, signs)) / extent
    return Optimum(
        genes=genes,
        fitness=fitness_of(columns, torque, genes),
        certificate=float(violation.max()),
        unique=full and bool(np.all(np.abs(needed) < ALONE)),
        floor=resolution(torque),
    )


def _whiten(columns: NDArray[np.float64], scale: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return rows (n, r) of independent columns made orthogonal, each of length sqrt(n), and the indices of these
    columns.

    scale (p,): the largest absolute value of each column, which keeps squares in range. Clearly distinct columns need
    one Cholesky decomposition, others are treated one by one.
    """
    scaled = columns / scale
    gram = scaled.T @ scaled
    lengths = np.sqrt(gram.diagonal())
    if (lengths > 0.0).all():
        try:
            triangle = np.linalg.cholesky(gram / np.outer(lengths, lengths))
        except np.linalg.LinAlgError:
            return _orthogonal(columns, scale)
        if triangle.diagonal().min() > DISTINCT:
            into = np.sqrt(len(columns)) * np.linalg.inv(triangle).T / lengths[:, None]
            return scaled @ into, np.arange(len(scale))
    return _orthogonal(columns, scale)


def _orthogonal(
    columns: NDArray[np.float64], scale: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return what `_whiten` returns, computed by Gram-Schmidt with column exchange; each column is orthogonalised
    twice.

    The rank follows from the length of a column that remains after this.
    """
    work = np.divide(columns.T, scale[:, None], order="C")
    lengths = np.sqrt(np.einsum("kn,kn->k", work, work))
    work /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    order = np.arange(len(work))
    rank = 0
    while rank < min(columns.shape):
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
    return np.multiply(work[:rank].T, np.sqrt(len(columns)), order="C"), order[:rank]


def _solve(
    rows: NDArray[np.float64], torque: NDArray[np.float64], start: NDArray[np.float64], *, patient: bool
) -> NDArray[np.int64] | None:
    """Return the optimal basis of all rows (n, r), searched from the point start (r,); None if the descent stalls.

    patient: whether a descent that stalls with a part of the rows is repeated with more rows, up to all.
    """
    n, r = rows.shape
    if n <= _DIRECT:
        return _descend(rows, torque, np.zeros(r), start)[1]
    step = max(n // max(_DIRECT, n // 16), 2)
    count = n // step
    # one row at random out of every `step`: a fixed stride could beat with a periodic excitation
    sample = np.arange(count) * step + np.random.default_rng(1).integers(0, step, count)
    basis = _solve(rows[sample], torque[sample], start, patient=patient)
    if basis is None:
        return None
    centre = np.linalg.solve(rows[sample][basis], torque[sample][basis])
    return _bracketed(rows, torque, centre, count, patient=patient)


def _bracketed(
    rows: NDArray[np.float64], torque: NDArray[np.float64], centre: NDArray[np.float64], count: int, *, patient: bool
) -> NDArray[np.int64] | None:
    """Return the optimal basis, searched with the rows that can change sign around the centre (r,), in growing regions.

    centre: an estimate of the optimum from `count` rows. patient: whether a stalled descent is repeated with more rows.
    """
    r = len(centre)
    residual = torque - _times(rows, centre)
    reach = 4.0 * float(np.mean(np.abs(residual))) * np.sqrt(r / count)
    lengths = np.sqrt(np.einsum("nk,nk->n", rows, rows))
    while True:
        # within `reach` of the centre these rows keep their sign (Cauchy-Schwarz): together they are one linear term
        settled = np.abs(residual) > reach * lengths
        pull = _weighted_sum(rows, np.where(settled, np.sign(residual), 0.0))
        open_rows = np.flatnonzero(~settled)
        status, found = _descend(rows[open_rows], torque[open_rows], pull, centre)
        if status == STALLED and not patient:
            return None
        if found is not None:
            basis = open_rows[found]
            if (
                _is_vertex(rows[basis])
                and np.linalg.norm(np.linalg.solve(rows[basis], torque[basis]) - centre) <= reach
            ):
                return basis
        if not settled.any():
            return None
        reach = 4.0 * max(reach, 1e-300)


def _is_vertex(basis: NDArray[np.float64]) -> bool:
    """Return whether the rows (r, r) of a basis are independent; the few rows used in `_bracketed` may not be."""
    return bool(np.linalg.cond(basis) < 1.0 / _RANK)


def _times(rows: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the product (n,) of rows (n, p) and a vector (p,), computed in one thread.

    For so few columns the threads of a linear-algebra library take more time than they save, and on a busy machine many
    times more.
    """
    return np.asarray(np.einsum("nk,k->n", rows, vector))


def _weighted_sum(rows: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum (p,) of rows (n, p), each multiplied by its weight (n,), computed in one thread."""
    return np.asarray(np.einsum("nk,n->k", rows, weights))


def _descend(
    rows: NDArray[np.float64], torque: NDArray[np.float64], pull: NDArray[np.float64], start: NDArray[np.float64]
) -> tuple[int, NDArray[np.int64] | None]:
    status, basis = descend(np.ascontiguousarray(rows.T), torque, pull, start)
    return status, basis if status == OPTIMAL else None
