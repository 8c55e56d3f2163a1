"""A joint that another device reads, at its own times and mostly more slowly: the motion is interpolated there.

The torque is left as it was read, since interpolation between few readings would flatten it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def is_fresh(joint_time: Array) -> NDArray[np.bool_]:
    """Return whether (n,) each row holds a new reading of the joint; joint_time (n,) s, NaN without one."""
    fresh: NDArray[np.bool_] = np.isfinite(joint_time) & (np.diff(joint_time, prepend=np.nan) != 0.0)
    return fresh


def interpolated(at: Array, time: Array, value: Array, slope: Array) -> Array:
    """Return a value (n,) with slope (n,) at `time` (n,) s, interpolated at `at` (m,) s: (m,), NaN outside."""
    from scipy.interpolate import CubicHermiteSpline

    found: Array = CubicHermiteSpline(time, value, slope, extrapolate=False)(at)
    return found
