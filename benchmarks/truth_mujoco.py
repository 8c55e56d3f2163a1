"""The cases of the truth study from a joint that MuJoCo simulates (`mujoco_joint`): it follows the chirp of a case.

Sensors read its motion and its torque as in the closed form.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from mujoco_joint import Joint, simulated
from truth_cases import DURATION, Array, Case, Motion, Truth, chirp

STEP = 1e-4  # s, of the integrator: a sine of 15 Hz between two steps is a line within 1e-5 of its amplitude
BEFORE = 0.5  # s of the chirp's first sine before the first sample, in which the joint comes up to it

WITHOUT = ("backlash", "motor side", "too slow", "standing still")  # what MuJoCo's joint has no parameter for


@dataclass(frozen=True, eq=False, slots=True)
class Driven:
    """What a joint did, on a grid `time` (n,) s: its motion, and the torque of its coupling, N m.

    It stands in for a `Case` where the sensors ask how the joint moves and what a perfect cell would show.
    """

    truth: Truth
    time: Array
    moved: Motion
    carried: Array

    def motion(self, time: Array) -> Motion:
        """The motion at `time` (m,) s."""
        parts = (self.moved.deflection, self.moved.rate, self.moved.acceleration)
        return Motion(*(np.interp(time, self.time, part) for part in parts))

    def torque(self, time: Array) -> Array:
        """The torque a perfect cell would show at `time` (m,) s, N m, late by the skew."""
        late = np.interp(time - self.truth.skew, self.time, self.carried)
        return np.asarray(late + self.truth.tau0 + self.truth.drift * time)


def driven(case: Case) -> Driven:
    """Return how MuJoCo moves the joint of a case. Raises ValueError for a case that it has no parameter for."""
    if case.name in WITHOUT:
        raise ValueError(f"MuJoCo's joint has no parameter for the case {case.name!r}")
    true = case.truth
    joint = Joint(true.Kc, true.Bc, cubic=true.K3, friction=true.Fc)
    return Driven(true, *_simulated(case.band, joint))


@functools.lru_cache(maxsize=4)  # the seeds of a case share the motion: only their sensors differ
def _simulated(band: tuple[float, float], joint: Joint) -> tuple[Array, Motion, Array]:
    time = np.arange(round((DURATION + 2.0 * BEFORE) / STEP)) * STEP - BEFORE
    wanted = chirp(np.maximum(time, 0.0), band)
    wave = np.where(time < 0.0, 0.0, wanted.deflection), np.where(time < 0.0, 0.0, wanted.rate)
    deflection, rate, carried = simulated(joint, STEP, *wave)
    return time, Motion(deflection, rate, np.gradient(rate, STEP)), carried
