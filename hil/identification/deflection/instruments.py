"""Correct the parameters by instrumental variables if the command was recorded.

The motion that follows from the command through a short filter has none of the readings' errors, and the model's
columns for that motion are the instruments (Young 2011; Pintelon and Schoukens 2012, section 2.7). The command need not
be the physical drive signal; it only has to be correlated with the motion. Its strength is measured by how much the
instruments increase the uncertainty of the parameters.
"""

from __future__ import annotations

from typing import TypeGuard

import numpy as np

from ga.arrays import Array, Mask
from ga.model.trajectory import Motion
from hil.identification.deflection.fitted import Change, Fitted, behind, clipped, moved
from hil.signals.constants import BLOCKS, DELAYS, NORMAL
from hil.signals.rate.windows import Window


def by_command(part: Fitted, sound: Mask) -> tuple[Change, float] | None:
    """Return the correction by the instruments, and the strength of the instruments; None without a command.

    part: the fit on a part of the recording. sound (n,): the samples with a known rate.
    """
    if not is_instrument(part.command):
        return None
    motion = followed(part.motion, part.window, part.command, sound)
    columns, left = (of[sound] for of in part.linearised(part.motion))
    instruments, residuals = part.linearised(motion)[0][sound], clipped(left)
    sizes = np.linalg.norm(columns, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    z, x = instruments / sizes, columns / sizes
    across, own = np.linalg.pinv(z.T @ x), np.linalg.pinv(x.T @ x)
    at = list(part.decisive)
    less_certain = np.diag(across @ (z.T @ z) @ across.T)[at] / np.maximum(np.diag(own)[at], 1e-300)
    each = (z @ across.T - x @ own) * residuals[:, None]
    sums = np.add.reduceat(each, np.arange(BLOCKS) * len(each) // BLOCKS, axis=0)
    error = np.sqrt(BLOCKS * np.var(sums, axis=0, ddof=1))
    change = Change(each.sum(axis=0) / sizes, NORMAL * error / sizes)
    return change, float(min(1.0, 1.0 / max(float(less_certain.max()), 1e-300)))


def delayed(motion: Motion, values: Array, delay: float) -> Array:
    """Return values (n,) delayed by `delay` s; before a piece its first value is used, and beyond it its last value."""
    return motion.by_piece(lambda time, own: np.interp(time - delay, time, own) if len(own) else own, values)


def is_instrument(command: Array | None) -> TypeGuard[Array]:
    """Return whether set-points (n,) were recorded and change."""
    return command is not None and bool(np.isfinite(command).all()) and float(np.ptp(command)) > 0.0


def followed(motion: Motion, window: Window, command: Array, sound: Mask) -> Motion:
    """Return the motion that follows from the command (n,) through a filter with a few coefficients.

    The filter is fitted to the motion at the samples in `sound` (n,).
    """
    unit = 1.0 / (8.0 * window.band[1])
    parts = behind(window, motion, command - command.mean())
    value, *rates = (np.stack([delayed(motion, one, lag * unit) for lag in DELAYS], axis=1) for one in parts)
    value = value - value[sound].mean(axis=0)
    middle = float(motion.dtheta[sound].mean())
    weights = np.linalg.lstsq(value[sound], motion.dtheta[sound] - middle, rcond=1e-9)[0]
    less = (middle + value @ weights - motion.dtheta, *(of @ weights for of in rates))
    return moved(motion, (less[0], less[1] - motion.dtheta_dot, less[2] - motion.dtheta_ddot))
