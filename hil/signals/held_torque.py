"""Compute the smooth part of a motor's torque where a drive holds its torque set-points.

From one set-point to the next the torque is a staircase. The angle follows its smooth part, which a reading once a tick
does not show: the reading is the level before or after a step, or a value between both while the current rises. It is
therefore up to half a tick late or early, and at ten readings in a period 1.6 % too large. Both change Bc, and the
second Kc too. The set-points give the form of the staircase, and the readings its scale.
"""

from __future__ import annotations

import numpy as np

from ga.arrays import Array
from hil.signals import constants as c
from hil.signals.deflection_noise import smallest_step


def smooth_torque(reading: Array, set_points: Array) -> Array:
    """Return the smooth part of a held torque (n,), N m, in the middle of the step at each row.

    reading (n,): the torque that the drive reports, N m, NaN where it is lost. set_points (n,): the drive takes each of
    them at its row. Set-points are rounded to the counts of the readings if these are coarse beside the steps. The
    difference of a reading from both levels, beyond half a count, stays in the result. If the readings do not follow
    the set-points, `reading` is returned.
    """
    _, old, *_ = _around(set_points)
    good = np.isfinite(reading + np.sum(_around(set_points), axis=0))
    if np.count_nonzero(good) < c.FEWEST or not np.ptp(set_points[good]) > 0.0:
        return reading
    spread, count = float(np.std(reading[good])), smallest_step(reading[good])
    columns = np.stack([set_points, set_points - old, np.ones_like(old)], axis=1)
    scale = np.linalg.lstsq(columns[good], reading[good], rcond=None)[0][0]
    # a reading of a rising current is uncertain in proportion to the step
    weights = 1.0 / np.maximum(np.abs(scale * (set_points - old)), max(count, c.ACCURATE * spread, 1e-300))
    scale, _, offset = np.linalg.lstsq(columns[good] * weights[good, None], (reading * weights)[good], rcond=None)[0]
    level, step = scale * set_points + offset, float(np.std(scale * (set_points - old)[good]))
    if c.ROUNDING * count > c.SMALL_COUNT * step:
        level = count * np.round(level / count)
    earlier, old, new, coming = _around(level)
    rest = reading - np.clip(reading, np.minimum(old, new) - 0.5 * count, np.maximum(old, new) + 0.5 * count)
    if float(np.std(rest[good])) > c.SMALL_COUNT * step:
        return reading
    # the mean of both levels, and a twelfth of its curvature
    smooth = 0.5 * (old + new + c.ROUNDING**2 * (old + new - earlier - coming))
    return np.asarray(np.where(good, smooth + rest, reading))


def _around(values: Array) -> tuple[Array, Array, Array, Array]:
    """Return the values (n,) two rows and one row earlier, at the row, and one row later; the ends repeat."""
    padded = np.pad(values, 2, mode="edge")
    return padded[:-4], padded[1:-3], values, padded[3:-1]
