"""Value, slope and curvature of a reading by a polynomial fitted to its neighbourhood (Savitzky and Golay 1964).

It has no phase shift, time stamps need not be even, and its gain is one up to a frequency set by the window's width.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ga.compiled import compiled_inline, compiled_no_refcount

Array = NDArray[np.float64]

DEGREE = 7
"""The polynomial's: high, so that a wide window, which averages noise, has a flat gain over the excited band."""

LEAST = (DEGREE + 1) // 2
"""The fewest neighbours a side: with fewer there are fewer readings than coefficients."""

_SHARE: Final = 4
"""Windows that share their sums reach this part of half a window further than one does, at the most."""

_WIDER: Final = 1.3
"""How much longer than the shortest of its windows a block may be: beside a gap in time it holds fewer of them."""

_PART: Final = 1 << 15
"""Samples for a thread at a time."""


def local_polynomial(time: Array, values: Array, half: int, order: int) -> Array:
    """Return the derivative of that order, 0 to 2, at every sample: (n,), in the values' unit per s^order.

    time (n,) s, rising; values (n,). A window is the sample and `half` neighbours a side; at the ends it is the first
    or last 2*half+1 samples, evaluated off its centre, where the noise is many times larger.
    """
    time, values, ends = np.ascontiguousarray(time), np.ascontiguousarray(values), 2 * half + 1
    if len(time) <= 2 * ends or not _is_even(time):
        return _fitted(time, values, half, order)
    found = np.empty(len(time))
    found[:ends] = _fitted(time[: 2 * ends], values[: 2 * ends], half, order)[:ends]
    found[-ends:] = _fitted(time[-2 * ends :], values[-2 * ends :], half, order)[-ends:]
    weights = kernel(half, order) * ((len(time) - 1) / (time[-1] - time[0])) ** order

    def convolve(first: int, last: int) -> None:
        near = values[first - half : last + half]
        base = near[half]  # small numbers lose fewer digits
        found[first:last] = np.correlate(near - base, weights, "valid") + (base if order == 0 else 0.0)

    _in_parts(convolve, ends, len(time) - ends)
    return found


def _is_even(time: Array) -> bool:
    """Return whether stamps (n,) are even to their own rounding."""
    grid = np.linspace(time[0], time[-1], len(time))
    rounding = 4.0 * float(np.finfo(np.float64).eps) * max(abs(time[0]), abs(time[-1]))
    return bool(np.all(np.abs(time - grid) <= rounding))


def _fitted(time: Array, values: Array, half: int, order: int) -> Array:
    """Return the derivative of a fit to each window, whatever the stamps."""
    found, together = np.empty(len(time)), _together(half)

    def fit(first: int, last: int) -> None:
        fit_all(time, values, half, order, together, first, last, found, _room(half))

    _in_parts(fit, 0, len(time))
    return found


def _in_parts(work: Callable[[int, int], None], first: int, last: int) -> None:
    """Call `work` for all samples from first to last, part by part; many parts in threads, with the same result."""
    parts = [(at, min(at + _PART, last)) for at in range(first, last, _PART)]
    if len(parts) == 1:
        work(*parts[0])
        return
    with ThreadPoolExecutor() as pool:
        for part in [pool.submit(work, *part) for part in parts]:
            part.result()


def _together(half: int) -> int:
    """Return how many windows share a basis and sums: the more they are, the less of its interval each covers."""
    return max(half // _SHARE, 1)


def _room(half: int) -> Room:
    p, samples = DEGREE + 1, 2 * half + 1 + _together(half)
    return Room(
        np.empty((samples, 2 * p - 1)), np.empty(2 * p - 1), np.empty((p, p)), np.empty((2, p)), np.empty((3, p))
    )


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


class Room(NamedTuple):
    """Working space: the basis at the samples of a block, its sums over a window, and the equations of a fit."""

    basis: Array
    sums: Array
    normal: Array
    right: Array
    at: Array


@compiled_no_refcount
def fit_all(  # noqa: PLR0917 - compiled functions take their parts by position
    time: Array, values: Array, half: int, order: int, together: int, first: int, last: int, found: Array, room: Room
) -> None:
    """`local_polynomial` of the samples from first to last in machine code, written to `found` (n,)."""
    width = 2 * half + 1
    end = first
    while end < last:
        begin, end = end, _block(time, half, end, min(end + together, last))
        low, high = _window(begin, half, time.size), _window(end - 1, half, time.size) + width
        middle, scale = 0.5 * (time[low] + time[high - 1]), 0.5 * (time[high - 1] - time[low])
        base = values[begin]
        for j in range(low, high):
            _chebyshev((time[j] - middle) / scale, room.basis[j - low])
        _clear(room.sums)
        _clear(room.right[0])
        for j in range(low, low + width):
            _add(room, j - low, values[j] - base, 1.0)
        start, is_solved = low, False
        for i in range(begin, end):
            while start < _window(i, half, time.size):
                _add(room, start - low, values[start] - base, -1.0)
                _add(room, start + width - low, values[start + width] - base, 1.0)
                start, is_solved = start + 1, False
            if not is_solved:
                _solve(room)
                is_solved = True
            _derivatives((time[i] - middle) / scale, room.at)
            total = 0.0
            for k in range(room.at.shape[1]):
                total += room.at[order, k] * room.right[1, k]
            found[i] = total / scale**order + (base if order == 0 else 0.0)


@compiled_no_refcount
def _block(time: Array, half: int, begin: int, most: int) -> int:
    """Return the first sample after a block: up to `most`, but so that each of its windows covers most of it."""
    low, end = _window(begin, half, time.size), begin
    shortest = np.inf
    while end < most:
        start = _window(end, half, time.size)
        shortest = min(shortest, time[start + 2 * half] - time[start])
        if end > begin and time[start + 2 * half] - time[low] > _WIDER * shortest:
            break
        end += 1
    return end


@compiled_inline
def _window(i: int, half: int, count: int) -> int:
    """The first sample of the window of sample i."""
    return min(max(i - half, 0), count - 2 * half - 1)


@compiled_inline
def _add(room: Room, j: int, value: float, sign: float) -> None:
    """Add a sample to the sums, or with a sign of -1 take it out."""
    for k in range(room.sums.size):
        room.sums[k] += sign * room.basis[j, k]
    for k in range(room.at.shape[1]):
        room.right[0, k] += sign * value * room.basis[j, k]


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
def _solve(room: Room) -> None:
    """Solve the normal equations by Cholesky; the basis is so nearly orthogonal that no pivot is needed."""
    normal, sums, right = room.normal, room.sums, room.right[1]
    p = right.size
    for k in range(p):
        for m in range(k + 1):
            total = 0.5 * (sums[k + m] + sums[k - m])  # the product T_k T_m
            for j in range(m):
                total -= normal[k, j] * normal[m, j]
            normal[k, m] = math.sqrt(max(total, 1e-300)) if m == k else total / normal[m, m]
    for k in range(p):
        right[k] = room.right[0, k]
        for j in range(k):
            right[k] -= normal[k, j] * right[j]
        right[k] /= normal[k, k]
    for k in range(p - 1, -1, -1):
        for j in range(k + 1, p):
            right[k] -= normal[j, k] * right[j]
        right[k] /= normal[k, k]
