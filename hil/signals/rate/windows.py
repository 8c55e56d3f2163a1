"""Choose the windows of the local polynomials for a recording: as wide as its excited band allows, so that they pass
little noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ga.arrays import Array, Mask
from ga.model.sticking import beyond_noise
from ga.model.trajectory import Motion
from hil.signals import constants as c
from hil.signals.deflection_noise import disturbs, own_noise, smallest_step
from hil.signals.rate.low_pass import LowPass, is_sound, low_pass_for, passed, passing
from hil.signals.rate.savitzky_golay import LEAST, kernel, local_polynomial, widest
from hil.signals.rate.spectrum import Spectrum
from hil.signals.slow_channel import Readings, noise_beside_any_shape
from hil.signals.stamps import mean_step

_NARROW = (LEAST, LEAST + 1)  # the same of windows that are no wider than needed: few samples are lost to a jump


@dataclass(frozen=True, slots=True)
class Window:
    """The windows of the local polynomials of a recording, or the low-pass in their place.

    slope, curvature: numbers of neighbours on each side. step: median time between two samples, s. band: the excited
    band, Hz. noise: standard deviation of the slope's noise, rad/s. of_deflection: standard deviation of the readings'
    noise, rad. count: the smallest step between two readings, rad. unseen: errors of the rate, rad/s, too small for the
    lack-of-fit tests to detect beside the torque's noise. low_pass: used in place of the polynomials if the noise would
    change Kc or Bc, or if the joint moves too fast for the narrowest polynomial. noisy: whether the noise is the
    reason. jerk, rad/s, and jump, rad/s^2: the largest differences between rates and between accelerations in several
    windows where the acceleration does not jump; infinite if a jump would not show in the torque of the damping or of
    an inertia.
    """

    slope: int
    curvature: int
    step: float
    band: tuple[float, float]
    noise: float
    of_deflection: float
    count: float
    unseen: float = 0.0
    low_pass: LowPass | None = None
    noisy: bool = False
    jerk: float = np.inf
    jump: float = np.inf

    @property
    def jerks(self) -> bool:
        """Return whether the acceleration jumps, so that some samples have no rate or no acceleration."""
        return bool(np.isfinite(self.jerk) or np.isfinite(self.jump))

    @property
    def widest(self) -> int:
        """Return the number of neighbours on each side of a sample in the widest of the window's filters."""
        return max(self.slope, self.curvature, self.low_pass.half if self.low_pass else 0)

    def moved(self, time: Array, dtheta: Array) -> tuple[Array, Array, Array]:
        """Return deflection, rate and acceleration (n,), computed with this window from readings (n,), rad, at rising
        stamps (n,), s.
        """
        if self.low_pass:
            return passed(time, dtheta, self.low_pass)
        rate = local_polynomial(time, dtheta, self.slope, 1)
        return dtheta, rate, local_polynomial(time, dtheta, self.curvature, 2)

    def alike(self, time: Array, values: Array) -> Array:
        """Return values (n,) filtered as the deflection was, so that relations between values and deflection are
        preserved.
        """
        return values if self.low_pass is None else _known(passed(time, values, self.low_pass)[0], values)

    @property
    def longest_step(self) -> float:
        """Return the longest time between two samples, s, at which the filter of `passing` is possible."""
        return self.low_pass.longest_step if self.low_pass else np.inf

    def of_every(self, every: int) -> Window:
        """Return the window whose `passing` filters a signal that has only every `every`-th sample in the same way."""
        return replace(self, low_pass=self.low_pass.of_every(every)) if self.low_pass else self

    def passing(self, time: Array) -> Callable[[Array], Array]:
        """Return a function that filters values (n,) at the stamps (n,), s; a search calls it many times."""
        if self.low_pass is None:
            return lambda values: values
        through = passing(time, self.low_pass)
        return lambda values: _known(through(values), values)

    def jerked(self, time: Array, dtheta: Array, rate: Array, acceleration: Array) -> Mask:
        """Return the samples (n,) beside a jump of the acceleration, where no window gives the true motion."""
        of_rate = _differing(time, dtheta, rate, _NARROW) > self.jerk
        if not np.isfinite(self.jump):
            return of_rate
        return of_rate | (_differing(time, dtheta, acceleration, _NARROW, order=2) > self.jump)

    def sound(self, time: Array) -> Mask:
        """Return the samples (n,) for which all neighbours exist from which the rate is computed."""
        return is_sound(time, self.low_pass) if self.low_pass else _whole(time, self.widest, self.step)


def _known(found: Array, values: Array) -> Array:
    return np.where(np.isfinite(found), found, values)


def window_for(time: Array, dtheta: Array, torque: Array, cell: Readings | None = None) -> Window:
    """Return the widest windows that the excited band allows; the slope's window is then narrowed as far as its noise
    permits.

    The noise of the deflection (n,), rad, is acceptable if its effect on the torque (n,), N m, is small. cell: the
    readings that the torque was interpolated from, if there are fewer than samples; the steps between them are not
    noise.
    """
    step, count = float(np.median(np.diff(time))), smallest_step(dtheta)
    rounding = c.ROUNDING * count
    # counts round in step with slow motion: above, their noise is then less than below, or lines
    spectrum = Spectrum.of(time, dtheta, rounding)
    band, floor = spectrum.band, spectrum.noise
    slope, curvature = windows(time, band[1])
    rate = local_polynomial(time, dtheta, slope, 1)
    left = _noise_of(time, dtheta)
    acceleration = local_polynomial(time, dtheta, curvature, 2)
    # a window across a long gap has no slope, and stamps that are alike no noise
    known = np.isfinite(rate) & np.isfinite(left) & np.isfinite(acceleration)
    some = np.flatnonzero(known)[: c.ENOUGH]
    seen = Motion(time[some], dtheta[some], rate[some], acceleration[some], np.zeros(len(some)))
    of_torque = _own_noise(seen, torque[some], cell)
    hidden = _hidden(seen, torque[some], of_torque)
    rate, left = rate[known], left[known]
    fast = np.abs(rate) >= np.quantile(np.abs(rate), c.MOST)  # there wrong time stamps make noise too
    noise, fastest = float(np.median(left)), float(np.median(left[fast]))
    of_deflection = max(own_noise(min(noise, floor), seen.dtheta, torque[some]), rounding)
    slope = max(
        narrowed(slope, step, noise, hides_in_rate(rate)),
        narrowed(slope, step, fastest, hides_in_rate(rate[fast])),
        narrowed(slope, step, of_deflection, hidden),
    )
    first = time[: c.ENOUGH], dtheta[: c.ENOUGH]
    slope = best_of(slope, *first, of_deflection)
    curvature = best_of(curvature, *first, of_deflection, order=2)
    found = Window(
        slope, curvature, step, band, noise * _amplified(slope, step), of_deflection, count, c.MAJORITY * hidden
    )
    noisy = disturbs(seen, torque[some], step, of_deflection, of_deflection * _amplified(slope, step))
    following = None if noisy else _following(found, *first, torque[: c.ENOUGH], of_torque)
    if following is None and not noisy and cell is not None:
        # torque readings so far apart cannot pass the low-pass that the deflection would
        following = _jumping(found, *first, torque[: c.ENOUGH], of_torque)
    ripple = np.inf if cell else min(spectrum.ripple_begins, _ripple_of_torque(time, torque, spectrum.main))
    if following is not None and np.isinf(ripple):
        return following
    highest = spectrum.above(of_deflection)
    if np.isfinite(ripple):
        highest = min(max(highest, band[1]), ripple / c.STOPPED)
    elif not noisy:  # what goes on beyond is taken from torque and deflection alike, also where sampling has folded it
        highest = max(spectrum.band[1], min(highest, c.FOLLOWED / step))
    low_pass = low_pass_for(time, highest, min(slope, c.NARROWEST))
    if low_pass is None:
        return found
    of_rate = float(found.of_deflection * low_pass.amplification()[1])
    # a low-pass blurs a jump over many samples, whose errors are alike
    return replace(found, low_pass=low_pass, noisy=noisy, unseen=0.0, noise=of_rate)


def _ripple_of_torque(time: Array, torque: Array, main: float) -> float:
    """Return the frequency, Hz, above which the torque (n,), N m, contains only ripple; infinite without ripple.

    Rounding to counts may hide such a ripple in the deflection. main: the frequency up to which the joint moves, Hz.
    The result is infinite also if readings are missing, because that makes steps.
    """
    steps = np.diff(time)
    if steps.max() > c.MISSING * float(np.median(steps)):
        return np.inf
    return Spectrum.of(time, torque, c.GAIN_ERROR * float(np.std(torque))).rises_beyond(main)


def narrowed(slope: int, step: float, noise: float, allowed: float) -> int:
    """Return the narrowest window whose noise is below `allowed`, rad/s, as neighbours on each side, at most `slope`.

    step: time between two samples, s. noise: standard deviation of the deflection's noise, rad. A wide window removes
    details, such as the kinks where the joint sticks, and lowers Bc.
    """
    while slope > c.NARROWEST and noise * _amplified(slope - 1, step) <= allowed:
        slope -= 1
    return slope


def best_of(half: int, time: Array, dtheta: Array, noise: float, *, order: int = 1) -> int:
    """Return the window, at most `half` neighbours on each side, with the smallest sum of noise and smoothing error.

    noise: standard deviation of the noise of the deflection (n,), rad. Both errors would dominate the residuals of a
    quiet torque. The slopes (order 2: the curvatures) of two windows differ by the difference of their noise power, and
    by the part of the motion that the wider window removes.
    """
    step = float(np.median(np.diff(time)))
    found, whole = local_polynomial(time, dtheta, half, order), _whole(time, half, step)
    while half > c.NARROWEST and whole.any():
        less = max(c.NARROWEST, int(c.NARROWER * half))
        narrower = local_polynomial(time, dtheta, less, order)
        more_noise = noise**2 * (_amplified(less, step, order) ** 2 - _amplified(half, step, order) ** 2)
        if float(np.mean((narrower - found)[whole] ** 2)) <= 2.0 * more_noise:
            break
        half, found = less, narrower
    return half


def _following(found: Window, time: Array, dtheta: Array, torque: Array, own: float) -> Window | None:
    """Return the window `found` if its polynomials follow the motion except beside jumps of the acceleration.

    None if they do not. time, dtheta, torque (n,): s, rad and N m. own: standard deviation of the torque's noise, N m.
    """
    if smoothed_away(found.slope, time, dtheta, found.of_deflection) <= found.unseen:
        return _jumping(found, time, dtheta, torque, own)
    narrow = local_polynomial(time, dtheta, found.slope, 1)
    apart = _differing(time, dtheta, narrow, _NARROW)
    jerky = replace(found, jerk=beyond_noise(apart, narrow))
    smooth = ~(apart > jerky.jerk)
    if _power(narrow, smooth) < c.MAJORITY * _power(narrow):
        return None
    away = smoothed_away(found.slope, time, dtheta, found.of_deflection, seen=smooth)
    return _jumping(jerky, time, dtheta, torque, own) if away <= found.unseen else None


def _jumping(found: Window, time: Array, dtheta: Array, torque: Array, own: float) -> Window:
    """Return the window `found`. If smoothing would change the torque of the joint's inertia, the window leaves out the
    samples beside jumps of the acceleration.

    time, dtheta (n,): s and rad. torque (n,): N m; the inertia is estimated from it. own: standard deviation of the
    torque's noise, N m.
    """
    _, rate, acceleration = found.moved(time, dtheta)
    apart = _differing(time, dtheta, acceleration, _NARROW, order=2)
    jumping = replace(found, jump=beyond_noise(apart, acceleration))
    known = np.isfinite(rate + acceleration)
    smooth = known & ~jumping.jerked(time, dtheta, rate, acceleration)
    away = smoothed_away(found.curvature, time, dtheta, found.of_deflection, order=2)
    columns = np.stack([np.ones_like(rate), dtheta, rate, acceleration, np.sign(rate)], axis=1)
    # friction may hide it without the samples beside jumps, and the smoothing with them: the larger value counts
    inertia = max(abs(np.linalg.lstsq(columns[rows], torque[rows], rcond=None)[0][3]) for rows in (smooth, known))
    is_felt = float(inertia) * away > c.FELT_INERTIA * own
    return jumping if is_felt and _power(rate, smooth) >= c.MAJORITY * _power(rate) else found


def smoothed_away(
    half: int, time: Array, dtheta: Array, noise: float, *, seen: Mask | None = None, order: int = 1
) -> float:
    """Return the part of the rate, rad/s r.m.s., that a window of `half` neighbours on each side removes.

    This part is the difference to the rate of the narrowest possible polynomial, without the noise of the deflection.
    dtheta (n,): the deflection, rad. noise: the standard deviation of its noise, rad. seen (n,): the samples that are
    compared; all if None. order: 2 for the part of the acceleration, rad/s^2.
    """
    step = float(np.median(np.diff(time)))
    half = max(half, LEAST + 1)  # nothing is narrower than the least
    whole = _whole(time, half, step) & (True if seen is None else seen)
    if not whole.any():
        return 0.0
    more = (local_polynomial(time, dtheta, LEAST, order) - local_polynomial(time, dtheta, half, order))[whole]
    of_noise = noise**2 * (_amplified(LEAST, step, order) ** 2 - _amplified(half, step, order) ** 2)
    power = float(np.mean(more**2))
    return float(np.sqrt(power - of_noise)) if power > 2.0 * of_noise else 0.0


def _power(rate: Array, rows: Mask | None = None) -> float:
    """Return the sum of squares of the known rates (n,), (rad/s)^2. rows (n,): the samples that count; all if None."""
    return float(np.nansum(np.square(rate) if rows is None else np.square(rate[rows])))


def hides_in_rate(rate: Array) -> float:
    """Return the standard deviation of noise, rad/s, that lowers the Bc computed from a rate (n,), rad/s, by 0.01 %."""
    return c.RATE_NOISE * float(np.sqrt(np.mean(rate**2)))


def _hidden(motion: Motion, torque: Array, own: float) -> float:
    """Return the noise of the rate, rad/s, that cannot be detected beside the noise of the torque (n,), N m.

    own: standard deviation of the torque's noise, N m. More noise of the rate would dominate the residuals, and the
    deflection's readings would then predict the residuals.
    """
    columns = np.stack([np.ones(len(motion)), motion.dtheta, motion.dtheta_dot], axis=1)
    damping = float(np.linalg.lstsq(columns, torque, rcond=None)[0][2])
    return c.HIDDEN_NOISE * own / abs(damping) if damping else np.inf


def _own_noise(motion: Motion, torque: Array, cell: Readings | None) -> float:
    """Return the standard deviation of the noise of a torque (n,), N m, but at least GAIN_ERROR times the torque's.

    cell: the torque cell's own readings, if there are fewer of them than samples.
    """
    if cell is None:
        own = own_noise(float(np.nanmedian(_noise_of(motion.time, torque))), torque, motion.dtheta)
    else:
        own = noise_beside_any_shape(cell, motion)
    return max(own, c.GAIN_ERROR * float(np.std(torque)))


def _noise_of(time: Array, values: Array) -> Array:
    """Return the distance (n,) of values from a narrow local polynomial, scaled so that its median is the noise's
    standard deviation.
    """
    left = np.abs(values - local_polynomial(time, values, c.NARROWEST, 0))
    return np.asarray(left * (c.SPREAD / np.sqrt(1.0 - float(kernel(c.NARROWEST, 0)[c.NARROWEST]))))


def _amplified(half: int, step: float, order: int = 1) -> float:
    """Return the standard deviation of the slope, rad/s, or (order 2) of the curvature, rad/s^2, for noise of 1 rad in
    the deflection. half: neighbours on each side in the window. step: time between two samples, s.
    """
    return float(np.linalg.norm(kernel(half, order))) / step**order


def windows(time: Array, highest: float) -> tuple[int, int]:
    """Return the widest windows that give slope and curvature of motion up to `highest`, Hz, as neighbours on each
    side.
    """
    cycles = highest * mean_step(time)
    most = min(c.WIDEST, (len(time) - 1) // c.WINDOWS)
    slope, curvature = (widest(order, cycles, most, c.GAIN_ERROR) for order in (1, 2))
    return slope, min(slope, curvature)


def _whole(time: Array, half: int, step: float) -> Mask:
    """Return the samples (n,) whose window, `half` neighbours on each side, is centred on the sample and free of gaps.
    step: time between two samples, s.
    """
    whole = np.zeros(len(time), dtype=bool)
    whole[half : len(time) - half] = time[2 * half :] - time[: -2 * half] <= 3.0 * half * step
    return whole


def is_smooth(motion: Motion, window: Window | None) -> Mask:
    """Return the samples (n,) whose rate hardly depends on the window that it is computed with. Beside a jump of the
    acceleration it depends on the window.

    window: the window that was used, if known. Only somewhat wider windows are compared with it, because much wider
    ones give another rate even where the rate is right. Two differences are ignored: noise of the deflection, which a
    wider window averages too, and differences that the torque's noise hides.
    """
    seen, rows = motion.whole
    # a low-pass that takes noise out blurs a jump as far as wide windows reach
    half, unseen = (window.slope, window.unseen) if window and not window.noisy else (c.OTHER_WINDOWS[0], 0.0)
    others = tuple(min(half + more, most) for more, most in zip(c.OTHER_WIDER, c.OTHER_WINDOWS, strict=True))
    if len(seen) <= 2 * max(others):
        return np.ones(len(motion), dtype=bool)
    apart = _differing(seen.time, seen.dtheta, seen.dtheta_dot, others)
    return (apart <= max(unseen, beyond_noise(apart, seen.dtheta_dot)))[rows]


def _differing(time: Array, dtheta: Array, rate: Array, halves: tuple[int, ...], order: int = 1) -> Array:
    """Return the largest difference (n,), rad/s, between the rate (n,) and the rates of other windows.

    halves: the other windows, neighbours on each side; the rate itself may come from one of them. order: 2 for an
    acceleration, rad/s^2.
    """
    return np.asarray(np.max([np.abs(local_polynomial(time, dtheta, half, order) - rate) for half in halves], axis=0))
