"""Simulate errors of the deflection: the effect of adding them once more on the parameters and on the lack-of-fit
tests.

Noise and rounding of the deflection are in the regressors (errors in variables: Soderstrom 2007). The effect of adding
the same errors once more is subtracted from the parameters (Cook and Stefanski 1994).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ga.arrays import Array, Mask
from ga.model.trajectory import Motion
from hil.identification.deflection.fitted import Change, Fitted, behind, moved, sampled, solved
from hil.signals.constants import ERROR_LEVEL, IN_STEP, NARROWER, NORMAL, PAIRS, ROUNDING
from hil.signals.rate.savitzky_golay import local_polynomial
from hil.signals.rate.windows import Window, is_smooth


def simulated_change(part: Fitted, sound: Mask) -> tuple[Change, Array]:
    """Return the correction found by adding the same errors once more, and 1.96 times the standard deviation of the
    random part.

    The parameters' intervals include this scatter already, except for rounding that repeats with the motion.
    """
    added = _added(part, sound, _errors(sampled(part.motion), part.window))
    means = added.mean(axis=1)  # of either sign: what errors add on average is what both have in common
    change = -means.mean(axis=0)
    error = np.std(means, axis=0, ddof=1) / np.sqrt(PAIRS)
    return Change(change, np.hypot(ERROR_LEVEL * change, NORMAL * error)), _scatter(added)


def is_in_step(part: Fitted, sound: Mask, spread: Array) -> bool:
    """Return whether rounding changes Kc or Bc by far more than the same errors in random order.

    Periodic motion is rounded in the same way in each period. spread (p + q,): the second result of `simulated_change`.
    """
    rng = np.random.default_rng(1)
    shuffled = _added(part, sound, (rng.permutation(one) for one in _errors(sampled(part.motion), part.window)))
    at = list(part.decisive)
    return bool((spread[at] > IN_STEP * _scatter(shuffled)[at]).any())


def noisier(motion: Motion, window: Window) -> Iterator[tuple[Motion, Motion]]:
    """Yield pairs of motions with additional errors, without end.

    For each pair, errors of deflection and rate are drawn that are as large as those already in the recording; the
    first motion has them added, the second one subtracted. window: the window that the rate is computed with.
    """
    smoothed = _smoothed_away(motion.whole[0], window)
    for errors in _errors(sampled(motion), window):
        yield _more(motion, window, errors, smoothed)


def _added(part: Fitted, sound: Mask, errors: Iterable[Array]) -> Array:
    """Return the changes of the parameters, (k, 2, p + q), by k draws of errors: with the errors and with their
    opposites.

    errors: the draws, each (n,), rad.
    """

    def step(motion: Motion) -> Array:
        columns, left = part.linearised(motion)
        return solved(columns[sound], columns[sound], left[sound])

    without = step(part.motion)
    return np.array([[step(moved) - without for moved in _more(part.motion, part.window, one)] for one in errors])


def _scatter(added: Array) -> Array:
    """Return half the 95 % intervals (p + q,) of the random effect of errors, which changes sign with the errors.

    added: the result of `_added`.
    """
    return np.asarray(NORMAL * np.sqrt(np.mean((0.5 * (added[:, 0] - added[:, 1])) ** 2, axis=0)))


def _more(motion: Motion, window: Window, errors: Array, of_rate: Array | float = 0.0) -> tuple[Motion, Motion]:
    """Return two motions: with errors added to the readings, and with the same errors subtracted.

    errors (n,): errors of the angle's readings, rad. of_rate (n,): additional errors of the rate, rad/s.
    """
    whole = sampled(motion)
    more = np.array(behind(window, whole, errors))
    if window.low_pass is None:
        for part in whole.pieces:  # near its ends a local polynomial has many times the noise
            more[:, part.start : part.start + window.widest] = 0.0
            more[:, max(part.start, part.stop - window.widest) : part.stop] = 0.0
    more[1] += of_rate
    return moved(motion, (more[0], more[1], more[2])), moved(motion, (-more[0], -more[1], -more[2]))


def _errors(motion: Motion, window: Window) -> Iterator[Array]:
    """Draw measurement errors (n,), rad: noise, then rounding to encoder counts."""
    rng, count, span = np.random.default_rng(0), window.count, float(np.ptp(motion.dtheta))
    # counts that are rounded once more would follow from the angle
    smooth = motion.dtheta.copy()
    for part in motion.pieces:
        if part.stop - part.start > 2 * window.slope:
            fit = local_polynomial(motion.time[part], motion.dtheta[part], window.slope, 0)
            smooth[part] = np.where(np.isfinite(fit), fit, motion.dtheta[part])
    beside = np.sqrt(max(0.0, window.of_deflection**2 - (ROUNDING * count) ** 2))
    for _ in range(PAIRS):
        noise = beside * rng.standard_normal(len(motion))
        if count > 0.0:
            # where the motion turns within a count decides how the rounding goes with it, and is not known
            true = smooth * (1.0 + count / span * rng.uniform(-1.0, 1.0)) + noise + count * rng.random()
            noise = noise + count * np.round(true / count) - true
        yield noise


def _smoothed_away(motion: Motion, window: Window) -> Array:
    """Return the part of the rate (n,), rad/s, that the window removes, estimated from the rates of two wider windows.

    The changes from window to window grow by a constant factor; the window's own error is the sum of the earlier terms
    of this geometric series.
    """
    first, second = np.zeros((2, len(motion)))
    if window.low_pass is not None:  # flat up to where the deflection's noise hides all
        return first
    wider = [max(window.slope + more, int(window.slope / NARROWER**more)) for more in (1, 2)]
    for part in motion.pieces:
        inside = slice(part.start + wider[1], part.stop - wider[1])
        if inside.stop > inside.start:
            near = [local_polynomial(motion.time[part], motion.dtheta[part], half, 1) for half in wider]
            once, twice = (np.nan_to_num(rate)[wider[1] : -wider[1]] for rate in near)
            first[inside], second[inside] = motion.dtheta_dot[inside] - once, once - twice
    ratio = float(first @ second) / max(float(second @ second), 1e-300)
    ratio = min(max(ratio, 0.0), NARROWER)
    sure = is_smooth(motion, window)  # no test looks at the others
    return np.asarray(np.where(sure, ratio / (1.0 - ratio) * first, 0.0))
