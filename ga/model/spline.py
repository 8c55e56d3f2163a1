"""The cubic spline through samples: twice differentiable, with a continuous third derivative at the second and the last
but one knot (de Boor 1978).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from ga.arrays import Array
from ga.compiled import compiled_no_refcount

_FEWEST: Final = 4
"""The number of knots below which a single polynomial passes through all of them."""


@dataclass(frozen=True, eq=False)
class Spline:
    """Curves through knots (n,), s, rising.

    parts (n-1, k, m): coefficients of the polynomials of m curves, the constant first.
    """

    knots: Array
    parts: Array

    @classmethod
    def through(cls, knots: Array, values: Array) -> Spline:
        """Return the curves through values (k, n), equal to scipy's CubicSpline, which takes 0.2 s to import.

        Raises ValueError for fewer than two knots.
        """
        if len(knots) < 2:
            raise ValueError("a curve needs two knots at least")
        step, slopes = np.diff(knots), _slopes(knots, values)
        before, after = slopes[:, :-1], slopes[:, 1:]
        chord = np.diff(values, axis=1) / step
        square, cube = (3.0 * chord - 2.0 * before - after) / step, (before + after - 2.0 * chord) / step**2
        parts = np.stack([values[:, :-1], before, square, cube])
        return cls(np.ascontiguousarray(knots), np.ascontiguousarray(parts.T))

    def __call__(self, times: Array) -> Array:
        """Return the values (k, m) at times (m,), s, rising; outside the knots, the polynomials at the ends
        continue.
        """
        found = np.empty((self.parts.shape[1], len(times)))
        evaluate(self.knots, self.parts, np.ascontiguousarray(times), found)
        return found

    def changing(self) -> Spline:
        """Return the time derivatives of the curves."""
        orders = np.arange(1.0, self.parts.shape[2])
        return Spline(self.knots, np.ascontiguousarray(self.parts[..., 1:] * orders))


def _slopes(knots: Array, values: Array) -> Array:
    """Return the slopes (k, n) at the knots that make the second derivative of the curves continuous.

    At the second and the last but one knot the third derivative is continuous too.
    """
    if len(knots) < _FEWEST:
        return np.asarray(np.gradient(values, knots, axis=1, edge_order=2 if len(knots) > 2 else 1))
    step = np.diff(knots)
    chord, both = np.diff(values, axis=1) / step, step[:-1] + step[1:]
    below, diagonal, above = np.zeros((3, len(knots)))
    right = np.empty(values.shape[::-1])
    diagonal[1:-1], above[1:-1], below[1:-1] = 2.0 * both, step[:-1], step[1:]
    right[1:-1] = 3.0 * (step[1:] * chord[:, :-1] + step[:-1] * chord[:, 1:]).T
    diagonal[0], above[0] = step[1], both[0]
    right[0] = ((step[0] + 2.0 * both[0]) * step[1] * chord[:, 0] + step[0] ** 2 * chord[:, 1]) / both[0]
    diagonal[-1], below[-1] = step[-2], both[-1]
    right[-1] = (step[-1] ** 2 * chord[:, -2] + (2.0 * both[-1] + step[-1]) * step[-2] * chord[:, -1]) / both[-1]
    solve_three_diagonals(below, diagonal, above, right)
    return right.T


@compiled_no_refcount
def solve_three_diagonals(below: Array, diagonal: Array, above: Array, right: Array) -> None:
    """Replace the right sides (n, k) of equations by their solutions, and the diagonal (n,) by the pivots.

    below, above (n,): the elements beside the diagonal of each row. No rows are exchanged: once the first row of a
    spline is eliminated, the diagonal dominates.
    """
    for i in range(1, len(diagonal)):
        factor = below[i] / diagonal[i - 1]
        diagonal[i] -= factor * above[i - 1]
        for k in range(right.shape[1]):
            right[i, k] -= factor * right[i - 1, k]
    for i in range(len(diagonal) - 1, -1, -1):
        for k in range(right.shape[1]):
            if i < len(diagonal) - 1:
                right[i, k] -= above[i] * right[i + 1, k]
            right[i, k] /= diagonal[i]


@compiled_no_refcount
def evaluate(knots: Array, parts: Array, times: Array, found: Array) -> None:
    """Fill in the values (k, m) of curves at times (m,), rising."""
    at = 0
    for i in range(len(times)):
        while at < len(knots) - 2 and times[i] >= knots[at + 1]:
            at += 1
        past = times[i] - knots[at]
        for k in range(len(found)):
            value = 0.0
            for order in range(parts.shape[2] - 1, -1, -1):
                value = value * past + parts[at, k, order]
            found[k, i] = value
