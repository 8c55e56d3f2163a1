"""The delay and bandwidth of a cell from a load that is taken off, against the closed forms of two filters."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.calibration.step import step_response
from hil.errors import Untrustworthy
from hil.recording.reader import Array


def released(shape: str, length: float, period: float, at: float, noise: float = 1.0) -> tuple[Array, Array]:
    """Readings of 1000 that fall to 0 at `at` s, through an average over `length` s or a low-pass with it."""
    time = np.arange(0.0, 3.0, period)
    since = np.maximum(time - at, 0.0)
    left = 1.0 - np.clip(since / length, 0.0, 1.0) if shape == "average" else np.exp(-since / length)
    return time, 1000.0 * left + noise * np.random.default_rng(0).standard_normal(len(time))


@pytest.mark.parametrize(("length", "period"), [(0.05, 1 / 80), (4e-3, 1e-3)])
def test_an_average_is_late_by_half_its_length(length: float, period: float) -> None:
    found = step_response(*released("average", length, period, 1.0 + 0.3 * period))
    assert found.shape == "average"
    assert found.delay == pytest.approx(length / 2.0, abs=3.0 * found.uncertainty)
    assert found.uncertainty < 0.1 * found.delay
    assert abs(np.sinc(found.bandwidth * length)) == pytest.approx(math.sqrt(0.5), rel=0.02)


@pytest.mark.parametrize(("tau", "period"), [(5e-3, 1e-3), (0.03, 1 / 80)])
def test_a_low_pass_is_late_by_its_time_constant(tau: float, period: float) -> None:
    found = step_response(*released("low-pass", tau, period, 1.003))
    assert found.shape == "low-pass"
    assert found.delay == pytest.approx(tau, rel=0.05)
    assert 1.0 / math.hypot(1.0, 2.0 * math.pi * found.bandwidth * tau) == pytest.approx(math.sqrt(0.5), rel=0.02)


def test_a_step_faster_than_the_readings_is_somewhere_within_half_a_period() -> None:
    found = step_response(*released("average", 1e-4, 1e-3, 1.0004))
    assert found.delay + 2.0 * found.uncertainty >= 0.5e-4
    assert found.delay - 2.0 * found.uncertainty <= 0.5e-3


def test_readings_without_a_step_are_refused() -> None:
    time, value = released("average", 0.05, 1 / 80, 99.0, noise=5.0)
    with pytest.raises(Untrustworthy, match="no step"):
        step_response(time, value)
    with pytest.raises(Untrustworthy, match="too few"):
        step_response(time[:5], value[:5])
