"""Check the samples that are fitted, columns (n, p) and torque (n,), N m, cut them into lanes, and find the smallest
fitness that is not zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

RESOLUTION: Final = 1e-6
"""The fraction of the mean absolute torque below which a fitness is treated as zero in relative comparisons.

Noise-free data have an optimum of zero, to which nothing is relatively close.
"""

LANES: Final = 128
"""The number of samples in a block, which is the number of partial sums."""


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
