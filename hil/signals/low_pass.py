"""Deflection, rate and acceleration from one low-pass, for readings whose noise or counts would reach Kc and Bc.

A local polynomial is flat over the excited band and falls slowly beyond it, so that it passes a lot of noise; and where
the deflection is taken as it was read, a model that delays it by a part of a sample averages its noise away, which
looks like a skew. Here all three come from one finite impulse response without phase shift, of Kaiser's (1974) window:
the second and third are differences of the first, so that the rate is the slope of the deflection whatever delays both.
Derivatives of the window would not do: those of a short one are 0.4 % off at low frequencies, which is as much of Bc.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import comb
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from hil.signals.savitzky_golay import local_polynomial

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]
Rows = slice | NDArray[np.int64]

_ATTENUATION: Final = 70.0  # dB, in the stop band; in the pass band as little is lost, 0.03 %
_BETA: Final = 0.1102 * (_ATTENUATION - 8.7)  # of the window, by Kaiser's formula
_FLAT: Final = 12  # neighbours a side of the differences, which are right to 0.06 % up to 0.28 times the sampling rate
_PASSED: Final = 1.1  # times the highest frequency, up to where all is passed
_STOPPED: Final = 1.6  # times it, from where nothing is
_NYQUIST: Final = 0.9  # part of half the sampling rate that the stop band must begin below
_SIGNALS: Final = 3  # deflection, rate, acceleration
_BRIDGED: Final = 4.0  # steps between two samples, up to which the readings between them are interpolated
_LEFT: Final = 0.8  # of the samples, that must remain
_KEPT: Final = 5_000_000  # weights, 60 MB, that are kept for stamps asked for again
_FEW: Final = 2  # times as many samples as rows, from which the weights of these are kept too
_EVEN: Final = 1e-3  # of a step, within which stamps are even


@dataclass(frozen=True, slots=True)
class LowPass:
    """A low-pass. cut: Hz, the middle of its transition. half: neighbours a side. step: s between two samples.

    near: neighbours a side of the local polynomial that takes readings with uneven stamps to an even grid.
    """

    cut: float
    half: int
    step: float
    near: int

    @lru_cache(maxsize=8)  # noqa: B019 - it holds four numbers
    def kernels(self) -> Array:
        """Return the weights (3, 2*half+1) of value, slope per s and curvature per s^2."""
        own = self.half - _FLAT
        offsets = np.arange(-own, own + 1)
        window = np.i0(_BETA * np.sqrt(1.0 - (offsets / (own + 1)) ** 2)) - 1.0
        value = np.sinc(2.0 * self.cut * self.step * offsets) * window
        found = np.array([np.convolve(value / value.sum(), one) for one in _differences(self.step)])
        found.flags.writeable = False
        return found

    def amplification(self) -> Array:
        """Return the standard deviations (3,) of value, slope and curvature for white noise of 1 rad."""
        return np.asarray(np.linalg.norm(self.kernels(), axis=1))


def low_pass_for(time: Array, highest: float, near: int) -> LowPass | None:
    """Return the low-pass that passes up to `highest`, Hz; None where samples (n,) s are too few or too far apart.

    near: neighbours a side of a local polynomial that passes as much.
    """
    step = float(np.median(np.diff(time)))
    edge, stop = _PASSED * highest, _STOPPED * highest
    if stop * 2.0 * step > _NYQUIST:
        return None
    # Kaiser's formula for the length
    half = int(np.ceil((_ATTENUATION - 7.95) / (2.0 * 14.36 * (stop - edge) * step)))
    found = LowPass(0.5 * (edge + stop), half + _FLAT, step, near)
    return found if float(np.mean(is_sound(time, found))) >= _LEFT else None


def _differences(step: float) -> Array:
    """Return the weights (3, 2*_FLAT+1) of value, slope per s and curvature per s^2 at neighbours `step` s apart.

    Of all central differences of that length they are the flattest at low frequencies (Fornberg 1988).
    """
    at = np.arange(1, _FLAT + 1)
    ratio = np.array([(-1.0) ** (k + 1) * comb(2 * _FLAT, _FLAT - k) / comb(2 * _FLAT, _FLAT) for k in at.tolist()])
    slope, curvature = ratio / at / step, 2.0 * ratio / at**2 / step**2
    value = np.zeros(2 * _FLAT + 1)
    value[_FLAT] = 1.0
    return np.array(
        [
            value,
            np.concatenate([slope[::-1], [0.0], -slope]),
            np.concatenate([curvature[::-1], [-2.0 * curvature.sum()], curvature]),
        ]
    )


def passed(time: Array, values: Array, low_pass: LowPass) -> tuple[Array, Array, Array]:
    """Return value, slope and curvature (n,) of readings (n,) at their stamps (n,) s, rising.

    They are right where `is_sound`.
    """
    found = np.empty((_SIGNALS, len(time)))
    kernels = low_pass.kernels()
    for part in _stretches(time, low_pass.step):
        found[:, part] = _passed(time[part], values[part], low_pass, kernels)
    value, slope, curvature = found
    return value, slope, curvature


def passed_again(time: Array, values: Array, low_pass: LowPass, rows: Rows) -> Array:
    """Return the value of `passed` alone, of some rows, rising, for many readings (n,) at the same stamps.

    What depends on the stamps and the rows is kept.
    """
    if len(time) >= _KEPT / (2 * (low_pass.half + low_pass.near) + 3):
        return passed(time, values, low_pass)[0][rows]
    stamps, parts = time.tobytes(), _stretches(time, low_pass.step)
    if isinstance(rows, slice) or _FEW * len(rows) > len(time):
        kept = zip(parts, _weights(stamps, low_pass), strict=True)
        return np.concatenate([_value(values[part], low_pass, weights) for part, weights in kept])[rows]
    few = zip(parts, _weights_of(stamps, low_pass, rows.tobytes()), strict=True)
    return np.concatenate(
        [_value(values[one], low_pass, own, None if own is not None else _own(rows, one)) for one, own in few]
    )


def is_sound(time: Array, low_pass: LowPass) -> NDArray[np.bool_]:
    """Return whether (n,) each sample has all neighbours that the low-pass reaches to, with no gap between them."""
    found = np.zeros(len(time), dtype=bool)
    for part in _stretches(time, low_pass.step):
        found[part.start + low_pass.half : max(part.stop - low_pass.half, part.start + low_pass.half)] = True
    return found


def _stretches(time: Array, step: float) -> list[slice]:
    """Samples between which so little is lost that it can be interpolated."""
    breaks = np.flatnonzero(np.diff(time) > _BRIDGED * step) + 1
    return [slice(first, last) for first, last in pairwise([0, *breaks.tolist(), len(time)])]


def _passed(time: Array, values: Array, low_pass: LowPass, kernels: Array) -> Array:
    """The same of a stretch without gaps, a row for each kernel, of which the last has the slope of the one before."""
    from scipy.interpolate import CubicHermiteSpline

    if _is_even(time, low_pass):
        return _filtered(values, low_pass, kernels)
    if len(time) < 2 * low_pass.near + 1:
        return np.full((len(kernels), len(time)), np.nan)
    grid = _grid(time, low_pass)
    # a spline through noisy readings of which two are close would swing
    smooth = CubicHermiteSpline(time, *(local_polynomial(time, values, low_pass.near, order) for order in (0, 1)))
    value, slope, curvature = _filtered(smooth(grid), low_pass, kernels)
    return np.array(
        [
            CubicHermiteSpline(grid, value, slope)(time),
            CubicHermiteSpline(grid, slope, curvature)(time),
            np.interp(time, grid, curvature),
        ]
    )


def _value(values: Array, low_pass: LowPass, weights: csr_array | None, rows: NDArray[np.int64] | None = None) -> Array:
    """The first row of `_passed` of a stretch by its weights, None for one with even stamps; rows: of that which."""
    if weights is None:
        found = _filtered(values, low_pass, low_pass.kernels()[:1])[0]
        return np.asarray(found if rows is None else found[rows])
    base = values.mean()  # small numbers lose fewer digits
    return np.asarray(base + weights @ (values - base))


def _own(rows: NDArray[np.int64], part: slice) -> NDArray[np.int64]:
    """Those of the rows, rising, that lie in a stretch, counted from its first."""
    return np.asarray(rows[(rows >= part.start) & (rows < part.stop)] - part.start)


def _filtered(even: Array, low_pass: LowPass, kernels: Array) -> Array:
    """Readings at even times behind each kernel."""
    padded = np.pad(even - even[0], low_pass.half, mode="edge")
    # scipy.signal would cost half a second of start-up; what goes around the end is before the first of what is kept
    size = 1 << int(np.ceil(np.log2(len(padded))))
    spectra = np.fft.rfft(padded, size) * np.fft.rfft(kernels, size)
    found = np.fft.irfft(spectra, size)[:, 2 * low_pass.half : len(padded)]
    found[0] += even[0]
    return found


def _is_even(time: Array, low_pass: LowPass) -> bool:
    count = 1 + round((time[-1] - time[0]) / low_pass.step)
    even = np.linspace(time[0], time[-1], count) if count == len(time) else time + low_pass.step
    return bool(np.all(np.abs(even - time) < _EVEN * low_pass.step))


def _grid(time: Array, low_pass: LowPass) -> Array:
    """Even times around a stretch, the same whichever part of a recording is read."""
    first, last = np.floor(time[0] / low_pass.step), np.ceil(time[-1] / low_pass.step)
    return np.asarray(low_pass.step * np.arange(first, last + 1.0))


@lru_cache(maxsize=2)
def _weights(stamps: bytes, low_pass: LowPass) -> tuple[csr_array | None, ...]:
    """Return the weights (n, n) of each stretch, None for one with even stamps."""
    time = np.frombuffer(stamps)
    parts = (time[part] for part in _stretches(time, low_pass.step))
    return tuple(None if _is_even(part, low_pass) else _weights_in(part, low_pass) for part in parts)


@lru_cache(maxsize=16)
def _weights_of(stamps: bytes, low_pass: LowPass, rows: bytes) -> tuple[csr_array | None, ...]:
    """Return some rows of the weights: each costs as much as a value has neighbours."""
    wanted, parts = np.frombuffer(rows, dtype=np.int64), _stretches(np.frombuffer(stamps), low_pass.step)
    found = zip(parts, _weights(stamps, low_pass), strict=True)
    return tuple(None if weights is None else weights[_own(wanted, part)] for part, weights in found)


def _weights_in(time: Array, low_pass: LowPass) -> csr_array:
    """Return the weights (n, n) that make the filtered values of a stretch from its readings, as `_passed` does it.

    Readings go to the grid by a local polynomial, through the low-pass there, and back: each is a matrix.
    """
    from scipy.sparse import csr_array, diags_array

    if len(time) < 2 * low_pass.near + 1:
        return csr_array(diags_array(np.full(len(time), np.nan)))
    grid, half = _grid(time, low_pass), low_pass.half
    fits = [_local(time, low_pass.near, order) for order in (0, 1)]
    there = sum(part @ fit for part, fit in zip(_hermite(time, grid), fits, strict=True))
    ends = np.clip(np.arange(-half, len(grid) + half), 0, len(grid) - 1)
    padded = csr_array((np.ones(len(ends)), ends, np.arange(len(ends) + 1)), shape=(len(ends), len(grid))) @ there
    back = []
    for part, kernel in zip(_hermite(grid, time), low_pass.kernels()[:2], strict=True):
        offsets = range(2 * half + 1)
        through = diags_array(kernel[::-1], offsets=list(offsets), shape=(len(grid), len(ends)))
        back.append(part @ (through.tocsr() @ padded))
    return csr_array(back[0] + back[1])


def _local(time: Array, near: int, order: int) -> csr_array:
    """The weights (n, n) of a local polynomial: ones, m apart, have a single one in each window of m samples."""
    from scipy.sparse import csr_array

    count, width = len(time), 2 * near + 1
    at = np.arange(count)
    first = np.clip(at - near, 0, count - width)[:, None]
    neighbours = first + (np.arange(width) - first) % width
    weights = [local_polynomial(time, (at % width == k).astype(np.float64), near, order) for k in range(width)]
    return csr_array((np.stack(weights, axis=1).ravel(), neighbours.ravel(), width * np.arange(count + 1)))


def _hermite(knots: Array, at: Array) -> tuple[csr_array, csr_array]:
    """The weights (k, n) of values and slopes (n,) at the knots in the cubic between two of them, at times (k,)."""
    from scipy.sparse import csr_array

    left = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
    step = knots[left + 1] - knots[left]
    part = (at - knots[left]) / step
    places, rows = np.stack([left, left + 1], axis=1).ravel(), 2 * np.arange(len(at) + 1)
    later = part**2 * (3.0 - 2.0 * part)
    of_value = np.stack([1.0 - later, later], axis=1)
    of_slope = np.stack([part * (1.0 - part) ** 2, part**2 * (part - 1.0)], axis=1) * step[:, None]
    shape = (len(at), len(knots))
    return tuple(csr_array((values.ravel(), places, rows), shape=shape) for values in (of_value, of_slope))
