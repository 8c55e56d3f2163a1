"""The dense engine: every sample is looked at, side by side in the vector units.

The sum is kept in 128 parallel parts whose order is fixed by the layout, not by the machine: the result is the same to
the last bit everywhere.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ga.compiled import lean_apart

if TYPE_CHECKING:
    from numpy.typing import NDArray

LANES = 128
"""Samples in a block: the number of partial sums."""

RESOLUTION = 1e-6
"""A fitness below this part of the mean absolute torque counts as none when two fitnesses are compared relatively.

Noise-free data have an optimum of zero, to which nothing is relatively close.
"""


class Samples(NamedTuple):
    """Columns and torque of one recording, ready to be evaluated.

    blocks: (ceil(n/128), p + 1, 128), the torque, then the columns, padded with zero rows, which add nothing to a sum.
    length: n. floor: N m, the least fitness that relative comparisons divide by. scratch: (2, 128), working space.
    """

    blocks: NDArray[np.float64]
    length: int
    floor: float
    scratch: NDArray[np.float64]


def check(columns: NDArray[np.float64], torque: NDArray[np.float64]) -> None:
    """Raise ValueError unless columns (n, p) and torque (n,) are finite, of equal length and not empty."""
    if columns.ndim != 2 or torque.ndim != 1 or len(columns) != len(torque):
        raise ValueError(f"columns {columns.shape} and torque {torque.shape} are not of shape (n, p) and (n,)")
    if 0 in columns.shape:
        raise ValueError(f"columns of shape {columns.shape}: there is nothing to fit")
    if not (np.isfinite(columns).all() and np.isfinite(torque).all()):
        raise ValueError("columns or torque hold NaN or infinite values: drop those rows first")


def pack(columns: NDArray[np.float64], torque: NDArray[np.float64]) -> Samples:
    """The samples of columns (n, p) and torque (n,), N m. Raises ValueError as `check` does."""
    check(columns, torque)
    count, p = columns.shape
    rows = -(-count // LANES)
    padded = np.zeros((p + 1, rows * LANES))
    padded[0, :count] = torque
    padded[1:, :count] = columns.T
    blocks = np.ascontiguousarray(padded.reshape(p + 1, rows, LANES).transpose(1, 0, 2))
    return Samples(blocks, count, resolution(torque), np.empty((2, LANES)))


def resolution(torque: NDArray[np.float64]) -> float:
    """The least fitness, N m, that relative comparisons divide by; 1e-300 where the torque is zero throughout."""
    return max(RESOLUTION * float(np.mean(np.abs(torque))), 1e-300)


@lean_apart
def dense_error(samples: Samples, genes: NDArray[np.float64]) -> float:
    """Equation 5 for one chromosome (p,), N m."""
    # plain indices and scalars: an iterated block or an indexed gene in the inner loop keeps it from the vector units
    total, residual = samples.scratch[0], samples.scratch[1]
    for j in range(LANES):
        total[j] = 0.0
    for b in range(samples.blocks.shape[0]):
        gene, torque, column = genes[0], samples.blocks[b, 0], samples.blocks[b, 1]
        if genes.size == 2:  # the paper's model, in one pass
            damping, rate = genes[1], samples.blocks[b, 2]
            for j in range(LANES):
                total[j] += abs(torque[j] - gene * column[j] - damping * rate[j])
            continue
        for j in range(LANES):
            residual[j] = torque[j] - gene * column[j]
        for k in range(1, genes.size):
            gene, column = genes[k], samples.blocks[b, k + 1]
            for j in range(LANES):
                residual[j] -= gene * column[j]
        for j in range(LANES):
            total[j] += abs(residual[j])
    error = 0.0
    for j in range(LANES):
        error += total[j]
    return error / samples.length


@lean_apart
def dense_tangent(samples: Samples, genes: NDArray[np.float64], slope: NDArray[np.float64]) -> float:
    """The fitness at a chromosome (p,), N m, and a subgradient (p,), written to `slope`."""
    for k in range(genes.size):
        slope[k] = 0.0
    for b in range(samples.blocks.shape[0]):
        for j in range(LANES):
            residual = samples.blocks[b, 0, j]
            for k in range(genes.size):
                residual -= samples.blocks[b, k + 1, j] * genes[k]
            for k in range(genes.size):
                slope[k] -= np.sign(residual) * samples.blocks[b, k + 1, j] / samples.length
    return dense_error(samples, genes)
