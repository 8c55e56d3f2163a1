"""Find the exact optimum of data that do not fit in memory, by summing all rows whose residual keeps its sign.

After Portnoy and Koenker, The Gaussian Hare and the Laplacian Tortoise (1997): a random subsample locates the optimum
to within a few of its own standard errors. In a ball around this estimate most residuals cannot change sign, and the
sum of their absolute values is one linear function, which a single row represents. The reduced problem is of the same
kind with a thousandth of the rows. If its optimum lies in the ball, it is the optimum of all the data, because both
functions are convex and equal in the ball; otherwise a larger ball around it is used, and the data are read again.
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
"""A function that reads columns (m, p) and torque (m,), N m, in blocks of any number of rows, in order; it can be
called many times.
"""

_SUBSAMPLE: Final = 200_000
_SHARE: Final = 0.01
"""_SUBSAMPLE: the number of rows that are drawn at random. _SHARE: the same as a fraction of all rows, used if that
gives more rows: the subsample then takes as much time as the rows that remain after the reduction.
"""

_SIGMAS: Final = 6.0
"""The radius of the ball in standard errors of the subsample's optimum."""

_WIDER: Final = 8.0
_ATTEMPTS: Final = 6


@dataclass(frozen=True, eq=False)
class Reduced:
    """The data reduced to about a thousandth of their rows: columns (m, p), torque (m,), N m.

    The first row is the sum of all rows whose residual keeps its sign. length: the number of rows of all data, over
    which means are taken. optimum: the optimum of all data. The mean absolute error of the reduced rows times `share`
    equals the fitness of all data in a ball around the optimum, and is never larger elsewhere. start: the region around
    the subsample's optimum in which a search of the reduced rows may begin; None if no rows were removed, or a column
    is zero.
    """

    columns: Matrix
    torque: Vector
    length: int
    optimum: Optimum
    start: Start | None = None

    @property
    def share(self) -> float:
        """Return the number of reduced rows divided by the number of all rows."""
        return len(self.torque) / self.length

    def compared(self, genes: Vector) -> tuple[Optimum, float]:
        """Return the optimum, and the optimiser gap: how much worse genes (p,) are, relative to the optimum, never
        negative.

        Genes can be better than the optimum only by rounding, as small as the distance to the proven optimum; then they
        replace the optimum.
        """
        fitness = fitness_of(self.columns, self.torque, genes) * self.share
        better = fitness < self.optimum.fitness
        optimum = replace(self.optimum, genes=genes, fitness=fitness) if better else self.optimum
        return optimum, optimum.relative_gap(fitness)


def reduce(blocks: Blocks, rows: int, positive: tuple[int, ...] = ()) -> Reduced:
    """Reduce `rows` rows in `blocks` around their exact least-absolute-deviations optimum.

    positive: indices of genes that must not be negative. The data are read twice, and once more each time that the ball
    was too small. Raises ValueError for data that are not finite or empty, RuntimeError if no ball contained the
    optimum.
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
    """Return the whitening (p, p) of the columns of all rows, columns and torque of some rows drawn at random, and 1e-6
    of the mean |torque|, N m.
    """
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
    """Return the largest likely distance between the optimum of all rows and that of the subsample, in whitened
    coordinates.

    The variance of a median's estimate is 1/(4 f(0)^2 m) in each coordinate (Koenker 2005, section 4.2). Rows were
    drawn at random, so correlation in time does not matter.
    """
    residuals = np.abs(torque - columns @ genes)
    near = np.quantile(residuals, min(1.0, 4.0 / len(torque) ** (1.0 / 3.0)))
    sigma = float(near / np.mean(residuals <= near)) / np.sqrt(len(torque)) if near > 0.0 else 0.0
    size = float(np.abs(torque).max())
    return _SIGMAS * float(np.sqrt(columns.shape[1])) * max(sigma, 1e-12 * size)


def _start(genes: Vector, whitening: Matrix, radius: float) -> Start | None:
    """Return the cube inside the ball of this radius around `genes`, as the region in which a search begins. whitening
    (p, p): its coordinates.
    """
    p = len(genes)
    if np.linalg.matrix_rank(whitening) < p:
        return None
    # an orthogonal turn makes the whitening triangular, and leaves the columns orthogonal
    forward: Matrix = np.linalg.qr(np.linalg.inv(whitening))[1]
    return Start(genes, forward, np.asarray(np.linalg.inv(forward), np.float64), radius / float(np.sqrt(p)))


def _collapse(blocks: Blocks, genes: Vector, whitening: Matrix, radius: float) -> tuple[Matrix, Vector]:
    """Return the rows that may change sign within `radius` of `genes`, preceded by one row that represents all
    others.
    """
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
    """Mark the rows that may change sign in `undecided`; add torque and columns of the others, multiplied by their
    sign, to `settled`.
    """
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
