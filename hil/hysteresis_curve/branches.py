"""Cut a torsion test at the ends of its strokes, and each stroke where the torque is zero, into branches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.errors import Untrustworthy

Array = NDArray[np.float64]

_SLOW: Final = 1.0
"""The shortest mean time of a stroke of a slow test, s."""
_REVERSAL: Final = 0.1
"""The share of its range by which the guide (set-point or torque) must turn back before a stroke has ended."""
_NOISES: Final = 8.0
"""The number of standard deviations of its noise by which it must also turn back."""
_NOTHING: Final = 0.05
"""The share of the largest torque up to which a branch is a torque that wanders about zero, and no load."""
_POINTS: Final = 100
"""The number of means to which the rows of a branch are reduced, so that noise of the torque does not flatten it."""


@dataclass(frozen=True, eq=False)
class Torsion:
    """A torsion test in the order in which it was done: torque, N m, and angle, rad, (n,) each, without NaN.

    name: of the file. setpoint: (n,), in any unit, None if unknown. seconds: its duration, NaN if unknown.
    """

    name: str
    torque: Array
    angle: Array
    setpoint: Array | None = None
    seconds: float = float("nan")

    @property
    def guide(self) -> Array:
        """Return the signal (n,) that reverses at the end of a stroke: the set-point, or without a set-point the
        torque.
        """
        return self.torque if self.setpoint is None else self.setpoint

    def check_slow(self) -> None:
        """Raise Untrustworthy if a stroke is so short that damping adds to the torque."""
        stroke = self.seconds / max(1, len(reversals(self.guide)) - 1)
        if stroke < _SLOW:
            raise Untrustworthy(
                f"{self.name} is not slow: a stroke takes {stroke:.2g} s on average, so its torque includes damping, "
                f"and its slope is not the stiffness. Use hil identify, or take {_SLOW:g} s or more for each stroke"
            )


@dataclass(frozen=True, eq=False)
class Branch:
    """A part of a stroke with torque of one sign: means of torque, N m, and angle, rad, (m,) each, in order.

    stroke: number of the stroke in its test. sign: of the torque, 1 or -1. loading: whether the torque grows in size.
    """

    stroke: int
    sign: int
    loading: bool
    torque: Array
    angle: Array

    @property
    def direction(self) -> str:
        """Return the direction of the torque, "+" or "-"."""
        return "+" if self.sign > 0 else "-"

    @property
    def largest(self) -> float:
        """Return the largest torque of the branch in size, N m."""
        return float(np.abs(self.torque).max())


def branches_of(test: Torsion) -> list[Branch]:
    """Return the branches of a test in order; each has at least two rows and a torque other than zero."""
    guide = test.guide
    ends = reversals(guide)
    found = []
    for stroke, (start, stop) in enumerate(pairwise(ends)):
        torque, angle = test.torque[start : stop + 1], test.angle[start : stop + 1]
        rises = bool(guide[stop] > guide[start])
        # the sum turns where the torque crosses zero, also if noise makes it cross many times there
        sums = np.concatenate([[0.0], np.cumsum(torque if rises else -torque)])
        zero = int(np.argmin(sums))
        for rows, loading in ((slice(0, zero), False), (slice(zero, None), True)):
            if len(torque[rows]) > 1:
                sign = 1 if rises == loading else -1
                found.append(Branch(stroke, sign, loading, _means(torque[rows]), _means(angle[rows])))
    least = _NOTHING * float(np.abs(test.torque).max())
    return [one for one in found if one.largest > least]


def reversals(guide: Array) -> list[int]:
    """Return the first index of a quantity that turns back and forth, `guide` (n,), the indices at which it turns, and
    the last index.
    """
    threshold = max(_REVERSAL * float(np.ptp(guide)), min(_NOISES * noise_of(guide), 0.5 * float(np.ptp(guide))))
    found, extreme, rises = [0], 0, 0
    values: Sequence[float] = guide.tolist()
    for at, value in enumerate(values):
        further = value - values[extreme]
        if rises and further * rises > 0.0:
            extreme = at
        elif abs(further) > threshold:
            if rises:
                found.append(extreme)
            extreme, rises = at, 1 if further > 0.0 else -1
    return [*found, len(guide) - 1]


def noise_of(values: Array) -> float:
    """Return the standard deviation of the noise of a slow signal (n,), in its unit; 0 for few rows."""
    return 1.4826 * float(np.median(np.abs(np.diff(values, 2)))) / 6.0**0.5 if len(values) > _POINTS else 0.0


def _means(values: Array) -> Array:
    """Return at most _POINTS means of successive values (n,)."""
    count = min(len(values), _POINTS)
    edges = np.linspace(0, len(values), count + 1).astype(int)
    return np.asarray(np.add.reduceat(values, edges[:-1]) / np.diff(edges))
