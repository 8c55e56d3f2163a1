"""The spectrum of a deflection: the frequencies up to which the joint moved, its ripple, and the noise floor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ga.arrays import Array
from hil.signals import constants as c
from hil.signals.stamps import mean_step, pieces


def excited_band(time: Array, dtheta: Array) -> tuple[float, float]:
    """Return the excited band, Hz: the frequencies at which the deflection (n,), rad, is larger than its own noise.

    Below the band lies 1 % of the deflection's power, above the band 1 % of the rate's power. The noise floor is the
    median density in the upper half of the spectrum.
    """
    return Spectrum.of(time, dtheta).band


def power_of(time: Array, values: Array) -> tuple[Array, Array, float]:
    """Return frequencies (k,), Hz, the power (k,) of values (n,) at rising stamps (n,), s, and that of white noise of
    variance one.

    The powers of the pieces between pauses are added. Only the outermost samples of a piece are tapered, because a
    chirp is fastest at its end.
    """
    count, power, weight = len(time), np.zeros(len(time) // 2 + 1), 0.0
    for part in pieces(time):
        rows = part.stop - part.start
        uniform = np.interp(np.linspace(time[part][0], time[part][-1], rows), time[part], values[part])
        taper = np.sin(0.5 * np.pi * np.minimum(1.0, (np.arange(rows) + 0.5) / (c.TAPER * count))) ** 2
        taper *= taper[::-1]
        power += np.abs(np.fft.rfft((uniform - uniform.mean()) * taper, count)) ** 2
        weight += float(np.sum(taper**2))
    return np.asarray(np.fft.rfftfreq(count, mean_step(time)), np.float64), power, weight


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The spectrum of a deflection.

    frequency (n,): Hz, without zero. density (n,): the smoothed power density. floor: the density of the noise. noise:
    standard deviation, rad, of white noise with the floor's density. rounding: the density of the rounding error if
    that error is white.
    """

    frequency: Array
    density: Array
    floor: float
    noise: float
    rounding: float = 0.0

    @classmethod
    def of(cls, time: Array, dtheta: Array, least: float = 0.0) -> Spectrum:
        """Return the spectrum of readings (n,), rad, at rising stamps (n,), s.

        least: lower limit of the readings' white noise, rad.
        """
        frequency, power, weight = power_of(time, dtheta)
        density = np.convolve(power, np.full(c.SMOOTHED_LINES, 1.0 / c.SMOOTHED_LINES), mode="same")
        of_white = c.MEDIAN_POWER * weight  # the density of white noise of 1 rad
        rounding = least**2 * of_white
        floor = max(float(np.median(density[len(density) // 2 :])), rounding)
        return cls(frequency[1:], density[1:], floor, float(np.sqrt(floor / of_white)), rounding)

    @property
    def band(self) -> tuple[float, float]:
        """The excited band, Hz, without a ripple far above the motion."""
        excited = np.where(self.frequency < self.ripple_begins, self._excited, 0.0)
        if not excited.any():
            return float(self.frequency[0]), float(self.frequency[-1])
        power = np.cumsum(excited)
        low = int(np.searchsorted(power, c.OUTSIDE_BAND * power[-1]))
        return float(self.frequency[low]), max(
            float(self.frequency[low]), self._upper_end(excited, 1.0 - c.OUTSIDE_BAND)
        )

    @cached_property
    def _excited(self) -> Array:
        """Return the density (n,) that is motion and not noise. Rounding of a steady motion is removed too: its power
        lies in lines.
        """
        beyond = np.cumsum(self.density[::-1])[::-1] > c.ABOVE_ROUNDING * self.rounding * len(self.density)
        return np.where(beyond & (self.density > c.ABOVE_FLOOR * self.floor), self.density - self.floor, 0.0)

    def _upper_end(self, excited: Array, share: float) -> float:
        """Return the frequency, Hz, below which the fraction `share` of the rate's power lies. excited (n,): density of
        the motion.
        """
        power = np.cumsum(excited * self.frequency**2)
        return float(self.frequency[int(np.searchsorted(power, share * power[-1]))])

    @cached_property
    def ripple_begins(self) -> float:
        """Return the frequency, Hz, above which there is only ripple far above the motion; infinite without ripple.

        A set-point that is held for some ticks makes the joint ripple at the rate of the set-points. Sampling aliases
        the faster harmonics, so the rate is wrong at these frequencies while the torque is right. Between the motion
        and its ripple there is hardly any power.
        """
        begins = self.rises_beyond(self.main)
        power = self._excited * self.frequency**2
        return begins if power[self.frequency > begins].sum() > c.GAIN_ERROR * power.sum() else np.inf

    @property
    def main(self) -> float:
        """Return the frequency, Hz, up to which the joint moves, without ripple; infinite if it does not move."""
        return self._upper_end(self._excited, c.MOST) if self._excited.any() else np.inf

    def rises_beyond(self, main: float) -> float:
        """Return the frequency, Hz, above which the density is far higher than just above the motion.

        main: the frequency up to which the joint moves, Hz.
        """
        beyond = self.frequency > c.RIPPLE_BEGINS * main
        width = max(1, round(main / float(self.frequency[0]))) if beyond.any() else 1
        if np.count_nonzero(beyond) <= width:
            return np.inf
        # from the fast end: rounding of the sum of a large density would hide what follows a small one
        sums = np.cumsum(np.append(0.0, self.density[beyond][::-1]))
        smooth = ((sums[width:] - sums[:-width]) / width)[::-1]
        least = np.minimum.accumulate(smooth)
        rises = np.flatnonzero((smooth > c.RIPPLE_RISES * least) & (smooth > c.ABOVE_FLOOR * self.floor))
        if not rises.size:
            return np.inf
        return float(self.frequency[beyond][np.argmin(smooth[: rises[0]]) + width // 2])

    def above(self, noise: float) -> float:
        """Return the frequency, Hz, up to which motion is clearly larger than noise, even the last hundredth of the
        rate's power.

        noise: standard deviation of the readings' noise, rad. For a random walk, or motion with corners, the part of
        the rate above the band may be far larger than the noise of the torque. The rounding of a steady motion makes
        lines and not a floor, so `noise` may exceed the noise of the floor.
        """
        floor = self.floor * max(1.0, noise / max(self.noise, 1e-300)) ** 2
        gained = np.cumsum(self.density - c.ABOVE_FLOOR * floor)
        return max(self.band[1], float(self.frequency[int(np.argmax(gained))]))
