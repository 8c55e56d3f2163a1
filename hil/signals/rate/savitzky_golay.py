"""Compute value, slope and curvature of a reading by a polynomial fitted to its neighbourhood (Savitzky and Golay
1964).

The fit has no phase shift, time stamps need not be even, and its gain is one up to a frequency set by the window's
width.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np

from ga.arrays import Array, Index, Mask
from hil.signals.constants import BLOCK_LENGTH, DEGREE, ROWS_AT_ONCE, SHARED_WINDOWS, SINGULAR

LEAST = (DEGREE + 1) // 2
"""The smallest number of neighbours on each side: with fewer there are fewer readings than coefficients."""


def local_polynomial(time: Array, values: Array, half: int, order: int) -> Array:
    """Return the derivative of `order`, 0 to 2, at every sample: (n,), in the values' unit per s^order.

    time (n,): s, rising. values (n,). half: the number of neighbours on each side of a sample in its window. At the
    ends the window is the first or last 2*half+1 samples, and the polynomial is evaluated off the window's centre,
    where the noise is many times larger.
    """
    time, values = (np.ascontiguousarray(one, dtype=np.float64) for one in (time, values))
    if len(time) <= 4 * half + 2 or not _is_even(time):
        return _fitted(time, values, half, order)
    found, width = np.empty(len(time)), 2 * half + 1
    per_time = ((len(time) - 1) / (time[-1] - time[0])) ** order

    def weighed(near: Array, weigh: Callable[[Array], Array]) -> Array:
        base = near[half]  # small numbers lose fewer digits
        return np.asarray(weigh(near - base) * per_time + (base if order == 0 else 0.0))

    def convolve(first: int, last: int) -> None:
        near = values[first - half : last + half]
        found[first:last] = weighed(near, lambda near: np.correlate(near, centred, "valid"))

    centred, after = kernel(half, order), np.arange(1.0, half + 1.0)
    found[:half] = weighed(values[:width], kernels(half, order, after - (half + 1)).__matmul__)
    found[-half:] = weighed(values[-width:], kernels(half, order, after).__matmul__)
    _in_parts(convolve, half, len(time) - half)
    return found


def local_weights(time: Array, half: int, order: int, samples: Index) -> Array:
    """Return the weights (k, 2*half+1) of the readings in each window that give the derivative of `order`, 0 to 2, per
    s^order.

    time (n,): s, rising. samples (k,): the centres of the windows; at the ends the first or last 2*half+1 samples are
    the window. NaN where the stamps determine no polynomial.
    """
    near = time[neighbours(half, samples, len(time))].T
    middle, scale = 0.5 * (near[0] + near[-1]), 0.5 * (near[-1] - near[0])
    basis = _chebyshev(((near - middle) / scale).ravel(), 2 * DEGREE + 1).reshape(2 * DEGREE + 1, *near.shape)
    shares = _solved(basis.sum(axis=1), _chebyshev_derivative((time[samples] - middle) / scale, order))
    return np.asarray(np.einsum("pwk,pk->wk", basis[: DEGREE + 1], shares) / scale**order).T


def _is_even(time: Array) -> bool:
    """Return whether stamps (n,), s, are evenly spaced, except for the rounding of the stamps."""
    grid = np.linspace(time[0], time[-1], len(time))
    rounding = 4.0 * float(np.finfo(np.float64).eps) * max(abs(time[0]), abs(time[-1]))
    return bool(np.all(np.abs(time - grid) <= rounding))


def _fitted(time: Array, values: Array, half: int, order: int) -> Array:
    """Return the derivative of `order` of a polynomial fitted to each window of `half` neighbours on each side, for
    stamps that need not be evenly spaced.
    """
    if _together(half) == 1 and len(time) <= ROWS_AT_ONCE:
        return _weighed(values, half, order, np.arange(len(time)), _kept_weights(time.tobytes(), half, order))
    found = np.empty(len(time))

    def fit(first: int, last: int) -> None:
        begin = np.arange(first, last, _together(half))
        windows = np.minimum(begin[:, None] + np.arange(_together(half)), last - 1)
        together = _are_alike(time, half, windows) & (_together(half) > 1)
        alone = np.unique(windows[~together])
        with np.errstate(all="ignore"):  # across a gap in time there may be no fit
            found[windows[together]] = _derivatives(time, values, half, order, windows[together])
            found[alone] = _weighed(values, half, order, alone, local_weights(time, half, order, alone))

    _in_parts(fit, 0, len(time))
    return found


@lru_cache(maxsize=16)  # an identification asks for the motion of many readings at the same stamps
def _kept_weights(stamps: bytes, half: int, order: int) -> Array:
    time = np.frombuffer(stamps)
    with np.errstate(all="ignore"):
        return local_weights(time, half, order, np.arange(len(time)))


def _weighed(values: Array, half: int, order: int, samples: Index, weights: Array) -> Array:
    """Return the derivative (k,) of `order` at samples (k,). weights (k, 2*half+1): of the readings in each window."""
    base = values[samples]  # small numbers lose fewer digits
    near = values[neighbours(half, samples, len(values))] - base[:, None]
    return np.asarray(np.einsum("kw,kw->k", weights, near) + (base if order == 0 else 0.0))


def _in_parts(work: Callable[[int, int], None], first: int, last: int) -> None:
    """Call the function `work` for all samples from `first` to `last` in parts; many parts run in threads, with the
    same result.
    """
    parts = [(at, min(at + ROWS_AT_ONCE, last)) for at in range(first, last, ROWS_AT_ONCE)]
    if len(parts) == 1:
        work(*parts[0])
        return
    with ThreadPoolExecutor() as pool:
        for part in [pool.submit(work, *part) for part in parts]:
            part.result()


def _together(half: int) -> int:
    """Return how many windows share a basis and sums. With more windows in a block, each window covers less of the
    block's interval.
    """
    return max(half // SHARED_WINDOWS, 1)


@lru_cache(maxsize=256)  # an identification asks for the same few windows again and again
def kernel(half: int, order: int) -> Array:
    """Return the weights (2*half+1,) that give the derivative of `order`, per sample^order, on an even grid."""
    found = np.asarray(kernels(half, order, np.zeros(1))[0])
    found.flags.writeable = False
    return found


def kernels(half: int, order: int, samples: Array) -> Array:
    """Return the weights (m, 2*half+1) that give the derivative of `order` at m positions in the window.

    samples (m,): the distances of the positions from the centre of the window, in samples.
    """
    offsets = np.arange(-half, half + 1, dtype=np.float64) / half
    weights = np.linalg.pinv(np.polynomial.chebyshev.chebvander(offsets, DEGREE))
    derivatives = np.polynomial.chebyshev.chebder(np.eye(DEGREE + 1), order)
    return np.asarray(np.polynomial.chebyshev.chebval(samples / half, derivatives).T @ weights / half**order)


def gain(half: int, order: int, cycles: float) -> float:
    """Return the gain of a derivative for a sine of `cycles` periods per sample, on an even grid.

    half: neighbours on each side of a sample in the window. order: of the derivative; 0: smoothing only.
    """
    offsets = np.arange(-half, half + 1, dtype=np.float64)
    omega = 2.0 * math.pi * cycles
    wave = np.cos(omega * offsets) if order % 2 == 0 else np.sin(omega * offsets)
    return float(kernel(half, order) @ wave) / omega**order * (-1.0 if order == 2 else 1.0)


def widest(order: int, cycles: float, most: int, tolerance: float) -> int:
    """Return the widest window, neighbours on each side, at most `most`, whose gain at `cycles` periods per sample is 1
    within `tolerance`. order: of the derivative.
    """
    half = LEAST
    while half < most and abs(gain(half + 1, order, cycles) - 1.0) <= tolerance:
        half += 1
    return half


def neighbours(half: int, samples: Index, count: int) -> Index:
    """Return the samples (k, 2*half+1) in the window of each sample (k,)."""
    return _first(half, samples, count)[:, None] + np.arange(2 * half + 1)


def _first(half: int, sample: Index, count: int) -> Index:
    """Return the index at which the window of each sample begins."""
    return np.clip(sample - half, 0, count - 2 * half - 1)


def _are_alike(time: Array, half: int, windows: Index) -> Mask:
    """Return which blocks (b,) of windows (b, m) can share a basis: those in which each window covers most of its
    block.
    """
    start = _first(half, windows, len(time))
    end = time[start + 2 * half]
    return np.asarray(end[:, -1] - time[start[:, 0]] <= BLOCK_LENGTH * (end - time[start]).min(axis=1))


def _derivatives(time: Array, values: Array, half: int, order: int, windows: Index) -> Array:
    """Return the derivative (b, m) at the samples (b, m), each the centre of a window.

    The m windows of a block share a basis. The sums of a window are those of the previous window, less the sample that
    left the window, plus the sample that entered. All blocks are computed side by side, because there are many short
    blocks.
    """
    width, found = 2 * half + 1, np.empty(windows.shape)
    starts = _first(half, windows, len(time))
    low, high = time[starts[:, 0]], time[starts[:, -1] + width - 1]
    middle, scale, base = 0.5 * (low + high), 0.5 * (high - low), values[windows[:, 0]]
    sums, right = np.zeros((2 * DEGREE + 1, len(windows))), np.zeros((DEGREE + 1, len(windows)))

    def count_in(sample: Index, weight: Array | float = 1.0) -> None:
        """Add one sample (b,) of each block to the block's sums: of weight 1 it enters, -1 leaves, 0 stays."""
        basis = weight * _chebyshev((time[sample] - middle) / scale, len(sums))
        np.add(sums, basis, out=sums)
        basis = basis[: len(right)]
        basis *= values[sample] - base
        np.add(right, basis, out=right)

    for at in range(width):
        count_in(starts[:, 0] + at)
    for number, sample in enumerate(windows.T):
        if number:
            before = starts[:, number - 1]
            moved = (starts[:, number] - before).astype(np.float64)  # at the ends of a recording windows stay
            count_in(before, -moved)
            count_in(np.minimum(before + width, len(time) - 1), moved)
        at_sample = _chebyshev_derivative((time[sample] - middle) / scale, order)
        found[:, number] = (at_sample * _solved(sums, right)).sum(axis=0) / scale**order + (base if order == 0 else 0.0)
    return found


def _chebyshev(x: Array, count: int) -> Array:
    """Return the values (count, b) of the first `count` Chebyshev polynomials at x (b,)."""
    basis, twice = np.empty((count, len(x))), 2.0 * x
    basis[0], basis[1] = 1.0, x
    for k in range(2, count):
        np.multiply(twice, basis[k - 1], out=basis[k])
        basis[k] -= basis[k - 2]
    return basis


def _chebyshev_derivative(x: Array, order: int) -> Array:
    """Return the derivatives (p, b) of `order` of the Chebyshev polynomials up to the fit's degree at x (b,)."""
    at = _chebyshev(x, DEGREE + 1)
    for number in range(1, order + 1):
        before, at = at, np.zeros_like(at)
        at[1] = before[0] if number == 1 else 0.0
        for k in range(2, len(at)):
            at[k] = 2.0 * number * before[k - 1] + 2.0 * x * at[k - 1] - at[k - 2]
    return at


def _solved(sums: Array, right: Array) -> Array:
    """Return the coefficients (p, b) of b fits. sums (2p-1, b): sums of the basis. right (p, b): sums of basis times
    values.

    The equations are solved by Cholesky's method; the basis is so nearly orthogonal that no pivot is needed. NaN if the
    equations are singular.
    """
    p, found = len(right), right.copy()
    root = np.empty((p, p, right.shape[1]))
    for m in range(p):
        below = np.arange(m, p)
        column = 0.5 * (sums[below + m] + sums[below - m])  # the product T_k T_m
        for j in range(m):
            column -= root[m:, j] * root[m, j]
        whole = 0.5 * (sums[2 * m] + sums[0])
        diagonal = np.sqrt(np.where(column[0] > SINGULAR * whole, column[0], np.nan))
        root[m:, m] = column / diagonal
        root[m, m] = diagonal
        found[m] /= diagonal
        found[m + 1 :] -= root[m + 1 :, m] * found[m]
    for k in reversed(range(p)):
        found[k] /= root[k, k]
        found[:k] -= root[k, :k] * found[k]
    return found
