"""The shift between the clocks of two files of one run, by which the torque of one fits the deflection of the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PIECES: Final = 8  # of the common time: the scatter of their own shifts gives the error
_COMMON: Final = 0.5  # of the shorter file, which lies in both
_EXCITED: Final = 0.995  # of the power that rate and torque have in common, up to the upper end of the band
_ABOVE: Final = 1.5  # times that end, up to which both are compared
_AROUND: Final = 1.0  # periods of that frequency, around the first estimate, in which the shift is searched


@dataclass(frozen=True, slots=True)
class Shift:
    """What to add to the torque's clock, s, and its standard error, which is large too where the clocks run apart.
    explained: the share of the torque's power that deflection and rate explain after the shift.
    """

    seconds: float
    error: float
    explained: float


def shift_of(time: Array, dtheta: Array, other: Array, torque: Array) -> Shift:
    """Return the shift with which `torque` (m,) at times `other` (m,), s, fits `dtheta` (n,) at times `time` (n,), s.

    The torque is fitted as that of a spring that may harden, damping, friction, an offset and a drift. Stiffness and
    damping have one sign: a shift of 2 Bc/Kc with a negative damping would fit nearly as well. A motion with a single
    frequency does not determine the shift, so its error is large then.
    """
    step = max(float(np.median(np.diff(time))), float(np.median(np.diff(other))))
    coarse, explained = _coarse(step, time, dtheta, other, torque)
    grid, load, angle, highest = _filtered(step, time, dtheta, other + coarse, torque)

    def misfits(shift: float) -> Array:
        """Return the sum of the squared residuals in each piece; inf if the damping is negative."""
        near, rate = angle(grid + shift), angle(grid + shift, 1)
        friction = np.tanh(10.0 * rate / rate.std())
        columns = np.column_stack([near, rate, near**3, friction, np.ones_like(grid), grid - grid.mean()])
        scale = np.abs(columns).max(axis=0)
        found = np.linalg.lstsq(columns / scale, load, rcond=None)[0] / scale
        left = (load - columns @ found) ** 2
        sums = np.array([piece.sum() for piece in np.array_split(left, _PIECES)])
        return np.where(found[0] * found[1] < 0.0, np.inf, sums)

    tried = np.arange(-_AROUND / highest, _AROUND / highest, step)
    best = float(tried[np.argmin([misfits(one).sum() for one in tried])])
    own, best = _refined(misfits, best, step)
    return Shift(coarse + best, float(np.std(own, ddof=1)) / _PIECES**0.5, explained)


def _refined(misfits: Callable[[float], Array], shift: float, width: float) -> tuple[Array, float]:
    """Return how much each piece's own best shift differs (pieces,), and the best shift of all."""
    for _ in range(6):
        less, here, more = (misfits(shift + part * width) for part in (-1.0, 0.0, 1.0))
        slopes, bend = (more - less) / (2.0 * width), float((more + less - 2.0 * here).sum()) / width**2
        if not np.isfinite(bend) or bend <= 0.0:
            return np.full(_PIECES, np.inf) * np.resize([1.0, -1.0], _PIECES), shift
        shift += float(np.clip(-slopes.sum() / bend, -width, width))
        width *= 0.6
    return -slopes * _PIECES / bend, shift


def _coarse(step: float, time: Array, dtheta: Array, other: Array, torque: Array) -> tuple[float, float]:
    """Return the shift at which deflection and rate explain the most of the torque's power, and that share."""
    from scipy.signal import correlate

    angle, load = (_even(step, at, values) for at, values in ((time, dtheta), (other, torque)))
    ones = np.ones_like(load)
    power, both = (correlate(np.ones_like(angle), one, method="fft") for one in (load**2, ones))
    with np.errstate(all="ignore"):
        shares = sum(
            correlate(one, load, method="fft") ** 2 / correlate(one**2, ones, method="fft") / power
            for one in (angle, np.gradient(angle, step))
        )
    shares = np.where(both > _COMMON * min(len(angle), len(load)), np.nan_to_num(shares), 0.0)
    best = int(np.argmax(shares))
    return float(time[0] + (best - len(load) + 1) * step - other[0]), float(shares[best])


def _even(step: float, time: Array, values: Array) -> Array:
    grid = np.arange(time[0], time[-1], step)
    found = np.interp(grid, time, values)
    return np.asarray(found - found.mean())


def _filtered(
    step: float, time: Array, dtheta: Array, other: Array, torque: Array
) -> tuple[Array, Array, Callable[..., Array], float]:
    """Return common times (k,), the torque (k,) there, the deflection as a spline, and the highest frequency, Hz.

    Both are low-passed alike above the band that they have in common.
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, csd, sosfiltfilt

    grid = np.arange(max(time[0], other[0]), min(time[-1], other[-1]), step)
    load, angle = CubicSpline(other, torque)(grid), CubicSpline(time, dtheta)(grid)
    frequency, cross = csd(angle, load, 1.0 / step, nperseg=max(256, len(grid) // 8), detrend="linear")
    power = np.cumsum(np.abs(cross) * frequency)
    highest = _ABOVE * float(frequency[np.searchsorted(power, _EXCITED * power[-1])])
    if highest < 0.45 / step:
        sections = butter(4, highest, fs=1.0 / step, output="sos")
        load, angle = (sosfiltfilt(sections, one) for one in (load, angle))
    ends = int(2.0 * _AROUND / highest / step) + 1
    return grid[ends:-ends], load[ends:-ends], CubicSpline(grid, angle), highest
