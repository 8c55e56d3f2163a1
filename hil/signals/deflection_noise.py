"""Predict, before anything is identified, whether noise or counts of the deflection would change Kc and Bc.

Noise in a regressor makes its parameter too small, by the ratio of the noise's power to the regressor's. A delay by a
fraction of a sample averages the noise of the readings, so a skew is biased towards the delay that averages most, and
so is Bc.
"""

from __future__ import annotations

import numpy as np

from ga.arrays import Array
from ga.model.trajectory import Motion
from hil.signals import constants as c


def smallest_step(dtheta: Array) -> float:
    """Return the smallest difference, rad, between two readings (n,) that is larger than floating-point rounding; 0 if
    there is none.
    """
    steps = np.diff(np.unique(dtheta))
    steps = steps[steps > 1e-9 * float(np.ptp(dtheta))]
    return float(steps.min()) if steps.size else 0.0


def own_noise(noise: float, values: Array, other: Array) -> float:
    """Return the standard deviation of the noise of a channel, limited to the part that another channel does not share.

    noise: standard deviation of white noise in values (n,), in their unit; it may include fast motion. other (n,): the
    readings of the other channel in the same rows. Both channels contain the motion, and each has noise of its own.
    """
    most = _unshared(values, other)
    return most if most < c.LESS_NOISE * noise else noise


def _unshared(values: Array, other: Array) -> float:
    """Return the standard deviation of white noise in values (n,) that another channel `other` (n,) does not share.

    It is computed from the upper half of the spectrum; infinite for too few rows.
    """
    count = len(values) // c.SHORTEST_SEGMENT - 1
    if count < c.FEWEST:
        return np.inf
    taper = np.hanning(2 * c.SHORTEST_SEGMENT + 1)[:-1]
    starts = c.SHORTEST_SEGMENT * np.arange(count)[:, None] + np.arange(2 * c.SHORTEST_SEGMENT)
    own, others = (
        np.fft.rfft((read - read.mean())[starts] * taper)[:, c.SHORTEST_SEGMENT // 2 : -1] for read in (values, other)
    )
    power, beside = (np.sum(np.abs(part) ** 2, axis=0) for part in (own, others))
    shared = np.abs(np.sum(own * others.conj(), axis=0)) ** 2 / np.maximum(beside, 1e-300)
    left = np.maximum(power - shared, 0.0) / (count - c.SHARED_BY_CHANCE)
    return float(np.sqrt(np.median(left) / np.sum(taper**2)))


def disturbs(motion: Motion, torque: Array, step: float, noise: float, rate_noise: float) -> bool:
    """Return whether noise of the deflection, rad, and noise of its rate, rad/s, would change Kc or Bc by 0.05 %.

    torque (n,): N m. step: time between two readings, s.
    """
    of_deflection, of_rate = (max(float(np.var(one)), 1e-300) for one in (motion.dtheta, motion.dtheta_dot))
    attenuated = max(noise**2 / of_deflection, rate_noise**2 / of_rate)
    return bool(attenuated > c.ACCURATE or _drawn(motion, torque, step, noise) > c.ACCURATE)


def _drawn(motion: Motion, torque: Array, step: float, noise: float) -> float:
    """Return the relative change of Bc that a skew biased by noise causes."""
    columns = np.stack([np.ones(len(motion)), motion.dtheta, motion.dtheta_dot, motion.dtheta_ddot], axis=1)
    _, stiffness, damping, _inertia = np.linalg.lstsq(columns, torque, rcond=None)[0].tolist()
    # what of the torque's slope no Kc and Bc can make
    slope = damping * motion.dtheta_ddot
    others = columns[:, :3]
    alone = slope - others @ np.linalg.lstsq(others, slope, rcond=None)[0]
    if float(np.mean(alone**2)) * c.CONFUSED < float(np.mean(slope**2)):
        return 0.0  # a skew cannot be distinguished, and is not included
    drawn = skew_by_noise(stiffness * noise, alone, step)
    return float(abs(stiffness * drawn / damping)) if damping else np.inf


def skew_by_noise(noise: float, column: Array, step: float) -> float:
    """Return the skew, s, towards which noise of the deflection biases a fit: at most half the time between readings.

    A delay by a fraction of a sample averages the noise of the readings. noise: times the stiffness, N m. column (n,):
    the torque per second of skew that no other parameter makes, N m/s. step: time between two readings, s.
    """
    return min(0.5 * step, c.AVERAGED_BY_SKEW * noise**2 / (step * max(float(np.mean(column**2)), 1e-300)))
