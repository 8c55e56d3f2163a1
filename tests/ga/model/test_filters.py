"""Filters in front of the torque, and motion at the times of a slower cell, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from ga.model.coupling import CouplingModel, parse
from ga.model.memory import averaged
from ga.model.separable import Problem, fit
from ga.model.trajectory import Motion, joined

Array = NDArray[np.float64]
Numbers = NDArray[Any]

KC, BC, NOISE = 0.3, 3e-3, 5e-4
OMEGA = 2.0 * np.pi * np.arange(1.0, 13.0)
PHASES = np.random.default_rng(4).uniform(0.0, 2.0 * np.pi, 12)
STEP = 2e-3


def moving(time: Numbers) -> Motion:
    """A sum of sines from 1 to 12 Hz."""
    waves = 0.05 * np.exp(1j * (np.outer(time, OMEGA) + PHASES))
    parts = [(waves * (1j * OMEGA) ** order).sum(axis=1).imag for order in range(3)]
    return Motion(time, parts[0], parts[1], parts[2], np.zeros(len(time)))


def behind(time: Numbers, response: Numbers) -> Array:
    """The torque of spring and damper behind a filter of that response (12,) to each sine, and noise."""
    waves = 0.05 * np.exp(1j * (np.outer(time, OMEGA) + PHASES)) * (KC + 1j * OMEGA * BC) * response
    return np.asarray(waves.sum(axis=1).imag + NOISE * np.random.default_rng(5).standard_normal(len(time)))


TIME = STEP * np.arange(3000)
MOTION = moving(TIME)


def fitted(name: str, torque: Array) -> dict[str, float]:
    model = parse(name).anchored(MOTION)
    found = fit(Problem(model, MOTION, torque, *model.bounds(MOTION, 12.2)))
    return dict(zip((parameter.name for parameter in model.parameters), found.values.tolist(), strict=True))


@pytest.mark.parametrize("width", [0.004, 0.03])
def test_a_mean_of_a_sine_is_that_of_the_closed_form(width: float) -> None:
    found = MOTION.averaged(np.sin(20.0 * TIME), width)
    inside = slice(20, -20)
    exact = np.sin(20.0 * TIME) * np.sinc(20.0 * width / (2.0 * np.pi))
    np.testing.assert_allclose(found[inside], exact[inside], atol=1e-7)


@pytest.mark.parametrize(("count", "width"), [(2, 0.01), (3, 0.001), (400, 0.0005), (400, 0.03), (400, 10.0)])
def test_a_mean_over_uneven_stamps_is_that_of_an_independent_curve(count: int, width: float) -> None:
    """scipy's integral of the cubic curve with the slopes of central differences; near the ends over less."""
    rng = np.random.default_rng(count)
    time, values = np.cumsum(rng.uniform(1e-3, 3e-3, count)), rng.standard_normal((count, 3))
    integral = CubicHermiteSpline(time, values, np.gradient(values, time, axis=0)).antiderivative()
    reach = np.minimum(0.5 * width, np.minimum(time - time[0], time[-1] - time))[1:-1, None]
    middle = time[1:-1, None]
    expected = (integral((middle + reach)[:, 0]) - integral((middle - reach)[:, 0])) / (2.0 * reach)

    found = averaged(time, values, width)
    np.testing.assert_allclose(found[1:-1], expected, atol=1e-9)
    np.testing.assert_allclose(found[[0, -1]], values[[0, -1]], atol=1e-2)
    np.testing.assert_array_equal(averaged(time, values[:, 1], width), found[:, 1])


@pytest.mark.parametrize("width", [0.0, 0.02])
def test_the_means_of_some_samples_are_those_that_they_have_among_all(width: float) -> None:
    twice = joined([MOTION, moving(TIME + 1.0)])
    torque = np.column_stack([twice.dtheta, np.repeat([0.0, 5.0], len(MOTION)) + twice.dtheta_dot])
    some = twice.of(np.isin(np.arange(len(twice)), [0, 7, 2999, 3000, 3001, 4000, 5999]))
    np.testing.assert_array_equal(some.averaged(torque, width), twice.averaged(torque, width)[some.whole[1]])


def test_a_mean_over_nothing_is_the_torque_itself() -> None:
    torque = np.sin(20.0 * TIME)
    np.testing.assert_allclose(MOTION.averaged(torque, 1e-12), torque, atol=1e-5)


def test_stiffness_and_damping_come_back_from_a_moving_average() -> None:
    response = np.exp(-1j * np.outer(OMEGA, STEP * np.arange(10))).mean(axis=1)
    found = fitted("linear+offset+skew+mean", behind(TIME, response))
    assert found["Kc"] == pytest.approx(KC, rel=3e-3)
    assert found["Bc"] == pytest.approx(BC, rel=0.03)
    assert found["skew"] == pytest.approx(4.5 * STEP, abs=2e-4)
    assert found["window"] == pytest.approx(10.0 * STEP, rel=0.05)


@pytest.mark.parametrize("delay", [-0.006, 0.005, 0.009, 0.012])
def test_a_delay_is_found_though_damping_nearly_undoes_it(delay: float) -> None:
    found = fitted("linear+offset+skew", behind(TIME, np.exp(-1j * OMEGA * delay)))
    assert found["skew"] == pytest.approx(delay, abs=2e-4)
    assert found["Bc"] == pytest.approx(BC, rel=0.02)


def test_a_lag_is_not_taken_for_an_earlier_torque_with_negative_damping() -> None:
    found = fitted("linear+offset+skew", behind(TIME, 1.0 / (1.0 + 5e-3j * OMEGA)))
    assert found["skew"] > 0.0
    assert found["Bc"] > 0.0


def test_motion_between_the_ticks_is_delayed_as_exactly_as_at_them() -> None:
    at = np.arange(0.1, 5.8, 0.0127)
    there = MOTION.at(at)
    np.testing.assert_array_equal(there.time, at)
    np.testing.assert_allclose(there.delayed(3e-3).dtheta_dot, moving(at - 3e-3).dtheta_dot, atol=5e-4)


def test_nothing_is_read_between_two_stretches() -> None:
    there = replace(MOTION, starts=(0, 1500))
    at = np.array([0.5, 1.0, float(TIME[1499]) + 1e-3, 3.5, 4.0, 9.0])
    found = there.at(at)
    np.testing.assert_array_equal(found.time, at[[0, 1, 3, 4]])
    assert found.starts == (0, 2)


def test_a_reading_alone_in_a_stretch_is_left_out() -> None:
    """No curve leads through one. Of 120 broken recordings of slow cells five ended with a fault."""
    there = replace(MOTION, starts=(0, 1500, 1600))
    at = np.array([0.5, 1.0, float(TIME[1550]), 3.5, 4.0])
    found = there.at(at)
    np.testing.assert_array_equal(found.time, at[[0, 1, 3, 4]])
    np.testing.assert_allclose(found.delayed(1e-3).dtheta, moving(found.time - 1e-3).dtheta, atol=1e-4)


def test_motions_one_after_the_other_remain_parts_of_their_wholes() -> None:
    first, second = MOTION.at(np.arange(0.1, 2.0, 0.0127)), moving(TIME).at(np.arange(1.0, 5.0, 0.0127))
    both = joined([first, second])
    np.testing.assert_allclose(
        both.delayed(2e-3).dtheta, np.concatenate([first.delayed(2e-3).dtheta, second.delayed(2e-3).dtheta])
    )
    moved = both.shifted(0.2)
    np.testing.assert_allclose(moved.delayed(2e-3).dtheta, both.delayed(2e-3).dtheta - 0.2)


def test_a_torque_that_passes_two_cells_passes_one_after_the_other() -> None:
    """Of some samples too: the second cell needs the first one's readings beside them."""
    some = MOTION.of(slice(100, None, 7))
    found = CouplingModel("linear+lag+mean").columns(some, np.array([4e-3, 0.02]))[:, 0]
    expected = MOTION.averaged(MOTION.lagged(MOTION.dtheta, 4e-3), 0.02)[100::7]
    np.testing.assert_allclose(found[50:], expected[50:], atol=1e-9)
