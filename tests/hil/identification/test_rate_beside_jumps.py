"""The rate that a low-pass lacks beside jumps of the acceleration, against closed forms of steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import firwin

from ga.model.trajectory import Motion
from hil.identification.deflection.held import rate_beside_jumps

Array = NDArray[np.float64]

STEP, OMEGA, COUNT = 2e-3, 60.0, 4000
TAPS: Array = np.asarray(firwin(101, 40.0, fs=1.0 / STEP), dtype=np.float64)


class Through:
    """A low-pass of 40 Hz without a phase shift."""

    longest_step = 0.0

    def of_every(self, _every: int) -> Through:
        return self

    def passing(self, _time: Array) -> Callable[[Array], Array]:
        return lambda values: np.convolve(values, TAPS, mode="same")


def stepping() -> tuple[Motion, Array]:
    """Steps to random places at ticks through a critically damped drive."""
    rng = np.random.default_rng(2)
    ticks = np.cumsum(rng.integers(40, 160, 30))
    sizes: Array = rng.uniform(-0.3, 0.3, len(ticks))
    time: Array = STEP * np.arange(COUNT, dtype=np.float64)
    since = np.maximum(time[:, None] - STEP * ticks, 0.0)
    fading = np.exp(-OMEGA * since)
    place = (1.0 - fading * (1.0 + OMEGA * since)) @ sizes
    rate = (OMEGA**2 * since * fading) @ sizes
    acceleration = (OMEGA**2 * fading * (1.0 - OMEGA * since) * (since > 0.0)) @ sizes
    command = (np.arange(COUNT)[:, None] >= ticks) @ sizes
    return Motion(time, place, rate, acceleration, np.zeros(COUNT), behind=Through()), command


def lacking(motion: Motion) -> Array:
    """By how much the slope of the band-limited motion through all readings is more than the rate, both filtered."""
    reach = np.arange(-400, 401)
    kernel = np.where(reach == 0, 0.0, np.cos(np.pi * reach) / np.where(reach == 0, 1, reach)) * np.kaiser(801, 8.0)
    slope = np.convolve(motion.dtheta, kernel / STEP, mode="same")
    return np.convolve(slope - motion.dtheta_dot, TAPS, mode="same")


@pytest.mark.parametrize("prescribed", [True, False])
def test_the_rate_beside_jumps_is_what_a_low_pass_lacks_there(*, prescribed: bool) -> None:
    """It is one and a half times what steps at the readings lack: as much as these and steps between them differ by."""
    motion, command = stepping()
    motion = motion if prescribed else replace(motion, dtheta_ddot=motion.filtered(motion.dtheta_ddot))
    found = rate_beside_jumps(motion, motion.dtheta if prescribed else command)
    assert found is not None
    inside = slice(500, -500)
    expected = lacking(motion)[inside]
    assert abs(np.corrcoef(found[inside], expected)[0, 1]) > (0.9 if prescribed else 0.6)
    assert 0.7 < np.std(found[inside]) / np.std(expected) < 2.0


def test_a_motion_that_passed_no_low_pass_or_has_no_command_lacks_nothing() -> None:
    motion, command = stepping()
    assert rate_beside_jumps(motion, None) is None
    assert rate_beside_jumps(replace(motion, behind=None), command) is None
    assert rate_beside_jumps(motion, np.zeros(COUNT)) is None
