"""Regressors for the lack-of-fit tests, the parts of a recording to compare, and the plane of deflection and rate."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from ga.arrays import Array
from ga.model.trajectory import Motion
from hil.identification.deflection.instruments import delayed
from hil.identification.misfit.effects import centred, direction, of_readings, progress
from hil.signals.constants import CELLS_A_SIDE, LENGTHS, TIMES, WAVES

NAMES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "band": "between slow and fast motion",
        "amplitude": "between small and large deflection",
        "direction": "between loading and unloading",
        "half": "between the first and the second half",
        "memory": "the torque depends on the earlier motion",
        "shape": "the torque is not in proportion to deflection and rate",
        "angle": "the torque repeats with the angle",
        "time": "the torque changes with time",
        "readings": "noise of the deflection shows in the residuals",
        "any": "the motion predicts the residuals",
    }
)
"""The respects in which a model is tested: a description for each code."""


def cuts(motion: Motion) -> list[tuple[str, Array | float]]:
    """Return the parts of the recording between which Kc and Bc are compared, each with its code.

    A part is given as weights (n,) of the samples, or as the frequency, Hz, that splits the band into two parts.
    """
    angle, rate = centred(motion), motion.dtheta_dot
    speed = float(np.sqrt(np.mean(rate**2) / np.mean(angle**2)))  # rad/s
    size = np.abs(angle)
    return [
        ("band", speed / (2.0 * np.pi)),
        ("amplitude", (size > np.median(size)).astype(np.float64)),
        ("direction", (angle * rate > 0.0).astype(np.float64)),
        ("half", (np.arange(len(angle)) >= len(angle) // 2).astype(np.float64)),
    ]


def regressors(motion: Motion, model: Array) -> dict[str, Array]:
    """Return the regressors (n, k) of each lack-of-fit test, by its code. model (n,): torque of the model, N m."""
    angle, rate = centred(motion), motion.dtheta_dot
    x, v = angle / np.abs(angle).max(), rate / max(float(np.abs(rate).max()), 1e-300)
    return {
        "memory": _of_before(motion, x, v),
        "shape": _shapes(motion, x, v, np.abs(model - np.median(model))),
        "angle": np.stack([wave(2.0 * np.pi * turns * x) for turns in WAVES for wave in (np.cos, np.sin)], axis=1),
        "time": _in_time(motion, x, v),
        "readings": of_readings(motion),
    }


def _of_before(motion: Motion, x: Array, v: Array) -> Array:
    step, early = motion.step, -TIMES[1]  # readings that were interpolated know what comes
    lags = [*(lag for lag in TIMES if lag >= step), -step, step, early]
    before = [delayed(motion, values, lag) for values in (x, v) for lag in lags]
    return np.stack([*before, motion.slope(v)], axis=1)


def _shapes(motion: Motion, x: Array, v: Array, carried: Array) -> Array:
    sign, reach = direction(motion), 0.5 * float(np.ptp(motion.dtheta))
    powers = [np.ones_like(x), np.abs(x), x * x, x**3, x**5, np.abs(v), v * v, v * np.abs(v), v**3]
    products = [x * v, np.abs(x) * v, x * x * v, x * v * v]
    friction = [sign, np.abs(x) * sign, x * x * sign, carried * sign]
    return np.stack([*powers, *products, *friction, *(motion.presliding(p * reach) for p in LENGTHS[2:7:4])], axis=1)


def _in_time(motion: Motion, x: Array, v: Array) -> Array:
    late = progress(motion)
    return np.stack([late**power * values for power in (1, 2) for values in (np.ones_like(x), x, v)], axis=1)


def mean_over_plane(motion: Motion, residuals: Array) -> Array:
    """Return the mean residual, N m, in cells of deflection (rows) and rate (columns); NaN in empty cells."""
    at = []
    for values in (motion.dtheta, motion.dtheta_dot):
        edges = np.quantile(values, np.linspace(0.0, 1.0, CELLS_A_SIDE + 1)[1:-1])
        at.append(np.searchsorted(edges, values))
    cell = at[0] * CELLS_A_SIDE + at[1]
    counts = np.bincount(cell, minlength=CELLS_A_SIDE**2)
    sums = np.bincount(cell, weights=residuals, minlength=CELLS_A_SIDE**2)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan).reshape(CELLS_A_SIDE, CELLS_A_SIDE)
