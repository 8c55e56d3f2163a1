"""Set-points that are held until the next reading take a part off the rate there: that is no skew and no misfit.

The joint follows filtered noise or a sum of sines as a system of second order, whose deflection and rate at the ticks
are exact.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, cont2discrete, lfilter

from ga.evolution.evolution import PRESETS
from ga.model.coupling import parse
from hil.identification.fitting.solution import Search
from hil.identification.identify import identify
from hil.identification.selection.held import held
from hil.recording.reader import Array

from ..conftest import Maker

KC, BC = 0.3, 6e-3
SAMPLES, STEP = 5000, 2e-3
SEARCH = Search("default", PRESETS["default"], trials=1, seed=0, workers=1, bounds={})


def driven(command: Array, highest: float) -> tuple[Array, Array]:
    """Deflection and rate (n,), SI, of a drive of that natural frequency, Hz, behind set-points (n,) rad."""
    omega = 2.0 * np.pi * highest
    system = np.array([[0.0, 1.0], [-(omega**2), -1.5 * omega]]), np.array([[0.0], [omega**2]])
    a, b, *_ = cont2discrete((*system, np.eye(2), np.zeros((2, 1))), STEP)
    state = np.zeros((len(command), 2))
    for at in range(len(command) - 1):
        state[at + 1] = a @ state[at] + b[:, 0] * command[at]
    return state[:, 0], state[:, 1]


def noise() -> Array:
    """Set-points of noise up to 14 Hz, rad."""
    b, a = butter(2, 14.0 * 2.0 * STEP)
    found = lfilter(b, a, np.random.default_rng(3).standard_normal(SAMPLES))
    return np.asarray(0.25 * found / np.abs(found).max())


def sines(time: Array) -> tuple[Array, Array]:
    """A sum of sines of 0.5 to 12 Hz and its rate at times (n,) s, SI."""
    omega = 2.0 * np.pi * np.geomspace(0.5, 12.0, 15)
    waves = 0.03 * np.exp(1j * (np.outer(time, omega) + np.random.default_rng(3).uniform(0.0, 2.0 * np.pi, 15)))
    return waves.sum(axis=1).imag, (1j * omega * waves).sum(axis=1).imag


def recorded(make_recording: Maker, angle: Array, torque: Array) -> Path:
    """A recording of that deflection and torque (n,), SI, with noise of 0.4 mN m in the torque."""

    def change(channels: dict[str, Array]) -> None:
        channels["dtheta"] = angle
        channels["torque"] = torque + 4e-4 * np.random.default_rng(4).standard_normal(SAMPLES)

    return make_recording(change=change, samples=SAMPLES)


def test_set_points_that_are_held_between_readings_are_no_misfit_and_leave_bc_in_its_interval(
    make_recording: Maker,
) -> None:
    """A skew that stood for them, of 44 us, made Bc 0.2 % too high, beside a misfit."""
    angle, rate = driven(noise(), 14.0)
    found = identify([recorded(make_recording, angle, KC * angle + BC * rate)], None, SEARCH)
    assert all(one.code != "misfit" for one in found.diagnostics)
    for name, truth in (("Kc", KC), ("Bc", BC)):
        low, high = found[name].ci95
        assert low < truth < high
        assert high - low < 0.015 * truth
    assert 0.5 * sum(found["Bc"].ci95) == pytest.approx(BC, rel=1e-3)


def test_the_interval_of_bc_holds_set_points_that_a_smooth_motion_hides(make_recording: Maker) -> None:
    command, _ = sines(np.arange(0.0, SAMPLES) * STEP)
    angle, rate = driven(command, 30.0)
    path = recorded(make_recording, angle, KC * angle + BC * rate)
    low, high = identify([path], None, SEARCH)["Bc"].ci95
    assert low < BC < high
    own_low, own_high = identify([path], parse("linear+skew"), SEARCH)["Bc"].ci95
    assert not own_low < BC < own_high


@pytest.mark.parametrize(("inertia", "expected"), [(-1.0, True), (1.0, False), (-100.0, False)])
def test_held_set_points_look_like_a_small_negative_inertia(inertia: float, expected: bool) -> None:
    """A drive of 196 rad/s and a damping ratio of 0.75 takes (w h)^2/12 of the rate off, 1.3 %."""
    as_one = BC * STEP**2 / 12.0 * 1.5 * 196.0
    found = held(inertia * as_one, BC, STEP, 0.0)
    assert (found is not None) == expected
    if found is not None:
        assert found.size == pytest.approx((196.0 * STEP) ** 2 / 12.0)
        assert found.spread == pytest.approx(0.5 * found.size)
