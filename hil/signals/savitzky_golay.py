"""Value, slope and curvature of a reading by a polynomial fitted to its neighbourhood (Savitzky and Golay 1964).

It has no phase shift, time stamps need not be even, and its gain is one up to a frequency set by the window's width.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_inline, compiled_no_refcount

Array = NDArray[np.float64]

DEGREE = 7
"""The polynomial's: high, so that a wide window, which averages noise, has a flat gain over the excited band."""

LEAST = (DEGREE + 1) // 2
"""The fewest neighbours a side: with fewer there are fewer readings than coefficients."""


def local_polynomial(time: Array, values: Array, half: int) -> tuple[Array, Array, Array]:
    """Return value, slope and curvature at every sample: three arrays (n,), in the values' unit, per s and per s^2.

    time (n,) s, rising; values (n,). A window is the sample and `half` neighbours a side; at the ends it is the first
    or last 2*half+1 samples, evaluated off its centre, where the noise is many times larger.
    """
    found, p = np.empty((3, len(time))), DEGREE + 1
    room = (np.empty(2 * p - 1), np.empty(2 * p - 1), np.empty((p, p)), np.empty(p), np.empty((3, p)))
    fit_all(np.ascontiguousarray(time), np.ascontiguousarray(values), half, found, room)
    return found[0], found[1], found[2]


def kernel(half: int, order: int) -> Array:
    """Return the weights (2*half+1,) of the derivative of that order, per sample^order, on an even grid."""
    offsets = np.arange(-half, half + 1, dtype=np.float64) / half
    weights = np.linalg.pinv(np.polynomial.chebyshev.chebvander(offsets, DEGREE))
    at_centre = [
        np.polynomial.chebyshev.chebval(0.0, np.polynomial.chebyshev.chebder(np.eye(DEGREE + 1)[k], order))
        for k in range(DEGREE + 1)
    ]
    return np.asarray(np.array(at_centre) @ weights / half**order)


def gain(half: int, order: int, cycles: float) -> float:
    """Return the gain of that derivative for a sine of `cycles` periods a sample, on an even grid."""
    offsets = np.arange(-half, half + 1, dtype=np.float64)
    omega = 2.0 * math.pi * cycles
    wave = np.cos(omega * offsets) if order % 2 == 0 else np.sin(omega * offsets)
    return float(kernel(half, order) @ wave) / omega**order * (-1.0 if order == 2 else 1.0)


def widest(order: int, cycles: float, most: int, tolerance: float) -> int:
    """Return the widest window, neighbours a side, whose gain at `cycles` periods a sample is 1 within `tolerance`."""
    half = LEAST
    while half < most and abs(gain(half + 1, order, cycles) - 1.0) <= tolerance:
        half += 1
    return half


@compiled_no_refcount
def fit_all(
    time: Array, values: Array, half: int, found: Array, room: tuple[Array, Array, Array, Array, Array]
) -> None:
    """`local_polynomial` in machine code, the results written to `found` (3, n). room: working space."""
    row, sums, normal, right, at = room
    count, width, p = time.size, 2 * half + 1, right.size
    for i in range(count):
        start = min(max(i - half, 0), count - width)
        middle = 0.5 * (time[start] + time[start + width - 1])
        scale = 0.5 * (time[start + width - 1] - time[start])
        base = values[i]
        _clear(sums)
        _clear(right)
        for j in range(width):
            _chebyshev((time[start + j] - middle) / scale, row)
            left = values[start + j] - base
            for k in range(row.size):
                sums[k] += row[k]
            for k in range(p):
                right[k] += row[k] * left
        for k in range(p):
            for m in range(k + 1):
                normal[k, m] = 0.5 * (sums[k + m] + sums[k - m])  # the product T_k T_m
        _solve(normal, right)
        _derivatives((time[i] - middle) / scale, at)
        for order in range(3):
            total = 0.0
            for k in range(p):
                total += at[order, k] * right[k]
            found[order, i] = total / scale**order
        found[0, i] += base


@compiled_inline
def _clear(values: Array) -> None:
    for k in range(values.size):
        values[k] = 0.0


@compiled_inline
def _chebyshev(x: float, row: Array) -> None:
    row[0], row[1] = 1.0, x
    for k in range(2, row.size):
        row[k] = 2.0 * x * row[k - 1] - row[k - 2]


@compiled_inline
def _derivatives(x: float, at: Array) -> None:
    """The basis at x, its slope and its curvature (3, p)."""
    at[0, 0], at[0, 1], at[1, 0], at[1, 1], at[2, 0], at[2, 1] = 1.0, x, 0.0, 1.0, 0.0, 0.0
    for k in range(2, at.shape[1]):
        at[0, k] = 2.0 * x * at[0, k - 1] - at[0, k - 2]
        at[1, k] = 2.0 * at[0, k - 1] + 2.0 * x * at[1, k - 1] - at[1, k - 2]
        at[2, k] = 4.0 * at[1, k - 1] + 2.0 * x * at[2, k - 1] - at[2, k - 2]


@compiled_inline
def _solve(normal: Array, right: Array) -> None:
    """Solve in place by Cholesky; the basis is so nearly orthogonal that no pivot is needed."""
    p = right.size
    for k in range(p):
        for m in range(k + 1):
            total = normal[k, m]
            for j in range(m):
                total -= normal[k, j] * normal[m, j]
            normal[k, m] = math.sqrt(max(total, 1e-300)) if m == k else total / normal[m, m]
    for k in range(p):
        for j in range(k):
            right[k] -= normal[k, j] * right[j]
        right[k] /= normal[k, k]
    for k in range(p - 1, -1, -1):
        for j in range(k + 1, p):
            right[k] -= normal[j, k] * right[j]
        right[k] /= normal[k, k]
