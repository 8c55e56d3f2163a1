"""The fitness of a chromosome, equations 3 to 5, from either of two engines: the mean absolute error of the torque, N
m.

    fitness(genes) = 1/n * sum over i of |torque_i - columns_i . genes|

`ga.fitness.dense` computes every sample and is ready at once. `ga.fitness.cell_tree` learns the signs of the residuals
in each region, and then costs the same for a thousand samples and for ten million. Both agree to rounding. The compiled
loops take both as arguments, one of which is None: code for None is not compiled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from ga.compiled import compiled_within
from ga.fitness.cell_tree import tree_error, tree_tangent
from ga.fitness.cells import Tree, another, grow
from ga.fitness.dense import Samples, collapse, dense_error, dense_errors, dense_tangent, pack, shared

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ga.bounds import Bounds
    from ga.start import Start

Engine: TypeAlias = Samples | Tree

WORTHWHILE: Final = 1_000_000_000
"""The number of residuals in one search from which the cell tree saves more time than its first compilation takes."""

REPAID: Final = 50_000
"""The number of evaluations in one search from which the cell tree saves more time than growing it takes, for any
number of samples.

A search of the `default` preset ends earlier; its children spread everywhere in a cloud that shrinks as fast as the
cells.
"""


def engine_for(
    columns: NDArray[np.float64],
    torque: NDArray[np.float64],
    bounds: Bounds,
    evaluations: int,
    start: Start | None = None,
) -> Engine:
    """Return the faster engine for columns (n, p), torque (n,), N m, and this number of evaluations within the bounds.

    start: the region in which all evaluations begin. Raises ValueError if the data are not finite, not of equal length
    or empty.
    """
    if start is not None:
        return collapse(columns, torque, start)
    if evaluations < REPAID or len(torque) * evaluations < WORTHWHILE:
        return pack(columns, torque)
    return grow(columns, torque, bounds)


def fork(engine: Engine) -> Engine:
    """Return an engine over the same data for another thread, with separate working space."""
    return shared(engine) if isinstance(engine, Samples) else another(engine)


@compiled_within
def error_of(samples: Samples | None, tree: Tree | None, genes: NDArray[np.float64], limit: float) -> float:
    """Return equation 5 for one chromosome (p,), N m; the result may be infinite if the error exceeds the limit."""
    if samples is not None:
        return dense_error(samples, genes, limit)
    if tree is not None:
        return tree_error(tree, genes, limit)
    return np.nan


@compiled_within
def tangent_of(
    samples: Samples | None, tree: Tree | None, genes: NDArray[np.float64], limit: float, slope: NDArray[np.float64]
) -> float:
    """Return the height, N m, at a chromosome (p,) of a plane below the fitness; its slope (p,) is written to `slope`.

    The plane touches the fitness at the chromosome. If the fitness exceeds the limit, the plane exceeds the limit too,
    but may lie below the fitness.
    """
    if samples is not None:
        return dense_tangent(samples, genes, slope)
    if tree is not None:
        return tree_tangent(tree, genes, limit, slope)
    return np.nan


def parts(engine: Engine) -> tuple[Samples | None, Tree | None]:
    """Return (samples, None) or (None, tree), as the compiled loops take the engine."""
    return (engine, None) if isinstance(engine, Samples) else (None, engine)


def columns_of(engine: Engine) -> int:
    """Return p, the number of parameters."""
    return engine.blocks.shape[1] - 1 if isinstance(engine, Samples) else engine.origin.size


def evaluate_all(engine: Engine, genes: NDArray[np.float64], errors: NDArray[np.float64]) -> None:
    """Fill in the fitness, N m, of chromosomes (m, p)."""
    if isinstance(engine, Samples):
        dense_errors(engine, genes, errors)
    else:
        errors[:] = [tree_error(engine, chromosome, np.inf) for chromosome in genes]


def evaluate(engine: Engine, genes: NDArray[np.float64]) -> float:
    """Return the fitness, N m, of one chromosome (p,)."""
    genes = np.ascontiguousarray(genes)
    return dense_error(engine, genes, np.inf) if isinstance(engine, Samples) else tree_error(engine, genes, np.inf)
