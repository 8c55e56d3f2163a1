"""Estimate the error of the rate beside jumps of the acceleration, which a stepping command causes and no low-pass can
show.

At a reading where the acceleration jumps, the true rate is lower than that of the band-limited motion through all
readings, by a twelfth of the jump times the sampling period; halfway between two readings it is higher by half that
amount (docs/rate.md). When a drive takes its new set-point between two readings is unknown; therefore an eighth, a
value between these, is used.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ga.model.trajectory import Motion
from hil.signals import constants as c

Array = NDArray[np.float64]


def rate_beside_jumps(motion: Motion, command: Array | None) -> Array | None:
    """Return the possible error of the rate of each sample (n,), rad/s, of a low-passed motion.

    command: the set-points of all samples, which step, or prescribe the motion. None if no low-pass was applied or no
    command was recorded.
    """
    whole, rows = motion.whole
    if whole.behind is None or command is None or len(whole) <= 2 * c.SLOWEST_STEP or not np.ptp(command) > 0.0:
        return None
    steps, period = np.diff(command, prepend=command[:1]), whole.step
    if np.count_nonzero(steps) > c.OFTEN * len(steps):
        jumps = _prescribed(whole.dtheta, command, period)
    else:
        jumps = _following(whole.dtheta_ddot, steps)
    return whole.filtered(c.EIGHTH * period * jumps)[rows]


def _prescribed(dtheta: Array, command: Array, period: float) -> Array:
    """Return the jumps (n,), rad/s^2, of the acceleration of a motion that the command prescribes."""
    size = float(np.cov(dtheta, command)[0, 1] / np.var(command))
    changes = np.diff(command, n=3, prepend=command[:1], append=command[[-1, -1]]) * (size / period**2)
    return np.asarray(changes - np.median(sliding_window_view(np.pad(changes, c.BESIDE), 2 * c.BESIDE + 1), axis=1))


def _following(acceleration: Array, steps: Array) -> Array:
    """Return the jumps (n,), rad/s^2, of an acceleration (n,) that follows steps (n,) of the command a few samples
    later.
    """
    count = len(steps) - c.SLOWEST_STEP
    after = np.array([steps[:count] @ acceleration[lag : lag + count] for lag in range(c.SLOWEST_STEP)])
    late = int(np.argmax(after >= 0.5 * after.max()))
    found = np.zeros(len(steps))
    found[late:] = c.LOW_PASSED_JUMP * after.max() / float(steps @ steps) * steps[: len(steps) - late]
    return found
