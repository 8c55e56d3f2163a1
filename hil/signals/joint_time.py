"""A joint that another device reads, at its own times and mostly more slowly: what moved is looked up at those times.

The torque is left as it was read, since a line drawn between few readings would be flatter than what they are of.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

Array = NDArray[np.float64]


def is_fresh(joint_time: Array) -> NDArray[np.bool_]:
    """Whether (n,) a row holds a reading that the row before did not; joint_time (n,) s, NaN where there is none."""
    fresh: NDArray[np.bool_] = np.isfinite(joint_time) & (np.diff(joint_time, prepend=np.nan) != 0.0)
    return fresh


def looked_up(at: Array, time: Array, value: Array, slope: Array) -> Array:
    """A value (n,) with the slope it has (n,) at `time` (n,) s, looked up at `at` (m,) s; (m,), NaN outside."""
    found: Array = CubicHermiteSpline(time, value, slope, extrapolate=False)(at)
    return found
