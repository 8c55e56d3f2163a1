"""Compute the effect of rounding to counts on the parameters, for a joint that rests."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ga.arrays import Array, Mask
from hil.identification.deflection.fitted import Fitted, moved
from hil.signals.constants import NORMAL, RESTS, ROUNDING, STILL, WITHIN


def rounded_at_rest(part: Fitted, sound: Mask) -> Array:
    """Return half the 95 % intervals (p + q,) of the effect of rounding while the joint rests.

    At rest all readings of an angle or a torque have the same error, up to half a count, which averaging does not
    reduce. Noise does not help for a torque in counts either: the least sum of absolute errors lies at one of the
    counts. Readings at opposite deflections may have opposite errors, whose effects on Kc add up.
    """
    motion, count = part.motion, part.window.count
    columns, left = part.linearised(motion)
    torque = part.torque - left
    at_rest = _is_still(motion.dtheta, STILL * count), _is_within(torque, WITHIN * part.torque_count)
    found = np.zeros(len(part.half_width))
    for still, values, step in zip(at_rest, (motion.dtheta, torque), (count, part.torque_count), strict=True):
        rows = still & sound
        if rows.any():
            own = _influence(columns, sound)[:, rows[sound]]
            own = own * np.sign(values[rows]) * (_per_rad(part, left)[rows] if values is motion.dtheta else 1.0)
            level = np.unique(np.abs(np.round(values[rows] / step)), return_inverse=True)[1]
            of_level = np.array([np.bincount(level, weights=one) for one in own])
            most = 0.5 * np.abs(of_level).sum(axis=1)
            likely = NORMAL * ROUNDING * np.linalg.norm(of_level, axis=1)
            found = np.hypot(found, step * np.minimum(most, likely))
    return found


def _influence(columns: Array, sound: Mask) -> Array:
    """Return the derivative (p + q, m) of each parameter with respect to the torque of each of the m samples in
    `sound`.
    """
    sizes = np.linalg.norm(columns[sound], axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    return np.asarray(np.linalg.pinv(columns[sound] / sizes) / sizes[:, None])


def _per_rad(part: Fitted, left: Array) -> Array:
    """Return the derivative (n,) of the residuals `left`, N m/rad, with respect to an error of the deflection."""
    count, samples = part.window.count, len(part.motion.whole[0])
    one_off = moved(part.motion, (np.full(samples, count), *np.zeros((2, samples))))
    return np.asarray((left - part.linearised(one_off)[1]) / count)


def _is_still(dtheta: Array, most: float) -> Mask:
    """Return whether each reading (n,), rad, belongs to several consecutive readings that differ by less than `most`,
    rad.
    """
    alike = np.concatenate([[False], np.abs(np.diff(dtheta)) < most])
    run = np.cumsum(~alike)  # the number of the run of like readings that each is in
    return np.asarray(np.bincount(run)[run] >= RESTS)


def _is_within(values: Array, most: float) -> Mask:
    """Return whether each value (n,) belongs to several consecutive values that differ by less than `most`."""
    found = np.zeros(len(values), dtype=bool)
    if len(values) >= RESTS:
        first = np.flatnonzero(np.ptp(sliding_window_view(values, RESTS), axis=1) < most)
        for later in range(RESTS):
            found[first + later] = True
    return found
