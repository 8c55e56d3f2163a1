"""The effect on the rate of a drive that holds each set-point until the next one.

The acceleration of a second-order drive jumps when it takes a new set-point. If it takes one at each reading, the rate
there is lower than that of the smooth motion through all readings, by a twelfth of the jump times the time step;
halfway between two readings it is higher by half that amount (docs/rate.md). No window and no low-pass can show this,
because the readings lie on the smooth motion. In the torque the lower rate looks like less damping, and like a delay of
a few hundredths of a tick.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ga.arrays import Array
from ga.model.terms import size_of
from ga.model.trajectory import Motion
from hil.identification.deflection.instruments import followed, is_instrument
from hil.signals import constants as c
from hil.signals.prepare import Signals


def of_jerk(motion: Motion) -> Array:
    """Return the part of the rate error (n,), rad/s, that is proportional to the jerk, where set-points are held.

    With c the set-point of a second-order drive of natural frequency w (rad/s) and damping ratio z, the jump of the
    acceleration is w^2 h dc/dt, with the time step h and dc/dt = v + 2 z/w a + j/w^2. The true rate is therefore lower
    by h^2/12 (w^2 v + 2 z w a + j), of which only the last part is known.
    """
    return c.ROUNDING**2 * motion.step**2 * motion.changing(0.0).dtheta_ddot


def taken_off(motion: Motion) -> Array:
    """Return the difference (n,), rad/s, between the computed rate and the true rate behind a drive of the usual
    natural frequency, or of the highest that the readings follow.

    The difference is that of `of_jerk`.
    """
    speed = min(2.0 * np.pi * c.USUAL_DRIVE * motion.step, (c.TAKEN_OFF / c.ROUNDING**2) ** 0.5)  # w h
    of_acceleration = 2.0 * c.ROUNDING**2 * c.DRIVE_DAMPING * speed * motion.step
    found = c.ROUNDING**2 * speed**2 * motion.dtheta_dot + of_acceleration * motion.dtheta_ddot + of_jerk(motion)
    return np.asarray(found)


def most_taken_off(signals: Signals) -> float:
    """Return the largest part of Bc that a drive which holds its set-points may take off.

    The mean of the set-points before and after a reading is a multiple of x + 2 z/w v + a/w^2, with w and z of drive
    and coupling together; with many readings in a period nothing is taken off. The rate is wrong by up to h^2/12 w^2
    (`of_jerk`). x, v and a are those that follow from the command, because they have no noise. The result is
    0 without a command, and if the joint does not lag behind its command: then nothing is known of the drive.
    """
    motion, window, command = signals.motion, signals.window, signals.command
    if window is None or not is_instrument(command) or motion.part_of is not None:
        return 0.0
    if 1.0 / motion.step > c.DENSE_READINGS * window.band[1]:
        return 0.0
    sound = window.sound(motion.time)
    smooth = followed(motion, window, command, sound)
    columns = np.stack([smooth.dtheta, smooth.dtheta_dot, smooth.dtheta_ddot], axis=1)[sound]
    held = 0.5 * (command + np.append(command[:1], command[:-1]))[sound]
    found = np.linalg.lstsq(columns - columns.mean(axis=0), held - held.mean(), rcond=None)[0]
    is_behind = bool((found[0] * found[1:] > 0.0).all())
    return float(min(c.ROUNDING**2 * motion.step**2 * found[0] / found[2], 1.0)) if is_behind else 0.0


def damping_at(rate: Array, values: Mapping[str, float]) -> Array:
    """Return the slope of the torque over the rate, N m s/rad, at rates (n,), rad/s. values: the model's parameters by
    name.
    """
    return values.get("Bc", 0.0) + 2.0 * size_of(values, "growth of damping") * np.abs(rate)
