"""Correct the parameters for errors of the deflection: by instrumental variables, or by a simulation of the errors.

Noise and counts of the deflection stand in the regressors, so that a fit makes Kc and Bc too small (errors in
variables: Soderstrom 2007). What as many errors again do to the parameters is simulated (Cook and Stefanski 1994).
Where the command was recorded there is a better way: the motion that follows from the command by a short filter is
free of the readings' errors, and the model's columns for it are instruments (Young 2011; Pintelon and Schoukens 2012,
section 2.7). The command need not be what was driven, only go with it: how well it does is measured by how much less
certain the instruments make the parameters. Both act on the model linearised at its exact optimum, and so on nonlinear
parameters too. Nothing is changed where the change is small beside the intervals.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal, TypeGuard

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ga.model.separable import SeparableModel
from ga.model.trajectory import Motion
from hil.signals.deflection_noise import FEW_COUNTS
from hil.signals.savitzky_golay import local_polynomial
from hil.signals.windows import Window, is_smooth
from hil.uncertainty.effects import Recorded

Array = NDArray[np.float64]

_SAMPLES: Final = 40_000  # in a row, that are looked at
_FEWEST: Final = 400  # samples, below which nothing is corrected
_PAIRS: Final = 4  # of simulated errors, of either sign
_MATTERS: Final = 0.1  # of half an interval, from which a change is made
_NOTHING: Final = 2e-5  # of the power of deflection and rate, below which their errors are not looked at
_LEVEL: Final = 0.3  # of a simulated change, half the interval of its size: the errors' level is not known better
_WEAK: Final = 0.25  # of the information without instruments, below which they are too weak
_DELAYS: Final = (-1, 0, 1, 2, 3, 4, 6, 8, 12, 16, 24)  # of the filter from command to motion, in eighths of a period
_SURE: Final = 2.0  # times half its interval, beyond which a change is no chance
_BLOCKS: Final = 32  # in time, of which the error of a change is estimated
_CLIPPED: Final = 2.5  # standard deviations (from the median) beyond which a residual counts no more
_WIDER: Final = 1.25  # of a window, the next wider one, whose rate beside a jerk is wrong by as much more
_STILL: Final = 0.1  # of a count, by which readings behind a low-pass differ at most where the joint rests
_WITHIN: Final = 0.25  # of a count, by which the torque of the model differs at most among like ones in a row
_IN_STEP: Final = 2.5  # times their scatter in any other order, from which roundings go with the motion
_RESTS: Final = 10  # like readings in a row, from which it rests
_NORMAL: Final = 1.959964

Method = Literal["none", "simulation", "instruments"]


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model at its exact optimum, SI. torque (n,) N m as read; used (n,): the samples that it was fitted to.

    genes (p,), nonlinear (q,): its parameters. half_width (p + q,): of their intervals. decisive: the places of the
    parameters that decide whether anything is changed. command (n,): None where it was not recorded. torque_count:
    N m, the smallest step between two readings of the torque.
    """

    model: SeparableModel
    motion: Motion
    torque: Array
    used: NDArray[np.bool_]
    genes: Array
    nonlinear: Array
    half_width: Array
    decisive: tuple[int, ...]
    window: Window
    command: Array | None
    torque_count: float = 0.0

    def part(self) -> Fitted:
        """Return the fit on samples in a row from the middle of the recording."""
        first = max(0, (len(self.motion) - _SAMPLES) // 2)
        rows = slice(first, first + _SAMPLES)
        motion = replace(self.motion.of(rows), part_of=None)
        motion = replace(motion, starts=tuple(sorted({0, *(at for at in motion.starts if at < len(motion))})))
        command = None if self.command is None else self.command[rows]
        return replace(self, motion=motion, torque=self.torque[rows], used=self.used[rows], command=command)

    def linearised(self, motion: Motion) -> tuple[Array, Array]:
        """Return columns (n, p + q) and residuals (n,) N m of the model for another motion."""
        columns = linearised(self.model, motion, self.genes, self.nonlinear)
        left = self.model.target(motion, self.torque, self.nonlinear) - columns[:, : len(self.genes)] @ self.genes
        return columns, left

    def matters(self, change: Array) -> bool:
        """Return whether a change (p + q,) is large enough beside the intervals to be made."""
        at = list(self.decisive)
        return bool((np.abs(change[at]) > _MATTERS * self.half_width[at]).any())

    def shows(self, change: _Change) -> bool:
        """Return whether a change is large enough to be made and larger than its own error (Hausman 1978)."""
        return self.matters(np.where(np.abs(change.values) > _SURE * change.half_width, change.values, 0.0))


def linearised(model: SeparableModel, motion: Motion, genes: Array, nonlinear: Array) -> Array:
    """Return how the torque of a motion (n,) changes with genes (p,) and nonlinear parameters (q,): (n, p + q)."""
    lag = max(0.0, float(genes[1] / genes[0])) if model.needs_ratio and genes[0] > 0.0 else 0.0
    columns = model.columns(motion, nonlinear, lag)
    return np.concatenate([columns, model.jacobian(motion, nonlinear, genes, lag)], axis=1)


@dataclass(frozen=True, eq=False)
class _Change:
    """A change of the parameters (p + q,), and half the 95 % interval of it."""

    values: Array
    half_width: Array


@dataclass(frozen=True, eq=False)
class DeflectionErrors:
    """The errors of the deflection and what was done about them.

    noise: rad, standard deviation of the readings' errors. counts: of the encoder, peak to peak. low_pass: Hz, of the
    low-pass that the deflection went through, None for none. method: of the change. change (p + q,), SI: what is added
    to the parameters; half_width (p + q,): half the 95 % interval of it, and of roundings that go with the motion.
    predicted (p + q,), SI: the change by simulation. strength: 1 for a command that the motion follows, to 0; None
    where it was not recorded or not needed.
    """

    noise: float
    counts: float
    low_pass: float | None
    method: Method
    change: Array
    half_width: Array
    predicted: Array
    strength: float | None = None

    @property
    def is_weak(self) -> bool:
        """Whether there is a command, and the motion does not follow it."""
        return self.strength is not None and self.strength < _WEAK


def deflection_errors(fitted: Fitted) -> DeflectionErrors:
    """Return what the errors of the deflection do to the parameters, and the change by which they are corrected."""
    part, window, nothing = fitted.part(), fitted.window, np.zeros(len(fitted.half_width))
    counts = float(np.ptp(fitted.motion.dtheta)) / window.count if window.count else np.inf
    low_pass = window.low_pass.cut if window.low_pass else None
    sound = window.sound(part.motion.time) & part.used
    rounded = _rounded_at_rest(part, sound)
    found = DeflectionErrors(window.of_deflection, counts, low_pass, "none", nothing, rounded, nothing)
    if np.count_nonzero(sound) < _FEWEST or not _disturbed(part):
        return found
    simulated, spread = _simulated(part, sound)
    if counts < FEW_COUNTS or (window.count and _is_in_step(part, sound, spread)):
        rounded = np.maximum(rounded, spread)
    found = replace(found, predicted=simulated.values, half_width=rounded)
    instruments = _by_command(part, sound)
    # noise that is not white is more than its floor says, which only the command shows
    is_shown = instruments is not None and instruments[1] >= _WEAK and fitted.shows(instruments[0])
    if not fitted.matters(simulated.values) and not is_shown:
        return found
    if instruments is not None:
        found = replace(found, strength=instruments[1])
    change = simulated if instruments is None or found.is_weak else instruments[0]
    method: Method = "simulation" if change is simulated else "instruments"
    return replace(found, method=method, change=change.values, half_width=np.hypot(change.half_width, rounded))


def _rounded_at_rest(part: Fitted, sound: NDArray[np.bool_]) -> Array:
    """Return half the 95 % intervals (p + q,) of what rounding does where the joint rests.

    All readings of one angle or torque at rest are wrong by the same, somewhere within half a count, which no average
    takes away. Noise does not either for a torque in counts: the least sum of absolute errors is at one of its counts.
    Opposite readings may be wrong by opposite amounts, which change Kc by the same.
    """
    motion, count = part.motion, part.window.count
    columns, left = part.linearised(motion)
    torque = part.torque - left
    at_rest = _is_still(motion.dtheta, _STILL * count), _is_within(torque, _WITHIN * part.torque_count)
    found = np.zeros(len(part.half_width))
    for still, values, step in zip(at_rest, (motion.dtheta, torque), (count, part.torque_count), strict=True):
        rows = still & sound
        if rows.any():
            own = _influence(columns, sound)[:, rows[sound]]
            own = own * np.sign(values[rows]) * (_per_rad(part, left)[rows] if values is motion.dtheta else 1.0)
            level = np.unique(np.abs(np.round(values[rows] / step)), return_inverse=True)[1]
            of_level = np.array([np.bincount(level, weights=one) for one in own])
            most = 0.5 * np.abs(of_level).sum(axis=1)
            likely = _NORMAL / np.sqrt(12.0) * np.linalg.norm(of_level, axis=1)
            found = np.hypot(found, step * np.minimum(most, likely))
    return found


def _influence(columns: Array, sound: NDArray[np.bool_]) -> Array:
    """Return by how much each parameter changes with the torque of each sound sample, (p + q, m)."""
    sizes = np.linalg.norm(columns[sound], axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    return np.asarray(np.linalg.pinv(columns[sound] / sizes) / sizes[:, None])


def _per_rad(part: Fitted, left: Array) -> Array:
    """Return the torque (n,), N m, by which an error of 1 rad in the deflection changes the residuals (n,)."""
    count, zero = part.window.count, np.zeros((2, len(part.motion)))
    moved = _moved(part.motion, (np.full(len(part.motion), count), *zero))
    return np.asarray((left - part.linearised(moved)[1]) / count)


def _is_still(dtheta: Array, most: float) -> NDArray[np.bool_]:
    """Return whether each reading (n,) rad is among some that differ by less than `most`, rad, from one to the next."""
    alike = np.concatenate([[False], np.abs(np.diff(dtheta)) < most])
    run = np.cumsum(~alike)  # the number of the run of like readings that each is in
    return np.asarray(np.bincount(run)[run] >= _RESTS)


def _is_within(values: Array, most: float) -> NDArray[np.bool_]:
    """Return whether each value (n,) is among some in a row that differ by less than `most`."""
    found = np.zeros(len(values), dtype=bool)
    if len(values) >= _RESTS:
        first = np.flatnonzero(np.ptp(sliding_window_view(values, _RESTS), axis=1) < most)
        for later in range(_RESTS):
            found[first + later] = True
    return found


def _disturbed(part: Fitted) -> bool:
    window, motion = part.window, part.motion
    passed = window.low_pass.amplification()[0] if window.low_pass else 1.0
    shares = (
        (passed * window.of_deflection) ** 2 / max(float(np.var(motion.dtheta)), 1e-300),
        window.noise**2 / max(float(np.var(motion.dtheta_dot)), 1e-300),
    )
    return max(shares) > _NOTHING


def _simulated(part: Fitted, sound: NDArray[np.bool_]) -> tuple[_Change, Array]:
    """Return the correction, found by adding as many errors again, and 1.96 times its standard deviation.

    The interval has that scatter already, unless it is of a rounding in step with the motion.
    """
    added = _added(part, sound, _errors(part.motion, part.window))
    means = added.mean(axis=1)  # of either sign: what errors add on average is what both have in common
    change = -means.mean(axis=0)
    error = np.std(means, axis=0, ddof=1) / np.sqrt(_PAIRS)
    return _Change(change, np.hypot(_LEVEL * change, _NORMAL * error)), _scatter(added)


def _is_in_step(part: Fitted, sound: NDArray[np.bool_], spread: Array) -> bool:
    """Return whether roundings change Kc or Bc by far more than the same errors in any other order.

    Motion that repeats is rounded alike each time. spread (p + q,): of `_simulated`.
    """
    rng = np.random.default_rng(1)
    shuffled = _added(part, sound, (rng.permutation(one) for one in _errors(part.motion, part.window)))
    at = list(part.decisive)
    return bool((spread[at] > _IN_STEP * _scatter(shuffled)[at]).any())


def _added(part: Fitted, sound: NDArray[np.bool_], errors: Iterable[Array]) -> Array:
    """Return what errors (n,) rad add to the parameters, (k, 2, p + q): for each, and for it with the other sign."""

    def step(motion: Motion) -> Array:
        columns, left = part.linearised(motion)
        return _solved(columns[sound], columns[sound], left[sound])

    without = step(part.motion)
    return np.array([[step(moved) - without for moved in _more(part.motion, part.window, one)] for one in errors])


def _scatter(added: Array) -> Array:
    """Return half the 95 % intervals (p + q,) of what errors add at random: with the other sign it is the opposite."""
    return np.asarray(_NORMAL * np.sqrt(np.mean((0.5 * (added[:, 0] - added[:, 1])) ** 2, axis=0)))


def _more(motion: Motion, window: Window, errors: Array) -> tuple[Motion, Motion]:
    """Return the motion with more errors (n,) rad in its readings, and with the same of the other sign."""
    more = np.array(_behind(window, motion, errors))
    if window.low_pass is None:
        for part in _stretches(motion):  # near its ends a local polynomial has many times the noise
            more[:, part.start : part.start + window.widest] = 0.0
            more[:, max(part.start, part.stop - window.widest) : part.stop] = 0.0
    return _moved(motion, (more[0], more[1], more[2])), _moved(motion, (-more[0], -more[1], -more[2]))


def _errors(motion: Motion, window: Window) -> Iterator[Array]:
    """Errors (n,) rad as the readings may have them: noise, then rounding to counts."""
    rng, count, span = np.random.default_rng(0), window.count, float(np.ptp(motion.dtheta))
    # counts that are rounded once more would follow from the angle
    smooth = motion.dtheta.copy()
    for part in _stretches(motion):
        if part.stop - part.start > 2 * window.slope:
            fit = local_polynomial(motion.time[part], motion.dtheta[part], window.slope, 0)
            smooth[part] = np.where(np.isfinite(fit), fit, motion.dtheta[part])
    beside = np.sqrt(max(0.0, window.of_deflection**2 - count**2 / 12.0))
    for _ in range(_PAIRS):
        noise = beside * rng.standard_normal(len(motion))
        if count > 0.0:
            # where the motion turns within a count decides how the rounding goes with it, and is not known
            true = smooth * (1.0 + count / span * rng.uniform(-1.0, 1.0)) + noise + count * rng.random()
            noise = noise + count * np.round(true / count) - true
        yield noise


def _behind(window: Window, motion: Motion, readings: Array) -> tuple[Array, Array, Array]:
    """Readings (n,) behind the window, with slope and curvature; zero in stretches that are too short for it."""
    found = np.zeros((3, len(motion)))
    for part in _stretches(motion):
        if window.low_pass is not None or part.stop - part.start > 2 * window.widest:
            found[:, part] = window.moved(motion.time[part], readings[part])
    value, slope, curvature = np.nan_to_num(found)
    return value, slope, curvature


def _stretches(motion: Motion) -> list[slice]:
    return [slice(first, last) for first, last in pairwise([*motion.starts, len(motion)]) if last > first]


def _moved(motion: Motion, more: tuple[Array, Array, Array]) -> Motion:
    """The motion with more deflection, rate and acceleration (n,); the motor's own torque follows the latter two."""
    value, slope, curvature = more
    own = np.stack([motion.dtheta_dot, motion.dtheta_ddot], axis=1)
    share = np.linalg.lstsq(own, motion.known, rcond=None)[0] if motion.known.any() else np.zeros(2)
    return replace(
        motion,
        dtheta=motion.dtheta + value,
        dtheta_dot=motion.dtheta_dot + slope,
        dtheta_ddot=motion.dtheta_ddot + curvature,
        known=motion.known + np.stack([slope, curvature], axis=1) @ share,
        part_of=None,
    )


def _by_command(part: Fitted, sound: NDArray[np.bool_]) -> tuple[_Change, float] | None:
    """Return the correction by the instruments, and their strength; None without a command."""
    if not is_instrument(part.command):
        return None
    motion = followed(part.motion, part.window, part.command, sound)
    columns, left = (of[sound] for of in part.linearised(part.motion))
    instruments, residuals = part.linearised(motion)[0][sound], _clipped(left)
    sizes = np.linalg.norm(columns, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    z, x = instruments / sizes, columns / sizes
    across, own = np.linalg.pinv(z.T @ x), np.linalg.pinv(x.T @ x)
    at = list(part.decisive)
    less_certain = np.diag(across @ (z.T @ z) @ across.T)[at] / np.maximum(np.diag(own)[at], 1e-300)
    each = (z @ across.T - x @ own) * residuals[:, None]
    sums = np.add.reduceat(each, np.arange(_BLOCKS) * len(each) // _BLOCKS, axis=0)
    error = np.sqrt(_BLOCKS * np.var(sums, axis=0, ddof=1))
    change = _Change(each.sum(axis=0) / sizes, _NORMAL * error / sizes)
    return change, float(min(1.0, 1.0 / max(float(less_certain.max()), 1e-300)))


def is_instrument(command: Array | None) -> TypeGuard[Array]:
    """Return whether set-points (n,) were recorded and change."""
    return command is not None and bool(np.isfinite(command).all()) and float(np.ptp(command)) > 0.0


def followed(motion: Motion, window: Window, command: Array, sound: NDArray[np.bool_]) -> Motion:
    """Return the motion that follows from the command (n,) by a filter of a few delays, fitted where sound (n,)."""
    unit = 1.0 / (8.0 * window.band[1])
    recorded = Recorded(motion.time, motion.known, motion.dtheta, motion.dtheta_dot, motion.starts)
    parts = _behind(window, motion, command - command.mean())
    value, *rates = (np.stack([recorded.delayed(one, lag * unit) for lag in _DELAYS], axis=1) for one in parts)
    value = value - value[sound].mean(axis=0)
    middle = float(motion.dtheta[sound].mean())
    weights = np.linalg.lstsq(value[sound], motion.dtheta[sound] - middle, rcond=1e-9)[0]
    less = (middle + value @ weights - motion.dtheta, *(of @ weights for of in rates))
    return _moved(motion, (less[0], less[1] - motion.dtheta_dot, less[2] - motion.dtheta_ddot))


def noisier(motion: Motion, window: Window) -> Iterator[tuple[Motion, Motion]]:
    """Yield pairs of motions with as many errors again of deflection and rate, of either sign, each time others."""
    smoothed = _smoothed_away(motion, window)
    for errors in _errors(motion, window):
        more, less = _more(motion, window, errors)
        yield (
            replace(more, dtheta_dot=more.dtheta_dot + smoothed),
            replace(less, dtheta_dot=less.dtheta_dot - smoothed),
        )


def _smoothed_away(motion: Motion, window: Window) -> Array:
    """Return the part of the rate (n,), rad/s, that the window smooths away, from the rates of two wider windows.

    The changes grow by one factor, as a geometric series, of which the window's own error is all that comes before.
    """
    first, second = np.zeros((2, len(motion)))
    if window.low_pass is not None:  # flat up to where the deflection's noise hides all
        return first
    wider = [max(window.slope + more, int(_WIDER**more * window.slope)) for more in (1, 2)]
    for part in _stretches(motion):
        inside = slice(part.start + wider[1], part.stop - wider[1])
        if inside.stop > inside.start:
            near = [local_polynomial(motion.time[part], motion.dtheta[part], half, 1) for half in wider]
            once, twice = (np.nan_to_num(rate)[wider[1] : -wider[1]] for rate in near)
            first[inside], second[inside] = motion.dtheta_dot[inside] - once, once - twice
    ratio = float(first @ second) / max(float(second @ second), 1e-300)
    ratio = min(max(ratio, 0.0), 1.0 / _WIDER)
    sure = is_smooth(motion)  # no test looks at the others
    return np.asarray(np.where(sure, ratio / (1.0 - ratio) * first, 0.0))


def _solved(columns: Array, instruments: Array, left: Array) -> Array:
    """Return the change of the parameters (p + q,) that makes the residuals (n,) orthogonal to the instruments."""
    sizes = np.linalg.norm(columns, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    gram = (instruments / sizes).T @ (columns / sizes)
    found = np.linalg.lstsq(gram, (instruments / sizes).T @ _clipped(left), rcond=1e-12)[0]
    return np.asarray(found / sizes)


def _clipped(left: Array) -> Array:
    """Return residuals (n,) N m clipped as in Huber's (1964) estimate, scaled so that a step has full length."""
    limit = _CLIPPED * 1.4826 * float(np.median(np.abs(left)))
    inside = float(np.mean(np.abs(left) < limit))
    return np.asarray(np.clip(left, -limit, limit) / max(0.5, inside))
