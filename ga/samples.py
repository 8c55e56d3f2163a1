"""Check the samples that are fitted, columns (n, p) and torque (n,), N m, cut them into lanes, and find the smallest
fitness that is not zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from ga.compiled import compiled_too, compiled_within

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Vector = NDArray[np.float64]
    Matrix = NDArray[np.float64]

RESOLUTION: Final = 1e-6
"""The fraction of the mean absolute torque below which a fitness is treated as zero in relative comparisons.

Noise-free data have an optimum of zero, to which nothing is relatively close.
"""

LANES: Final = 128
"""The number of samples in a block, which is the number of partial sums."""

AT_ONCE: Final = LANES << 6
"""The number of rows that are computed at a time: their working space stays in the processor's cache."""


def check(columns: NDArray[np.float64], torque: NDArray[np.float64]) -> None:
    """Raise ValueError unless columns (n, p) and torque (n,) are finite, of equal length and not empty."""
    if columns.ndim != 2 or torque.ndim != 1 or len(columns) != len(torque):
        raise ValueError(f"columns {columns.shape} and torque {torque.shape} are not of shape (n, p) and (n,)")
    if 0 in columns.shape:
        raise ValueError(f"columns of shape {columns.shape}: there is nothing to fit")
    if not (np.isfinite(columns).all() and np.isfinite(torque).all()):
        raise ValueError("columns or torque hold NaN or infinite values: drop those rows first")


def resolution(torque: NDArray[np.float64]) -> float:
    """Return the smallest divisor, N m, in relative comparisons of fitness; 1e-300 if the torque is zero throughout."""
    return max(RESOLUTION * float(np.mean(np.abs(torque))), 1e-300)


def in_lanes(*rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return k rows (m,) cut into lanes, (k, ceil(m/128), 128), filled up with zeros."""
    count = len(rows[0])
    padded = np.empty((len(rows), -(-count // LANES) * LANES))
    for row, values in zip(padded, rows, strict=True):
        row[:count] = values
    padded[:, count:] = 0.0
    return padded.reshape(len(rows), -1, LANES)


@compiled_too
def in_order(lanes: NDArray[np.float64]) -> float:
    """Return the sum of the lanes (128,), added one after another: the same to the last bit on every machine."""
    total = 0.0
    for value in lanes:
        total += value
    return total


@compiled_within
def load_block(columns: Matrix, torque: Vector, centre: Vector, block: Matrix) -> None:
    """Copy up to 128 rows to the lanes of a block, filled up with zeros: p columns, then the residuals at the centre
    (p,), N m.
    """
    residual = block[centre.size]
    _load_lanes(torque, residual)
    for k in range(centre.size):
        column, gene = block[k], centre[k]
        _load_lanes(columns[:, k], column)
        for i in range(LANES):
            residual[i] -= gene * column[i]


@compiled_within
def _load_lanes(values: Vector, lanes: Vector) -> None:
    for i in range(values.size):
        lanes[i] = values[i]
    for i in range(values.size, LANES):
        lanes[i] = 0.0


@compiled_within
def carry(part: Matrix, total: Matrix) -> None:
    """Add the sums in lanes of some blocks (terms, 128) to the total, and set them to zero."""
    for t in range(len(total)):
        for i in range(LANES):
            total[t, i] += part[t, i]
            part[t, i] = 0.0
