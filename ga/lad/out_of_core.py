"""The exact optimum of data that do not fit in memory, by collapsing every row whose sign is settled.

After Portnoy and Koenker, The Gaussian Hare and the Laplacian Tortoise (1997): a random subsample locates the
optimum to within a few of its own standard errors. In a ball around it most residuals cannot change sign, and the
sum of their absolute values is one linear function, which a single row holds. What is left is a problem of the same
kind with a thousandth of the rows. If its optimum lies in the ball it is that of all the data, since both functions are
convex and the same there; if not, the ball is widened around it and the data are gone through again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_no_refcount
from ga.lad.exact import Optimum, fitness_of, not_negative
from ga.start import Start

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Blocks = Callable[[], Iterable[tuple[Matrix, Vector]]]
"""Columns (m, p) and torque (m,), N m, in blocks of any number of rows, in order, as often as they are asked for."""

_SUBSAMPLE: Final = 200_000
_SHARE: Final = 0.01
"""The fraction of all rows that is drawn, if that is more: the subsample then costs as much as the rows it leaves."""

_SIGMAS: Final = 6.0
"""The radius of the ball in standard errors of the subsample's optimum."""

_WIDER: Final = 8.0
_ATTEMPTS: Final = 6


@dataclass(frozen=True, eq=False)
class Reduced:
    """The data reduced to about a thousandth of their rows: columns (m, p), torque (m,), N m.

    The first row holds the sum of all rows with settled sign. length: the number of rows of the whole, over which means
    are taken. optimum: of the whole. The mean absolute error of these rows times `share` equals the fitness of the
    whole in a ball around the optimum, and is never larger elsewhere. start: the region in which a search of these rows
    may begin, around the subsample's optimum; None if all rows are here, or a column is zero.
    """

    columns: Matrix
    torque: Vector
    length: int
    optimum: Optimum
    start: Start | None = None

    @property
    def share(self) -> float:
        """Return the number of rows here over that of the whole."""
        return len(self.torque) / self.length

    def compared(self, genes: Vector) -> tuple[Optimum, float]:
        """Return the optimum, and how much worse genes (p,) are, relative to it: the optimiser gap, never negative.

        Genes can only be better by rounding, like the distance to the proven optimum; they then become the optimum.
        """
        fitness = fitness_of(self.columns, self.torque, genes) * self.share
        better = fitness < self.optimum.fitness
        optimum = replace(self.optimum, genes=genes, fitness=fitness) if better else self.optimum
        return optimum, optimum.relative_gap(fitness)


def reduce(blocks: Blocks, rows: int, positive: tuple[int, ...] = ()) -> Reduced:
    """Collapse `rows` rows in `blocks` around their least-absolute-deviations optimum, which is exact.

    positive: genes that are zero or more, in the optimum as in `not_negative`. The data are gone through twice, and
    once more for every time the ball was too small. Raises ValueError as `least_absolute_deviations`, RuntimeError
    where no ball held the optimum.
    """
    if rows <= _SUBSAMPLE:
        parts = list(blocks())
        columns, torque = np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
        return Reduced(columns, torque, rows, not_negative(columns, torque, positive))
    whitening, columns, torque, floor = _subsample(blocks, rows)
    genes = not_negative(columns, torque, positive).genes
    radius = _radius(columns, torque, genes)
    start = _start(genes, whitening, radius)
    for _ in range(_ATTEMPTS):
        columns, torque = _collapse(blocks, genes, whitening, radius)
        optimum = not_negative(columns, torque, positive)
        moved = float(np.linalg.norm(np.linalg.pinv(whitening) @ (optimum.genes - genes)))
        if moved < radius:
            share = len(torque) / rows
            whole = replace(optimum, fitness=optimum.fitness * share, floor=floor)
            return Reduced(columns, torque, rows, whole, start)
        genes, radius = optimum.genes, _WIDER * max(radius, moved)
    raise RuntimeError("the optimum could not be bracketed: the columns are too nearly collinear")


def _subsample(blocks: Blocks, rows: int) -> tuple[Matrix, Matrix, Vector, float]:
    """Whitening (p, p) of the columns of all rows, some rows drawn at random, and 1e-6 of the mean |torque|, N m."""
    rng, share = np.random.default_rng(0), max(_SUBSAMPLE / rows, _SHARE)
    drawn: list[tuple[Matrix, Vector]] = []
    gram, size = np.zeros((1, 1)), 0.0
    for columns, torque in blocks():
        gram = gram + columns.T @ columns
        size += float(np.abs(torque).sum())
        kept = rng.random(len(torque)) < share
        drawn.append((columns[kept], torque[kept]))
    values, vectors = np.linalg.eigh(gram / rows)
    # a direction in which no row has a component has no length: no row's sign depends on it
    lengths = np.where(values > 1e-20 * values[-1], 1.0 / np.sqrt(np.maximum(values, 1e-300)), 0.0)
    columns, torque = (np.concatenate(part) for part in zip(*drawn, strict=True))
    return vectors * lengths, columns, torque, 1e-6 * size / rows


def _radius(columns: Matrix, torque: Vector, genes: Vector) -> float:
    """Return how far the optimum of all rows may be from that of the subsample, in whitened coordinates.

    The variance of a median's estimate is 1/(4 f(0)^2 m) in each (Koenker 2005, section 4.2); rows were drawn at
    random, so that what follows what in the recording does not matter.
    """
    residuals = np.abs(torque - columns @ genes)
    near = np.quantile(residuals, min(1.0, 4.0 / len(torque) ** (1.0 / 3.0)))
    sigma = float(near / np.mean(residuals <= near)) / np.sqrt(len(torque)) if near > 0.0 else 0.0
    size = float(np.abs(torque).max())
    return _SIGMAS * float(np.sqrt(columns.shape[1])) * max(sigma, 1e-12 * size)


def _start(genes: Vector, whitening: Matrix, radius: float) -> Start | None:
    """The cube within the ball of some radius around `genes`."""
    p = len(genes)
    if np.linalg.matrix_rank(whitening) < p:
        return None
    # an orthogonal turn makes the whitening triangular, and leaves the columns orthogonal
    forward: Matrix = np.linalg.qr(np.linalg.inv(whitening))[1]
    return Start(genes, forward, np.asarray(np.linalg.inv(forward), np.float64), radius / float(np.sqrt(p)))


def _collapse(blocks: Blocks, genes: Vector, whitening: Matrix, radius: float) -> tuple[Matrix, Vector]:
    """Return the rows that may change sign within `radius` of `genes`, after one row that stands for all others."""
    settled = np.zeros(len(genes) + 1)
    kept: list[tuple[Matrix, Vector]] = []
    whitening = np.ascontiguousarray(whitening)
    for block in blocks():
        columns, torque = (np.require(array, np.float64, ["C", "W"]) for array in block)  # as is compiled for
        undecided, part = np.empty(len(torque), np.bool_), np.zeros(len(genes) + 1)
        settle(columns, torque, genes, whitening, radius, undecided, part)
        settled += part
        kept.append((columns[undecided], torque[undecided]))
    first = (settled[None, 1:], settled[:1])
    columns, torque = (np.concatenate(part) for part in zip(first, *kept, strict=True))
    return columns, torque


@compiled_no_refcount
def settle(  # noqa: PLR0917 - compiled functions take their parts by position
    columns: Matrix,
    torque: Vector,
    genes: Vector,
    whitening: Matrix,
    radius: float,
    undecided: NDArray[np.bool_],
    settled: Vector,
) -> None:
    """Mark the rows that may change sign; add the torque and the columns of the others, times their sign, up."""
    n, p = columns.shape
    for i in range(n):
        residual, length = torque[i], 0.0
        for k in range(p):
            residual -= columns[i, k] * genes[k]
            along = 0.0
            for j in range(p):
                along += columns[i, j] * whitening[j, k]
            length += along * along
        undecided[i] = abs(residual) <= radius * np.sqrt(length)
        if not undecided[i]:
            sign = 1.0 if residual >= 0.0 else -1.0
            settled[0] += sign * torque[i]
            for k in range(p):
                settled[k + 1] += sign * columns[i, k]
