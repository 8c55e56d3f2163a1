"""Faults of an angle's reading: a zero far away, jumps by a turn, a reading that stopped while the torque went on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FAR = 1.5  # times the range of the angle
_TURN = 2.0 * np.pi  # rad
_NEAR = 0.1  # of a turn, by which a step may differ from one that was taken for a wrap
_LONGEST = 0.5  # s without any change, from which on a reading may be frozen
_MOVED = 0.3  # of the torque's range, that it covers while the reading is frozen
_SLOWER = 10.0  # times the usual time between two changes of the reading


def unwrapped(angle: Array) -> tuple[Array, int]:
    """Return the angle (n,) rad without jumps by a turn, and how many there were.

    A step counts as a jump only where it is within a tenth of a turn and no step between a tenth and nine tenths of one
    occurs: only then is it certain that it was no motion.
    """
    steps = np.abs(np.diff(angle))
    jumps = np.abs(steps - _TURN) < _NEAR * _TURN
    if not jumps.any() or bool((steps[~jumps] > _NEAR * _TURN).any()):
        return angle, 0
    return np.unwrap(angle), int(np.count_nonzero(jumps))


def far_zero(angle: Array) -> float:
    """Return the middle of an angle's range, rad, where its zero is further away than 1.5 times the range, else 0."""
    low, high = float(angle.min()), float(angle.max())
    middle = 0.5 * (low + high)
    return middle if abs(middle) > _FAR * (high - low) else 0.0


def frozen(time: Array, angle: Array, torque: Array) -> NDArray[np.bool_]:
    """Return which samples (n,) of an angle stand still while the torque covers a third of its range.

    time s, angle rad, torque N m. A joint that friction holds, or a pause, leaves the torque in a smaller range.
    """
    changes = np.flatnonzero(np.diff(angle) != 0.0) + 1
    if not changes.size:
        return np.zeros(len(angle), dtype=bool)
    edges = np.concatenate([[0], changes, [len(angle)]])
    lasted = time[edges[1:] - 1] - time[edges[:-1]]
    found = np.zeros(len(angle), dtype=bool)
    for at in np.flatnonzero(lasted > max(_LONGEST, _SLOWER * float(np.mean(np.sort(lasted)[:-1])))).tolist():
        rows = slice(int(edges[at]) + 1, int(edges[at + 1]))
        found[rows] = np.ptp(torque[rows]) > _MOVED * np.ptp(torque)
    return found
