"""Compute deflection, rate and acceleration with one low-pass, for readings whose noise or counts would change Kc and
Bc.

A local polynomial is flat over the excited band but falls slowly above it, and so passes much noise. If the deflection
itself is not filtered, a model that delays it by a fraction of a sample averages its noise, which looks like a skew.
Here deflection, rate and acceleration come from one finite impulse response without phase shift, with the window of
Kaiser (1974). Rate and acceleration are differences of the filtered deflection, so that the rate is exactly the slope
of the deflection. Derivatives of the window would be wrong by 0.4 % at low frequencies for a short window, and so would
Bc.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from math import ceil, comb
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from ga.arrays import Array, Index, Mask
from hil.signals import constants as c
from hil.signals.rate.savitzky_golay import local_polynomial, local_weights, neighbours

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Cubic = tuple[Index, Array, Array]

_SIGNALS: Final = 3  # deflection, rate, acceleration


@dataclass(frozen=True, slots=True)
class LowPass:
    """A low-pass filter.

    cut: the middle of its transition, Hz. half: the number of neighbours on each side. step: time between two samples,
    s. near: the number of neighbours on each side of the local polynomial that moves unevenly stamped readings to an
    even grid.
    """

    cut: float
    half: int
    step: float
    near: int

    @property
    def longest_step(self) -> float:
        """Return the longest time between two samples, s, at which a low-pass with this cut is possible."""
        return c.NYQUIST / (4.0 * self.cut) * (c.PASSED + c.STOPPED) / c.STOPPED

    def of_every(self, every: int) -> LowPass:
        """Return the low-pass with the same cut for a signal that has only every `every`-th sample."""
        return replace(self, half=ceil((self.half - c.FLAT) / every) + c.FLAT, step=every * self.step)

    @lru_cache(maxsize=8)  # noqa: B019 - it holds four numbers
    def kernels(self) -> Array:
        """Return the weights (3, 2*half+1) that give value, slope per s and curvature per s^2."""
        own = self.half - c.FLAT
        offsets = np.arange(-own, own + 1)
        window = np.i0(c.BETA * np.sqrt(1.0 - (offsets / (own + 1)) ** 2)) - 1.0
        value = np.sinc(2.0 * self.cut * self.step * offsets) * window
        found = np.array([np.convolve(value / value.sum(), one) for one in _differences(self.step)])
        found.flags.writeable = False
        return found

    @lru_cache(maxsize=16)  # noqa: B019 - it holds four numbers
    def spectra(self, size: int) -> NDArray[np.complex128]:
        """Return the transforms (3, size/2 + 1) of the kernels."""
        return np.asarray(np.fft.rfft(self.kernels(), size))

    def amplification(self) -> Array:
        """Return the standard deviations (3,) of value, slope and curvature for white noise of 1 rad."""
        return np.asarray(np.linalg.norm(self.kernels(), axis=1))


def low_pass_for(time: Array, highest: float, near: int) -> LowPass | None:
    """Return the low-pass that passes up to `highest`, Hz; None if the samples are too few or too far apart.

    time (n,): s. near: the number of neighbours on each side of a local polynomial with the same pass band.
    """
    step = float(np.median(np.diff(time)))
    edge, stop = c.PASSED * highest, c.STOPPED * highest
    if stop * 2.0 * step > c.NYQUIST:
        return None
    half = int(np.ceil(c.KERNEL / ((stop - edge) * step)))
    found = LowPass(0.5 * (edge + stop), half + c.FLAT, step, near)
    return found if float(np.mean(is_sound(time, found))) >= c.LEFT_BY_FILTER else None


def _differences(step: float) -> Array:
    """Return the weights (3, 2*FLAT+1) that give value, slope per s and curvature per s^2 from neighbours `step` s
    apart.

    The weights are the central differences of that length that are flattest at low frequencies (Fornberg 1988).
    """
    at = np.arange(1, c.FLAT + 1)
    ratio = np.array([(-1.0) ** (k + 1) * comb(2 * c.FLAT, c.FLAT - k) / comb(2 * c.FLAT, c.FLAT) for k in at.tolist()])
    slope, curvature = ratio / at / step, 2.0 * ratio / at**2 / step**2
    value = np.zeros(2 * c.FLAT + 1)
    value[c.FLAT] = 1.0
    return np.array(
        [
            value,
            np.concatenate([slope[::-1], [0.0], -slope]),
            np.concatenate([curvature[::-1], [-2.0 * curvature.sum()], curvature]),
        ]
    )


def passed(time: Array, values: Array, low_pass: LowPass) -> tuple[Array, Array, Array]:
    """Return value, slope and curvature (n,) of low-passed readings (n,). time (n,): their stamps, s, rising.

    The results are valid for the samples that `is_sound` returns.
    """
    found = np.empty((_SIGNALS, len(time)))
    for part in _stretches(time, low_pass.step):
        found[:, part] = _passed(time[part], values[part], low_pass)
    value, slope, curvature = found
    return value, slope, curvature


def passing(time: Array, low_pass: LowPass) -> Callable[[Array], Array]:
    """Return a function that returns the low-passed values of readings (n,) or (k, n) at stamps (n,), s, rising.

    The filter's weights at the stamps are computed once, so that many readings at the same stamps cost less.
    """
    if len(time) < c.KEPT_WEIGHTS:
        return _passing_again(low_pass, time.tobytes())
    through = _through(time, low_pass)  # transforms of many long columns at once would need much memory
    return lambda values: np.apply_along_axis(through, -1, values)


@lru_cache(maxsize=4)  # a recording's motion has the same stamps whatever errors are added to it
def _passing_again(low_pass: LowPass, stamps: bytes) -> Callable[[Array], Array]:
    return _through(np.frombuffer(stamps), low_pass)


def _through(time: Array, low_pass: LowPass) -> Callable[[Array], Array]:
    parts = [(part, _passing(time[part], low_pass)) for part in _stretches(time, low_pass.step)]
    return lambda values: np.concatenate([pass_part(values[..., part]) for part, pass_part in parts], axis=-1)


def is_sound(time: Array, low_pass: LowPass) -> Mask:
    """Return the samples (n,) for which all neighbours that the low-pass uses exist, with no gap between them."""
    found = np.zeros(len(time), dtype=bool)
    for part in _stretches(time, low_pass.step):
        found[part.start + low_pass.half : max(part.stop - low_pass.half, part.start + low_pass.half)] = True
    return found


def _stretches(time: Array, step: float) -> list[slice]:
    """Return the pieces between gaps that are too long to interpolate. step: time between two samples, s."""
    breaks = np.flatnonzero(np.diff(time) > c.APART * step) + 1
    return [slice(first, last) for first, last in pairwise([0, *breaks.tolist(), len(time)])]


def _passed(time: Array, values: Array, low_pass: LowPass) -> Array:
    """Return filtered deflection, rate and acceleration (3, n) of one piece without gaps."""
    if _is_even(time, low_pass):
        return _filtered(values, low_pass, _SIGNALS)
    if len(time) < 2 * low_pass.near + 1:
        return np.full((_SIGNALS, len(time)), np.nan)
    grid = _grid(time, low_pass)
    # a spline through noisy readings of which two are close would swing
    fits = [local_polynomial(time, values, low_pass.near, order) for order in (0, 1)]
    value, slope, curvature = _filtered(_between(_cubic(time, grid), *fits), low_pass, _SIGNALS)
    back = _cubic(grid, time)
    return np.array([_between(back, value, slope), _between(back, slope, curvature), np.interp(time, grid, curvature)])


def _passing(time: Array, low_pass: LowPass) -> Callable[[Array], Array]:
    """Return a function that low-passes readings (n,) of one piece without gaps, for stamps that are used many
    times.
    """
    if _is_even(time, low_pass):
        return lambda values: np.asarray(_filtered(values, low_pass, 1)[..., 0, :])
    if not 2 * low_pass.near < len(time) < c.KEPT_WEIGHTS:
        return lambda values: np.apply_along_axis(lambda one: _passed(time, one, low_pass)[0], -1, values)
    grid = _grid(time, low_pass)
    there, back = _to_grid(time, grid, low_pass.near), _matrix(_cubic(grid, time), len(grid))

    def through(values: Array) -> Array:
        base = values.mean(axis=-1, keepdims=True)  # small numbers lose fewer digits
        grids = _filtered((there @ (values - base).T).T, low_pass, 2)
        return np.asarray(base + (back @ grids.reshape(*grids.shape[:-2], -1).T).T)

    return through


def _filtered(even: Array, low_pass: LowPass, kernels: int) -> Array:
    """Return readings (n,) or (k, n) at even times, filtered by each of the first kernels, (kernels, n) or (k, kernels,
    n).
    """
    before, end = low_pass.half, low_pass.half + even.shape[-1]
    # scipy.signal would cost half a second of start-up; what goes around the end is before the first of what is kept
    size = _fast_size(end + before)
    padded = np.zeros((*even.shape[:-1], size))  # np.pad takes half as long as the transform
    padded[..., before:end] = even - even[..., :1]
    padded[..., end : end + before] = padded[..., end - 1 : end]
    found = np.fft.irfft(np.fft.rfft(padded)[..., None, :] * low_pass.spectra(size)[:kernels], size)
    found = found[..., 2 * before : end + before]
    found[..., 0, :] += even[..., :1]
    return np.asarray(found)


def _fast_size(least: int) -> int:
    """Return the smallest size of at least `least` whose transform is fast: a power of two, or three times one."""
    return min(odd << max((-(-least // odd) - 1).bit_length(), 0) for odd in (1, 3))


def _is_even(time: Array, low_pass: LowPass) -> bool:
    count = 1 + round((time[-1] - time[0]) / low_pass.step)
    even = np.linspace(time[0], time[-1], count) if count == len(time) else time + low_pass.step
    return bool(np.all(np.abs(even - time) < c.SAME * low_pass.step))


def _grid(time: Array, low_pass: LowPass) -> Array:
    """Return even times around a piece; the times do not depend on which part of the recording is read."""
    first, last = np.floor(time[0] / low_pass.step), np.ceil(time[-1] / low_pass.step)
    return np.asarray(low_pass.step * np.arange(first, last + 1.0))


def _to_grid(time: Array, grid: Array, near: int) -> csr_array:
    """Return the weights (k, n) that move readings at uneven stamps (n,) to a grid (k,). near: neighbours on
    each side.
    """
    from scipy.sparse import csr_array, vstack

    count, width, samples = len(time), 2 * near + 1, np.arange(len(time))
    columns, rows = neighbours(near, samples, count).ravel(), width * np.arange(count + 1)
    fits = [csr_array((local_weights(time, near, order, samples).ravel(), columns, rows)) for order in (0, 1)]
    return _matrix(_cubic(time, grid), count) @ vstack(fits, format="csr")


def _cubic(knots: Array, at: Array) -> Cubic:
    """Return the data for a cubic interpolation between knots at times `at` (k,).

    They are the knots beside each time, and the weights (k, 2) of the values and of the slopes at these knots.
    """
    left = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
    step = knots[left + 1] - knots[left]
    part = (at - knots[left]) / step
    later = part**2 * (3.0 - 2.0 * part)
    of_value = np.stack([1.0 - later, later], axis=1)
    of_slope = np.stack([part * (1.0 - part) ** 2, part**2 * (part - 1.0)], axis=1) * step[:, None]
    return np.stack([left, left + 1], axis=1), of_value, of_slope


def _between(cubic: Cubic, values: Array, slopes: Array) -> Array:
    """Return the interpolated values (k,). cubic: the result of `_cubic`. values, slopes (n,): at the knots."""
    places, of_value, of_slope = cubic
    return np.asarray((of_value * values[places] + of_slope * slopes[places]).sum(axis=1))


def _matrix(cubic: Cubic, knots: int) -> csr_array:
    """Return the interpolation `_between` as a matrix of weights (k, 2n) of the values followed by the slopes."""
    from scipy.sparse import csr_array

    places, of_value, of_slope = cubic
    weights = np.concatenate([of_value, of_slope], axis=1).ravel()
    columns, rows = np.concatenate([places, knots + places], axis=1).ravel(), 4 * np.arange(len(places) + 1)
    return csr_array((weights, columns, rows), shape=(len(places), 2 * knots))
