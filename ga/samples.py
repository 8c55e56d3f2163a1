"""The samples that are fitted: columns (n, p) and torque (n,), N m, and the least fitness that counts for them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

RESOLUTION: Final = 1e-6
"""A fitness below this part of the mean absolute torque counts as none when two fitnesses are compared relatively.

Noise-free data have an optimum of zero, to which nothing is relatively close.
"""


def check(columns: NDArray[np.float64], torque: NDArray[np.float64]) -> None:
    """Raise ValueError unless columns (n, p) and torque (n,) are finite, of equal length and not empty."""
    if columns.ndim != 2 or torque.ndim != 1 or len(columns) != len(torque):
        raise ValueError(f"columns {columns.shape} and torque {torque.shape} are not of shape (n, p) and (n,)")
    if 0 in columns.shape:
        raise ValueError(f"columns of shape {columns.shape}: there is nothing to fit")
    if not (np.isfinite(columns).all() and np.isfinite(torque).all()):
        raise ValueError("columns or torque hold NaN or infinite values: drop those rows first")


def resolution(torque: NDArray[np.float64]) -> float:
    """The least fitness, N m, that relative comparisons divide by; 1e-300 where the torque is zero throughout."""
    return max(RESOLUTION * float(np.mean(np.abs(torque))), 1e-300)
