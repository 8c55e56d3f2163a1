"""The band in which models are proposed: torque and columns are low-passed to the excited band, thinned and whitened.

Only the excited band distinguishes models: above it there are only noise, and errors of the deflection that look like
less damping. Torque and columns pass the same filter, so a linear relation between them stays the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ga.arrays import Array, Index, Mask
from ga.model.trajectory import Motion
from hil.signals import constants as c
from hil.signals.prepare import Signals
from hil.signals.rate.low_pass import LowPass, is_sound, low_pass_for, passing
from hil.signals.rate.spectrum import power_of


@dataclass(frozen=True, eq=False)
class Band:
    """The torque of a recording in its excited band, at fewer rows.

    motion and torque (n,), N m: the recording. highest: the frequency up to which the joint moved, Hz. low_pass: the
    filter; None if the samples are too few, or some have no certain rate. every: samples from one row to the next. rows
    (m,): the index of each row among the samples. weights (k + 1,): the filter that makes the residuals white noise,
    its first weight 1.
    """

    motion: Motion
    torque: Array
    highest: float
    low_pass: LowPass | None
    every: int
    rows: Index
    weights: Array

    @classmethod
    def of(cls, signals: Signals, seen: Mask) -> Band:
        """Return the band of the samples in `seen` (n,), not whitened."""
        motion, highest = signals.motion, _highest(signals)
        clear = seen & signals.smooth
        used = clear if c.CERTAIN_RATES < clear.mean() < c.NEARLY_ALL else seen
        first = motion.time[motion.pieces[0]]
        low_pass = low_pass_for(first, highest, c.BAND_NEIGHBOURS) if used.all() and len(first) > c.FEWEST else None
        if low_pass is not None:
            sound = np.concatenate([_sound(motion.time[piece], low_pass) for piece in motion.pieces])
            every = max(1, int(0.5 / (low_pass.cut * low_pass.step)))
            if np.count_nonzero(sound[::every]) >= c.ROWS_A_WEIGHT:
                return cls._at(signals, sound, low_pass, every)
        return cls._at(signals, used, None, max(1, len(motion) // c.CURVE_ROWS))

    @classmethod
    def _at(cls, signals: Signals, used: Mask, low_pass: LowPass | None, every: int) -> Band:
        rows = np.flatnonzero(used)
        rows = rows[rows % every == 0]
        return cls(signals.motion, signals.torque, signals.band[1], low_pass, every, rows, np.ones(1))

    def lowered(self, values: Array) -> Array:
        """Return values (k, n) of all samples after the low-pass, at the rows: (k, m)."""
        if self.low_pass is None:
            return np.asarray(values[:, self.rows])
        parts = [_passed(self.motion.time[one], values[:, one], self.low_pass) for one in self.motion.pieces]
        return np.asarray(np.concatenate(parts, axis=1)[:, self.rows])

    def whitened(self, values: Array) -> Array:
        """Return values (k, m) of the rows after the whitening filter, without the first rows of each piece."""
        found = values.copy()
        for back, weight in enumerate(self.weights[1:], start=1):
            found[:, back:] += weight * values[:, :-back]
        return found[:, self._following]

    def with_noise(self, residuals: Array) -> Band:
        """Return the band with the filter that whitens residuals (m,) of its rows: their autoregression."""
        order = min(c.NOISE_WEIGHTS, len(residuals) // c.ROWS_A_WEIGHT)
        near = [residuals[: len(residuals) - k] @ residuals[k:] / (len(residuals) - k) for k in range(order + 1)]
        if not near[0] > 0.0 or order < 1:
            return self
        table = np.array([[near[abs(i - k)] for k in range(order)] for i in range(order)])
        table += 1e-6 * near[0] * np.eye(order)
        white = replace(self, weights=np.append(1.0, -np.linalg.solve(table, near[1:])))
        return white if np.count_nonzero(white._following) > 0.5 * len(self.rows) else replace(self, weights=np.ones(1))

    @cached_property
    def _following(self) -> Mask:
        """Return which rows (m,) have enough rows before them, without a gap, for the whitening filter."""
        follows = np.ones(len(self.rows), dtype=bool)
        for begin in (0, *(np.flatnonzero(np.diff(self.rows) > self.every) + 1).tolist()):
            follows[begin : begin + len(self.weights) - 1] = False
        return follows


def _highest(signals: Signals) -> float:
    """Return the highest frequency, Hz, of the excited band at which the deflection far exceeds its errors.

    At higher frequencies the errors look like less damping, and like a delay of the torque.
    """
    motion, window = signals.motion, signals.window
    if window is None or not window.of_deflection > 0.0:
        return signals.band[1]
    frequency, power, white = power_of(motion.time, motion.dtheta)
    lines = 1 + int(np.searchsorted(frequency, c.SMOOTHED_SPECTRUM))
    smooth = np.convolve(power, np.ones(lines) / lines, "same")
    above = (smooth > c.ABOVE_ERRORS * window.of_deflection**2 * white) & (frequency <= signals.band[1])
    return float(frequency[above][-1]) if above.any() else signals.band[1]


def _sound(time: Array, low_pass: LowPass) -> Mask:
    return is_sound(time, low_pass) if _is_long(time, low_pass) else np.zeros(len(time), dtype=bool)


def _passed(time: Array, values: Array, low_pass: LowPass) -> Array:
    return passing(time, low_pass)(values) if _is_long(time, low_pass) else values


def _is_long(time: Array, low_pass: LowPass) -> bool:
    return len(time) > 2 * (low_pass.near + 1)
